"""The grid-forming inverter against its check values: inertia, eigenvalues, short circuit, black start, load step.

The plant is the filter and the loads by their own kernels, discretised exactly; the controller is the compiled kernel
at its rate, obeyed one period later and held for one. Eigenvalues are those of one whole period around the operating
point, in the frame that turns with the controller, by complex step.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from scipy.linalg import block_diag, expm, null_space
from scipy.optimize import brentq

from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.components.electrical.load import Load
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.controllers import grid_forming
from shipgrid.equipment.capability import FilterAtRest, inverter_end, inverter_on, voltage_limit
from shipgrid.model.records import initial_of, make_record, parameter_record
from validation.hotel_rig import (
    DESIGN,
    F_S,
    I_B,
    OMEGA_B,
    T_S,
    V_B,
    V_DC,
    Controller,
    controller,
    faulted,
    filter_of,
    isolated,
    matrices,
    one_feeds_both,
    parallel,
    series,
    tied,
)

R_T, X_T, C_F = 0.005, 0.10, 0.06
"""Transformer and filter capacitor [pu]."""
R_D = filter_of(controller()).R_d
"""Damping resistance [ohm] of the default filter."""


class Plant:
    """Filter with elements on its bar, one axis: dx/dt = A x + B v_conv; bar voltage = v_x x + v_u v_conv."""

    def __init__(self, control, elements=(), conductance=0.0, closed=None):
        closed = [True] * len(elements) if closed is None else closed
        lcl = LclFilter.per_unit(50e3, 400.0, 60.0, L_1=control.L_1, C=C_F, L_2=X_T)
        parts = [matrices(lcl)] + [matrices(e) for e in elements]
        works = [True, *closed]
        A = block_diag(*[a * w for (a, _, _), w in zip(parts, works, strict=True)])
        n = len(A)
        B = np.concatenate([parts[0][1][:, 0], np.zeros(n - 3)])
        others = list(zip(parts[1:], works[1:], strict=True))
        B_bar = np.concatenate([parts[0][1][:, 1]] + [b[:, 0] * w for (_, b, _), w in others])
        C_bar = np.concatenate([parts[0][2][1]] + [c[0] * w for (_, _, c), w in others])
        self.basis = np.eye(n)
        self.project = np.eye(n)
        if conductance > 0.0:
            self.v_x, self.v_u = -C_bar / conductance, 0.0
        else:  # only inductances meet here: their currents sum to zero, and so do the derivatives
            stiff = C_bar @ B_bar
            self.v_x, self.v_u = -(C_bar @ A) / stiff, -(C_bar @ B) / stiff
            self.project -= np.outer(B_bar, C_bar) / stiff  # what a change of contacts does to the currents
            self.basis = null_space(C_bar[None, :])
        self.A = A + np.outer(B_bar, self.v_x)
        self.B = B + B_bar * self.v_u
        self.n = n

    def discrete(self, h, A=None, B=None):
        """Exact step of length h for a held converter voltage."""
        A, B = (self.A, self.B) if A is None else (A, B)
        E = expm(np.block([[A, B[:, None]], [np.zeros((1, len(A) + 1))]]) * h)
        return E[:-1, :-1], E[:-1, -1]


class Run:
    """The inverter on its bar from standstill, sampled as in the ship; every tenth of a period is kept."""

    parts = 10

    def __init__(self, control, elements):
        self.control, self.elements = control, elements
        self.kernel = Controller(control)
        self.x = initial_of(grid_forming.State)
        n = 3 + len(elements)
        self.full = np.zeros((n, 2))
        self.coming = np.zeros(2)
        self.log, self.marks = {name: [] for name in ("f", "v_c", "v_bar", "i_1", "flags")}, {}

    def go(self, seconds, closed=None):
        plant = Plant(self.control, self.elements, closed=closed)
        self.full = plant.project @ self.full
        if closed is not None:
            self.full[3:][~np.array(closed)] = 0.0
        A_d, B_d = plant.discrete(T_S / self.parts)
        for _ in range(round(seconds * F_S)):
            active = self.coming
            self.x, self.coming, y = self.kernel(self.x, self.full[1], self.full[0], self.full[2])
            for _ in range(self.parts):
                self.full = A_d @ self.full + np.outer(B_d, active)
                self.log["v_bar"].append(np.hypot(*(plant.v_x @ self.full + plant.v_u * active)) / V_B)
                self.log["i_1"].append(np.hypot(*self.full[0]) / I_B)
            self.log["v_c"].append(np.hypot(*(self.full[1] + R_D * (self.full[0] - self.full[2]))) / V_B)
            self.log["f"].append(y.f)
            self.log["flags"].append((y.current_limit, y.virtual_impedance, y.modulation_limit))
        return self

    def mark(self, name):
        """Put aside what was logged since the last mark, under `name`."""
        self.marks[name] = {symbol: np.array(values) for symbol, values in self.log.items()}
        self.log = {symbol: [] for symbol in self.log}
        return self

    def __getitem__(self, name):
        return self.marks[name]


def droop_statics(p, power_factor=0.9, m_q=0.02, m_p=0.02):
    """Frequency [Hz], measured and bar voltage [pu] by phasors: the load's impedance at the droop's frequency.

    What is measured is the node of the chokes and of the capacitor with its damping resistor: they do not enter.
    """
    z_n = 50e3 / (p / power_factor)
    f, v = 1.0, 1.0
    for _ in range(50):
        z = z_n * (power_factor + 1j * f * math.sqrt(1.0 - power_factor**2))
        z_t = R_T + 1j * f * X_T
        i = v / (z + z_t)
        s = v * i.conjugate()
        f, v = 1.0 - m_p * s.real, 1.0 - m_q * s.imag
    return 60.0 * f, v, abs(z * i)


def test_inertia_is_that_of_the_low_pass():
    control = controller(T_1=0.011)  # lead-lag out
    p, _ = parameter_record(control)
    x, x_next = make_record(grid_forming.State), make_record(grid_forming.State)
    u = make_record(grid_forming.Input)
    dt = 1e-6
    omega, _ = grid_forming.droop(0.1, 0.0, dt, x, u, p, x_next)
    inertia = 0.1 * dt / (2.0 * (1.0 - omega))
    assert inertia == pytest.approx(0.796, abs=5e-4)  # the check value's last digit
    assert inertia == pytest.approx(1.0 / (2.0 * control.m_p * control.omega_c), rel=1e-4)


@pytest.mark.parametrize(
    ("x_total", "lead_lag", "expected"),
    [
        (0.15, True, [-46.35 + 51.9j, -29.6]),
        (0.15, False, [-15.7 + 36.5j]),
        (0.10, True, [-46.2 + 71.1j]),
        (0.10, False, [-15.7 + 46.1j]),
    ],
)
def test_outer_loop_against_a_stiff_bus_has_the_stated_eigenvalues(x_total, lead_lag, expected):
    control = controller(T_1=0.033 if lead_lag else 0.011)
    p, _ = parameter_record(control, "c16")
    dt = 1e-6  # as good as continuous: the check values are

    def step(z):
        x = make_record(grid_forming.State, {"power": z[0], "lead": z[1]}, "c16")
        x_next = make_record(grid_forming.State, None, "c16")
        u = make_record(grid_forming.Input, None, "c16")
        omega, _ = grid_forming.droop(np.sin(z[2]) / x_total, 0j, dt, x, u, p, x_next)
        return np.array([x_next.power, x_next.lead, z[2] + OMEGA_B * (omega - 1.0) * dt])

    jacobian = np.array([step(np.eye(3)[k] * 1e-30j).imag / 1e-30 for k in range(3)]).T
    found = np.log(np.linalg.eigvals(jacobian) + 0j) / dt
    for value in expected:
        assert np.abs(found - value).min() < 0.1  # the check values' last digit


@pytest.mark.parametrize(("z_c", "expected"), [(0.005 + 0.15j, 1.200), (0.005 + 0.10j, 1.212)])
def test_virtual_impedance_alone_holds_a_bolted_fault_at_the_stated_current(z_c, expected):
    c = controller()

    def missing(i):
        drop = complex(*grid_forming.virtual_impedance(i, 0.0, c.I_n, c.k_pRVI, c.sigma)) + z_c * i
        return abs(drop) - 1.0

    assert brentq(missing, 1.0, 2.0) == pytest.approx(expected, abs=1e-3)


def test_transient_virtual_resistor_leaves_the_steady_state_alone():
    with_it, without = controller(), controller(R_v=0.0)
    points = [isolated(c, series(10e3)).equilibrium() for c in (with_it, without)]
    assert np.allclose(points[0], points[1], rtol=0.0, atol=1e-6)  # volts and amperes among them


# The check values say power factor 0.9 and, by their source, 10 kW (default) or 6 kW (paper), but not how the parallel
# load was taken: one a few percent heavier gives their last digit, hence the wider band there.
@pytest.mark.parametrize(
    ("preset", "load", "expected", "within"),
    [
        ("default", series(10e3), -16.4, 0.2),
        ("default", parallel(10e3), -6.6 + 333j, 2.0),
        ("paper", series(6e3), -9.1, 0.2),
        ("paper", parallel(6e3), -5.8 + 327j, 2.5),
    ],
)
def test_isolated_inverter_has_the_stated_rightmost_eigenvalue(preset, load, expected, within):
    control = controller(preset, **(DESIGN if preset == "default" else {}))
    assert abs(isolated(control, load).rightmost() - expected) < within


@pytest.mark.parametrize(("preset", "p", "expected"), [("default", 10e3, -4.4 + 43j), ("paper", 6e3, -6.0 + 18.4j)])
def test_inverters_in_parallel_have_the_stated_rightmost_eigenvalue(preset, p, expected):
    control = controller(preset, **(DESIGN if preset == "default" else {}))
    assert abs(tied(control, series, p, p).rightmost() - expected) < 0.1  # printed to two figures


def test_a_slow_voltage_integrator_is_stable_alone_and_unstable_in_parallel():
    control = controller(**DESIGN | {"K_pv": 0.1, "K_iv": 20.0})
    assert isolated(control, series(10e3)).rightmost().real < 0.0
    assert tied(control, series, 10e3, 10e3).rightmost().real > 0.0


def cases(control, p):
    """Every load case of the table, and more; `p` is what one inverter can feed on each of two bars."""

    def lossy(p, power_factor=0.9, bar="for"):
        # an inductance with 2 % of resistance: through the tie, two without any would trap a direct current for ever
        (element, bar), *_ = parallel(p, power_factor, bar)[0]
        return [(RlBranch(R=0.02 * OMEGA_B * element.L, L=element.L), bar)], {bar: p / 400.0**2}

    return {
        "series R-L": isolated(control, series(p)),
        "light": isolated(control, series(1e3)),
        "resistive": isolated(control, series(p, 0.999)),
        "R parallel L": isolated(control, parallel(p)),
        "R parallel L, light": isolated(control, parallel(2e3)),
        "R parallel L, power factor 0.8": isolated(control, parallel(0.8 * p, 0.8)),
        "one feeds both": one_feeds_both(control, series, p),
        "one feeds both, R parallel L": one_feeds_both(control, lossy, p),
        "parallel": tied(control, series, p, p),
        "parallel, light": tied(control, series, 1e3, 1e3),
        "parallel, uneven": tied(control, series, 1.6 * p, 0.4 * p),
        "parallel, R parallel L": tied(control, lossy, p, p),
    }


@pytest.mark.parametrize(("preset", "p"), [("default", 10e3), ("paper", 6e3)])
def test_every_load_case_is_stable(preset, p):
    for name, case in cases(controller(preset), p).items():
        assert case.rightmost().real < -0.8, name  # least: R parallel L, light, whose L has no resistance at all


def slow_damping(system):
    """Least damping ratio of the modes below 24 Hz."""
    values = system.eigenvalues()
    modes = values[(np.abs(values) < 150.0) & (values.imag > 5.0)]
    return (-modes.real / np.abs(modes)).min()


def test_default_gains_damp_the_parallel_mode_twice_as_well_as_those_of_the_check_values():
    ours, design = controller(), controller(**DESIGN)
    assert slow_damping(tied(design, series, 10e3, 10e3)) == pytest.approx(0.10, abs=0.01)
    assert slow_damping(tied(ours, series, 10e3, 10e3)) > 0.18
    for load in (parallel(10e3), parallel(8e3, 0.8), parallel(8e3, 0.6)):  # and nothing is paid for it elsewhere
        assert isolated(ours, load).rightmost().real < isolated(design, load).rightmost().real


@pytest.mark.parametrize("power_factor", [0.8, 0.7, 0.6, 0.5])
def test_default_gains_are_stable_with_a_resistance_parallel_to_an_inductance(power_factor):
    assert isolated(controller(), parallel(8e3, power_factor)).rightmost().real < -0.5
    if power_factor < 0.65:  # where those of the check values are not
        assert isolated(controller(**DESIGN), parallel(8e3, power_factor)).rightmost().real > 0.0


@pytest.mark.parametrize(("preset", "i"), [("default", 1.25), ("paper", 0.81)])
@pytest.mark.parametrize(("R", "L"), [(1e-3, 5e-6), (0.3, 0.3e-3)], ids=["bolted", "behind a cable"])
def test_a_fault_is_held_by_the_limits_and_damped(preset, i, R, L):
    """With the limit acting the loops are damped: the eigenvalues are those at the point the fault comes to rest at."""
    system = faulted(controller(preset), series(6e3), R, L)
    z = system.after(800)
    assert np.abs(system(z) - z).max() < 1.0  # at rest: volts and amperes
    assert system.current(z) <= 1.2501
    if R == 1e-3:
        assert system.current(z) == pytest.approx(i, abs=0.01)
    assert system.eigenvalues(z)[0].real < -10.0


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_without_the_limit_the_virtual_impedance_is_unstable_in_a_bolted_fault(preset):
    system = faulted(controller(preset, i_max=10.0), series(6e3))
    z = system.start()
    lengths = []
    for _ in range(800):
        z = system(z)
        lengths.append(system.current(z))
    assert np.ptp(lengths[-100:]) > 0.05 or not np.isfinite(lengths[-1])


def test_advance_of_the_modulation_vector_is_needed():
    """Without it the isolated inverter is unstable on R || L: the frame lags by 1.5 periods, 20 degrees."""
    assert isolated(controller(**DESIGN), parallel(10e3), advance=False).rightmost().real > 0.0


@pytest.mark.parametrize("preset", ["default", "paper"])
@pytest.mark.parametrize("power_factor", [0.9, 0.999])
@pytest.mark.parametrize("share", [0.5, 0.95])
def test_what_an_inverter_can_carry_is_the_closed_form(preset, power_factor, share):
    """Its modulation at a load below the end, at the equilibrium of one whole sampling period."""
    control = controller(preset)
    lcl = FilterAtRest.of(filter_of(control), 50e3, 400.0, 60.0)
    v_lim = voltage_limit(V_DC, 400.0)
    end = inverter_end(lcl, v_lim, control.i_max, control.m_q, power_factor)
    z_load = end.v_bar**2 / end.s / share  # the load is an impedance
    load = 50e3 * power_factor / z_load
    one = isolated(control, series(load, power_factor))
    z = one.equilibrium()
    w, _, states = one.split(z)
    full = one.grid.basis @ w
    _, _, y = one.kernels[0](states[0], full[1], full[0], full[2])
    expected = inverter_on(lcl, z_load * cmath.rect(1.0, math.acos(power_factor)), control.m_q)
    # a vector held for a carrier period counts 0.23 % less than its length; the droop lowers the frequency by up to 2 %
    assert y.modulation == pytest.approx(abs(expected.v) / v_lim, rel=0.01)
    assert y.modulation < 1.0
    assert one.current(z) == pytest.approx(abs(expected.i), rel=0.015)  # and with it the reactance of the load


class TestBlackStart:
    """10 kW at power factor 0.9 from standstill, then half as much again, then a bolted fault and its end."""

    @pytest.fixture(scope="class")
    @classmethod
    def run(cls):
        elements = (Load(p_0=10e3), Load(p_0=5e3), RlBranch(R=1e-3, L=5e-6))
        run = Run(controller(), elements)
        run.go(3.0, closed=[True, False, False]).mark("started")
        run.go(0.6, closed=[True, True, False]).mark("loaded")
        run.go(0.3, closed=[True, True, True]).mark("fault")
        return run.go(1.0, closed=[True, True, False]).mark("cleared")

    def test_settles_at_the_droops_static_voltage_and_frequency(self, run):
        f, v_c, v_bar = droop_statics(10e3)
        assert run["started"]["f"][-1] == pytest.approx(f, abs=2e-4)  # the held voltage's ripple enters the samples
        assert run["started"]["v_c"][-1] == pytest.approx(v_c, abs=1e-4)
        assert run["started"]["v_bar"][-1620:].mean() == pytest.approx(v_bar, abs=1e-3)

    def test_voltage_rises_with_the_ramp_and_never_above_its_end(self, run):
        v = run["started"]["v_c"]
        assert v[round(0.75 * F_S)] == pytest.approx(0.5, abs=0.01)  # ramp of 1.5 s
        assert v.max() < 1.002 * v[-1]
        assert run["started"]["i_1"].max() < 0.21  # 0.22 pu of load less the capacitor's current: no inrush
        assert run["started"]["flags"].sum() == 0

    def test_load_step_dips_and_is_back_in_a_tenth_of_a_second(self, run):
        f, _, v_bar = droop_statics(15e3)
        v = run["loaded"]["v_bar"]
        assert 0.80 < v.min() < 0.90  # the capacitor alone at first, behind the leakage
        assert np.abs(v[round(0.1 * F_S) * Run.parts :] - v_bar).max() < 4e-3
        assert run["loaded"]["f"][-1] == pytest.approx(f, abs=5e-4)
        assert run["loaded"]["f"].min() > f - 1e-3  # no undershoot of the frequency

    def test_limiter_bounds_a_bolted_fault(self, run):
        """The virtual impedance alone would be unstable here; the 1.25 pu limit of the reference holds it."""
        i = run["fault"]["i_1"]
        assert i.max() < 1.75  # before the sampled control can act
        assert i[-1620:].min() > 1.20
        assert i[-1620:].max() < 1.26  # the limit and the held voltage's ripple
        limited, virtual_impedance, _ = run["fault"]["flags"][-100:].mean(axis=0)
        assert limited == 1.0
        assert virtual_impedance == 1.0

    def test_bar_recovers_when_the_fault_is_cleared(self, run):
        _, _, v_bar = droop_statics(15e3)
        assert run["cleared"]["v_bar"][-1620:].mean() == pytest.approx(v_bar, abs=1e-3)
        assert run["cleared"]["flags"][-100:].sum() == 0


def test_modulation_limit_settles_the_fault_current_of_the_paper_filter():
    run = Run(controller("paper"), (Load(p_0=6e3), RlBranch(R=1e-3, L=5e-6)))
    run.go(2.0, closed=[True, False]).go(0.3, closed=[True, True]).mark("fault")
    assert run["fault"]["i_1"][-1620:].mean() == pytest.approx(0.81, abs=0.01)
    assert run["fault"]["flags"][-100:, 2].all()
