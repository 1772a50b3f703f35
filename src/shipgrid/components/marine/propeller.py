"""Fixed-pitch screw of the Wageningen B-series, in all four quadrants.

    beta = arctan2(v_a, 0.7 pi n D)                                               (1)
    q = 1/2 rho (v_a^2 + (0.7 pi n D)^2) (pi/4) D^2                               (2)
    thrust = q CT*(beta),   tau = q D CQ*(beta) / eta_r                           (3)
    J_adv = v_a / (n D),   CT* = KT 8 / (pi (J_adv^2 + (0.7 pi)^2))               (4)

with n = omega_m / 2 pi in revolutions per second. CT* and CQ* are one smooth periodic table, made once:

- from J_adv = 0 to the zero of KT, n > 0: the open-water polynomials [Oosterveld1975] by (4);
- elsewhere: the Fourier series of the tested propeller [Roddy2006] nearest in Z, then A_E/A_0, then P/D, brought to the
  screw's pitch by the difference that B4-70 shows between the two pitches: it alone was tested at several, 0.5 to 1.4.
  For the ferry's B5-75 with P/D 0.9 that is B5-75 with P/D 1.0 and that difference. Where polynomials and series join
  they are 0.0045 apart in CT*, 0.0009 in CQ* (`mismatch`; without the difference 0.030 and 0.0070; the tested B5-75
  itself 0.0038 and 0.0002);
- the two blend over 10 degrees beyond each end of the polynomials, by a fifth-order step (value, slope and curvature
  meet).

`ends` 1 is the screw in its own axes facing astern, -1 facing ahead (thrust and torque still positive ahead): the bow
screw of a double-ended ferry whose screws both face outwards. While such a ship stops, one of the two works in the
second quadrant of its own axes and the other in the fourth, and they brake differently: of P/D 0.9 and B5-75,
CT* is -0.372 and -0.492 at beta = 150 degrees.

`ends` 0, mirrored, is a screw that is the same in both directions of travel, CT*(beta + pi) = -CT*(beta):

- with the flow, n v_a > 0: the screw facing astern as above, in the axes of travel;
- against the flow, n v_a < 0: half of each of the two screws above, so that a pair brakes as two tested screws that
  face outwards do. Between them 20 degrees beyond n = 0 and 10 degrees before v_a = 0, where one diagram for both
  directions meets itself, by the same step.

A single screw at the stern is none of these: it has `ends` 1, and brakes less than a mirrored one.

The reaction of hull and flow is `u_thrust` = (1 - t_f) u_ship, the speed at which thrust does work on the ship: what
the shaft gives and the ship does not get is lost in the water. Reynolds number of the tests (2e6); no cavitation,
ventilation or waves.

Source: docs/theory/propulsion.md; data/README.md.
"""

from __future__ import annotations

import csv
import importlib.resources
import math
from functools import cache

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import arctan2, catmull_rom, clip
from shipgrid.units import KilogramPerMetre3, Metre, MetrePerSecond, Newton, NewtonMetre, Radian, RadianPerSecond, Ratio

POINTS = 720
"""Intervals of the table round the circle: 0.5 degrees; cubic interpolation is then within 1e-5 (tested)."""
BLEND = math.radians(10.0)
PITCH_SERIES = (4.0, 0.7)
"""Z and A_E/A_0 of the propeller tested at five pitches, which are the range of `P_D`."""


class Input:
    omega_m: RadianPerSecond = signal("shaft speed, positive ahead")
    v_a: MetrePerSecond = signal("speed of the water into the screw, positive ahead", initial=0.0)
    u_thrust: MetrePerSecond = signal("speed at which thrust does work on the ship, (1 - t_f) u_ship", initial=0.0)


class Output:
    thrust: Newton = signal("thrust of the screw, positive ahead, before thrust deduction")
    tau: NewtonMetre = signal("torque the screw takes from the shaft behind the hull")
    J_adv: Ratio = signal("advance ratio, shown between -2 and 2; 0 at standstill")
    beyond: Ratio = signal("1 while the screw works beyond the open-water diagram and its blends", limiter=True)


