"""Eigenvalues of the design's figures, by the linearisation that any plant gets; and linear against nonlinear runs.

The plants are networks of the real components with their real kernels (`small_signal_rig`); nothing here writes an
equation of theirs down again.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from validation import small_signal_rig as rig

from shipgrid.analysis.equilibrium import steady_state
from shipgrid.analysis.linearise import linearise
from shipgrid.controllers.rectifier_control import RectifierControl


def near(modes, expected, within=0.02):
    """Whether each expected eigenvalue has one within 2 % of its magnitude."""
    found = modes.eigenvalues
    missing = {z: found[np.argmin(np.abs(found - z))] for z in expected if np.abs(found - z).min() > within * abs(z)}
    assert not missing, missing


# the genset


def test_generator_on_a_stiff_bus_has_the_published_eigenvalues():
    plan = rig.machine_on_stiff_bus()
    point = steady_state(
        plan,
        hold={"machine.p_ac": 0.5 * 596e3, "machine.q_ac": 0.0},
        free=["E_fd", "T_m"],
        start={"machine.omega": 1.0, "machine.theta": math.radians(34.8 - 90.0), "machine.psi_f": 1.1,
               "machine.psi_d": 0.8, "machine.psi_q": -0.5, "machine.psi_kd": 0.9, "machine.psi_kq": -0.5,
               "bus.v_alpha": 391.9},
    )  # fmt: skip
    assert (point["E_fd"], point["T_m"]) == pytest.approx((1.511, 0.503), abs=5e-4)
    assert point.frequency["bus"] == pytest.approx(60.0, abs=1e-9)
    modes = linearise(plan, point).modes()
    near(modes, [-33.0 + 370.3j, -131.2, -21.66 + 61.08j, -70.0, -0.965])
    # seven of the machine, its angle counted from the bus's; the source's branch is far to the left
    assert len([z for z in modes.eigenvalues if z.real > -500.0]) == 7
    swing = modes.nearest(-21.66 + 61.08j)
    assert set(swing.states[:2]) == {"machine.omega", "machine.theta"}


def test_speed_loop_of_the_unloaded_genset_is_that_of_governor_dead_time_and_rotor():
    plan = rig.genset()
    point = steady_state(plan, start=rig.GENSET_START)
    modes = linearise(plan, point).modes()
    near(modes, [-2.66 + 2.37j, -17.73 + 43.5j, -43.0 + 84.7j])
    assert "governor.throttle" in modes.nearest(-2.66 + 2.37j).participation


@pytest.mark.parametrize(
    ("T_d01", "expected"), [(3.5, [-4.49 + 16.1j, -1.07, -15.2, -47.4]), (2.0, [-0.77 + 17.9j]), (1.0, [3.2 + 21.2j])]
)
def test_voltage_loop_on_the_field_alone_has_the_published_eigenvalues(T_d01, expected):
    plan = rig.exciter_on_field(T_d01)
    start = {"field.E": 1.0, "exciter.v_m": 1.0, "exciter.v_a": 1.4986, "exciter.v_e": 1.1154, "exciter.x_f": 1.4986}
    point = steady_state(plan, start=start)
    modes = linearise(plan, point).modes()
    near(modes, expected)
    assert modes.stable == (T_d01 > 1.0)


# the rectifier


@pytest.mark.parametrize(
    ("R_d", "expected"), [(0.2, [-7.1, -273 + 157j, -441 + 5257j, -461 + 4494j]), (0.0, [2.4 + 5280j])]
)
def test_current_loop_of_the_rectifier_has_the_published_eigenvalues(R_d, expected):
    """As they were computed: one delay of 1.5/1620 s, no feed-forward, decoupled by both chokes, the rest slow."""
    slow = {"f_ff": 0.01, "pll_f": 0.05, "K_p_dc": 1e-4, "K_i_dc": 1e-2, "K_p_q": 1e-4, "K_i_q": 1e-3}
    control = RectifierControl(L_1=1.38 * 480.0**2 / 596e3 / rig.OMEGA, **slow)
    damped = rig.rectifier(control=control, f_s=1620.0, R_d=0.2, stiff=743.0)
    plan = rig.rectifier(control=control, f_s=1620.0, R_d=R_d, stiff=743.0)
    start = steady_state(damped, start=rig.RECTIFIER_START).workspace()
    modes = linearise(plan, steady_state(plan, start=start)).modes()
    near(modes, expected)
    assert modes.stable == (R_d > 0.0)


@pytest.mark.parametrize(("load", "expected"), [(0.0, [-162.7 + 297.7j, -2.52]), (1.0, [-109 + 262j, -3.42])])
def test_dc_loop_has_the_published_eigenvalues(load, expected):
    # the load's current at the nominal voltage is what they were computed at
    plan = rig.dc_loop()
    point = steady_state(plan, {"power": load * 596e3}, hold={"dc.v_dc": 750.0}, free=["v_ref"], start={})
    near(linearise(plan, point).modes(), expected)


# drive and inverter


@pytest.mark.parametrize(("damping", "expected"), [(0.0, -1.59 + 1.50j), (2.0, -1.90 + 1.07j)])
def test_speed_loop_of_the_shaft_line_has_the_published_eigenvalues(damping, expected):
    plan = rig.shaft_line()
    point = steady_state(plan, {"k": damping * 5729.6 / 47.12389}, start={"shaft.omega_m": 0.3 * 47.1})
    assert point["shaft.omega_pu"] == pytest.approx(0.3, rel=1e-9)
    modes = linearise(plan, point).modes()
    near(modes, [expected])
    assert set(modes.nearest(expected).states) <= {"shaft.omega_m", "speed.speed.i"}


@pytest.mark.parametrize(
    ("X", "T_1", "expected"),
    [
        (0.15, 0.033, [-46.35 + 51.9j, -29.6]),
        (0.15, 0.011, [-15.7 + 36.5j]),
        (0.10, 0.033, [-46.2 + 71.1j]),
        (0.10, 0.011, [-15.7 + 46.1j]),
    ],
)
def test_outer_loop_of_the_inverter_has_the_published_eigenvalues(X, T_1, expected):
    plan = rig.swing(X, T_1)
    near(linearise(plan, steady_state(plan, start={})).modes(), expected, within=0.005)


@pytest.mark.parametrize(
    ("preset", "load", "rightmost"),
    [
        ("default", rig.series(10e3), -16.4),
        ("paper", rig.series(6e3), -9.1),
        ("default", rig.parallel(10e3), -5.91 + 334.6j),
        ("paper", rig.parallel(6e3), -5.15 + 329.2j),
    ],
)
def test_isolated_inverter_has_the_eigenvalues_of_the_table(preset, load, rightmost):
    """The table has -6.6+333j and -5.8+327j for R || L: 0.5 and 0.7 % of the magnitude from these."""
    plan = rig.grid_forming(preset, *load)
    point = steady_state(plan, start={})
    sampled = linearise(plan, point, method="sampled").modes()
    assert sampled[0].eigenvalue == pytest.approx(rightmost, abs=0.15)  # the last digits
    continuous = linearise(plan, point).modes()
    near(continuous, [m.eigenvalue for m in sampled if abs(m.eigenvalue) < 340.0])  # a thirtieth of the sampling
