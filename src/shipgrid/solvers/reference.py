"""Reference solver: the same plant by an adaptive implicit method, slow and trusted.

It shares the kernels with the fast solver and nothing of how they are stepped: no companion matrices, no stamps, no
rule of its own. Between two instants at which something discrete happens the plant is an ordinary differential
equation of its continuous states z (voltages of capacitive nodes, states of elements and machines, states of
continuous components), which SciPy's Radau method of order five integrates to a tolerance:

    C dv/dt = -G v - S i(z)                 nodes with capacitance           (1)
    0 = G v + S i(z, v)                     the others: algebraic            (2)
    0 = S di/dt                             where (2) does not contain v     (3)

S holds, port by port, the node, its sign, the weight and the switching function. (3) is the time derivative of
(2) at a node that only inductances meet; it is linear in v, since every element's di/dt is.

What is discrete happens at its exact instant: sampled controllers, references put in force, edges of switches,
clocks of whole steps at the same multiples of the step. Components that run every step are discrete at the step by
the plan's own definition.

Switching functions are 0 or 1 (averaged: constant) in between. A modulator gives their means over any interval that
holds no instant of its own; where such a mean is not what it is over the interval's very beginning, there is an edge,
and bisection ends the interval there, to a millionth of a step. Hysteresis control predicts its edges from the
currents at the interval's beginning, which is anew after every edge and every step. What the gates leave open the
diodes decide, from one event to the next (`solvers/reference_diodes.py`): the integration is taken again from the
last step to the event, until the condition that fails there fails by less than its tolerance.
Continuous components with a slower clock, and what they read, are continuous here; so the comparison shows what
holding their inputs over a period costs.

Kernels run uncompiled, on plain Python objects: about a second of computing for a millisecond of the ferry.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.integrate import Radau

from shipgrid.assembly.layout import ONE, TypeLayout
from shipgrid.assembly.plan import Plan, Workspace
from shipgrid.errors import SolverError
from shipgrid.model.component import STAGES
from shipgrid.model.kernel import uncompiled
from shipgrid.model.ops import wrap
from shipgrid.model.records import COMPLEX_STEP, PlainRecord, names_of, parameter_dtype
from shipgrid.solvers.companion import StateSpace, state_space
from shipgrid.solvers.reference_diodes import Condition, Diodes

DIFFERENCE = 1e-7
"""Relative step of the Jacobian's forward differences: half the digits."""
UNIT_SCALE = {"V": 10.0, "A": 10.0}
"""Size of a state by its unit, for the absolute tolerance; others are per unit, angles and the like: 0.1."""
JACOBIAN_LIFE = 40
"""Segments for which a Jacobian is used again: it only steers Newton's iteration and never the result."""
EDGE = Fraction(1, 2**20)
"""How closely, in steps, an edge is bracketed: 30 ps of 30 us. Its volt-seconds are exact all the same."""
CONSTANT = 1e-7
"""Means of a switching function that differ by less are one."""
PASSES = 8
"""Most times that outputs which read each other are evaluated until none changes."""
LOOKS = 4
"""How often in a step of the integration the conditions of the diodes are looked at."""
CLOSE = 1e-14
"""Time [s] between two integrations that count as one."""
SEARCH = 60
"""Most integrations that look for one event."""
CHANGES = 100
"""Most changes of state at one event."""
SINGULAR = 1e-10
"""Singular values of (2) below this share of the largest conductance count as zero."""


@dataclass(frozen=True)
class Trajectory:
    """What a reference run found.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Instants [s], a step of the plan apart (or as many as `every` said).
    signals : dict of str to ndarray
        The chosen signals at those instants.
    """

    time: np.ndarray
    signals: dict[str, np.ndarray]

    def __getitem__(self, path: str) -> np.ndarray:
        return self.signals[path]


