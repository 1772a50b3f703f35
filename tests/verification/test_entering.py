"""To enter a crew is cheap: what depends on a plan alone is made once, and a workspace is only put in its place."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from shipgrid.assembly import tables
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.core_text import numbers_of
from shipgrid.assembly.tables import COPIES, arguments, named_arrays, scratch_of
from shipgrid.assembly.workspace import new_workspace
from shipgrid.io.ship_file import load_ship
from shipgrid.model.kernel import TableRow
from shipgrid.model.network import Network
from shipgrid.scenarios import provenance
from shipgrid.scenarios import simulate as simulation
from shipgrid.solvers.pacing import pace_work

PARTS = {"for": ["dc_for"], "aft": ["dc_aft"], "grid": ["ac_for", "ac_aft"]}


def ferry(**options):
    network = Network("ferry", options.pop("fidelity", "averaged"))
    load_ship("ferry").build(network)
    return assemble(network, 30e-6, **options)


@pytest.fixture(scope="module")
def plan():
    return ferry(fidelity="switching")


def recording(plan, places):
    """A copy of a plan that records other signals, as a run of a circuit makes one."""
    recorded = np.array(places, dtype=np.int64)
    return replace(plan, step=plan.step._replace(recorded=recorded, n_plant=len(recorded), record_every=7))


def addresses(plan, work):
    """Entries of a table by the name of their array: its address and shape, for what has any memory."""
    _, memory = arguments(plan, work)
    work.kept = memory  # as long as somebody has the workspace, nothing else lies there
    numbers = memory.rows.numbers[-1].tolist()
    arrays = named_arrays(plan, work, scratch_of(plan))
    places = TableRow(arrays, {}).places
    return arrays, {
        name: (numbers[place], tuple(numbers[place + 1 : place + 1 + arrays[name].ndim]))
        for name, place in places.items()
        if arrays[name].nbytes
    }


def scratch_names(plan):
    return {f"{t.kind.key}.{name}{flat}" for t in plan.layout.types for name in COPIES for flat in ("", "_flat")}


def ring_sized(work):
    """A workspace as a live run has it: rings of another length in the place of some arrays."""
    made = work.snapshot()
    made.step = made.step._replace(wave_rows=np.zeros((16_384, work.step.wave_rows.shape[1])))
    made.pace = pace_work(bins=100, windows=16, worst=4, commands=8, signals=len(work.sig))
    return made


def test_rows_are_made_once_for_all_copies_of_a_plan(monkeypatch):
    plan, made, real = ferry(), [], tables.named_arrays
    monkeypatch.setattr(tables, "named_arrays", lambda plan, *rest: made.append(plan) or real(plan, *rest))
    for copy in (plan, recording(plan, [3, 4]), recording(plan, [])):
        arguments(copy, new_workspace(copy))
    assert len(made) == 1


@pytest.mark.parametrize("recorded", [None, [], [5, 3, 8]])
@pytest.mark.parametrize("work_of", [new_workspace, lambda plan: ring_sized(new_workspace(plan))])
def test_every_array_is_found_where_this_workspace_and_this_copy_have_it(plan, recorded, work_of):
    """Whatever the workspace looked like that came first: here one that records nothing, with arrays of no size."""
    arguments(recording(plan, []), new_workspace(recording(plan, [])))
    copy = plan if recorded is None else recording(plan, recorded)
    work = work_of(copy)
    arrays, found = addresses(copy, work)
    own = {name: array for name, array in arrays.items() if name not in scratch_names(plan)}
    assert len(own) > 400
    ends = (".weight", ".place_in_books", "calls", "call_due", "call_start")  # made anew by each call of `named_arrays`
    made_anew = {name for name in own if name.endswith(ends)}
    for name in found.keys() & own.keys() - made_anew:
        assert found[name] == (own[name].ctypes.data, own[name].shape), name
    for name in made_anew:
        assert found[name][1] == own[name].shape


def test_numbers_are_those_of_the_copy(plan):
    copy = recording(plan, [5, 3, 8])
    _, memory = arguments(copy, new_workspace(copy))
    whole, real = memory.whole, memory.real
    numbers = numbers_of(copy)
    assert numbers["n_plant"] == 3 and numbers["record_every"] == 7
    assert whole[0].tolist() == [n for n in numbers.values() if isinstance(n, int)]
    assert real[0].tolist() == [n for n in numbers.values() if not isinstance(n, int)]


def test_two_runs_of_a_plan_share_nothing_that_a_step_writes(plan):
    """Two threads may step two workspaces at once."""
    works = [new_workspace(plan) for _ in range(2)]
    (_, one), (_, other) = (addresses(plan, work) for work in works)
    constant = {*plan.net._fields, *plan.step._fields, "sources"}
    kinds = [t.kind.key for t in plan.layout.types]
    own = ("clock", "weight", "p", "tables", "clock_inc", "clock_den", "clock_period", "place_in_books")
    constant |= {f"{key}.{name}" for key in kinds for name in (*plan.gathers.get(key, {}), *own)}
    constant |= {"calls", "call_due", "call_start"}
    for name in one.keys() - constant:
        assert one[name] != other[name], name


def test_memory_between_steps_of_a_part_has_room_for_each_of_its_components():
    """And that of one part shares no cache line with that of another, which another core writes."""
    cut = ferry(parts=PARTS)
    for part in cut.parts:
        arrays = named_arrays(part, new_workspace(part), scratch_of(part))
        spans = sorted((a.ctypes.data, a.nbytes) for name, a in arrays.items() if name in scratch_names(part))
        spans = sorted(set(spans))  # a record and its numbers are one
        for (start, size), (following, _) in pairwise(spans):
            assert start + size <= following
        assert scratch_of(part).ctypes.data % 64 == 0


def test_a_plan_that_nobody_has_any_more_is_freed():
    plan = ferry()
    arguments(plan, new_workspace(plan))
    gone = weakref.ref(plan.layout), weakref.ref(plan.network)
    del plan
    gc.collect()
    assert [reference() for reference in gone] == [None, None]


def test_an_array_in_pieces_is_refused(plan):
    work = new_workspace(plan)
    work.net = work.net._replace(v=np.zeros(2 * len(work.net.v))[::2])
    with pytest.raises(ValueError, match="must lie in one piece"):
        arguments(plan, work)


def test_what_is_found_at_the_start_stays_until_the_table_is_gone(plan):
    """A table keeps the arrays alive that it names."""
    work = new_workspace(plan)
    array = weakref.ref(work.step.energy)
    values = arguments(plan, work)
    del work
    gc.collect()
    assert array() is not None
    del values
    gc.collect()
    assert array() is None


def test_a_run_has_its_rows_made_once_from_its_provenance_to_its_last_step(monkeypatch):
    """Built, started, timed and stepped."""
    made, real = [], tables.named_arrays
    monkeypatch.setattr(tables, "named_arrays", lambda plan, *rest: made.append(plan) or real(plan, *rest))
    plan = ferry()
    provenance.provenance(plan)
    simulation.time_of_a_step(plan, new_workspace(plan), steps=2)
    simulation.time_of_a_step(plan, new_workspace(plan), steps=2)
    assert len(made) == 1
