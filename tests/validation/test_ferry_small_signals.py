"""Small signals of the whole ferry, moored and with a genset loaded: modes, a step, the impedance of its DC bus."""

from __future__ import annotations

import math

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.analysis.settling import advance, advancing, run_to_rest
from shipgrid.assembly.code_store import core
from shipgrid.assembly.tables import arguments
from shipgrid.scenarios.case import build

H = 90e-6


@pytest.fixture(scope="module")
def moored():
    ship = sg.load_ship("ferry")
    plan = build(ship, H)
    work, _ = run_to_rest(plan, sg.load_scenario("mission").start_commands(ship))
    return plan, work, sg.steady_state(plan, start=work)


@pytest.fixture(scope="module")
def loaded(moored):
    """Genset fore started and loaded by the droop; Newton's method spares the minute of the reactive power loop."""
    plan, work, _ = moored
    work = work.snapshot()
    work.sig[plan.layout.index["command:genset_for.on"]] = 1.0
    advance(plan, work, 25.0)
    point = sg.steady_state(plan, start=work)
    return plan, point, sg.linearise(plan, point)


def test_moored_ferry_rests_where_the_run_came_to_rest(moored):
    plan, work, point = moored
    for name in ("dc_for.v_dc", "bess_for.control.i_star", "inverter_for.control.p"):
        assert point[name] == pytest.approx(work.sig[plan.layout.index[name]], rel=2e-3), name  # a sawtooth
    assert point.frequency["ac_for"] == pytest.approx(60.0 * (1.0 - 0.02 * point["inverter_for.control.p"]), abs=1e-6)


def test_modes_of_the_moored_ferry_are_those_of_its_parts(moored):
    plan, _, point = moored
    modes = sg.linearise(plan, point).modes()
    assert modes.stable
    # two inverters apart on 10 kW of R-L each, as the table of the design has them
    assert len([m for m in modes if abs(m.eigenvalue.real + 16.4) < 0.1 and "i_g_slow" in m.states[0]]) == 2
    # both shaft lines at standstill, without damping by the water
    for line in ("propulsion_for", "propulsion_aft"):
        shaft = modes.of(f"{line}.shaft.omega_m")[0]
        assert abs(shaft.eigenvalue - (-1.59 + 1.50j)) < 0.02 * abs(shaft.eigenvalue)
    # the tie between 17 mF on either side
    network = plan.network
    tie, capacitance = network.placed["dc_tie.branch"].item, network.capacitances["dc_for.v_dc"]
    swing = modes.of("dc_tie.branch.i")[0]
    assert swing.frequency == pytest.approx(math.sqrt(2.0 / (tie.L * capacitance)) / (2.0 * math.pi), rel=0.02)
    assert set(swing.participation) >= {"dc_tie.branch.i", "dc_for.v_dc", "dc_aft.v_dc"}


@pytest.fixture(scope="module")
def one_drive(moored):
    """2.5 m/s on the drive fore; the one aft is off, its screw turned by the water."""
    plan, work, _ = moored
    work = work.snapshot()
    work.sig[plan.layout.index["command:propulsion_aft.on"]] = 0.0
    for side in ("for", "aft"):
        work.sig[plan.layout.index[f"command:propulsion_{side}.speed_ref"]] = 2.5
    advance(plan, work, 120.0)
    return plan, work, sg.steady_state(plan, start=work)


def test_a_drive_that_is_off_takes_no_current_and_its_screw_idles(one_drive):
    plan, work, point = one_drive
    for name in ("motor.i_q", "motor.i_d", "motor.tau_e", "bridge.p_dc"):
        assert point[f"propulsion_aft.{name}"] == pytest.approx(0.0, abs=1e-9), name
    omega_m = "propulsion_aft.shaft.omega_m"
    assert 8.5 < point[omega_m] < 10.0  # by the water alone; stopped if its bridge were a short circuit
    assert point[omega_m] == pytest.approx(work.sig[plan.layout.index[omega_m]], rel=2e-2)  # the ship gathers way still
    assert point["hull.surge.u_ship"] == pytest.approx(2.5, rel=5e-3)
    modes = sg.linearise(plan, point).modes()
    shaft = modes.of(omega_m)[0]  # the water holds it at its speed: slower than driven, and damped
    assert shaft.eigenvalue.real < 0.0


def test_a_run_started_with_a_drive_off_stays_where_the_point_is(one_drive):
    plan, _, point = one_drive
    after = point.workspace()
    advance(plan, after, 0.5)
    for name in ("propulsion_aft.shaft.omega_m", "propulsion_for.shaft.omega_m", "hull.surge.u_ship"):
        assert after.sig[plan.layout.index[name]] == pytest.approx(point[name], rel=1e-4), name
    assert abs(after.sig[plan.layout.index["propulsion_aft.motor.tau_e"]]) < 1e-9


