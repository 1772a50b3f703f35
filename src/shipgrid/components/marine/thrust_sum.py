"""Sum of two thrusts: a chain of them adds up any number of screws.

total = first + second          (1)
"""

from __future__ import annotations

from shipgrid.model import component, kernel, signal
from shipgrid.units import Newton


class Input:
    first: Newton = signal("one thrust, or the sum so far")
    second: Newton = signal("another thrust")


class Output:
    total: Newton = signal("both together")


@kernel
def outputs(u: Input, y: Output):
    y.total = u.first + u.second  # (1)


@component(input=Input, output=Output, stage="measure", outputs=outputs)
class ThrustSum:
    """Two thrusts on one hull."""
