"""Names of ships, scenarios, items and signals are no paths, wherever they come from."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import PurePosixPath, PureWindowsPath

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from typer.testing import CliRunner

import shipgrid as sg
from shipgrid.cli.main import app
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.io.run_file import read_run_file
from shipgrid.io.scenario_file import read_case, read_scenario
from shipgrid.io.ship_file import bundled, open_document, read_ship
from shipgrid.io.yaml_lines import read_text
from shipgrid.names import ITEM_NAME, LONGEST, PART_NAME, mistake_in, nearest, shown, similar
from shipgrid.scenarios.simulate import default_place

WRONG = {
    "../../pwned/x": "it has '/'",
    "a\\b": "it has '\\\\'",
    "..": "it begins with '.'",
    ".hidden": "it begins with '.'",
    "-rf": "it begins with '-'",
    " x": "it begins with ' '",
    "a..b": "it has '..'",
    "dot.": "it ends with '.'",
    "space ": "it ends with ' '",
    "x [/x]": "it has '['",
    "<!--<script>": "it has '<'",
    "bell\x07": "it has '\\x07'",
    "\x1b[31mred": "it has '\\x1b'",
    "two\nlines": "it has '\\n'",
    "nul\x00": "it has '\\x00'",
    "~": "it has '~'",
    "$HOME": "it has '$'",
    "C:drive": "it has ':'",
    "con": "it is the name of a device on Windows",
    "LPT1.dat": "it is the name of a device on Windows",
    "n" * 300: "it is 300 bytes long",
    "é" * 40: "it is 80 bytes long",
}
RIGHT = [
    "mission",
    "ferry-in-harbour",
    "load-step",
    "low batteries",
    "R-L-C step",
    "2026",
    "v1.2",
    "Città di Intra",
    "x" * 64,
]
SCENARIO = "schema: 1\nscenario: {name}\nduration: 0.02 s\nstart: {{state: moored, closed: [dc_tie]}}\n"


def quoted(name):
    return '"' + name.encode("unicode_escape").decode().replace('"', '\\"') + '"'


@pytest.fixture(scope="module")
def ship():
    return sg.load_ship("ferry")


@pytest.mark.parametrize(("name", "mistake"), WRONG.items())
def test_what_is_wrong_with_a_name_is_said(name, mistake):
    assert mistake_in(name) == mistake


@pytest.mark.parametrize("name", RIGHT)
def test_names_that_people_give_are_names(name):
    assert mistake_in(name) == ""


def test_no_name_is_empty():
    assert mistake_in("") == "it is empty"


@given(st.text(max_size=80))
@example("a/b")
@example("mission")
def test_whatever_is_a_name_is_one_step_of_a_path_on_every_system(name):
    if mistake_in(name):
        return
    made = f".{name}-averaged-k3f9w2ab.old"
    assert PurePosixPath(made).name == made and PureWindowsPath(made).name == made
    assert len(os.fsencode(made)) < 255
    assert name.isprintable()


@given(st.from_regex(ITEM_NAME, fullmatch=True))
def test_the_name_of_an_item_is_a_name(name):
    assert mistake_in(name) in ("", "it is the name of a device on Windows")  # no folder is called after an item
    assert PART_NAME.fullmatch(f"{name}.terminals")


def test_a_long_name_is_shown_cut_and_what_is_not_printable_written_out():
    assert shown("n" * 300) == f"'{'n' * 40}...'"
    assert shown("\x1b[31m") == "'\\x1b[31m'"


def test_a_hint_names_the_nearest_word_and_else_all_or_none():
    words = ("averaged", "switching")
    assert similar("averagd", words) == nearest("averagd", words) == " (nearest: 'averaged')"
    assert (similar("zzz", words), nearest("zzz", words)) == ("", " (there are: averaged, switching)")
    assert similar("zzz", ()) == nearest("zzz", map(str, range(13))) == ""


@pytest.mark.parametrize("what", ["ship", "scenario"])
def test_every_bundled_name_is_a_name(what):
    for path in bundled(what).values():
        assert mistake_in(open_document(what, path).root.entries[what].text) == ""


@pytest.mark.parametrize("name", [name for name in WRONG if "\x00" not in name])  # YAML has no such character
def test_a_scenario_with_such_a_name_is_refused_with_its_line(ship, name):
    document = read_text(SCENARIO.format(name=quoted(name)), "my.yaml")
    (line,) = read_scenario(document, ship.catalogue).problems.lines()
    assert line.startswith(f"my.yaml:2: scenario: {shown(name)} is not a name: {WRONG[name]}, expected letters, digits")


def test_a_ship_with_such_a_name_is_refused_with_its_line():
    text = bundled("ship")["ferry"].read_text().replace("ship: ferry", "ship: ../../pwned/x", 1)
    (line,) = read_ship(read_text(text, "my.yaml")).problems.lines()
    assert line.startswith("my.yaml:6: ship: '../../pwned/x' is not a name: it has '/', expected letters, digits")


def test_a_wrong_name_comes_with_all_other_mistakes(ship):
    text = SCENARIO.format(name="../x").replace("0.02 s", "0.02").replace("moored", "mored")
    lines = read_scenario(read_text(text, "my.yaml"), ship.catalogue).problems.lines()
    assert [line.split(": ")[1] for line in lines] == ["scenario", "duration", "start.state"]


@pytest.mark.parametrize(
    ("old", "new", "path"),
    [
        ("  bess_for:", f"  {'b' * 65}:", f"equipment.{'b' * 40}...: is not a name, expected lower-case letters"),
        ("  bess_for:", '  "../bess":', "equipment.../bess: is not a name"),
        ("  bess_for:", '  "bess\\e[31m":', "equipment.bess\\x1b[31m: is not a name"),
        ("propeller: propeller_for", "propeller: ../x", "equipment.propulsion_for.propeller: '../x' is not a name"),
        ("  dc_for:", '  "dc/for":', "buses.dc/for: is not a name"),
    ],
)
def test_items_and_buses_have_the_names_of_keys(old, new, path):
    text = bundled("ship")["ferry"].read_text()
    assert old in text
    lines = read_ship(read_text(text.replace(old, new, 1), "my.yaml")).problems.lines()
    assert any(f": {path}" in line and f"at most {LONGEST}" in line for line in lines), lines


def test_an_override_is_checked_like_a_file():
    with pytest.raises(InputErrors, match=r"--set scenario=\.\./x: scenario: '\.\./x' is not a name"):
        read_case(open_document("ship", "ferry"), open_document("scenario", "mission"), [("scenario", "../x")])


@pytest.mark.parametrize("command", ["run", "live"])
def test_nothing_is_written_outside_of_results(command, tmp_path, monkeypatch):
    (tmp_path / "deep" / "here").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "deep" / "here")
    (tmp_path / "deep" / "here" / "bad.yaml").write_text(SCENARIO.format(name="../../pwned/x"))
    result = CliRunner().invoke(app, [command, "bad.yaml", "--no-report"])
    assert result.exit_code == 2
    assert "bad.yaml:2: scenario: '../../pwned/x' is not a name: it has '/'" in result.stderr
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["bad.yaml"]


@pytest.mark.parametrize("which", ["ship", "scenario"])
def test_what_is_made_in_python_is_checked_before_anything_is_written(which, ship, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    case = {"ship": ship, "scenario": sg.load_scenario("mission", ship)}
    case[which] = replace(case[which], name="../../pwned")
    with pytest.raises(ParameterError, match=rf"{which}: '\.\./\.\./pwned' is not a name: it has '/'"):
        sg.simulate(case["ship"], case["scenario"])
    if which == "scenario":
        with pytest.raises(ParameterError, match="is not a name"):
            default_place(case["scenario"], "live")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "add",
    [
        lambda net: net.dc_bus("a/b", 100.0),
        lambda net: net.ac_bus("../b", 100.0, 50.0),
        lambda net: net.add("r/1", sg.Resistor(R=1.0), a=net.bus("dc")),
        lambda net: net.publish("../../x.v", source="dc.v_dc", unit="V", description="voltage"),
        lambda net: net.publish_phases("x/v", alpha="a", beta="b", unit="V", description="voltage"),
        lambda net: net.command("x\ny.on"),
        lambda net: net.dc_bus("", 100.0),
        lambda net: net.dc_bus("b" * 201, 100.0),
    ],
)
def test_signals_of_networks_made_in_python_are_no_paths(add):
    """They name variables of results, where a `/` would begin a group."""
    net = sg.Network("yard")
    net.dc_bus("dc", 100.0)
    with pytest.raises(ParameterError, match=r"yard: .* is not a name: it "):
        add(net)


def test_the_file_of_commands_lies_beside_its_run_file():
    text = "schema: 1\nship: x\nscenario: x\nfidelity: averaged\nstep: 30 us\nuntil: 1 s\nversion: 1\ncommit: x\n"
    with pytest.raises(InputErrors, match=r"run.yaml:9: outside: '\.\./\.\./etc/passwd' is no file beside this one"):
        read_run_file(read_text(text + "outside: ../../etc/passwd\n", "run.yaml"))
