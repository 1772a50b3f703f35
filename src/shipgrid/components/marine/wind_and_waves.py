"""Wind and waves: what they add to the resistance of a hull in surge.

    v_r = u + v_w cos(gamma)                                             (1)
    T_wind = 1/2 rho_a C_x A_T (|v_r| v_r - |u| u)                       (2)
    T_wave = 1/16 rho g H_s^2 B sqrt(B / L_bwl) u / sqrt(u^2 + u_0^2)    (3)

with the speed v_w of the true wind and the angle gamma from the bow to where it comes from (0: from ahead). A hull's
resistance is that in still air, so (2) has the wind's part alone. C_x is taken the same at all angles, and only what
blows along the ship counts: no leeway. (3) is STAWAVE-1: the added resistance by reflection at the bow of a ship under
way in a head sea within 45 degrees of its course, which therefore is against the ship whichever way it goes; a sea from
elsewhere is not covered, and is no sea here. u_0 = 0.25 m/s makes (3) smooth through standstill. It holds up to
H_s = 2.25 sqrt(L_pp / 100 m); in higher waves `beyond` says so.

Source: STAWAVE-1 as in [ISO15016] annex D; docs/theory/propulsion.md.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute
from shipgrid.units import KilogramPerMetre3, Metre, Metre2, MetrePerSecond, Newton, Radian, Ratio

GRAVITY = 9.81
U_0 = 0.25


class Input:
    u_ship: MetrePerSecond = signal("speed through the water, positive ahead")
    wind_speed: MetrePerSecond = signal("speed of the true wind", initial=0.0)
    wind_from: Radian = signal("where it comes from: angle from the bow", initial=0.0)
    wave_height: Metre = signal("significant height of a head sea", initial=0.0)


class Output:
    T_env: Newton = signal("added resistance of wind and waves")
    T_wind: Newton = signal("added resistance of the wind, positive against the ship going ahead")
    T_wave: Newton = signal("added resistance of the waves, positive against the ship going ahead")
    beyond: Ratio = signal("1 while the waves are higher than the formula holds for", limiter=True)


class Derived:
    k_wave: Ratio = signal("added resistance of the waves over the square of their height [N/m2]")
    H_max: Metre = signal("largest height of waves that the formula holds for")


def derive(p: WindAndWaves) -> dict[str, float]:
    """Constants of (3)."""
    k_wave = p.rho * GRAVITY / 16.0 * p.B * math.sqrt(p.B / p.L_bwl)
    return {"k_wave": k_wave, "H_max": 2.25 * math.sqrt(p.L_pp / 100.0)}


@kernel
def outputs(u: Input, p: WindAndWaves, y: Output):
    v_r = u.u_ship + u.wind_speed * np.cos(u.wind_from)  # (1)
    y.T_wind = 0.5 * p.rho_a * p.C_x * p.A_T * (absolute(v_r) * v_r - absolute(u.u_ship) * u.u_ship)  # (2)
    under_way = u.u_ship / np.sqrt(u.u_ship * u.u_ship + U_0 * U_0)
    y.T_wave = p.k_wave * u.wave_height * u.wave_height * under_way  # (3)
    y.T_env = y.T_wind + y.T_wave
    y.beyond = 1.0 if u.wave_height.real > p.H_max.real else 0.0


@component(input=Input, output=Output, derived=Derived, derive=derive, stage="measure", outputs=outputs)
class WindAndWaves(Derived):
    """Wind along a ship, and a head sea."""

    A_T: Metre2 = param("area above water, seen from ahead", default=60.0, at_least=0.0, source="estimate for a ferry")
    C_x: Ratio = param("wind resistance coefficient", default=0.8, at_least=0.0, source="typical of a ferry, head wind")
    B: Metre = param("breadth", default=8.3, above=0.0, source="[DAgostino2020] table 1")
    L_bwl: Metre = param(
        "length on the waterline from the bow to 95 % of the breadth", default=6.0, above=0.0, source="estimate"
    )
    L_pp: Metre = param("length between perpendiculars", default=38.0, above=0.0, source="[DAgostino2020] table 1")
    rho_a: KilogramPerMetre3 = param("density of air", default=1.225, above=0.0, source="15 C, 1013 hPa")
    rho: KilogramPerMetre3 = param(
        "density of water", default=1000.0, above=0.0, source="[DAgostino2020] table A1 (fresh water)"
    )
