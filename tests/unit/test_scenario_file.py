"""Scenario files: start, time-line and requirements, checked against a ship."""

from __future__ import annotations

import math

import pytest

from shipgrid.errors import InputErrors
from shipgrid.io.scenario_file import load_case, load_scenario, read_scenario
from shipgrid.io.ship_file import bundled, load_ship, read_ship
from shipgrid.io.yaml_lines import read_text
from shipgrid.units import KNOT

SHORT = """\
schema: 1
scenario: short
duration: 60 s
start: {state: moored, closed: [dc_tie], set: {bess_for.i_ref: 20 A}}
timeline:
  - {at: 30 s, set: {bess_for.mode: current}}
  - {at: 10 s, set: {propulsion_for.speed_ref: 6 kn, genset_for.on: true}}
requirements:
  - {name: bus, signal: dc_for.v_dc, band: [715 V, 785 V], from: 5 s}
  - {name: fast, signal: hull.u_ship, max: 10.2 kn, from: 1 s, until: 0.5 min}
  - {name: soc, signal: bess_for.soc, min: 0.4}
  - {name: power, signal: bess_for.p_dc, mean: [-1 kW, 2 kW]}
  - {name: rest, signal: hull.u_ship, abs_max: 0.1 kn}
"""


@pytest.fixture(scope="module")
def ship():
    return load_ship("ferry")


def reading(text, ship, overrides=()):
    return read_scenario(read_text(text, "my.yaml"), ship.catalogue, overrides)


def changed(old, new, text=SHORT):
    assert old in text
    return text.replace(old, new, 1)


def line_of(text, part):
    return next(k for k, line in enumerate(text.splitlines(), start=1) if part in line)


def test_commands_come_in_the_order_of_time_with_values_in_si(ship):
    scenario = reading(SHORT, ship).checked()
    assert (scenario.name, scenario.duration, scenario.step) == ("short", 60.0, None)
    assert [tuple(event) for event in scenario.events] == [
        (10.0, "propulsion_for.speed_ref", pytest.approx(6.0 * KNOT, rel=1e-15)),
        (10.0, "genset_for.on", 1.0),
        (30.0, "bess_for.mode", 3.0),
    ]


def test_a_moored_start_gives_every_command_its_value(ship):
    commands = reading(SHORT, ship).checked().start_commands(ship)
    assert set(commands) == set(ship.commands)
    assert commands["bess_for.on"] == 1.0 and commands["genset_for.on"] == 0.0
    assert (commands["dc_tie.close"], commands["ac_tie.close"]) == (1.0, 0.0)
    assert commands["bess_for.i_ref"] == 20.0 and commands["bess_aft.i_ref"] == 0.0
    assert commands["bess_for.mode"] == 1.0


def test_a_cold_start_has_everything_off(ship):
    commands = reading(changed("moored", "cold"), ship).checked().start_commands(ship)
    assert all(value == 0.0 for path, value in commands.items() if path.endswith(".on"))


def test_requirements_are_in_the_unit_of_their_signal(ship):
    bus, fast, soc, power, rest = reading(SHORT, ship).checked().requirements
    assert (bus.measure, bus.low, bus.high, bus.start, bus.end) == ("band", 715.0, 785.0, 5.0, math.inf)
    assert (fast.low, fast.high, fast.start, fast.end) == (-math.inf, pytest.approx(10.2 * KNOT), 1.0, 30.0)
    assert (soc.measure, soc.low, soc.high) == ("min", 0.4, math.inf)
    assert (power.measure, power.low, power.high) == ("mean", -1e3, 2e3)
    assert (rest.measure, rest.low, rest.high) == ("abs_max", 0.0, pytest.approx(0.1 * KNOT))


def test_rules_in_time_and_differences_are_read(ship):
    softened = changed("max: 10.2 kn", "max: 10.2 kn, recovery: 1500 ms").replace(
        "abs_max: 0.1 kn", "abs_max: 0.1 kn, settles: 0.5 min"
    )
    softened = softened.replace("band: [715 V, 785 V]", "spread: 4 V, minus: dc_aft.v_dc")
    bus, fast, _, _, rest = reading(softened, ship).checked().requirements
    assert (bus.measure, bus.low, bus.high, bus.signal, bus.minus) == ("spread", 0.0, 4.0, "dc_for.v_dc", "dc_aft.v_dc")
    assert (fast.rule, fast.allowed) == ("recovery", 1.5)
    assert (rest.rule, rest.allowed) == ("settles", 30.0)


