"""A test bed for the genset's kernels: exact derivatives, a machine on a prescribed or loaded bus, the whole set."""

from types import SimpleNamespace

import numpy as np
from numba import njit

from shipgrid.assembly.unit_text import NORTON
from shipgrid.components.mechanical import diesel_engine
from shipgrid.components.sources import synchronous_generator as machine
from shipgrid.controllers import exciter_ac1a, governor_degov1
from shipgrid.equipment import genset
from shipgrid.model.records import initial_of, make_record, names_of, parameter_record, record_dtype

loop = njit(error_model="numpy")  # around kernels; unlike them it may allocate


GAMMA = 1.0 - 1.0 / np.sqrt(2.0)


def pair(record, scalar="f8"):
    """A record at its initial values, and the same memory as a flat vector that can be written."""
    flat = initial_of(record).astype(scalar)
    return flat.view(record_dtype(record, scalar)).view(np.recarray)[0], flat


def jacobian(f, at):
    """Derivatives of the vector function `f` at the real vector `at`, by complex steps."""
    columns = []
    for k in range(len(at)):
        stepped = np.array(at, dtype=complex)
        stepped[k] += 1e-40j
        columns.append(np.asarray(f(stepped)).imag / 1e-40)
    return np.array(columns).T


def derivatives_of(module, item):
    """The continuous equations of a component as `f(x, u) -> dx`, flat and complex; `u` is a mapping."""
    p, _ = parameter_record(item)

    def f(x, u, t=0.0):
        (record, flat), (dx, slope) = pair(module.State, "c16"), pair(module.State, "c16")
        flat[:] = x
        module.derivatives(t, record, make_record(module.Input, u, scalar="c16"), p, dx)
        return slope

    return f


def outputs_of(module, item):
    """The outputs of a component as `g(x, u) -> {name: value}`, complex."""
    p, _ = parameter_record(item)

    def g(x, u):
        (record, flat), (y, values) = pair(module.State, "c16"), pair(module.Output, "c16")
        flat[:] = x
        module.outputs(0.0, record, make_record(module.Input, u, scalar="c16"), p, y)
        return dict(zip(names_of(module.Output), values, strict=True))

    return g


def operating_point(item, P, Q=0.0, V=1.0):
    """Steady state of the machine on a bus of V pu along alpha, by Newton on its own equations: flat state, inputs."""
    p, _ = parameter_record(item)
    f, g = derivatives_of(machine, item), outputs_of(machine, item)
    bus = {"v_alpha": V * p.V_b, "v_beta": 0.0}
    state = names_of(machine.State)
    order = [state.index(n) for n in ("psi_d", "psi_f", "psi_kd", "psi_q", "psi_kq", "theta")]

    def split(z):
        x = np.zeros(len(state), dtype=complex)
        x[order], x[state.index("omega")] = z[:6], 1.0
        return x, {**bus, "E_fd": z[6], "T_m": z[7]}

    def residual(z):
        x, u = split(z)
        y, dx = g(x, u), f(x, u)
        flows = [dx[i] / p.omega_b for i in order[:5]]
        return np.array([*flows, dx[state.index("omega")], y["p_ac"] / p.S_n - P, y["q_ac"] / p.S_n - Q])

    z = np.array([0.9, 1.1, 0.9, -0.4, -0.4, np.radians(30.0) - np.pi / 2, 2.0, P])
    for _ in range(20):
        z = z - np.linalg.solve(jacobian(residual, z), residual(z).real)
    assert np.abs(residual(z)).max() < 1e-12
    x, u = split(z)
    return x.real, {name: float(np.real(value)) for name, value in u.items()}


