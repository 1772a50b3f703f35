"""Quantities as people write them, `1.5 kV`, `30us`, `6 kn`, `0.05 pu`, turned into SI floats, and back.

The number is read here, strictly, and only its unit is handed to pint, against the short list of units below: a
general list knows a `Pa` in every typing slip. Angle, apparent and reactive power and per unit are dimensions of
their own, so that `60 Hz` is no angular speed, `50 kW` no apparent power and `0.2 pu` no voltage. Factors are exact
fractions, so that `30us` is the same float as `30e-6`.
"""

from __future__ import annotations

import difflib
import math
import re
from fractions import Fraction
from functools import lru_cache
from typing import Any

from shipgrid.errors import ParameterError

_UNITS = """
nano- = 1e-9 = n-
micro- = 1e-6 = u- = µ- = μ-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
kilo- = 1e3 = k-
mega- = 1e6 = M-
giga- = 1e9 = G-
metre = [length] = m
second = [time] = s
ampere = [current] = A
gram = [mass] = g
radian = [angle] = rad
per_unit = [per_unit] = pu
volt_ampere = [apparent_power] = VA
var = [reactive_power]
percent = 0.01 = %
tonne = 1000 kilogram = t
minute = 60 second = min
hour = 3600 second = h
nautical_mile = 1852 metre = nmi
knot = nautical_mile / hour = kn
degree = 0.01745329251994329577 radian = deg
revolution = 6.28318530717958647693 radian = rev
rpm = revolution / minute
hertz = 1 / second = Hz
newton = kilogram * metre / second ** 2 = N
joule = newton * metre = J
watt = joule / second = W
watt_hour = watt * hour = Wh
volt = watt / ampere = V
ohm = volt / ampere = Ω = Ohm
siemens = ampere / volt = S
coulomb = ampere * second = C
ampere_hour = ampere * hour = Ah
farad = coulomb / volt = F
weber = volt * second = Wb
henry = weber / ampere = H
"""

EXAMPLES = {
    "V": "750 V",
    "A": "128 A",
    "ohm": "0.25 ohm",
    "H": "0.8 mH",
    "F": "12 uF",
    "W": "270 kW",
    "var": "10 kvar",
    "VA": "50 kVA",
    "C": "128 Ah",
    "s": "30 us",
    "Hz": "60 Hz",
    "rad": "30 deg",
    "rad/s": "450 rpm",
    "N": "18 kN",
    "N m": "5.73 kN m",
    "kg": "377 t",
    "m": "30 m",
    "m/s": "6 kn",
    "pu": "0.05 pu",
    "1": "0.9",
}
"""One way to write a quantity of each common unit, for messages."""

_QUANTITY = re.compile(r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?)\s*(.*)", re.DOTALL)
_UNIT = re.compile(r"(?:1 ?/|/)? ?[A-Za-zµμΩ(][A-Za-z0-9µμΩ()*/^ -]{0,39}|%")


def parse_quantity(text: str, unit: str) -> float:
    """SI value of a quantity written with its unit.

    Parameters
    ----------
    text : str
        As written: a number and a unit; a bare number only where `unit` is `"1"`.
    unit : str
        Expected unit, an SI symbol of `shipgrid.units` (or `"pu"`).

    Returns
    -------
    float
        Value in `unit`, finite.

    Raises
    ------
    ParameterError
        If it is not a number with a unit of that kind; the message says what is expected.
    """
    text = text.strip()
    try:
        value = _value(text, unit)
    except ParameterError as wrong:
        raise ParameterError(f"{wrong}; expected {expectation(unit)}") from None
    return value


def expectation(unit: str) -> str:
    """What a quantity in `unit` looks like, in words."""
    example = f", such as '{EXAMPLES[unit]}'" if unit in EXAMPLES else ""
    return (f"a number without a unit{example}") if unit == "1" else f"a number with a unit of {unit}{example}"


def write_quantity(value: float, unit: str) -> str:
    """The quantity as text that `parse_quantity` reads back to the same float."""
    return f"{value!r}" if unit == "1" else f"{value!r} {unit}"


def show_quantity(value: float, unit: str) -> str:
    """The quantity for people, six digits."""
    return f"{value:g}" if unit == "1" else f"{value:g} {unit}"


