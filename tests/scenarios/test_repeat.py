"""A run is repeated from the `run.yaml` it wrote: from the command line, to the last bit."""

from __future__ import annotations

import json

import netCDF4
import numpy as np
import pytest
from typer.testing import CliRunner

import shipgrid as sg
from shipgrid.cli.main import app


def shipgrid(*words: str):
    return CliRunner().invoke(app, list(words))


def recorded(folder):
    """Every number in a file of results, by group and variable."""
    with netCDF4.Dataset(folder / "results.nc") as file:
        return {
            f"{group}/{name}": np.asarray(variable[:])
            for group in ("plant", "slow", "events", "waveforms/0")
            for name, variable in file[group].variables.items()
        }


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """Three seconds of the mission, moored and leaving, with a value of the ship and one of the scenario changed."""
    folder = tmp_path_factory.mktemp("results") / "first"
    said = shipgrid(
        *["run", "--until", "3 s", "--step", "70us", "--out", str(folder), "--no-report"],
        *["--set", "equipment.bess_for.capacity=100 Ah", "--set", "timeline.0.at=1 s"],
        *["--waveforms", "2 s:2.2 s"],
    )
    assert said.exit_code == 0, said.output
    return folder, said


def test_a_run_repeated_from_its_run_yaml_is_bit_identical(first, tmp_path):
    folder, _ = first
    said = shipgrid("run", str(folder / "run.yaml"), "--out", str(tmp_path / "again"), "--no-report")
    assert said.exit_code == 0, said.output
    a, b = recorded(folder), recorded(tmp_path / "again")
    assert set(a) == set(b) and len(a["plant/time"]) == 31
    assert float(a["plant/propulsion_for.omega_m"][-1]) > 0.1  # the command given at 1 s instead of 10 s is in it
    for name in a:
        assert np.array_equal(a[name], b[name]), name
    settings = [sg.open_results(f).settings for f in (folder, tmp_path / "again")]
    assert settings[0] == settings[1]
    assert settings[0]["ship"]["equipment"]["bess_for"]["capacity"] == "100 Ah"
    assert settings[0]["waveforms"] == ["2.0 s:2.2 s"] and len(a["waveforms/0/time"]) == pytest.approx(
        0.2 / 70e-6, abs=1.0
    )
    v_a, v_pu = a["waveforms/0/ac_for.v_a"], a["plant/ac_for.v_pu"][20]
    assert float(v_a.max()) == pytest.approx(400.0 * np.sqrt(2.0 / 3.0) * float(v_pu), rel=1e-2)
    energy = [json.loads((f / "summary.json").read_text())["energy"] for f in (folder, tmp_path / "again")]
    assert energy[0] == energy[1]


def test_an_option_given_as_well_goes_before_what_the_run_yaml_says(first, tmp_path):
    folder, _ = first
    said = shipgrid(
        *["run", str(folder / "run.yaml"), "--out", str(tmp_path / "again"), "--no-report"],
        *["--until", "2.5 s", "--set", "equipment.bess_aft.capacity=90 Ah"],
    )
    assert said.exit_code == 0, said.output
    run = sg.open_results(tmp_path / "again")
    assert run.summary["simulated_s"] == pytest.approx(2.5, abs=70e-6)
    assert run.summary["step_s"] == 70e-6
    assert run.settings["set"] == {
        "equipment.bess_for.capacity": "100 Ah",
        "timeline.0.at": "1 s",
        "equipment.bess_aft.capacity": "90 Ah",
    }
    assert [run.settings["ship"]["equipment"][f"bess_{x}"]["capacity"] for x in ("for", "aft")] == ["100 Ah", "90 Ah"]


def test_plan_and_duration_are_said_before_the_run(first):
    _, said = first
    plan, duration = said.stderr.index("mission of ferry: 3 s in 42,857 steps of 70 us"), said.stderr.index("about ")
    assert plan < duration
    assert "us a step in a trial at the start" in said.stderr


@pytest.fixture(scope="module")
def cut(tmp_path_factory):
    """A third of a second of the same, in two parts."""
    folder = tmp_path_factory.mktemp("results") / "cut"
    said = shipgrid("run", "--until", "0.3 s", "--step", "30us", "--parts", "2", "--out", str(folder), "--no-report")
    assert said.exit_code == 0, said.output
    return folder


def test_a_run_of_a_plant_in_parts_is_repeated_with_the_same_cut(cut, tmp_path):
    said = shipgrid("run", str(cut / "run.yaml"), "--out", str(tmp_path / "again"), "--no-report")
    assert said.exit_code == 0, said.output
    assert "cut into 2 parts (dc_for, dc_aft)" in said.stderr
    runs = [sg.open_results(folder) for folder in (cut, tmp_path / "again")]
    assert runs[0].settings == runs[1].settings
    assert runs[0].settings["parts"]["dc_for"] == ["dc_for", "genset_for.terminals"]
    for name in runs[0].signals:
        assert np.array_equal(runs[0][name], runs[1][name]), name
    said = shipgrid("run", str(cut / "run.yaml"), "--parts", "1", "--out", str(tmp_path / "whole"), "--no-report")
    assert said.exit_code == 0 and "cut into" not in said.stderr, said.output
    whole = sg.open_results(tmp_path / "whole")
    assert "parts" not in whole.settings
    assert not np.array_equal(runs[0]["ac_for.v_pu"], whole["ac_for.v_pu"])


@pytest.mark.parametrize(
    ("was", "wrong", "says"),
    [
        ("  dc_for: [dc_for, genset_for.terminals]\n", "", "parts: is not enough, expected two parts or more"),
        ("dc_for: [dc_for, ", "dc_for: [dc_aft, ", "parts.dc_aft.0: bus 'dc_aft' is in the part 'dc_for' already"),
        ("parts:\n", "part:\n", "part: no such key (nearest: 'parts')"),
    ],
)
def test_a_mistake_about_the_parts_of_a_run_yaml_is_named(cut, tmp_path, was, wrong, says):
    text = (cut / "run.yaml").read_text()
    assert was in text
    (tmp_path / "run.yaml").write_text(text.replace(was, wrong, 1))
    said = shipgrid("check", str(tmp_path / "run.yaml"))
    assert (said.exit_code, says in said.stderr) == (2, True), said.stderr


def test_check_reads_a_run_yaml_and_says_where_its_mistakes_are(first, tmp_path):
    folder, _ = first
    assert shipgrid("check", str(folder / "run.yaml")).exit_code == 0
    text = (folder / "run.yaml").read_text()
    broken = tmp_path / "run.yaml"
    broken.write_text(text.replace("capacity: 100 Ah", "capacity: 100 A"))
    for words in (["check", str(broken)], ["run", str(broken), "--out", str(tmp_path / "out")]):
        said = shipgrid(*words)
        assert said.exit_code == 2
        assert f"{broken}: ship:" in said.stderr and "equipment.bess_for.capacity" in said.stderr
    broken.write_text(text.replace("until: 3.0 s", "until: 4000 s").replace("fidelity: averaged\n", ""))
    said = shipgrid("check", str(broken))
    assert said.exit_code == 2 and "fidelity: missing" in said.stderr
    broken.write_text(text.replace("until: 3.0 s", "until: 4000 s"))
    assert "until: is not within the scenario, expected up to 3400 s" in shipgrid("check", str(broken)).stderr
    said = shipgrid("run", str(folder / "run.yaml"), "--ship", "ferry")
    assert said.exit_code == 2 and "has its ship in it" in said.stderr
