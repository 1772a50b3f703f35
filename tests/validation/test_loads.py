"""Loads that are no impedance: power by voltage, constant power on a weak grid, a motor direct on line.

Against formulas, steady-state equivalent circuits, eigenvalues by hand, and SciPy. Plants that run share their
component types, and so their compiled module.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import shipgrid as sg
from shipgrid.controllers.grid_forming import GridForming
from validation import small_signal_rig as rig

V, F = 400.0, 60.0
OMEGA, PEAK = 2.0 * math.pi * F, math.sqrt(2.0 / 3.0) * V
TIGHT = {"rtol": 1e-10, "atol": 1e-10}


def assembled(net: sg.Network, step: float):
    """The plan of a plant, one of every kind of this file standing aside."""
    ac, dc = net.ac_bus("aside_ac", V, F), net.dc_bus("aside_dc", 750.0)
    net.capacitance(dc, 1e-3)
    net.add("aside_grid", sg.ThreePhaseSource(R=0.1, L=1e-4), a=ac)
    net.add("aside_feeder", sg.InductiveDcSource(R=0.1, L=1e-3), a=dc)
    net.add("aside_load", sg.VoltageDependentLoad(), a=ac)
    net.add("aside_converter", sg.DcLoad(p_0=100.0), a=dc)
    net.add("aside_motor", sg.InductionMotor(), a=ac, initial={"omega": 0.97})
    return sg.assemble(net, step=step)


def on_grid(loads: dict, R: float, L: float, **initial):
    """Loads on one bar behind R-L."""
    net = sg.Network("loads")
    bar = net.ac_bus("bar", V, F)
    net.add("grid", sg.ThreePhaseSource(v_n=V, f_n=F, R=R, L=L), a=bar)
    for name, item in loads.items():
        net.add(name, item, a=bar, initial=initial.get(name))
    return net


# --- power by voltage -------------------------------------------------------------------------------------------------

KINDS = {
    "impedance": ({"z_p": 1.0, "z_q": 1.0}, lambda r: (r**2, r**2)),
    "zip": ({"z_p": 0.3, "i_p": 0.5, "z_q": 0.8, "i_q": -0.2},
            lambda r: (0.3 * r**2 + 0.5 * r + 0.2, 0.8 * r**2 - 0.2 * r + 0.4)),
    "exponential": ({"alpha_p": 1.3, "alpha_q": 2.7}, lambda r: (r**1.3, r**2.7)),
    "power": ({}, lambda r: (1.0, 1.0)),
}  # fmt: skip


@pytest.mark.parametrize("v_pu", [1.0, 0.85, 1.1, 0.5])
def test_a_load_takes_what_its_formula_says_at_the_voltage_it_has(v_pu):
    """At 0.5 pu, below `r_min`, each goes on as the impedance that it was there."""
    p_0, pf = 8e3, 0.8
    loads = {name: sg.VoltageDependentLoad(p_0=p_0, power_factor=pf, **kind) for name, (kind, _) in KINDS.items()}
    plan = assembled(on_grid(loads, 0.02, 1e-4), 50e-6)
    run = plan.run({"grid.v_pu": v_pu}, until=0.15, record=["bar.v_alpha", "bar.v_beta", *POWERS])
    r = float(np.hypot(run["bar.v_alpha"][-1], run["bar.v_beta"][-1])) / PEAK
    assert r == pytest.approx(v_pu, abs=0.05) and abs(r - 1.0) > 0.005
    for name, (_, formula) in KINDS.items():
        at = max(r, 0.7)
        p, q = (part * (r / at) ** 2 for part in formula(at))
        # to (omega h)^2 / 10: the rule's first stage has another length of the voltage than its second
        assert float(run[f"{name}.p_ac"][-1]) == pytest.approx(p_0 * p, rel=4e-5), name
        assert float(run[f"{name}.q_ac"][-1]) == pytest.approx(p_0 * math.tan(math.acos(pf)) * q, rel=4e-5), name


POWERS = [f"{name}.{symbol}" for name in KINDS for symbol in ("p_ac", "q_ac")]


def test_constant_power_comes_back_within_its_filter_and_converges_with_order_two():
    """SciPy: source inductance, and the bar's voltage from the admittance that the filtered voltage leaves."""
    R, L, item = 0.2, 1.5e-3, sg.VoltageDependentLoad(p_0=20e3, power_factor=0.9)
    G, B, T = 20e3 / V**2, 20e3 * math.tan(math.acos(0.9)) / V**2, item.T_v

    def rates(t, x):
        i, w = x[0] + 1j * x[1], x[2]
        v = -i / ((G - 1j * B) / w)  # the source's current counts into the source
        e = 0.9 * PEAK * cmath.exp(1j * OMEGA * t)
        d = (v - R * i - e) / L
        return [d.real, d.imag, (abs(v) ** 2 / PEAK**2 - w) / T]

    errors, names = [], ["grid.i_alpha", "grid.i_beta", "load.w"]
    for step in (60e-6, 30e-6, 15e-6):
        plan = assembled(on_grid({"load": item}, R, L), step)
        run = plan.run({"grid.v_pu": 0.9, "grid.i_alpha": -30.0}, until=30e-3, record=names)
        found = solve_ivp(rates, (0.0, 30e-3 + step), [-30.0, 0.0, 1.0], t_eval=run["load.w"]["time"].values, **TIGHT).y
        got = np.array([run[name] for name in names])
        errors.append(np.abs(got - found).max(axis=1) / np.abs(found).max(axis=1))
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2.0, abs=0.2), errors
    assert errors[1].max() < 2e-4
    assert abs(run.energy_balance_error) < 1e-4


