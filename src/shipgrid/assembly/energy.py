"""Energy and power of a plant at one instant, by its components' own kernels."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from shipgrid.assembly.layout import TypeLayout
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.stiff import capacitor_path
from shipgrid.assembly.tables import type_views
from shipgrid.assembly.unit_text import LEDGERS
from shipgrid.assembly.workspace import Workspace
from shipgrid.model.connections import axis_weight
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


def energy_balance(
    plan: Plan, work: Workspace, before: Mapping[str, float]
) -> tuple[dict[str, dict[str, float]], float]:
    """Where the energy came from and went, by component, and the relative error of the balance.

    Parameters
    ----------
    plan, work
        A run.
    before : mapping of str to float
        `stored_energy` at its start.

    Returns
    -------
    ledgers : dict of str to dict of str to float
        `sources`, `consumers`, `losses`, `stored` (change) in joule by component path.
    error : float
        (sources - consumers - losses - stored) over the energy exchanged: what sources gave or took, each instant by
        its magnitude, what was stored in the network at the start (it may swing to and fro unseen), and of everything
        else the change of what is stored.
    """
    names = {"supplied": "sources", "consumed": "consumers", "losses": "losses"}
    ledgers: dict[str, dict[str, float]] = {"sources": {}, "consumers": {}, "losses": {}, "stored": {}}
    for (path, ledger), value in zip(plan.energy_items, work.energy, strict=True):
        place = ledgers[names[ledger]]
        short = path.removesuffix(".alpha").removesuffix(".beta")
        place[short] = place.get(short, 0.0) + float(value)
    after = stored_energy(plan, work)
    for path, value in after.items():
        short = path.removesuffix(".alpha").removesuffix(".beta")
        ledgers["stored"][short] = ledgers["stored"].get(short, 0.0) + value - before.get(path, 0.0)
    net = sum(ledgers["sources"].values()) - sum(sum(ledgers[k].values()) for k in ("consumers", "losses", "stored"))
    apart = {path for path, placed in plan.network.placed.items() if not placed.ports}  # a hull, a shaft
    exchanged = work.exchanged + sum(abs(joule) for path, joule in before.items() if path not in apart)
    exchanged += sum(abs(after[path] - before.get(path, 0.0)) for path in apart & set(after))
    if exchanged == 0.0:  # neither a source nor anything stored: what was booked at all is wrong, or nothing was
        exchanged = sum(abs(joule) for ledger in ledgers.values() for joule in ledger.values())
    return ledgers, net / exchanged if exchanged > 0.0 else 0.0
