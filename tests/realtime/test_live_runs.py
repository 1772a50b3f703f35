"""A live run is the offline run: same signals, same log, whatever the clock, the disk or the operator do."""

from __future__ import annotations

import json
import os
import signal
import threading
import time

import numpy as np
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
                assert waited(lambda: run.work.pace.pacer[0].steps >= 3000 * (1 + count[0]))
                entry = box[int(count[0])]
                entry.place, entry.value = run.plan.layout.index[f"command:{path}"], value
                count[0] += 1

        hand = threading.Thread(target=operator)
        hand.start()

        return lambda: hand.join() or {}

    simulate(tmp_path / "live", live=Executive(0.5, attached=attached))
    given = read_outside(tmp_path / "live" / COMMANDS)
    assert [(c.path, c.value, c.origin) for c in given] == [(*command, "Python") for command in asked]
    simulate(tmp_path / "again", outside=given)
    assert same(tmp_path / "live", tmp_path / "again")
    assert read_outside(tmp_path / "again" / COMMANDS) == given  # so that this one can be repeated too
    events = recorded(tmp_path / "live")["events/text"].tolist()
    assert "set to 30 A, by Python" in events


def test_ctrl_c_stops_it_cleanly_and_it_goes_on_live_or_not(offline, tmp_path):
    steps_at = []

    def attached(shared, run):
        def operator():
            if waited(lambda: run.work.pace.pacer[0].steps >= 4000) and run.work.pace.pacer[0].steps < 20_000:
                os.kill(os.getpid(), signal.SIGINT)

        hand = threading.Thread(target=operator)
        hand.start()
        return lambda: steps_at.append(int(run.work.pace.pacer[0].steps)) or hand.join() or {}

    results = simulate(tmp_path / "run", live=Executive(0.5, attached=attached))
    assert results.summary["interrupted"] and steps_at[0] >= 4000
    simulate(tmp_path / "run", live=Executive(HURRY), resume=True)
    assert same(tmp_path / "run", offline)


def test_a_live_run_that_is_killed_goes_on_from_its_last_snapshot(offline, tmp_path):
    place = tmp_path / "run"
    child = os.fork()
    if child == 0:
        try:
            simulate(place, live=Executive(0.1, snapshot_every=0.2))  # fifteen seconds
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
    assert about["n"] > 0  # not the start
    simulate(place, resume=True)
    assert same(place, offline)


def test_a_pause_is_no_overrun(offline, tmp_path):
    executive, stood = Executive(virtual_cost=[7_000]), []
    executive.pause()

    def attached(shared, run):
        p = run.work.pace.pacer[0]

        def operator():
            for steps in (0, 5):
                waited(lambda steps=steps: p.steps >= steps)
                time.sleep(0.05)  # in which it would go on, if it did
                stood.append(int(p.steps))
                executive.step(5) if steps == 0 else executive.go_on()

        hand = threading.Thread(target=operator)
        hand.start()
        return lambda: hand.join() or {}

    executive.attached = attached
    simulate(tmp_path / "live", live=executive)
    assert stood == [0, 5]
    assert same(tmp_path / "live", offline)
    assert realtime(tmp_path / "live")["overruns"] == 0


def waited(until, most=60.0):
    """Wait for something that comes, or not."""
    end = time.monotonic() + most
    while not until() and time.monotonic() < end:
        time.sleep(1e-4)
    return until()


def test_rows_that_the_disk_was_too_slow_for_are_counted(offline, tmp_path, monkeypatch):
    monkeypatch.setattr("shipgrid.realtime.executive.RING_WAVES", 64)
    simulate(tmp_path / "live", live=Executive(HURRY))
    found = realtime(tmp_path / "live")
    assert found["rows_lost"]["waveforms"] > 0
    ours, whole = recorded(tmp_path / "live"), recorded(offline)
    kept = np.isin(whole["waveforms/0/time"], ours["waveforms/0/time"])
    assert len(ours["waveforms/0/time"]) == np.sum(kept) < len(kept)
    for name in (name for name in whole if name.startswith("waveforms/0/")):
        assert ours[name].tobytes() == whole[name][kept].tobytes(), name  # what is there is right


@pytest.mark.parametrize(
    ("options", "said"),
    [({"factor": 0.0}, "factor = 0.0, expected 0.001 to 1000"), ({"policy": "hope"}, "expected catch-up or re-anchor")],
)
def test_nonsense_is_refused(options, said):
    with pytest.raises(ParameterError, match=said):
        Executive(**options)
