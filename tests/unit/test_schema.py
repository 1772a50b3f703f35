"""The JSON Schemas for editors: they accept what is right and refuse what an editor can see is wrong."""

from __future__ import annotations

import copy
import json

import jsonschema
import pytest
from ruamel.yaml import YAML
from typer.testing import CliRunner

from shipgrid.cli.main import app
from shipgrid.io.ship_file import bundled


def printed(what):
    said = CliRunner().invoke(app, ["check", "--schema", what])
    assert said.exit_code == 0, said.output
    return json.loads(said.stdout)


def read(path):
    """As an editor reads it: YAML 1.2, numbers as numbers."""
    return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def validators():
    found = {}
    for what in ("ship", "scenario"):
        schema = printed(what)
        jsonschema.Draft202012Validator.check_schema(schema)
        found[what] = jsonschema.Draft202012Validator(schema)
    return found


BUNDLED = [(what, path) for what in ("ship", "scenario") for path in bundled(what).values()]


@pytest.mark.parametrize(("what", "path"), BUNDLED, ids=[path.stem for _, path in BUNDLED])
def test_bundled_files_are_valid(validators, what, path):
    assert [error.message for error in validators[what].iter_errors(read(path))] == []


def put(document, path, value):
    changed = copy.deepcopy(document)
    *steps, last = path
    place = changed
    for step in steps:
        place = place[step]
    place[last] = value
    return changed


@pytest.mark.parametrize(
    ("path", "value", "names"),
    [
        (("schema",), 2, "1 was expected"),
        (("equipment", "bess_for", "capacty"), "128 Ah", "'capacty' was unexpected"),
        (("equipment", "bess_for", "kind"), "battery", "'battery' is not one of"),
        (("equipment", "bess_for", "capacity"), 128, "128 is not of type 'string'"),
        (("equipment", "genset_for", "governor", "Kp"), "8 pu", "'Kp' was unexpected"),
        (("buses", "dc_for", "kind"), "three-phase", "'three-phase' is not one of"),
        (("equipment", "Bess"), {"kind": "bess"}, "'Bess' does not match"),
        (("hull",), {"displacement": 377}, "377 is not of type 'string'"),
        (("hull", "resistance"), [["6 kn"]], "is not valid under any of"),
        (("parts",), {"for": ["dc_for"]}, "does not have enough properties"),
        (("parts", "aft"), "dc_aft", "'dc_aft' is not of type 'array'"),
    ],
)
def test_a_slip_in_a_ship_file_is_refused(validators, path, value, names):
    wrong = put(read(bundled("ship")["ferry"]), path, value)
    errors = [error.message for error in validators["ship"].iter_errors(wrong)]
    assert any(names in error for error in errors), errors


def test_resistance_may_be_a_list_of_pairs(validators):
    ship = put(read(bundled("ship")["ferry"]), ("hull", "resistance"), [["6 kn", "7 kN"], ["10 kn", "18 kN"]])
    assert validators["ship"].is_valid(ship)


@pytest.mark.parametrize(
    ("path", "value", "names"),
    [
        (("timeline", 0, "when"), "10 s", "False schema does not allow '10 s'"),
        (("timeline", 0, "wen"), "10 s", "'wen' was unexpected"),
        (("timeline", 0), {"when": {"signal": "hull.u_ship"}, "set": {}}, "is not valid under any of"),
        (("timeline", 0), {"when": {"above": "1 kn"}, "set": {}}, "'signal' is a required property"),
        (("timeline", 0), {"when": "10 s", "set": {}}, "'10 s' is not of type 'object'"),
        (("timeline", 0), {"after": "leave"}, "is not valid under any of"),
        (("timeline", 0), {"after": "leave", "times": 0, "set": {}}, "0 is not valid under any of"),
        (("timeline", 0, "at"), 10, "10 is not of type 'string'"),
        (("start", "state"), "sailing", "'sailing' is not one of"),
        (("requirements", 0, "band"), ["715 V"], "is too short"),
        (("requirements", 0, "max"), "785 V", "is valid under each of"),
        (("requirements", 0, "recovery"), 1.5, "1.5 is not of type 'string'"),
        (("duration",), None, "None is not of type 'string'"),
    ],
)
def test_a_slip_in_a_scenario_file_is_refused(validators, path, value, names):
    wrong = put(read(bundled("scenario")["mission"]), path, value)
    errors = [error.message for error in validators["scenario"].iter_errors(wrong)]
    assert any(names in error for error in errors), errors


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--schema", "shp"], "--schema: no schema of the name 'shp' (nearest: 'ship'), expected ship or scenario"),
        (["--schema", "ship", "my.yaml"], "--schema: prints a schema and checks no files"),
        ([], "check: no files given"),
    ],
)
def test_check_says_what_it_expects(words, says):
    said = CliRunner().invoke(app, ["check", *words])
    assert said.exit_code == 2 and says in said.stderr


def test_an_entry_may_wait_for_a_condition_for_another_entry_or_for_both(validators):
    soc = {"signal": "bess_for.soc", "above": "60 %", "for": "5 s"}
    for entry in (
        {"when": soc, "set": {"bess_for.i_ref": "0 A"}},
        {"name": "arrived", "when": [soc, {"signal": "hull.u_ship", "below": "1 kn"}], "times": "unlimited"},
        {"after": "arrived", "delay": "30 s", "mode": "hybrid", "optional": True, "times": 3},
        {"after": ["arrived", "left"], "when": soc, "from": "10 s", "until": "1 min", "set": {}},
    ):
        scenario = put(read(bundled("scenario")["mission"]), ("timeline", 0), entry)
        assert [error.message for error in validators["scenario"].iter_errors(scenario)] == []