def reference_run(
    plan: Plan,
    work: Workspace,
    until: float,
    signals: Iterable[str] | None = None,
    *,
    every: int = 1,
    rtol: float = 1e-8,
    atol: float | None = None,
) -> Trajectory:
    """Run a plant on from any state with an adaptive solver.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Where it starts; left as it is.
    until : float
        Time of the end [s], counted as the workspace counts.
    signals : iterable of str, optional
        Paths of the signals to keep; all states and node voltages if left out.
    every : int
        Steps between two kept values.
    rtol : float
        Relative tolerance of each integration between two instants.
    atol : float, optional
        Absolute tolerance on the size of a state (10 V, 10 A, 0.1 of any other unit); `rtol` if left out.

    Returns
    -------
    Trajectory

    Raises
    ------
    SolverError
        If the integration fails, or no state of the diodes holds.
    """
    plan.refuse_parts()
    plant = _Plant(plan, work.snapshot())
    names = list(signals) if signals is not None else [*plan.layout.nodes, *sorted(plan.layout.states)]
    places = np.array([plan.layout.place(name, "reference run") for name in names], dtype=np.int64)
    end = round(until / plan.h)
    clocks = _Clocks(plan, work)
    with np.errstate(all="ignore"):  # a kernel that divides by zero gives inf or nan, as when it is compiled
        now = Fraction(work.n)
        plant.t = float(now) * plan.h
        plant.start({c: f for c, f in enumerate(work.step.clock_ahead) if f >= 0.0}, clocks)
        times, rows = [work.n * plan.h], [plant.sig[places].copy()]
        keep = work.n + every
        while now < end:
            then = plant.segment(clocks, now, min(clocks.next(), Fraction(keep), Fraction(end)))
            plant.integrate(float(now) * plan.h, float(then - now) * plan.h, rtol, rtol if atol is None else atol)
            now = then
            if now in (keep, end):
                times.append(float(now) * plan.h)
                rows.append(plant.sig[places].copy())
                keep += every
            plant.instant(float(now) * plan.h, clocks.due(now), clocks)
    table = np.array(rows)
    return Trajectory(np.array(times), {name: table[:, k] for k, name in enumerate(names)})


class _Clocks:
    """Every clock's instants, exactly, in steps."""

    def __init__(self, plan: Plan, work: Workspace):
        step = plan.step
        ratios = list(zip(step.clock_inc.tolist(), step.clock_den.tolist(), strict=True))
        self.period = [Fraction(den, inc) for inc, den in ratios]
        self.at = [
            work.n + Fraction(den - phase, inc)
            for (inc, den), phase in zip(ratios, work.step.clock_phase.tolist(), strict=True)
        ]

    def next(self) -> Fraction:
        """Step number of the nearest instant."""
        return min(self.at, default=Fraction(2**62))

    def phase(self, c: int, now: Fraction) -> float:
        """Phase of a clock between its last instant (0) and its next (1), in periods."""
        return float(1 - (self.at[c] - now) / self.period[c])

    def due(self, now: Fraction) -> dict[int, float]:
        """Clocks with an instant now, each at fraction 1 of the time since the last: nothing to interpolate."""
        found = {}
        for c, at in enumerate(self.at):
            if at == now:
                found[c] = 1.0
                self.at[c] += self.period[c]
        return found


class _Instance:
    """One component in its place: its records, and its kernels called with them."""

    def __init__(self, plan: Plan, t: TypeLayout, k: int, delays: np.ndarray):
        kind = t.kind
        self.type, self.number, self.placed = t, k, t.placed[k]
        self.path = self.placed.path
        self.xs = slice(t.x + k * t.nx, t.x + (k + 1) * t.nx)
        self.us = slice(t.u + k * t.nu, t.u + (k + 1) * t.nu)
        self.ys = slice(t.y + k * t.ny, t.y + (k + 1) * t.ny)
        self.clock = int(plan.clock_of[kind.key][k])
        records = {"x": kind.state, "u": kind.input, "y": kind.output, "dx": kind.state, "x_next": kind.state}
        self.records = {key: PlainRecord(names_of(record), np.float64(0.0)) for key, record in records.items()}
        p = PlainRecord(parameter_dtype(kind.cls).names or (), np.float64(0.0))
        p.write(t.parameters[k * len(p.names) : (k + 1) * len(p.names)])
        self.values: dict[str, Any] = {key: record.top for key, record in self.records.items()}
        self.values |= {"p": p.top, "tables": plan.step.tables, "delays": delays, "t": 0.0}
        self.kernels = {}
        for name, kernel in kind.kernels.items():
            function = uncompiled(kernel)
            self.kernels[name] = (function, function.__code__.co_varnames[: function.__code__.co_argcount])
        if not kind.linear:
            gather = plan.gathers[kind.key]
            cut = {
                name: gather[name][gather[f"{name}_start"][k] : gather[f"{name}_start"][k + 1]]
                for name in ("measured", "latest")
            }
            self.measured, self.latest = cut["measured"], cut["latest"]
            self.turns = np.isin(self.measured[:, 1], list(plan.layout.angles))  # of these the short way round
            both = np.concatenate([self.measured, self.latest])
            self.to, self.source = both[:, 0], both[:, 1]

    def gather(self, sig: np.ndarray) -> None:
        sig[self.to] = sig[self.source]

    def read(self, sig: np.ndarray, parts: str = "xuy") -> None:
        for part in parts:
            self.records[part].write(sig[getattr(self, part + "s")])

    def call(self, name: str, **extra: Any) -> Any:
        function, names = self.kernels[name]
        self.values.update(extra)
        return function(*[self.values[n] for n in names])


