"""A plant in parts: where it is cut, what its parts read of each other, and that threads change nothing."""

from __future__ import annotations

import threading

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.analysis.settling import run_to_rest
from shipgrid.assembly import crew as crew_module
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import code_names
from shipgrid.assembly.crew import Crew, shared_out
from shipgrid.assembly.partition import divide, propose
from shipgrid.assembly.workspace import new_workspace
from shipgrid.components.electrical.resistor import Resistor
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.errors import TopologyError
from shipgrid.model.connections import Across
from shipgrid.model.network import Network
from shipgrid.model.placed import Sampled
from shipgrid.solvers.crew import CROWDED
from verification.circuits import Hold, Sampler, SourceBranch
from verification.parted import CUT, buses, circuit, run, started, traced, two_buses, value

H = 30e-6
CABLE = RlBranch(R=1e-3, L=100e-6)


def joined(item, **ports):
    net = circuit("plant")
    a, b = buses(net, a=1e-3, b=1e-3)
    net.add("link", item, ports=ports or {"branch": Across(a, b)})
    return net


def test_a_bus_that_does_not_exist_is_named_with_the_nearest():
    with pytest.raises(TopologyError, match=r"'fore'"):
        divide(joined(CABLE), {"one": ["fore"], "two": ["b"]}, H)


def test_a_bus_in_two_parts_is_refused():
    with pytest.raises(TopologyError, match=r"bus 'b' is in two parts, 'two' is the second"):
        divide(joined(CABLE), {"one": ["a", "b"], "two": ["b"]}, H)


def test_a_bus_between_two_parts_has_to_be_named():
    net = joined(CABLE)
    (c,) = buses(net, c=1e-3)
    net.add("onward", CABLE, ports={"branch": Across(net.bus("b"), c)})
    with pytest.raises(TopologyError, match=r"b between the parts 'one' and 'two', expected in one of them"):
        divide(net, {"one": ["a"], "two": ["c"]}, H)


def test_what_has_no_inductance_at_a_terminal_cannot_be_cut():
    expected = r"link \(\w+\) lies between two parts and cannot be cut: expected an element whose current .* a cable"
    with pytest.raises(TopologyError, match=expected):
        divide(joined(Resistor(R=1.0)), CUT, H)
    net = circuit("plant")
    a, b = buses(net, a=1e-3, b=1e-3)
    net.add("link", SourceBranch(R=1.0, L=1e-3), ports={"ends": Across(a, b)})  # its source would be at both ends
    with pytest.raises(TopologyError, match=expected):
        divide(net, CUT, H)


def test_the_ferry_falls_apart_as_the_paper_has_it_and_never_at_the_ac_tie():
    net = Network("ferry")
    sg.load_ship("ferry").build(net)
    fore, aft, grid = ("dc_for", "genset_for.terminals"), ("dc_aft", "genset_aft.terminals"), ("ac_for", "ac_aft")
    assert propose(net, 3, H) == {"dc_for": fore, "dc_aft": aft, "ac_for": grid}
    two = propose(net, 2, H)
    assert {frozenset(names) for names in two.values()} in (
        {frozenset(fore), frozenset(aft + grid)},
        {frozenset(fore + grid), frozenset(aft)},
    )
    assert [len(propose(net, 1, H))] == [1]
    for count in range(1, 9):
        for h in (1e-6, H, 90e-6):
            parts = propose(net, count, h)
            assert len(parts) <= count
            assert sorted(name for names in parts.values() for name in names) == sorted(net.buses)
            assert any({"ac_for", "ac_aft"} <= set(names) for names in parts.values())
    lines = {line.path: line for line in divide(net, propose(net, 3, H), H).lines}
    assert sorted(lines) == ["dc_tie.branch", "inverter_aft.filter", "inverter_for.filter"]
    # models of the design: 0.849 mH has 1.06 uF at 30 us, 2.1 % of the filter's 49.7 uF
    surplus = lines["inverter_for.filter"]
    farad = surplus.C
    assert farad == pytest.approx(1.06e-6, rel=2e-3)
    assert surplus.share == pytest.approx(0.0213, rel=1e-2)
    assert set(lines["dc_tie.branch"].parts) == {"dc_for", "dc_aft"}


def test_a_cut_plant_has_the_code_of_the_uncut_one():
    assert code_names(two_buses(H, CUT).kinds) == code_names(two_buses(H, None).kinds)


def islands(parts):
    """Two that nothing joins, so that a cut between them changes no voltage; what belongs to one reads the other."""
    net = circuit()
    a, b = buses(net, a=100e-6, b=100e-6)
    net.add("first.source", SourceBranch(R=0.1, L=1e-3), ports={"ends": a}, inputs={"e": -100.0})
    net.add("first.hold", Hold(), inputs={"wanted": "first.source.i"})
    net.add("second.source", SourceBranch(R=0.1, L=1e-3), ports={"ends": b}, inputs={"e": -50.0})
    net.add("second.seen", Hold(), inputs={"wanted": "a.v_dc"})
    net.add("second.heard", Hold(), inputs={"wanted": "first.hold.value"})
    net.add("second.sampler", Sampler(), inputs={"v": "a.v_dc"}, clock=Sampled(1620.0))
    return assemble(net, H, parts=parts)


