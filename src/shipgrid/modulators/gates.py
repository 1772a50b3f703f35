"""What every modulator hands to the legs it drives: bounds of their switching functions, and how they are found.

A modulator says which mean switching functions of the coming step the gates leave possible, `lo` to `hi`: a driven leg
leaves one, a blocked leg all from 0 to 1, a leg of which one switch alone is driven those on one side. Inside them the
diodes decide (`components/converters/two_level_bridge.py`).

`lead` belongs to the step that holds the sampling instant of the modulator's clock, at the fraction f of the step: with
the integral of s up to f in steps,

    lead = integral_0^f s - f s_mean,    i(f) = i_n + f (i_n+1 - i_n) + (h/L) v_dc lead          (modulation-3)

in the sign of a current that s drives. So the current sampled inside a step is the one that flows there.

Duty ratios of a bridge: m_k = 1/2 + s_k - (max s + min s)/2 with min-max injection, m_k = 1/2 + s_k without, s_k the
phase values of the modulation vector.
"""

from __future__ import annotations

from shipgrid.model import kernel, signal
from shipgrid.model.frames import alpha_beta_to_abc
from shipgrid.model.ops import maximum, minimum
from shipgrid.units import Ratio

LIMIT = 1e-9
"""A duty ratio this much beyond 0 or 1 is over-modulated: less is rounding at the edge of the linear range."""

BOTH, LOWER, UPPER = 1.0, 2.0, 3.0
"""Values of a leg's `gates`: both switches driven, the lower one alone (boost), the upper one alone (buck)."""


class LegGates:
    """Output of a half-bridge modulator."""

    lo: Ratio = signal("least mean switching function of the coming step that the gates leave")
    hi: Ratio = signal("greatest mean switching function of the coming step that the gates leave")
    lead: Ratio = signal("integral of s up to the sampling instant over that of its mean, in steps")
    limited: Ratio = signal("1 while the reference is beyond 0 or 1", limiter=True)


class BridgeGates:
    """Output of a bridge modulator."""

    lo_a: Ratio = signal("least mean switching function of the coming step that the gates leave, leg a")
    hi_a: Ratio = signal("greatest mean switching function of the coming step that the gates leave, leg a")
    lo_b: Ratio = signal("least mean switching function of the coming step that the gates leave, leg b")
    hi_b: Ratio = signal("greatest mean switching function of the coming step that the gates leave, leg b")
    lo_c: Ratio = signal("least mean switching function of the coming step that the gates leave, leg c")
    hi_c: Ratio = signal("greatest mean switching function of the coming step that the gates leave, leg c")
    lead_a: Ratio = signal("integral of s up to the sampling instant over that of its mean, in steps, leg a")
    lead_b: Ratio = signal("integral of s up to the sampling instant over that of its mean, in steps, leg b")
    lead_c: Ratio = signal("integral of s up to the sampling instant over that of its mean, in steps, leg c")
    limited: Ratio = signal("1 while what is asked is cut: over-modulation, or crossings not followed", limiter=True)


@kernel
def block(y: BridgeGates):
    """Both gates of every leg blocked."""
    y.lo_a = y.lo_b = y.lo_c = 0.0
    y.hi_a = y.hi_b = y.hi_c = 1.0
    y.lead_a = y.lead_b = y.lead_c = y.limited = 0.0


@kernel
def duty_ratios(s_alpha, s_beta, injection):
    """Duty ratios of the three legs for a modulation vector, not yet cut; `injection` 1 with min-max, 0 without."""
    a, b, c = alpha_beta_to_abc(s_alpha, s_beta)
    middle = 0.5 - 0.5 * injection * (maximum(a, maximum(b, c)) + minimum(a, minimum(b, c)))
    return a + middle, b + middle, c + middle


@kernel
def over_modulated(a, b, c):
    """1 if one of three duty ratios is beyond 0 or 1, else 0."""
    highest, lowest = maximum(a, maximum(b, c)), minimum(a, minimum(b, c))
    return 1.0 if highest > 1.0 + LIMIT or lowest < -LIMIT else 0.0
