"""What happens during a run at circuit level: a contact opens or closes, a command or a constant input is set.

events=[At(0.1, Close("breaker")), At(0.2, Set("grid.v_pu", 0.9))]
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass

from shipgrid.assembly.plan import Plan
from shipgrid.errors import InputErrors
from shipgrid.model.component import type_of
from shipgrid.model.records import names_of


@dataclass(frozen=True)
class Open:
    """Open the contact of the element at `path`."""

    path: str


@dataclass(frozen=True)
class Close:
    """Close the contact of the element at `path`."""

    path: str


@dataclass(frozen=True)
class Set:
    """Give the command or the constant input at `path` a `value`, in SI units."""

    path: str
    value: float


@dataclass(frozen=True)
class At:
    """An `action` (`Open`, `Close` or `Set`) at a `time` [s], carried out at the step that begins there."""

    time: float
    action: Open | Close | Set


def places_to_set(plan: Plan) -> dict[str, int]:
    """What an event may set, and where it lies in the flat vector: commands, and inputs that no signal feeds."""
    layout = plan.layout
    found = {}
    for placed in plan.network.placed.values():
        kind = type_of(placed.item)
        ends = {terminal.v for terminal in kind.terminals}
        for name in names_of(kind.input):
            path = f"{placed.path}.{name}"
            if name not in ends and not isinstance(placed.inputs.get(name), str):
                found[path] = layout.slots["u", path]
    return found | {command: layout.index[f"command:{command}"] for command in plan.network.commands}


def timeline(plan: Plan, events: Iterable[At], start: float) -> list[tuple[float, str, float]]:
    """Time, path and value of each event, in order of time.

    Parameters
    ----------
    plan : Plan
    events : iterable of At
    start : float
        Time of the run's first step [s].

    Raises
    ------
    InputErrors
        All events that cannot be: before the start, or of a path that nothing can set, with the nearest that can.
    """
    known, problems, found = places_to_set(plan), [], []
    for event in events:
        action = event.action
        path = action.path if isinstance(action, Set) else f"{action.path}.close"
        value = action.value if isinstance(action, Set) else float(isinstance(action, Close))
        said = f"{event!r}: "
        if not (math.isfinite(event.time) and event.time > start - 0.5 * plan.h):
            problems.append(f"{said}the run starts at {start:g} s, expected a time from then on")
        if path not in known:
            wanted = [p for p in known if p.endswith(".close")] if not isinstance(action, Set) else list(known)
            near = difflib.get_close_matches(path, wanted, n=1)
            shown = [p if isinstance(action, Set) else p.removesuffix(".close") for p in near]
            hint = f" (nearest: '{shown[0]}')" if shown else ""
            what = "nothing can be set there" if isinstance(action, Set) else "there is no contact to operate"
            problems.append(f"{said}{what}{hint}")
        if not math.isfinite(value):
            problems.append(f"{said}the value is no number")
        found.append((event.time, path, value))
    if problems:
        raise InputErrors(problems)
    return sorted(found, key=lambda row: row[0])
