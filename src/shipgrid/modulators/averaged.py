"""Averaged modulators: what the switching function is during a step, its ripple left out.

A reference computed at one sampling instant is put in force at the next (computation delay) and held for a period
(sample and hold). In the step that holds the instant, at the fraction f of the step,

    s = f s_before + (1 - f) s_after                 (1)

the exact mean over the step. So sampling and delay are those of the switching modulator, and so is the stability.
"""

from __future__ import annotations

from shipgrid.model import component, kernel, signal
from shipgrid.units import Ratio


class LegState:
    """State of the half-bridge modulator."""

    active: Ratio = signal("reference in force")


class LegInput:
    """Input of the half-bridge modulator."""

    s_ref: Ratio = signal("reference of the controller's last sampling instant")


class LegOutput:
    """Output of the half-bridge modulator."""

    s: Ratio = signal("mean switching function of the coming step")


@kernel
def leg_modulate(fraction, x, u, y):
    """Mean switching function of a step in which a new reference comes into force at `fraction` (none: below 0)."""
    if fraction < 0.0:
        y.s = x.active
    else:
        y.s = fraction * x.active + (1.0 - fraction) * u.s_ref  # (1)
        x.active = u.s_ref


class BridgeState:
    """State of the bridge modulator."""

    alpha: Ratio = signal("reference in force, alpha axis")
    beta: Ratio = signal("reference in force, beta axis")


class BridgeInput:
    """Input of the bridge modulator."""

    s_alpha_ref: Ratio = signal("reference of the controller's last sampling instant, alpha axis")
    s_beta_ref: Ratio = signal("reference of the controller's last sampling instant, beta axis")


class BridgeOutput:
    """Output of the bridge modulator."""

    s_alpha: Ratio = signal("mean switching function of the coming step, alpha axis")
    s_beta: Ratio = signal("mean switching function of the coming step, beta axis")


@kernel
def bridge_modulate(fraction, x, u, y):
    """As `leg_modulate`, for the alpha-beta vector of a three-phase bridge."""
    if fraction < 0.0:
        y.s_alpha = x.alpha
        y.s_beta = x.beta
    else:
        y.s_alpha = fraction * x.alpha + (1.0 - fraction) * u.s_alpha_ref  # (1)
        y.s_beta = fraction * x.beta + (1.0 - fraction) * u.s_beta_ref
        x.alpha = u.s_alpha_ref
        x.beta = u.s_beta_ref


@component(state=LegState, input=LegInput, output=LegOutput, modulate=leg_modulate, stage="modulate")
class AveragedLeg:
    """Averaged modulator of a half-bridge leg."""


@component(state=BridgeState, input=BridgeInput, output=BridgeOutput, modulate=bridge_modulate, stage="modulate")
class AveragedBridge:
    """Averaged modulator of a three-phase two-level bridge."""
