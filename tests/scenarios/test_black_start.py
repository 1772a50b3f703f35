"""The ferry from dead: everything off, the buses without voltage, one source called."""

from __future__ import annotations

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.assembly.code_store import core
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.equipment import bess, rectifier
from shipgrid.scenarios.case import build

DIODES = 1.35 * 480.0


def called(name: str, until: float, signals: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Every millisecond of a dead ship in which one source is told to start, all other commands at their defaults."""
    plan = build(sg.load_ship("ferry"), 90e-6)
    work, index = new_workspace(plan), plan.layout.index
    for path, command in sg.load_ship("ferry").commands.items():
        work.sig[index[f"command:{path}"]] = command.default
    work.sig[[index["command:dc_tie.close"], index[f"command:{name}.on"]]] = 1.0
    settle_outputs(plan, work)
    entry, values, n = core(), arguments(plan, work), 11
    rows = []
    for _ in range(round(until / (n * plan.h))):
        assert entry(n, work.n, *values) == n
        work.n += n
        work.step.rows[:] = 0
        rows.append([work.sig[index[s]] for s in signals])
    time = n * plan.h * np.arange(1, len(rows) + 1)
    return {"t": time, **dict(zip(signals, np.array(rows).T, strict=True))}


def test_a_genset_charges_the_dead_ship_through_its_rectifier_s_diodes():
    state, bus, current = "rectifier_for.sequence.state", "dc_for.v_dc", "rectifier_for.lcl.alpha.i_2"
    run = called("genset_for", 16.0, (state, bus, "dc_aft.v_dc", current))
    seen = [int(s) for s, before in zip(run[state], [-1.0, *run[state][:-1]], strict=True) if s != before]
    assert seen == [rectifier.OFF, rectifier.PRECHARGING, rectifier.SYNCHRONISING, rectifier.CONNECTED]
    charging = run[state] == rectifier.PRECHARGING
    assert run[bus][: int(np.argmax(charging))].max() < 1.0  # dead until then
    assert 0.1 < np.ptp(run["t"][charging]) < 1.0  # 34 mF behind 1.5 ohm a phase
    assert run[bus][charging][-1] == pytest.approx(0.9 * DIODES, rel=0.02)
    assert np.all(np.diff(run[bus][charging]) > -0.5)
    # at first two phases in series with their resistors and filters: 679 V over 3 ohm, less what the filter takes
    assert 100.0 < np.abs(run[current][charging]).max() < 679.0 / 3.0 * 1.1
    diodes = run[state] == rectifier.SYNCHRONISING
    assert DIODES < run[bus][diodes][-1] < 1.05 * np.sqrt(2.0) * 480.0  # hardly loaded: towards the line peak
    assert run[bus][-1] == pytest.approx(750.0, abs=2.0)
    assert run["dc_aft.v_dc"][-1] == pytest.approx(750.0, abs=2.0)  # the tie takes both sides along


def test_a_battery_charges_the_dead_ship_through_its_resistor_and_raises_it():
    state, bus, current = "bess_for.sequence.state", "dc_for.v_dc", "bess_for.converter.i_l"
    run = called("bess_for", 12.0, (state, bus, current))
    seen = [s for s, before in zip(run[state], [-1.0, *run[state][:-1]], strict=True) if s != before]
    assert seen == [bess.PRECHARGE, bess.CONNECT, bess.RAMP_IN, bess.ON]
    charging = run[state] == bess.PRECHARGE
    assert np.abs(run[current][charging]).max() == pytest.approx(474.0 / 20.3, rel=0.03)
    assert run[current][charging].min() > -1e-6  # the diode lets nothing back
    assert run[bus][charging][-1] == pytest.approx(0.97 * 474.0, rel=0.01)
    assert run[current].max() < 192.0
    assert run[bus][-1] == pytest.approx(750.0, abs=3.0)
