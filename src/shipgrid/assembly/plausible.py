"""The largest plausible magnitude of every signal: beyond it a run has diverged, whatever the buses do.

A signal that declares `absurd=` has its own. All others have one by their unit, far above what any plant on a ship
reaches in any transient (a short circuit of 14 pu, the impulse at a contact that interrupts a choke), and far below
what makes the sums of a step lose their digits.
"""

from __future__ import annotations

import numpy as np

from shipgrid.assembly.layout import Layout
from shipgrid.model.component import Field, fields_of

PLAUSIBLE = {
    "V": 1e6,
    "A": 1e6,
    "W": 1e10,
    "var": 1e10,
    "VA": 1e10,
    "N": 1e9,
    "N m": 1e9,
    "rad/s": 1e4,
    "Hz": 1e4,
    "m/s": 100.0,
    "pu": 1e3,
    "1": 1e6,
}
"""Magnitude by unit. In hard transients of the ferry no signal comes nearer than a fifth of its limit
(`tests/scenarios/test_ferry_at_rest.py`)."""

FINITE = float(np.finfo(float).max)
"""Limit of what only has to be a number: angles, counters, times, node voltages (the network has their limits)."""


def largest_plausible(layout: Layout) -> np.ndarray:
    """Limit of every place of the flat vector, in the unit of its signal.

    Parameters
    ----------
    layout : Layout
    """
    limits = np.full(layout.size, FINITE)
    for t in layout.types:
        # The voltage across a terminal is that of its nodes, whose impulse at an opening contact is no divergence.
        ends = {terminal.v for terminal in t.kind.terminals}
        for first, width, record in ((t.x, t.nx, t.kind.state), (t.u, t.nu, t.kind.input), (t.y, t.ny, t.kind.output)):
            for k, declared in enumerate(fields_of(record) if width else ()):
                places = first + k + width * np.arange(len(t.placed))
                limits[places] = FINITE if declared.name in ends else _limit(declared)
    return limits


def _limit(declared: Field) -> float:
    if declared.signal.absurd is not None:
        return declared.signal.absurd
    if declared.signal.rotates or declared.signal.counts:
        return FINITE
    return PLAUSIBLE.get(declared.unit, FINITE)
