"""Before the first step: every signal that follows from the states is made to agree with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from shipgrid.assembly.layout import ONE, TypeLayout
from shipgrid.assembly.line_end import LineEnd
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.tables import type_views
from shipgrid.assembly.unit_text import NORTON
from shipgrid.assembly.workspace import Workspace
from shipgrid.model.component import type_of
from shipgrid.model.connections import PortBinding
from shipgrid.model.kernel import argument_names, call_uncompiled
from shipgrid.model.placed import Placed
from shipgrid.model.records import names_of
from shipgrid.solvers.companion import GAMMA, stage_matrices, state_space


def settle_outputs(plan: Plan, work: Workspace) -> None:
    """Evaluate the `outputs` kernels of all components once, in order, uncompiled.

    Two passes, so that what reads an output of a later stage sees it as well.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Its flat vector is changed in place.
    """
    sig = work.sig
    if plan.parts:
        for _ in range(2):
            hand_over(plan, sig)
            for part, own in zip(plan.parts, work.parts, strict=True):
                settle_outputs(part, own)
        hand_over(plan, sig)
        for own in (*work.parts, work):
            own.step.previous[:] = sig
        work.step.watched_was[:] = sig[plan.step.watched]
        return
    pairs = plan.gathers["network"]["latest"]
    for _ in range(2):
        for t in plan.ordered_types:
            kind = t.kind
            if kind.linear:
                continue
            gather = plan.gathers[kind.key]
            for name in ("measured", "latest"):
                sig[gather[name][:, 0]] = sig[gather[name][:, 1]]
            evaluate_outputs(plan, work, t)
        sig[pairs[:, 0]] = sig[pairs[:, 1]]
    work.step.previous[:] = sig
    work.step.watched_was[:] = sig[plan.step.watched]


def evaluate_outputs(plan: Plan, work: Workspace, t: TypeLayout) -> None:
    """Outputs of all components of a type, as their states and inputs are."""
    kernel = t.kind.kernels.get("outputs")
    if kernel is None:
        return
    views = type_views(plan, work, t)
    names = argument_names(kernel)
    for i in range(len(t.placed)):
        values: dict[str, Any] = {"t": 0.0, "tables": plan.step.tables, "delays": work.step.delays}
        values |= {n: views[n].view(np.recarray)[i] for n in names if n not in values}
        with np.errstate(all="ignore"):  # a machine at rest divides zero by zero where its kernel guards by inf
            call_uncompiled(kernel, values)


def hand_over(plan: Plan, sig: np.ndarray) -> None:
    """Let the parts of a plant take over what they read of each other, and each stub line carry its current.

    The waves are those of the step before, had the current changed in it at the rate at which it changes now.

    Parameters
    ----------
    plan : Plan
    sig : ndarray
        Flat vector, changed in place.
    """
    index, links = plan.layout.index, plan.step.links
    assert plan.partition is not None
    for end in (end for part in plan.partition.parts for end in part.ends if end.near):
        at = int(sig[index[end.position]]) if end.position else 0
        position = at if 0 <= at < len(end.opens) else 0
        i, slope = _current(plan, sig, end, position)
        far = _across(plan, sig, end.far_node) * plan.h / end.L
        near = far + plan.h * slope
        for k, ago in ((1, 1.0 - GAMMA), (2, 0.0)):
            then = i - ago * plan.h * slope if not end.opens[position] else 0.0
            sig[index[f"{end.name}.out_{k}"]] = near + then
            sig[index[f"{end.other}.out_{k}"]] = far - then
    for to, plus, minus in links:
        sig[to] = sig[plus] - sig[minus]


def _current(plan: Plan, sig: np.ndarray, end: LineEnd, position: int) -> tuple[float, float]:
    """Current that the element puts into a line at its near end, and the rate at which it changes."""
    path, kind, space = end.placed.path, type_of(end.placed.item), state_space(end.placed.item, position)
    x = sig[[plan.layout.slots["x", f"{path}.{name}"] for name in names_of(kind.state)]]
    u = [_across(plan, sig, end.placed.ports[terminal.name]) for terminal in kind.terminals]
    u += [sig[plan.layout.slots["u", f"{path}.{name}"]] for name in space.sources]
    sense = end.senses[0]
    return sense * x[end.row], sense * float(space.A[end.row] @ x + space.B[end.row] @ u)


def _across(plan: Plan, sig: np.ndarray, binding: PortBinding) -> float:
    """Voltage of a terminal that is connected like that."""
    plus, minus = (sig[plan.layout.index[node]] if node else 0.0 for node in (binding.plus, binding.minus))
    return (plus - minus) * (sig[plan.layout.index[binding.coefficient]] if binding.coefficient else 1.0)


VANISHING = 1e-6
"""Length of the step that finds the network's voltages, over that of the plan: what it moves is lost in rounding."""
NULL = 1e-9
"""Singular values of the nodal equations, all elements of one size, below which nothing conducts."""
EQUILIBRATIONS = 8
"""Rounds of scaling rows and columns by the roots of their largest entries: then all are 1 [Ruiz2001]."""
TINY = 1e-300
"""Largest entry of a row or column that is empty."""
ISOLATED = 1e-9
"""Conductance of everything else over an element's own below which it is isolated."""
IMPULSE = 0.01
"""Voltage that currents which do not add up make over the first step, over the limit of the bus: a tenth of nominal.
Currents at an inductance that stands for none (a stiff source) make less, and start as they are."""