def test_modes_with_a_genset_loaded_are_those_of_its_loops(loaded):
    _, point, model = loaded
    modes = model.modes()
    assert modes.stable
    assert point["rectifier_for.control.p_dc"] > 15e3
    assert point.frequency["genset_for.terminals"] == pytest.approx(60.0 * point["genset_for.machine.omega"], rel=1e-9)
    speed = modes.nearest(-17.73 + 43.5j)  # governor, dead time, rotor: load moves them by less than 2 %
    assert abs(speed.eigenvalue - (-17.73 + 43.5j)) < 0.02 * abs(speed.eigenvalue)
    assert any(name.startswith("genset_for.governor") or name == "genset_for.machine.omega" for name in speed.states)
    pll = modes.of("rectifier_for.control.pll.omega")[0]
    assert abs(pll.eigenvalue) == pytest.approx(2.0 * math.pi * 20.0, rel=0.03)  # its 20 Hz, zeta 0.707
    assert pll.damping == pytest.approx(0.707, abs=0.02)
    voltage = modes.of("genset_for.exciter.v_e")[0]
    assert 0.2 < voltage.damping < 0.5


def test_a_run_started_at_the_point_stays_there(loaded):
    plan, point, _ = loaded
    work = point.workspace()
    advance(plan, work, 0.5)
    for name in ("dc_for.v_dc", "genset_for.machine.omega", "genset_for.machine.psi_f", "genset_for.governor.throttle",
                 "genset_for.exciter.v_a", "rectifier_for.control.dc.pi.i", "bess_for.control.i_star"):  # fmt: skip
        assert work.sig[plan.layout.index[name]] == pytest.approx(point[name], rel=1e-2), name  # a gain of 600


def test_a_step_of_the_speed_reference_goes_as_linear_theory_says(loaded):
    """0.2 %: what its ramp lets through in one tick of the sequence, so that the ramp does not show.

    The sequence ticks at the instant of the step; linear theory has it wait half a period of 10 ms, as on the mean.
    """
    plan, point, model = loaded
    signals = ["genset_for.machine.omega", "genset_for.governor.throttle", "genset_for.governor.a_2"]
    every, runs = 100, []
    for extra in (0.0, 0.002):
        work = point.workspace()
        work.sig[plan.layout.index["command:genset_for.speed_ref"]] += extra
        places = [plan.layout.index[name] for name in signals]
        on, rows = advancing(plan, work), [work.sig[places].copy()]
        for _ in range(round(2.0 / H / every)):
            on(every * H)
            rows.append(work.sig[places].copy())
        runs.append(np.array(rows))
    found = runs[1] - runs[0]
    t = every * H * np.arange(len(found))
    predicted = model.step("genset_for.speed_ref", 0.002, t[-1] + 0.005, signals, n=2001)
    for k, name in enumerate(signals):
        size = np.abs(predicted[name]).max()
        expected = np.interp(t + 0.005, predicted.time, predicted[name])
        later = t > 0.06  # until then the shape of the tick shows in the throttle, 3 %
        assert np.abs(found[:, k] - expected)[later].max() < 0.02 * size, name


@pytest.mark.parametrize("frequency", [10.0, 50.0, 150.0])
def test_impedance_of_the_dc_bus_is_what_a_small_current_finds(loaded, frequency):
    """A sinusoidal current of 1 A into the bus, as charge at every step; the answer by correlation."""
    plan, point, model = loaded
    steps = round(1.0 / frequency / H)
    omega = 2.0 * math.pi / (steps * H)  # a whole number of steps a period
    v, capacitance = plan.layout.index["dc_for.v_dc"], plan.network.capacitances["dc_for.v_dc"]
    settle, count = round(0.3 / (steps * H)), max(3, round(0.1 / (steps * H)))
    entry, runs = core(), []
    for amplitude in (0.0, 1.0):
        work, trace = point.workspace(), []
        values = arguments(plan, work)
        for k in range((settle + count) * steps):
            charge = amplitude * math.cos(omega * k * H) * H / capacitance
            trace.append(work.sig[v] + 0.5 * charge)  # in the middle of the jump
            work.sig[v] += charge
            assert entry(1, k, *values) > 0
            work.step.rows[:] = 0
            work.step.event_count[0] = 0
        runs.append(np.array(trace[settle * steps :]))
    t = H * (settle * steps + np.arange(count * steps))
    found = 2.0 * np.mean((runs[1] - runs[0]) * np.exp(-1j * omega * t))
    predicted = sg.impedance(model, "dc_for", [omega / (2.0 * math.pi)]).value[0]
    assert abs(found - predicted) < 0.02 * abs(predicted)
