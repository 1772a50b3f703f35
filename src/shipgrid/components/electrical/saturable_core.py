"""Magnetising branch of a three-phase transformer whose core saturates: flux against current in two straight pieces.

Space vectors, x = x_alpha + j x_beta; k = a, b, c are the windings, each with a limb of the core by itself:

    dpsi/dt = v                                                                               (1)
    i_k = psi_k / L_m + (1/L_sat - 1/L_m) max(|psi_k| - psi_knee, 0) sign(psi_k)              (2)
    i = (2/3) (i_a + i_b exp(j 2 pi/3) + i_c exp(-j 2 pi/3)) exp(-j turn) + v / R_m           (3)

psi_k are the projections of psi exp(j turn) on the three axes: a winding in star has the flux of its phase, `turn` 0,
one in delta that of a line voltage, `turn` 30 degrees, as seen from the equivalent star. They have no zero sequence,
and (3) leaves out that of the currents: in a transformer with a delta winding, which most have, it flows there and
nowhere else. Without a delta the star point would move.

There is no hysteresis. A core that nothing else meets when a run starts, behind an open breaker, keeps the flux that it
is given there, its remanence: its current is then

    i(psi) - r i(psi_0),   r = max(0, 1 - |psi - psi_0| / (0.05 psi_knee)),   r never rising                    (4)

zero until voltage comes, and that of (2) as soon as the flux has moved by a twentieth of the knee's. A breaker that
opens later leaves no remanence: the flux goes through R_m.

For the network (1) is exact, and (2) is taken along the piece in which the flux would end with the last voltage known.
Where it passes a knee inside a step, the current of that step alone is off, by the square of the step.

Source: docs/theory/network.md.
"""

from __future__ import annotations

import math

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.model.frames import SQRT3_2, abc_to_alpha_beta, alpha_beta_to_abc, rotate, unrotate
from shipgrid.model.ops import absolute, hypot, maximum, minimum, sign
from shipgrid.units import Ampere, Henry, Ohm, Radian, Ratio, Volt, Weber

LEFT = 0.05
"""Flux by which a core leaves its remanence, over that of the knee: more than a step moves it, far from saturation."""


class State:
    """State of the core."""

    psi_alpha: Weber = signal("flux linkage, alpha axis")
    psi_beta: Weber = signal("flux linkage, beta axis")
    rest_alpha: Weber = signal("remanent flux linkage at the start, alpha axis")
    rest_beta: Weber = signal("remanent flux linkage at the start, beta axis")
    rest: Ratio = signal("1 while the flux rests at its remanence, 0 when it has left it")


class Input:
    """Input of the core."""

    v_alpha: Volt = signal("voltage of the windings, alpha axis")
    v_beta: Volt = signal("voltage of the windings, beta axis")


class Output:
    """Output of the core."""

    i_alpha_in: Ampere = signal("magnetising current and core loss, alpha axis")
    i_beta_in: Ampere = signal("magnetising current and core loss, beta axis")


class Derived:
    """What follows from the turn."""

    cos: Ratio = signal("cosine of the turn")
    sin: Ratio = signal("sine of the turn")


def derive(p: SaturableCore) -> dict[str, float]:
    """Cosine and sine of the turn."""
    return {"cos": math.cos(p.turn), "sin": math.sin(p.turn)}


@kernel
def magnetising(psi, p):
    """Current of one phase and its slope by the flux: (2)."""
    beyond = maximum(absolute(psi) - p.psi_knee, 0.0 * psi)
    steeper = 1.0 / p.L_sat - 1.0 / p.L_m
    slope = 1.0 / p.L_m + (steeper if beyond.real > 0.0 else 0.0 * steeper)
    return psi / p.L_m + steeper * sign(psi) * beyond, slope


@kernel
def current(psi_alpha, psi_beta, p):
    """Magnetising current, alpha and beta, and its slopes aa, ab and bb by the flux: (3) without losses."""
    psi_a, psi_b, psi_c = alpha_beta_to_abc(*rotate(psi_alpha, psi_beta, p.cos, -p.sin))
    i_a, y_a = magnetising(psi_a, p)
    i_b, y_b = magnetising(psi_b, p)
    i_c, y_c = magnetising(psi_c, p)
    i_d, i_q = abc_to_alpha_beta(i_a, i_b, i_c)
    i_alpha, i_beta = unrotate(i_d, i_q, p.cos, -p.sin)
    # (2/3) sum of y_k d_k d_k^T over the axes, its mean and what is left of it, turned back by twice the angle
    mean, d, q = (y_a + y_b + y_c) / 3.0, (y_a - 0.5 * (y_b + y_c)) / 3.0, -0.5 * SQRT3_2 * (y_b - y_c) / 1.5
    d, q = unrotate(d, q, p.cos * p.cos - p.sin * p.sin, -2.0 * p.sin * p.cos)
    return i_alpha, i_beta, mean + d, q, mean - d


@kernel
def remanence(x, p):
    """Current by which a core at its remanence has less, alpha and beta: the second term of (4)."""
    if x.rest.real == 0.0:
        return 0.0 * x.psi_alpha, 0.0 * x.psi_beta
    i_alpha, i_beta, _, _, _ = current(x.rest_alpha, x.rest_beta, p)
    return x.rest * i_alpha, x.rest * i_beta


