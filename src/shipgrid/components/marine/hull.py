"""Hull: surge motion and its resistance.

    (m + m_add) du/dt = (1 - t_f) thrust - R(u) - T_env         (1)
    R = c(|u|) u |u|                                             (2)
    dx/dt = u                                                    (3)
    v_a = (1 - w_f) u,   u_thrust = (1 - t_f) u                  (4)

R goes through the points of `resistance`, pairs of speed and resistance that rise together: a monotone cubic through
their logarithms, so that a power law between two of them is met exactly and R rises throughout. Half the first speed
and twice the last are points as well, by the square of speed, and so it goes on beyond these. One point is therefore a
resistance with the square of speed. The coefficient c = R / u^2 is made into a table once, in `POINTS` steps up to
twice the last speed, and read with a cubic: R and its slope are continuous, and R is smooth through zero. Wake and
thrust deduction are constant, the same for every screw and in both directions. Still, deep water; wind and waves enter
by T_env (positive against the ship going ahead).

The useful consumer at the end of the energy's way is the towing power, R u + T_env u.

Source: [DAgostino2020] fig. 7d and table A1; docs/theory/propulsion.md.
"""

from __future__ import annotations

import numpy as np

from shipgrid.errors import ParameterError
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute, catmull_rom, clip
from shipgrid.units import KNOT, Kilogram, Metre, MetrePerSecond, MetrePerSecond2, Newton, Ratio

POINTS = 800
"""Intervals of the table of c: it is within 3e-4 of a curve with a marked hump, 1e-5 of a plain one (tested)."""
SPEED_POINT, RESISTANCE_POINT = 10.0 * KNOT, 18.06e3
"""The ferry's resistance: [DAgostino2020] table A1."""


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
    c: Ratio = signal("resistance over speed squared [N s2/m2] at -u_step, 0, u_step, ... (POINTS + 1) u_step")
    u_step: MetrePerSecond = signal("distance of the points of that table")


@kernel
def resistance(u_ship, p, tables):
    """Resistance in still water [N]: (2)."""
    speed = absolute(u_ship)
    if speed.real == 0.0:  # and no slope either, not even that of rounding
        return 0.0 * speed
    place = clip(speed / p.u_step, 0.0, float(POINTS))
    k = min(int(place.real), POINTS - 1) if place.real > 0.0 else 0  # 0 as well where the place is no number
    w_0, w_1, w_2, w_3 = catmull_rom(place - k)
    at = int(p.c.real) + k
    c = w_0 * tables[at] + w_1 * tables[at + 1] + w_2 * tables[at + 2] + w_3 * tables[at + 3]
    return c * u_ship * speed


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


def through(points: tuple[tuple[float, float], ...], speed: np.ndarray) -> np.ndarray:
    """Resistance [N] at positive speeds [m/s] by the monotone cubic (Fritsch, Carlson) through the points.

    Raises
    ------
    ParameterError
        If there is no point, or speed or resistance does not rise from one to the next, beginning above zero.
    """
    given = np.asarray(points, dtype=float)
    if given.size == 0 or given.shape[1:] != (2,) or not np.isfinite(given).all():
        raise ParameterError(f"Hull.resistance = {points!r} is no list of pairs of speed [m/s] and resistance [N]")
    if (given[0] <= 0.0).any() or (np.diff(given, axis=0) <= 0.0).any():
        raise ParameterError("Hull.resistance: speed and resistance do not both rise from one pair to the next")
    by_square = np.array([[0.25, 0.0625], [0.5, 0.25], [2.0, 4.0], [4.0, 16.0]])
    every = np.concatenate([given[0] * by_square[:2], given, given[-1] * by_square[2:]])
    x, y = np.log(every).T
    h = np.diff(x)
    secant = np.diff(y) / h
    before, after = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    inner = (before + after) / (before / secant[:-1] + after / secant[1:])
    slope = np.concatenate([[2.0], inner, [2.0]])
    at = np.clip(np.log(speed), x[0], x[-1])
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(h) - 1)
    f, left, right = (at - x[k]) / h[k], h[k] * slope[k], h[k] * slope[k + 1]
    rise = h[k] * secant[k]
    log_R = y[k] + f * (left + f * (3.0 * rise - 2.0 * left - right + f * (left + right - 2.0 * rise)))
    return np.exp(log_R) * (speed / np.exp(at)) ** 2


def derive(hull: Hull) -> dict[str, float | np.ndarray]:
    """Table of the coefficient in (2); at zero it is that of the first step."""
    u_step = 2.0 * hull.resistance[-1][0] / POINTS if hull.resistance else 1.0
    speed = u_step * np.arange(1, POINTS + 2)
    c = through(hull.resistance, speed) / speed**2
    return {"c": np.concatenate([c[:1], c[:1], c]), "u_step": u_step}


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
    """A displacement hull in surge; `resistance` has its pairs of speed [m/s] and resistance [N]."""

    m: Kilogram = param("displacement", default=377e3, above=0.0, source="[DAgostino2020] table A1")
    m_add: Kilogram = param("added mass in surge", default=30.16e3, at_least=0.0, source="[DAgostino2020] table A1")
    w_f: Ratio = param("wake fraction", default=0.235, at_least=0.0, below=1.0, source="[DAgostino2020] table A1")
    t_f: Ratio = param("thrust deduction", default=0.205, at_least=0.0, below=1.0, source="[DAgostino2020] table A1")
    resistance: tuple[tuple[float, float], ...] = ((SPEED_POINT, RESISTANCE_POINT),)
