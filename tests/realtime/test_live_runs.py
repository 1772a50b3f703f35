"""A live run is the offline run: same signals, same log, whatever the clock, the disk or the operator do."""

from __future__ import annotations

import json
import os
import signal
import threading
import time

import pytest

from scenarios.killed_runs import simulate, snapshots, started
from scenarios.test_resume import recorded, same
from shipgrid.errors import ParameterError
from shipgrid.realtime.executive import Executive
from shipgrid.scenarios import runner, snapshot
from shipgrid.scenarios.output_folder import SNAPSHOT, UNFINISHED, unfinished
from shipgrid.scenarios.outside import COMMANDS, read_outside

HURRY = 1000.0
"""A factor of time that no machine keeps up with: every step is an overrun, and nothing waits."""


@pytest.fixture(scope="module", autouse=True)
def start():
    """The start is found once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "start", started())
        yield


@pytest.fixture(scope="module")
def offline(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "offline"
    simulate(folder)
    return folder


def realtime(folder):
    return json.loads((folder / "summary.json").read_text())["realtime"]


def test_a_live_run_is_the_offline_run(offline, tmp_path):
    simulate(tmp_path / "live", live=Executive(HURRY))
    assert same(tmp_path / "live", offline)
    found = realtime(tmp_path / "live")
    steps = round(1.5 / 70e-6)
    assert (found["steps"], found["rows_lost"]) == (steps, {})
    assert found["overruns"] == steps and found["verdict"].startswith("not in real time")
    histograms = json.loads((tmp_path / "live" / "realtime.json").read_text())["histograms"]
    assert sum(count for _, count in histograms["computation"]) == steps


def test_on_a_clock_of_its_own_nothing_is_late(offline, tmp_path):
    results = simulate(tmp_path / "live", live=Executive(virtual_cost=[7_000]))
    assert same(tmp_path / "live", offline)
    found = realtime(tmp_path / "live")
    assert found["overruns"] == 0 and found["duty"] == pytest.approx(0.1)
    assert found["wall_s"] == pytest.approx(found["simulated_s"] - 63e-6, abs=1e-9)  # to the end of the last step
    assert results["realtime.core_1.computation"].values == pytest.approx([7e-6])


def test_commands_from_outside_are_repeated_at_their_steps(tmp_path):
    asked = [("propulsion_for.speed_ref", 2.0), ("bess_for.i_ref", 30.0)]

    def attached(shared, run):
        box, count = shared.arrays["inbox"], shared.arrays["inbox_count"]

        def operator():
            for path, value in asked:
                while run.work.pace.pacer[0].steps < 3000 * (1 + count[0]):
                    time.sleep(1e-4)
                entry = box[int(count[0])]
                entry.place, entry.value = run.plan.layout.index[f"command:{path}"], value
                count[0] += 1

        hand = threading.Thread(target=operator)
        hand.start()

        return lambda: hand.join() or {}

    simulate(tmp_path / "live", live=Executive(10.0, attached=attached))
    given = read_outside(tmp_path / "live" / COMMANDS)
    assert [(c.path, c.value, c.origin) for c in given] == [(*command, "Python") for command in asked]
    simulate(tmp_path / "again", outside=given)
    assert same(tmp_path / "live", tmp_path / "again")
    events = recorded(tmp_path / "live")["events/text"].tolist()
    assert "set to 30 A, by Python" in events


def test_ctrl_c_stops_it_cleanly_and_it_goes_on_live_or_not(offline, tmp_path):
    steps_at = []

    def attached(shared, run):
        def operator():
            while run.work.pace.pacer[0].steps < 4000:
                time.sleep(1e-3)
            os.kill(os.getpid(), signal.SIGINT)

        hand = threading.Thread(target=operator)
        hand.start()
        return lambda: steps_at.append(int(run.work.pace.pacer[0].steps)) or hand.join() or {}

    results = simulate(tmp_path / "run", live=Executive(1.0, attached=attached))
    assert results.summary["interrupted"] and steps_at[0] >= 4000
    simulate(tmp_path / "run", live=Executive(HURRY), resume=True)
    assert same(tmp_path / "run", offline)


def test_a_live_run_that_is_killed_goes_on_from_its_last_snapshot(offline, tmp_path):
    place = tmp_path / "run"
    child = os.fork()
    if child == 0:
        try:
            simulate(place, live=Executive(0.25, snapshot_every=0.2))  # six seconds
        finally:
            os._exit(0)
    seen: set = set()
    while len(seen) < 4:  # of the start, and three while it sails
        seen |= snapshots(place)
        assert os.waitpid(child, os.WNOHANG) == (0, 0), "it ended before it could be killed"
        time.sleep(1e-3)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    (left,) = unfinished(place)
    about, _ = snapshot.read(left / UNFINISHED / SNAPSHOT)
    assert about["n"] > 1000  # not the start
    simulate(place, resume=True)
    assert same(place, offline)


def test_a_pause_is_no_overrun(offline, tmp_path):
    executive = Executive(virtual_cost=[7_000])

    def attached(shared, run):
        p = run.work.pace.pacer[0]

        def operator():
            while p.steps < 2000:
                time.sleep(1e-4)
            executive.pause()
            time.sleep(0.05)
            while p.steps != (was := int(p.steps)):
                time.sleep(0.05)
            executive.step(5)
            while p.steps < was + 5:
                time.sleep(1e-3)
            time.sleep(0.05)
            assert p.steps == was + 5
            executive.go_on()

        hand = threading.Thread(target=operator)
        hand.start()
        return lambda: hand.join() or {"was_paused": True}

    executive.attached = attached
    simulate(tmp_path / "live", live=executive)
    assert same(tmp_path / "live", offline)
    found = realtime(tmp_path / "live")
    assert found["was_paused"] and found["overruns"] == 0


def test_rows_that_the_disk_was_too_slow_for_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr("shipgrid.realtime.executive.RING_WAVES", 64)
    simulate(tmp_path / "live", live=Executive(HURRY))
    found = realtime(tmp_path / "live")
    assert found["rows_lost"]["waveforms"] > 0
    whole = round(0.05 / 70e-6) + 1
    with_rows = recorded(tmp_path / "live")["waveforms/0/dc_for.v_dc"]
    assert len(with_rows) < whole


@pytest.mark.parametrize(
    ("options", "said"),
    [({"factor": 0.0}, "factor = 0.0, expected 0.001 to 1000"), ({"policy": "hope"}, "expected catch-up or re-anchor")],
)
def test_nonsense_is_refused(options, said):
    with pytest.raises(ParameterError, match=said):
        Executive(**options)
