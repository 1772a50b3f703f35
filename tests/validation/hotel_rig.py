"""A hotel grid's eigenvalues: inverters, loads and ties by their own kernels, over one whole sampling period.

Every element is a linear one between bars, every inverter's bridge a held source; the grid is discretised exactly. The
controllers are the compiled kernels, all sampled at the same instants as in the ship, obeyed one period later and held
for one. The state is seen in the frame that turns with the first controller, and derivatives are taken by complex step.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag, expm, null_space

from shipgrid.components.electrical.cable import ac_cable
from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.components.electrical.load import Load
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.controllers import grid_forming
from shipgrid.controllers.grid_forming import PRESETS, GridForming
from shipgrid.model.component import type_of
from shipgrid.model.records import flat_of, initial_of, make_record, names_of, parameter_record, record_dtype, size_of

F_S = 1620.0
T_S = 1.0 / F_S
OMEGA_B = 2.0 * math.pi * 60.0
V_B = math.sqrt(2.0 / 3.0) * 400.0
I_B = 2.0 / 3.0 * 50e3 / V_B
STATES = names_of(grid_forming.State)
N_X = len(STATES)
V_DC = 750.0


def matrices(item):
    """State, voltage input and current output matrices of a linear element, column by column from its kernels."""
    kind = type_of(item)
    p, _ = parameter_record(item)
    n = size_of(kind.state)
    volts = [t.v for t in kind.terminals]
    A, B, C = np.zeros((n, n)), np.zeros((n, len(volts))), np.zeros((len(volts), n))
    for k in range(n + len(volts)):
        x, u = np.zeros(n), dict.fromkeys(volts, 0.0)
        if k < n:
            x[k] = 1.0
        else:
            u[volts[k - n]] = 1.0
        dx, y = make_record(kind.state), make_record(kind.output)
        state, given = (
            make_record(kind.state, dict(zip(names_of(kind.state), x, strict=True))),
            make_record(kind.input, u),
        )
        kind.kernels["derivatives"](0.0, state, given, p, dx)
        kind.kernels["outputs"](0.0, state, given, p, y)
        if k < n:
            A[:, k] = flat_of(dx)
            C[:, k] = [getattr(y, t.i) for t in kind.terminals]
        else:
            B[:, k - n] = flat_of(dx)
    return A, B, C


def filter_of(control):
    """The filter that a controller is made for."""
    return LclFilter.per_unit(control.S_n, control.v_n, control.f_n, L_1=control.L_1, C=control.C, L_2=0.10)


class Grid:
    """One axis of the grid: dx/dt = A x + B v_conv.

    Parameters
    ----------
    controls : list of (GridForming, bar)
    branches : list of (element, bar) or (element, bar, bar)
        Elements of one terminal, from a bar to the star point or to another bar.
    conductances : dict of bar to siemens
    """

    def __init__(self, controls, branches, conductances=None):
        conductances = conductances or {}
        filters = [filter_of(c) for c, _ in controls]
        parts = [matrices(f) for f in filters] + [matrices(b[0]) for b in branches]
        bars = sorted({b for _, b in controls} | {b for branch in branches for b in branch[1:]})
        A = block_diag(*[a for a, _, _ in parts])
        n, m = len(A), len(controls)
        B, B_bar, C_bar = np.zeros((n, m)), np.zeros((n, len(bars))), np.zeros((len(bars), n))
        at = 0
        for k, (a, b, c) in enumerate(parts):
            own = slice(at, at + len(a))
            if k < m:
                bar = bars.index(controls[k][1])
                B[own, k], B_bar[own, bar], C_bar[bar, own] = b[:, 0], b[:, 1], c[1]
            else:
                for sign, name in zip((1.0, -1.0), branches[k - m][1:], strict=False):
                    bar = bars.index(name)
                    B_bar[own, bar] += sign * b[:, 0]
                    C_bar[bar, own] += sign * c[0]
            at += len(a)
        # a bar with a conductance: g v + C x = 0; one where only inductances meet: C dx/dt = 0
        lhs, of_x, of_u = np.zeros((len(bars), len(bars))), np.zeros((len(bars), n)), np.zeros((len(bars), m))
        for k, name in enumerate(bars):
            g = conductances.get(name, 0.0)
            if g > 0.0:
                lhs[k, k], of_x[k] = g, -C_bar[k]
            else:
                lhs[k], of_x[k], of_u[k] = C_bar[k] @ B_bar, -C_bar[k] @ A, -C_bar[k] @ B
        v_x, v_u = np.linalg.solve(lhs, of_x), np.linalg.solve(lhs, of_u)
        self.A, self.B = A + B_bar @ v_x, B + B_bar @ v_u
        stiff = [k for k, name in enumerate(bars) if conductances.get(name, 0.0) == 0.0]
        self.basis = null_space(C_bar[stiff]) if stiff else np.eye(n)
        self.filter_of = [3 * k for k in range(m)]  # i_1, v_c, i_2 of each inverter


def turning(theta):
    """Matrix from alpha-beta to the frame at the angle theta."""
    cos, sin = np.cos(theta), np.sin(theta)
    return np.array([[cos, sin], [-sin, cos]])


class Controller:
    """One controller's kernel on flat vectors, real or complex."""

    def __init__(self, control):
        self.made = {}
        for scalar, kind in (("f8", np.float64), ("c16", np.complex128)):
            flats, records = [], []
            for declared in (grid_forming.State, grid_forming.State, grid_forming.Input, grid_forming.Output):
                flat = initial_of(declared).astype(scalar)
                flats.append(flat)
                records.append(flat.view(record_dtype(declared, scalar)).view(np.recarray)[0])
            records[2].enable = 1.0
            self.made[kind] = (flats, records, parameter_record(control, scalar)[0])

    def __call__(self, x, v_c, i_1, i_2):
        flats, (state, after, u, y), p = self.made[x.dtype.type]
        flats[2][:7] = [*v_c, *i_1, *i_2, V_DC]
        flats[0][:] = flats[1][:] = x
        grid_forming.update(0.0, T_S, state, u, p, after, y)
        return flats[1].copy(), np.array([y.s_alpha, y.s_beta]) * V_DC, y


