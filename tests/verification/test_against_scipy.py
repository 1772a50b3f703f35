"""The fast solver against equations written out here, integrated by SciPy, and against closed forms with a bridge.

An LCL filter between a grid and a DC link, with an averaged converter and its sampled current control: as in the
ship's rectifier, but the grid and the DC source are stiff. What is written here shares no kernel with the package.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.components.sources.three_phase_source import ThreePhaseSource
from shipgrid.controllers.blocks.low_pass import low_pass
from shipgrid.controllers.current_dq import CurrentDqState, current_dq
from shipgrid.equipment.wiring import add_bridge, add_leg
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.connections import Pole
from shipgrid.model.frames import rotate, unrotate
from shipgrid.model.network import Network
from shipgrid.model.placed import Sampled
from shipgrid.units import Ampere, PerUnit, Radian, RadianPerSecond, Ratio, Volt
from verification.circuits import Hold, SourceBranch, Toggle

# the rectifier of the models page: 596 kW, 480 V, 60 Hz, carrier 1620 Hz sampled twice, gains K_p = 1, K_i = 7 1/s
OMEGA = 2.0 * math.pi * 60.0
V_B = math.sqrt(2.0 / 3.0) * 480.0
I_B = 2.0 / 3.0 * 596e3 / V_B
Z_B = V_B / I_B
L_1, C, L_2 = 1.29 * Z_B / OMEGA, 0.07 / (Z_B * OMEGA), 0.09 * Z_B / OMEGA
R_1, R_2 = 0.005 * Z_B, 0.005 * Z_B
R_D = math.sqrt(L_1 * L_2 / ((L_1 + L_2) * C)) / 3.0
L_G, R_G = 0.10 * Z_B / OMEGA, 0.01 * Z_B  # the grid
K_P, K_I, OMEGA_FF = 1.0, 7.0, 2.0 * math.pi * 150.0
C_DC, G_DC, L_S, R_S, E_DC = 10e-3, 0.1, 50e-6, 0.05, 750.0
I_REF = 0.30 - 0.05j  # a step at time zero
UNTIL = 25e-3
F_S = 3240.0  # Hz: a sampling period is 10.29 steps of 30 us
F_WHOLE = 3125.0  # Hz: ten steps of 32 us, every instant on a step's end


# --- the package's side -----------------------------------------------------------------------------------------------


class LoopState:
    current: CurrentDqState
    v_ff_d: PerUnit = signal("feed-forward, d axis", initial=1.0)
    v_ff_q: PerUnit = signal("feed-forward, q axis")
    theta: Radian = signal("angle of the frame", rotates=True)


class LoopInput:
    i_alpha: Ampere = signal("converter current, alpha")
    i_beta: Ampere = signal("converter current, beta")
    v_alpha: Volt = signal("capacitor voltage, alpha")
    v_beta: Volt = signal("capacitor voltage, beta")
    v_dc: Volt = signal("DC voltage")


class LoopOutput:
    s_alpha: Ratio = signal("switching function, alpha")
    s_beta: Ratio = signal("switching function, beta")
    limited: Ratio = signal("1 where the voltage was limited")


@kernel
def loop_update(dt, x, u, p, x_next, y):
    cos, sin = np.cos(x.theta), np.sin(x.theta)
    i_d, i_q = rotate(-u.i_alpha / p.I_b, -u.i_beta / p.I_b, cos, sin)
    v_d, v_q = rotate(u.v_alpha / p.V_b, u.v_beta / p.V_b, cos, sin)
    x_next.v_ff_d = low_pass(v_d, x.v_ff_d, p.omega_ff, dt)
    x_next.v_ff_q = low_pass(v_q, x.v_ff_q, p.omega_ff, dt)
    v_d, v_q, y.limited = current_dq(
        p.i_d, p.i_q, i_d, i_q, x_next.v_ff_d, x_next.v_ff_q, p.X, 10.0, p.K_p, p.K_i, dt, x.current, x_next.current
    )
    ahead = x.theta + 1.5 * p.omega * dt
    y.s_alpha, y.s_beta = unrotate(v_d * p.V_b / u.v_dc, v_q * p.V_b / u.v_dc, np.cos(ahead), np.sin(ahead))
    x_next.theta = x.theta + p.omega * dt


@component(state=LoopState, input=LoopInput, output=LoopOutput, update=loop_update, stage="inner")
class CurrentLoop:
    """Current control in a frame that turns with the grid."""

    V_b: Volt = param("base voltage", above=0.0)
    I_b: Ampere = param("base current", above=0.0)
    omega: RadianPerSecond = param("angular frequency", above=0.0)
    omega_ff: RadianPerSecond = param("corner of the feed-forward", above=0.0)
    X: PerUnit = param("reactance of the choke", above=0.0)
    K_p: PerUnit = param("proportional gain", above=0.0)
    K_i: PerUnit = param("integral gain", above=0.0)
    i_d: PerUnit = param("reference, d axis")
    i_q: PerUnit = param("reference, q axis")


SIGNALS = (
    *(f"lcl.{axis}.{state}" for state in ("i_1", "v_c", "i_2") for axis in ("alpha", "beta")),
    "dc.v_dc",
    "source.i",
)


def converter(step, f_s):
    """Plan and start of the converter between grid and DC link."""
    net = Network("converter")
    dc, ac = net.dc_bus("dc", 750.0), net.ac_bus("ac", 480.0, 60.0)
    net.capacitance(dc, C_DC)
    net.conductance(dc, G_DC)
    net.add("source", SourceBranch(R=R_S, L=L_S), ports={"ends": dc}, inputs={"e": -E_DC})
    net.add("grid", ThreePhaseSource(v_n=480.0, R=R_G, L=L_G), a=ac)
    bridge = add_bridge(net, "converter", dc, control="loop", gates=1.0, clock=Sampled(f_s), f_sw=f_s)
    net.add_three_phase(
        "lcl",
        LclFilter(L_1=L_1, R_1=R_1, C=C, R_d=R_D, L_2=L_2, R_2=R_2),
        ports={"converter": bridge, "grid": ac},
    )
    net.add(
        "loop",
        CurrentLoop(
            V_b=V_B, I_b=I_B, omega=OMEGA, omega_ff=OMEGA_FF, X=1.29, K_p=K_P, K_i=K_I, i_d=I_REF.real, i_q=I_REF.imag
        ),
        inputs={"v_dc": "dc.v_dc"}
        | {f"i_{axis}": f"lcl.{axis}.i_1" for axis in ("alpha", "beta")}
        | {f"v_{axis}": f"lcl.{axis}.v_c" for axis in ("alpha", "beta")},
        clock=Sampled(f_s),
    )
    plan = assemble(net, step)
    work = new_workspace(plan)
    start = {
        "dc.v_dc": E_DC,
        "lcl.alpha.v_c": V_B,
        "converter.modulator.alpha": V_B / E_DC,
    }
    for path, number in (start | {"loop.s_alpha": V_B / E_DC}).items():
        work.sig[plan.layout.index[path]] = number
    return plan, work


def trace(plan, work, until, every):
    """The compared signals at each multiple of `every`."""
    places = [plan.layout.index[path] for path in SIGNALS]
    entry, values, n = core(), arguments(plan, work), round(every / plan.h)
    rows = [work.sig[places].copy()]
    for k in range(round(until / every)):
        assert entry(n, k * n, *values) == n
        rows.append(work.sig[places].copy())
    return np.array(rows)


# --- the equations, written out ---------------------------------------------------------------------------------------


@cache
def solution(every, f_s):
    """The same signals at each multiple of `every`: space vectors as complex numbers, piecewise between the samples."""
    T_s = 1.0 / f_s

    def right(t, z, s):
        i_1, v_c, i_2 = z[0] + 1j * z[1], z[2] + 1j * z[3], z[4] + 1j * z[5]
        v, i_s = z[6], z[7]
        drop = R_D * (i_1 - i_2)
        di_1 = (s * v - R_1 * i_1 - v_c - drop) / L_1
        dv_c = (i_1 - i_2) / C
        di_2 = (v_c + drop - (R_2 + R_G) * i_2 - V_B * np.exp(1j * OMEGA * t)) / (L_2 + L_G)
        dv = (i_s - G_DC * v - 1.5 * (s * i_1.conjugate()).real) / C_DC
        di_s = (E_DC - R_S * i_s - v) / L_S
        return [di_1.real, di_1.imag, dv_c.real, dv_c.imag, di_2.real, di_2.imag, dv, di_s]

    z = np.array([0.0, 0.0, V_B, 0.0, 0.0, 0.0, E_DC, 0.0])
    in_force = coming = complex(V_B / E_DC)
    integral, v_ff = 0.0j, 1.0 + 0.0j
    grid = every * np.arange(round(UNTIL / every) + 1)
    rows = [z]
    for k in range(math.ceil(UNTIL / T_s)):
        t = k * T_s
        in_force = coming
        turn = np.exp(1j * OMEGA * t)
        i = -(z[0] + 1j * z[1]) / turn / I_B
        v_ff += (1.0 - math.exp(-OMEGA_FF * T_s)) * ((z[2] + 1j * z[3]) / turn / V_B - v_ff)
        error = I_REF - i
        wanted = v_ff - (K_P * error + integral) - 1.29j * i
        integral += K_I * error * T_s
        coming = wanted * V_B / z[6] * turn * np.exp(1.5j * OMEGA * T_s)
        inside = grid[(grid > t + 1e-9) & (grid < t + T_s - 1e-9)]
        found = solve_ivp(right, (t, t + T_s), z, "DOP853", [*inside, t + T_s], args=(in_force,), rtol=1e-9, atol=1e-7)
        on_grid = abs((t + T_s) / every - round((t + T_s) / every)) < 1e-6
        rows += list(found.y.T[: len(inside) + on_grid])
        z = found.y[:, -1]
    return np.array(rows)[: len(grid)] * np.array([1.0] * 7 + [-1.0])  # source.i flows into the source


def errors(step, every, f_s):
    """Largest error of each signal, over the largest value of its kind (both axes alike)."""
    plan, work = converter(step, f_s)
    got, true = trace(plan, work, UNTIL, every), solution(every, f_s)
    largest = np.abs(true).max(axis=0)
    for k in (0, 2, 4):
        largest[k : k + 2] = largest[k : k + 2].max()
    found = np.abs(got - true).max(axis=0) / largest
    return dict(zip(SIGNALS, found.tolist(), strict=True))


def test_filter_dc_link_and_current_control_agree_with_equations_written_out():
    """Well within 0.1 % of the largest value at 30 us; the error falls with the square of the step."""
    fine, coarse = errors(15e-6, 30e-6, F_S), errors(30e-6, 30e-6, F_S)
    assert max(coarse.values()) < 5e-4, coarse
    assert coarse["dc.v_dc"] < 5e-6  # behind ten millifarads
    orders = {name: math.log2(coarse[name] / fine[name]) for name in fine}
    assert all(1.5 < order < 2.5 for order in orders.values()), orders  # sampling inside a step costs none of it


def test_what_the_current_samples_cost_falls_with_the_step():
    """A sample falls on the corner that the new switching function makes in the current; a straight line between the
    step's ends cuts it by up to h/4 ds v_dc / L_1. So the error is of first order where instants fall inside steps."""
    coarse, fine = (errors(step, 30e-6, F_S) for step in (30e-6, 7.5e-6))
    corner = 30e-6 / 4.0 * (OMEGA / F_S * V_B) / L_1 / 320.0  # over the largest current
    for name in SIGNALS[:2]:
        assert coarse[name] < 2.0 * corner  # one sample's, and what the loop makes of those before it
        assert fine[name] < 0.35 * coarse[name]


