"""Quantities as people write them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shipgrid import units
from shipgrid.errors import ParameterError
from shipgrid.io.quantities import EXAMPLES, parse_quantity, write_quantity

UNITS = sorted({item.__metadata__[0].symbol for item in vars(units).values() if hasattr(item, "__metadata__")})


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("1.5 kV", "V", 1500.0),
        ("30us", "s", 30e-6),
        ("30 µs", "s", 30e-6),
        ("10 min", "s", 600.0),
        ("1 h", "s", 3600.0),
        ("6 kn", "m/s", 6.0 * 1852.0 / 3600.0),
        ("-6 kn", "m/s", -6.0 * 1852.0 / 3600.0),
        ("\N{MINUS SIGN}128 A", "A", -128.0),
        ("18 km/h", "m/s", 5.0),
        ("0.05 pu", "pu", 0.05),
        ("0.02 pu/s", "pu/s", 0.02),
        ("128 Ah", "C", 460800.0),
        ("750 V", "V", 750.0),
        ("30 m", "m", 30.0),
        ("2 nmi", "m", 3704.0),
        ("450 rpm", "rad/s", 450.0 * 2.0 * math.pi / 60.0),
        ("180 deg", "rad", math.pi),
        ("377 t", "kg", 377e3),
        ("50 kVA", "VA", 50e3),
        ("10 kvar", "var", 10e3),
        ("5 kohm", "ohm", 5e3),
        ("5 kΩ", "ohm", 5e3),
        ("0.8 mH", "H", 0.8e-3),
        ("12 uF", "F", 12e-6),
        ("5.73 kN m", "N m", 5730.0),
        ("383.4 kg m2", "kg m2", 383.4),
        ("2 m/s2", "m/s2", 2.0),
        ("471 V/(A s)", "V/(A s)", 471.0),
        ("7 1/s", "1/s", 7.0),
        ("7 /s", "1/s", 7.0),
        ("0.9", "1", 0.9),
        ("60 %", "1", 0.6),
        ("1e-3 H", "H", 1e-3),
        (".5 s", "s", 0.5),
        ("  750   V ", "V", 750.0),
    ],
)
def test_a_quantity_is_read_in_the_expected_unit(text, unit, value):
    assert parse_quantity(text, unit) == pytest.approx(value, rel=1e-15)  # one rounding of the float


def test_a_decimal_fraction_is_the_float_of_the_same_name():
    # 30 * 1e-6 is another float than 30e-6; a step read from a file must be the one written in Python.
    assert parse_quantity("30us", "s") == 30e-6
    assert parse_quantity("0.3 mH", "H") == 0.3e-3 or parse_quantity("0.3 mH", "H") == 0.0003


@pytest.mark.parametrize(
    ("text", "unit", "says"),
    [
        ("1,5 kV", "V", "the decimal sign is a point, '1.5 kV'"),
        ("1,234.5 V", "V", "digits are written without gaps"),
        ("1 000 V", "V", "digits are written without gaps"),
        ("1_000 V", "V", "digits are written without gaps"),
        ("1.5.2 V", "V", "digits are written without gaps"),
        ("nan V", "V", "not a finite number"),
        ("-inf", "V", "not a finite number"),
        (".inf", "V", "not a finite number"),
        ("1e999 V", "V", "is not finite"),
        ("", "V", "nothing is written"),
        ("V", "V", "does not begin with a number"),
        ("true", "V", "does not begin with a number"),
        ("--5 V", "V", "does not begin with a number"),
        ("٣ V", "V", "does not begin with a number"),
        ("12:30", "s", "write a duration with a unit of time, '750 s'"),
        ("0.2 pu", "V", "no base exists here for a per-unit value"),
        ("0.9 pu", "1", "no base exists here for a per-unit value"),
        ("750", "V", "has no unit; expected a number with a unit of V, such as '750 V'"),
        ("0.05", "pu", "has no unit; expected a number with a unit of pu"),
        ("0.9 V", "1", "expected a number without a unit"),
        ("6 kn", "A", "wrong kind of unit; expected a number with a unit of A"),
        ("5 kg", "pu", "wrong kind of unit; expected a number with a unit of pu"),
        ("50 kW", "VA", "wrong kind of unit"),
        ("60 Hz", "rad/s", "wrong kind of unit"),
        ("450 rpm", "Hz", "wrong kind of unit"),
        ("750 v", "V", "'v' is not a unit (nearest: 'V')"),
        ("128 ah", "C", "'ah' is not a unit (nearest: 'Ah')"),
        ("750 volts!", "V", "'volts!' is not a unit"),
        ("5 m; import os", "m", "is not a unit"),
        ("5 V^9999999999", "V", "wrong kind of unit"),
        ("5 (((", "V", "is not a unit"),
    ],
)
def test_what_is_no_such_quantity_is_refused_and_said_why(text, unit, says):
    with pytest.raises(ParameterError) as caught:
        parse_quantity(text, unit)
    assert says in str(caught.value)
    assert "expected" in str(caught.value)


@pytest.mark.parametrize("unit", UNITS)
def test_every_unit_of_the_package_can_be_written_in_a_file(unit):
    assert parse_quantity(write_quantity(2.5, unit), unit) == 2.5


def test_the_examples_in_messages_are_right():
    for unit, example in EXAMPLES.items():
        assert math.isfinite(parse_quantity(example, unit))


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(UNITS))
def test_what_is_written_reads_back_to_the_same_float(value, unit):
    assert parse_quantity(write_quantity(value, unit), unit) == value


@given(
    st.floats(min_value=-1e9, max_value=1e9),
    st.sampled_from([("mA", "A", 1e-3), ("kV", "V", 1e3), ("MW", "W", 1e6), ("us", "s", 1e-6), ("Ah", "C", 3600.0)]),
)
def test_a_prefix_is_a_factor(value, named):
    written, unit, factor = named
    assert parse_quantity(f"{value!r} {written}", unit) == pytest.approx(value * factor, rel=1e-15)


@given(st.text(max_size=20), st.sampled_from(UNITS))
def test_any_text_is_a_finite_number_or_refused(text, unit):
    try:
        assert math.isfinite(parse_quantity(text, unit))
    except ParameterError as wrong:
        assert "expected" in str(wrong)