def test_a_part_sees_of_another_what_there_was_at_the_end_of_the_last_step():
    plan = islands(CUT)
    assert plan.partition is not None
    assert sorted(plan.partition.parts[1].foreign) == ["a.v_dc", "first.hold.value"]
    paths = ["a.v_dc", "first.source.i", "second.seen.value", "first.hold.value", "second.heard.value"]
    v, i, seen, hold, heard = traced(plan, started(plan), 200, paths).T
    assert np.ptp(v) > 100.0
    assert np.array_equal(seen[1:], v[:-1])  # measured quantities: as in the uncut plant
    assert np.array_equal(hold[1:], i[:-1])
    assert np.array_equal(heard[1:], hold[:-1])  # what a controller computes: a step later


def test_a_sampled_controller_sees_across_a_cut_what_it_sees_in_the_uncut_plant():
    samples = []
    for parts in (CUT, None):
        plan = islands(parts)
        samples.append(traced(plan, started(plan), 400, ["second.sampler.sample", "second.sampler.at", "a.v_dc"]))
    assert np.array_equal(*samples)
    assert len(np.unique(samples[0][:, 0])) > 15  # interpolated to instants inside steps: 19 of them in 12 ms


def chain(at="c", e=-100.0):
    """Three parts in a row, fed at one bus, reading each other; the first is the heaviest."""
    net = circuit()
    a, b, c = buses(net, a=1e-3, b=2e-3, c=3e-3)
    net.add("first.line", CABLE, ports={"branch": Across(a, b)}, variant=net.command("first.open"))
    net.add("last.line", CABLE, ports={"branch": Across(b, c)})
    net.add("source", SourceBranch(R=0.5, L=1e-3), ports={"ends": net.bus(at)}, inputs={"e": e})
    net.add("last.hold", Hold(), inputs={"wanted": "a.v_dc"})
    net.add("first.sampler", Sampler(), inputs={"v": "c.v_dc"}, clock=Sampled(1620.0))
    net.conductance(a, 0.3)
    return assemble(net, H, audit=10 * H, parts={"one": ["a"], "two": ["b"], "three": ["c"]})


@pytest.mark.parametrize("cores", [None, 1])
def test_the_number_of_threads_changes_no_bit(cores, monkeypatch):
    """Spinning where there are cores enough, and with one core, as it were, giving way to each other."""
    if cores:
        monkeypatch.setattr(crew_module, "cores", lambda: list(range(cores)))
    plan, found, begun = chain(), [], []
    for workers in (1, 2, 3):
        work = started(plan)
        with Crew(plan, work, workers, joined=begun.append) as crew:
            assert len(crew.posts) == workers
            assert crew(300, 0) == 300
            work.sig[plan.layout.index["command:first.open"]] = 1.0
            assert crew(200, 300) == 200
            work.sig[plan.layout.index["command:first.open"]] = 0.0
            assert crew(500, 500) == 500
        assert not [t for t in threading.enumerate() if t.name.startswith("shipgrid-core")]
        found.append((work.sig, work.energy))
    assert sorted(begun) == [1, 1, 2]
    assert value(plan, work, "a.v_dc") > 50.0
    for sig, energy in found[1:]:
        assert np.array_equal(sig, found[0][0])
        assert np.array_equal(energy, found[0][1])


def test_a_failure_in_a_part_of_another_thread_stops_all_at_the_same_step():
    stopped = []
    for workers in (1, 2, 3):
        plan = chain("a", -5000.0)
        work = started(plan)
        with Crew(plan, work, workers) as crew:
            stopped.append(crew(5000, 0))
            assert workers == 1 or crew.crew[0] != 0  # not the leader's part
        stopped.append(work.sig)
    assert -5000 < stopped[0] < -10
    assert stopped[0] == stopped[2] == stopped[4]
    assert np.array_equal(stopped[1], stopped[3]) and np.array_equal(stopped[1], stopped[5])


def test_a_crew_may_run_a_step_again_and_come_back_after_it_was_left():
    plan, found = chain(), []
    for workers in (1, 3):
        work = started(plan)
        crew = Crew(plan, work, workers)
        for _ in range(2):
            with crew:
                assert [crew(1, 0), crew(1, 0), crew(5, 2), crew(1, 6)] == [1, 1, 5, 1]
        found.append(work.sig)
    assert np.array_equal(*found)


def test_the_leader_has_least_and_nobody_nothing():
    plan = chain()
    weight = [len(part.network.placed) for part in plan.parts]
    for workers in (2, 3):
        share = shared_out(plan, workers)
        load = [sum(w for w, worker in zip(weight, share, strict=True) if worker == k) for k in range(workers)]
        assert load == sorted(load)
        assert min(load) > 0


def test_a_plant_in_one_piece_has_a_crew_of_one():
    plan = two_buses(H, None)
    work, other = (started(plan, a__v_dc=100.0) for _ in range(2))
    run(plan, work, 100)
    with Crew(plan, other, 3) as crew:
        assert len(crew.posts) == 1 and not crew.threads
        assert crew(100, 0) == 100
    assert np.array_equal(work.sig, other.sig)


def test_a_plant_in_parts_is_refused_where_it_would_look_empty():
    with pytest.raises(TopologyError, match="is cut into parts, expected the plant in one piece"):
        run_to_rest(chain(), {})


def test_a_crew_spins_on_cores_of_its_own_and_yields_on_shared_ones():
    plan = chain()
    for crowded in (True, False):
        crew = Crew(plan, new_workspace(plan), 2, crowded=crowded)
        assert set(crew.posts[:, CROWDED].tolist()) == {int(crowded)}
    with pytest.raises(RuntimeError, match="has to be entered"):
        crew(1, 0)


def test_a_thread_that_cannot_begin_ends_the_others():
    def joined(worker):
        raise OSError("no such core")

    plan = chain()
    with pytest.raises(OSError, match="no such core"):
        Crew(plan, new_workspace(plan), 2, joined).__enter__()
