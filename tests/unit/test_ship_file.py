"""Ship files: what is read, and every mistake found at once with its place."""

from __future__ import annotations

import re

import pytest

from shipgrid.equipment.declaration import (
    EQUIPMENT,
    Command,
    Published,
    choice,
    equipment,
    kind_of,
    reference,
)
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.io.ship_file import bundled, load_ship, read_ship
from shipgrid.io.yaml_lines import read_text
from shipgrid.model.component import Bounds, param
from shipgrid.model.connections import DcBus
from shipgrid.model.network import Network
from shipgrid.units import KNOT, Henry, Ratio, Volt

FERRY = bundled("ship")["ferry"].read_text()


@pytest.fixture(scope="module", autouse=True)
def dummy_kind():
    """A kind of its own, declared as any is, that uses every sort of field; gone after the tests."""
    load_ship()

    @equipment(
        "lamp",
        commands=(Command("dim", "1", "brightness", 0.0, 1.0, 1.0),),
        signals=(Published("level", "1", "brightness"),),
    )
    class Lamp:
        """A lamp."""

        bus: str = reference("DC bus that feeds it", "dc")
        from_: Ratio = param("a key that is a word of the language", default=0.5, at_least=0.0, at_most=1.0)
        v_n: Volt = param("voltage", above=0.0)
        L: Henry = param("inductance", default=1e-3, above=0.0)
        colour: str = choice("colour", "red", "green", default="red")
        dimmed: bool = False

        def check(self) -> None:
            if self.v_n > 1e3 and self.dimmed:
                raise ParameterError("lamp: no dimmer stands more than 1 kV")

        def build(self, net, name, ship):
            net.conductance(ship.bus(self.bus), 1.0)

    # Annotations of a class inside a function are not resolved by name: give them as they are.
    Lamp.__annotations__ |= {"bus": str, "from_": Ratio, "v_n": Volt, "L": Henry, "colour": str, "dimmed": bool}
    yield Lamp
    del EQUIPMENT["lamp"]


def problems_of(text: str, overrides=()) -> list[str]:
    return read_ship(read_text(text, "my.yaml"), overrides).problems.lines()


def line_of(text: str, part: str) -> int:
    return next(k for k, line in enumerate(text.splitlines(), start=1) if part in line)


def changed(old: str, new: str, text: str = FERRY) -> str:
    assert old in text
    return text.replace(old, new, 1)


def with_lamp(entry: str) -> str:
    return changed("  # Ties between", f"  lamp: {{kind: lamp, {entry}}}\n  # Ties between")


def the_problem(text: str, part: str) -> str:
    """The one mistake of a text, with its place checked: the line with `part`."""
    found = problems_of(text)
    assert len(found) == 1, found
    assert found[0].startswith(f"my.yaml:{line_of(text, part)}: ")
    return found[0]


def test_the_ferry_is_read_with_its_values_in_si():
    ship = load_ship("ferry")
    assert ship.name == "ferry"
    assert ship.buses["dc_for"].v_n == 750.0 and ship.buses["dc_for"].bleeder == 5e3
    assert ship.item("bess_for").capacity == 128.0 * 3600.0
    assert ship.item("bess_for").L == 0.8e-3
    assert ship.item("dc_tie").from_ == "dc_for"
    assert ship.item("genset_for").governor.K == 8.0
    assert list(ship.items("genset")) == ["genset_for", "genset_aft"]
    assert ship.hull.displacement == 377e3


def test_the_ferry_offers_the_commands_and_signals_of_the_public_interface():
    ship = load_ship("ferry")
    for side in ("for", "aft"):
        assert {
            *(f"genset_{side}.{name}" for name in ("on", "speed_ref", "v_ref")),
            *(f"rectifier_{side}.{name}" for name in ("v_dc_ref", "mode")),
            *(f"bess_{side}.{name}" for name in ("on", "mode", "v_dc_ref", "i_ref")),
            *(f"propulsion_{side}.{name}" for name in ("on", "speed_ref")),
            f"inverter_{side}.on",
        } <= set(ship.commands)
        units = {
            f"dc_{side}.v_dc": "V",
            f"ac_{side}.v_pu": "1",
            f"ac_{side}.f": "Hz",
            f"bess_{side}.i_b": "A",
            f"bess_{side}.soc": "1",
            f"genset_{side}.p_ac": "W",
            f"genset_{side}.q_ac": "var",
            f"genset_{side}.p_pu": "1",
            f"rectifier_{side}.modulation": "1",
            f"propulsion_{side}.omega_m": "rad/s",
            f"propeller_{side}.tau": "N m",
            f"propeller_{side}.J_adv": "1",
            f"inverter_{side}.f": "Hz",
            "hull.u_ship": "m/s",
            "dc_tie.i": "A",
            "ac_tie.closed": "1",
        }
        assert {name: ship.signals[name].unit for name in units} == units
    of_the_lake = {"hull.wind_speed", "hull.wind_from", "hull.wave_height"}
    assert of_the_lake <= set(ship.commands) and len(ship.commands) == 26 + len(of_the_lake)


