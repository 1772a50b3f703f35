"""Operating points, linear models, modes and responses on circuits with closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.analysis.dead_time import pade
from shipgrid.analysis.modes import Mode, Modes, modes_of
from shipgrid.components.electrical.cable import dc_cable
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.controllers.drive_current import DriveCurrent
from shipgrid.errors import ParameterError, SteadyStateError, TopologyError
from shipgrid.model import component, kernel, signal
from shipgrid.units import Ratio, Volt
from verification.circuits import SourceBranch

R, L, C, G = 0.1, 1e-3, 1e-3, 0.1


def rlc():
    """A source behind R and L on a bus with C and G."""
    net = sg.Network("rlc")
    bus = net.dc_bus("bus", 100.0)
    net.capacitance(bus, C)
    net.conductance(bus, G)
    net.add("source", SourceBranch(R=R, L=L), ports={"ends": bus}, inputs={"e": net.command("source.e", -100.0)})
    return sg.assemble(net, 30e-6)


def test_a_pi_section_with_its_far_end_open_resonates_at_its_half_capacitance():
    cable, C_half = dc_cable(30.0), 0.5 * 0.4e-9 * 30.0
    net = sg.Network("pi section")
    near, far = net.dc_bus("near", 750.0), net.dc_bus("far", 750.0)
    net.capacitance(near, C_half)
    net.capacitance(far, C_half)
    net.add("source", sg.DcSource(v_0=750.0, R=1e-3), a=near)
    net.add("cable", cable, a=near, b=far)
    plan = sg.assemble(net, 30e-6)
    modes = sg.linearise(plan, sg.steady_state(plan, start={})).modes()
    (ringing,) = [mode for mode in modes if mode.eigenvalue.imag]
    assert ringing.frequency == pytest.approx(1.0 / (2.0 * math.pi * math.sqrt(cable.L * C_half)), rel=1e-4)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_pade_quotient_has_unit_gain_and_the_phase_of_the_delay(order):
    delay = 1e-3
    A, b, c, d = pade(delay, order)
    for s in 1j * np.array([0.0, 100.0, 600.0]):
        value = c @ np.linalg.solve(s * np.eye(order) - A, b) + d
        assert abs(value) == pytest.approx(1.0, rel=1e-9)
        if order >= 3:
            assert np.angle(value) == pytest.approx(-s.imag * delay, abs=1e-6)


def test_steady_state_of_a_circuit_is_ohms_law():
    point = sg.steady_state(rlc(), start={})
    assert point["bus.v_dc"] == pytest.approx(100.0 / (1.0 + R * G), rel=1e-12)
    assert point["source.i"] == pytest.approx(-G * point["bus.v_dc"], rel=1e-12)


def test_a_command_is_found_for_a_signal_that_is_held():
    point = sg.steady_state(rlc(), hold={"source.i": -20.0}, free=["source.e"], start={})
    assert point["source.e"] == pytest.approx(-20.0 / G - 20.0 * R, rel=1e-12)
    assert point["source.i"] == pytest.approx(-20.0, rel=1e-12)


def test_as_many_are_held_as_are_free():
    with pytest.raises(SteadyStateError, match="1 signals are held and 0 set free"):
        sg.steady_state(rlc(), hold={"source.i": -20.0}, start={})


def test_a_signal_that_follows_cannot_be_set_free():
    with pytest.raises(SteadyStateError, match=r"'bus\.v_dc' follows from the plant"):
        sg.steady_state(rlc(), hold={"source.i": -20.0}, free=["bus.v_dc"], start={})


def test_an_unknown_signal_is_named_with_its_nearest():
    with pytest.raises(TopologyError, match=r"nearest: 'source\.i'"):
        sg.steady_state(rlc(), hold={"source.ii": -20.0}, free=["source.e"], start={})


def test_modes_of_a_circuit_are_the_roots_of_its_polynomial():
    plan = rlc()
    modes = sg.linearise(plan, sg.steady_state(plan, start={})).modes()
    expected = np.roots([L * C, R * C + L * G, 1.0 + R * G])
    assert np.sort_complex(modes.eigenvalues) == pytest.approx(np.sort_complex(expected), rel=1e-9)
    assert modes[0].participation == pytest.approx({"bus.v_dc": 0.5, "source.i": 0.5}, abs=1e-9)
    assert modes[0].frequency == pytest.approx(abs(expected[0].imag) / (2.0 * math.pi))
    assert modes[0].damping == pytest.approx(-expected[0].real / abs(expected[0]))


def test_impedance_of_a_bus_is_that_of_what_is_on_it():
    plan = rlc()
    f = np.array([1.0, 159.0, 1000.0])
    found = sg.impedance(sg.linearise(plan, sg.steady_state(plan, start={})), "bus", f)
    s = 2j * math.pi * f
    assert found.value == pytest.approx(1.0 / (s * C + G + 1.0 / (R + s * L)), rel=1e-9)


def test_step_response_of_a_circuit_ends_at_the_new_steady_state():
    plan = rlc()
    model = sg.linearise(plan, sg.steady_state(plan, start={}))
    response = model.step("source.e", -1.0, 0.2, ["bus.v_dc"])
    assert response["bus.v_dc"][0] == 0.0
    assert response["bus.v_dc"][-1] == pytest.approx(1.0 / (1.0 + R * G), rel=1e-6)


def test_inductances_that_meet_at_a_node_are_one_state():
    """R-L to R-L in series with nothing else at the node between: one time constant, no eigenvalue at zero."""
    net = sg.Network("series")
    bus, middle = net.dc_bus("bus", 100.0), net.dc_bus("middle", 100.0)
    net.capacitance(bus, 1.0)
    net.conductance(bus, 1e-6)
    net.add("first", RlBranch(R=1.0, L=1e-3), ports={"branch": sg.Across(bus, middle)})
    net.add("second", RlBranch(R=2.0, L=2e-3), ports={"branch": middle})
    plan = sg.assemble(net, 30e-6)
    model = sg.linearise(plan, sg.steady_state(plan, start={"bus.v_dc": 0.0}))
    modes = model.modes()
    # 1 F behind 3 ohm and 3 mH
    assert np.sort(modes.eigenvalues.real) == pytest.approx(np.sort(np.roots([3e-3, 3.0, 1.0]).real), rel=1e-5)
    assert set(modes[-1].participation) == {"first.i", "second.i"}
    # what such a node shows has no state at all: both branches to a stiff end
    z = sg.impedance(model, "middle", [100.0]).value[0]
    s = 2j * math.pi * 100.0
    assert z == pytest.approx(1.0 / (1.0 / (1.0 + s * 1e-3 + 1.0 / s) + 1.0 / (2.0 + s * 2e-3)), rel=1e-4)


def test_loop_gain_needs_an_input():
    plan = rlc()
    model = sg.linearise(plan, sg.steady_state(plan, start={}))
    with pytest.raises(ParameterError, match="is no input of a component"):
        sg.loop_gain(model, "bus.v_dc", [1.0])


def test_loop_gain_of_a_proportional_speed_loop():
    """DriveCurrent aside, a loop by hand: the shaft line's speed loop, K_p + K_i/s over 2 H s and the current's lag."""
    from validation import small_signal_rig as rig

    plan = rig.shaft_line()
    point = sg.steady_state(plan, {"k": 0.0}, start={"shaft.omega_m": 0.3 * 47.1})
    f = np.array([0.05, 0.3, 1.0, 5.0])
    found = sg.loop_gain(sg.linearise(plan, point), "speed.omega_pu", f)
    s = 2j * math.pi * f
    inertia = 383.4 * 47.12389 / 5729.6
    assert found.value == pytest.approx((10.0 + 15.0 / s) / (inertia * s) / (1.0 + s * 1e-3), rel=3e-3)
    phase, _ = sg.loop_gain(sg.linearise(plan, point), "speed.omega_pu", np.geomspace(0.05, 5.0, 400)).margins()
    assert 60.0 < phase < 90.0
    assert DriveCurrent().tau_c == 1e-3


def test_an_unknown_method_and_a_missing_rate_are_refused():
    plan = rlc()
    point = sg.steady_state(plan, start={})
    with pytest.raises(ParameterError, match="method = 'exact'"):
        sg.linearise(plan, point, method="exact")
    with pytest.raises(ParameterError, match="sampled control at one rate"):
        sg.linearise(plan, point, method="sampled")


class ClockState:
    level: Ratio = signal("follows the time's sine")


class ClockOutput:
    e: Volt = signal("source voltage")


@kernel
def clock_derivatives(t, x, dx):
    dx.level = 100.0 * (math.sin(50.0 * t) - x.level)


@kernel
def clock_outputs(t, x, y):
    y.e = -100.0 * x.level


@component(state=ClockState, output=ClockOutput, derivatives=clock_derivatives, outputs=clock_outputs)
class TimedSource:
    """A source that reads the time; its outputs have `t` among their arguments, and do nothing with it."""


def test_a_component_that_reads_the_time_is_refused_by_name():
    net = sg.Network("timed")
    bus = net.dc_bus("bus", 100.0)
    net.capacitance(bus, C)
    net.add("timed", TimedSource())
    net.add("source", SourceBranch(R=R, L=L), ports={"ends": bus}, inputs={"e": "timed.e"})
    with pytest.raises(SteadyStateError, match=r"'timed' \(TimedSource\) reads the time in `derivatives`"):
        sg.steady_state(sg.assemble(net, 30e-6), start={})


def three_phase(**source):
    net = sg.Network("three phases")
    bus = net.ac_bus("bus", 400.0, 60.0)
    net.add("source", sg.ThreePhaseSource(R=0.1, L=1e-3, **source), a=bus)
    net.add("load", sg.Load(p_0=10e3, power_factor=0.9), a=bus)
    return sg.assemble(net, 30e-6)


@pytest.mark.parametrize(
    "start", [{"bus.v_alpha": 326.0, "source.i_alpha": -10.0}, pytest.param(None, marks=pytest.mark.full)]
)
def test_a_balanced_circuit_has_its_operating_point_from_given_values_and_from_a_run(start):
    point = sg.steady_state(three_phase(), start=start)
    impedance = 400.0**2 / 10e3 * 0.9 * complex(0.9, math.sin(math.acos(0.9)))
    divided = abs(impedance / (impedance + 0.1 + 1j * 120.0 * math.pi * 1e-3))
    assert math.hypot(point["bus.v_alpha"], point["bus.v_beta"]) == pytest.approx(326.6 * divided, rel=1e-4)
    assert point.frequency["bus"] == pytest.approx(60.0)


def test_a_modulation_turns_what_hangs_on_its_bridge_by_itself():
    net = sg.Network("inverter on a load")
    dc = net.dc_bus("dc", 750.0)
    net.add("source", sg.DcSource(v_0=750.0, R=1e-6), a=dc)
    net.add("modulation", sg.SineModulation(), inputs={"m": 0.8})
    bridge = sg.Pole3(dc, s_alpha="modulation.s_alpha", s_beta="modulation.s_beta")
    net.add_three_phase("load", RlBranch(R=2.0, L=5e-3), ports={"branch": bridge})
    point = sg.steady_state(sg.assemble(net, 30e-6), start={})
    current = math.hypot(point["load.alpha.i"], point["load.beta.i"])
    assert current == pytest.approx(0.4 * 750.0 / abs(2.0 + 120j * math.pi * 5e-3), rel=1e-6)


@pytest.mark.parametrize("source", [{"r_2": 0.02}, {"r_5": 0.03}, {"r_13": 0.001}])
def test_unbalance_and_harmonics_have_no_operating_point(source):
    # in the turning frame they go on turning: what looks like rest at one instant is none
    with pytest.raises(SteadyStateError, match=r"source\.i_\w+ does not turn evenly with its island"):
        sg.steady_state(three_phase(**source), start={"bus.v_alpha": 326.0, "source.i_alpha": -10.0})


def test_dominant_modes_are_the_slow_and_the_badly_damped_without_twins():
    def mode(eigenvalue, name):
        return Mode(complex(eigenvalue), {name: 1.0})

    modes = Modes(
        tuple(mode(z, str(z)) for z in (-0.1, -0.1000001, -1 + 1j, -1.001 + 1j, -5 + 500j, -50 + 60j, -1000.0, -2000.0))
    )
    assert [m.eigenvalue for m in modes.dominant(3)] == [-0.1, -1 + 1j, -5 + 500j]
    assert modes.stable
    assert not Modes((mode(0.1, "x"),)).stable


def test_participation_counts_both_axes_as_one_and_sums_to_one():
    A = np.array([[-1.0, -10.0], [10.0, -1.0]])
    found = modes_of(A, np.eye(2), np.eye(2), ["lcl.i_1", "lcl.i_1"])
    assert len(found) == 1
    assert found[0].participation == pytest.approx({"lcl.i_1": 1.0})
    assert "lcl.i_1 100 %" in str(found)


def test_figures_name_the_modes(tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    plan = rlc()
    model = sg.linearise(plan, sg.steady_state(plan, start={}))
    axes = model.modes().plot()
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert any(name in labels[0] for name in ("source.i", "bus.v_dc"))
    assert "159 Hz" in labels[0]
    magnitude, phase = sg.impedance(model, "bus", np.geomspace(1.0, 1e3, 50)).plot()
    assert "ohm" in magnitude.get_ylabel()
    assert phase.get_xlabel() == "frequency, Hz"
    matplotlib.pyplot.close("all")
