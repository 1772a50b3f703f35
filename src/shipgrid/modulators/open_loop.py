"""Open-loop modulation of a three-phase bridge: a sine reference of given amplitude, frequency and phase.

    s = m / 2 exp(j theta),    dtheta/dt = 2 pi f_pu f_n            (1)

`m` is the peak of the phase voltage over half the DC voltage, 1 at the limit of linear modulation without a zero
sequence, 2/sqrt(3) with one. Averaged over a step: the reference of the step's middle, which is its mean up to a term
of second order. A leg needs no component for this: its duty ratio is a command or a constant (`Network.command`).
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import wrap
from shipgrid.units import Hertz, PerUnit, Radian, Ratio


class State:
    """State of the modulation."""

    theta: Radian = signal("angle of the reference at the end of the step", rotates=True)


class Input:
    """Input of the modulation."""

    m: Ratio = signal("modulation index", initial=0.0)
    f_pu: PerUnit = signal("frequency over its nominal value", initial=1.0)


class Output:
    """Output of the modulation."""

    s_alpha: Ratio = signal("mean switching function of the coming step, alpha axis")
    s_beta: Ratio = signal("mean switching function of the coming step, beta axis")


@kernel
def update(t, dt, x: State, u: Input, p: SineModulation, x_next: State, y: Output):
    turn = 2.0 * math.pi * u.f_pu * p.f_n * dt
    middle = x.theta + p.phase + 0.5 * turn
    y.s_alpha = 0.5 * u.m * np.cos(middle)  # (1)
    y.s_beta = 0.5 * u.m * np.sin(middle)
    x_next.theta = wrap(x.theta + turn)


@component(state=State, input=Input, output=Output, update=update, stage="inner")
class SineModulation:
    """Sine reference for a three-phase bridge, every step."""

    f_n: Hertz = param("nominal frequency", default=60.0, above=0.0, source="[DAgostino2020] table A1")
    phase: Radian = param("angle of phase a at the start", default=0.0, source="none")