def test_every_declared_signal_is_published_by_the_built_ship():
    ship = load_ship("ferry")
    declared = {f"{name}.{s.name}" for name, item in ship.equipment.items() for s in kind_of(item).signals}
    assert declared <= set(ship.signals)


def test_building_makes_buses_with_their_bleeders_and_commands_with_their_start():
    network = Network("ferry")
    load_ship("ferry").build(network, {"bess_for.on": 1.0})
    assert isinstance(network.bus("dc_for"), DcBus)
    assert network.conductances["dc_for.v_dc"] == pytest.approx(1.0 / 5e3)
    assert network.commands["bess_for.on"] == 1.0
    assert network.commands["bess_for.mode"] == 1.0  # its default, droop


def test_items_are_built_sources_first_whatever_the_order_of_the_file():
    head, _, tail = FERRY.partition("equipment:\n")
    body, _, hull = tail.partition("\n# Resistance")
    backwards = "\n".join(reversed(body.splitlines()))
    ship = read_ship(read_text(f"{head}equipment:\n{backwards}\n# Resistance{hull}", "my.yaml")).checked()
    network = Network("ferry")
    ship.build(network)
    forwards = Network("ferry")
    load_ship("ferry").build(forwards)
    assert set(network.placed) == set(forwards.placed)


def test_a_kind_from_outside_is_read_with_every_sort_of_field(dummy_kind):
    ship = read_ship(
        read_text(with_lamp("bus: dc_for, from: 0.25, v_n: 750 V, colour: green, dimmed: true"), "x")
    ).checked()
    lamp = ship.item("lamp")
    assert (lamp.bus, lamp.from_, lamp.v_n, lamp.L, lamp.colour, lamp.dimmed) == (
        "dc_for",
        0.25,
        750.0,
        1e-3,
        "green",
        True,
    )
    assert isinstance(lamp, dummy_kind) and ship.commands["lamp.dim"].high == 1.0


# The traps


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("v_n: 440 V", "v_n: 1,5 kV", "equipment.bess_for.v_n: '1,5 kV': the decimal sign is a point"),
        ("v_n: 440 V", "v_n: nan V", "equipment.bess_for.v_n: 'nan V' is not a finite number"),
        ("v_n: 440 V", "v_n: 0.2 pu", "equipment.bess_for.v_n: '0.2 pu': no base exists here"),
        ("v_n: 440 V", "v_n: 440", "'440' has no unit; expected a number with a unit of V"),
        ("v_n: 440 V", "v_n: 440 A", "wrong kind of unit; expected a number with a unit of V"),
        ("v_n: 440 V", "v_n: 12:30", "'12:30' is a time of day"),
        ("v_n: 440 V", "v_n: ", "equipment.bess_for.v_n: is not one value, expected a number with a unit of V"),
        ("v_n: 440 V", "v_n: [440 V]", "equipment.bess_for.v_n: is not one value"),
        ("L: 0.8 mH", "L: -0.8 mH", "equipment.bess_for.L: -0.8 mH is out of range, expected > 0 H (choke inductance)"),
        ("capacity: 128 Ah", "capasity: 128 Ah", "equipment.bess_for.capasity: no such key (nearest: 'capacity')"),
        ("kind: bess,", "kind: bes,", "equipment.bess_for.kind: no kind of equipment 'bes' (nearest: 'bess')"),
        ("bess, bus: dc_for", "bess", "equipment.bess_for.bus: missing, expected the name of a DC bus"),
        ("bess, bus: dc_for", "bess, bus: dc_fore", "there is no 'dc_fore' (nearest: 'dc_for')"),
        ("bess, bus: dc_for", "bess, bus: ac_for", "'ac_for' is an AC bus"),
        ("bess, bus: dc_for", "bess, bus: hotel_for", "'hotel_for' is an ac_load"),
    ],
)
def test_a_mistake_in_a_value_is_named_by_file_line_path_and_expectation(old, new, says):
    text = changed(old, new)
    problem = the_problem(text, "  bess_for:")
    assert says in problem
    assert "expected" in problem or "nearest" in problem