def test_constant_power_has_a_rest_up_to_the_largest_power_that_the_grid_can_give():
    """At unity power factor E^2 / (2 (R + |Z|)): an eigenvalue goes through zero there; beyond it the bar collapses."""
    R, L, item = 0.5, 3e-3, sg.VoltageDependentLoad(p_0=1e3, power_factor=1.0, r_min=0.2)
    most = V**2 / (2.0 * (R + abs(R + 1j * OMEGA * L)))
    # the rest at a share k of it, from |E|^2 = |v + Z i|^2 with v i = P / 3: its voltage, the upper of the two
    slowest = []
    for share in (0.5, 0.97, 0.9999):
        p = share * most
        z2, b = R**2 + (OMEGA * L) ** 2, V**2 - 2.0 * R * p
        v = math.sqrt((b + math.sqrt(b**2 - 4.0 * z2 * p**2)) / 2.0)
        demand, r = p / 1e3, v / V
        plan = sg.assemble(on_grid({"load": item}, R, L))
        i = -p / (1.5 * r * PEAK)
        start = {"load.w": r**2, "bar.v_alpha": r * PEAK, "grid.i_alpha": i, "load.demand": demand}
        start["grid.turned"] = cmath.phase(r * PEAK - (R + 1j * OMEGA * L) * i)
        point = sg.steady_state(plan, start=start)
        assert math.hypot(point["bar.v_alpha"], point["bar.v_beta"]) == pytest.approx(r * PEAK, rel=1e-5)
        modes = sg.linearise(plan, point).modes()

        def rates(x, p=p, e=r * PEAK - (R + 1j * OMEGA * L) * i):
            current, w = x[0] + 1j * x[1], x[2]
            v = -current * V**2 * w / p
            d = (v - (R + 1j * OMEGA * L) * current - e) / L
            return np.array([d.real, d.imag, (abs(v) ** 2 / PEAK**2 - w) / item.T_v])

        at, sizes = np.array([i, 0.0, r**2]), np.array([1e-3, 1e-3, 1e-6])
        assert np.abs(rates(at) * sizes).max() < 1e-6
        A = np.array([(rates(at + e) - rates(at - e)) / (2.0 * e.sum()) for e in np.diag(sizes)]).T
        eigenvalues = np.linalg.eigvals(A)
        for expected in eigenvalues:
            assert np.abs(modes.eigenvalues - expected).min() < 1e-4 * np.abs(eigenvalues).max()
        assert modes.stable and eigenvalues.real.max() < 0.0
        slowest.append(float(max(modes.eigenvalues.real)))
    assert slowest[-1] == pytest.approx(0.0, abs=0.05 / item.T_v)  # it vanishes with the square root of what is left
    assert slowest[0] < 20.0 * slowest[-1] < 0.0
    plan = assembled(on_grid({"load": item}, R, L), 50e-6)
    ends = {}
    for share in (0.97, 1.03):
        # from a light load on, slowly enough for the grid to follow
        rise = [sg.At(0.1 + 0.4 * k, sg.Set("load.demand", f * most / 1e3)) for k, f in enumerate((0.9, 0.95, share))]
        run = plan.run({"load.demand": 0.5 * most / 1e3}, events=rise, until=2.0, record=["load.w", "load.p_ac"])
        ends[share] = math.sqrt(float(run["load.w"][-1])), float(run["load.p_ac"][-1])
    assert ends[0.97][0] > 0.6 and ends[0.97][1] == pytest.approx(0.97 * most, rel=5e-5)  # as above
    assert ends[1.03][0] < 0.3 and ends[1.03][1] < 0.9 * most


