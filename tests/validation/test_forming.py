"""A battery that forms the bus by itself, boost and buck in turn: every switch, and averaged beside it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.components.sources.dc_source import CurrentSource
from shipgrid.equipment.bess import Bess
from shipgrid.model.network import Network

DROOP, VOLTAGE, CURRENT = 1.0, 2.0, 3.0
BLOCKED, BOTH, LOWER, UPPER = 0.0, 1.0, 2.0, 3.0
TURN = 20
"""Steps of 30 us in three switching periods."""
NAMES = {
    "v_dc": "dc.v_dc",
    "i_l": "bess.converter.i_l",
    "i_star": "bess.control.i_star",
    "boost": "bess.control.boost",
    "gates": "bess.modulator.gates",
    "i_fed": "bess.leg.i_fed",
}


class Side:
    """A battery system, 17 mF and a current drawn from the bus."""

    def __init__(self, fidelity, **commands):
        net = Network("side", fidelity)
        dc = net.dc_bus("dc", 750.0)
        net.capacitance(dc, 17e-3)
        net.conductance(dc, 1.0 / 5e3)
        net.add("load", CurrentSource(i_0=-1.0), a=dc, inputs={"i_pu": net.command("load")})
        Bess(bus="dc").build(net, "bess", SimpleNamespace(bus=net.bus))
        self.plan = assemble(net, 30e-6)
        self.work = new_workspace(self.plan)
        self.work.sig[self.plan.layout.index["dc.v_dc"]] = 750.0
        self.entry, self.values = core(), arguments(self.plan, self.work)
        self.command(load=0.0, **{"bess.on": 1.0, "bess.mode": VOLTAGE, "bess.v_dc_ref": 750.0} | commands)
        self.run(0.6)

    def command(self, **values):
        for name, value in values.items():
            self.work.sig[self.plan.layout.index[self.plan.network.command(name)]] = value
        return self

    def run(self, seconds):
        """Values after every step, over a whole number of switching periods."""
        places = [self.plan.layout.index[name] for name in NAMES.values()]
        rows = np.empty((round(seconds / 600e-6) * TURN, len(places)))
        for k in range(len(rows)):
            assert self.entry(1, self.work.n, *self.values) == 1
            self.work.n += 1
            self.work.step.rows[:] = 0
            rows[k] = self.work.sig[places]
        return SimpleNamespace(**dict(zip(NAMES, rows.T, strict=True)))


def periods(values):
    """Means over switching periods, three at a time."""
    return values.reshape(-1, TURN).mean(axis=1)


@pytest.fixture(scope="module")
def loads():
    """Both fidelities through the same steps of the load: rest, boost, buck, both in discontinuous conduction too."""
    steps = (0.0, 5.0, 40.0, -20.0, -5.0, 13.3)
    found = {}
    for fidelity in ("switching", "averaged"):
        side = Side(fidelity)
        found[fidelity] = [side.command(load=amperes).run(0.4) for amperes in steps]
    return dict(zip(steps, zip(*found.values(), strict=True), strict=True))


def last(values):
    return values[-TURN * 40 :]


def test_the_bus_stays_at_its_reference_under_load_in_both_directions(loads):
    for amperes, (run, _) in loads.items():
        assert abs(last(run.v_dc) - 750.0).max() < 3.0, amperes  # 40 A: what its integrator has still to do after 0.4 s
        assert run.v_dc.min() > 720.0 and run.v_dc.max() < 780.0, amperes
        assert last(run.i_fed).mean() == pytest.approx(amperes + 750.0 / 5e3, abs=0.7)  # 17 mF still charge


def test_only_one_switch_works_and_no_current_flows_through_the_other(loads):
    for amperes, (run, _) in loads.items():
        boosting = run.gates == LOWER
        assert np.all(boosting | (run.gates == UPPER)), amperes
        settled = np.arange(len(run.gates)) > TURN  # the diodes have let go of what the other branch left
        turned = np.flatnonzero(np.diff(run.gates)) + 1
        for k in turned:
            settled[k : k + TURN] = False
        assert run.i_l[boosting & settled].min(initial=0.0) >= -1e-9, amperes
        assert run.i_l[~boosting & settled].max(initial=0.0) <= 1e-9, amperes
        assert np.ptp(last(run.i_l)) > 2.0, amperes  # and it does switch: pulses of 2.5 A at rest


def test_the_branch_changes_once_when_the_load_does(loads):
    for amperes, (run, _) in loads.items():
        assert np.count_nonzero(np.diff(run.gates)) <= 1, amperes
        assert last(run.boost).mean() == (1.0 if amperes >= 0.0 else 0.0), amperes


def test_the_reference_is_the_mean_current_in_continuous_and_discontinuous_conduction(loads):
    for amperes, (run, _) in loads.items():
        i = last(run.i_l)
        assert i.mean() == pytest.approx(last(run.i_star).mean(), rel=0.035, abs=0.01), amperes  # (6) leaves out R
    at_rest = {amperes: np.mean(np.abs(last(run.i_l)) < 1e-9) for amperes, (run, _) in loads.items()}
    assert at_rest[0.0] > 0.8 and at_rest[5.0] > 0.2 and at_rest[-5.0] > 0.2 and at_rest[40.0] == 0.0


def test_voltages_and_currents_are_those_of_the_averaged_converter(loads):
    for amperes, (run, averaged) in loads.items():
        assert last(run.v_dc).mean() == pytest.approx(last(averaged.v_dc).mean(), rel=1e-4), amperes
        assert last(run.i_l).mean() == pytest.approx(last(averaged.i_l).mean(), rel=0.01), amperes
        assert run.v_dc.min() == pytest.approx(averaged.v_dc.min(), abs=0.6), amperes  # a ripple of 0.6 V
        assert run.v_dc.max() == pytest.approx(averaged.v_dc.max(), abs=0.6), amperes
        assert np.all(averaged.gates == BOTH)


@pytest.mark.parametrize("load", [30.0, 3.0, -20.0])
def test_handing_over_between_the_modes_bumps_neither_bus_nor_current(load):
    """3 A: the current of both switches goes to and fro, that of one comes to rest, and the mean stays."""
    side = Side("switching", **{"bess.mode": DROOP}).command(load=load)
    side.run(0.6)
    for mode, gates in ((VOLTAGE, UPPER if load < 0.0 else LOWER), (DROOP, BOTH), (VOLTAGE, None), (DROOP, BOTH)):
        before = side.run(0.012)
        after = side.command(**{"bess.mode": mode}).run(0.012)
        moved = np.abs(periods(after.i_l) - before.i_l.mean())
        # a reference moves on by its ramp or integrator, 250 A/s; where the current was at rest, both switches begin
        # their ripple of 43 A there and not at its mean
        assert np.all(moved < 0.5 + 0.25 * np.arange(len(moved)) + (2.0 if load == 3.0 and mode == DROOP else 0.0))
        assert np.abs(periods(after.v_dc) - periods(before.v_dc)[-1]).max() < 0.7  # 3 A for half of 12 ms on 17 mF
        assert gates is None or after.gates[-1] == gates
        side.run(0.1)