def settle_network(plan: Plan, work: Workspace) -> list[str]:
    """Find the voltages of buses without capacitance, and the terminal quantities of all elements.

    One implicit Euler step of vanishing length, solved densely; states and capacitor voltages stay what they are. A
    bus that nothing defines is at zero. The `isolated` kernel of an element that nothing else meets is called.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Its flat vector is changed in place.

    Returns
    -------
    list of str
        Currents that have no path, a line each.
    """
    sig, layout = work.sig, plan.layout
    solved = _solved(plan, work, VANISHING * plan.h)
    v = solved.v
    if np.any(solved.capacitance == 0.0):
        # of an impulse, which goes with one over the length of the step, what it is over the first stage of a real one
        smooth = 2.0 * _solved(plan, work, 2.0 * VANISHING * plan.h).v - v
        v = np.where(solved.capacitance > 0.0, v, smooth + (v - smooth) * VANISHING / GAMMA)
    sig[[layout.index[name] for name in layout.nodes]] = v
    for port in solved.ports:
        voltage = port.incidence @ v
        for terminal, volt, ampere in zip(port.t.kind.terminals, voltage, port.W @ voltage + port.history, strict=True):
            sig[layout.slots["u", f"{port.placed.path}.{terminal.v}"]] = volt
            sig[layout.slots["y", f"{port.placed.path}.{terminal.i}"]] = ampere
    settle_meters(plan, sig)
    return _without_path(layout.nodes, solved) + _do_not_add_up(plan, solved)


@dataclass
class _Solved:
    """Node voltages at the end of a short implicit Euler step, and the equations they are of.

    Attributes
    ----------
    v : ndarray
        (nodes,) [V].
    capacitance : ndarray
        (nodes,) [F].
    injected : ndarray
        (nodes,) currents that the elements drive into the nodes while all voltages are zero [A].
    loose : ndarray
        (directions, nodes) patterns of voltages that drive no current anywhere.
    ports : list of _Port
    """

    v: np.ndarray
    capacitance: np.ndarray
    injected: np.ndarray
    loose: np.ndarray
    ports: list[_Port]


