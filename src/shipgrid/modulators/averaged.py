"""Averaged modulators: what the switching function is during a step, its ripple left out.

A reference computed at one sampling instant is put in force at the next (computation delay) and held for a period
(sample and hold). In the step that holds the instant, at the fraction f of the step,

    s = f s_before + (1 - f) s_after                 (1)

the exact mean over the step. So sampling and delay are those of the switching modulator, and so is the stability.
What a leg's volt-seconds up to the instant are ahead of their mean is handed on, so that the current sampled at that
instant, inside the step, is the one that flows there:

    lead = f s_before - f s = f (1 - f) (s_before - s_after)         (2)

A modulator says which switching functions the gates leave possible, `lo` to `hi`: a driven leg leaves one, a blocked
leg all from 0 to 1, a leg of which one switch alone is driven those on one side. A reference beyond what the bus has is
cut, leg by leg, and `limited` says so.
"""

from __future__ import annotations

import math

from shipgrid.model import component, kernel, signal
from shipgrid.model.ops import clip, maximum, minimum
from shipgrid.units import Ratio

HALF_SQRT3 = 0.5 * math.sqrt(3.0)
LIMIT = 1e-9
"""A reference this much beyond 0 or 1 is over-modulated: less is rounding at the edge of the linear range."""
LOWER, UPPER = 2.0, 3.0
"""Values of a leg's `gates`: the lower switch alone (boost), the upper switch alone (buck)."""


class LegState:
    """State of the half-bridge modulator."""

    active: Ratio = signal("reference in force")


class LegInput:
    """Input of the half-bridge modulator."""

    s_ref: Ratio = signal("reference of the controller's last sampling instant")
    gates: Ratio = signal("0 blocked, 1 both switches driven, 2 the lower alone, 3 the upper alone", initial=1.0)


class LegOutput:
    """Output of the half-bridge modulator."""

    lo: Ratio = signal("least mean switching function of the coming step that the gates leave")
    hi: Ratio = signal("greatest mean switching function of the coming step that the gates leave")
    lead: Ratio = signal("volt-seconds up to the sampling instant ahead of their mean, over v_dc and the step")
    limited: Ratio = signal("1 while the reference is beyond 0 or 1", limiter=True)


@kernel
def leg_modulate(fraction, x: LegState, u: LegInput, y: LegOutput):
    """Bounds of a step in which a new reference comes into force at `fraction` (none: below 0)."""
    before = clip(x.active, 0.0, 1.0)
    y.lead = 0.0
    y.lo = before
    if fraction >= 0.0:
        y.lo = fraction * before + (1.0 - fraction) * clip(u.s_ref, 0.0, 1.0)  # (1)
        y.lead = fraction * (before - y.lo)  # (2)
        x.active = u.s_ref
    y.hi = y.lo
    y.limited = 1.0 if x.active > 1.0 + LIMIT or x.active < -LIMIT else 0.0
    if u.gates < 0.5:
        y.lo, y.hi, y.lead, y.limited = 0.0, 1.0, 0.0, 0.0
    elif u.gates == LOWER:
        y.lo = 0.0
    elif u.gates == UPPER:
        y.hi = 1.0


class BridgeState:
    """State of the bridge modulator."""

    alpha: Ratio = signal("reference in force, alpha axis")
    beta: Ratio = signal("reference in force, beta axis")


class BridgeInput:
    """Input of the bridge modulator."""

    s_alpha_ref: Ratio = signal("reference of the controller's last sampling instant, alpha axis")
    s_beta_ref: Ratio = signal("reference of the controller's last sampling instant, beta axis")
    gates: Ratio = signal("1: the gates are driven, 0: blocked", initial=1.0)