class Derived:
    characteristic: Ratio = signal("CT* and CQ* in turn at beta = -180 - 0.5, -180, ... 180 + 0.5 degrees")
    beta_0: Radian = signal("angle beta at which the open-water diagram ends: KT is zero")


@kernel
def forces(omega_m, v_a, p, tables):
    """Thrust [N] and torque at the shaft [N m]: (1) to (3), by a cubic through four points of the table."""
    v_tip = 0.35 * p.D * omega_m
    squared = v_a * v_a + v_tip * v_tip
    if squared.real == 0.0:  # no flow, no force; beta is undefined
        return 0.0 * squared, 0.0 * squared
    place = (arctan2(v_a, v_tip) + math.pi) * (POINTS / (2.0 * math.pi))
    k = min(int(place.real), POINTS - 1) if place.real > 0.0 else 0  # 0 as well where the place is no number
    f = place - k
    w_0, w_1, w_2, w_3 = catmull_rom(f)
    at = int(p.characteristic.real) + 2 * k
    c_t = w_0 * tables[at] + w_1 * tables[at + 2] + w_2 * tables[at + 4] + w_3 * tables[at + 6]
    c_q = w_0 * tables[at + 1] + w_1 * tables[at + 3] + w_2 * tables[at + 5] + w_3 * tables[at + 7]
    q = 0.5 * p.rho * squared * (0.25 * math.pi * p.D * p.D)  # (2)
    return q * c_t, q * p.D * c_q / p.eta_r  # (3)


@kernel
def beyond_diagram(omega_m, v_a, p):
    """1 where the tested series stand alone, 0 on the open-water diagram, its blends, and at standstill."""
    v_tip = 0.35 * p.D.real * omega_m.real
    if v_tip == 0.0 and v_a.real == 0.0:
        return 0.0
    whole = math.pi if p.ends.real == 0.0 else 2.0 * math.pi  # mirrored, the diagram comes again after half a circle
    past = arctan2(v_a.real, v_tip) + BLEND + (math.pi if p.ends.real < 0.0 else 0.0)
    past -= whole * np.floor(past / whole)
    return 1.0 if past > p.beta_0.real + 2.0 * BLEND else 0.0


@kernel
def outputs(u: Input, p: Propeller, y: Output, tables):
    y.thrust, y.tau = forces(u.omega_m, u.v_a, p, tables)
    n_D = u.omega_m / (2.0 * math.pi) * p.D
    y.J_adv = clip(u.v_a / n_D, -2.0, 2.0) if n_D.real != 0.0 else 0.0  # (4)
    y.beyond = beyond_diagram(u.omega_m, u.v_a, p)


@kernel
def losses(u: Input, p: Propeller, tables):
    thrust, tau = forces(u.omega_m, u.v_a, p, tables)
    return tau * u.omega_m - thrust * u.u_thrust


def table(name: str) -> list[dict[str, str]]:
    """Rows of a table of `shipgrid/data`."""
    with importlib.resources.files("shipgrid.data").joinpath(name).open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@cache
def polynomial(coefficient: str) -> np.ndarray:
    """Coefficient and exponents of J, P/D, A_E/A_0, Z of each term of `"KT"` or `"KQ"`, shape (terms, 5)."""
    rows = [row for row in table("wageningen_b_series.csv") if row["coefficient_of"] == coefficient]
    return np.array([[float(row[key]) for key in ("C", "s", "t", "u", "v")] for row in rows])


def open_water(coefficient: str, J_adv, P_D: float, A_E: float, Z: float) -> np.ndarray:
    """Open-water coefficient of the B-series by its polynomial, at the Reynolds number of the tests.

    Parameters
    ----------
    coefficient : {"KT", "KQ"}
        Which.
    J_adv : array_like
        Advance ratio.
    P_D, A_E, Z : float
        Pitch ratio, blade area ratio, number of blades.
    """
    J = np.asarray(J_adv, dtype=float)[..., None]
    C, s, t, u, v = polynomial(coefficient).T
    return (C * J**s * P_D**t * A_E**u * Z**v).sum(axis=-1)