def test_the_source_of_a_rectifier_is_a_genset():
    text = changed("source: genset_for", "source: bess_for")
    problem = the_problem(text, "  rectifier_for:")
    assert "equipment.rectifier_for.source: 'bess_for' is a bess" in problem
    assert "expected the name of a genset" in problem


def test_a_per_unit_value_needs_its_unit_and_a_parameter_with_a_base():
    problem = the_problem(changed("droop: 0.05 pu", "droop: 0.05"), "  genset_for:")
    assert "equipment.genset_for.governor.droop: '0.05' has no unit; expected a number with a unit of pu" in problem


def test_an_unknown_key_inside_a_block_is_named_with_the_nearest_valid_one():
    problem = the_problem(changed("governor: {K: 8 pu", "governor: {KK: 8 pu"), "  genset_for:")
    assert "equipment.genset_for.governor.KK: no such key" in problem


def test_a_duplicate_key_is_named_with_both_lines():
    text = changed("v_n: 440 V", "v_n: 440 V, v_n: 450 V")
    line = line_of(text, "  bess_for:")
    assert the_problem(text, "  bess_for:").endswith(
        f"equipment.bess_for.v_n: duplicate key, first given on line {line}; expected once"
    )


def test_two_items_of_one_name_are_a_duplicate_key_with_both_lines():
    text = changed("  # Ties", "  bess_for: {kind: bess, bus: dc_for}\n  # Ties")
    first = line_of(text, "  bess_for:")
    second = line_of(text, "  # Ties") - 1
    assert problems_of(text) == [
        f"my.yaml:{second}: equipment.bess_for: duplicate key, first given on line {first}; expected once"
    ]


def test_an_item_with_the_name_of_a_bus_is_refused():
    text = changed("  # Ties", "  dc_for: {kind: bess, bus: dc_aft}\n  # Ties")
    problem = the_problem(text, "  dc_for: {kind: bess")
    assert f"the name is taken on line {line_of(text, '  dc_for: {kind: dc')}" in problem


def test_two_screws_of_one_name_are_refused():
    text = changed("propeller: propeller_aft", "propeller: propeller_for")
    assert "the name 'propeller_for' is taken" in the_problem(text, "  propulsion_aft:")


def test_a_bus_nobody_feeds_is_found_with_all_breakers_closed():
    lonely = changed("  ac_aft:", "  dc_spare: {kind: dc, v_n: 750 V}\n  ac_aft:")
    problem = the_problem(lonely, "  dc_spare:")
    assert "buses.dc_spare: nobody feeds this bus, even with all breakers closed; expected a rectifier" in problem
    tied = changed(
        "\n# Resist", "  spare: {kind: dc_breaker, from: dc_spare, to: dc_aft, length: 5 m}\n\n# Resist", lonely
    )
    assert problems_of(tied) == []


def test_an_ac_bar_is_fed_only_if_the_inverters_dc_bus_is():
    text = FERRY
    for item in ("genset_for", "rectifier_for", "bess_for", "dc_tie", "ac_tie"):
        text = re.sub(rf"^  {item}: .*\n", "", text, flags=re.MULTILINE)
    found = problems_of(text)
    assert [f"my.yaml:{line_of(text, f'  {bus}: ')}" for bus in ("dc_for", "ac_for")] == [
        problem.partition(": ")[0] for problem in found
    ]
    assert all("nobody feeds" in problem for problem in found)


def test_a_ship_with_propulsion_needs_a_hull():
    text = FERRY[: FERRY.index("hull:")]
    assert "hull: missing, expected what propulsion_for pushes" in problems_of(text)[0]


def test_all_mistakes_come_at_once_in_the_order_of_the_file():
    text = changed("v_n: 440 V", "v_n: 1,5 kV")
    text = changed("L: 0.8 mH", "L: -0.8 mH", text)
    text = changed("kind: inverter", "kind: invertor", text)
    text = changed("wake: 0.235", "wake: 1.235", text)
    text = changed("schema: 1", "schema: 2", text)
    found = problems_of(text)
    lines = [int(problem.split(":")[1]) for problem in found]
    assert lines == sorted(lines)
    for part in (
        "schema: '2' is not known",
        "the decimal sign",
        "-0.8 mH is out of range",
        "'invertor' (nearest: 'inverter')",
        "hull.wake: 1.235 is out of range, expected >= 0 and < 1 (wake fraction)",
    ):
        assert sum(part in problem for problem in found) == 1
    with pytest.raises(InputErrors) as caught:
        read_ship(read_text(text, "my.yaml")).checked()
    assert caught.value.problems == found


