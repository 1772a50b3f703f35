"""The motor: rated point, back-emf, Norton equivalent; with its drive: the step of speed of the models page."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numba import njit

from shipgrid.assembly.unit_text import NORTON
from shipgrid.components.machines import pmsm
from shipgrid.components.machines.pmsm import Pmsm
from shipgrid.controllers import drive_current, motor_speed
from shipgrid.controllers.drive_current import DriveCurrent
from shipgrid.controllers.motor_speed import MotorSpeed
from shipgrid.model.records import flat_of, make_record, parameter_record

loop = njit(error_model="numpy")  # around kernels; unlike them it may allocate


OMEGA_N = 2.0 * math.pi * 450.0 / 60.0
SALIENT = Pmsm(L_d=1.2e-3, L_q=2.5e-3)
GAMMA = 1.0 - math.sqrt(0.5)


def machine(motor: Pmsm, omega_m: float = OMEGA_N, **values: float):
    """Parameters, state, input and output records of a motor."""
    p, _ = parameter_record(motor)
    x = make_record(pmsm.State, {k: v for k, v in values.items() if k in ("i_d", "i_q", "theta_e")})
    u = make_record(pmsm.Input, {"omega_m": omega_m, **{k: v for k, v in values.items() if k in ("v_alpha", "v_beta")}})
    return p, x, u, make_record(pmsm.Output)


def test_rated_point_is_that_of_the_nameplate():
    p, x, u, y = machine(Pmsm(), i_q=490.7)
    pmsm.outputs(x, u, p, y)
    assert y.tau_e == pytest.approx(5730.0, rel=1e-3)
    # steady: derivatives vanish at this voltage
    omega_e = 3.0 * OMEGA_N
    assert omega_e / (2.0 * math.pi) == pytest.approx(22.5)
    v_d, v_q = -omega_e * 1.83e-3 * 490.7, 8e-3 * 490.7 + omega_e * 2.595
    u.v_alpha, u.v_beta = v_d, v_q
    dx = make_record(pmsm.State)
    pmsm.derivatives(x, u, p, dx)
    assert abs(dx.i_d) < 1e-6
    assert abs(dx.i_q) < 1e-6
    assert math.hypot(v_d, v_q) * math.sqrt(1.5) == pytest.approx(480.0, rel=2e-3)  # L_q is given with three digits
    pmsm.outputs(x, u, p, y)
    assert y.p_s == pytest.approx(272.9e3, rel=1e-3)
    assert pmsm.losses(x, p) == pytest.approx(y.p_s - y.tau_e * OMEGA_N, rel=1e-9)


def test_open_circuit_emf_is_449_volt_so_that_no_diode_conducts():
    line_to_line_peak = 3.0 * OMEGA_N * 2.595 * math.sqrt(3.0)
    assert line_to_line_peak / math.sqrt(2.0) == pytest.approx(449.3, abs=0.2)
    p, x, u, _ = machine(Pmsm())
    dx = make_record(pmsm.State)
    u.v_alpha, u.v_beta = (
        0.0,
        3.0 * OMEGA_N * 2.595,
    )  # the q axis at theta_e = 0: this voltage holds the current at zero
    pmsm.derivatives(x, u, p, dx)
    assert abs(dx.i_d) + abs(dx.i_q) < 1e-9
    assert line_to_line_peak == pytest.approx(635.0, abs=1.0)


def norton():
    """What a stamp writes into."""
    return np.zeros(1, NORTON).view(np.recarray)[0]


@pytest.mark.parametrize("motor", [Pmsm(), SALIENT], ids=["round", "salient"])
@pytest.mark.parametrize("omega_m", [OMEGA_N, -20.0, 0.0])
def test_stamp_and_advance_are_one_implicit_euler_step_of_the_equations(motor, omega_m):
    gh = GAMMA * 30e-6
    p, x, u, y = machine(motor, omega_m, i_d=-80.0, i_q=300.0, theta_e=0.7, v_alpha=120.0, v_beta=-310.0)
    n = norton()
    pmsm.stamp.py_func(gh, x, u, p, n)
    end = make_record(pmsm.State)
    pmsm.advance(gh, x, u, p, n, end)
    # the step's definition: end = x + gh f(end)
    dx = make_record(pmsm.State)
    pmsm.derivatives(end, u, p, dx)
    assert flat_of(end) == pytest.approx(flat_of(x) + gh * flat_of(dx), rel=1e-11, abs=1e-9)
    # the stamp gives the current at the end
    pmsm.outputs(end, u, p, y)
    assert n.g_aa * u.v_alpha + n.g_ab * u.v_beta + n.h_a == pytest.approx(y.i_alpha, rel=1e-10)
    assert n.g_ba * u.v_alpha + n.g_bb * u.v_beta + n.h_b == pytest.approx(y.i_beta, rel=1e-10)


def test_conductance_is_the_exact_derivative_of_the_step_by_complex_step():
    gh, small = GAMMA * 30e-6, 1e-40
    p, x, u, _ = machine(SALIENT, i_d=-80.0, i_q=300.0, theta_e=0.7, v_alpha=120.0, v_beta=-310.0)
    n = norton()
    pmsm.stamp.py_func(gh, x, u, p, n)
    pc, _ = parameter_record(SALIENT, scalar="c16")
    xc = make_record(pmsm.State, {"i_d": -80.0, "i_q": 300.0, "theta_e": 0.7}, scalar="c16")
    got = []
    for axis in ("v_alpha", "v_beta"):
        uc = make_record(pmsm.Input, {"v_alpha": 120.0, "v_beta": -310.0, "omega_m": OMEGA_N}, scalar="c16")
        uc[axis] += 1j * small
        end, y = make_record(pmsm.State, scalar="c16"), make_record(pmsm.Output, scalar="c16")
        pmsm.advance(gh, xc, uc, pc, n, end)
        pmsm.outputs(end, uc, pc, y)
        got += [y.i_alpha.imag / small, y.i_beta.imag / small]
    assert got == pytest.approx([n.g_aa, n.g_ba, n.g_ab, n.g_bb], rel=1e-12)


def test_terminal_power_is_stored_energy_losses_and_shaft_power():
    small = 1e-7
    p, x, u, y = machine(SALIENT, 35.0, i_d=-80.0, i_q=300.0, theta_e=0.7, v_alpha=120.0, v_beta=-310.0)
    pmsm.outputs(x, u, p, y)
    dx = make_record(pmsm.State)
    pmsm.derivatives(x, u, p, dx)
    ahead, back = (
        make_record(pmsm.State, {"i_d": x.i_d + d * dx.i_d, "i_q": x.i_q + d * dx.i_q}) for d in (small, -small)
    )
    rate = (pmsm.stored_energy(ahead, p) - pmsm.stored_energy(back, p)) / (2.0 * small)
    assert y.p_s == pytest.approx(rate + pmsm.losses(x, p) + y.tau_e * 35.0, rel=1e-8)


@loop
def run_drive(steps, h, n_ref, v_dc, J, machine, current, speed, trace):
    """Motor, current control and speed control on a stiff bus, one inertia, no load; a row of `trace` each step."""
    p, x, x_mid, x_end, u, y, n = machine
    p_c, u_c, y_c = current
    p_s, x_s, x_s_next, u_s, y_s = speed
    gh = (1.0 - math.sqrt(0.5)) * h
    kappa = 1.0 + math.sqrt(2.0)
    omega = u.omega_m
    for k in range(steps):
        u_s.n_ref = n_ref
        u_s.omega_pu = omega / 47.12388980384690
        u_s.v_dc = v_dc
        motor_speed.update(h, x_s, u_s, p_s, x_s_next, y_s)
        x_s.speed.i = x_s_next.speed.i
        u_c.tau_ref = y_s.tau_ref
        u_c.i_d, u_c.i_q, u_c.theta_e, u_c.omega_m, u_c.v_dc = x.i_d, x.i_q, x.theta_e, omega, v_dc
        drive_current.update(h, u_c, p_c, y_c)
        u.omega_m = omega
        u.v_alpha, u.v_beta = y_c.s_alpha * v_dc, y_c.s_beta * v_dc
        pmsm.stamp(gh, x, u, p, n)
        pmsm.advance(gh, x, u, p, n, x_mid)
        x_end.i_d = x.i_d + kappa * (x_mid.i_d - x.i_d)
        x_end.i_q = x.i_q + kappa * (x_mid.i_q - x.i_q)
        x_end.theta_e = x.theta_e + kappa * (x_mid.theta_e - x.theta_e)
        pmsm.stamp(gh, x_end, u, p, n)
        pmsm.advance(gh, x_end, u, p, n, x)
        pmsm.limit(x)
        pmsm.outputs(x, u, p, y)
        if J > 0.0:
            omega += h * y.tau_e / J
        trace[k, 0], trace[k, 1], trace[k, 2], trace[k, 3] = omega, y.tau_e, x.i_d, y_c.voltage_limited


def drive(
    steps: int, h: float, n_ref: float, v_dc: float = 750.0, J: float = 383.4, omega_0: float = 0.0
) -> np.ndarray:
    """Trace of `run_drive`: speed, torque, direct-axis current, voltage limit."""
    p, _ = parameter_record(Pmsm())
    p_c, _ = parameter_record(DriveCurrent(R=8e-3))
    p_s, _ = parameter_record(MotorSpeed())
    states = [make_record(pmsm.State) for _ in range(3)]
    u = make_record(pmsm.Input, {"omega_m": omega_0})
    trace = np.zeros((steps, 4))
    current = (p_c, make_record(drive_current.Input), make_record(drive_current.Output))
    records = (make_record(motor_speed.Input, {"v_dc": v_dc}), make_record(motor_speed.Output))
    speed = (p_s, make_record(motor_speed.State), make_record(motor_speed.State), *records)
    run_drive(steps, h, n_ref, v_dc, J, (p, *states, u, make_record(pmsm.Output), norton()), current, speed, trace)
    return trace


def test_step_of_speed_without_load_runs_up_at_the_torque_limit():
    trace = drive(int(6.0 / 100e-6), 100e-6, 1.0)
    speed = trace[:, 0] / OMEGA_N
    assert trace[:, 1].max() == pytest.approx(1.257 * 5729.6, rel=2e-3)
    # at the limit throughout it would take J omega / tau = 2.51 s; the controller leaves the limit at 0.87 pu
    assert 2.5 < np.argmax(speed >= 1.0) * 100e-6 < 2.8
    assert np.argmax(speed >= 0.87) * 100e-6 == pytest.approx(0.87 * 2.51, abs=0.02)
    assert speed.max() < 1.10
    assert speed[-1] == pytest.approx(1.0, abs=0.01)


def test_current_follows_with_its_time_constant_and_no_cross_coupling():
    h, omega_0 = 10e-6, 0.3 * OMEGA_N
    trace = drive(int(8e-3 / h), h, 0.32, J=0.0, omega_0=omega_0)  # 0.02 pu of speed error: 0.2 pu of torque
    wanted = 0.2 * 5729.6
    assert trace[int(1e-3 / h), 1] / wanted == pytest.approx(1.0 - math.exp(-1.0), abs=0.01)  # a step is 0.01 of 1 ms
    assert trace[-1, 1] == pytest.approx(wanted, rel=0.015)  # the speed integrator adds 15/10 * 8 ms
    assert np.abs(trace[:, 2]).max() < 1e-3 * 490.7
    assert trace[:, 3].max() == 0.0


def test_full_torque_at_rated_speed_needs_705_volt():
    omega_e, i_q = 3.0 * OMEGA_N, 1.257 * 5729.6 / (4.5 * 2.595)
    v = math.hypot(omega_e * 1.83e-3 * i_q, 8e-3 * i_q + omega_e * 2.595)
    assert v * math.sqrt(3.0) == pytest.approx(705.0, rel=0.007)  # the models page rounds to 498 V line to line
    trace = drive(4000, 30e-6, 1.2, 720.0, 0.0, OMEGA_N)  # 15 V to spare: the rise is slow, then it is held
    assert trace[0, 3] == 1.0
    assert trace[-1, 3] == 0.0
    assert trace[-1, 1] == pytest.approx(1.257 * 5729.6, rel=1e-3)


def test_torque_limit_falls_from_700_to_660_volt_and_says_so():
    p, _ = parameter_record(MotorSpeed())
    x, x_next, y = make_record(motor_speed.State), make_record(motor_speed.State), make_record(motor_speed.Output)
    for v_dc, wanted, flag in [(750.0, 1.257, 0.0), (680.0, 0.6285, 1.0), (650.0, 0.0, 1.0)]:
        u = make_record(motor_speed.Input, {"n_ref": 1.0, "omega_pu": 0.2, "v_dc": v_dc})
        motor_speed.update(30e-6, x, u, p, x_next, y)
        assert y.tau_ref == pytest.approx(wanted)
        assert (y.torque_limited, y.voltage_limited) == (1.0, flag)
        assert x_next.speed.i == 0.0  # no windup in the limit


def test_switching_functions_stay_bounded_on_a_dead_bus():
    p, _ = parameter_record(DriveCurrent())
    y = make_record(drive_current.Output)
    for v_dc in (0.0, -5.0, 300.0):
        u = make_record(drive_current.Input, {"tau_ref": 1.0, "omega_m": OMEGA_N, "v_dc": v_dc})
        drive_current.update(30e-6, u, p, y)
        assert math.hypot(y.s_alpha, y.s_beta) <= 1.0 / math.sqrt(3.0) + 1e-12
        assert y.voltage_limited == 1.0
