"""Hull: surge motion and its resistance.

    (m + m_add) du/dt = (1 - t_f) thrust - R(u) - T_env         (1)
    R = c(|u|) u |u|                                             (2)
    dx/dt = u                                                    (3)
    v_a = (1 - w_f) u,   u_thrust = (1 - t_f) u                  (4)

The coefficient c is a table over the ship's speed, linear between its points and constant beyond them: R is smooth
through zero, and a resistance that goes with the square of speed is exact. Wake and thrust deduction are constant,
the same for every screw and in both directions. Still, deep water; wind and waves enter by T_env (positive against
the ship going ahead).

The useful consumer at the end of the energy's way is the towing power, R u + T_env u.

Source: [DAgostino2020] fig. 7d and table A1; docs/theory/propulsion.md.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute, interp
from shipgrid.units import KNOT, Kilogram, Metre, MetrePerSecond, MetrePerSecond2, Newton, Ratio

N_POINTS = 6


class State:
    u_ship: MetrePerSecond = signal("speed through the water, positive ahead")
    distance: Metre = signal("distance made good ahead", counts=True)


class Input:
    thrust: Newton = signal("thrust of all screws, before thrust deduction", initial=0.0)
    T_env: Newton = signal("added resistance of wind and waves", initial=0.0)


class Output:
    resistance: Newton = signal("resistance in still water, with the sign of the speed")
    acceleration: MetrePerSecond2 = signal("acceleration of the ship")
    v_a: MetrePerSecond = signal("speed of the water into the screws")
    u_thrust: MetrePerSecond = signal("speed at which thrust does work on the ship")


class Derived:
    c: Ratio = signal("resistance over speed squared [N s2/m2] at 0, u_step, ... 6 u_step")


@kernel
def resistance(u_ship, p, tables):
    """Resistance in still water [N]: (2)."""
    speed = absolute(u_ship)
    return interp(speed, tables, int(p.c.real), N_POINTS + 1, 0.0, p.u_step) * u_ship * speed


@kernel
def acceleration(x: State, u: Input, p: Hull, tables):
    return ((1.0 - p.t_f) * u.thrust - resistance(x.u_ship, p, tables) - u.T_env) / (p.m + p.m_add)  # (1)


@kernel
def derivatives(x: State, u: Input, p: Hull, dx: State, tables):
    dx.u_ship = acceleration(x, u, p, tables)
    dx.distance = x.u_ship  # (3)


@kernel
def outputs(x: State, u: Input, p: Hull, y: Output, tables):
    y.acceleration = acceleration(x, u, p, tables)
    y.resistance = resistance(x.u_ship, p, tables)
    y.v_a = (1.0 - p.w_f) * x.u_ship  # (4)
    y.u_thrust = (1.0 - p.t_f) * x.u_ship


@kernel
def stored_energy(x: State, p: Hull):
    return 0.5 * (p.m + p.m_add) * x.u_ship**2


@kernel
def consumed(x: State, u: Input, p: Hull, tables):
    return (resistance(x.u_ship, p, tables) + u.T_env) * x.u_ship


def derive(hull: Hull) -> dict[str, np.ndarray]:
    """Table of the coefficient in (2); below the first point it is that of the first point."""
    speed = hull.u_step * np.arange(1, N_POINTS + 1)
    points = np.array([getattr(hull, f"R_{k}") for k in range(1, N_POINTS + 1)]) / speed**2
    return {"c": np.concatenate([points[:1], points])}


@component(
    state=State,
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    consumed=consumed,
)
class Hull(Derived):
    """A displacement hull in surge; resistance by default 18.06 kN at 10 kn, with the square of speed."""

    m: Kilogram = param("displacement", default=377e3, above=0.0, source="[DAgostino2020] table A1")
    m_add: Kilogram = param("added mass in surge", default=30.16e3, at_least=0.0, source="[DAgostino2020] table A1")
    w_f: Ratio = param("wake fraction", default=0.235, at_least=0.0, below=1.0, source="[DAgostino2020] table A1")
    t_f: Ratio = param("thrust deduction", default=0.205, at_least=0.0, below=1.0, source="[DAgostino2020] table A1")
    u_step: MetrePerSecond = param("distance of the resistance points", default=2.0 * KNOT, above=0.0)
    R_1: Newton = param("resistance at u_step", default=722.4, at_least=0.0, source="0.1806 kN/kn2 at 2 kn")
    R_2: Newton = param("resistance at 2 u_step", default=2889.6, at_least=0.0, source="0.1806 kN/kn2 at 4 kn")
    R_3: Newton = param("resistance at 3 u_step", default=6501.6, at_least=0.0, source="0.1806 kN/kn2 at 6 kn")
    R_4: Newton = param("resistance at 4 u_step", default=11558.4, at_least=0.0, source="0.1806 kN/kn2 at 8 kn")
    R_5: Newton = param("resistance at 5 u_step", default=18060.0, at_least=0.0, source="[DAgostino2020] table A1")
    R_6: Newton = param("resistance at 6 u_step", default=26006.4, at_least=0.0, source="0.1806 kN/kn2 at 12 kn")
