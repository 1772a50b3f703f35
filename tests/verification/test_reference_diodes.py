"""Blocked legs, by events in the reference solver: against closed forms, and the fast solver against it.

The fast solver has one state of a leg for a whole step and lands a current on zero inside it by its volt-seconds; the
reference puts the end of a step on every change. At ends of steps the two differ by the square of the step, and the
factor depends on where in the steps the changes fall.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.components.converters.two_level_bridge import HalfBridge, TwoLevelBridge
from shipgrid.components.electrical.resistor import Resistor
from shipgrid.components.machines.pmsm import Pmsm
from shipgrid.components.sources.three_phase_source import ThreePhaseSource
from shipgrid.errors import SolverError
from shipgrid.io.scenario_file import load_scenario
from shipgrid.io.ship_file import load_ship
from shipgrid.model.network import Network
from shipgrid.model.placed import Every, Sampled
from shipgrid.modulators.open_loop import SineModulation
from shipgrid.modulators.time_stamped import Carrier, TimeStampedBridge
from shipgrid.scenarios.against_reference import against_reference
from shipgrid.solvers.reference import reference_run
from validation.test_forming import Side
from verification.circuits import Gates, LegGates, SourceBranch, Toggle
from verification.gallery import example
from verification.test_conduction import LOWER, MEAN, OMEGA, UPPER, one_switch, six_pulse
from verification.test_reference import difference

RTOL = 1e-7
"""Of the reference where it is the truth: a hundredth of the differences below."""


def start(net, step, **values):
    """Plan and workspace from these initial values."""
    plan = assemble(net, step)
    work = new_workspace(plan)
    for path, value in values.items():
        work.sig[plan.layout.index[path]] = value
    settle_outputs(plan, work)
    return plan, work


def forward(plan, work, seconds):
    """On by the fast solver."""
    steps = round(seconds / plan.h)
    assert core()(steps, work.n, *arguments(plan, work)) == steps
    work.n += steps
    work.step.rows[:] = 0
    return plan, work


def orders(errors):
    """Order of each difference from one step to half of it."""
    return np.array([np.log2(np.array(list(a.values())) / np.array(list(b.values()))) for a, b in pairwise(errors)])


# --- the reference by itself ------------------------------------------------------------------------------------------


def test_a_current_lands_on_zero_when_the_closed_form_says_and_stays_there():
    """Battery, choke, upper diode, capacitor: half a period of the resonance."""
    E, R, L, C = 474.0, 0.05, 0.8e-3, 10e-3
    net = Network("leg")
    bus = net.dc_bus("bus", 750.0)
    net.capacitance(bus, C)
    net.add("gates", LegGates())
    pole = net.half_bridge("leg", HalfBridge(), bus, modulator="gates")
    net.add("choke", SourceBranch(R=R, L=L), ports={"ends": pole}, inputs={"e": -E})
    found = reference_run(*start(net, 30e-6), 12e-3, ["bus.v_dc", "choke.i"])
    a = R / (2.0 * L)
    w = math.sqrt(1.0 / (L * C) - a**2)
    t = np.minimum(found.time, math.pi / w)
    v = E * (1.0 - np.exp(-a * t) * (np.cos(w * t) + a / w * np.sin(w * t)))
    i = -E / (w * L) * np.exp(-a * t) * np.sin(w * t)
    assert np.abs(found["bus.v_dc"] - v).max() < 1e-6 * E  # a hundred times the tolerance
    assert np.abs(found["choke.i"] - i).max() < 1e-6 * np.abs(i).max()
    assert np.abs(found["choke.i"][found.time > math.pi / w]).max() < 1e-15


def test_the_mean_of_a_loaded_diode_bridge_is_that_of_the_commutation_formula():
    """On a smoothed current I the mean is 648 V - 3/pi omega L I; the bus has no capacitor, legs overlap."""
    L, current = 0.3e-3, 60.0
    ohms = (MEAN - 3.0 / math.pi * OMEGA * L * current) / current
    plan, work = forward(*six_pulse(10e-6, L=L, load=(ohms, 40.0 * ohms / 1000.0)), 0.25)
    period = 1.0 / 360.0
    found = reference_run(plan, work, work.n * plan.h + period, ["bus.v_dc", "load.i"], rtol=RTOL)
    mean = np.trapezoid(found["bus.v_dc"], found.time) / (found.time[-1] - found.time[0])
    i = found["load.i"].mean()
    assert np.ptp(found["load.i"]) < 0.02 * i  # smoothed, as the formula has it
    expected = MEAN - 3.0 / math.pi * OMEGA * L * i
    assert mean == pytest.approx(expected, rel=2e-3)  # the load's ripple


def test_a_short_circuited_bus_freewheels_through_the_diodes():
    """models.md 10: the bus reverses at 0.757 ms; then 13.88 kA decay in cable and diodes."""
    R, L, C, R_d = 10e-3, 20e-6, 10e-3, 2e-3
    net = Network("short circuit")
    bus = net.dc_bus("bus", 750.0)
    net.capacitance(bus, C)
    net.add("gates", Gates())
    poles = net.bridge("bridge", TwoLevelBridge(R_d=R_d), bus, modulator="gates")
    net.add_three_phase("choke", SourceBranch(R=0.1, L=1e-3), ports={"ends": poles})
    net.add("fault", SourceBranch(R=R, L=L), ports={"ends": bus})
    plan, work = start(net, 10e-6, **{"bus.v_dc": 750.0})
    found = reference_run(plan, work, 2e-3, ["fault.i", "bus.v_dc", "choke.alpha.i"])
    a = R / (2.0 * L)
    w = math.sqrt(1.0 / (L * C) - a**2)
    reversal = (math.pi - math.atan2(w, a)) / w
    assert reversal == pytest.approx(0.757e-3, abs=0.5e-6)
    before = found.time < reversal
    t = found.time[before]
    i = 750.0 / (w * L) * np.exp(-a * t) * np.sin(w * t)
    assert np.abs(found["fault.i"][before] - i).max() < 1e-5 * 14.23e3  # the bus: 1000 times the tolerance of 10 V
    # a loop of two time constants, of the fault and of the capacitor behind the diodes: C v' = -v/r - i, L i' = v - R i
    r = 2.0 / 3.0 * R_d
    A = np.array([[-1.0 / (r * C), -1.0 / C], [1.0 / L, -R / L]])
    values, vectors = np.linalg.eig(A)
    at = 750.0 / (w * L) * math.exp(-a * reversal) * math.sin(w * reversal)
    weights = np.linalg.solve(vectors, [0.0, at])
    v, i = np.real(vectors @ (weights[:, None] * np.exp(np.outer(values, found.time[~before] - reversal))))
    assert np.abs(found["fault.i"][~before] - i).max() < 1e-5 * at
    assert np.abs(found["bus.v_dc"][~before] - v).max() < 1e-4 * np.abs(v).max()
    assert np.all(found["choke.alpha.i"] == 0.0)


def test_an_open_leg_at_a_resistance_is_refused():
    net = Network("resistor")
    bus = net.dc_bus("bus", 750.0)
    net.capacitance(bus, 1e-3)
    net.add("gates", LegGates())
    net.add("load", Resistor(R=10.0), a=net.half_bridge("leg", HalfBridge(), bus, modulator="gates"))
    plan = assemble(net, 30e-6)
    with pytest.raises(SolverError, match="leg is blocked, and its poles feed a resistance"):
        reference_run(plan, new_workspace(plan), 1e-3)


# --- the fast solver against it ---------------------------------------------------------------------------------------


def test_a_diode_rectifier_with_a_capacitor_agrees_with_order_two():
    names = ["dc.v_dc", "grid.i_alpha", "grid.i_beta"]
    found = []
    for step in (80e-6, 10e-6):  # far apart: where in a step a commutation falls is part of the error
        plan, work = start(example("diode_rectifier").circuit(), step, **{"dc.v_dc": 620.0})
        found.append(difference(plan, work, 6e-3, names, rtol=RTOL))
    assert orders(found).mean() / 3.0 > 1.6  # three halvings
    assert max(found[1].values()) < 3e-5


@pytest.mark.parametrize(("gates", "duty", "bus"), [(LOWER, 0.9, "dc.v_dc"), (UPPER, 0.1, "low.v_dc")])
def test_one_driven_switch_in_discontinuous_conduction_agrees_with_order_two(gates, duty, bus):
    """Pulses of 20 us in a period of 200 us, and a current that rests in between."""
    found = []
    for step in (30e-6, 10e-6, 3e-6):
        plan, work = forward(*one_switch(gates, duty, 300.0, step), 5e-3)
        found.append(difference(plan, work, 2e-3, [bus, "choke.i"], rtol=RTOL))
    coarse, middle, fine = (np.array(list(f.values())) for f in found)
    assert np.all(coarse < 7e-3)  # a pulse has two thirds of the step
    assert np.all(middle < coarse / 8.0) and np.all(fine < coarse / 50.0)  # 9 and 100; and where in a step the pulse is


def in_turn(step, v_dc):
    """A bridge between a grid and a loaded bus that is blocked and switches in turn, every 3.96 ms."""
    net = Network("in turn", "switching")
    bus = net.dc_bus("bus", 750.0)
    net.capacitance(bus, 2e-3)
    net.conductance(bus, 0.05)
    net.add("toggle", Toggle(), clock=Every(3.96e-3))
    net.add("carrier", Carrier(), clock=Sampled(1620.0))
    net.add("wave", SineModulation(f_n=60.0, phase=0.3), inputs={"m": 0.95}, clock=Sampled(3240.0))
    inputs = {f"s_{axis}_ref": f"wave.s_{axis}" for axis in ("alpha", "beta")} | {"gates": "toggle.s"}
    inputs |= {name: f"carrier.{name}" for name in ("phase", "phase_next", "turns")}
    net.add("modulator", TimeStampedBridge(), inputs=inputs, clock=Sampled(3240.0))
    poles = net.bridge("bridge", TwoLevelBridge(), bus, modulator="modulator")
    net.add("grid", ThreePhaseSource(v_n=400.0, f_n=60.0, R=0.05, L=2e-3), a=poles)
    return start(net, step, **{"bus.v_dc": v_dc})


@pytest.mark.parametrize(
    ("v_dc", "order", "bound"), [(650.0, 1.5, 3e-4), pytest.param(600.0, 1.0, 2e-3, marks=pytest.mark.full)]
)
def test_a_bridge_that_is_blocked_and_released_under_current_agrees(v_dc, order, bound):
    """From 600 V a current goes at once from one diode of its leg to the other: landed, it misses the rest of one."""
    names = ["bus.v_dc", "grid.i_alpha", "grid.i_beta"]
    found = [difference(*in_turn(step, v_dc), 11e-3, names, rtol=RTOL) for step in (30e-6, 15e-6)]
    assert orders(found).mean() > order
    assert max(found[0].values()) < bound


def test_a_turning_motor_behind_a_blocked_bridge_feeds_the_bus_with_order_two():
    """449 V line-to-line at 450 rpm, on a loaded bus that it holds below its peak."""
    names = ["bus.v_dc", "motor.i_d", "motor.i_q", "motor.tau_e"]
    found = []
    for step in (60e-6, 30e-6):
        net = Network("windmilling motor")
        bus = net.dc_bus("bus", 750.0)
        net.capacitance(bus, 5e-3)
        net.conductance(bus, 0.02)
        net.add("gates", Gates())
        poles = net.bridge("bridge", TwoLevelBridge(), bus, modulator="gates")
        net.add_three_phase("motor", Pmsm(), ports={"stator": poles}, inputs={"omega_m": 2.0 * math.pi * 7.5})
        found.append(difference(*start(net, step, **{"bus.v_dc": 600.0}), 12e-3, names, rtol=RTOL))
    assert np.all(orders(found) > 1.5)
    assert max(found[-1].values()) < 2e-4


@pytest.mark.parametrize(("step", "bound"), [(30e-6, 2e-3), (3e-6, 2e-5)])
def test_a_motor_that_feeds_a_short_circuit_agrees(step, bound):
    """The bus reverses, and the motor goes on through the diodes; the error depends on where in a step that happens."""
    case = example("short_circuit")
    plan, work = start(case.circuit(), step, **{"dc.v_dc": case.CASE["v_dc_0"], "command:fault.close": 1.0})
    found = difference(plan, work, 1.2e-3, ["fault.i", "motor.i_alpha", "motor.i_beta"], rtol=RTOL)
    assert max(found.values()) < bound, found


def test_a_battery_that_forms_the_bus_agrees():
    """Boost and buck, at rest in pulses and under load, its control in the loop; 30 us, 2 ms of each."""
    side = Side("switching")
    for amperes in (0.0, 40.0, -20.0):
        side.command(load=amperes).run(0.1)
        found = difference(side.plan, side.work, 2e-3, ["dc.v_dc", "bess.converter.i_l"], rtol=RTOL)
        assert found["dc.v_dc"] < 1e-5, amperes
        bound = 1e-2 if amperes == 0.0 else 2e-3  # pulses of 20 us, and the sample of their mean in the control
        assert found["bess.converter.i_l"] < bound, amperes


FORMING = """
schema: 1
scenario: forming
description: one battery forms the voltage, the other is off, and so is a drive
duration: 3 s
start: {state: moored, closed: [dc_tie], set: {propulsion_aft.on: false, bess_for.i_ref: 0 A, bess_aft.i_ref: 0 A}}
timeline:
  - {at: 0.1 s, set: {bess_for.on: false}}
  - {at: 0.8 s, set: {bess_aft.mode: voltage}}