def test_what_a_kind_itself_refuses_is_reported_at_the_item():
    text = with_lamp("bus: dc_for, v_n: 2 kV, dimmed: true")
    assert the_problem(text, "  lamp:").endswith("equipment.lamp: lamp: no dimmer stands more than 1 kV")


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ("bus: dc_for, v_n: 12 V, colour: blue", "equipment.lamp.colour: 'blue' is no choice, expected red, green"),
        ("bus: dc_for, v_n: 12 V, dimmed: yes", "equipment.lamp.dimmed: 'yes' is neither, expected true or false"),
        ("bus: dc_for, v_n: 12 V, from_: 0.5", "equipment.lamp.from_: no such key (nearest: 'from')"),
        ("bus: dc_for", "equipment.lamp.v_n: missing, expected a number with a unit of V, such as '750 V' (voltage)"),
    ],
)
def test_words_truths_and_missing_values_are_checked(entry, says):
    assert says in the_problem(with_lamp(entry), "  lamp:")


# The file itself


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "my.yaml:1: is empty"),
        ("- a\n- b\n", "my.yaml:1: is not a mapping"),
        ("schema: 1\nship: {\n", "is not YAML"),
        ("schema: 1\n\tship: x\n", "my.yaml:2: is not YAML"),
        ("schema: 1\nship: x\x00\n", "my.yaml:2: has a character that YAML does not allow"),
        ("a: &a [*a]\n", "contains itself"),
        ("schema: 1\n---\nschema: 1\n", "is not YAML"),
    ],
)
def test_a_file_that_is_no_yaml_says_where(text, says):
    assert any(says in problem for problem in problems_of(text))


def test_a_file_that_is_not_there_or_not_text_is_named(tmp_path):
    with pytest.raises(InputErrors, match="No such file"):
        load_ship(tmp_path / "nothing.yaml")
    with pytest.raises(InputErrors, match="cannot be read"):
        load_ship(tmp_path)
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputErrors, match="is not UTF-8"):
        load_ship(tmp_path / "bytes.yaml")


def test_an_unknown_ship_is_named_with_the_nearest():
    with pytest.raises(InputErrors, match=r"fery: no bundled ship of that name \(nearest: 'ferry'\)"):
        load_ship("fery")


# Variants


def test_replace_gives_a_variant_and_leaves_the_ship_as_it_was():
    ship = load_ship("ferry")
    larger = ship.replace("equipment.bess_for.capacity", "160 Ah")
    assert larger.item("bess_for").capacity == 160.0 * 3600.0
    assert ship.item("bess_for").capacity == 128.0 * 3600.0
    nested = ship.replace("equipment.genset_aft.governor.T_3", "0.25 s")
    assert nested.item("genset_aft").governor.T_3 == 0.25
    assert nested.item("genset_aft").governor.K == 8.0


def test_a_variant_is_written_as_a_file_that_reads_back_to_it():
    variant = load_ship("ferry").replace("equipment.bess_for.capacity", "160 Ah")
    again = read_ship(read_text(variant.text, "again.yaml")).checked()
    assert (again.buses, again.equipment, again.hull) == (variant.buses, variant.equipment, variant.hull)


def test_an_unchanged_ship_is_written_as_it_was_read():
    assert load_ship("ferry").text == FERRY


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("equipment.bess_for.capacity", "160", "equipment.bess_for.capacity: '160' has no unit"),
        ("equipment.bess_for.capasity", "160 Ah", "no such key (nearest: 'capacity')"),
        (
            "equipment.bes_for.capacity",
            "160 Ah",
            "equipment.bes_for.capacity: no entry 'bes_for' (nearest: 'bess_for')",
        ),
        ("equipment.bess_for.capacity.x", "160 Ah", "there is nothing inside '128 Ah'"),
        ("equipment..capacity", "160 Ah", "is not a path"),
        ("equipment.bess_for.capacity", "", "no value given"),
        ("equipment.bess_for.capacity", "{", "is not YAML"),
    ],
)
def test_a_variant_is_checked_like_a_file(path, value, says):
    with pytest.raises(InputErrors) as caught:
        load_ship("ferry").replace(path, value)
    assert len(caught.value.problems) == 1
    assert says in caught.value.problems[0]