@cache
def fourier() -> dict[tuple[float, float], dict[float, np.ndarray]]:
    """Fourier coefficients AT, BT, AQ, BQ of the tested propellers, shape (harmonics, 4), by (Z, A_E/A_0), then P/D."""
    found: dict[tuple[float, float], dict[float, np.ndarray]] = {}
    rows = table("wageningen_four_quadrant.csv")
    for shape in sorted({(float(r["Z"]), float(r["AE_A0"]), float(r["P_D"])) for r in rows}):
        own = [r for r in rows if (float(r["Z"]), float(r["AE_A0"]), float(r["P_D"])) == shape]
        own.sort(key=lambda r: int(r["k"]))
        values = [[float(r[key]) for key in ("AT", "BT", "AQ", "BQ")] for r in own]
        found.setdefault(shape[:2], {})[shape[2]] = np.array(values)
    return found


def stand_in(P_D: float, A_E: float, Z: float) -> tuple[tuple[float, float], float]:
    """Tested propeller that stands for a screw beyond the polynomials: (Z, A_E/A_0) and P/D, nearest in that order."""
    series = min(fourier(), key=lambda shape: (abs(shape[0] - Z), round(abs(shape[1] - A_E), 9)))
    return series, min(fourier()[series], key=lambda pitch: abs(pitch - P_D))


def at_pitch(P_D: float) -> np.ndarray:
    """Fourier coefficients of B4-70, the one propeller tested at several pitches, linear between them."""
    pitches, values = zip(*fourier()[PITCH_SERIES].items(), strict=True)
    above = int(np.clip(np.searchsorted(pitches, P_D), 1, len(pitches) - 1))
    weight = (P_D - pitches[above - 1]) / (pitches[above] - pitches[above - 1])
    return (1.0 - weight) * values[above - 1] + weight * values[above]


def four_quadrants(coefficient: str, beta, P_D: float, A_E: float, Z: float) -> np.ndarray:
    """CT* or CQ* by the Fourier series of `stand_in`, brought to the screw's pitch by the difference of B4-70.

    Parameters
    ----------
    coefficient : {"T", "Q"}
        Thrust or torque.
    beta : array_like
        Hydrodynamic pitch angle [rad].
    P_D, A_E, Z : float
        Pitch ratio, blade area ratio, number of blades.
    """
    series, pitch = stand_in(P_D, A_E, Z)
    terms = fourier()[series][pitch] + at_pitch(P_D) - at_pitch(pitch)
    a, b = terms.T["TQ".index(coefficient) * 2 :][:2]
    angle = np.asarray(beta, dtype=float)[..., None] * np.arange(len(a))
    return (a * np.cos(angle) + b * np.sin(angle)).sum(axis=-1)


