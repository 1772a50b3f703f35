"""The time-line of a scenario file: entries that wait for a condition or for another entry, and their mistakes."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from shipgrid.io.quantities import parse_quantity
from shipgrid.io.scenario_file import read_scenario
from shipgrid.io.ship_file import load_ship
from shipgrid.io.yaml_lines import read_text
from shipgrid.units import KNOT

WAITING = """\
schema: 1
scenario: waiting
duration: 600 s
start: {state: moored, closed: [dc_tie]}
timeline:
  - {name: leave, at: 10 s, set: {propulsion_for.speed_ref: 6 kn}}
  - {when: {signal: bess_aft.soc, above: 60 %}, set: {bess_aft.i_ref: 40 A}}
  - {name: moored, when: [{signal: hull.u_ship, above: -0.1 kn, below: 0.1 kn, for: 5 s}, NEAR], after: leave}
  - {after: [moored, leave], delay: 0.5 min, times: 3, from: 1 min, until: 500 s, set: {propulsion_for.speed_ref: 0 kn}}
  - {when: {signal: dc_for.v_dc, below: 700 V, hysteresis: 5 V}, times: unlimited, optional: true, mode: diesel}
""".replace("NEAR", "{signal: hull.distance, below: 50 m}")


@pytest.fixture(scope="module")
def ship():
    return load_ship("ferry")


def reading(text, ship, overrides=()):
    return read_scenario(read_text(text, "my.yaml"), ship.catalogue, overrides)


def changed(old, new, text=WAITING):
    assert old in text
    return text.replace(old, new, 1)


def test_entries_are_read_with_values_in_si_and_what_they_wait_for_in_words(ship):
    scenario = reading(WAITING, ship).checked()
    soc, moored, stop, diesel = scenario.entries
    assert [tuple(event) for event in scenario.events] == [(10.0, "propulsion_for.speed_ref", pytest.approx(6 * KNOT))]
    assert scenario.named_times == {"leave": 10.0}
    assert (soc.name, soc.text, soc.commands) == ("timeline.1", "bess_aft.soc above 60 %", (("bess_aft.i_ref", 40.0),))
    assert (soc.conditions[0].above, soc.conditions[0].below) == (0.6, math.inf)
    assert (soc.times, soc.optional, soc.start, soc.end, soc.after) == (1, False, 0.0, math.inf, ())
    at_rest, near = moored.conditions
    assert (at_rest.above, at_rest.below, at_rest.hold) == (pytest.approx(-0.1 * KNOT), pytest.approx(0.1 * KNOT), 5.0)
    assert (near.below, moored.commands, moored.after) == (50.0, (), ("leave",))
    assert moored.text == (
        "hull.u_ship above -0.1 kn and below 0.1 kn for 5 s and hull.distance below 50 m, after leave"
    )
    assert (stop.after, stop.delay, stop.times, stop.start, stop.end) == (("moored", "leave"), 30.0, 3, 60.0, 500.0)
    assert stop.text == "30 s after moored or leave"
    assert (diesel.times, diesel.optional, diesel.conditions[0].hysteresis) == (None, True, 5.0)
    assert dict(diesel.commands)["bess_for.on"] == 0.0


def test_a_value_of_a_condition_can_be_set(ship):
    scenario = reading(WAITING, ship, [("timeline.1.when.above", "55 %"), ("timeline.3.delay", "1 s")]).checked()
    assert scenario.entries[0].conditions[0].above == parse_quantity("55 %", "1")
    assert scenario.entries[2].delay == 1.0


E2, E3, E4, E5 = (f"my.yaml:{line}: timeline.{line - 6}" for line in (7, 8, 9, 10))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("bess_aft.soc,", "bess_aft.sock,", E2 + ".when.signal: no signal 'bess_aft.sock' (nearest: 'bess_aft.soc')"),
        ("signal: bess_aft.soc, ", "", E2 + ".when.signal: missing, expected the name of a signal"),
        (
            "above: 60 %",
            "above: 60 A",
            E2 + ".when.above: '60 A' has the wrong kind of unit; expected a number without",
        ),
        ("above: 60 %", "abve: 60 %", E2 + ".when.abve: no such key (nearest: 'above')"),
        ("below: 700 V", "below: 700", E5 + ".when.below: '700' has no unit; expected a number with a unit of V"),
        ("above: -0.1 kn", "above: 0.2 kn", E3 + ".when.0.above: is not less than 'below', so that it never holds"),
        ("for: 5 s", "for: 5", E3 + ".when.0.for: '5' has no unit"),
        ("for: 5 s", "for: 900 s", E3 + ".when.0.for: 900 s is after the end, expected at most 600 s (duration)"),
        ("for: 5 s", "hysteresis: 1 kn", E3 + ".when.0.hysteresis: has an effect only where 'times' is more than 1"),
        ("hysteresis: 5 V", "hysteresis: -5 V", E5 + ".when.hysteresis: is negative, expected 0 or more"),
        (
            "{signal: bess_aft.soc, above: 60 %}",
            "60 %",
            E2 + ".when: is no condition, expected {signal: bess_for.soc, ",
        ),
        ("{signal: bess_aft.soc, above: 60 %}", "[]", E2 + ".when: is no condition, expected {signal: bess_for.soc, "),
        ("{signal: hull.distance, below: 50 m}", "50 m", E3 + ".when.1: is not a mapping, expected {signal: bess_for."),
        (
            "{when: {signal: bess_aft",
            "{at: 5 s, when: {signal: bess_aft",
            E2 + ".at: does not go with 'when' or 'after'",
        ),
        ("{name: leave,", "{name: leave, until: 9 s,", "my.yaml:6: timeline.0.until: goes with 'when' or 'after'"),
        (
            "after: leave}",
            "after: laeve}",
            E3 + ".after: no entry 'laeve' (nearest: 'leave'), expected the name of one",
        ),
        ("[moored, leave]", "[]", E4 + ".after: is empty, expected the name of an entry"),
        ("[moored, leave]", "[moored, {}]", E4 + ".after: is no name, expected that of an entry of the time-line"),
        ("after: [moored, leave], ", "when: {signal: hull.u_ship, below: 1 kn}, ", E4 + ".delay: goes with 'after'"),
        (
            "mode: diesel",
            "mode: diesel, name: timeline.2",
            E5 + ".name: 'timeline.2' is what an entry without a name is called, expected another",
        ),
        ("mode: diesel", "mode: diesel, name: a/b", E5 + ".name: 'a/b' is not a name: it has '/'"),
        ("name: moored", "name: leave", E3 + ".name: 'leave' is the name of the entry on line 6 too, expected another"),
        (
            "times: 3",
            "times: 0",
            E4 + ".times: '0' is no number of times, expected a whole number from 1, or unlimited",
        ),
        ("times: 3", "times: often", E4 + ".times: 'often' is no number of times"),
        ("optional: true", "optional: maybe", E5 + ".optional: 'maybe' is not a choice, expected false or true"),
        ("until: 500 s", "until: 50 s", E4 + ".until: the window ends before it begins"),
        ("delay: 0.5 min", "delay: 0.5", E4 + ".delay: '0.5' has no unit"),
        (
            ", set: {bess_aft.i_ref: 40 A}",
            "",
            E2 + ".set: missing, expected {command: value, ...}, or a name that other",
        ),
        ("i_ref: 40 A", "i_ref: 400 A", E2 + ".set.bess_aft.i_ref: 400 A is out of range"),
        ("mode: diesel", "mode: desel", E5 + ".mode: no mode 'desel' (nearest: 'diesel')"),
        ("{name: leave, at: 10 s,", "{name: leave,", "my.yaml:6: timeline.0.at: missing, expected a time, such as"),
    ],
)
def test_a_mistake_is_named_by_file_line_path_and_expectation(ship, old, new, says):
    found = reading(changed(old, new), ship).problems.lines()
    if "name: leave" not in new:  # else there are those who wait for a name that is gone
        assert len(found) == 1, found
    assert any(problem.startswith(says) for problem in found), found


def test_an_entry_that_can_never_happen_is_named(ship):
    circle = changed("after: leave}", "after: stop}").replace("{after: [moored, leave]", "{name: stop, after: moored")
    why = "waits for it or never happens, expected an entry with a time, or with a condition alone, to begin with"
    assert reading(circle, ship).problems.lines() == [
        E3 + f".after: can never happen: what it follows (stop) {why}",
        E4 + f".after: can never happen: what it follows (moored) {why}",
    ]


def test_all_mistakes_come_at_once(ship):
    text = changed("60 %", "60 A", changed("after: leave", "after: laeve", changed("times: 3", "times: x")))
    assert [line.split(":")[1] for line in reading(text, ship).problems.lines()] == ["7", "8", "9"]


def test_the_example_of_the_how_to_is_valid(ship):
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "time_lines.md").read_text()
    (example, *_) = re.findall(r"```yaml\n(timeline:.*?)```", page, re.DOTALL)
    head = WAITING.partition("timeline:")[0]
    assert [entry.name for entry in reading(head + example, ship).checked().entries][:2] == [
        "genset on",
        "recharge ends",
    ]