def test_the_source_of_a_requirement_is_read_where_there_is_one(ship):
    read = reading(changed("min: 0.4", "min: 0.4, source: paper text"), ship).checked().requirements
    assert [requirement.source for requirement in read] == ["", "", "paper text", "", ""]


def test_the_step_a_scenario_asks_for_is_read(ship):
    assert reading(changed("60 s\n", "60 s\nstep: 60 us\n"), ship).checked().step == 60e-6


TIME = "my.yaml:6: timeline.0.at: "
SET = "my.yaml:7: timeline.1.set."


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("at: 30 s", "at: 90 s", TIME + "90 s is after the end, expected at most 60 s (duration)"),
        ("at: 30 s", "at: -3 s", TIME + "-3 s is before the start, expected 0 s or later"),
        ("at: 30 s", "at: 12:30", TIME + "'12:30' is a time of day or a ratio: write a duration with a unit of time"),
        ("at: 30 s", "at: 30", TIME + "'30' has no unit; expected a number with a unit of s"),
        ("at: 30 s", "at: 1,5 min", TIME + "'1,5 min': the decimal sign is a point, '1.5 min'"),
        ("at: 30 s", "at: nan s", TIME + "'nan s' is not a finite number"),
        ("{at: 30 s, ", "{", "my.yaml:6: timeline.0.at: missing, expected a time"),
        ("at: 30 s", "at: 30 s, to: 3", "my.yaml:6: timeline.0.to: no such key"),
        ("{at: 30 s, set: {bess_for.mode: current}}", "{at: 30 s}", "my.yaml:6: timeline.0.set: missing"),
        ("{at: 30 s, set: {bess_for.mode: current}}", "30 s", "my.yaml:6: timeline.0: is not a mapping"),
        ("mode: current", "mode: curent", "timeline.0.set.bess_for.mode: 'curent' is not a choice, expected droop or"),
        ("on: true", "on: 1", SET + "genset_for.on: '1' is not a choice, expected false or true"),
        ("6 kn", "60 kn", SET + "propulsion_for.speed_ref: 60 kn is out of range, expected -6.5 .. 6.5 m/s (ship"),
        ("6 kn", "6 A", SET + "propulsion_for.speed_ref: '6 A' has the wrong kind of unit; expected a number with a"),
        ("6 kn", "0.2 pu", SET + "propulsion_for.speed_ref: '0.2 pu': no base exists here"),
        ("6 kn", "", SET + "propulsion_for.speed_ref: is not one value, expected -6.5 .. 6.5 m/s"),
        ("for.speed_ref", "for.sped_ref", "propulsion_for has no command 'sped_ref' (nearest: 'speed_ref')"),
        ("propulsion_for.speed", "propulsin_for.speed", "no such command (nearest: 'propulsion_for.speed_ref')"),
        ("timeline:", "timelin:", "my.yaml:5: timelin: no such key (nearest: 'timeline')"),
        ("state: moored", "state: mored", "my.yaml:4: start.state: no state 'mored', expected moored or cold"),
        ("state: moored, ", "", "my.yaml:4: start.state: missing, expected moored or cold"),
        ("closed: [dc_tie]", "closed: [dc_tye]", "my.yaml:4: start.closed.0: no breaker 'dc_tye' (nearest: 'dc_tie')"),
        ("closed: [dc_tie]", "closed: dc_tie", "my.yaml:4: start.closed: is not a list"),
        ("i_ref: 20 A", "i_ref: 200 A", "my.yaml:4: start.set.bess_for.i_ref: 200 A is out of range, expected -192 .."),
        ("duration: 60 s", "duration: 0 s", "my.yaml:3: duration: nothing lasts 0 s"),
        ("duration: 60 s", "duration: 60", "my.yaml:3: duration: '60' has no unit"),
        ("duration: 60 s", "duration: 60 s\nduration: 70 s", "my.yaml:4: duration: duplicate key, first given on line"),
        ("duration: 60 s", "duration: 60 s\nstep: 1 s", "my.yaml:4: step: is out of range, expected 1 us .. 1000 us"),
        ("scenario: short\n", "", "my.yaml:1: scenario: missing"),
        ("schema: 1", "schema: 9", "my.yaml:1: schema: '9' is not known to this version, expected 1"),
        ("dc_for.v_dc", "dc_for.v_cd", "my.yaml:9: requirements.0.signal: no signal 'dc_for.v_cd' (nearest: 'dc_"),
        ("[715 V, 785 V]", "[785 V, 715 V]", "my.yaml:9: requirements.0.band: the lower limit is not below the upper"),
        ("[715 V, 785 V]", "[715 V]", "my.yaml:9: requirements.0.band: is not a pair, expected [low, high]"),
        ("[715 V, 785 V]", "[715, 785 V]", "my.yaml:9: requirements.0.band.0: '715' has no unit"),
        ("band: [715 V, 785 V], ", "", "my.yaml:9: requirements.0: has no limit, expected one of band, min, max"),
        ("max: 10.2 kn", "max: 10.2 kn, min: 1 kn", "my.yaml:10: requirements.1: has min and max, expected one of"),
        (
            "max: 10.2 kn",
            "max: 10.2 kn, minus: dc_for.v_dc",
            "requirements.1.minus: dc_for.v_dc is in V, hull.u_ship in m/s",
        ),
        ("max: 10.2 kn", "max: 10.2 kn, minus: hull.v", "my.yaml:10: requirements.1.minus: no signal 'hull.v'"),
        (
            "max: 10.2 kn",
            "max: 10.2 kn, settles: 1 s, recovery: 1 s",
            "requirements.1: has recovery and settles, expected",
        ),
        (
            "2 kW]",
            "2 kW], recovery: 1 s",
            "my.yaml:12: requirements.3.recovery: does not go with mean, expected one of band",
        ),
        ("until: 0.5 min", "until: 0.5 s", "my.yaml:10: requirements.1.until: the window ends before it begins"),
        ("until: 0.5 min", "until: 5 min", "my.yaml:10: requirements.1.until: 5 min is after the end"),
        ("name: fast, ", "", "my.yaml:10: requirements.1.name: missing, expected a name"),
        ("name: fast", "name: bus", "my.yaml:10: requirements.1.name: 'bus' is the name of the requirement on line 9"),
        (
            "min: 0.4",
            "min: 0.4, source: ",
            "my.yaml:11: requirements.2.source: is not one value, expected where the req",
        ),
        ("min: 0.4", "min: 0.4 V", "my.yaml:11: requirements.2.min: '0.4 V' has the wrong kind of unit"),
    ],
)
def test_a_mistake_is_named_by_file_line_path_and_expectation(ship, old, new, says):
    found = reading(changed(old, new), ship).problems.lines()
    if "timelin:" in new or "duration: 60" in old:  # these take other mistakes with them
        assert any(problem.startswith(says) for problem in found), found
    else:
        assert len(found) == 1, found
        assert says in found[0] and found[0].startswith("my.yaml:")