def test_a_file_may_say_where_its_plant_is_cut():
    assert load_ship("ferry").parts == {"for": ("dc_for",), "aft": ("dc_aft",), "grid": ("ac_for", "ac_aft")}
    variant = load_ship("ferry").replace("parts.aft", "[dc_aft, genset_aft.terminals]")
    assert variant.parts["aft"] == ("dc_aft", "genset_aft.terminals")
    assert read_ship(read_text(variant.text, "again.yaml")).checked().parts == variant.parts
    assert read_ship(read_text(FERRY[: FERRY.index("parts:")], "my.yaml")).checked().parts == {}


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("aft: [dc_aft]", "aft: [dc_aftt]", "parts.aft.0: there is no bus 'dc_aftt' (nearest: 'dc_aft')"),
        ("aft: [dc_aft]", "aft: [bess_aft]", "parts.aft.0: there is no bus 'bess_aft' (nearest: 'dc_aft')"),
        ("aft: [dc_aft]", "aft: [x.terminals]", "parts: ferry: no bus 'x.terminals'"),
        ("aft: [dc_aft]", "aft: [dc_aft, dc_for]", "parts.aft.1: bus 'dc_for' is in the part 'for' already, expected"),
        ("aft: [dc_aft]", "aft: []", "parts.aft: has no buses, expected a list of them, such as [dc_for, ac_for]"),
        ("aft: [dc_aft]", "aft: dc_aft", "parts.aft: has no buses, expected a list of them"),
        ("aft: [dc_aft]", "aft: [[dc_aft]]", "parts.aft.0: is not one value, expected the name of a bus"),
        ("aft: [dc_aft]", "Aft: [dc_aft]", "parts.Aft: is not a name, expected lower-case letters, digits and _"),
        (
            "for: [dc_for], aft: [dc_aft], ",
            "",
            "parts: is not enough, expected two parts or more, each name: [bus, ...",
        ),
        ("{for: [dc_for], aft: [dc_aft], grid: [ac_for, ac_aft]}", "2", "parts: is not a mapping, expected two parts"),
        ("grid: [ac_for, ac_aft]", "", "ac_for and ac_aft between the parts 'for' and 'aft', expected in one of them"),
    ],
)
def test_a_mistake_about_parts_is_named_by_file_line_path_and_expectation(old, new, says):
    assert says in the_problem(changed(old, new), "parts:")


def test_resistance_is_a_word_or_pairs_of_speed_and_resistance():
    pairs = "[[2 kn, 0.5 kN], [6 kn, 7 kN], [10 kn, 20 kN]]"
    ship = load_ship("ferry", [("hull.resistance", pairs)])
    expected = [(2.0 * KNOT, 500.0), (6.0 * KNOT, 7e3), (10.0 * KNOT, 20e3)]
    assert [pytest.approx(pair) for pair in expected] == list(ship.hull.resistance)
    assert read_ship(read_text(ship.text, "my.yaml")).checked().hull == ship.hull
    assert load_ship("ferry", [("hull.resistance", "paper_fit")]).hull.resistance == "paper_fit"


def test_every_wrong_pair_is_named_with_its_line():
    pairs = ["[2 kn, 0.5 kN]", "[4 kn, 3 m]", "[6 kn, 0.4 kN]", "[8 kn]", "12 kN", "[-9 kn, 9 kN]", "[10, 9 kN]"]
    lines = "\n".join(f"    - {pair}" for pair in pairs)
    text = FERRY[: FERRY.index("hull: {")] + "hull:\n  displacement: 377 t\n  resistance:\n" + lines + "\n"
    said = [
        (1, "'3 m' has the wrong kind of unit"),
        (2, "[6 kn, 0.4 kN] comes after [2 kn, 0.5 kN], expected both to rise"),
        (3, "is not a pair, expected [6 kn, 18 kN]"),
        (4, "is not a pair, expected [6 kn, 18 kN]"),
        (5, "-9 kn is out of range, expected > 0 m/s"),
        (6, "'10' has no unit"),
    ]
    found = problems_of(text)
    assert len(found) == len(said)
    for problem, (k, what) in zip(found, said, strict=True):
        assert problem.startswith(f"my.yaml:{line_of(text, pairs[k])}: hull.resistance.{k}: ") and what in problem
    empty = FERRY.replace("resistance: table", "resistance: []")
    assert "hull.resistance: is empty, expected a list of pairs [6 kn, 18 kN]" in the_problem(empty, "hull: {")
    word = FERRY.replace("resistance: table", "resistance: tabel")
    assert "expected table, paper_fit, or a list of pairs [6 kn, 18 kN]" in the_problem(word, "hull: {")


