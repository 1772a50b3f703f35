"""What happens during a run at circuit level: a contact opens or closes, a command or a constant input is set.

events=[At(0.1, Close("breaker")), At(0.2, Set("grid.v_pu", 0.9))]
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from shipgrid.assembly.hand_over import places_to_set, why_not_set
from shipgrid.assembly.plan import Plan
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.names import nearest

OFF_GRID = 1e-6
"""Share of a step by which a time may lie beside the grid of the steps: what rounding leaves of a multiple."""


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


def seconds(name: str, value: Any) -> float:
    """A time [s] given as an argument.

    Parameters
    ----------
    name : str
        Of the argument.
    value : float

    Raises
    ------
    ParameterError
        If it is no number: a text, with or without a unit, say.
    """
    found = _number(value)
    if found is None:
        raise ParameterError(f"{name} = {value!r} is not a number, expected a time in seconds, such as {name}=1e-4")
    return found


def _number(value: Any) -> float | None:
    if isinstance(value, (str, bytes)):
        return None
    try:
        return float(value)
    except (TypeError, ValueError):
        return None


def with_times_asked_for(
    plan: Plan, lines: Iterable[tuple[float, str, float]], events: Iterable[tuple[float, str, str]]
) -> list[tuple[float, str, str]]:
    """Events of a log, those that were asked for between two steps with the time at which they were.

    Parameters
    ----------
    plan : Plan
    lines : iterable of (float, str, float)
        Of `timeline`: time [s], path, value.
    events : iterable of (float, str, str)
        Time [s], source, text.
    """
    steps = {(round(t / plan.h), path): t for t, path, _ in lines}
    found = []
    for t, who, what in events:
        asked = steps.get((round(t / plan.h), who), t)
        between = abs(asked - round(asked / plan.h) * plan.h) > OFF_GRID * plan.h
        found.append((t, who, f"{what}, asked for at {asked:.9g} s" if between else what))
    return found


def timeline(plan: Plan, events: Iterable[At], start: float, end: float = math.inf) -> list[tuple[float, str, float]]:
    """Time, path and value of each event, in order of time.

    Parameters
    ----------
    plan : Plan
    events : iterable of At
    start, end : float
        Time of the run's first step and of its end [s].

    Raises
    ------
    InputErrors
        All events that cannot be: before the start, after the end, or of a path that nothing can set, with the
        nearest that can.
    """
    known, problems, found = places_to_set(plan), [], []
    for event in events:
        action = event.action
        path = action.path if isinstance(action, Set) else f"{action.path}.close"
        value = action.value if isinstance(action, Set) else float(isinstance(action, Close))
        said = f"{event!r}: "
        at, value = _number(event.time), _number(value)
        if at is None or value is None:
            problems.append(
                f"{said}not numbers, expected time and value in SI units, such as At(0.1, Set(path, 750.0))"
            )
            continue
        if not (math.isfinite(at) and at > start - 0.5 * plan.h):
            problems.append(f"{said}the run starts at {start:g} s, expected a time from then on")
        elif at > end + 0.5 * plan.h:
            problems.append(f"{said}is after the end, expected at most {end:g} s (until)")
        if path not in known:
            wanted = [p for p in known if p.endswith(".close")] if not isinstance(action, Set) else list(known)
            shown = [p if isinstance(action, Set) else p.removesuffix(".close") for p in wanted]
            hint = nearest(path if isinstance(action, Set) else action.path, shown)
            what = "nothing can be set there" if isinstance(action, Set) else "there is no contact to operate"
            why = why_not_set(plan, path)
            problems.append(f"{said}{why or what + hint}")
        if not math.isfinite(value):
            problems.append(f"{said}the value is no number")
        found.append((at, path, value))
    if problems:
        raise InputErrors(problems)
    return sorted(found, key=lambda row: row[0])