"""


def test_the_ferry_with_blocked_legs_agrees_signal_by_signal(tmp_path):
    path = tmp_path / "forming.yaml"
    path.write_text(FORMING)
    found = against_reference(load_ship("ferry"), load_scenario(path), (2.5, 2.501), fidelity="switching")
    by_name = {d.signal: d for d in found}
    assert by_name["bess_aft.i_b"].size > 20.0 and by_name["bess_aft.i_b"].relative < 2e-3
    assert by_name["dc_aft.v_dc"].relative < 1e-5 and by_name["dc_for.v_dc"].relative < 1e-5
    assert by_name["propulsion_aft.i_a"].largest == 0.0  # its blocked bridge lets nothing through
    for d in found:  # the tie rings at 575 Hz; the rest samples inside steps
        assert d.relative < (1e-2 if d.signal == "dc_tie.i" else 3e-3), d


CHARGING = """
schema: 1
scenario: charging
description: a genset charges the dead ship
duration: 9 s
start: {state: cold, closed: [dc_tie]}
timeline: [{at: 0.1 s, set: {genset_for.on: true}}]
"""


@pytest.mark.full
@pytest.mark.parametrize("window", [(7.62, 7.623), (7.86, 7.863)])
def test_the_dead_ferry_on_the_diodes_of_a_rectifier_agrees_signal_by_signal(window, tmp_path):
    """First through the resistors, then through the diodes alone."""
    path = tmp_path / "charging.yaml"
    path.write_text(CHARGING)
    found = against_reference(load_ship("ferry"), load_scenario(path), window, fidelity="switching")
    by_name = {d.signal: d for d in found}
    assert by_name["rectifier_for.i_a"].size > 20.0
    assert 200.0 < by_name["dc_for.v_dc"].size < 670.0
    for d in found:  # governor and exciter hold their inputs for half a millisecond
        assert d.relative < 1e-3, d
