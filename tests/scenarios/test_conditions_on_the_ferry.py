"""Conditions of a time-line on the ferry: obeyed, logged, and the same however a run is cut into pieces."""

from __future__ import annotations

import json
import math
import os
import signal

import pytest

import shipgrid as sg
from scenarios.killed_runs import case, started
from scenarios.killed_runs import simulate as run_case
from scenarios.test_resume import same
from shipgrid.io.report import verdict
from shipgrid.realtime.desk import MODBUS
from shipgrid.realtime.executive import Executive
from shipgrid.scenarios import session
from shipgrid.scenarios import simulate as simulation
from shipgrid.scenarios.output_folder import COMMANDS
from shipgrid.scenarios.outside import read_outside

WAITING = """\
schema: 1
scenario: waiting
description: shafts that speed up give commands, one of which the interlocks hold back until the tie is open
duration: 1.5 s
step: 70 us
start: {state: moored, closed: [dc_tie]}
timeline:
  - {name: leave, at: 0.1 s, set: {propulsion_for.speed_ref: 6 kn, propulsion_aft.speed_ref: 6 kn}}
  - name: turning
    when: {signal: propulsion_for.omega_m, above: 0.2 rpm, for: 0.2 s}
    set: {bess_for.mode: voltage, bess_aft.mode: voltage}
  - {name: apart, after: turning, delay: 0.15 s, set: {dc_tie.close: false}}
  - {when: {signal: dc_tie.closed, below: 0.5}, after: apart, set: {bess_aft.v_dc_ref: 745 V}}
  - name: swing
    when: {signal: dc_aft.v_dc, below: 749 V, hysteresis: 0.5 V}
    times: unlimited
    optional: true
    set: {bess_aft.v_dc_ref: 748 V}
  - {name: seen, when: [{signal: bess_aft.i_b, above: 17 A}, {signal: bess_aft.soc, above: 40 %}], from: 0.5 s}
  - {name: full, when: {signal: bess_for.soc, above: 90 %}, set: {bess_for.i_ref: 0 A}}
"""
HURRY = 1000.0
WINDOWS = [(0.0, 0.001), (1.0, 1.001)]
FIND_START = simulation.start


@pytest.fixture(scope="module", autouse=True)
def start():
    """The start is found once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "start", started())
        yield


def simulate(out, *, made_of=None, **options):
    return run_case(out, made_of=made_of or case(scenario=WAITING), **{"waveforms": WINDOWS, **options})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The run that nothing disturbs."""
    folder = tmp_path_factory.mktemp("results") / "whole"
    simulate(folder)
    return folder


def test_commands_are_given_when_conditions_hold_and_the_log_says_which(whole):
    with sg.open_results(whole) as run:
        said = [(e.source, e.text) for e in run.events if " by " in e.text or e.source == "timeline"]
        times = {e.source: e.time for e in run.events if " by " in e.text and "refused" not in e.text}
        instants = [e.time / (1429 * 70e-6) for e in run.events if " by " in e.text]  # 0.1 s, in whole steps
        omega, run_events = run["propulsion_for.omega_m"].load(), run.events
    turning = "by turning: propulsion_for.omega_m above 0.2 rpm for 0.2 s"
    both = "bess_for and bess_aft would both form the voltage of dc_aft and dc_for"
    assert said[:-1] == [
        ("bess_aft.v_dc_ref", "set to 748 V by swing: dc_aft.v_dc below 749 V"),
        ("timeline", "seen: bess_aft.i_b above 17 A and bess_aft.soc above 40 %"),
        ("bess_for.mode", f"set to voltage {turning}"),
        ("bess_aft.mode", f"refused: {both} (set to voltage {turning})"),
        ("dc_tie.close", "set to false by apart: 0.15 s after turning"),
        ("bess_aft.v_dc_ref", "set to 745 V by timeline.3: dc_tie.closed below 0.5, after apart"),
    ]
    assert [e.text for e in run_events if e.source == "bess_aft.mode"][-1] == "set to voltage, as it had been asked to"
    assert instants == pytest.approx([round(k) for k in instants], abs=1e-6)
    assert times["dc_tie.close"] - times["bess_for.mode"] == pytest.approx(0.2, abs=1e-4)  # the instant after 0.15 s
    assert times["bess_aft.v_dc_ref"] > times["dc_tie.close"]
    at = times["bess_for.mode"]
    limit = 0.2 * math.pi / 30.0
    assert float(omega.sel(time=at - 0.2, method="nearest")) > limit
    assert float(omega.sel(time=at - 0.3, method="nearest")) < limit


