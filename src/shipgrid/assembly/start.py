"""Before the first step: every signal that follows from the states is made to agree with them."""

from __future__ import annotations

from typing import Any

import numpy as np

from shipgrid.assembly.layout import ONE, TypeLayout
from shipgrid.assembly.partition import LineEnd
from shipgrid.assembly.plan import Plan, Workspace
from shipgrid.assembly.weave import NORTON, type_order, type_views
from shipgrid.model.component import type_of
from shipgrid.model.kernel import argument_names, call_uncompiled
from shipgrid.model.network import PortBinding
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
        for t in type_order(plan):
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
    views = dict(type_views(plan, work, t))
    names = argument_names(kernel)
    for i in range(len(t.placed)):
        values: dict[str, Any] = {"t": 0.0, "tables": plan.step.tables, "delays": work.step.delays}
        values |= {n: views[f"{t.kind.key}_{n}"].view(np.recarray)[i] for n in names if n not in values}
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


def settle_network(plan: Plan, work: Workspace) -> None:
    """Find the voltages of buses without capacitance, and the terminal quantities of all elements.

    One implicit Euler step of vanishing length, solved densely; states and capacitor voltages stay what they are. A
    bus that nothing defines is at zero.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Its flat vector is changed in place.
    """
    sig, layout, network = work.sig, plan.layout, plan.network
    gh = VANISHING * plan.h
    number = {name: k for k, name in enumerate(layout.nodes)}
    capacitance = np.array([network.capacitances.get(name, 0.0) for name in layout.nodes])
    start = sig[[layout.index[name] for name in layout.nodes]]
    Y = np.diag(capacitance / gh + [network.conductances.get(name, 0.0) for name in layout.nodes])
    rhs = capacitance / gh * start
    ports = []
    for t in layout.types:
        if not t.kind.terminals:
            continue
        views = dict(type_views(plan, work, t)) if t.kind.stamped else {}
        for i, placed in enumerate(t.placed):
            W, history = _stamped(plan, work, t, i, views, gh) if t.kind.stamped else _linear(plan, work, t, i, gh)
            bindings = [placed.ports[terminal.name] for terminal in t.kind.terminals]
            c = sig[[layout.place(b.coefficient, placed.path) if b.coefficient else ONE for b in bindings]]
            incidence = np.zeros((len(bindings), len(number)))
            for r, binding in enumerate(bindings):
                for node, sign in ((binding.plus, 1.0), (binding.minus, -1.0)):
                    if node:
                        incidence[r, number[node]] += sign
            left = incidence.T * (np.array([b.weight for b in bindings]) * c)
            Y += left @ W @ (c[:, None] * incidence)
            rhs -= left @ history
            ports.append((t, placed, c[:, None] * incidence, W, history))
    scale = 1.0 / np.sqrt(np.where(np.diag(Y) > 0.0, np.diag(Y), 1.0))
    v = scale * np.linalg.lstsq(scale[:, None] * Y * scale, scale * rhs, rcond=1e-12)[0]
    v = np.where(capacitance > 0.0, start, v)
    sig[[layout.index[name] for name in layout.nodes]] = v
    for t, placed, incidence, W, history in ports:
        voltage = incidence @ v
        for terminal, volt, ampere in zip(t.kind.terminals, voltage, W @ voltage + history, strict=True):
            sig[layout.slots["u", f"{placed.path}.{terminal.v}"]] = volt
            sig[layout.slots["y", f"{placed.path}.{terminal.i}"]] = ampere


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
    kernel, key = t.kind.kernels["stamp"], t.kind.key
    norton = np.zeros(1, NORTON).view(np.recarray)[0]
    values: dict[str, Any] = {"t": 0.0, "gh": gh, "n": norton, "tables": plan.step.tables, "delays": work.step.delays}
    values |= {n: views[f"{key}_{n}"].view(np.recarray)[i] for n in argument_names(kernel) if n not in values}
    with np.errstate(all="ignore"):
        call_uncompiled(kernel, values)
    return np.array([[norton.g_aa, norton.g_ab], [norton.g_ba, norton.g_bb]]), np.array([norton.h_a, norton.h_b])