# --- constant power behind L and C ------------------------------------------------------------------------------------

E_DC, R_DC, L_DC, C_DC = 750.0, 0.1, 0.5e-3, 2e-3
FAST = 1e-5
"""Time constant of a load's control far below that of L and C, 1 ms."""


def feeder(p: float, T_v: float = FAST):
    net = sg.Network("feeder")
    bus = net.dc_bus("bus", E_DC)
    net.capacitance(bus, C_DC)
    net.add("source", sg.InductiveDcSource(v_0=E_DC, R=R_DC, L=L_DC), a=bus)
    net.add("load", sg.DcLoad(p_0=p, T_v=T_v), a=bus)
    return net


def rest(p: float) -> dict[str, float]:
    v = 0.5 * (E_DC + math.sqrt(E_DC**2 - 4.0 * R_DC * p))
    return {"bus.v_dc": v, "source.i": -p / v, "load.w": (v / E_DC) ** 2}


def characteristic(p: float, T: float) -> np.ndarray:
    """Roots of (R + s L)(s C + Y) + 1 = 0 with Y = (P/V^2)(s T - 1)/(s T + 1)."""
    g = p / rest(p)["bus.v_dc"] ** 2
    admittance = np.polyadd(np.polymul([C_DC, 0.0], [T, 1.0]), g * np.array([T, -1.0]))
    return np.roots(np.polyadd(np.polymul([L_DC, R_DC], admittance), [T, 1.0]))


@pytest.mark.parametrize("T", [FAST, 1e-3, 20e-3])
@pytest.mark.parametrize("p", [50e3, 150e3, 220e3])
def test_constant_power_behind_l_and_c_has_the_eigenvalues_of_its_negative_conductance(p, T):
    plan = sg.assemble(feeder(p, T))
    modes = sg.linearise(plan, sg.steady_state(plan, start=rest(p))).modes()
    expected = characteristic(p, T)
    assert np.sort_complex(modes.eigenvalues) == pytest.approx(np.sort_complex(expected), rel=1e-6)
    # R C / L > P / V^2 is what a fast constant power asks of its feeder; a slow one adds damping to the resonance
    limit = R_DC * C_DC / L_DC
    if T == FAST:
        assert modes.stable == (p / rest(p)["bus.v_dc"] ** 2 < limit)
    assert modes.stable == bool(np.all(expected.real < 0.0))