def test_a_command_given_twice_at_one_instant_is_named_with_both_lines(ship):
    text = changed("{at: 10 s, set: {", "{at: 30 s, set: {bess_for.mode: droop, ")
    assert reading(text, ship).problems.lines() == [
        "my.yaml:7: timeline.1.set.bess_for.mode: is given at 30 s on line 6 too; expected once"
    ]


def test_all_mistakes_come_at_once(ship):
    text = changed("at: 30 s", "at: 90 s", changed("6 kn", "60 kn", changed("715 V,", "715,")))
    assert [line.split(":")[1] for line in reading(text, ship).problems.lines()] == ["6", "7", "9"]


def test_the_mistakes_of_ship_and_scenario_come_in_one_go_and_only_once_each(tmp_path):
    ferry = bundled("ship")["ferry"].read_text()
    # The inverter's kind is unknown, so nothing is said about the commands of that item: they may be right.
    text = changed("L: 0.8 mH", "L: -0.8 mH", changed("kind: inverter,", "kind: invertr,", ferry))
    (tmp_path / "ship.yaml").write_text(text)
    scenario = changed("genset_for.on: true", "inverter_for.on: true", changed("at: 30 s", "at: 90 s"))
    (tmp_path / "scenario.yaml").write_text(scenario)
    with pytest.raises(InputErrors) as caught:
        load_case(tmp_path / "ship.yaml", tmp_path / "scenario.yaml")
    said = "\n".join(caught.value.problems)
    assert f"ship.yaml:{line_of(text, 'invertr')}: equipment.inverter_for.kind" in said
    assert "-0.8 mH is out of range" in said
    assert "scenario.yaml:6: timeline.0.at: 90 s is after the end" in said
    assert "inverter_for.on" not in said


