"""Voltmeter and frequency meter of an AC bar.

    v_pu = |v_alpha + j v_beta| / v_b,   v_b = sqrt(2/3) v_n                   (1)
    f - f_n <- two low-passes of  (theta - theta_before - 2 pi f_n dt) / (2 pi dt)   (2)
    v_rms_pu <- a low-pass of  v_pu, of the noise bandwidth of one cycle's mean      (3)

It runs every step: the staircase of a sampled modulation is then filtered instead of folded down. Two low-passes,
because the first only takes the derivative out of the angle's ripple. A bar below `v_dead` has no frequency: it reads
0 Hz. (3) is what a meter of one cycle's rms shows of a balanced bar, and what limits of bar voltages are on.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import arctan2, hypot, wrap
from shipgrid.units import Hertz, PerUnit, Radian, RadianPerSecond, Ratio, Volt


class State:
    """State of the meter."""

    theta: Radian = signal("angle of the voltage at the last instant", rotates=True)
    slip: Hertz = signal("frequency above nominal, through one low-pass")
    slip_f: Hertz = signal("frequency above nominal, through both")
    live: Ratio = signal("1: the bar was live at the last instant")
    v_f: PerUnit = signal("length of the voltage vector, through a low-pass")


class Input:
    """Input of the meter."""

    v_alpha: Volt = signal("bar voltage, alpha axis")
    v_beta: Volt = signal("bar voltage, beta axis")


class Output:
    """Output of the meter."""

    v_pu: PerUnit = signal("length of the voltage vector")
    f: Hertz = signal("frequency, 0 on a dead bar")
    v_rms_pu: PerUnit = signal("voltage as a meter of one cycle's rms shows it")


class Derived:
    """Base."""

    v_b: Volt = signal("base voltage, peak of a phase")


def derive(p: BarMeter) -> dict[str, float]:
    """Base voltage."""
    return {"v_b": math.sqrt(2.0 / 3.0) * p.v_n}


@kernel
def update(t, dt, x: State, u: Input, p: BarMeter, x_next: State, y: Output):
    y.v_pu = hypot(u.v_alpha, u.v_beta) / p.v_b  # (1)
    x_next.v_f = x.v_f + (1.0 - np.exp(-2.0 * p.f_n * dt)) * (y.v_pu - x.v_f)  # (3)
    y.v_rms_pu = x_next.v_f
    if y.v_pu.real < p.v_dead.real:
        x_next.slip = 0.0
        x_next.slip_f = 0.0
        x_next.live = 0.0
        y.f = 0.0
        return
    theta = arctan2(u.v_beta, u.v_alpha)
    x_next.theta = theta
    x_next.live = 1.0
    if x.live.real > 0.5:
        advance = wrap(theta - x.theta - 2.0 * np.pi * p.f_n * dt)
        share = 1.0 - np.exp(-p.omega_c * dt)
        x_next.slip = x.slip + share * (advance / (2.0 * np.pi * dt) - x.slip)  # (2)
        x_next.slip_f = x.slip_f + share * (x_next.slip - x.slip_f)
    y.f = p.f_n + x_next.slip_f


@component(state=State, input=Input, output=Output, derived=Derived, derive=derive, update=update, stage="measure")
class BarMeter(Derived):
    """Voltage and frequency of an AC bar."""

    v_n: Volt = param("nominal voltage, line to line, rms", default=400.0, above=0.0, source="[DAgostino2020] table A1")
    f_n: Hertz = param("nominal frequency", default=60.0, above=0.0, source="[DAgostino2020] table A1")
    omega_c: RadianPerSecond = param(
        "corner of each low-pass of the frequency",
        default=2.0 * math.pi * 20.0,
        above=0.0,
        source="together about the three periods of a transducer",
    )
    v_dead: PerUnit = param("below this the bar counts as dead", default=0.05, above=0.0, source="dead-bus rule, 5 %")
