"""Plant of the reference solver: a differential equation between instants, and a list of actions at them.

The equations are those of `solvers/reference.py`; of them `solvers/reference_network.py` solves (2) and (3).
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.errors import SolverError
from shipgrid.model.component import STAGES
from shipgrid.model.kernel import uncompiled
from shipgrid.model.ops import wrap
from shipgrid.solvers.reference_clocks import ReferenceClocks
from shipgrid.solvers.reference_components import Instance, state_places
from shipgrid.solvers.reference_diodes import Condition
from shipgrid.solvers.reference_network import ReferenceNetwork

UNIT_SCALE = {"V": 10.0, "A": 10.0}
"""Size of a state by its unit, for the absolute tolerance; others are per unit, angles and the like: 0.1."""
EDGE = Fraction(1, 2**20)
"""How closely, in steps, an edge is bracketed: 30 ps of 30 us. Its volt-seconds are exact all the same."""
CONSTANT = 1e-7
"""Means of a switching function that differ by less are one."""
PASSES = 8
"""Most times that outputs which read each other are evaluated until none changes."""
CHANGES = 100
"""Most changes of state at one event."""


class ReferencePlant:
    """The plant as a differential equation between instants, and as a list of actions at them.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Where a run starts; its flat vector is changed in place.

    Attributes
    ----------
    network : ReferenceNetwork
    places : ndarray of int
        Places of the continuous states z.
    size : ndarray
        Size of each.
    t : float
        Time [s] that kernels are told.
    """

    def __init__(self, plan: Plan, work: Workspace):
        self.plan, self.work, self.sig = plan, work, work.sig
        delays = work.step.delays
        self.instances = [Instance(plan, t, k, delays) for t in plan.layout.types for k in range(len(t.placed))]
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
        self.network = ReferenceNetwork(plan, elements, self.machines)
        self._place_states()
        self.passes = PASSES
        self.t = 0.0

    def _live(self, signal: list[Instance]) -> list[Instance]:
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

    def _place_states(self) -> None:
        """Places and sizes of the continuous states, and places of what follows from them."""
        network, layout = self.network, self.plan.layout
        live = state_places([*self.machines, *self.continuous])
        self.places = np.concatenate([network.node_places[network.stiff], network.state_places, live]).astype(np.int64)
        units = {place: layout.unit.get(path, "") for path, place in layout.index.items()}
        self.size = np.array([UNIT_SCALE.get(units.get(int(p), ""), 0.1) for p in self.places])
        self.live_outputs = np.array([k for i in self.live for k in range(i.ys.start, i.ys.stop)], dtype=np.int64)

    # what happens at an instant

    def start(self, pending: dict[int, float], clocks: ReferenceClocks) -> None:
        """Bring everything up to the start: what sampled in the last step runs first, as in the fast solver.

        Parameters
        ----------
        pending : dict of int to float
            Clocks with an instant in the last step, and at which fraction of it.
        clocks : ReferenceClocks
        """
        for i in self.live:
            i.gather(self.sig)
            i.read(self.sig)
        self._act(0.0, pending)
        now = Fraction(self.work.n)
        self._modulate(clocks, now, EDGE)
        self._set(settle=True)

    def instant(self, t: float, due: dict[int, float], clocks: ReferenceClocks) -> None:
        """Put references in force, then sample, in the order of the stages.

        A modulator on the clock of the steps has nothing to put in force: it follows what it reads.

        Parameters
        ----------
        t : float
            Time [s].
        due : dict of int to float
            What `ReferenceClocks.due` gives.
        clocks : ReferenceClocks
        """
        for i in self.modulators:
            if i.clock in due and clocks.period[i.clock] != 1:
                i.gather(self.sig)
                i.read(self.sig)
                i.call("modulate", fraction=0.0, dt=float(EDGE) * self.plan.h, phase=0.0, phase_next=float(EDGE))
                self.sig[i.xs] = i.records["x"].read()
        if due:
            self._act(t, due)

    def segment(self, clocks: ReferenceClocks, now: Fraction, then: Fraction) -> Fraction:
        """Until when the switching functions stay what they are, at most until `then`; they are set on the way.

        Parameters
        ----------
        clocks : ReferenceClocks
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

    def _modulate(self, clocks: ReferenceClocks, now: Fraction, steps: Fraction, *, keep: bool = False) -> np.ndarray:
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
        sig, net = self.sig, self.network
        held = net.take_contacts(sig)
        net.diodes.take_bounds(sig)
        net.diodes.refuse_jumps(net.jumps)
        net.update(sig)
        sig[net.state_places[held]] = 0.0
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
        self.conduct()

    def conduct(self) -> None:
        """Find the states of all diodes that hold from now on, and bring the plant into them.

        Raises
        ------
        SolverError
            If there are none.
        """
        sig, net = self.sig, self.network
        if net.diodes.any_free:
            self.rates(sig[self.places])
            net.diodes.follow_currents(sig[net.port_i])
        for _ in range(CHANGES):
            net.update(sig)
            broken = next((c for c in self.conditions(sig[self.places], with_slope=True) if c.margin < -0.5), None)
            if broken is not None:
                net.diodes.change(broken)
                continue
            if len(net.kernel_left):
                net.project(sig)
                self.rates(sig[self.places])
            if not net.diodes.follow_currents(sig[net.port_i]):
                return
        raise SolverError("reference run: no state of the diodes holds")

    def conditions(self, z: np.ndarray, with_slope: bool = False) -> list[Condition]:
        """What the diodes ask for, at the state z.

        Parameters
        ----------
        z : ndarray
        with_slope : bool
            Whether to ask di/dt where a current that is zero goes.
        """
        rate, sig, net = self.rates(z), self.sig, self.network
        current, voltage = sig[net.port_i], sig[net.port_v]
        slope = None
        if with_slope and net.diodes.any_free:
            slope = net.now.C @ rate[net.n_v : net.n_v + net.n_x]
            for k, port in enumerate(net.machine_port):
                if port not in net.diodes.ports:
                    continue
                zero, by_volt, _ = net.machine_response(k)
                slope[port : port + 2] = zero + by_volt @ voltage[port : port + 2]
        return list(net.diodes.conditions(current, voltage, sig[net.node_places], slope))

    # what happens between instants

    def rates(self, z: np.ndarray) -> np.ndarray:
        """dz/dt, everything else brought up to date with z on the way.

        Parameters
        ----------
        z : ndarray
            Continuous states, in the order of `places`.
        """
        sig, net, now = self.sig, self.network, self.network.now
        sig[self.places] = z
        x = z[net.n_v : net.n_v + net.n_x]
        v = np.zeros(now.T.shape[1])
        v[net.stiff] = z[: net.n_v]
        for i in self.live:
            i.read(sig, "x")
        for i in self.machines:
            i.read(sig, "x")
        machine_current = np.zeros(len(net.port_c))
        for k, i in enumerate(self.machines):  # their currents follow from their states alone
            i.gather(sig)
            i.read(sig, "u")
            i.call("outputs")
            top, port = i.records["y"].top, net.machine_port[k]
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
        rate[: net.n_v] = (-now.g[net.stiff] * v[net.stiff] - net.S_c @ current) / net.c
        rate[net.n_v : net.n_v + net.n_x] = now.A @ x + now.B @ port_v + now.B_s @ source
        k = net.n_v + net.n_x
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
        sig, net, now = self.sig, self.network, self.network.now
        pairs = self.plan.gathers["network"]["latest"]
        for i in self.live:
            if "outputs" in i.kernels:
                i.gather(sig)
                i.read(sig, "u")
                i.call("outputs", t=self.t)
                sig[i.ys] = i.records["y"].read()
        sig[pairs[:, 0]] = sig[pairs[:, 1]]
        source = sig[net.source_places]
        current = now.C @ x + now.D_s @ source + now.D @ (net.T_c @ v[net.stiff]) + machine_current
        if len(net.free):
            v[net.free] = net.free_voltages(x, source, current, v)
        port_v = now.T @ v
        current += now.D @ (net.T_a @ v[net.free])
        sig[net.port_v], sig[net.port_i], sig[net.node_places] = port_v, current, v[: len(net.node_places)]
        for i in self.machines:
            i.gather(sig)
            i.read(sig, "u")
            i.call("outputs")
            sig[i.ys] = i.records["y"].read()
        return source, port_v, current