def test_overrides_reach_the_file_their_path_leads_into():
    ship, scenario = load_case(
        "ferry",
        "mission",
        [
            ("equipment.bess_for.capacity", "160 Ah"),
            ("duration", "3500 s"),
            ("start.set.bess_for.i_ref", "10 A"),
            ("timeline.0.set.propulsion_for.speed_ref", "5 kn"),
            ("timeline.0.at", "11 s"),
        ],
    )
    assert ship.item("bess_for").capacity == 160.0 * 3600.0
    assert scenario.duration == 3500.0
    assert scenario.start_commands(ship)["bess_for.i_ref"] == 10.0
    first = {event.path: event for event in scenario.events if event.at == 11.0}
    assert first["propulsion_for.speed_ref"].value == pytest.approx(5.0 * KNOT)
    assert first["propulsion_aft.speed_ref"].value == pytest.approx(6.0 * KNOT)


def test_mistakes_in_overrides_say_which_override():
    with pytest.raises(InputErrors) as caught:
        load_case(
            "ferry", "mission", [("equipment.bess_for.capacity", "160"), ("timeline.99.at", "3 s"), ("duratio", "3 s")]
        )
    first, second, third = caught.value.problems
    assert first.startswith("--set equipment.bess_for.capacity=160: equipment.bess_for.capacity: '160' has no unit")
    assert second.startswith("--set timeline.99.at=3 s: timeline.99.at: '99' is not a place in a list of")
    assert third.startswith("--set duratio=3 s: duratio: no such key (nearest: 'duration')")


def test_an_unknown_scenario_is_named_with_the_nearest(ship):
    with pytest.raises(InputErrors, match=r"misson: no bundled scenario of that name \(nearest: 'mission'\)"):
        load_scenario("misson", ship)


def test_a_scenario_is_checked_again_for_another_ship(ship):
    scenario = reading(SHORT, ship).checked()
    ferry = bundled("ship")["ferry"].read_text()
    without_aft = "\n".join(
        line
        for line in ferry.splitlines()
        if not any(word in line for word in ("_aft:", "dc_tie:", "ac_tie:", "parts:"))
    )
    smaller = read_ship(read_text(without_aft, "small.yaml")).checked()
    with pytest.raises(InputErrors, match=r"start\.closed\.0: no breaker 'dc_tie'"):
        scenario.for_ship(smaller)


def test_a_variant_of_a_scenario(ship):
    scenario = reading(SHORT, ship).checked()
    assert scenario.replace("duration", "90 s", ship).duration == 90.0
    with pytest.raises(InputErrors, match="after the end"):
        scenario.replace("duration", "20 s", ship)


# The bundled mission


@pytest.fixture(scope="module")
def mission(ship):
    return load_scenario("mission", ship)


def test_the_mission_follows_its_time_line(mission, ship):
    given = {(event.at, event.path): event.value for event in mission.events}
    assert given[10.0, "propulsion_for.speed_ref"] == pytest.approx(6.0 * KNOT)
    assert given[310.0, "genset_for.on"] == 1.0
    assert given[310.0, "propulsion_aft.speed_ref"] == pytest.approx(10.0 * KNOT)
    assert given[1390.0, "propulsion_for.speed_ref"] == pytest.approx(6.0 * KNOT)
    assert given[1420.0, "genset_for.on"] == 0.0
    assert given[1560.0, "propulsion_for.speed_ref"] == 0.0
    assert given[1800.0, "propulsion_for.speed_ref"] == pytest.approx(-6.0 * KNOT)
    assert mission.duration == 3400.0
    assert {path for _, path in given if path.endswith("aft.on")} == {"genset_aft.on"}
    start = mission.start_commands(ship)
    assert (start["dc_tie.close"], start["ac_tie.close"], start["genset_for.on"]) == (1.0, 0.0, 0.0)