@kernel
def derivatives(u: Input, dx: State):
    dx.psi_alpha = u.v_alpha  # (1)
    dx.psi_beta = u.v_beta
    dx.rest_alpha = 0.0 * u.v_alpha
    dx.rest_beta = 0.0 * u.v_beta
    dx.rest = 0.0 * u.v_alpha


@kernel
def outputs(x: State, u: Input, p: SaturableCore, y: Output):
    i_alpha, i_beta, _, _, _ = current(x.psi_alpha, x.psi_beta, p)
    less_alpha, less_beta = remanence(x, p)
    y.i_alpha_in = i_alpha - less_alpha + u.v_alpha / p.R_m
    y.i_beta_in = i_beta - less_beta + u.v_beta / p.R_m


@kernel
def stamp(gh, x: State, u: Input, p: SaturableCore, n):
    i_alpha, i_beta, y_aa, y_ab, y_bb = current(x.psi_alpha + gh * u.v_alpha, x.psi_beta + gh * u.v_beta, p)
    less_alpha, less_beta = remanence(x, p)
    n.g_aa = gh * y_aa + 1.0 / p.R_m
    n.g_ab = gh * y_ab
    n.g_ba = gh * y_ab
    n.g_bb = gh * y_bb + 1.0 / p.R_m
    n.h_a = i_alpha - less_alpha - gh * (y_aa * u.v_alpha + y_ab * u.v_beta)
    n.h_b = i_beta - less_beta - gh * (y_ab * u.v_alpha + y_bb * u.v_beta)


@kernel
def advance(gh, x: State, u: Input, x_next: State):
    x_next.psi_alpha = x.psi_alpha + gh * u.v_alpha
    x_next.psi_beta = x.psi_beta + gh * u.v_beta
    x_next.rest_alpha = x.rest_alpha
    x_next.rest_beta = x.rest_beta
    x_next.rest = x.rest


@kernel
def limit(x: State, p: SaturableCore):
    if x.rest.real > 0.0:
        gone = hypot(x.psi_alpha - x.rest_alpha, x.psi_beta - x.rest_beta)
        x.rest = minimum(x.rest, maximum(1.0 - gone / (LEFT * p.psi_knee), 0.0 * gone))  # (4)


@kernel
def isolated(x: State):
    """The flux that a core has which nothing else meets is its remanence."""
    x.rest_alpha = x.psi_alpha
    x.rest_beta = x.psi_beta
    x.rest = 1.0


@kernel
def stored_energy(x: State, p: SaturableCore):
    psi_a, psi_b, psi_c = alpha_beta_to_abc(*rotate(x.psi_alpha, x.psi_beta, p.cos, -p.sin))
    linear = (psi_a**2 + psi_b**2 + psi_c**2) / p.L_m
    steeper = 1.0 / p.L_sat - 1.0 / p.L_m
    more_a = maximum(absolute(psi_a) - p.psi_knee, 0.0 * psi_a)
    more_b = maximum(absolute(psi_b) - p.psi_knee, 0.0 * psi_b)
    more_c = maximum(absolute(psi_c) - p.psi_knee, 0.0 * psi_c)
    less_alpha, less_beta = remanence(x, p)
    held = less_alpha * (x.psi_alpha - x.rest_alpha) + less_beta * (x.psi_beta - x.rest_beta)
    return 0.5 * (linear + steeper * (more_a**2 + more_b**2 + more_c**2)) - 1.5 * held


@kernel
def losses(u: Input, p: SaturableCore):
    return 1.5 * (u.v_alpha**2 + u.v_beta**2) / p.R_m


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
    isolated=isolated,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(Terminal("alpha", v="v_alpha", i="i_alpha_in"), Terminal("beta", v="v_beta", i="i_beta_in")),
    passive=True,
)
class SaturableCore(Derived):
    """Magnetising branch with a knee, on an AC bus: of a transformer, or of a three-phase reactor."""

    L_m: Henry = param(
        "magnetising inductance below the knee",
        default=4.24,
        above=0.0,
        source="500 pu of 50 kVA at 400 V and 60 Hz, default of the SPS block",
    )
    L_sat: Henry = param(
        "inductance of what is added beyond the knee",
        default=2.72e-3,
        above=0.0,
        source="0.32 pu of 50 kVA at 400 V and 60 Hz, last piece of the SPS block's default (1.2 to 1.52 pu)",
    )
    psi_knee: Weber = param(
        "flux linkage of a phase at the knee, peak",
        default=1.04,
        above=0.0,
        source="1.2 pu at 400 V and 60 Hz, default of the SPS block",
    )
    R_m: Ohm = param(
        "resistance of the core's losses",
        default=1600.0,
        above=0.0,
        source="500 pu of 50 kVA at 400 V, default of the SPS block",
    )
    turn: Radian = param(
        "angle by which the windings' axes lead the phases: 0 for a star, 30 degrees for a delta",
        default=0.0,
        at_least=-math.pi,
        at_most=math.pi,
        source="a star",
    )
