"""The command line: what is accepted, what is said, and the exit status."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import pytest
import synthetic_run
from typer.testing import CliRunner

from shipgrid.analysis.requirements import Verdict
from shipgrid.assembly import crew
from shipgrid.cli.main import app
from shipgrid.errors import ParameterError, SolverError, SteadyStateError
from shipgrid.io.ship_file import bundled, load_ship
from shipgrid.model.network import FIDELITIES
from shipgrid.scenarios import simulate as simulation
from shipgrid.scenarios.conditions import Outcome
from shipgrid.scenarios.results import Limiter


def shipgrid(*words: str):
    return CliRunner().invoke(app, list(words))


class Simulated:
    """Stands in for the runner: remembers what it was asked for, and answers as told."""

    def __init__(
        self, ok=True, interrupted=False, error=None, requirements=(), class_limits=(), timeline=(), limiters=()
    ):
        self.class_limits, self.timeline = class_limits, list(timeline)
        self.requirements, self.limiters = list(requirements), list(limiters)
        self.ok, self.interrupted, self.error = ok, interrupted, error
        self.asked = None

    def __call__(self, ship, scenario, **options):
        self.asked = SimpleNamespace(ship=ship, scenario=scenario, **options)
        if self.error is not None:
            raise self.error
        options["progress"](1.0, 60.0)
        summary = {"simulated_s": 60.0, "wall_s": 1.0, "us_per_step": 3.0, "interrupted": self.interrupted}
        limits = [Verdict(**row) for row in self.class_limits]
        found = SimpleNamespace(ok=self.ok, requirements=self.requirements, class_limits=limits, summary=summary)
        found.folder, found.timeline = Path("results/x"), self.timeline
        found.at_limit = [limiter for limiter in self.limiters if limiter.long]
        return found


@pytest.fixture
def simulated(monkeypatch):
    def install(**answers):
        made = Simulated(**answers)
        monkeypatch.setattr(simulation, "simulate", made)
        return made

    return install


def test_without_arguments_run_sails_the_ferrys_mission(simulated):
    made = simulated()
    result = shipgrid("run")
    assert result.exit_code == 0, result.output
    assert (made.asked.ship.name, made.asked.scenario.name) == ("ferry", "mission")
    assert (made.asked.fidelity, made.asked.step, made.asked.until, made.asked.out) == ("averaged", None, None, None)
    assert made.asked.report is True
    assert "mission of ferry: 3400 s" in result.stderr
    assert "commands, 2 entries that wait, 71 requirements" in result.stderr


def test_options_reach_the_runner_in_si(simulated):
    made = simulated()
    result = shipgrid(
        *["run", "mission", "--ship", "ferry", "--step", "15us", "--until", "0.5min", "--out", "here", "--no-report"],
        *("--set", "equipment.bess_for.capacity=160 Ah"),
        *("--waveforms", "10s:10.2s", "--waveforms", "0.02min:1500ms"),
    )
    assert result.exit_code == 0, result.output
    assert made.asked.waveforms == [(10.0, 10.2), (1.2, 1.5)]
    assert (made.asked.step, made.asked.until, made.asked.out) == (15e-6, 30.0, Path("here"))
    assert made.asked.report is False
    assert made.asked.overrides == {"equipment.bess_for.capacity": "160 Ah"}
    assert made.asked.ship.item("bess_for").capacity == 160.0 * 3600.0


@pytest.mark.parametrize(
    ("answer", "status"),
    [
        ({}, 0),
        ({"ok": False}, 1),
        ({"error": ParameterError("--out: /x cannot be written")}, 2),
        ({"error": SolverError("diverged")}, 3),
        ({"error": SteadyStateError("no operating point")}, 3),
        ({"interrupted": True}, 130),
        ({"error": KeyboardInterrupt()}, 130),
    ],
)
def test_the_exit_status_says_how_it_ended(simulated, answer, status):
    simulated(**answer)
    result = shipgrid("run")
    assert result.exit_code == status
    if isinstance(answer.get("error"), Exception):
        assert str(answer["error"]) in result.stderr
        assert "Traceback" not in result.output


def test_requirements_that_were_judged_are_a_table_and_the_others_are_counted(simulated):
    rows = [synthetic_run.SUMMARY["requirements"][0]]
    for signal, unit in (("dc_for.v_dc", "V"), ("dc_aft.v_dc", "V"), ("bess_mid.soc", "")):
        never = {"name": f"later {signal}", "signal": signal, "unit": unit, "value": None, "verdict": "not evaluated"}
        rows.append(rows[0] | never)
    simulated(requirements=[Verdict(**row) for row in rows])
    result = shipgrid("run")
    assert result.exit_code == 0, result.output
    assert "DC bus" in result.stdout and "721.5 V" in result.stdout
    assert "later" not in result.stdout
    assert "2 not evaluated (outside the run)" in result.stdout.splitlines()
    assert "1 not evaluated (not recorded: bess_mid.soc)" in result.stdout.splitlines()


def test_what_the_time_line_waited_for_in_vain_is_said(simulated):
    simulated(ok=False, timeline=[Outcome("recharge ends", "bess_for.soc above 60 %", 4, 3, 8.0, 9.0, "too few times")])
    result = shipgrid("run")
    assert result.exit_code == 1
    assert "time-line: recharge ends happened 3 of 4 times: bess_for.soc above 60 %" in result.stdout.splitlines()


def test_the_source_of_requirements_has_a_column_where_any_has_one(simulated):
    row = synthetic_run.SUMMARY["requirements"][0]
    simulated(requirements=[Verdict(**row)])
    assert "source" not in shipgrid("run").stdout
    simulated(requirements=[Verdict(**row), Verdict(**row, source="paper text")])
    said = shipgrid("run").stdout
    assert "source" in said and "paper text" in said


def test_a_violated_limit_of_class_is_said_and_does_not_fail_the_run(simulated):
    simulated(class_limits=synthetic_run.SUMMARY["class_limits"])
    result = shipgrid("run")
    assert result.exit_code == 0
    said = [line for line in result.stdout.splitlines() if line.startswith("limit of class violated")]
    assert (
        len(said) == 1 and "ISO 8528-5 G2: speed, transient, genset_for.omega_pu, band 0.9 .. 1.12 1: 0.875" in said[0]
    )


def test_what_ran_at_a_limit_is_said_after_the_run(simulated):
    signal, meaning = "rectifier_for.control.q_bound", "the bridge's voltage bounds the reactive current"
    simulated(limiters=[Limiter(signal, 401.3, 1058.0, 4, 0.3112, meaning), Limiter("a.b", 1.0, 2.0, 1, 6e-4)])
    said = shipgrid("run").stdout
    (row,) = [line for line in said.splitlines() if line.startswith(signal)]
    assert "31.1 %" in row and "17 min 38 s" in row and meaning in row
    assert "a.b" not in said
    simulated(limiters=[])
    assert "at a limit" not in shipgrid("run").stdout


def test_a_rule_in_time_is_said_with_its_band(simulated):
    row = synthetic_run.SUMMARY["requirements"][0] | {"unit": "s", "limit": [None, 1.5], "value": 0.25}
    simulated(requirements=[Verdict(**row, rule="recovery", inside=[715.0, None], inside_unit="V")])
    assert "band >= 715 V, outside for <= 1.5 s" in shipgrid("run").stdout


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["run", "misson"], "misson: no bundled scenario of that name (nearest: 'mission')"),
        (["run", "--ship", "fery"], "fery: no bundled ship of that name (nearest: 'ferry')"),
        (["run", "--step", "30"], "--step: '30' has no unit; expected a number with a unit of s"),
        (["run", "--step", "1,5 us"], "--step: '1,5 us': the decimal sign is a point"),
        (["run", "--step", "1 s"], "--step: 1 s is out of range, expected 1 us .. 1000 us"),
        (["run", "--until", "12:30"], "--until: '12:30' is a time of day"),
        (["run", "--until", "0 s"], "--until: 0 s is not after the start"),
        (["run", "--until", "2 h"], "--until: 2 h is after the scenario's end, expected at most 3400 s"),
        (["run", "--fidelity", "averagd"], "--fidelity: no fidelity 'averagd' (nearest: 'averaged')"),
        (["run", "--set", "duration"], "--set duration: is not PATH=VALUE"),
        (["run", "--set", "equipment.bess_for.L=-1 mH"], "equipment.bess_for.L: -1 mH is out of range"),
        (["run", "--waveforms", "170s"], "--waveforms: '170s' is not a window, expected FROM:TO, such as 170s:170.2s"),
        (["run", "--waveforms", "17:18"], "--waveforms: '17' has no unit"),
        (["run", "--waveforms", "18s:17s"], "--waveforms: 18s:17s ends before it begins"),
        (["run", "--waveforms", "17s:4000s"], "17 s to 4000 s is not within the run, expected an end up to 3400 s"),
        (
            ["run", "--waveforms", "1s:4s", "--until", "3s"],
            "1 s to 4 s is not within the run, expected an end up to 3 s",
        ),
        (["run", "--reference"], "--reference: needs the window to run with both solvers, expected one --waveforms"),
        (["run", "--resume", "--reference"], "--resume: --reference keeps nothing that could be continued"),
        (["run", "--reference", "--waveforms", "9.9s:10.1s"], "--reference: a command comes at 10 s"),
        (["live", "--cores", "99"], "--cores: '99' is no core of this machine, expected one of 0"),
        (["live", "--cores", "0,0"], "--cores: '0,0' is no list of cores, expected numbers such as 0,1,2, each once"),
        (["live", "--cores", "0-2"], "--cores: '0-2' is no list of cores"),
        (["run", "--parts", "0"], "--parts: '0' is no number of parts, expected 1 or more, or 'ship'"),
        (["run", "--parts", "shp"], "--parts: 'shp' is no number of parts"),
        (["run", "--parts", "2", "--reference"], "--parts: --reference runs the whole plant"),
        (["parts", "--parts", "1"], "parts: the plant stays whole, so that there is nothing to show"),
        (["parts", "--until", "-1 s"], "--until: -1 s is not after the start"),
        (
            ["parts", "--until", "1 us"],
            "until = 1e-06 s, expected a step at least",
        ),
        (["live", "--factor", "0"], "factor = 0.0, expected 0.001 to 1000"),
        (["live", "--overrun", "hope"], "there is no overrun policy 'hope', expected catch-up or re-anchor"),
        (["live", "--console", "127.0.0.1:80"], "--console: not in this version"),
        (["live", "--udp", "127.0.0.1"], "--udp: '127.0.0.1' is no address, expected HOST:PORT, such as"),
        (["live", "--udp", ":5005"], "--udp: ':5005' is no address"),
        (["live", "--modbus", "::1:5020"], "--modbus: '::1:5020' is no address"),
        (["live", "--modbus", "127.0.0.1:modbus"], "--modbus: 'modbus' is no port, expected 0 to 65535"),
        (["live", "--modbus", "[::1]:65536"], "--modbus: '65536' is no port"),
        (["live", "--udp", "no such host:1"], "--udp: there is no host 'no such host'"),
        (["live", "--on-loss", "panic"], "--on-loss: nothing is done by the name 'panic', expected hold, safe, local"),
        (["live", "--timeout", "500"], "--timeout: '500' has no unit"),
        (["live", "--timeout", "0 s"], "--timeout: 0 s is no time to wait"),
        (["list", "signals", "--csv"], "--csv: belongs to `list registers`"),
        (["list", "signal"], "nothing to list of the name 'signal' (nearest: 'signals')"),
        (["plot", "nowhere", "dc_for.v_dc"], "nowhere"),
        (["plot", "nowhere", "dc_for.v_dc", "--from", "3"], "--from: '3' has no unit"),
        (["compare", "nowhere", "there"], "nowhere"),
    ],
)
def test_bad_input_is_said_and_ends_with_status_2_before_anything_runs(simulated, tmp_path, monkeypatch, words, says):
    monkeypatch.chdir(tmp_path)
    made = simulated()
    result = shipgrid(*words)
    assert (result.exit_code, made.asked) == (2, None), result.output
    assert says in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def four_cores(monkeypatch):
    monkeypatch.setattr(crew, "cores", lambda: [0, 1, 2, 3])


OWN = {"for": ("dc_for",), "aft": ("dc_aft",), "grid": ("ac_for", "ac_aft")}


@pytest.mark.parametrize(
    ("words", "parts", "says"),
    [
        (["--parts", "ship"], OWN, "cut into 3 parts (for, aft, grid) on 1 core"),
        (["--parts", "2", "--step", "30us", "--threads", "4"], 2, "cut into 2 parts (dc_for, dc_aft) on 2 cores"),
        (["--parts", "9", "--step", "30us"], 5, "--parts: ferry has 5 parts at steps of 30 us: any other line would"),
        (["--parts", "2"], None, "--parts: ferry stays whole at steps of 90 us: any other line would have a surplus"),
        (["--parts", "1"], None, ""),
        ([], None, ""),
    ],
)
def test_a_run_is_cut_where_it_is_asked_for(simulated, four_cores, words, parts, says):
    made = simulated()
    result = shipgrid("run", *words)
    assert result.exit_code == 0, result.output
    asked = getattr(made.asked, "parts", None)
    assert asked == parts if parts == OWN else len(asked or ()) == (parts or 0)
    assert getattr(made.asked, "workers", 1) == (2 if "--threads" in words else 1)
    assert says in result.stderr
    assert ("cut into" in result.stderr) == ("dc_tie.branch" in result.stderr) == (parts is not None)


def test_a_ship_without_parts_of_its_own_is_said_to_have_none(simulated, tmp_path):
    text = bundled("ship")["ferry"].read_text()
    (tmp_path / "ship.yaml").write_text(text[: text.index("parts:")])
    made = simulated()
    result = shipgrid("run", "--ship", str(tmp_path / "ship.yaml"), "--parts", "ship", "--step", "30")
    assert (result.exit_code, made.asked) == (2, None)
    assert "--parts: the file of ferry has no section 'parts', expected one, or a number" in result.stderr
    assert "--step: '30' has no unit" in result.stderr


@pytest.mark.parametrize(
    ("words", "cores", "parts", "says"),
    [
        ([], [], 0, ""),
        (["--cores", "2"], [2], 0, ""),
        (["--cores", "0,1"], [0, 1], 3, "cut into 3 parts (for, aft, grid) on 2 cores"),
        (["--cores", "3, 1,2"], [3, 1, 2], 3, "cut into 3 parts (for, aft, grid) on 3 cores"),
        (["--cores", "1,2,8"], [1, 2], 3, "--cores: there is no core 8 here (0, 1, 2, 3); the plant is cut all the"),
        (["--cores", "1,8"], [1], 3, "cut into 3 parts (for, aft, grid) on 1 core"),
        (["--cores", "0,1", "--parts", "1"], [0], 0, "--cores: the plant has no part for core 1"),
        (["--cores", "0,1,2", "--parts", "2"], [0, 1], 2, "--cores: the plant has no part for core 2"),
        (["--parts", "ship"], [], 3, "cut into 3 parts (for, aft, grid) on 1 core"),
    ],
)
def test_a_live_run_is_cut_for_the_cores_it_is_given(simulated, four_cores, words, cores, parts, says):
    made = simulated(error=SolverError("far enough"))
    result = shipgrid("live", *words)
    assert made.asked is not None, result.output
    assert (list(made.asked.live.cores), len(getattr(made.asked, "parts", ()))) == (cores, parts)
    assert says in result.stderr
    assert made.asked.step == 30e-6


def test_a_live_run_of_a_ship_without_parts_is_cut_into_as_many_as_there_are_cores(simulated, four_cores, tmp_path):
    text = bundled("ship")["ferry"].read_text()
    (tmp_path / "ship.yaml").write_text(text[: text.index("parts:")])
    made = simulated(error=SolverError("far enough"))
    shipgrid("live", "--ship", str(tmp_path / "ship.yaml"), "--cores", "0,3")
    assert (list(made.asked.live.cores), len(made.asked.parts)) == ([0, 3], 2)


def test_parts_and_lines_are_shown_before_anything_is_sailed():
    result = shipgrid("parts", "--step", "30us", "--until", "0 s")
    assert result.exit_code == 0, result.output
    lines = [line.split() for line in result.stdout.splitlines()]
    assert ["grid", "ac_for,", "ac_aft", "9", "0"] in lines
    assert ["dc_tie.branch", "for", "and", "aft", "9", "uH", "100", "uF", "0.588", "%"] in lines  # C = h2/L, over 17 mF
    assert "Cut minus whole" not in result.stdout


def test_a_live_run_has_the_gateway_that_is_asked_for(simulated, monkeypatch):
    for token, said in (("0123456789abcdeF", ""), ("", "token of this run: ")):
        monkeypatch.setenv("SHIPGRID_TOKEN", token)
        made = simulated(error=SolverError("far enough"))
        words = ("--udp", "[::1]:5005", "--modbus", "0.0.0.0:5020", "--on-loss", "safe", "--timeout", "0.25 s")
        result = shipgrid("live", *words)
        assert said in result.stderr and (said or "token of" not in result.stderr)
        assert "--modbus: listens on 0.0.0.0, which other machines may reach" in result.stderr
        assert "--udp: listens" not in result.stderr
        gateway = made.asked.live.attached.args[0]
        assert (gateway.udp, gateway.modbus) == (("::1", 5005), ("0.0.0.0", 5020))
        assert (gateway.lost, gateway.timeout) == ("safe", 0.25)
        assert gateway.token == 0x0123456789ABCDEF or not token
    monkeypatch.setenv("SHIPGRID_TOKEN", "secret")
    result = shipgrid("live", "--udp", "127.0.0.1:5005")
    assert (result.exit_code, "SHIPGRID_TOKEN: is no token, expected 16" in result.stderr) == (2, True)


def test_the_list_of_registers_is_for_people_and_for_programs():
    lines = list(csv.DictReader(shipgrid("list", "registers", "--csv").stdout.splitlines()))
    by_name = {line["name"]: line for line in lines}
    assert by_name["dc_for.v_dc"]["table"] == "input" and by_name["dc_for.v_dc"]["unit"] == "V"
    assert (by_name["bess_for.i_ref"]["takes"], by_name["bess_for.i_ref"]["unit"]) == ("-192 .. 192", "A")
    taken = [(line["table"], int(line["address"]) + k) for line in lines for k in range(int(line["registers"]))]
    assert len(taken) == len(set(taken))
    assert "Modbus address" in shipgrid("list", "registers").stdout


def test_every_mistake_of_options_and_files_comes_in_one_go(simulated, tmp_path):
    made = simulated()
    (tmp_path / "ship.yaml").write_text(bundled("ship")["ferry"].read_text().replace("L: 0.8 mH", "L: -0.8 mH", 1))
    (tmp_path / "scenario.yaml").write_text(
        bundled("scenario")["mission"].read_text().replace("duration: 3400 s", "duration: 3300 s")
        + "  - {name: late, signal: dc_for.v_dc, max: 1 V, from: 3350 s}\n"
    )
    result = shipgrid(
        *("run", str(tmp_path / "scenario.yaml"), "--ship", str(tmp_path / "ship.yaml")),
        *("--step", "30", "--set", "hull.wake=2", "--waveforms", "x"),
    )
    assert (result.exit_code, made.asked) == (2, None)
    for part in (
        "--step: '30'",
        "--waveforms",
        "-0.8 mH is out of range",
        "--set hull.wake=2",
        "3350 s is after the end",
    ):
        assert part in result.stderr


def test_check_finds_no_mistake_in_the_bundled_files():
    result = shipgrid("check", str(bundled("ship")["ferry"]), str(bundled("scenario")["mission"]))
    assert (result.exit_code, result.stdout) == (0, "2 files checked, no mistakes found\n")


def test_check_names_every_mistake_as_file_line_path(tmp_path):
    bad = tmp_path / "bad.yaml"
    bad.write_text(
        "schema: 1\nship: raft\nbuses:\n  dc: {kind: dc, v_n: 1,5 kV}\n  dc: {kind: dc, v_n: 750 V}\n"
        "equipment:\n  bess: {kind: bess, bus: dc, L: -1 mH, Q: 3 Ah}\n"
    )
    result = shipgrid("check", str(bad))
    assert result.exit_code == 2
    lines = result.stderr.splitlines()
    assert [line.removeprefix(f"{bad}:").split(": ")[:2] for line in lines] == [
        ["4", "buses.dc.v_n"],
        ["5", "buses.dc"],
        ["7", "equipment.bess.Q"],
        ["7", "equipment.bess.L"],
    ]
    assert "'1,5 kV': the decimal sign is a point, '1.5 kV'" in lines[0]
    assert "first given on line 4" in lines[1]


def test_check_tests_a_scenario_against_the_ship_given_with_it(tmp_path):
    ship, scenario = tmp_path / "raft.yaml", tmp_path / "drift.yaml"
    ship.write_text(
        "schema: 1\nship: raft\nbuses: {dc: {kind: dc, v_n: 750 V}}\nequipment: {bess: {kind: bess, bus: dc}}\n"
    )
    scenario.write_text(
        "schema: 1\nscenario: drift\nduration: 1 s\nstart: {state: moored}\n"
        "timeline:\n  - {at: 0.5 s, set: {bess.i_ref: 1 A}}\n"
    )
    assert shipgrid("check", str(scenario), str(ship)).exit_code == 0
    alone = shipgrid("check", str(scenario))
    assert alone.exit_code == 2 and "no such command" in alone.stderr


@pytest.mark.parametrize(
    ("what", "parts"),
    [
        ("ships", ["ferry"]),
        ("scenarios", ["mission", "3400 s"]),
        ("equipment", ["genset", "governor.K", "8 pu", "table A1", "from"]),
        ("components", ["Battery", "components.sources.battery"]),
        ("signals", ["propeller_aft.J_adv", "ac_for.f", "hull.u_ship"]),
        ("equipment", ["weather.A_T", "table or paper_fit or [[m/s, N], ...]"]),
        ("commands", ["hull.wave_height", "bess_for.i_ref", "-192 .. 192 A", "droop or voltage or current"]),
    ],
)
def test_list_shows_what_is_declared(what, parts):
    result = shipgrid("list", what)
    assert result.exit_code == 0
    for part in parts:
        assert part in result.stdout


def test_explain_names_buses_stages_and_time_constants():
    result = shipgrid("explain", "--step", "30us")
    assert result.exit_code == 0
    for part in (
        "dc_for",
        "17 mF",
        "5000 ohm",
        "genset_for.terminals",
        "bess_for.converter",
        "at 3240 Hz exactly",
        "0.0045 in CT*",
        "for and grid  848.8 uH",
        "head sea up to 1.39 m",
    ):
        assert part in result.stdout


def test_explain_says_what_converters_carry_against_their_rating_and_what_would_help():
    said = shipgrid("explain").stdout
    for part in (
        "377.5 kW",  # of 596 kW, at 750 V
        "rectifier_for, rectifier_aft: less than the rating, 358 kW of 596 kW on 712.5 V",
        "lcl_preset: design_rules carries the rating with 0.371 pu",
        "inverter_for, inverter_aft: less than the rating, 26.91 kVA of 50 kVA at power factor 0.9",
        "518 Hz",
        "600 to 810 Hz",
    ):
        assert part in said, part


def test_explain_is_silent_about_a_rectifier_that_carries_its_rating(tmp_path):
    text = load_ship().text
    path = tmp_path / "ruled.yaml"
    path.write_text(text.replace("f_sw: 1620 Hz, dc_droop: 0.05 pu}", "lcl_preset: design_rules}"))
    said = shipgrid("explain", "--ship", str(path)).stdout
    assert "rectifier_for, rectifier_aft  596 kW" in said
    assert "rectifier_aft: less than" not in said
    assert "717 Hz" in said


def test_help_answers_without_the_heavy_libraries():
    # Start-up time is what a person feels; the libraries behind it are what can be asserted without a clock.
    code = (
        "import sys\nfrom typer.testing import CliRunner\nfrom shipgrid.cli.main import app\n"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0\n"
        "heavy = {'numba', 'pint', 'scipy', 'xarray', 'netCDF4', 'matplotlib', 'ruamel.yaml'} & set(sys.modules)\n"
        "print(sorted(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_plot_draws_a_window_of_a_run(tmp_path):
    folder, out = synthetic_run.write(tmp_path), tmp_path / "plot.svg"
    result = shipgrid("plot", str(folder), "dc_for.v_dc", "--from", "300s", "--to", "330s", "--out", str(out))
    assert result.exit_code == 0, result.output
    assert out.read_text().startswith("<?xml")


def test_bench_measures_every_bundled_case_cold_and_warm(monkeypatch):
    from shipgrid.cli import bench

    asked = []

    def in_a_process(cache, ship, scenario, fidelity, steps):
        asked.append((ship, scenario, fidelity, len(list(Path(cache).iterdir())), len(steps) > 0))
        (Path(cache) / f"compiled{len(asked)}").touch()
        return {"cpu_s": 1.5, **({"steps": {"30 us": {"median_us": 3.25}}} if steps else {})}

    monkeypatch.setattr(bench, "_in_a_process", in_a_process)
    result = shipgrid("bench", "--json")
    assert result.exit_code == 0, result.output
    cases = list(product(bundled("ship"), bundled("scenario"), FIDELITIES))
    assert [a[:3] for a in asked] == [case for case in cases for _ in range(2)]
    # nothing compiled before the first, cold case
    assert [a[3:] for a in asked] == [(k, k % 2 == 1) for k in range(len(asked))]
    figures = json.loads(result.stdout)
    assert figures["cases"]["ferry mission averaged"]["cold"] == {"cpu_s": 1.5}
    assert {"version", "commit", "numba"} <= set(figures)
    table = shipgrid("bench").stdout
    assert "cases.ferry mission averaged.steps.30 us.median_us" in table and "3.25" in table