class OnePeriod:
    """Map of the whole state over one sampling period, in the frame of the first controller."""

    def __init__(self, controls, branches, conductances=None, *, advance=True):
        self.controls, self.advance = controls, advance
        self.grid = Grid(controls, branches, conductances)
        self.kernels = [Controller(c) for c, _ in controls]
        N = self.grid.basis
        A, B = N.T @ self.grid.A @ N, N.T @ self.grid.B
        n, m = B.shape
        E = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * T_S)
        self.A_d, self.B_d, self.n, self.m = E[:n, :n], E[:n, n:], n, m

    def split(self, z):
        w = z[: 2 * self.n].reshape(-1, 2)
        held = z[2 * self.n : 2 * (self.n + self.m)].reshape(-1, 2)
        # the first controller's own angle is the frame: it is no state
        rest = np.concatenate([[0.0 * z[0]], z[2 * (self.n + self.m) :]])
        return w, held, rest.reshape(self.m, N_X)

    def __call__(self, z):
        w, held, states = self.split(z)
        full = self.grid.basis @ w
        after, commanded = [], []
        for k, kernel in enumerate(self.kernels):
            j = self.grid.filter_of[k]
            x_next, v, _ = kernel(states[k], full[j + 1], full[j], full[j + 2])
            if not self.advance:
                v = turning(1.5 * OMEGA_B * T_S) @ v
            after.append(x_next)
            commanded.append(v)
        theta = after[0][STATES.index("theta")]
        turn = turning(theta)
        for x in after:
            x[STATES.index("theta")] = x[STATES.index("theta")] - theta
        new = (self.A_d @ w + self.B_d @ held) @ turn.T
        rest = np.concatenate(after)[1:]
        return np.concatenate([new.ravel(), (np.array(commanded) @ turn.T).ravel(), rest])

    def jacobian(self, z):
        columns = []
        for k in range(len(z)):
            zc = z.astype(complex)
            zc[k] += 1e-30j
            columns.append(self(zc).imag / 1e-30)
        return np.array(columns).T

    def start(self):
        """Near the equilibrium: every inverter's capacitor at 1 pu and angle zero."""
        grid, m = self.grid, self.m
        N = grid.basis
        A, B = N.T @ grid.A @ N, N.T @ grid.B
        unit = N @ np.linalg.solve(1j * OMEGA_B * np.eye(self.n) - A, B.astype(complex))
        caps = [j + 1 for j in grid.filter_of]
        v_m = np.linalg.solve(unit[caps], np.full(m, V_B, dtype=complex))
        phasor = unit @ v_m
        held = v_m * np.exp(0.5j * OMEGA_B * T_S)
        states = []
        for k, (c, _) in enumerate(self.controls):
            j = grid.filter_of[k]
            i_1, i_2 = phasor[j] / I_B, phasor[j + 2] / I_B
            s = np.conj(i_2)
            x_v, x_c = i_1 - c.F_i * i_2 - 1j * c.C, v_m[k] / V_B - 1j * c.L_1 * i_1 - c.F_v
            values = {"theta": 0.0, "v_set": 1.0, "power": -s.real, "lead": -s.real, "reactive": s.imag}
            for name, value in (("i_g_slow", i_2), ("v_c_forward", 1.0 + 0j), ("voltage", x_v), ("current", x_c)):
                values |= {f"{name}.d": value.real, f"{name}.q": value.imag}
            states.append([values[name] for name in STATES])
        pairs = np.concatenate([N.T @ phasor, held])
        flat = np.column_stack([pairs.real, pairs.imag]).ravel()
        return np.concatenate([flat, np.concatenate(states)[1:]])

    def equilibrium(self):
        z = self.start()
        for _ in range(12):
            dz = np.linalg.solve(self.jacobian(z) - np.eye(len(z)), z - self(z))
            z = z + dz
            if np.abs(dz).max() < 1e-8:
                return z
        raise AssertionError(f"no equilibrium, {np.abs(dz).max()}")

    def eigenvalues(self, z=None):
        """Eigenvalues [1/s] at the equilibrium, or at the point `z`, as if continuous, from right to left."""
        multipliers = np.linalg.eigvals(self.jacobian(self.equilibrium() if z is None else z))
        values = np.log(multipliers[np.abs(multipliers - 1.0) > 1e-6] + 1e-300) * F_S  # 1: an integrator that stands
        return values[np.argsort(-values.real)]

    def after(self, periods):
        """The state that many periods after the start."""
        z = self.start()
        for _ in range(periods):
            z = self(z)
        return z

    def current(self, z, k=0):
        """Length of an inverter's bridge current [pu]."""
        w, _, _ = self.split(z)
        return float(np.hypot(*(self.grid.basis @ w)[self.grid.filter_of[k]])) / I_B

    def rightmost(self):
        """The rightmost eigenvalue, its imaginary part taken positive."""
        value = self.eigenvalues()[0]
        return complex(value.real, abs(value.imag))


