"""Network of the reference solver: (1) to (3) of `solvers/reference.py`, from elements, machines, contacts and diodes.

All elements stand side by side: their matrices are blocks of one A, B, C, D. What these become with contacts open, legs
off and switches where they are is made anew at an instant or event that changes it, and constant in between.
"""

from __future__ import annotations

import types
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipgrid.assembly.layout import ONE, Layout
from shipgrid.assembly.plan import Plan
from shipgrid.model.records import COMPLEX_STEP, names_of
from shipgrid.solvers.companion import StateSpace, state_space
from shipgrid.solvers.reference_components import Instance, state_places
from shipgrid.solvers.reference_diodes import Diodes

SINGULAR = 1e-10
"""Singular values of (2) below this share of the largest conductance count as zero."""


@dataclass(frozen=True)
class Contact:
    """Contacts of one element: which states each position holds at zero, and its matrices in each position."""

    place: int
    held: list[list[int] | None]
    states: slice
    ports: slice
    spaces: list[StateSpace]

    def position(self, sig: np.ndarray) -> int:
        """Its position; the first one where the signal has no such value.

        Parameters
        ----------
        sig : ndarray
            The flat vector.
        """
        position = int(sig[self.place])
        return position if 0 <= position < len(self.held) else 0


class ReferenceNetwork:
    """Elements and machines between their nodes, at the contacts, switches and diodes of the moment.

    Parameters
    ----------
    plan : Plan
    elements, machines : list of Instance
        Linear elements, and what has a stamp of its own.

    Attributes
    ----------
    diodes : Diodes
    now : SimpleNamespace
        Matrices of (1) to (3) as they are until the next instant or event.
    stiff, free : ndarray of int
        Numbers of the nodes with capacitance, and of the others: those of legs that are off come last.
    """

    def __init__(self, plan: Plan, elements: list[Instance], machines: list[Instance]):
        self.machines = machines
        self._join(plan.layout, elements)
        self._connect(plan, elements)

    @property
    def topology(self) -> tuple[Any, ...]:
        """States of the diodes and positions of the contacts."""
        return self.setting[:2]

    def _join(self, layout: Layout, elements: list[Instance]) -> None:
        """Matrices of all elements side by side."""
        spaces = [state_space(i.placed.item) for i in elements]
        n = sum(len(space.A) for space in spaces)
        m = sum(len(i.type.kind.terminals) for i in [*elements, *self.machines])
        self.A, self.B = np.zeros((n, n)), np.zeros((n, m))
        self.C, self.D = np.zeros((m, n)), np.zeros((m, m))
        b_source, d_source = [], []
        source_places: list[int] = []
        self.contacts: list[Contact] = []
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
                self.contacts.append(Contact(layout.place(i.placed.variant, i.path), held, states, ports, in_each))
        s = len(source_places)
        self.B_s, self.D_s = np.array(b_source).reshape(s, n).T, np.array(d_source).reshape(s, m).T
        self.source_places = np.array(source_places, dtype=np.int64)
        self.machine_port = [first_port + 2 * k for k in range(len(self.machines))]

    def _connect(self, plan: Plan, elements: list[Instance]) -> None:
        """Ports, nodes, and the places of what belongs to them."""
        network, layout = plan.network, plan.layout
        m = len(self.C)
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
        self.state_places = np.array(state_places(elements), dtype=np.int64)
        self.n_v, self.n_x = len(self.stiff), len(self.A)
        self.jumps = np.any(self.D != 0.0, axis=1)
        pole_ports = {int(place): k for k, place in enumerate(self.port_c)}
        self.diodes = Diodes(plan, pole_ports, number)
        self.setting: tuple[Any, ...] = ()

    def take_contacts(self, sig: np.ndarray) -> list[int]:
        """Take over the positions of contacts; returns the states that these hold at zero.

        Parameters
        ----------
        sig : ndarray
            The flat vector.
        """
        held, opened, positions = [], [], []
        for contact in self.contacts:
            positions.append(contact.position(sig))
            rows = contact.held[positions[-1]]
            held += rows or []
            if rows is not None and len(rows) == len(contact.spaces[0].A):
                opened.append(contact.ports)
        self.contact_state = held, opened, positions
        return held

    def update(self, sig: np.ndarray) -> None:
        """Everything of (1) to (3) that is constant until the next instant or event, unless it is at hand.

        Parameters
        ----------
        sig : ndarray
            The flat vector.
        """
        held, opened, positions = self.contact_state
        self.diodes.switch(sig)
        coefficient = sig[self.port_c]
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

    def machine_response(self, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of machine k: di/dt at zero voltage, d(di/dt)/dv, and d(dx/dt)/dv; linear in v.

        Parameters
        ----------
        k : int
            Number of the machine.
        """
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

    def project(self, sig: np.ndarray) -> None:
        """Where (3) stands for (2): bring the state onto (2) by the voltage impulse that a sudden contact makes.

        Parameters
        ----------
        sig : ndarray
            The flat vector, whose states are changed in place.
        """
        current = self.now.C @ sig[self.state_places]
        M = self.M_linear.copy()
        responses = {}
        for k in range(len(self.machines)):
            i, port = self.machines[k], self.machine_port[k]
            i.read(sig)
            i.call("outputs")
            current[port : port + 2] = [getattr(i.records["y"].top, end.i) for end in i.type.kind.terminals]
            if k in self.inductive_machines:
                responses[k] = self.machine_response(k)
                M += self.S_a[:, port : port + 2] @ responses[k][1] @ self.T_a[port : port + 2]
        lacking = self.kernel_left @ (self.S_a @ current)
        impulse = (
            self.kernel_right @ np.linalg.lstsq(self.kernel_left @ M @ self.kernel_right, -lacking, rcond=1e-10)[0]
        )
        sig[self.state_places] += self.BT_a @ impulse
        for k, (_, _, by_volt) in responses.items():
            port = self.machine_port[k]
            sig[self.machines[k].xs] += by_volt @ (self.T_a[port : port + 2] @ impulse)

    def free_voltages(self, x: np.ndarray, source: np.ndarray, current: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Voltages of the nodes without capacitance, from (2) and (3).

        Parameters
        ----------
        x : ndarray
            States of elements.
        source : ndarray
            Sources in them.
        current : ndarray
            Of each port while those voltages are zero.
        v : ndarray
            Voltages of all nodes; those of nodes with capacitance are read.
        """
        now = self.now
        sum_2 = self.S_a @ current
        if not len(self.kernel_left):
            return np.linalg.solve(self.K, -sum_2)
        rate = now.C @ (now.A @ x + now.B_s @ source + now.B @ (self.T_c @ v[self.stiff]))
        M = self.M_linear
        for k in self.inductive_machines:
            port = self.machine_port[k]
            zero, by_volt, _ = self.machine_response(k)
            rate[port : port + 2] = zero + by_volt @ (self.T_c[port : port + 2] @ v[self.stiff])
            M = M + self.S_a[:, port : port + 2] @ by_volt @ self.T_a[port : port + 2]
        L = self.kernel_left
        right = np.concatenate([-(sum_2 - L.T @ (L @ sum_2)), -self.balance * L @ (self.S_a @ rate)])
        inverse = self.inverse if self.inverse is not None else self._inverse(M)
        return inverse @ right

    def _inverse(self, M: np.ndarray) -> np.ndarray:
        """Solves (2) with (3) in the place of what it lacks; nodes that float get the least voltages."""
        return np.linalg.pinv(np.vstack([self.K, self.balance * self.kernel_left @ M]), rcond=1e-12)