def test_bounds_say_themselves_in_words():
    # What messages quote: the words of a declared range.
    assert str(Bounds("x", at_least=0.0, below=1.0)) == ">= 0 and < 1"


def test_the_schema_knows_every_kind_and_key():
    from shipgrid.io.schema import scenario_schema, ship_schema

    branches = ship_schema()["properties"]["equipment"]["additionalProperties"]["allOf"]
    kinds = {b["then"]["properties"]["kind"]["const"]: b["then"]["properties"] for b in branches}
    assert set(kinds) == set(EQUIPMENT) - {"hull"}
    assert "governor" in kinds["genset"] and "K" in kinds["genset"]["governor"]["properties"]
    assert kinds["dc_breaker"]["from"]["type"] == "string"
    assert scenario_schema()["properties"]["start"]["properties"]["state"]["enum"] == ["moored", "cold"]


# What is right in each entry, and cannot be together


def test_a_tie_has_two_ends():
    text = changed("from: dc_for, to: dc_aft", "from: dc_aft, to: dc_aft")
    assert "equipment.dc_tie.to: both ends are 'dc_aft', expected two buses" in the_problem(text, "  dc_tie:")
    text = changed("from: ac_for, to: ac_aft", "from: ac_aft, to: ac_aft")
    assert "equipment.ac_tie.to: both ends are 'ac_aft', expected two buses" in the_problem(text, "  ac_tie:")


@pytest.mark.parametrize(
    ("old", "new", "tie", "says"),
    [
        ("dc_aft: {kind: dc, v_n: 750 V", "dc_aft: {kind: dc, v_n: 600 V", "dc_tie", "750 V, 'dc_aft' 600 V"),
        ("ac_aft: {kind: ac, v_n: 400 V", "ac_aft: {kind: ac, v_n: 440 V", "ac_tie", "400 V, 'ac_aft' 440 V"),
        ("ac_aft: {kind: ac, v_n: 400 V, f_n: 60 Hz", "ac_aft: {kind: ac, v_n: 400 V, f_n: 50 Hz", "ac_tie", "50 Hz"),
    ],
)
def test_a_tie_joins_buses_of_one_voltage_and_frequency(old, new, tie, says):
    problem = the_problem(changed(old, new), f"  {tie}:")
    assert f"equipment.{tie}.to: " in problem and says in problem and "expected two buses of one nominal" in problem


def test_a_tie_joins_buses_of_its_kind():
    text = changed("from: dc_for, to: dc_aft", "from: dc_for, to: ac_aft")
    assert "equipment.dc_tie.to: 'ac_aft' is an AC bus" in the_problem(text, "  dc_tie:")


def test_a_full_battery_lies_below_its_bus():
    full = load_ship("ferry").item("bess_for").v_full
    within, beyond = 749.0 / full, 751.0 / full
    assert problems_of(changed("v_n: 440 V", f"v_n: {within:.1f} V")) == []
    problem = the_problem(changed("v_n: 440 V", f"v_n: {beyond:.1f} V"), "  bess_for:")
    assert "equipment.bess_for.v_n: a full battery has 751 V and its bus 'dc_for' 750 V, expected less" in problem


def test_a_genset_without_a_rectifier_is_found():
    text = re.sub(r"^  rectifier_aft: .*\n", "", FERRY, flags=re.MULTILINE)
    problem = the_problem(text, "  genset_aft:")
    assert "equipment.genset_aft: no rectifier takes this genset, expected one with 'source: genset_aft'" in problem


def test_what_cannot_be_together_comes_with_all_other_mistakes():
    text = changed("from: dc_for, to: dc_aft", "from: dc_aft, to: dc_aft")
    text = changed("v_n: 440 V", "v_n: 750 V", text)
    text = changed("wake: 0.235", "wake: 1.235", text)
    found = problems_of(text)
    assert [int(problem.split(":")[1]) for problem in found] == [
        line_of(text, part) for part in ("  bess_for:", "  dc_tie:", "hull: {")
    ]