def test_a_run_beyond_the_limit_of_r_c_over_l_oscillates_and_one_within_comes_to_rest():
    """Growth and decay of the run are those of the eigenvalue."""
    at_limit = brentq(lambda p: characteristic(p, FAST).real.max(), 50e3, 800e3)
    assert at_limit == pytest.approx(R_DC * C_DC / L_DC * rest(at_limit)["bus.v_dc"] ** 2, rel=0.02)
    for share in (0.9, 1.1):
        p = share * at_limit
        s = max(characteristic(p, FAST), key=lambda z: z.real)
        assert (s.real < 0.0) == (share < 1.0)
        plan = assembled(feeder(p), 5e-6)
        start = rest(p)
        period = 2.0 * math.pi / abs(s.imag)
        run = plan.run(start | {"bus.v_dc": start["bus.v_dc"] + 0.1}, until=8.0 * period, record=["bus.v_dc"])
        t, x = run["bus.v_dc"]["time"].values, run["bus.v_dc"].values - start["bus.v_dc"]
        crests = [float(np.abs(x[(t >= n * period) & (t < (n + 1) * period)]).max()) for n in range(1, 8)]
        rate = np.polyfit(period * np.arange(1, 8), np.log(crests), 1)[0]
        assert rate == pytest.approx(s.real, abs=0.02 * abs(s.real) + 0.3)  # 5 us on 1 ms


# --- a motor direct on line -------------------------------------------------------------------------------------------

MOTOR = sg.InductionMotor(p_n=37.3e3, v_n=460.0, t_n=0.9)
"""The motor of the default per-unit values in its own size."""


def phasors(item: sg.InductionMotor, slip: float, v: complex = 1.0) -> tuple[complex, float]:
    """Stator current and torque of the T equivalent circuit, per unit."""
    rotor = item.r_r / slip + 1j * item.x_lr
    parallel = 1j * item.x_m * rotor / (1j * item.x_m + rotor)
    i_s = v / (item.r_s + 1j * item.x_ls + parallel)
    i_r = i_s * parallel / rotor
    return i_s, abs(i_r) ** 2 * item.r_r / slip


def at_slip(item: sg.InductionMotor, slip: float) -> dict[str, float]:
    """States of a motor that turns evenly on a grid whose voltage is on alpha."""
    i_s, _ = phasors(item, slip)
    psi_s = (1.0 - item.r_s * i_s) / 1j
    i_r = (psi_s - (item.x_ls + item.x_m) * i_s) / item.x_m
    psi_r = item.x_m * i_s + (item.x_lr + item.x_m) * i_r
    names = ("psi_s_alpha", "psi_s_beta", "psi_r_alpha", "psi_r_beta", "omega")
    return dict(zip(names, (psi_s.real, psi_s.imag, psi_r.real, psi_r.imag, 1.0 - slip), strict=True))


def stiff(motors: dict, **initial):
    net = sg.Network("motors")
    bar = net.ac_bus("bar", 460.0, F)
    net.add("grid", sg.ThreePhaseSource(v_n=460.0, f_n=F, R=1e-6, L=1e-9), a=bar)
    for name, item in motors.items():
        net.add(name, item, a=bar, initial=initial.get(name))
    return net


def test_a_motor_held_at_a_speed_has_the_current_and_torque_of_the_equivalent_circuit():
    """A rotor of a thousand times the inertia, at standstill, at its breakdown torque, and at two more slips."""
    heavy = sg.InductionMotor(p_n=37.3e3, v_n=460.0, t_n=0.0, H=1e4)
    thevenin = 1j * heavy.x_m * (heavy.r_s + 1j * heavy.x_ls) / (heavy.r_s + 1j * (heavy.x_ls + heavy.x_m))
    breakdown = heavy.r_r / abs(thevenin + 1j * heavy.x_lr)
    slips = {"locked": 1.0, "breakdown": breakdown, "running": 0.03, "braking": -0.05}
    torques = np.array([phasors(heavy, s)[1] for s in np.linspace(0.01, 1.0, 2000)])
    assert phasors(heavy, breakdown)[1] == pytest.approx(torques.max(), rel=1e-5)
    starts = {name: at_slip(heavy, slip) for name, slip in slips.items()}
    plan = assembled(stiff(dict.fromkeys(slips, heavy), **starts), 25e-6)
    run = plan.run(until=0.1)
    base_i, base_tau = 37.3e3 / (math.sqrt(3.0) * 460.0), 37.3e3 * 2.0 / OMEGA
    for name, slip in slips.items():
        i_s, torque = phasors(heavy, slip)  # what is left is (omega h)^2 = 9e-5, near no load
        assert float(run[f"{name}.i_rms"][-1]) == pytest.approx(base_i * abs(i_s), rel=3e-4), (
            name
        )  # (omega h)^2 = 9e-5, near no load
        assert float(run[f"{name}.tau_e"][-1]) == pytest.approx(base_tau * torque, rel=3e-4), name
    # the textbook's motor: a starting current of eight times its base
    assert float(run["locked.i_rms"][-1]) / base_i == pytest.approx(8.36, rel=0.02)


