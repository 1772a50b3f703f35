"""What the step keeps besides the physics: interval means and extremes, and what an opening contact takes."""

from __future__ import annotations

import numpy as np
import pytest

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.energy import stored_energy
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.model.network import Network
from shipgrid.scenarios.recorder import ResultsWriter
from shipgrid.scenarios.results import open_results
from shipgrid.scenarios.session import Run, run_until
from shipgrid.units import Ampere, Henry, Ohm, Volt
from verification.circuits import Hold, SourceBranch

STEP, C, E = 10e-6, 100e-6, 100.0


class PairState:
    i_1: Ampere = signal("current of the first winding")
    i_2: Ampere = signal("current of the second winding")


class PairInput:
    v_1: Volt = signal("voltage of the first winding")
    v_2: Volt = signal("voltage of the second winding")


class PairOutput:
    i_1_in: Ampere = signal("current into the first winding")
    i_2_in: Ampere = signal("current into the second winding")


@kernel
def pair_derivatives(x, u, p, dx):
    det = p.L_1 * p.L_2 - p.M * p.M
    v_1, v_2 = u.v_1 - p.R * x.i_1, u.v_2 - p.R * x.i_2
    dx.i_1 = (p.L_2 * v_1 - p.M * v_2) / det
    dx.i_2 = (p.L_1 * v_2 - p.M * v_1) / det


@kernel
def pair_outputs(x, y):
    y.i_1_in = x.i_1
    y.i_2_in = x.i_2


@kernel
def pair_energy(x, p):
    return 0.5 * p.L_1 * x.i_1**2 + p.M * x.i_1 * x.i_2 + 0.5 * p.L_2 * x.i_2**2


@component(
    state=PairState,
    input=PairInput,
    output=PairOutput,
    derivatives=pair_derivatives,
    outputs=pair_outputs,
    stored_energy=pair_energy,
    terminals=(Terminal("one", v="v_1", i="i_1_in"), Terminal("two", v="v_2", i="i_2_in")),
    variants={"second open": ("i_2",), "open": ("i_1", "i_2")},
)
class CoupledPair:
    """Two coupled windings, with contacts in the second and in both."""

    R: Ohm = param("resistance of each", default=0.1, at_least=0.0)
    L_1: Henry = param("first inductance", default=1e-3, above=0.0)
    L_2: Henry = param("second inductance", default=2e-3, above=0.0)
    M: Henry = param("mutual inductance", default=0.8e-3, at_least=0.0)


def circuit(**options):
    """A source charges a bus; both windings of a pair hang on it."""
    net = Network("pair")
    bus = net.dc_bus("bus", 200.0)
    net.capacitance(bus, C)
    net.add("source", SourceBranch(R=0.1, L=1e-3), ports={"ends": bus}, inputs={"e": -E})
    net.add("hold", Hold(), inputs={"wanted": net.command("pair.position")})
    net.add("pair", CoupledPair(), ports={"one": bus, "two": bus}, variant="hold.value")
    net.publish("bus.v_dc", source="bus.v_dc", unit="V", description="bus voltage")
    net.publish("source.i", source="source.i", unit="A", description="source current", group="slow")
    return assemble(net, STEP, **options)


def stepped(plan, work, n):
    assert core()(n, work.n, *arguments(plan, work)) == n
    work.n += n


@pytest.mark.parametrize("position", [1.0, 2.0])
def test_what_an_opening_contact_interrupts_is_booked_as_a_loss_of_its_element(position):
    plan = circuit()
    work = new_workspace(plan)
    stepped(plan, work, 100)
    place = {name: plan.layout.index[f"pair.{name}"] for name in ("i_1", "i_2")}
    assert min(abs(work.sig[k]) for k in place.values()) > 1.0
    before = stored_energy(plan, work)["pair"]
    i_1 = work.sig[place["i_1"]]
    kept = 0.5 * 1e-3 * i_1**2 if position == 1.0 else 0.0
    entry = plan.energy_items.index(("pair", "losses"))
    assert work.step.energy[entry] == 0.0
    work.sig[plan.layout.index["command:pair.position"]] = position
    stepped(plan, work, 1)
    assert work.sig[place["i_2"]] == 0.0
    assert work.step.energy[entry] == pytest.approx(before - kept, rel=1e-12)
    stepped(plan, work, 100)
    assert work.step.energy[entry] == pytest.approx(before - kept, rel=1e-12)  # once, not every step
    work.sig[plan.layout.index["command:pair.position"]] = 0.0
    stepped(plan, work, 1)
    assert work.step.energy[entry] == pytest.approx(before - kept, rel=1e-12)  # closing takes nothing


@pytest.mark.parametrize("chunk", [7, 1000])
def test_recorded_means_and_extremes_are_those_of_all_steps_since_the_last_row(chunk):
    every, slowly, n = 20, 50, 200
    plan = circuit(record=every * STEP, record_slow=slowly * STEP)
    work = new_workspace(plan)
    places = [plan.layout.index[name] for name in ("bus.v_dc", "source.i")]
    history = []
    for _ in range(n):
        stepped(plan, work, 1)
        history.append(work.sig[places].copy())
    history = np.array(history)
    again = new_workspace(plan)
    for first in range(0, n, chunk):
        stepped(plan, again, min(chunk, n - first))
    for column, steps, rows in ((0, every, again.step.plant_rows), (1, slowly, again.step.slow_rows)):
        blocks = history[:, column].reshape(-1, steps)
        count = len(blocks)
        assert np.array_equal(rows[0, :count, 0], blocks[:, -1])
        assert np.array_equal(rows[1, :count, 0], blocks.min(axis=1))
        assert np.array_equal(rows[2, :count, 0], blocks.max(axis=1))
        assert rows[3, :count, 0] == pytest.approx(blocks.mean(axis=1), rel=1e-12)


def test_the_file_of_a_run_has_means_that_average_to_the_integral(tmp_path):
    """The charge that went into the bus is the mean current times the time, whatever the sampling does."""
    plan = circuit(record=0.33e-3, record_slow=0.7e-3)
    run = Run(plan, new_workspace(plan))
    columns = {g: [(n, plan.network.published[n].unit, n) for n in names] for g, names in plan.groups.items()}
    with ResultsWriter(tmp_path, columns, plan.record_period) as writer:
        run_until(run, None, 10e-3, writer)  # ends between two rows of both groups
    fine = circuit()
    work = new_workspace(fine)
    total = 0.0
    for _ in range(1000):
        stepped(fine, work, 1)
        total += work.sig[fine.layout.index["source.i"]]
    with open_results(tmp_path) as results:
        series = results.series("source.i")
        assert series.low is not None and series.high is not None and series.mean is not None
        assert results["source.i_mean"].attrs["units"] == "A"
        lengths = np.diff(series.time, prepend=0.0)
        assert series.time[-1] == pytest.approx(10e-3)
        assert np.sum(lengths * series.mean) == pytest.approx(total * STEP, rel=1e-6)  # single precision
        assert np.sum(lengths * series.value) != pytest.approx(total * STEP, rel=1e-2)  # as samples they do not tell
        assert np.all((series.low <= series.mean) & (series.mean <= series.high))