def _solved(plan: Plan, work: Workspace, gh: float) -> _Solved:
    sig, layout, network = work.sig, plan.layout, plan.network
    number = {name: k for k, name in enumerate(layout.nodes)}
    capacitance = np.array([network.capacitances.get(name, 0.0) for name in layout.nodes])
    start = sig[[layout.index[name] for name in layout.nodes]]
    Y = np.diag(capacitance / gh + [network.conductances.get(name, 0.0) for name in layout.nodes])
    ports = []
    for t in layout.types:
        if not t.kind.terminals:
            continue
        views = type_views(plan, work, t) if t.kind.stamped else {}
        for i, placed in enumerate(t.placed):
            bindings = [placed.ports[terminal.name] for terminal in t.kind.terminals]
            c = sig[[layout.place(b.coefficient, placed.path) if b.coefficient else ONE for b in bindings]]
            incidence = np.zeros((len(bindings), len(number)))
            for r, binding in enumerate(bindings):
                for node, sign in ((binding.plus, 1.0), (binding.minus, -1.0)):
                    if node:
                        incidence[r, number[node]] += sign
            weight = np.array([b.weight for b in bindings])
            stamp = (
                partial(_stamped, plan, work, t, i, views, gh)
                if t.kind.stamped
                else partial(_linear, plan, work, t, i, gh)
            )
            port = _Port(t, i, placed, c[:, None] * incidence, incidence.T * (weight * c), views, stamp, *stamp())
            Y += port.left @ port.W @ port.incidence
            ports.append(port)
    for port in ports:
        if "isolated" in port.t.kind.kernels and _is_isolated(Y, port):
            Y -= port.left @ port.W @ port.incidence
            _call_isolated(plan, work, port)
            port.W, port.history = port.stamp()
            Y += port.left @ port.W @ port.incidence
    injected = -sum((port.left @ port.history for port in ports), np.zeros(len(number)))
    own = np.array([network.conductances.get(name, 0.0) for name in layout.nodes])
    loose = _loose(capacitance + own, ports)
    v = _voltages(capacitance / gh + own, capacitance / gh * start, loose, ports)
    return _Solved(np.where(capacitance > 0.0, start, v), capacitance, injected, loose, ports)


def _loose(own: np.ndarray, ports: list[_Port]) -> np.ndarray:
    """Patterns of node voltages (rows, unit length) that drive no current, in elements or in what the nodes have.

    All elements count alike here, a choke of a henry and a closed contact: elements are passive for a short step, so
    that how large an admittance is does not decide where there is none.
    """
    Y = np.diag((own > 0.0).astype(float))
    for port in ports:
        largest = float(np.abs(port.W).max(initial=0.0))
        if largest > 0.0:
            Y += port.left @ (port.W / largest) @ port.incidence
    _, values, right = np.linalg.svd(Y)
    return right[values <= NULL * max(float(np.max(values, initial=0.0)), 1.0)]


def _voltages(own: np.ndarray, given: np.ndarray, loose: np.ndarray, ports: list[_Port]) -> np.ndarray:
    """Node voltages, with the elements' currents as unknowns beside them: chokes and closed contacts in series differ
    by too many powers of ten to be added up in admittances.

    Parameters
    ----------
    own : ndarray
        (nodes,) conductance of each to the reference, that of its capacitance included [S].
    given : ndarray
        (nodes,) current into each [A].
    loose : ndarray
        `_loose`; these patterns are zero in the solution.
    ports : list of _Port
    """
    nodes, size = len(own), len(own) + sum(len(port.history) for port in ports)
    injected = np.zeros(nodes)
    matrix, rhs = np.zeros((size, size)), np.zeros(size)
    matrix[:nodes, :nodes] = np.diag(own)
    rhs[:nodes] = given
    at = nodes
    for port in ports:
        here = slice(at, at + len(port.history))
        matrix[:nodes, here] = port.left
        matrix[here, here] = np.eye(len(port.history))
        matrix[here, :nodes] = -port.W @ port.incidence
        rhs[here] = port.history
        injected -= port.left @ port.history
        at = here.stop
    rhs[:nodes] -= loose.T @ (loose @ (given + injected))  # what is driven into them has no path
    matrix[:nodes, :nodes] += loose.T @ loose
    rows, columns = np.ones(size), np.ones(size)
    for _ in range(EQUILIBRATIONS):
        entries = np.abs(rows[:, None] * matrix * columns)
        rows /= np.sqrt(np.maximum(entries.max(axis=1, initial=0.0), TINY))
        columns /= np.sqrt(np.maximum(entries.max(axis=0, initial=0.0), TINY))
    matrix, rhs = rows[:, None] * matrix * columns, rows * rhs
    try:
        solution = np.linalg.solve(matrix, rhs)
    except np.linalg.LinAlgError:
        solution = np.linalg.lstsq(matrix, rhs, rcond=None)[0]
    return columns[:nodes] * solution[:nodes]