def test_a_start_direct_on_line_is_scipys_with_order_two():
    """Five complex-valued equations in the axes of the grid, written down anew."""
    item, base_i = MOTOR, 37.3e3 / (math.sqrt(3.0) * 460.0)
    X = np.array([[item.x_ls + item.x_m, item.x_m], [item.x_m, item.x_lr + item.x_m]])

    def rates(t, x):
        psi = np.array([x[0] + 1j * x[1], x[2] + 1j * x[3]])
        i_s, i_r = np.linalg.solve(X, psi)
        d_s = OMEGA * (1.0 - item.r_s * i_s - 1j * psi[0])  # the grid's axes: v = 1
        d_r = OMEGA * (-item.r_r * i_r - 1j * (1.0 - x[4]) * psi[1])
        torque = (psi[0].conjugate() * i_s).imag - item.t_n * x[4] * abs(x[4])
        return [d_s.real, d_s.imag, d_r.real, d_r.imag, torque / (2.0 * item.H)]

    errors = []
    for step in (50e-6, 25e-6):
        run = assembled(stiff({"motor": item}), step).run(until=1.2)
        t = run["motor.omega"]["time"].values
        found = solve_ivp(rates, (0.0, 1.2), [0.0] * 5, t_eval=t, **TIGHT).y
        i_s = np.linalg.solve(X, np.array([found[0] + 1j * found[1], found[2] + 1j * found[3]]))[0]
        speed = float(np.abs(run["motor.omega"] - found[4]).max())
        current = float(np.abs(run["motor.i_rms"] / base_i - np.abs(i_s)).max())
        errors.append([speed, current])
    assert np.log2(np.divide(errors[0], errors[1])) == pytest.approx(2.0, abs=0.25), errors
    assert errors[1][0] < 1e-3 and errors[1][1] < 0.05  # of 14 pu, the first crest
    i_rms, omega = run["motor.i_rms"] / base_i, run["motor.omega"]
    assert float(i_rms.max()) > 1.2 * abs(phasors(item, 1.0)[0])  # with the offset of the first cycle
    assert float(i_rms.sel(time=0.1, method="nearest")) > 6.0
    slip = brentq(lambda s: phasors(item, s)[1] - item.t_n * (1.0 - s) ** 2, 1e-3, 0.1)
    assert float(omega[-1]) == pytest.approx(1.0 - slip, abs=1e-4)
    assert float(i_rms[-1]) == pytest.approx(abs(phasors(item, slip)[0]), rel=2e-3)
    assert abs(run.energy_balance_error) < 1e-3
    assert run.energy["consumers"]["motor"] == pytest.approx(
        37.3e3 * item.t_n * float((np.abs(omega) ** 3).integrate("time")), rel=1e-4
    )


def test_a_motor_at_rest_has_the_eigenvalues_of_its_equations_in_turning_axes():
    item = MOTOR
    slip = brentq(lambda s: phasors(item, s)[1] - item.t_n * (1.0 - s) ** 2, 1e-3, 0.1)
    plan = sg.assemble(stiff({"motor": item}))
    i_s, _ = phasors(item, slip)
    states = at_slip(item, slip)
    start = {f"motor.{name}": value for name, value in states.items()}
    values = np.array(list(states.values()))
    peak = math.sqrt(2.0 / 3.0) * 460.0
    i_n = i_s * 2.0 / 3.0 * 37.3e3 / peak
    start |= {"bar.v_alpha": peak, "grid.i_alpha": -i_n.real, "grid.i_beta": -i_n.imag}
    point = sg.steady_state(plan, start=start)
    assert point["motor.omega"] == pytest.approx(1.0 - slip, abs=1e-5)
    modes = sg.linearise(plan, point).modes()
    X = np.array([[item.x_ls + item.x_m, item.x_m], [item.x_m, item.x_lr + item.x_m]])

    def rates(x):
        psi = np.array([x[0] + 1j * x[1], x[2] + 1j * x[3]])
        i = np.linalg.solve(X, psi)
        d_s = OMEGA * (1.0 - item.r_s * i[0] - 1j * psi[0])
        d_r = OMEGA * (-item.r_r * i[1] - 1j * (1.0 - x[4]) * psi[1])
        torque = (psi[0].conjugate() * i[0]).imag - item.t_n * x[4] * abs(x[4])
        return np.array([d_s.real, d_s.imag, d_r.real, d_r.imag, torque / (2.0 * item.H)])

    A = np.array([(rates(values + e) - rates(values - e)) / 2e-6 for e in 1e-6 * np.eye(5)]).T
    for expected in np.linalg.eigvals(A):
        assert np.abs(modes.eigenvalues - expected).min() < 1e-4 * abs(expected), expected
    assert modes.stable