def test_the_batteries_have_40_amperes_without_a_genset_and_minus_128_with_one(mission):
    """Within the 30 s that a genset takes to start, or to be told to stop."""
    genset, i_ref, changes = 0.0, {}, []
    for at, path, value in mission.events:
        if path.startswith("genset"):
            genset = value
            changes.append((at, genset))
        if path.endswith("i_ref"):
            i_ref.setdefault(path, []).append((at, value))
    assert set(i_ref) == {"bess_for.i_ref", "bess_aft.i_ref"}
    for given in i_ref.values():
        assert [value for _, value in given] == [40.0, -128.0, 40.0, -128.0, 40.0]
        assert all(abs(a - b) <= 30.0 for (a, _), (b, _) in zip(given[1:], changes, strict=True))


def test_both_ways_have_the_same_requirements_at_their_cruising_speed(mission):
    steady = [r for r in mission.requirements if r.signal in ("genset_for.p_pu", "genset_aft.p_pu") and r.low > 0.0]
    assert [(r.low, r.high) for r in steady] == [(0.46, 0.56)] * 2
    there, back = (r for r in mission.requirements if r.signal == "propulsion_for.omega_m" and abs(r.low) > 25.0)
    assert (there.low, there.high) == (-back.high, -back.low)


@pytest.mark.parametrize("name", ["dc-regulation", "ac-regulation", "mission", "round-trips"])
def test_every_requirement_of_the_papers_experiments_says_whose_it_is(ship, name):
    sources = {requirement.source for requirement in load_scenario(name, ship).requirements}
    assert {"paper text", "ours"} <= sources <= {"paper text", "paper axis", "ours"}


def with_mode(entry):
    return changed("  - {at: 30 s, set: {bess_for.mode: current}}", f"  - {entry}")


def given_at_30(text, ship):
    return {e.path: e.value for e in reading(text, ship).checked().events if e.at == 30.0}


def test_a_mode_is_its_set_of_commands(ship):
    gensets, batteries = ("genset_for", "genset_aft"), ("bess_for", "bess_aft")
    rectifiers = {"rectifier_for.mode": 0.0, "rectifier_aft.mode": 0.0}
    droop = {f"{b}.on": 1.0 for b in batteries} | {f"{b}.mode": 1.0 for b in batteries}
    electric = given_at_30(with_mode("{at: 30 s, mode: full-electric}"), ship)
    assert electric == droop | {f"{g}.on": 0.0 for g in gensets} | {f"{b}.i_ref": 0.0 for b in batteries}
    assert given_at_30(with_mode("{at: 30 s, mode: hybrid}"), ship) == droop | rectifiers | {"genset_for.on": 1.0}
    diesel = given_at_30(with_mode("{at: 30 s, mode: diesel}"), ship)
    assert diesel == rectifiers | {f"{g}.on": 1.0 for g in gensets} | {f"{b}.on": 0.0 for b in batteries}


def test_commands_beside_a_mode_go_before_its_own(ship):
    entry = "{at: 30 s, mode: hybrid, set: {genset_aft.on: true, genset_for.on: false, bess_for.i_ref: -128 A}}"
    given = given_at_30(with_mode(entry), ship)
    assert (given["genset_for.on"], given["genset_aft.on"], given["bess_for.i_ref"]) == (0.0, 1.0, -128.0)
    assert given["bess_aft.on"] == 1.0


def test_an_unknown_mode_is_named_with_those_there_are(ship):
    text = with_mode("{at: 30 s, mode: hybird}")
    with pytest.raises(InputErrors) as wrong:
        reading(text, ship).checked()
    line = line_of(text, "hybird")
    assert str(wrong.value) == (
        f"my.yaml:{line}: timeline.0.mode: no mode 'hybird' (nearest: 'hybrid'), expected full-electric, hybrid, diesel"
    )