def _value(text: str, unit: str) -> float:
    number, given = _split(text)
    if not given:
        if unit != "1":
            raise ParameterError(f"'{text}' has no unit")
        return float(number)
    if given == "pu" and unit != "pu":
        raise ParameterError(f"'{text}': no base exists here for a per-unit value")
    factor = _factor(given, unit)
    if factor is None:
        raise ParameterError(f"'{text}' has the wrong kind of unit")
    value = float(Fraction(number) * factor)
    if not math.isfinite(value):
        raise ParameterError(f"'{text}' is not finite")
    return value


def _split(text: str) -> tuple[str, str]:
    """Number and unit of a quantity, both as text; the number is a finite one."""
    if not text:
        raise ParameterError("nothing is written here")
    # Documents set with a true minus sign are pasted from; both mean the same.
    match = _QUANTITY.fullmatch(text.replace("\N{MINUS SIGN}", "-"))
    if match is None:
        if re.match(r"[+-]?\.?(nan|inf)", text, re.IGNORECASE):
            raise ParameterError(f"'{text}' is not a finite number")
        raise ParameterError(f"'{text}' does not begin with a number")
    number, given = match.groups()
    if re.match(r"[,'_]?[0-9]|\.", given) and not given.startswith(("1/", "1 /")):
        if given.startswith(",") and text.count(",") == 1 and "." not in text:
            raise ParameterError(f"'{text}': the decimal sign is a point, '{text.replace(',', '.')}'")
        raise ParameterError(f"'{text}': digits are written without gaps or signs between them")
    if re.match(r":[0-9]", given):
        raise ParameterError(f"'{text}' is a time of day or a ratio: write a duration with a unit of time, '750 s'")
    if given and _UNIT.fullmatch(given) is None:
        raise ParameterError(f"'{text}': '{given}' is not a unit")
    if not math.isfinite(float(number)):
        raise ParameterError(f"'{text}' is not finite")
    return number, given


@lru_cache(maxsize=1)
def _registry() -> Any:
    # Imported here: it takes a third of a second, and `shipgrid --help` needs no units.
    import pint

    make: Any = pint.UnitRegistry  # its annotations know neither an empty registry nor fractions
    registry = make(None, non_int_type=Fraction)
    for line in _UNITS.strip().splitlines():
        registry.define(line)
    return registry


@lru_cache(maxsize=512)
def _factor(given: str, unit: str) -> Fraction | None:
    """What a quantity in `given` is multiplied with to be in `unit`; None if they are of different kinds.

    Raises
    ------
    ParameterError
        If `given` is no unit.
    """
    registry = _registry()
    wanted = registry.parse_units(_powers(unit)) if unit != "1" else registry.dimensionless
    try:
        found = registry.parse_units(_powers(given))
    except Exception:  # pint answers nonsense with a dozen kinds of error
        known = [*_symbols(), *EXAMPLES]
        near = [symbol for symbol in known if symbol.lower() == given.lower()]
        near = near or difflib.get_close_matches(given, known, n=1, cutoff=0.5)
        hint = f" (nearest: '{near[0]}')" if near else ""
        raise ParameterError(f"'{given}' is not a unit{hint}") from None
    if registry.get_dimensionality(found) != registry.get_dimensionality(wanted):
        return None
    return Fraction(registry.convert(Fraction(1), found, wanted))


def _powers(unit: str) -> str:
    """Unit with powers spelled for pint, `kg m2` as `kg m**2`, and `1/s` and `/s` alike."""
    unit = re.sub(r"([A-Za-zΩ])\^?(-?[0-9])", r"\1**\2", unit.strip())
    return "1" + unit if unit.startswith("/") else unit


def _symbols() -> list[str]:
    """Symbols a unit may be written with, the common prefixed ones included."""
    bare = [line.split("=")[-1].strip() for line in _UNITS.strip().splitlines() if "-" not in line.split("=")[0]]
    bare = [symbol if len(symbol) < 5 else "" for symbol in bare] + ["rpm", "var", "ohm", "km/h"]
    return [s for s in bare if s] + [p + s for p in ("k", "m", "u", "M") for s in ("V", "A", "W", "H", "F", "s", "VA")]
