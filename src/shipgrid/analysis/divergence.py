"""Where a run broke: the equipment and the signal to look at, and why, in one sentence."""

from __future__ import annotations

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.model.component import STAGES, fields_of
from shipgrid.model.kernel import uncompiled
from shipgrid.solvers.conduction import unsettled


def culprit(plan: Plan, work: Workspace) -> str:
    """Say where a run broke: the component that first gave something absurd or no number, or the bus beyond its limit.

    A step's stages run in order, so that of the components with such a value the origin is the first whose inputs still
    are plausible. A voltage beyond its limit is named with the element that drives most current.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        As the step that failed left it.
    """
    t = work.n * plan.h
    pieces = list(zip(plan.pieces, work.pieces, strict=True))
    found = [text for piece in pieces if (text := _unsettled(*piece, t))]
    if found:
        return found[0]
    broken = [entry for piece in pieces for entry in _broken(*piece)]
    beyond = [entry for piece in pieces for entry in _beyond(*piece)]
    when = f"diverged at {t:.6f} s"
    if broken:
        first = min(range(len(broken)), key=lambda k: (broken[k][0], k))
        return f"{when}: {broken[first][1]}" + (f"; {max(beyond)[1]}" if beyond else "")
    if not beyond:
        return f"{when}: no signal is absurd"
    _, bus, limit, driven = max(beyond)
    return f"{when}: {bus}, beyond {limit:.4g} V" + (f"; {driven}" if driven else "")


def _unsettled(plan: Plan, work: Workspace, t: float) -> str:
    """What no state of the legs agrees with, if there is such a bridge or bus."""
    if not uncompiled(unsettled)(work.net.conduct):
        return ""
    last = int(work.net.conduct[3])
    node = plan.net.clamp_node[-1 - last] if last < 0 else plan.net.bridge_node[last]
    bus = {int(place): name for name, place in plan.layout.index.items()}[int(plan.net.node_signal[node])]
    what = f"the diodes across {bus}" if last < 0 else f"the legs of {list(plan.network.legs)[last]}"
    return (
        f"conduction at {t:.6f} s: no state of {what} agrees with its current "
        f"({bus} = {work.sig[plan.net.node_signal[node]]:.4g} V); a shorter step may find one"
    )


def _broken(plan: Plan, work: Workspace) -> list[tuple[bool, str]]:
    """Components with an absurd value, in the order of the stages: whether their inputs are absurd too, and which."""
    sig, step = work.sig, plan.step
    limit = np.full(len(sig), np.inf)
    limit[step.audited_from : step.audited_from + len(step.absurd)] = step.absurd
    with np.errstate(invalid="ignore"):
        absurd = ~(np.abs(sig) <= limit)
    found = []
    for t in sorted(plan.layout.types, key=lambda t: STAGES.index(t.kind.stage)):
        for i, placed in enumerate(t.placed):
            own = [(t.x + i * t.nx + k, f) for k, f in enumerate(fields_of(t.kind.state))]
            own += [(t.y + i * t.ny + k, f) for k, f in enumerate(fields_of(t.kind.output))]
            wrong = [
                f"{placed.path}.{f.name} = {_shown(sig[k], f.unit)} ({f.signal.description})"
                + (f", beyond {_shown(limit[k], f.unit)}" if np.isfinite(sig[k]) else "")
                for k, f in own
                if absurd[k]
            ]
            if wrong:
                found.append((bool(absurd[t.u + i * t.nu : t.u + (i + 1) * t.nu].any()), wrong[0]))
    return found


def _beyond(plan: Plan, work: Workspace) -> list[tuple[float, str, float, str]]:
    """The bus furthest beyond its limit, if one is: how far, which, the limit, and the largest current there."""
    net, sig = plan.net, work.sig
    if not net.n_nodes:
        return []
    volts = np.abs(sig[net.node_signal])
    far = np.where(np.isfinite(volts), volts / net.node_limit, np.inf)
    node = int(np.argmax(far))
    if volts[node] < net.node_limit[node]:
        return []
    named = {place: name for name, place in plan.layout.index.items()}
    ports = np.flatnonzero((net.port_plus == node) | (net.port_minus == node))
    driven = ""
    if len(ports):
        worst = int(net.port_i[ports[np.argmax(np.abs(sig[net.port_i[ports]]))]])
        driven = f"{named[worst]} = {sig[worst]:.4g} A"
    bus = f"{named[net.node_signal[node]]} = {sig[net.node_signal[node]]:.4g} V"
    return [(float(far[node]), bus, float(net.node_limit[node]), driven)]


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g}" + ("" if unit == "1" else f" {unit}")
