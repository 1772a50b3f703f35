"""Short cables: a series R-L branch from length and data per metre.

Shunt capacitance is left out: 30 m of the DC main have 12 nF beside millifarads at either end. The loop of a DC
cable has the resistance of both poles and the inductance between them.
"""

from __future__ import annotations

from shipgrid.components.electrical.rl_branch import RlBranch

DC_OHM_PER_METRE = 2 * 0.035e-3
"""Both poles of 2 x (3 x 185 mm2), 0.035 mOhm/m each; typical catalogue value."""

DC_HENRY_PER_METRE = 0.30e-6
"""Loop of the same cable; typical catalogue value."""

AC_OHM_PER_METRE = 0.19e-3
"""A phase of 95 mm2; typical catalogue value."""

AC_HENRY_PER_METRE = 0.28e-6
"""A phase of 95 mm2, positive sequence; typical catalogue value."""


def dc_cable(length: float, contact: float = 0.0) -> RlBranch:
    """DC main of `length` [m], a switch of resistance `contact` [ohm] in series."""
    return RlBranch(R=DC_OHM_PER_METRE * length + contact, L=DC_HENRY_PER_METRE * length)


def ac_cable(length: float, contact: float = 0.0) -> RlBranch:
    """One axis of an AC cable of `length` [m], a switch of resistance `contact` [ohm] a phase in series."""
    return RlBranch(R=AC_OHM_PER_METRE * length + contact, L=AC_HENRY_PER_METRE * length)
