"""Clocks of the reference solver: their instants as exact fractions of a step."""

from __future__ import annotations

from fractions import Fraction

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace


class ReferenceClocks:
    """Every clock's instants, exactly, in steps.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Where a run starts.

    Attributes
    ----------
    period : list of Fraction
        Of each clock.
    at : list of Fraction
        Step number of the next instant of each.
    """

    def __init__(self, plan: Plan, work: Workspace):
        step = plan.step
        ratios = list(zip(step.clock_inc.tolist(), step.clock_den.tolist(), strict=True))
        self.period = [Fraction(den, inc) for inc, den in ratios]
        self.at = [
            work.n + Fraction(den - phase, inc)
            for (inc, den), phase in zip(ratios, work.step.clock_phase.tolist(), strict=True)
        ]

    def next(self) -> Fraction:
        """Step number of the nearest instant."""
        return min(self.at, default=Fraction(2**62))

    def phase(self, c: int, now: Fraction) -> float:
        """Phase of a clock between its last instant (0) and its next (1), in periods.

        Parameters
        ----------
        c : int
            Number of the clock.
        now : Fraction
            Step number.
        """
        return float(1 - (self.at[c] - now) / self.period[c])

    def due(self, now: Fraction) -> dict[int, float]:
        """Clocks with an instant now, each at fraction 1 of the time since the last: nothing to interpolate.

        Their next instants are a period later from then on.

        Parameters
        ----------
        now : Fraction
            Step number.
        """
        found = {}
        for c, at in enumerate(self.at):
            if at == now:
                found[c] = 1.0
                self.at[c] += self.period[c]
        return found