def step(x):
    """0 below x = 0, 1 above x = 1, between them a fifth-order polynomial with flat ends (slope and curvature)."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 + x * (6.0 * x - 15.0))


def zero_thrust(P_D: float, A_E: float, Z: float) -> float:
    """Angle beta [rad] at which the polynomial of KT is zero, to 0.001 in J: that is nothing to the blend."""
    J = np.linspace(0.0, 2.0, 2001)
    return math.atan(J[int(np.argmax(open_water("KT", J, P_D, A_E, Z) <= 0.0))] / (0.7 * math.pi))


def first_quadrant(coefficient: str, beta: np.ndarray, P_D: float, A_E: float, Z: float) -> np.ndarray:
    """CT* or CQ* by the polynomials, from -90 to 90 degrees: (4)."""
    J = 0.7 * math.pi * np.tan(beta)
    return open_water("K" + coefficient, J, P_D, A_E, Z) * 8.0 / (math.pi * (J**2 + (0.7 * math.pi) ** 2))


def as_tested(coefficient: str, beta: np.ndarray, P_D: float, A_E: float, Z: float) -> np.ndarray:
    """CT* or CQ* of the screw in its own axes: polynomials in the first quadrant, blended into the Fourier series."""
    beta = (beta + math.pi) % (2.0 * math.pi) - math.pi
    beta_0 = zero_thrust(P_D, A_E, Z)
    weight = step((beta + BLEND) / BLEND) * step((beta_0 + BLEND - beta) / BLEND)
    near = first_quadrant(coefficient, np.where(weight > 0.0, beta, 0.0), P_D, A_E, Z)
    return weight * near + (1.0 - weight) * four_quadrants(coefficient, beta, P_D, A_E, Z)


def mismatch(P_D: float, A_E: float, Z: float) -> tuple[float, float]:
    """Largest differences of CT* and CQ* between polynomials and Fourier series where they join.

    They join at J_adv = 0 and at the zero of KT.

    Parameters
    ----------
    P_D, A_E, Z : float
        Pitch ratio, blade area ratio, number of blades.
    """
    ends, shape = np.array([0.0, zero_thrust(P_D, A_E, Z)]), (P_D, A_E, Z)
    apart = [np.abs(first_quadrant(c, ends, *shape) - four_quadrants(c, ends, *shape)).max() for c in "TQ"]
    return float(apart[0]), float(apart[1])


def characteristic(coefficient: str, beta: np.ndarray, ends: float, P_D: float, A_E: float, Z: float) -> np.ndarray:
    """CT* or CQ* over `beta` [rad], positive ahead, for the sort of `ends`."""
    if ends > 0.0:
        return as_tested(coefficient, beta, P_D, A_E, Z)
    if ends < 0.0:
        return -as_tested(coefficient, beta + math.pi, P_D, A_E, Z)
    half_turns = np.floor(beta / math.pi)
    beta = beta - math.pi * half_turns  # water from ahead, 0 to 180 degrees; the other half is the mirror of this one
    turned = 0.5 * (step((beta - 0.5 * math.pi) / (2.0 * BLEND)) + step((beta - math.pi + BLEND) / BLEND))
    astern, ahead = (characteristic(coefficient, beta, facing, P_D, A_E, Z) for facing in (1.0, -1.0))
    return (1.0 - 2.0 * (half_turns % 2.0)) * ((1.0 - turned) * astern + turned * ahead)


def derive(propeller: Propeller) -> dict[str, float | np.ndarray]:
    """The table round the circle, with a point more at each end for the cubic; where the diagram ends."""
    beta = -math.pi + 2.0 * math.pi / POINTS * np.arange(-1, POINTS + 2)
    shape = (propeller.P_D, propeller.A_E, propeller.Z)
    curves = [characteristic(c, beta, propeller.ends, *shape) for c in "TQ"]
    return {"characteristic": np.stack(curves, axis=1), "beta_0": zero_thrust(*shape)}


@component(
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    stage="measure",
    outputs=outputs,
    losses=losses,
)
class Propeller(Derived):
    """Fixed-pitch screw behind the hull."""

    D: Metre = param("diameter", default=1.25, above=0.0, source="[DAgostino2020] table A1")
    P_D: Ratio = param(
        "pitch over diameter",
        default=0.9,
        at_least=0.5,
        at_most=1.4,
        source="chosen: motor's torque and speed limits are then met almost together; KT is 0 at J 0.955",
    )
    A_E: Ratio = param("blade area ratio", default=0.75, at_least=0.3, at_most=1.05, source="chosen: B5-75")
    Z: Ratio = param("number of blades", default=5.0, at_least=2.0, at_most=7.0, source="[DAgostino2020] sec. 3.5")
    rho: KilogramPerMetre3 = param(
        "density of water", default=1000.0, above=0.0, source="[DAgostino2020] table A1 (fresh water)"
    )
    eta_r: Ratio = param("relative rotative efficiency", default=1.026, above=0.0, source="[DAgostino2020] table A1")
    ends: Ratio = param(
        "0 mirrored, half of 1 and -1 against the flow; 1 own axes, facing astern; -1 own axes, facing ahead",
        default=0.0,
        at_least=-1.0,
        at_most=1.0,
        source="[DAgostino2020] uses one open-water diagram for both screws and directions",
    )