# --- a motor on an inverter -------------------------------------------------------------------------------------------

GAINS = {
    "default": {name: getattr(GridForming(), name) for name in rig.DESIGN},
    "motors": {"R_v": 0.25, "omega_RV": 11.0, "K_pv": 0.5, "K_iv": 120.0, "F_i": 0.86,
               **{name: getattr(GridForming(), name) for name in ("K_pc", "K_ic", "F_v")}},
}  # fmt: skip
SHORE = sg.ThreePhaseSource(R=0.0285, L=0.111 / OMEGA)
"""Grid of 5 MVA, transformer of 0.05 pu on 100 kVA, 30 m of cable."""


def rightmost(gains: str, loads: list, units: int = 1, conductance: float = 0.0) -> complex:
    """Eigenvalue of the sampled plant, inverters with loads, that is damped least."""
    start = rig.near_nominal(units)
    for k, item in enumerate(loads):
        if isinstance(item, sg.InductionMotor):
            slip = brentq(lambda s, m=item: phasors(m, s)[1] - m.t_n * (1.0 - s) ** 2, 1e-3, 0.2)
            start |= {f"load_{k}.{name}": value for name, value in at_slip(item, slip).items()}
    plan = rig.grid_forming("default", loads, conductance, units, **GAINS[gains])
    point = sg.steady_state(plan, start=start)
    return max(sg.linearise(plan, point, method="sampled").modes().eigenvalues, key=lambda z: z.real)


@pytest.mark.parametrize(
    ("gains", "p", "expected"),
    [("default", 1e3, -16.3), ("default", 2e3, 1.8 + 268j), ("default", 4e3, 22.0 + 234j), ("motors", 2e3, -10.6),
     ("motors", 4e3, -6.7 + 222j), ("motors", 8e3, 6.8 + 182j)],
)  # fmt: skip
def test_a_motor_on_an_inverter_is_an_induction_generator_to_what_turns_slower(gains, p, expected):
    """Beside 8 kW of lights. In the motor's own axes the mode turns at 60 Hz less its frequency: below its speed."""
    found = rightmost(gains, [sg.Load(p_0=8e3), sg.InductionMotor(p_n=p)])
    assert found.real == pytest.approx(expected.real, abs=0.3)
    assert abs(found.imag) == pytest.approx(expected.imag, abs=5.0)


def test_the_gains_for_motors_are_damped_in_every_other_case_too():
    assert rightmost("motors", [sg.Load(p_0=20.0)]).real == pytest.approx(-11.0, abs=0.3)
    assert rightmost("motors", [sg.Load(p_0=8e3), SHORE]).real == pytest.approx(-3.5, abs=0.3)
    assert rightmost("motors", [sg.Load(p_0=20e3)], units=2).real == pytest.approx(-2.0, abs=0.3)
    loads, conductance = rig.parallel(8e3, 0.7)
    assert rightmost("motors", list(loads), conductance=conductance).real == pytest.approx(-10.6, abs=0.3)
    assert rightmost("default", [sg.Load(p_0=8e3), SHORE]).real == pytest.approx(-6.2, abs=0.3)
