"""Units as types: plain floats in SI, with the unit attached for people and for checks.

`Henry` is `Annotated[float, Unit("H")]`: a float to the compiler and to the type checker, a unit to the
documentation, the recorder and the connection check. Everything inside the package is SI; the functions below
turn what people say (knots, revolutions a minute, ampere hours) into SI at the border.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated


@dataclass(frozen=True)
class Unit:
    """A unit of measure: its SI symbol as written in files and on axes (`"1"` where there is none)."""

    symbol: str


Volt = Annotated[float, Unit("V")]
Ampere = Annotated[float, Unit("A")]
Ohm = Annotated[float, Unit("ohm")]
Siemens = Annotated[float, Unit("S")]
Henry = Annotated[float, Unit("H")]
Farad = Annotated[float, Unit("F")]
Weber = Annotated[float, Unit("Wb")]
Watt = Annotated[float, Unit("W")]
Var = Annotated[float, Unit("var")]
VoltAmpere = Annotated[float, Unit("VA")]
Joule = Annotated[float, Unit("J")]
Coulomb = Annotated[float, Unit("C")]
Second = Annotated[float, Unit("s")]
Hertz = Annotated[float, Unit("Hz")]
Radian = Annotated[float, Unit("rad")]
RadianPerSecond = Annotated[float, Unit("rad/s")]
RadianPerSecond2 = Annotated[float, Unit("rad/s2")]
Newton = Annotated[float, Unit("N")]
NewtonMetre = Annotated[float, Unit("N m")]
KilogramMetre2 = Annotated[float, Unit("kg m2")]
Kilogram = Annotated[float, Unit("kg")]
KilogramPerMetre3 = Annotated[float, Unit("kg/m3")]
Metre = Annotated[float, Unit("m")]
Metre2 = Annotated[float, Unit("m2")]
MetrePerSecond = Annotated[float, Unit("m/s")]
MetrePerSecond2 = Annotated[float, Unit("m/s2")]
PerUnit = Annotated[float, Unit("pu")]
PerUnitPerSecond = Annotated[float, Unit("pu/s")]
PerSecond = Annotated[float, Unit("1/s")]
VoltPerAmpere = Annotated[float, Unit("V/A")]
VoltPerAmpereSecond = Annotated[float, Unit("V/(A s)")]
AmperePerVolt = Annotated[float, Unit("A/V")]
AmperePerVoltSecond = Annotated[float, Unit("A/(V s)")]
AmperePerSecond = Annotated[float, Unit("A/s")]
VoltPerSecond = Annotated[float, Unit("V/s")]
VoltPerCoulomb = Annotated[float, Unit("V/C")]
PerCoulomb = Annotated[float, Unit("1/C")]
Ratio = Annotated[float, Unit("1")]

KNOT = 1852.0 / 3600.0
"""One knot in m/s (international nautical mile of 1852 m)."""


def knots(value: float) -> float:
    """Speed in m/s of a speed in knots."""
    return value * KNOT


def rpm(value: float) -> float:
    """Angular speed in rad/s of revolutions a minute."""
    return value * 2.0 * math.pi / 60.0


def ampere_hours(value: float) -> float:
    """Charge in coulomb of ampere hours."""
    return value * 3600.0
