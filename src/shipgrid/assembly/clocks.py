"""Clocks of a plan, and the delay lines whose lengths depend on them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from shipgrid.assembly.layout import Layout
from shipgrid.errors import ParameterError
from shipgrid.model.placed import Every, Placed, Sampled
from shipgrid.model.records import names_of


class Clocks:
    """Clocks as integer arithmetic: each step adds `inc`, an instant falls where the sum passes `den`.

    Parameters
    ----------
    step : float
        Step length [s].

    Attributes
    ----------
    ratios : list of (int, int)
        `inc` and `den` of each clock.
    periods : list of float
        Period [s] of each clock.
    """

    def __init__(self, step: float):
        self.h = step
        self.ratios: list[tuple[int, int]] = []
        self.periods: list[float] = []

    def number(self, placed: Placed) -> int:
        """Number of a component's clock; components with equal clocks share one.

        Parameters
        ----------
        placed : Placed

        Raises
        ------
        ParameterError
            If the step is too long for it.
        """
        clock = placed.clock
        if clock is None:
            inc, den, period = 1, 1, self.h
        elif isinstance(clock, Every):
            den = max(1, round(clock.seconds / self.h))
            inc, period = 1, den * self.h
        else:
            assert isinstance(clock, Sampled)
            # the nearest ratios of whole numbers: 3/100000 s also for a step computed as 30 * 1e-6
            ratio = Fraction(clock.hertz).limit_denominator(10**6) * Fraction(self.h).limit_denominator(10**9)
            if ratio > 1:
                raise ParameterError(
                    f"step = {self.h:g} s is too long for {placed.path}, which is sampled at {clock.hertz:g} Hz: "
                    f"expected at most {1.0 / clock.hertz:g} s"
                )
            inc, den, period = ratio.numerator, ratio.denominator, 1.0 / clock.hertz if ratio < 1 else self.h
        if (inc, den) not in self.ratios:
            self.ratios.append((inc, den))
            self.periods.append(period)
        return self.ratios.index((inc, den))


def lay_delay_lines(layout: Layout, clocks: Clocks, clock_of: dict[str, np.ndarray]) -> dict[str, tuple[int, int]]:
    """Give each delay line its cells, first and number by path; the derived constant `line` becomes the first.

    Parameters
    ----------
    layout : Layout
        Its parameters are changed in place.
    clocks : Clocks
    clock_of : dict of str to ndarray
        Number of each instance's clock, by the key of its type.
    """
    found: dict[str, tuple[int, int]] = {}
    cells = 0
    for t in layout.types:
        if not (t.placed and hasattr(t.kind.cls, "delay_length")):
            continue
        width = len(t.parameters) // len(t.placed)
        column = width - len(names_of(t.kind.derived)) + names_of(t.kind.derived).index("line")
        for k, placed in enumerate(t.placed):
            t.parameters[k * width + column] = cells
            length = placed.item.delay_length(clocks.periods[clock_of[t.kind.key][k]])
            found[placed.path] = cells, length
            cells += length
    return found
