"""What the solver notes while it steps, as events of the run's log.

A current that has no path any more does not flow. Discontinuous conduction with few steps a carrier period has means
that are off: by how much was measured (docs/theory/conduction.md, "One switch driven").
"""

from __future__ import annotations

import math

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.model.component import type_of
from shipgrid.model.placed import Sampled
from shipgrid.solvers.companion import state_space

DISCONTINUOUS = ((2.0, 0.80), (4.0, 0.45), (8.0, 0.20), (12.0, 0.08), (20.0, 0.04))
"""Steps a carrier period up to which the mean output of a boost or buck in discontinuous conduction may be off, and by
which share of it at most: duty ratios from 0.1 to 0.85, 2 L / (R T) from 0.004, and steps that divide the period."""
KEEPS, WITHIN = 20, 0.014
"""Steps a carrier period above which it is off by that share at most."""


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
        self.stranded = [own.net.stranded_first.copy() for _, own in self.pieces]
        self.rested = [own.net.rested[:, 1].copy() for _, own in self.pieces]

    def new(self) -> list[tuple[float, str, str]]:
        """Time [s], bus or converter and text of what has been noted since the last call."""
        return self._without_path() + self._discontinuous()

    def _without_path(self) -> list[tuple[float, str, str]]:
        events = []
        for (piece, own), seen in zip(self.pieces, self.stranded, strict=True):
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

    def _discontinuous(self) -> list[tuple[float, str, str]]:
        events = []
        for (piece, own), seen in zip(self.pieces, self.rested, strict=True):
            noted = own.net.rested[:, 1]
            for legs, step, before in zip(piece.network.legs.values(), noted, seen, strict=True):
                steps = _carrier_period(piece, legs.modulator) / self.h if step != before else math.inf
                share = next((share for most, share in DISCONTINUOUS if steps <= most * (1.0 + 1e-9)), None)
                if share is not None:
                    text = (
                        f"its current comes to rest within each carrier period of {steps:.3g} steps: means may be "
                        f"off by up to {100.0 * share:.0f} %; more than {KEEPS} steps a period keep them within "
                        f"{100.0 * WITHIN:.1f} %"
                    )
                    events.append(((int(step) - 1) * self.h, legs.path, text))
            seen[:] = noted
        return events


def _carrier_period(plan: Plan, modulator: str) -> float:
    """Period [s] of the carrier of a modulator; infinite if there is no carrier with a clock of its own."""
    phase = plan.network.placed[modulator].inputs.get("phase")
    carrier = plan.network.placed.get(phase.rpartition(".")[0]) if isinstance(phase, str) else None
    return 1.0 / carrier.clock.hertz if carrier is not None and isinstance(carrier.clock, Sampled) else math.inf


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
