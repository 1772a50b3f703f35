"""The error family: what can go wrong, said so that a person can put it right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


class ShipgridError(Exception):
    """Base of every error this package raises on purpose."""


class ParameterError(ShipgridError):
    """A parameter, quantity or file entry is not what is expected."""


class TopologyError(ShipgridError):
    """The network does not hang together: unknown names, unfed buses, algebraic loops."""


class SteadyStateError(ShipgridError):
    """No operating point was found."""


class SolverError(ShipgridError):
    """The simulation failed: it diverged, or left what its equations are valid for.

    Attributes
    ----------
    run : CircuitRun or None
        What a run at circuit level had computed before it failed.
    """

    run: Any = None


class RealTimeError(ShipgridError):
    """The real-time loop could not be run as asked."""


class InputErrors(ShipgridError):
    """Every mistake found in the input, at once.

    Parameters
    ----------
    problems : sequence of str
        One line each, as ``file:line: path: what is wrong, what is expected``.
    """

    def __init__(self, problems: Sequence[str]):
        self.problems = list(problems)
        super().__init__("\n".join(self.problems))