DESIGN = {"K_pc": 0.72, "K_ic": 97.0, "F_v": 0.41, "K_pv": 0.39, "K_iv": 236.0, "F_i": 0.74}
"""Gains the check values of the preset `default` belong to; its own are better damped."""


def controller(preset="default", **changes):
    control = GridForming(**{**PRESETS[preset], **changes})
    return replace(control, R_d=filter_of(control).R_d * control.S_n / control.v_n**2)


def series(p, power_factor=0.9, bar="for"):
    """A series R-L load as a branch, and no conductance."""
    return [(Load(p_0=p, power_factor=power_factor), bar)], {}


def parallel(p, power_factor=0.9, bar="for"):
    """A resistance parallel to an inductance: the branch and the conductance."""
    q = p * math.tan(math.acos(power_factor))
    return [(RlBranch(R=0.0, L=400.0**2 / q / OMEGA_B), bar)], {bar: p / 400.0**2}


def isolated(control, load, **options):
    """One inverter on its bar."""
    branches, conductances = load
    return OnePeriod([(control, "for")], branches, conductances, **options)


def faulted(control, load, R=1e-3, L=5e-6):
    """One inverter with a load and a bolted fault on its bar."""
    branches, conductances = load
    return OnePeriod([(control, "for")], [*branches, (RlBranch(R=R, L=L), "for")], conductances)


def one_feeds_both(control, make, p, *, length=30.0):
    """One inverter feeds the loads of both bars through the tie."""
    (a, g_a), (b, g_b) = make(p, bar="for"), make(p, bar="aft")
    return OnePeriod([(control, "for")], [*a, *b, (ac_cable(length, 1e-4), "for", "aft")], g_a | g_b)


def tied(control, make, p_for, p_aft, *, length=30.0):
    """Two inverters in parallel, each with a load on its bar."""
    (a, g_a), (b, g_b) = make(p_for, bar="for"), make(p_aft, bar="aft")
    controls = [(control, "for"), (control, "aft")]
    return OnePeriod(controls, [*a, *b, (ac_cable(length, 1e-4), "for", "aft")], g_a | g_b)
