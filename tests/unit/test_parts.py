"""Which parts a plant is cut into, as a person asks for it."""

from __future__ import annotations

import pytest

from shipgrid.errors import ParameterError
from shipgrid.io.ship_file import bundled, load_ship, read_ship
from shipgrid.io.yaml_lines import read_text
from shipgrid.scenarios.parts import partition_of, parts_wanted

FERRY = bundled("ship")["ferry"].read_text()
OWN = {"for": ("dc_for",), "aft": ("dc_aft",), "grid": ("ac_for", "ac_aft")}
STEP = 30e-6


def found(ship, asked, step=STEP):
    groups = parts_wanted(ship, asked, step)
    assert groups is not None
    return groups


def without_parts():
    return read_ship(read_text(FERRY[: FERRY.index("parts:")], "my.yaml")).checked()


@pytest.mark.parametrize("asked", [None, 1, "1", {}])
def test_a_plant_stays_whole_unless_more_is_asked_for(asked):
    assert parts_wanted(load_ship(), asked, STEP) is None


def test_the_parts_of_the_ships_own_file_are_taken_by_the_word_for_them():
    assert parts_wanted(load_ship(), "ship", STEP) == OWN


def test_groups_of_buses_are_taken_as_they_are():
    groups = {"dc": ["dc_for", "dc_aft"], "ac": ["ac_for", "ac_aft"]}
    assert parts_wanted(load_ship(), groups, STEP) == {"dc": ("dc_for", "dc_aft"), "ac": ("ac_for", "ac_aft")}


@pytest.mark.parametrize("asked", [3, "3"])
def test_a_number_of_parts_is_found_where_lines_have_little_surplus(asked):
    groups = found(without_parts(), asked)
    assert list(map(set, groups.values())) == [
        {"dc_for", "genset_for.terminals"},
        {"dc_aft", "genset_aft.terminals"},
        {"ac_for", "ac_aft"},
    ]
    assert all(line.share < 0.05 for line in partition_of(without_parts(), groups, STEP).lines)


def test_more_parts_than_there_can_be_are_as_many_as_there_are():
    assert len(found(load_ship(), 99)) == 5  # each DC bus, each genset, the hotel grid


def test_at_a_long_step_no_line_has_little_surplus():
    assert parts_wanted(load_ship(), 3, 90e-6) is None
    assert min(line.share for line in partition_of(load_ship(), OWN, 90e-6).lines) > 0.05


@pytest.mark.parametrize("asked", ["shp", "0", "-1", "2.5", 0, 2.5, True])
def test_what_is_no_number_of_parts_is_refused(asked):
    with pytest.raises(ParameterError, match=r"is no number of parts, expected 1 or more, or 'ship'"):
        parts_wanted(load_ship(), asked, STEP)


def test_a_ship_without_parts_of_its_own_says_so():
    with pytest.raises(ParameterError, match="the file of ferry has no section 'parts'"):
        parts_wanted(without_parts(), "ship", STEP)