def test_what_never_happened_is_in_summary_log_and_badge_and_the_run_is_not_ok(whole):
    with sg.open_results(whole) as run:
        assert not run.ok
        found = {outcome.name: outcome for outcome in run.timeline}
        last = run.events[-1]
        badge = verdict(run)
    assert [name for name, outcome in found.items() if outcome.missing] == ["full"]
    assert found["turning"].happened == 1 and found["turning"].first_s == found["turning"].last_s
    assert json.loads((whole / "summary.json").read_text())["timeline"][-1] == {
        "name": "full", "waits_for": "bess_for.soc above 90 %", "times": 1, "happened": 0, "first_s": None,
        "last_s": None, "verdict": "never happened",
    }  # fmt: skip
    assert (last.source, last.text) == ("timeline", "full never happened: bess_for.soc above 90 %")
    assert badge == ("bad", "1 of 6 entries of the time-line missing")


def interrupt_at(t):
    return lambda now, end: os.kill(os.getpid(), signal.SIGINT) if now >= t else None


def test_a_run_in_small_pieces_that_is_continued_gives_the_same_bits(whole, tmp_path, monkeypatch):
    """It is interrupted while a condition has held for a part of its time."""
    monkeypatch.setattr(session, "WALL_PER_CHUNK", 0.01)
    with sg.open_results(whole) as run:
        turning = next(outcome.first_s for outcome in run.timeline if outcome.name == "turning")
    simulate(tmp_path / "out", progress=interrupt_at(turning - 0.12))
    done = simulate(tmp_path / "out", resume=True)
    assert turning - 0.2 < done.summary["continued_at_s"][0] < turning
    assert same(tmp_path / "out", whole)


def test_a_live_run_that_is_continued_offline_is_the_offline_run(whole, tmp_path):
    first = simulate(tmp_path / "out", live=Executive(0.5), progress=interrupt_at(0.4))
    assert first.summary["interrupted"] and 0.3 < first.summary["simulated_s"] < 1.4
    simulate(tmp_path / "out", resume=True)
    assert same(tmp_path / "out", whole)


@pytest.mark.full
def test_a_condition_that_a_command_from_outside_brings_about_is_repeated(tmp_path):
    """The charge current that a controller orders is what the time-line waits for."""
    scenario = WAITING.replace("bess_for.soc, above: 90 %", "bess_aft.i_b, above: 15 A")
    made_of = case(scenario=scenario)

    def attached(shared, run):
        count = shared.arrays["inbox_count"]
        place = run.plan.layout.index["command:bess_aft.i_ref"]
        shared.arrays["inbox"][int(count[0])] = place, 60.0, MODBUS, 0
        count[0] += 1
        return dict

    live = simulate(tmp_path / "live", made_of=made_of, live=Executive(HURRY, attached=attached))
    assert live.ok and live.timeline[-1].happened == 1
    given = read_outside(tmp_path / "live" / COMMANDS, made_of[0].commands)
    simulate(tmp_path / "again", made_of=made_of, outside=given)
    assert same(tmp_path / "live", tmp_path / "again")


@pytest.fixture
def cut(tmp_path, monkeypatch):
    """The same, cut into two parts."""
    monkeypatch.setattr(simulation, "start", FIND_START)
    how = {"made_of": case(scenario=WAITING, step="30 us"), "parts": 2}
    simulate(tmp_path / "one", **how)
    return tmp_path / "one", how


def test_a_cut_plant_waits_for_the_same_conditions(cut, whole):
    with sg.open_results(cut[0]) as run, sg.open_results(whole) as uncut:
        for a, b in zip(run.timeline, uncut.timeline, strict=True):
            assert (a.name, a.happened) == (b.name, b.happened)
            if a.first_s is not None:
                assert a.first_s == pytest.approx(b.first_s, abs=0.11), a.name  # an instant, and those of 70 us


@pytest.mark.full
def test_the_threads_of_a_cut_plant_change_nothing(cut, tmp_path):
    simulate(tmp_path / "two", **cut[1], workers=2)
    assert same(tmp_path / "two", cut[0])
