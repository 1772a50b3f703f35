"""Diodes of the reference solver: which switch or diode of each leg conducts, from one event to the next.

Between two events every leg has one state, and the plant is a smooth differential equation:

    driven      its potential over the negative rail is s v_dc
    at lo       the diode of a current out of the leg:  s = lo,  while  i >= 0                      (1)
    at hi       the diode of a current into the leg:    s = hi,  while  i <= 0                      (2)
    off         no current:  n.i = 0,  while its potential is between lo v_dc and hi v_dc           (3)

lo and hi are what the gates leave open; between two edges 0 and 1. n is the leg's axis in the alpha-beta plane, or
the only one of a half-bridge. A leg that is off is one more node without capacitance: the unknown is its potential,
and the sum of currents there is (3). With two legs of three off no current has a way back, and both axes are such
nodes. The star point then follows from a driven leg; without one, all are off while their voltages fit into v_dc.

An event is where a condition fails. The states after it are found one leg at a time: of those that fail a condition
the first changes, and the plant is asked again. A leg whose current is zero conducts if its current then grows in the
direction that its diode allows: di/dt takes the place of i in (1) and (2). Of a passive plant that is a linear
complementarity problem with a positive matrix, in which this ends [Murty1974].

On a bus that reverses the diodes of all legs conduct, whatever their gates do, each with its resistance R_d. Of a leg

    both        v_lower = -R_d i_lower = v,  v_upper = v - v_dc = R_d i_upper,   while both currents flow      (4)
    lower       v = -R_d i,            while the upper one would carry nothing:  v <= v_dc                     (5)
    upper       v = v_dc - R_d i,      while the lower one would carry nothing:  v >= 0                        (6)

with i = i_lower - i_upper out of the leg. Its potential is one more node then, too, with the conductances of its
diodes to the poles of the bus.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from shipgrid.assembly.plan import Plan
from shipgrid.errors import SolverError
from shipgrid.model.frames import PHASES, abc_to_alpha_beta
from shipgrid.model.kernel import uncompiled

to_alpha_beta = uncompiled(abc_to_alpha_beta)

DRIVEN, AT_LO, AT_HI, OFF, BOTH = range(5)
NARROW = 1e-5
"""Bounds that are closer are one: an edge is bracketed to a millionth of a step."""
NONE_A = 1e-5
"""Current [A] that counts as none: of the size of the integration's errors."""
NONE_V = 1e-5
"""Voltage [V] by which a potential may leave its bounds before the event."""
NEAR = 10.0
"""Of so many times `NONE_A` the slope tells whether a current flows."""


@dataclass(frozen=True)
class Bridge:
    """Legs on a bus: the ports of their poles, and the axes that make leg currents and voltages of the poles'."""

    path: str
    legs: slice
    poles: list[int]
    axes: np.ndarray
    bus: int
    s: np.ndarray
    R_d: float


@dataclass(frozen=True)
class Condition:
    """Something that holds until the next event: `margin` is not below -1; else `change` are the new states."""

    margin: float
    change: dict[int, int]


