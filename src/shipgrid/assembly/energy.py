"""Energy and power of a plant at one instant, by its components' own kernels."""

from __future__ import annotations

import numpy as np

from shipgrid.assembly.layout import TypeLayout
from shipgrid.assembly.plan import Plan, Workspace, axis_weight
from shipgrid.assembly.stiff import capacitor_path
from shipgrid.assembly.tables import type_views
from shipgrid.assembly.unit_text import LEDGERS
from shipgrid.model.kernel import argument_names, call_uncompiled
from shipgrid.solvers.companion import GAMMA


def _is_of_the_network(t: TypeLayout) -> bool:
    """Whether what a type books is a mean of the step: of an element, and of a bridge, which has only such outputs."""
    return bool(t.kind.terminals) or t.kind.stage == "network"


def powers(plan: Plan, work: Workspace) -> np.ndarray:
    """Power [W] at this instant of those entries of `Plan.energy_items` that are booked by it; 0 for means of steps."""
    found = []
    for part, own in zip((*plan.parts, plan), (*work.parts, work), strict=True):
        start = len(found)
        for t in part.layout.types:
            views = type_views(part, own, t)
            for kernel in (t.kind.kernels[ledger] for ledger in LEDGERS if ledger in t.kind.kernels):
                if _is_of_the_network(t):
                    found += [0.0] * len(t.placed)
                    continue
                names = argument_names(kernel)
                for i, placed in enumerate(t.placed):
                    values = {n: part.step.tables if n == "tables" else views[n][i] for n in names}
                    found.append(placed.axis_weight * float(call_uncompiled(kernel, values)))
        found += [0.0] * (start + part.step.n_energy - len(found))
    return np.array(found)


def stored_energy(plan: Plan, work: Workspace) -> dict[str, float]:
    """Energy [J] stored in each component and bus capacitance at this instant."""
    found = {}
    for part, own in zip(plan.pieces, work.pieces, strict=True):
        for t in part.layout.types:
            kernel = t.kind.kernels.get("stored_energy")
            if kernel is None:
                continue
            views = type_views(part, own, t)
            names = argument_names(kernel)
            for i, placed in enumerate(t.placed):
                values = {n: (part.step.tables if n == "tables" else views[n][i]) for n in names}
                found[placed.path] = placed.axis_weight * float(call_uncompiled(kernel, values))
    for end in (end for part in (plan.partition.parts if plan.partition else ()) for end in part.ends if end.near):
        # of a line what is more than the energy of the current that its element has (stub-2)
        waves = [work.sig[[plan.layout.index[f"{name}.in_{k}"] for name in (end.name, end.other)]] for k in (1, 2)]
        line = 0.25 * end.L * sum(b * float(a @ a) for b, a in zip((1.0 - GAMMA, GAMMA), waves, strict=True))
        i = float(work.sig[plan.layout.slots["x", f"{end.placed.path}.{end.state}"]])
        found[f"{end.placed.path}.surplus"] = end.placed.axis_weight * (line - 0.5 * end.L * i**2)
    for node, farad in plan.network.capacitances.items():
        path = capacitor_path(node)
        energy = 0.5 * axis_weight(node) * farad * float(work.sig[plan.layout.index[node]]) ** 2
        found[path] = found.get(path, 0.0) + energy
    return found
