"""Two-level legs on a DC bus: the three-phase bridge and the half-bridge.

    v_k = s_k v_dc                                  potential of leg k over the negative rail          (1)
    i_dc = sum over the legs of s_k i_k             i_k out of the leg, i_dc out of the bus            (2)

`s_k` is the switching function of the upper switch: 1 closed, 0 open, between them the mean over a step. A modulator
gives its bounds, `lo` and `hi`: equal while one of the two switches is always driven, 0 and 1 while both gates are
blocked. What the gates leave open the diodes decide: the lower one conducts a current out of the leg (s = lo), the
upper one a current into it (s = hi), and between the bounds the current is zero. The network solution finds it
(`solvers/conduction.py`), so that (1) and (2) are valid in every state of a leg: blocked bridges rectify, feed
faults, float. If the bus voltage reverses, the diodes of every leg conduct, whatever its gates do, each with the
resistance `R_d`: both of a leg share what flows between the poles of the bus, and its own current (conduction-7).
Otherwise switches and diodes are ideal, and a bridge is without losses.

These records hold what a bridge does, found by the solver; there is nothing to integrate.

Source: docs/theory/conduction.md.
"""

from __future__ import annotations

from shipgrid.model import component, kernel, param, signal
from shipgrid.units import Ampere, Ohm, Ratio, Watt


class BridgeOutput:
    s_alpha: Ratio = signal("switching function in force, mean of the step, alpha axis")
    s_beta: Ratio = signal("switching function in force, mean of the step, beta axis")
    i_dc: Ampere = signal("current out of the bus into the bridge, mean of the step")
    p_dc: Watt = signal("power out of the bus into the bridge, mean of the step")
    i_fed: Ampere = signal("the same current counted into the bus")
    p_fed: Watt = signal("the same power counted into the bus")
    i_r: Ampere = signal(
        "current from pole to pole through both diodes of its legs while the bus voltage is reversed, mean of the step"
    )
    p_r: Watt = signal("power lost in the diodes of a reversed bus, mean of the step")


@kernel
def bridge_losses(y: BridgeOutput):
    return y.p_r


@component(output=BridgeOutput, losses=bridge_losses, stage="network", passive=True)
class TwoLevelBridge:
    """Three legs between the poles of a DC bus, feeding a three-wire element."""

    R_d: Ohm = param(
        "resistance of a diode while the bus voltage is reversed", default=2e-3, above=0.0, source="typical"
    )


class LegOutput:
    s: Ratio = signal("switching function in force, mean of the step")
    i_dc: Ampere = signal("current out of the bus into the leg, mean of the step")
    p_dc: Watt = signal("power out of the bus into the leg, mean of the step")
    i_fed: Ampere = signal("the same current counted into the bus")
    p_fed: Watt = signal("the same power counted into the bus")
    i_r: Ampere = signal(
        "current from pole to pole through both diodes of its legs while the bus voltage is reversed, mean of the step"
    )
    p_r: Watt = signal("power lost in the diodes of a reversed bus, mean of the step")


@kernel
def leg_losses(y: LegOutput):
    return y.p_r


@component(output=LegOutput, losses=leg_losses, stage="network", passive=True)
class HalfBridge:
    """One leg between the poles of a DC bus, its current returning to the negative rail."""

    R_d: Ohm = param(
        "resistance of a diode while the bus voltage is reversed", default=2e-3, above=0.0, source="typical"
    )