@dataclass(frozen=True)
class _Contact:
    """Contacts of one element: which states each position holds at zero, and its matrices in each position."""

    place: int
    held: list[list[int] | None]
    states: slice
    ports: slice
    spaces: list[StateSpace]

    def position(self, sig: np.ndarray) -> int:
        position = int(sig[self.place])
        return position if 0 <= position < len(self.held) else 0


class _Plant:
    """The plant as a differential equation between instants, and as a list of actions at them."""

    def __init__(self, plan: Plan, work: Workspace):
        self.plan, self.work, self.sig = plan, work, work.sig
        delays = work.step.delays
        self.instances = [_Instance(plan, t, k, delays) for t in plan.layout.types for k in range(len(t.placed))]
        by_type = {t.kind.key: [i for i in self.instances if i.type is t] for t in plan.layout.types}
        ordered = [i for t in plan.ordered_types for i in by_type[t.kind.key]]
        ordered.sort(key=lambda i: STAGES.index(i.type.kind.stage))
        elements = [i for i in self.instances if i.type.kind.linear]
        self.machines = [i for i in self.instances if i.type.kind.stamped]
        signal = [i for i in ordered if not i.type.kind.terminals]
        self.modulators = [i for i in signal if "modulate" in i.kernels]
        self.continuous = [i for i in signal if "derivatives" in i.kernels]
        self.live = self._live(signal)
        live = {i.path for i in self.live}
        self.discrete = [i for i in signal if "modulate" not in i.kernels and i.path not in live]
        self._network(elements)
        self.passes = PASSES
        self.rtol = self.atol = self.t = 0.0
        self.jacobians: dict[Any, tuple[np.ndarray, int]] = {}  # by contacts and diodes; segments that each has served

    def _live(self, signal: list[_Instance]) -> list[_Instance]:
        """Continuous components, and the algebraic ones that anything continuous reads, in their order."""
        owner = {}
        for i in signal:
            for k in range(i.ys.start, i.ys.stop):
                owner[k] = i
        found = {i.path for i in self.continuous}
        reads = [int(k) for i in [*self.continuous, *self.machines] for k in i.source]
        reads += [int(k) for k in self.plan.gathers["network"]["latest"][:, 1]]
        while reads:
            i = owner.get(reads.pop())
            if i is not None and i.path not in found and set(i.kernels) & {"update", "modulate"} == set():
                found.add(i.path)
                reads += [int(k) for k in i.source]
        return [i for i in signal if i.path in found]

    def _network(self, elements: list[_Instance]) -> None:
        """Matrices of all elements side by side, and the places of everything."""
        network, layout = self.plan.network, self.plan.layout
        spaces = [state_space(i.placed.item) for i in elements]
        n = sum(len(space.A) for space in spaces)
        m = sum(len(i.type.kind.terminals) for i in [*elements, *self.machines])
        self.A, self.B = np.zeros((n, n)), np.zeros((n, m))
        self.C, self.D = np.zeros((m, n)), np.zeros((m, m))
        b_source, d_source = [], []
        source_places: list[int] = []
        self.contacts: list[_Contact] = []
        first_state = first_port = 0
        for i, space in zip(elements, spaces, strict=True):
            states = slice(first_state, first_state + len(space.A))
            ports = slice(first_port, first_port + len(space.C))
            first_state, first_port = states.stop, ports.stop
            q = len(space.C)
            self.A[states, states], self.C[ports, states] = space.A, space.C
            self.B[states, ports], self.D[ports, ports] = space.B[:, :q], space.D[:, :q]
            for k, name in enumerate(space.sources):
                column_b, column_d = np.zeros(n), np.zeros(m)
                column_b[states], column_d[ports] = space.B[:, q + k], space.D[:, q + k]
                b_source.append(column_b)
                d_source.append(column_d)
                source_places.append(layout.slots["u", f"{i.path}.{name}"])
            if i.placed.variant:
                names = names_of(i.type.kind.state)
                held = [None if v is None else [states.start + names.index(x) for x in v] for v in i.placed.positions]
                in_each = [state_space(i.placed.item, k) for k in range(len(held))]
                self.contacts.append(_Contact(layout.place(i.placed.variant, i.path), held, states, ports, in_each))
        s = len(source_places)
        self.B_s, self.D_s = np.array(b_source).reshape(s, n).T, np.array(d_source).reshape(s, m).T
        self.source_places = np.array(source_places, dtype=np.int64)
        self.machine_port = []
        for _ in self.machines:
            self.machine_port.append(first_port)
            first_port += 2

        number = {name: k for k, name in enumerate(layout.nodes)}
        self.incidence, self.weight = np.zeros((m, len(number))), np.zeros(m)
        port_c, port_v, port_i = [], [], []
        for i in [*elements, *self.machines]:
            for end in i.type.kind.terminals:
                binding, k = i.placed.ports[end.name], len(port_v)
                for node, sign in ((binding.plus, 1.0), (binding.minus, -1.0)):
                    if node:
                        self.incidence[k, number[node]] += sign
                self.weight[k] = binding.weight
                port_c.append(layout.place(binding.coefficient, i.path) if binding.coefficient else ONE)
                port_v.append(layout.slots["u", f"{i.path}.{end.v}"])
                port_i.append(layout.slots["y", f"{i.path}.{end.i}"])
        self.port_c, self.port_v, self.port_i = (np.array(p, dtype=np.int64) for p in (port_c, port_v, port_i))
        self.node_places = np.array([layout.index[name] for name in layout.nodes], dtype=np.int64)
        capacitance = np.array([network.capacitances.get(name, 0.0) for name in layout.nodes])
        self.g = np.array([network.conductances.get(name, 0.0) for name in layout.nodes])
        self.stiff = np.flatnonzero(capacitance > 0.0)
        self.bare = np.flatnonzero(capacitance == 0.0)
        self.c = capacitance[self.stiff]

        def states_of(instances: list[_Instance]) -> list[int]:
            return [k for i in instances for k in range(i.xs.start, i.xs.stop)]

        self.state_places = np.array(states_of(elements), dtype=np.int64)
        live = states_of([*self.machines, *self.continuous])
        self.places = np.concatenate([self.node_places[self.stiff], self.state_places, live]).astype(np.int64)
        self.n_v, self.n_x = len(self.stiff), n
        units = {place: layout.unit.get(path, "") for path, place in layout.index.items()}
        self.size = np.array([UNIT_SCALE.get(units.get(int(p), ""), 0.1) for p in self.places])
        self.jumps = np.any(self.D != 0.0, axis=1)
        pole_ports = {int(place): k for k, place in enumerate(self.port_c)}
        self.diodes = Diodes(self.plan, pole_ports, number)
        self.live_outputs = np.array([k for i in self.live for k in range(i.ys.start, i.ys.stop)], dtype=np.int64)
        self.setting: tuple[Any, ...] = ()

    # what happens at an instant

    def start(self, pending: dict[int, float], clocks: _Clocks) -> None:
        """Bring everything up to the start: what sampled in the last step runs first, as in the fast solver."""
        for i in self.live:
            i.gather(self.sig)
            i.read(self.sig)
        self._act(0.0, pending)
        now = Fraction(self.work.n)
        self._modulate(clocks, now, EDGE)
        self._set(settle=True)

    def instant(self, t: float, due: dict[int, float], clocks: _Clocks) -> None:
        """Put references in force, then sample, in the order of the stages.

        A modulator on the clock of the steps has nothing to put in force: it follows what it reads.
        """
        for i in self.modulators:
            if i.clock in due and clocks.period[i.clock] != 1:
                i.gather(self.sig)
                i.read(self.sig)
                i.call("modulate", fraction=0.0, dt=float(EDGE) * self.plan.h, phase=0.0, phase_next=float(EDGE))
                self.sig[i.xs] = i.records["x"].read()
        if due:
            self._act(t, due)

    def segment(self, clocks: _Clocks, now: Fraction, then: Fraction) -> Fraction:
        """Until when the switching functions stay what they are, at most until `then`; they are set on the way.

        Parameters
        ----------
        clocks : _Clocks
        now, then : Fraction
            In steps.
        """
        if self.modulators:
            whole = then - now
            first = self._modulate(clocks, now, min(whole, EDGE) / 2)
            same, other = Fraction(0), whole
            if np.any(np.abs(self._modulate(clocks, now, whole) - first) > CONSTANT):
                while other - same > EDGE:
                    middle = (same + other) / 2
                    if np.any(np.abs(self._modulate(clocks, now, middle) - first) > CONSTANT):
                        other = middle
                    else:
                        same = middle
                other = min(whole, Fraction(math.ceil(other / EDGE)) * EDGE)  # a denominator that does not grow
            then = now + other
            self._modulate(clocks, now, other, keep=True)
        self._set()
        return then

    def _modulate(self, clocks: _Clocks, now: Fraction, steps: Fraction, *, keep: bool = False) -> np.ndarray:
        """Means of all switching functions over the coming `steps`; `keep`: time goes on to their end."""
        for i in self.modulators:
            i.gather(self.sig)
            i.read(self.sig)
            phase, phase_next = clocks.phase(i.clock, now), clocks.phase(i.clock, now + steps)
            dt = float(steps) * self.plan.h
            i.call("modulate", fraction=-1.0, dt=dt, phase=phase, phase_next=phase_next)
            self.sig[i.ys] = i.records["y"].read()
            if keep:
                self.sig[i.xs] = i.records["x"].read()
        return np.concatenate([self.sig[self.plan.net.leg_lo], self.sig[self.plan.net.leg_hi]])

    def _act(self, t: float, due: dict[int, float]) -> None:
        sig, before = self.sig, self.work.step.previous
        for i in self.discrete:
            f = due.get(i.clock)
            if f is None:
                continue
            i.gather(sig)
            if f != 1.0 and len(i.measured):
                to, source = i.measured[:, 0], i.measured[:, 1]
                step = sig[source] - before[source]
                step[i.turns] = uncompiled(wrap)(step[i.turns])
                sig[to] = before[source] + f * step + self.work.step.lead[source]
                sig[to[i.turns]] = uncompiled(wrap)(sig[to[i.turns]])
            i.read(sig)
            i.records["x_next"].write(sig[i.xs])
            if "update" in i.kernels:
                i.call("update", t=t, dt=self.plan.periods[i.clock])
                sig[i.xs] = i.records["x_next"].read()
                i.records["x"].write(sig[i.xs])
            if "outputs" in i.kernels:
                i.call("outputs", t=t)
            sig[i.ys] = i.records["y"].read()

    def _set(self, settle: bool = False) -> None:
        """Take over switching functions and contact positions, and make the state consistent with them."""
        sig = self.sig
        held, opened, positions = [], [], []
        for contact in self.contacts:
            positions.append(contact.position(sig))
            rows = contact.held[positions[-1]]
            held += rows or []
            if rows is not None and len(rows) == len(contact.spaces[0].A):
                opened.append(contact.ports)
        self.contact_state = held, opened, positions
        self.diodes.take_bounds(sig)
        self.diodes.refuse_jumps(self.jumps)
        self._matrices()
        sig[self.state_places[held]] = 0.0
        for i in [*self.machines, *self.continuous]:
            if "limit" in i.kernels:
                i.gather(sig)
                i.read(sig, "xu")
                i.call("limit")
                sig[i.xs] = i.records["x"].read()
        if settle:
            self.passes = PASSES
            self.rates(sig[self.places])
            sig[self.live_outputs] += 1.0  # how many passes until nothing of what stood there before is left?
            self.rates(sig[self.places])
            self.passes = max(1, self.used - 1)  # the last one found nothing new
        self._conduct()

    def _conduct(self) -> None:
        """Find the states of all diodes that hold from now on, and bring the plant into them.

        Raises
        ------
        SolverError
            If there are none.
        """
        sig = self.sig
        if self.diodes.any_free:
            self.rates(sig[self.places])
            self.diodes.follow_currents(sig[self.port_i])
        for _ in range(CHANGES):
            self._matrices()
            broken = next((c for c in self._conditions(sig[self.places], with_slope=True) if c.margin < -0.5), None)
            if broken is not None:
                self.diodes.change(broken)
                continue
            if len(self.kernel_left):
                self._project()
                self.rates(sig[self.places])
            if not self.diodes.follow_currents(sig[self.port_i]):
                return
        raise SolverError("reference run: no state of the diodes holds")

    def _conditions(self, z: np.ndarray, with_slope: bool = False) -> list[Condition]:
        """What the diodes ask for, at the state z."""
        rate, sig = self.rates(z), self.sig
        current, voltage = sig[self.port_i], sig[self.port_v]
        slope = None
        if with_slope and self.diodes.any_free:
            slope = self.now.C @ rate[self.n_v : self.n_v + self.n_x]
            for k, port in enumerate(self.machine_port):
                if port not in self.diodes.ports:
                    continue
                zero, by_volt, _ = self._machine_response(k)
                slope[port : port + 2] = zero + by_volt @ voltage[port : port + 2]
        return list(self.diodes.conditions(current, voltage, sig[self.node_places], slope))

    def _matrices(self) -> None:
        """Everything of (1) to (3) that is constant until the next instant or event, unless it is at hand."""
        held, opened, positions = self.contact_state
        self.diodes.switch(self.sig)
        coefficient = self.sig[self.port_c]
        setting = (self.diodes.key, tuple(positions), coefficient.tobytes())
        if setting == self.setting:
            return
        self.setting = setting
        A, B, C, D = self.A.copy(), self.B.copy(), self.C.copy(), self.D.copy()
        for contact, position in zip(self.contacts, positions, strict=True):
            space, q = contact.spaces[position], len(contact.spaces[position].C)
            A[contact.states, contact.states], B[contact.states, contact.ports] = space.A, space.B[:, :q]
        B_s, D_s = self.B_s.copy(), self.D_s.copy()
        A[held, :] = A[:, held] = B[held, :] = C[:, held] = B_s[held, :] = 0.0
        for ports in opened:
            D[ports] = D_s[ports] = 0.0
        floating, diodes = self.diodes.nodes(len(coefficient))  # legs that are off, say: free nodes after the others
        T = np.hstack([coefficient[:, None] * self.incidence, floating])
        S = np.hstack([(self.weight * coefficient)[:, None] * self.incidence, floating])
        self.free = np.append(self.bare, np.arange(len(self.node_places), T.shape[1]))
        g = np.append(self.g + self.diodes.clamp(len(self.g)), np.zeros(floating.shape[1]))
        self.now = types.SimpleNamespace(A=A, B=B, C=C, D=D, B_s=B_s, D_s=D_s, T=T, g=g)
        self.T_a, self.T_c, self.S_a, self.S_c = T[:, self.free], T[:, self.stiff], S.T[self.free], S.T[self.stiff]
        K = np.diag(g[self.free]) + self.S_a @ D @ self.T_a
        K[len(self.bare) :, len(self.bare) :] += diodes
        left, values, right = np.linalg.svd(K)
        null = values <= SINGULAR * max(float(np.max(values, initial=0.0)), 1e-6)
        self.K = K
        self.kernel_left, self.kernel_right = left[:, null].T, right[null].T
        self.BT_a = B @ self.T_a
        self.M_linear = self.S_a @ C @ self.BT_a
        touched = np.abs(self.kernel_left @ self.S_a) if len(self.kernel_left) else np.zeros((0, len(T)))
        self.inductive_machines = [k for k, p in enumerate(self.machine_port) if np.any(touched[:, p : p + 2] != 0.0)]
        scale = max(float(np.max(np.abs(self.M_linear), initial=0.0)), 1.0)
        self.balance = 1.0 / scale  # brings (3) to the size of a conductance
        self.inverse = None if self.inductive_machines else self._inverse(self.M_linear)

    def _machine_response(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of machine k: di/dt at zero voltage, d(di/dt)/dv, and d(dx/dt)/dv; linear in v."""
        i = self.machines[k]
        u, x, dx, y = (i.records[name] for name in ("u", "x", "dx", "y"))
        v = [end.v for end in i.type.kind.terminals]
        ends = [end.i for end in i.type.kind.terminals]
        kept_u, kept_x, kept_y = u.read(), np.array(x.read()), y.read()
        slopes, currents = [], []
        for volt in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
            for name, value in zip(v, volt, strict=True):
                setattr(u.top, name, np.float64(value))
            x.write(kept_x)
            i.call("derivatives")
            slope = np.array(dx.read())
            x.write(kept_x + 1j * COMPLEX_STEP * slope)
            i.call("outputs")
            slopes.append(slope)
            currents.append(np.imag([getattr(y.top, name) for name in ends]) / COMPLEX_STEP)
        u.write(kept_u)
        x.write(kept_x)
        y.write(kept_y)
        zero, alpha, beta = currents
        return zero, np.column_stack([alpha - zero, beta - zero]), np.column_stack([s - slopes[0] for s in slopes[1:]])

    def _project(self) -> None:
        """Where (3) stands for (2): bring the state onto (2) by the voltage impulse that a sudden contact makes."""
        sig = self.sig
        current = self.now.C @ sig[self.state_places]
        M = self.M_linear.copy()
        responses = {}
        for k in range(len(self.machines)):
            i, port = self.machines[k], self.machine_port[k]
            i.read(sig)
            i.call("outputs")
            current[port : port + 2] = [getattr(i.records["y"].top, end.i) for end in i.type.kind.terminals]
            if k in self.inductive_machines:
                responses[k] = self._machine_response(k)
                M += self.S_a[:, port : port + 2] @ responses[k][1] @ self.T_a[port : port + 2]
        lacking = self.kernel_left @ (self.S_a @ current)
        impulse = (
            self.kernel_right @ np.linalg.lstsq(self.kernel_left @ M @ self.kernel_right, -lacking, rcond=1e-10)[0]
        )
        sig[self.state_places] += self.BT_a @ impulse
        for k, (_, _, by_volt) in responses.items():
            port = self.machine_port[k]
            sig[self.machines[k].xs] += by_volt @ (self.T_a[port : port + 2] @ impulse)

    # what happens between instants

    def rates(self, z: np.ndarray) -> np.ndarray:
        """dz/dt, everything else brought up to date with z on the way."""
        sig, now = self.sig, self.now
        sig[self.places] = z
        x = z[self.n_v : self.n_v + self.n_x]
        v = np.zeros(now.T.shape[1])
        v[self.stiff] = z[: self.n_v]
        for i in self.live:
            i.read(sig, "x")
        for i in self.machines:
            i.read(sig, "x")
        machine_current = np.zeros(len(self.port_c))
        for k, i in enumerate(self.machines):  # their currents follow from their states alone
            i.gather(sig)
            i.read(sig, "u")
            i.call("outputs")
            top, port = i.records["y"].top, self.machine_port[k]
            machine_current[port : port + 2] = [getattr(top, end.i) for end in i.type.kind.terminals]
        source, port_v, current = self._pass(x, v, machine_current)
        self.used = 1
        while self.used < self.passes:
            before = sig.copy() if self.passes == PASSES else None
            source, port_v, current = self._pass(x, v, machine_current)
            self.used += 1
            if before is not None and np.array_equal(sig, before, equal_nan=True):
                break
        rate = np.empty(len(z))
        rate[: self.n_v] = (-now.g[self.stiff] * v[self.stiff] - self.S_c @ current) / self.c
        rate[self.n_v : self.n_v + self.n_x] = now.A @ x + now.B @ port_v + now.B_s @ source
        k = self.n_v + self.n_x
        for i in self.machines:
            i.call("derivatives")
            found = i.records["dx"].read()
            rate[k : k + len(found)] = found
            k += len(found)
        for i in self.continuous:
            i.gather(sig)
            i.read(sig, "u")
            i.call("derivatives", t=self.t)
            found = i.records["dx"].read()
            rate[k : k + len(found)] = found
            k += len(found)
        return rate

    def _pass(
        self, x: np.ndarray, v: np.ndarray, machine_current: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Everything once, in order: returns sources, port voltages, port currents; completes `v`."""
        sig, now, pairs = self.sig, self.now, self.plan.gathers["network"]["latest"]
        for i in self.live:
            if "outputs" in i.kernels:
                i.gather(sig)
                i.read(sig, "u")
                i.call("outputs", t=self.t)
                sig[i.ys] = i.records["y"].read()
        sig[pairs[:, 0]] = sig[pairs[:, 1]]
        source = sig[self.source_places]
        current = now.C @ x + now.D_s @ source + now.D @ (self.T_c @ v[self.stiff]) + machine_current
        if len(self.free):
            v[self.free] = self._free_voltages(x, source, current, v)
        port_v = now.T @ v
        current += now.D @ (self.T_a @ v[self.free])
        sig[self.port_v], sig[self.port_i], sig[self.node_places] = port_v, current, v[: len(self.node_places)]
        for i in self.machines:
            i.gather(sig)
            i.read(sig, "u")
            i.call("outputs")
            sig[i.ys] = i.records["y"].read()
        return source, port_v, current

    def _free_voltages(self, x: np.ndarray, source: np.ndarray, current: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Voltages of the nodes without capacitance, from (2) and (3)."""
        now = self.now
        sum_2 = self.S_a @ current
        if not len(self.kernel_left):
            return np.linalg.solve(self.K, -sum_2)
        rate = now.C @ (now.A @ x + now.B_s @ source + now.B @ (self.T_c @ v[self.stiff]))
        M = self.M_linear
        for k in self.inductive_machines:
            port = self.machine_port[k]
            zero, by_volt, _ = self._machine_response(k)
            rate[port : port + 2] = zero + by_volt @ (self.T_c[port : port + 2] @ v[self.stiff])
            M = M + self.S_a[:, port : port + 2] @ by_volt @ self.T_a[port : port + 2]
        L = self.kernel_left
        right = np.concatenate([-(sum_2 - L.T @ (L @ sum_2)), -self.balance * L @ (self.S_a @ rate)])
        inverse = self.inverse if self.inverse is not None else self._inverse(M)
        return inverse @ right

    def _inverse(self, M: np.ndarray) -> np.ndarray:
        """Solves (2) with (3) in the place of what it lacks; nodes that float get the least voltages."""
        return np.linalg.pinv(np.vstack([self.K, self.balance * self.kernel_left @ M]), rcond=1e-12)

    def integrate(self, t: float, seconds: float, rtol: float, atol: float) -> None:
        """From the instant `t` to the next, over the events in between; time is counted so that it keeps its digits."""
        self.rtol, self.atol = rtol, atol
        gone = 0.0
        while gone < seconds:
            gone += self._to_event(t + gone, seconds - gone)
            if gone < seconds:
                self._conduct()

    def _to_event(self, t: float, seconds: float) -> float:
        """To the first event of the diodes, at most `seconds` on: returns how far."""
        z = self.sig[self.places]
        margins = np.array([c.margin for c in self._conditions(z)])
        floor = np.minimum(margins, 0.0) - 1.0
        looks = LOOKS if self.diodes.any_free else 1

        def excess(at: float, z: np.ndarray) -> float:
            """By how many of their tolerances the conditions hold at a time from here, or fail."""
            self.t = t + at
            return float(np.min(np.array([c.margin for c in self._conditions(z)]) - floor, initial=np.inf))

        topology = self.setting[:2]
        if topology in self.jacobians:
            jacobian, age = self.jacobians[topology]
            self.jacobians[topology] = jacobian, age + 1
        solver = self._solver(t, z, seconds)
        good, left = float(np.min(margins - floor, initial=np.inf)), 0.0
        while solver.status == "running":
            start, z = solver.t, solver.y
            _step(solver, t)
            between = solver.dense_output()
            for at in np.linspace(start, solver.t, looks + 1)[1:].tolist():
                found = excess(at, solver.y if at == solver.t else between(at))
                if found < 0.0:
                    return self._land(t, (start, z), (left, good), (at, found), excess)
                left, good = at, found
        return seconds

    def _land(
        self,
        t: float,
        start: tuple[float, np.ndarray],
        low: tuple[float, float],
        high: tuple[float, float],
        excess: Callable[[float, np.ndarray], float],
    ) -> float:
        """Integrate to where a condition fails by less than one tolerance: returns when, counted from t.

        Parameters
        ----------
        t : float
            Origin of the times [s].
        start : (float, ndarray)
            Time and state from which to integrate.
        low, high : (float, float)
            Time and `excess` before the event, and after it.
        excess : callable
        """
        (a, f_a), (b, f_b) = (low[0], low[1] + 0.5), (high[0], high[1] + 0.5)
        side = 0
        for _ in range(SEARCH):
            at = b - f_b * (b - a) / (f_b - f_a) if f_b < 0.0 and b - a > CLOSE else b
            solver = self._solver(t + start[0], start[1], at - start[0])
            while solver.status == "running":
                _step(solver, t)
            found = excess(at, solver.y) + 0.5
            if abs(found) < 0.5 or at == b:
                return at
            if found < 0.0:  # false position, the end that stays counting half [Dowell1971]
                b, f_b, f_a, side = at, found, f_a * (0.5 if side < 0 else 1.0), -1
            else:
                a, f_a, f_b, side = at, found, f_b * (0.5 if side > 0 else 1.0), 1
        raise SolverError(f"reference run: no event of a diode found at {t:.9f} s")

    def _solver(self, t: float, z: np.ndarray, seconds: float) -> Radau:
        """The integration from z on, at the time t."""
        asked_at, topology = -1.0, self.setting[:2]

        def slope(at: float, z: np.ndarray) -> np.ndarray:
            """The last Jacobian, unless it is old, or Newton's iteration failed with it (it is asked for again)."""
            nonlocal asked_at
            jacobian, age = self.jacobians.get(topology, (None, JACOBIAN_LIFE))
            if jacobian is None or age >= JACOBIAN_LIFE or at == asked_at:
                jacobian = self._jacobian(z)
                self.jacobians[topology] = jacobian, 0
            asked_at = at
            return jacobian

        def right(at: float, z: np.ndarray) -> np.ndarray:
            self.t = t + at
            return self.rates(z)

        scale: Any = self.atol * self.size  # SciPy takes an array, its types do not say so
        return Radau(right, 0.0, z, seconds, rtol=self.rtol, atol=scale, jac=slope, first_step=seconds)

    def _jacobian(self, z: np.ndarray) -> np.ndarray:
        base = self.rates(z)
        found = np.empty((len(z), len(z)))
        for k in range(len(z)):
            step = DIFFERENCE * max(abs(z[k]), self.size[k])
            moved = z.copy()
            moved[k] += step
            found[:, k] = (self.rates(moved) - base) / step
        return found


def _step(solver: Radau, t: float) -> None:
    message = solver.step()
    if solver.status == "failed":
        raise SolverError(f"reference run failed at {t + solver.t:.9f} s: {message}")