@dataclass
class _Port:
    """An element in its place, its Norton equivalent, and what makes nodal equations of it."""

    t: TypeLayout
    i: int
    placed: Placed
    incidence: np.ndarray
    left: np.ndarray
    views: dict[str, Any]
    stamp: Callable[[], tuple[np.ndarray, np.ndarray]]
    W: np.ndarray
    history: np.ndarray


def _is_isolated(Y: np.ndarray, port: _Port) -> bool:
    """Whether nothing but an element itself conducts what it would drive."""
    own = port.left @ port.W @ port.incidence
    here = np.flatnonzero(np.any(own != 0.0, axis=1))
    there = np.setdiff1d(np.arange(len(Y)), here)
    rest = Y - own
    seen = (
        rest[np.ix_(here, here)]
        - rest[np.ix_(here, there)] @ np.linalg.pinv(rest[np.ix_(there, there)], rcond=NULL) @ rest[np.ix_(there, here)]
    )
    return bool(np.all(np.abs(seen) <= ISOLATED * np.abs(own).max()))


def _call_isolated(plan: Plan, work: Workspace, port: _Port) -> None:
    kernel = port.t.kind.kernels["isolated"]
    values: dict[str, Any] = {"tables": plan.step.tables, "delays": work.step.delays}
    names = argument_names(kernel)
    values |= {n: port.views[n].view(np.recarray)[port.i] for n in names if n not in values}
    call_uncompiled(kernel, values)


def _apart(rows: np.ndarray) -> np.ndarray:
    """Rows that span the same, each with as few entries as may be: one island each (Gauss and Jordan)."""
    rows = rows.copy()
    for k in range(len(rows)):
        row, column = np.unravel_index(np.argmax(np.abs(rows[k:])), rows[k:].shape)
        rows[[k, k + row]] = rows[[k + row, k]]
        rows[k] /= rows[k, column]
        others = np.arange(len(rows)) != k
        rows[others] -= np.outer(rows[others, column], rows[k])
    return rows


def _without_path(nodes: list[str], solved: _Solved) -> list[str]:
    """Currents that are driven into nodes which nothing leaves, a line each."""
    injected, ports = solved.injected, solved.ports
    lines = []
    for direction in _apart(solved.loose):
        if abs(direction @ injected) <= 1e-6 * (np.abs(direction) @ np.abs(injected)):
            continue
        island = {k for k in range(len(nodes)) if abs(direction[k]) > 1e-6}
        driving = [
            p.placed.path for p in ports if np.any(p.history) and island & set(np.flatnonzero(np.any(p.left, axis=1)))
        ]
        where = " and ".join(f"'{nodes[k]}'" for k in sorted(island))
        lines.append(
            f"start: the current of {' and '.join(driving)} into {where} has no path: expected an element that "
            "conducts there, a closed contact or a capacitance"
        )
    return list(dict.fromkeys(lines))


def _do_not_add_up(plan: Plan, solved: _Solved) -> list[str]:
    """Buses at which inductive currents are given that do not add up, so that an impulse would have to move them."""
    index, limit = plan.layout.index, dict(zip(plan.net.node_signal.tolist(), plan.net.node_limit, strict=True))
    lines = []
    for k, node in enumerate(plan.layout.nodes):
        impulse = VANISHING * float(solved.v[k])
        if abs(impulse) < IMPULSE * limit[index[node]] or plan.network.capacitances.get(node, 0.0) > 0.0:
            continue
        met = [
            f"{port.placed.path} {current:.4g} A"
            for port in solved.ports
            for current, row in zip(port.history, port.incidence, strict=True)  # at no voltage: what is given
            if row[k] != 0.0
        ]
        lines.append(
            f"start: the currents given at '{node}' do not add up ({', '.join(met)}, counted into each): "
            f"{impulse:.3g} V over the first step would have to move them; expected currents that do, or a capacitance"
        )
    return lines


