"""Three-phase source behind R-L: amplitude, frequency and phase, unbalance, harmonics.

Space vectors, x = x_alpha + j x_beta, i into the source:

    L di/dt = v - R i - e                                                                     (1)
    e = E (exp(j theta) + r_2 exp(-j (theta + phi_2))
           + r_5 exp(-j (5 theta + phi_5)) + r_7 exp(j (7 theta + phi_7))
           + r_11 exp(-j (11 theta + phi_11)) + r_13 exp(j (13 theta + phi_13)))              (2)
    E = v_pu sqrt(2/3) v_n,   dtheta/dt = 2 pi f_pu f_n,   theta(0) = phase                   (3)

r_2 is the negative sequence over the positive one. Harmonics have the sequence that a balanced set has: the 5th and
11th turn backwards, the 7th and 13th forwards. With three wires neither a zero sequence nor harmonics of multiples of
three drive any current; as line voltages they do not exist.

The emf is taken at the end of each implicit Euler step of the rule (`stage_end`), so that a source costs no order of
accuracy: a held value would lag by half a step. `v_pu` and `f_pu` may be set by events or be signals, held over a
step; the angle stays continuous.

Source: docs/theory/conventions.md.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.model.ops import wrap
from shipgrid.units import Ampere, Henry, Hertz, Ohm, PerUnit, Radian, RadianPerSecond, Ratio, Volt


class State:
    """State of the source."""

    i_alpha: Ampere = signal("current into the source, alpha axis; against the emf where it delivers")
    i_beta: Ampere = signal("current into the source, beta axis")
    turned: Radian = signal("angle of the emf since the start, without `phase`", rotates=True)


class Input:
    """Input of the source."""

    v_alpha: Volt = signal("terminal voltage, alpha axis")
    v_beta: Volt = signal("terminal voltage, beta axis")
    v_pu: PerUnit = signal("amplitude over its nominal value", initial=1.0)
    f_pu: PerUnit = signal("frequency over its nominal value", initial=1.0)


class Output:
    """Output of the source."""

    i_alpha_in: Ampere = signal("current into the terminal, alpha axis")
    i_beta_in: Ampere = signal("current into the terminal, beta axis")
    e_alpha: Volt = signal("emf, alpha axis")
    e_beta: Volt = signal("emf, beta axis")


class Derived:
    """What follows from the parameters."""

    E_n: Volt = signal("nominal peak of a phase of the emf")
    omega_n: RadianPerSecond = signal("nominal angular frequency")


def derive(p: ThreePhaseSource) -> dict[str, float]:
    """Peak and angular frequency: (3)."""
    return {"E_n": math.sqrt(2.0 / 3.0) * p.v_n, "omega_n": 2.0 * math.pi * p.f_n}


@kernel
def emf(turned, v_pu, p):
    """Emf, alpha and beta: (2)."""
    theta = turned + p.phase
    alpha, beta = np.cos(theta), np.sin(theta)
    for ratio, order, angle in (
        (p.r_2, -1.0, p.phi_2),
        (p.r_5, -5.0, p.phi_5),
        (p.r_7, 7.0, p.phi_7),
        (p.r_11, -11.0, p.phi_11),
        (p.r_13, 13.0, p.phi_13),
    ):
        if ratio.real != 0.0:
            forwards = 1.0 if order > 0.0 else -1.0
            alpha += ratio * np.cos(order * theta + forwards * angle)
            beta += ratio * np.sin(order * theta + forwards * angle)
    return v_pu * p.E_n * alpha, v_pu * p.E_n * beta


@kernel
def derivatives(t, x: State, u: Input, p: ThreePhaseSource, dx: State):
    e_alpha, e_beta = emf(x.turned, u.v_pu, p)
    dx.i_alpha = (u.v_alpha - p.R * x.i_alpha - e_alpha) / p.L  # (1)
    dx.i_beta = (u.v_beta - p.R * x.i_beta - e_beta) / p.L
    dx.turned = u.f_pu * p.omega_n  # (3)


@kernel
def outputs(t, x: State, u: Input, p: ThreePhaseSource, y: Output):
    y.i_alpha_in = x.i_alpha
    y.i_beta_in = x.i_beta
    y.e_alpha, y.e_beta = emf(x.turned, u.v_pu, p)


@kernel
def stage_end(gh, x, u, p):
    """Angle, emf and conductance at the end of an implicit Euler step of length gh."""
    turned = x.turned + gh * u.f_pu * p.omega_n
    e_alpha, e_beta = emf(turned, u.v_pu, p)
    return turned, e_alpha, e_beta, gh / (p.L + gh * p.R)


@kernel
def stamp(gh, x: State, u: Input, p: ThreePhaseSource, n):
    _, e_alpha, e_beta, g = stage_end(gh, x, u, p)
    kept = p.L / (p.L + gh * p.R)
    n.g_aa = g
    n.g_ab = 0.0
    n.g_ba = 0.0
    n.g_bb = g
    n.h_a = kept * x.i_alpha - g * e_alpha
    n.h_b = kept * x.i_beta - g * e_beta


@kernel
def advance(gh, x: State, u: Input, p: ThreePhaseSource, x_next: State):
    turned, e_alpha, e_beta, g = stage_end(gh, x, u, p)
    kept = p.L / (p.L + gh * p.R)
    x_next.i_alpha = kept * x.i_alpha + g * (u.v_alpha - e_alpha)
    x_next.i_beta = kept * x.i_beta + g * (u.v_beta - e_beta)
    x_next.turned = turned


@kernel
def limit(x: State, u: Input, p: ThreePhaseSource):
    x.turned = wrap(x.turned)


@kernel
def stored_energy(x: State, p: ThreePhaseSource):
    return 0.75 * p.L * (x.i_alpha**2 + x.i_beta**2)


@kernel
def losses(x: State, p: ThreePhaseSource):
    return 1.5 * p.R * (x.i_alpha**2 + x.i_beta**2)


@kernel
def supplied(x: State, u: Input, p: ThreePhaseSource):
    e_alpha, e_beta = emf(x.turned, u.v_pu, p)
    return -1.5 * (e_alpha * x.i_alpha + e_beta * x.i_beta)


@component(
    state=State,
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    derivatives=derivatives,
    outputs=outputs,
    stamp=stamp,
    advance=advance,
    limit=limit,
    stored_energy=stored_energy,
    losses=losses,
    supplied=supplied,
    terminals=(Terminal("alpha", v="v_alpha", i="i_alpha_in"), Terminal("beta", v="v_beta", i="i_beta_in")),
)
class ThreePhaseSource(Derived):
    """Three-phase source behind a series impedance; its only end is called `a`, or what one likes."""

    v_n: Volt = param("nominal emf, line to line, rms", default=400.0, above=0.0, source="[DAgostino2020] table A1")
    f_n: Hertz = param("nominal frequency", default=60.0, above=0.0, source="[DAgostino2020] table A1")
    R: Ohm = param("series resistance of a phase", at_least=0.0)
    L: Henry = param("series inductance of a phase", above=0.0)
    phase: Radian = param("angle of phase a at the start", default=0.0, source="none")
    r_2: Ratio = param("negative sequence over the positive one", default=0.0, at_least=0.0, source="balanced")
    phi_2: Radian = param("angle of the negative sequence", default=0.0, source="none")
    r_5: Ratio = param("5th harmonic over the fundamental", default=0.0, at_least=0.0, source="sine")
    phi_5: Radian = param("angle of the 5th harmonic", default=0.0, source="none")
    r_7: Ratio = param("7th harmonic over the fundamental", default=0.0, at_least=0.0, source="sine")
    phi_7: Radian = param("angle of the 7th harmonic", default=0.0, source="none")
    r_11: Ratio = param("11th harmonic over the fundamental", default=0.0, at_least=0.0, source="sine")
    phi_11: Radian = param("angle of the 11th harmonic", default=0.0, source="none")
    r_13: Ratio = param("13th harmonic over the fundamental", default=0.0, at_least=0.0, source="sine")
    phi_13: Radian = param("angle of the 13th harmonic", default=0.0, source="none")