class Diodes:
    """States of all legs and of all buses with legs.

    Attributes
    ----------
    state : ndarray, shape (legs,)
    reversed : dict of int to bool
        By the number of the bus's node.
    ports : set of int
        Those of poles.
    """

    def __init__(self, plan: Plan, pole_ports: dict[int, int], node_of: dict[str, int]):
        net = plan.net
        self.lo_place, self.hi_place = net.leg_lo, net.leg_hi
        self.lo, self.hi = np.zeros(len(net.leg_lo)), np.zeros(len(net.leg_lo))
        self.state = np.full(len(net.leg_lo), DRIVEN)
        self.bridges = []
        for b, legs in enumerate(plan.network.legs.values()):
            axes = np.array(list(PHASES.values())) if len(legs.poles) == 2 else np.ones((1, 1))
            s = net.bridge_s[b, : len(legs.poles)]
            bus = node_of[legs.bus.nodes[0]]
            span = slice(int(net.leg_first[b]), int(net.leg_first[b + 1]))
            poles = [pole_ports[int(k)] for k in s]
            self.bridges.append(Bridge(legs.path, span, poles, axes, bus, s, float(net.bridge_r[b])))
        self.ports = {port for bridge in self.bridges for port in bridge.poles}
        self.reversed = dict.fromkeys((bridge.bus for bridge in self.bridges), False)

    @property
    def key(self) -> tuple[bytes, ...]:
        """What the plant's matrices depend on, beside the switching functions."""
        return self.state.tobytes(), bytes(self.reversed.values())

    @property
    def any_free(self) -> bool:
        """Whether diodes decide about any leg."""
        return bool(np.any(self.state != DRIVEN))

    def take_bounds(self, sig: np.ndarray) -> None:
        """Take over what the modulators leave open; a leg that is released or blocked has no state yet: off."""
        self.lo, self.hi = sig[self.lo_place], sig[self.hi_place]
        for bridge in self.bridges:
            if not self.reversed[bridge.bus]:
                self._by_bounds(bridge)

    def _by_bounds(self, bridge: Bridge) -> None:
        state = self.state[bridge.legs]
        free = self.hi[bridge.legs] - self.lo[bridge.legs] > NARROW
        state[~free] = DRIVEN
        state[free & ((state == DRIVEN) | (state == BOTH))] = OFF

    def follow_currents(self, current: np.ndarray) -> bool:
        """Let every current that flows decide about its leg; true if a state has changed.

        Parameters
        ----------
        current : ndarray
            Of all ports, into the elements.
        """
        before = self.state.copy()
        for bridge in self.bridges:
            if self.reversed[bridge.bus]:
                continue
            state = self.state[bridge.legs]
            i = bridge.axes @ current[bridge.poles]
            free = state != DRIVEN
            state[free & (i > NONE_A)] = AT_LO
            state[free & (i < -NONE_A)] = AT_HI
            self._no_way_back(bridge)
        return not np.array_equal(self.state, before)

    def _no_way_back(self, bridge: Bridge) -> None:
        state = self.state[bridge.legs]
        if np.count_nonzero(state == OFF) >= 2:
            state[state != DRIVEN] = OFF

    def switch(self, sig: np.ndarray) -> None:
        """Write the switching functions; a leg that is off has the mean of its bounds, and a node of its own."""
        middle = 0.5 * (self.lo + self.hi)
        s = np.where(self.state == AT_LO, self.lo, np.where(self.state == AT_HI, self.hi, middle))
        on_a_reversed_bus = {AT_LO: 0.0, AT_HI: 1.0, BOTH: 0.5}
        for bridge in self.bridges:
            legs = s[bridge.legs]
            if self.reversed[bridge.bus]:
                legs = np.array([on_a_reversed_bus[int(state)] for state in self.state[bridge.legs]])
            sig[bridge.s] = legs if len(legs) == 1 else to_alpha_beta(*legs)

    def nodes(self, ports: int) -> tuple[np.ndarray, np.ndarray]:
        """How the potentials of legs that are nodes of their own act on the ports, and what conducts between them.

        Parameters
        ----------
        ports : int
            Number of ports.

        Returns
        -------
        columns : ndarray, shape (ports, nodes)
        conductance : ndarray, shape (nodes, nodes)
            Zero for legs that are off; of the diodes of reversed buses [S].
        """
        columns, blocks = [], []
        for bridge in self.bridges:
            if self.reversed[bridge.bus]:
                directions, block = np.eye(len(bridge.poles)), self._conductance(bridge)
            else:
                off = np.flatnonzero(self.state[bridge.legs] == OFF)
                directions = np.eye(len(bridge.poles)) if len(off) > 1 else bridge.axes[off]
                block = np.zeros((len(directions), len(directions)))
            for direction in directions:
                columns.append(np.zeros(ports))
                columns[-1][bridge.poles] = direction
            blocks.append(block)
        return np.array(columns).reshape(-1, ports).T, np.array(block_diag(np.zeros((0, 0)), *blocks))

    def _conductance(self, bridge: Bridge) -> np.ndarray:
        """What the legs of a reversed bus conduct, by the potentials of the poles alone: i = -G (v - s v_dc)."""
        g = np.where(self.state[bridge.legs] == BOTH, 2.0, 1.0) / bridge.R_d
        if len(g) == 1:
            return g.reshape(1, 1)
        star = np.diag(g) - np.outer(g, g) / g.sum()  # by the phases' potentials, the star point eliminated
        return 2.0 / 3.0 * bridge.axes.T @ star @ bridge.axes

    def clamp(self, nodes: int) -> np.ndarray:
        """Conductance [S] across reversed buses of the legs of which both diodes conduct, by node."""
        g = np.zeros(nodes)
        for bridge in self.bridges:
            if self.reversed[bridge.bus]:
                g[bridge.bus] += 0.5 * np.count_nonzero(self.state[bridge.legs] == BOTH) / bridge.R_d
        return g

    def conditions(
        self, current: np.ndarray, voltage: np.ndarray, node_voltage: np.ndarray, slope: np.ndarray | None = None
    ) -> Iterator[Condition]:
        """All that has to hold, as often as the states are the same in the same order.

        Parameters
        ----------
        current, voltage : ndarray
            Of all ports.
        node_voltage : ndarray
        slope : ndarray, optional
            Rates of the ports' currents; they decide where there is no current.
        """
        for bus, on in self.reversed.items():
            v = float(node_voltage[bus])
            yield Condition((-v if on else v) / NONE_V, {-1 - bus: not on})
        for bridge in self.bridges:
            first, axes = bridge.legs.start, bridge.axes
            state = self.state[bridge.legs]
            if self.reversed[bridge.bus]:
                v_dc = -float(node_voltage[bridge.bus])
                drops = bridge.R_d * (axes @ current[bridge.poles])  # in volts: the bus moves quickly
                for k, drop in enumerate(float(d) for d in drops):
                    if state[k] == BOTH:
                        yield Condition((v_dc - drop) / NONE_V, {first + k: AT_LO})
                        yield Condition((v_dc + drop) / NONE_V, {first + k: AT_HI})
                    else:
                        sign = 1.0 if state[k] == AT_LO else -1.0
                        yield Condition((sign * drop - v_dc) / NONE_V, {first + k: BOTH})
                continue
            if np.all(state == DRIVEN):
                continue
            v_dc = max(float(node_voltage[bridge.bus]), 0.0)
            i, phase = axes @ current[bridge.poles], axes @ voltage[bridge.poles]
            grows = None if slope is None else axes @ slope[bridge.poles]
            lo, hi = self.lo[bridge.legs] * v_dc, self.hi[bridge.legs] * v_dc
            on = np.flatnonzero(state != OFF)
            if len(on):
                k = on[0]
                s = {AT_LO: lo[k], AT_HI: hi[k]}.get(int(state[k]), 0.5 * (lo[k] + hi[k]))
                rail = s - phase[k] if len(state) > 1 else 0.0
            else:
                rail = 0.0
                if len(state) > 1:
                    lowest, highest = int(np.argmax(lo - phase)), int(np.argmin(hi - phase))
                    gap = (hi - phase)[highest] - (lo - phase)[lowest]
                    yield Condition(gap / NONE_V, {first + lowest: AT_LO, first + highest: AT_HI})
                    continue
            for k in range(len(state)):
                if state[k] == OFF:
                    potential = phase[k] + rail
                    yield Condition((potential - lo[k]) / NONE_V, {first + k: AT_LO})
                    yield Condition((hi[k] - potential) / NONE_V, {first + k: AT_HI})
                elif state[k] != DRIVEN:
                    sign = 1.0 if state[k] == AT_LO else -1.0
                    margin = sign * i[k] / NONE_A
                    if grows is not None and abs(margin) < NEAR:
                        margin = -np.inf if sign * grows[k] < 0.0 else 0.0
                    yield Condition(margin, {first + k: OFF})

    def change(self, condition: Condition) -> None:
        """Put the states after an event in force."""
        for which, state in condition.change.items():
            if which < 0:
                self.reversed[-1 - which] = bool(state)
                for bridge in (bridge for bridge in self.bridges if bridge.bus == -1 - which):
                    self.state[bridge.legs] = BOTH
                    if not state:
                        self._by_bounds(bridge)
            else:
                self.state[which] = state
        for bridge in self.bridges:
            if not self.reversed[bridge.bus]:
                self._no_way_back(bridge)

    def refuse_jumps(self, jumps: np.ndarray) -> None:
        """Refuse a leg that is open at an element whose current jumps with its voltage: no current decides there.

        Parameters
        ----------
        jumps : ndarray of bool
            By port.

        Raises
        ------
        SolverError
        """
        for bridge in self.bridges:
            blocked = np.any(self.state[bridge.legs] != DRIVEN) and not self.reversed[bridge.bus]
            if blocked and np.any(jumps[bridge.poles]):
                raise SolverError(f"{bridge.path} is blocked, and its poles feed a resistance: expected an inductance")