@loop
def machine_step(h, x, x_flat, u, p, n, work):
    """One SDIRK2 step of the machine alone, on its bus voltage (g_load < 0) or feeding a conductance g_load [S]."""
    x_1, x_1_flat, x_2, x_2_flat, bus_1, bus_2, g_load = work
    gh = GAMMA * h
    connect(gh, x, u, p, n, bus_1, g_load)
    machine.advance(gh, x, u, p, n, x_1)
    for k in range(len(x_flat)):
        x_1_flat[k] = x_flat[k] + (1.0 + np.sqrt(2.0)) * (x_1_flat[k] - x_flat[k])
    connect(gh, x_1, u, p, n, bus_2, g_load)
    machine.advance(gh, x_1, u, p, n, x_2)
    for k in range(len(x_flat)):
        x_flat[k] = x_2_flat[k]


@loop
def connect(gh, x, u, p, n, bus, g_load):
    machine.stamp(gh, x, u, p, n)
    if g_load < 0.0:
        u.v_alpha, u.v_beta = bus
        return
    a, b, c, d = n.g_aa + g_load, n.g_ab, n.g_ba, n.g_bb + g_load
    det = a * d - b * c
    u.v_alpha = (-d * n.h_a + b * n.h_b) / det
    u.v_beta = (c * n.h_a - a * n.h_b) / det


@loop
def run_on_bus(steps, h, v, x, x_flat, u, p, n, x_1, x_1_flat, x_2, x_2_flat, trace):
    """The machine on the voltages `v` [2 steps, 2]: the two stage instants of each step. Records the state."""
    for k in range(steps):
        v_1, v_2 = (v[2 * k, 0], v[2 * k, 1]), (v[2 * k + 1, 0], v[2 * k + 1, 1])
        machine_step(h, x, x_flat, u, p, n, (x_1, x_1_flat, x_2, x_2_flat, v_1, v_2, -1.0))
        trace[k] = x_flat


def on_bus(item, x_0, inputs, h, steps, voltage):
    """States of the machine after each step on the bus voltage `voltage(t) -> (alpha, beta)` [V]."""
    p, _ = parameter_record(item)
    (x, x_flat), x_1, x_2 = (pair(machine.State) for _ in range(3))
    x_flat[:] = x_0
    start = h * np.arange(steps)
    times = np.stack([start + GAMMA * h, start + h], axis=1).ravel()
    v = np.ascontiguousarray(np.broadcast_to(np.stack(np.broadcast_arrays(*voltage(times)), axis=-1), (2 * steps, 2)))
    trace = np.empty((steps, len(x_0)))
    u, n = make_record(machine.Input, inputs), np.zeros(1, NORTON).view(np.recarray)[0]
    run_on_bus(steps, h, v, x, x_flat, u, p, n, *x_1, *x_2, trace)
    return trace


@loop
def heun(derivatives, t, dt, controller, scratch):
    """One Heun step of a continuous controller, inputs held."""
    x, flat, u, p, dx, dx_flat = controller
    n = len(flat)
    old, slope = scratch[0, :n], scratch[1, :n]
    old[:] = flat
    derivatives(t, x, u, p, dx)
    slope[:] = dx_flat
    flat[:] = old + dt * slope
    derivatives(t, x, u, p, dx)
    flat[:] = old + 0.5 * dt * (slope + dx_flat)


