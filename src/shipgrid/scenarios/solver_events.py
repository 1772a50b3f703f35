"""What the solver notes while it steps, as events of the run's log: currents that have no path any more."""

from __future__ import annotations

from shipgrid.assembly.plan import Plan, Workspace
from shipgrid.model.component import type_of
from shipgrid.solvers.companion import state_space


class SolverEvents:
    """Turns the notes of a workspace into events, each once.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        What it has noted so far has been logged.
    """

    def __init__(self, plan: Plan, work: Workspace):
        self.pieces = list(zip(plan.pieces, work.pieces, strict=True))
        self.h = plan.h
        self.seen = [own.net.stranded_first.copy() for _, own in self.pieces]

    def new(self) -> list[tuple[float, str, str]]:
        """Time [s], bus and text of what has been noted since the last call."""
        events = []
        for (piece, own), seen in zip(self.pieces, self.seen, strict=True):
            first = own.net.stranded_first
            if (first == seen).all():
                continue
            named = {place: name for name, place in piece.layout.index.items()}
            nodes = [named[int(place)] for place in piece.net.node_signal]
            for step in sorted({int(n) for n, before in zip(first, seen, strict=True) if n != before}):
                island = [node for node, n in zip(nodes, first, strict=True) if n == step]
                buses = dict.fromkeys(node.rpartition(".")[0] for node in island)
                driving = " and ".join(_driving(piece, island))
                text = f"the current of {driving} has no path there: it does not flow"
                events.append(((step - 1) * self.h, " and ".join(buses), text))
            seen[:] = first
        return events


def _driving(plan: Plan, nodes: list[str]) -> list[str]:
    """Elements at some nodes whose current no voltage changes."""
    found = []
    for placed in plan.network.placed.values():
        met = {node for binding in placed.ports.values() for node in (binding.plus, binding.minus)}
        if type_of(placed.item).linear and met & set(nodes):
            space = state_space(placed.item)
            if space.sources and not len(space.A) and not space.D[:, : len(space.C)].any():
                found.append(placed.path)
    return found