def test_with_samples_on_step_ends_the_converter_is_of_second_order():
    found = [np.array(list(errors(step, 32e-6, F_WHOLE).values())) for step in (32e-6, 16e-6, 8e-6)]
    for coarse, fine in pairwise(found):
        assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.25)  # the next term is of third order
    assert found[0].max() < 1e-3


# --- closed forms with a bridge ---------------------------------------------------------------------------------------


def test_a_bridge_between_a_capacitor_and_a_choke_is_of_second_order():
    """Seen through the constant s, C is C / s^2: a damped oscillation in closed form."""
    s, R, L, capacity, v_0, T = 0.6, 0.05, 1e-3, 500e-6, 750.0, 10e-3
    a, w_0 = R / (2.0 * L), s / math.sqrt(L * capacity)
    w = math.sqrt(w_0**2 - a**2)
    exact = s * v_0 / (w * L) * math.exp(-a * T) * math.sin(w * T)
    found = []
    for step in (40e-6, 20e-6, 10e-6):
        net = Network("bridge and choke")
        bus = net.dc_bus("bus", v_0)
        net.capacitance(bus, capacity)
        net.add("hold", Hold(), inputs={"wanted": s})
        net.add("choke", SourceBranch(R=R, L=L), ports={"ends": Pole(bus, "hold.s")})
        plan = assemble(net, step)
        work = new_workspace(plan)
        work.sig[plan.layout.index["bus.v_dc"]] = v_0
        settle_outputs(plan, work)
        n = round(T / step)
        assert core()(n, 0, *arguments(plan, work)) == n
        found.append(work.sig[plan.layout.index["choke.i"]] - exact)
    orders = np.log2(np.abs(np.array(found[:-1]) / np.array(found[1:])))
    assert orders == pytest.approx(2.0, abs=0.15)  # the next term is of third order
    assert abs(found[-1]) < 1e-4 * s * v_0 * math.sqrt(capacity / L) / s