def settle_meters(plan: Plan, sig: np.ndarray) -> None:
    """Bring what bridges measure up to their switching functions, the currents of their poles and the bus voltage.

    Parameters
    ----------
    plan : Plan
        Not cut.
    sig : ndarray
        Flat vector, changed in place.
    """
    net = plan.net
    for b, legs in enumerate(plan.network.legs.values()):
        poles = slice(len(legs.poles))
        s, i = sig[net.bridge_s[b, poles]], sig[net.port_i[net.bridge_port[b, poles]]]
        current = net.bridge_weight[b] * float(s @ i)
        power = current * sig[net.node_signal[net.bridge_node[b]]]
        first = int(net.bridge_meter[b])
        sig[first : first + 6] = current, power, -current, -power, 0.0, 0.0


def settle_modulators(plan: Plan, work: Workspace) -> None:
    """Bring the outputs of averaged modulators up to what they have in force, as in a step without a new reference.

    Parameters
    ----------
    plan : Plan
        Not cut.
    work : Workspace
        Its flat vector is changed in place.
    """
    sig = work.sig
    for t in plan.layout.types:
        kernel, key = t.kind.kernels.get("modulate"), t.kind.key
        names = argument_names(kernel) if kernel is not None else ()
        if kernel is None or set(names) - {"fraction", "x", "u", "y", "p"}:
            continue
        gather = plan.gathers[key]["now"]
        sig[gather[:, 0]] = sig[gather[:, 1]]
        views = type_views(plan, work, t)
        for i in range(len(t.placed)):
            values = {n: views[n].view(np.recarray)[i] for n in names if n != "fraction"}
            call_uncompiled(kernel, values | {"fraction": -1.0})


def _linear(plan: Plan, work: Workspace, t: TypeLayout, i: int, gh: float) -> tuple[np.ndarray, np.ndarray]:
    """Admittance and history of a linear element's implicit Euler step, its contacts where they stand."""
    placed, sig = t.placed[i], work.sig
    space = state_space(placed.item)
    at = int(sig[plan.layout.place(placed.variant, placed.path)]) if placed.variant else 0
    position = placed.positions[at if 0 <= at < len(placed.positions) else 0]
    names = names_of(t.kind.state)
    held = None if position is None else tuple(names.index(name) for name in position)
    M, N, C, D, W = stage_matrices(space, gh, held)
    m = len(C)
    x = sig[t.x + i * t.nx : t.x + (i + 1) * t.nx]
    sources = sig[[plan.layout.slots["u", f"{placed.path}.{name}"] for name in space.sources]]
    return W, C @ (M @ x + N[:, m:] @ sources) + D[:, m:] @ sources


def _stamped(
    plan: Plan, work: Workspace, t: TypeLayout, i: int, views: dict[str, Any], gh: float
) -> tuple[np.ndarray, np.ndarray]:
    """Norton equivalent of a stamped device's implicit Euler step."""
    kernel = t.kind.kernels["stamp"]
    norton = np.zeros(1, NORTON).view(np.recarray)[0]
    values: dict[str, Any] = {"t": 0.0, "gh": gh, "n": norton, "tables": plan.step.tables, "delays": work.step.delays}
    values |= {n: views[n].view(np.recarray)[i] for n in argument_names(kernel) if n not in values}
    with np.errstate(all="ignore"):
        call_uncompiled(kernel, values)
    return np.array([[norton.g_aa, norton.g_ab], [norton.g_ba, norton.g_bb]]), np.array([norton.h_a, norton.h_b])