class BridgeOutput:
    """Output of a bridge modulator."""

    lo_a: Ratio = signal("least mean switching function of the coming step that the gates leave, leg a")
    hi_a: Ratio = signal("greatest mean switching function of the coming step that the gates leave, leg a")
    lo_b: Ratio = signal("least mean switching function of the coming step that the gates leave, leg b")
    hi_b: Ratio = signal("greatest mean switching function of the coming step that the gates leave, leg b")
    lo_c: Ratio = signal("least mean switching function of the coming step that the gates leave, leg c")
    hi_c: Ratio = signal("greatest mean switching function of the coming step that the gates leave, leg c")
    lead_a: Ratio = signal("volt-seconds up to the sampling instant ahead of their mean, over v_dc and the step, leg a")
    lead_b: Ratio = signal("volt-seconds up to the sampling instant ahead of their mean, over v_dc and the step, leg b")
    lead_c: Ratio = signal("volt-seconds up to the sampling instant ahead of their mean, over v_dc and the step, leg c")
    limited: Ratio = signal("1 while a leg is cut: over-modulation", limiter=True)


@kernel
def drive(alpha, beta, y):
    """Legs of a vector: half the bus each, the vector's phases, and the zero sequence that centres them (min-max)."""
    b = -0.5 * alpha + HALF_SQRT3 * beta
    c = -0.5 * alpha - HALF_SQRT3 * beta
    highest, lowest = maximum(alpha, maximum(b, c)), minimum(alpha, minimum(b, c))
    centre = 0.5 - 0.5 * (highest + lowest)
    y.lo_a = y.hi_a = clip(centre + alpha, 0.0, 1.0)
    y.lo_b = y.hi_b = clip(centre + b, 0.0, 1.0)
    y.lo_c = y.hi_c = clip(centre + c, 0.0, 1.0)
    y.limited = 1.0 if highest - lowest > 1.0 + LIMIT else 0.0


@kernel
def block(y):
    """Both gates of every leg blocked."""
    y.lo_a = y.lo_b = y.lo_c = 0.0
    y.hi_a = y.hi_b = y.hi_c = 1.0
    y.lead_a = y.lead_b = y.lead_c = y.limited = 0.0


@kernel
def bridge_modulate(fraction, x: BridgeState, u: BridgeInput, y: BridgeOutput):
    """As `leg_modulate`, for the alpha-beta vector of a three-phase bridge."""
    alpha, beta = x.alpha, x.beta
    y.lead_a = y.lead_b = y.lead_c = 0.0
    if fraction >= 0.0:
        alpha = fraction * x.alpha + (1.0 - fraction) * u.s_alpha_ref  # (1)
        beta = fraction * x.beta + (1.0 - fraction) * u.s_beta_ref
        a, b = fraction * (x.alpha - alpha), fraction * (x.beta - beta)  # (2)
        y.lead_a = a
        y.lead_b = -0.5 * a + HALF_SQRT3 * b
        y.lead_c = -0.5 * a - HALF_SQRT3 * b
        x.alpha = u.s_alpha_ref
        x.beta = u.s_beta_ref
    if u.gates.real < 0.5:
        block(y)
    else:
        drive(alpha, beta, y)


class DirectInput:
    """Input of the modulator without delay."""

    s_alpha: Ratio = signal("vector to put in force, alpha axis")
    s_beta: Ratio = signal("vector to put in force, beta axis")
    gates: Ratio = signal("1: the gates are driven, 0: blocked", initial=1.0)


@kernel
def direct_modulate(u: DirectInput, y: BridgeOutput):
    """The controller's vector of this very step: for a control that acts without sampling."""
    y.lead_a = y.lead_b = y.lead_c = 0.0
    if u.gates.real < 0.5:
        block(y)
    else:
        drive(u.s_alpha, u.s_beta, y)


@component(state=LegState, input=LegInput, output=LegOutput, modulate=leg_modulate, stage="modulate")
class AveragedLeg:
    """Averaged modulator of a half-bridge leg."""


@component(state=BridgeState, input=BridgeInput, output=BridgeOutput, modulate=bridge_modulate, stage="modulate")
class AveragedBridge:
    """Averaged modulator of a three-phase two-level bridge."""


@component(input=DirectInput, output=BridgeOutput, modulate=direct_modulate, stage="modulate")
class DirectBridge:
    """Modulator of a bridge whose control acts at every step, without computation delay."""
