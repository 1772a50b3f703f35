"""A ship made in Python is the ship that its file says, and is checked like one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.equipment.bess import Bess
from shipgrid.equipment.ship import DcBusbar
from shipgrid.equipment.ship_text import ship_text
from shipgrid.errors import InputErrors
from shipgrid.io.ship_file import read_ship
from shipgrid.io.yaml_lines import read_text
from shipgrid.scenarios.case import build

BUSES = {"dc": {"kind": "dc", "v_n": "900 V"}}
BATTERY = {"kind": "bess", "bus": "dc", "v_n": "600 V", "capacity": "200 Ah", "soc_0": "0.7"}


def parts_of(ship):
    return {name: getattr(ship, name) for name in ("name", "buses", "equipment", "hull", "parts")}


def test_the_ferry_made_of_its_objects_is_the_ferry():
    ferry = sg.load_ship("ferry")
    made = sg.Ship(**parts_of(ferry))
    assert parts_of(made) == parts_of(ferry) and made == ferry
    again = read_ship(read_text(made.text, "again")).checked()
    assert parts_of(again) == parts_of(ferry)
    one, other = (build(ship, 30e-6) for ship in (ferry, made))
    assert np.array_equal(one.layout.initial, other.layout.initial)
    assert all(np.array_equal(a, b) for a, b in zip(one.net, other.net, strict=True))


def test_the_ferry_with_every_value_changed_survives_its_text():
    """Values that are not at their defaults, blocks, curves and words among them."""
    ferry = sg.load_ship("ferry")
    battery = dataclasses.replace(ferry.item("bess_for"), soc_0=0.123456789, v_n=437.1)
    hull = dataclasses.replace(ferry.hull, resistance=((2.0, 1.0e3), (5.144, 18.06e3)))
    made = sg.Ship("other", ferry.buses, {**ferry.equipment, "bess_for": battery}, hull, ferry.parts)
    assert made.item("bess_for") == battery and made.hull == hull
    assert read_ship(read_text(made.text, "again")).checked() == made


def test_a_ship_is_made_as_its_file_says_it_or_of_objects():
    said = sg.Ship("bench", BUSES, {"bess": BATTERY})
    objects = sg.Ship(
        "bench",
        {"dc": DcBusbar(v_n=900.0)},
        {"bess": Bess(bus="dc", v_n=600.0, capacity=200.0 * 3600.0, soc_0=0.7)},
    )
    assert said == objects
    assert said.item("bess").soc_0 == 0.7
    assert repr(said) == "<Ship bench: 1 item, 1 bus>"
    assert said.replace("equipment.bess.soc_0", "0.4").item("bess").soc_0 == 0.4
    assert "dc.v_dc" in build(said, 30e-6).layout.index


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"bus": "ac"}, "there is no 'ac'"),
        ({"v_n": "600"}, "equipment.bess.v_n"),
        ({"v_n": "950 V"}, "expected less than the bus"),
        ({"capcity": "3 Ah"}, "no such key (nearest: 'capacity')"),
        ({"kind": "bes"}, "no kind of equipment 'bes' (nearest: 'bess')"),
    ],
)
def test_mistakes_are_those_of_a_file(changes, problem):
    with pytest.raises(InputErrors) as wrong:
        sg.Ship("bench", BUSES, {"bess": BATTERY | changes})
    assert problem in str(wrong.value)
    assert "ship made in Python" in str(wrong.value)


def test_texts_that_yaml_would_take_for_something_else_are_quoted():
    text = ship_text("a: b", {"on": {"kind": "dc", "v_n": "9 V"}}, {})
    document = read_text(text, "text")
    assert not document.problems
    assert document.plain()["ship"] == "a: b"
