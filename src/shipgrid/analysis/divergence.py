"""Where a run broke: the equipment and the signal to look at, and why, in one sentence."""

from __future__ import annotations

import numpy as np

from shipgrid.assembly.plan import Plan, Workspace
from shipgrid.model.component import STAGES, fields_of
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
    sig, limit = work.sig, plan.step.absurd
    if unsettled.py_func(work.net.conduct):
        last = int(work.net.conduct[3])
        node = plan.net.clamp_node[-1 - last] if last < 0 else plan.net.bridge_node[last]
        bus = {int(place): name for name, place in plan.layout.index.items()}[int(plan.net.node_signal[node])]
        what = f"the diodes across {bus}" if last < 0 else f"the legs of {list(plan.network.legs)[last]}"
        return (
            f"conduction at {work.n * plan.h:.6f} s: no state of {what} agrees with its current "
            f"({bus} = {work.sig[plan.net.node_signal[node]]:.4g} V); a shorter step may find one"
        )
    when = f"diverged at {work.n * plan.h:.6f} s"
    with np.errstate(invalid="ignore"):
        absurd = ~(np.abs(sig) <= limit)
    broken = []
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
                known = not absurd[t.u + i * t.nu : t.u + (i + 1) * t.nu].any()
                broken.append((not known, len(broken), wrong[0]))
    net = plan.net
    named = {place: name for name, place in plan.layout.index.items()}
    if not net.n_nodes:
        return f"{when}: {min(broken)[2] if broken else 'no signal is absurd'}"
    volts = np.abs(sig[net.node_signal])
    node = int(np.argmax(np.where(np.isfinite(volts), volts / net.node_limit, np.inf)))
    bus = f"{named[net.node_signal[node]]} = {sig[net.node_signal[node]]:.4g} V"
    beyond = not volts[node] < net.node_limit[node]
    if broken:
        return f"{when}: {min(broken)[2]}" + (f"; {bus}" if beyond else "")
    ports = np.flatnonzero((net.port_plus == node) | (net.port_minus == node))
    what = f"{when}: {bus}, beyond {net.node_limit[node]:.4g} V"
    if not len(ports):
        return what
    worst = int(net.port_i[ports[np.argmax(np.abs(sig[net.port_i[ports]]))]])
    return f"{what}; {named[worst]} = {sig[worst]:.4g} A"


def _shown(value: float, unit: str) -> str:
    return f"{value:.4g}" + ("" if unit == "1" else f" {unit}")