def test_a_switching_function_that_changes_inside_steps_acts_at_its_instant():
    """A choke at a stiff bus, s = 0.2 and 0.8 in turn at 1620 Hz: exponentials from instant to instant."""
    f_s, R, L, E = 1620.0, 0.5, 2e-3, 750.0
    samples = 160  # to the end of the last one: 79 ms
    T = 1.0 / f_s

    def exact(t):
        i, at, s, k = 0.0, 0.0, 0.0, 0
        while at < t - 1e-12:
            end = min(t, (k + 1) * T)
            i = s * E / R + (i - s * E / R) * math.exp(-R / L * (end - at))
            at, k = end, k + 1
            s = 0.2 if k % 2 else 0.8  # the reference of instant k - 1 is in force from instant k
        return i

    worst = []
    for step in (40e-6, 20e-6, 10e-6):
        net = Network("toggled leg")
        bus = net.dc_bus("bus", E)
        net.capacitance(bus, 1e7)  # stiff: some 50 C are taken from it, 5 uV
        net.add("toggle", Toggle(), clock=Sampled(f_s))
        leg = add_leg(net, "converter", bus, control="toggle", gates=1.0, clock=Sampled(f_s), f_sw=f_s)
        net.add("choke", SourceBranch(R=R, L=L), ports={"ends": leg})
        plan = assemble(net, step)
        work = new_workspace(plan)
        work.sig[plan.layout.index["bus.v_dc"]] = E
        place, entry, values = plan.layout.index["choke.i"], core(), arguments(plan, work)
        largest = 0.0
        for k in range(round(samples * T / step)):
            assert entry(1, k, *values) == 1
            largest = max(largest, abs(work.sig[place] - exact((k + 1) * step)))
        worst.append(largest)
    # the mean over a step is exact but for where in the step it acts: h^2/8 ds E R/L^2, and the place varies
    assert worst[0] < 2.0 * (40e-6) ** 2 / 8.0 * 0.6 * E * R / L**2
    assert worst[2] < 0.15 * worst[0]