@loop
def run_set(first, steps, h, every, g_load, generator, governor, exciter, engine, sequence, scratch, delays, trace):
    """The whole set on a conductance: sequence every 20 control periods, controls every `every` steps, machine each."""
    x, x_flat, u, p, y, n, x_1, x_1_flat, x_2, x_2_flat = generator
    g_x, _, g_u, g_p, _, _ = governor
    a_x, _, a_u, a_p, _, _ = exciter[:6]
    a_y = exciter[6]
    e_x, e_next, e_u, e_p, e_y = engine
    s_x, s_flat, s_u, s_p, s_next, s_next_flat, s_y = sequence
    dt = every * h
    for k in range(first, first + steps):
        t = k * h
        if k % (20 * every) == 0:
            s_u.omega, s_u.v_t = x.omega, y.v_t
            s_next_flat[:] = s_flat
            genset.update(t, 20 * dt, s_x, s_u, s_p, s_next, s_y)
            s_flat[:] = s_next_flat
        if k % every == 0:
            e_u.throttle, e_u.omega, e_u.fuel, e_u.crank = g_x.throttle, x.omega, s_y.fuel, s_y.crank
            diesel_engine.update(t, dt, e_x, e_u, e_p, e_next, e_y, delays)
            e_x.position = e_next.position
        u.T_m, u.E_fd = e_y.T_m, a_y.E_fd
        machine_step(h, x, x_flat, u, p, n, (x_1, x_1_flat, x_2, x_2_flat, (0.0, 0.0), (0.0, 0.0), g_load))
        machine.limit(x)
        machine.outputs(t, x, u, p, y)
        if (k + 1) % every == 0:
            g_u.omega, g_u.omega_ref, g_u.fuel = x.omega, s_x.omega_ref, s_y.fuel
            heun(governor_degov1.derivatives, t, dt, governor, scratch)
            governor_degov1.limit(g_x, g_u, g_p)
            a_u.v_t, a_u.v_ref, a_u.i_fd, a_u.on = y.v_t, s_x.v_t_ref, y.i_fd, s_y.excite
            heun(exciter_ac1a.derivatives, t, dt, exciter[:6], scratch)
            exciter_ac1a.limit(a_x, a_u, a_p)
            exciter_ac1a.outputs(t, a_x, a_u, a_p, a_y)
        row = trace[k - first]
        row[0], row[1], row[2], row[3], row[4] = s_x.state, x.omega, y.v_t, y.p_pu, e_y.T_m
        row[5], row[6], row[7], row[8] = g_x.throttle, u.E_fd, s_y.ready, s_x.refused


TRACED = ("state", "omega", "v_t", "p_pu", "T_m", "throttle", "E_fd", "ready", "refused")


class Rig:
    """A whole genset on a resistance, driven as the plant drives it."""

    h, every = 100e-6, 5  # the controls every 0.5 ms, as in the equipment

    def __init__(self, set_=None):
        item = self.item = set_ or genset.Genset()

        def continuous(module, part):
            return (*pair(module.State), make_record(module.Input), parameter_record(part)[0], *pair(module.State))

        p = parameter_record(item.machine)[0]
        self.base_conductance = item.rating / item.v_n**2
        self.generator = (
            *pair(machine.State),
            make_record(machine.Input),
            p,
            make_record(machine.Output),
            np.zeros(1, NORTON).view(np.recarray)[0],
            *pair(machine.State),
            *pair(machine.State),
        )
        self.governor = continuous(governor_degov1, item.governor)
        self.exciter = (*continuous(exciter_ac1a, item.exciter), make_record(exciter_ac1a.Output))
        self.engine = (
            make_record(diesel_engine.State),
            make_record(diesel_engine.State),
            make_record(diesel_engine.Input),
            parameter_record(item.engine)[0],
            make_record(diesel_engine.Output),
        )
        self.commands = make_record(genset.Input, {"speed_ref": 1.0, "v_ref": 1.0})
        self.sequence = (
            *pair(genset.State),
            self.commands,
            parameter_record(item.sequence)[0],
            *pair(genset.State),
            make_record(genset.Output),
        )
        self.delays = np.zeros(item.engine.delay_length(self.every * self.h))
        self.steps = 0

    def run(self, seconds, load=0.0, **commands):
        """Go on for `seconds` with `load` [pu] beside the local one; traces by name, and `t` [s]."""
        for name, value in commands.items():
            setattr(self.commands, name, value)
        n = round(seconds / self.h)
        trace = np.empty((n, len(TRACED)))
        g_load = (self.item.local_load + load) * self.base_conductance
        run_set(
            self.steps, n, self.h, self.every, g_load, self.generator, self.governor, self.exciter, self.engine,
            self.sequence, np.zeros((2, 8)), self.delays, trace,
        )  # fmt: skip
        t = self.h * (self.steps + 1 + np.arange(n))
        self.steps += n
        return SimpleNamespace(t=t, **dict(zip(TRACED, trace.T, strict=True)))
