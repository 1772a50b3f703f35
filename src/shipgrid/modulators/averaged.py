"""Averaged modulators: what the switching function is during a step, its ripple left out.

A reference computed at one sampling instant is put in force at the next (computation delay) and held for a period
(sample and hold). In the step that holds the instant, at the fraction f of the step,

    s = f s_before + (1 - f) s_after                 (1)

the exact mean over the step, and its `lead` (modulators/gates.py) is f s_before - f s = f (1 - f) (s_before - s_after).
So sampling and delay are those of the switching modulator, and so is the stability. A reference beyond what the bus has
is cut, leg by leg, and `limited` says so.
"""

from __future__ import annotations

from shipgrid.model import component, kernel, signal
from shipgrid.model.frames import alpha_beta_to_abc
from shipgrid.model.ops import clip
from shipgrid.modulators.gates import LIMIT, LOWER, UPPER, BridgeGates, LegGates, block, duty_ratios, over_modulated
from shipgrid.units import Ratio


class LegState:
    """State of the half-bridge modulator."""

    active: Ratio = signal("reference in force")


class LegInput:
    """Input of the half-bridge modulator."""

    s_ref: Ratio = signal("reference of the controller's last sampling instant")
    gates: Ratio = signal("0 blocked, 1 both switches driven, 2 the lower alone, 3 the upper alone", initial=1.0)


@kernel
def leg_modulate(fraction, x: LegState, u: LegInput, y: LegGates):
    """Bounds of a step in which a new reference comes into force at `fraction` (none: below 0)."""
    before = clip(x.active, 0.0, 1.0)
    y.lead = 0.0
    y.lo = before
    if fraction >= 0.0:
        y.lo = fraction * before + (1.0 - fraction) * clip(u.s_ref, 0.0, 1.0)  # (1)
        y.lead = fraction * (before - y.lo)
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


@kernel
def drive(alpha, beta, y: BridgeGates):
    """Legs of a vector, with min-max injection."""
    a, b, c = duty_ratios(alpha, beta, 1.0)
    y.lo_a = y.hi_a = clip(a, 0.0, 1.0)
    y.lo_b = y.hi_b = clip(b, 0.0, 1.0)
    y.lo_c = y.hi_c = clip(c, 0.0, 1.0)
    y.limited = over_modulated(a, b, c)


@kernel
def bridge_modulate(fraction, x: BridgeState, u: BridgeInput, y: BridgeGates):
    """As `leg_modulate`, for the alpha-beta vector of a three-phase bridge."""
    alpha, beta = x.alpha, x.beta
    y.lead_a = y.lead_b = y.lead_c = 0.0
    if fraction >= 0.0:
        alpha = fraction * x.alpha + (1.0 - fraction) * u.s_alpha_ref  # (1)
        beta = fraction * x.beta + (1.0 - fraction) * u.s_beta_ref
        y.lead_a, y.lead_b, y.lead_c = alpha_beta_to_abc(fraction * (x.alpha - alpha), fraction * (x.beta - beta))
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
def direct_modulate(u: DirectInput, y: BridgeGates):
    """The controller's vector of this very step: for a control that acts without sampling."""
    y.lead_a = y.lead_b = y.lead_c = 0.0
    if u.gates.real < 0.5:
        block(y)
    else:
        drive(u.s_alpha, u.s_beta, y)


@component(state=LegState, input=LegInput, output=LegGates, modulate=leg_modulate, stage="modulate")
class AveragedLeg:
    """Averaged modulator of a half-bridge leg."""


@component(state=BridgeState, input=BridgeInput, output=BridgeGates, modulate=bridge_modulate, stage="modulate")
class AveragedBridge:
    """Averaged modulator of a three-phase two-level bridge."""


@component(input=DirectInput, output=BridgeGates, modulate=direct_modulate, stage="modulate")
class DirectBridge:
    """Modulator of a bridge whose control acts at every step, without computation delay."""
