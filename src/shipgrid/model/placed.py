"""A component in its place: where its terminals are connected, what its inputs read, and when it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shipgrid.model.component import type_of
from shipgrid.model.connections import PortBinding


@dataclass(frozen=True)
class Every:
    """A clock of period `seconds`, rounded to a whole number of steps."""

    seconds: float


@dataclass(frozen=True)
class Sampled:
    """A clock of exactly `hertz`, whose instants fall anywhere inside a step."""

    hertz: float


class Delayed(str):
    """Path of a signal read as the last instant left it: breaks a loop within one step where it may be broken."""


class WhenClosed(str):
    """Path of a signal that is 1 while an element's contact is closed and 0 while it is open."""


@dataclass
class Placed:
    """One component in its place."""

    path: str
    item: Any
    ports: dict[str, PortBinding]
    inputs: dict[str, str | float]
    initial: dict[str, float]
    clock: Every | Sampled | None
    variant: str | None
    axis_weight: float

    @property
    def positions(self) -> list[tuple[str, ...] | None]:
        """States that are held at zero, by the value of the signal `variant`; None: nothing is open."""
        held = [None, *type_of(self.item).variants.values()]
        return [held[1], held[0]] if isinstance(self.variant, WhenClosed) else held
