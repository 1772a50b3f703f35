"""A live run is the offline run: same signals, same log, whatever the clock, the disk or the operator do."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from scenarios.killed_runs import case, simulate, snapshots, started
from scenarios.test_resume import recorded, same
from shipgrid.errors import ParameterError
from shipgrid.realtime.desk import MODBUS
from shipgrid.realtime.executive import Executive
from shipgrid.scenarios import simulate as simulation
from shipgrid.scenarios import snapshot
from shipgrid.scenarios.output_folder import COMMANDS, SNAPSHOT, UNFINISHED, unfinished
from shipgrid.scenarios.outside import read_outside

STEP = 70e-6
HURRY = 1000.0
"""A factor of time that no machine keeps up with: every step is an overrun, and nothing waits."""


@pytest.fixture(scope="module", autouse=True)
def start():
    """The start is found once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "start", started())
        yield


@pytest.fixture(scope="module")
def offline(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "offline"
    simulate(folder)
    return folder


@pytest.fixture(scope="module")
def commands():
    """What the ship takes."""
    return case()[0].commands


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


def manned(act):
    """What attaches a hand to a run: `act(shared, run)`, in a thread of its own."""

    def attached(shared, run):
        hand = threading.Thread(target=act, args=(shared, run))
        hand.start()
        return lambda: hand.join() or {}

    return attached


def ask(shared, run, path, value):
    """Put a command into the box, as the gateway does."""
    count = shared.arrays["inbox_count"]
    place = run.plan.layout.index[f"command:{path}"]
    shared.arrays["inbox"][int(count[0])] = place, value, MODBUS, 0
    count[0] += 1


ASKED = [("propulsion_for.speed_ref", 2.0), ("bess_for.i_ref", 30.0)]


def busy(shared, run):
    """Gives two commands, some thousand steps apart."""
    for k, (path, value) in enumerate(ASKED, 1):
        assert waited(lambda k=k: run.work.pace.pacer[0].steps >= 3000 * k)
        ask(shared, run, path, value)


def test_commands_from_outside_are_repeated_at_their_steps(commands, tmp_path):
    simulate(tmp_path / "live", live=Executive(0.5, attached=manned(busy)))
    given = read_outside(tmp_path / "live" / COMMANDS, commands)
    assert [(c.path, c.value, c.origin) for c in given] == [(*command, "Modbus") for command in ASKED]
    simulate(tmp_path / "again", outside=given)
    assert same(tmp_path / "live", tmp_path / "again")
    assert read_outside(tmp_path / "again" / COMMANDS, commands) == given  # so that this one can be repeated too
    events = recorded(tmp_path / "live")["events/text"].tolist()
    assert "set to 30 A, by Modbus" in events


def test_commands_at_both_ends_of_a_window_leave_its_rows_alone(tmp_path):
    """The step that follows a command has a visit; it may be the first of a window, or the first behind it."""
    given = [round(t / STEP) for t in (0.1, 0.2, 0.3)]
    edges = [(given[0] + 1, given[1]), (given[2] + 1, given[2] + 100)]
    windows = [(first * STEP, last * STEP) for first, last in edges]
    simulate(tmp_path / "live", live=Executive(HURRY), until=0.4, waveforms=windows)
    simulate(tmp_path / "offline", until=0.4, waveforms=windows)
    assert same(tmp_path / "live", tmp_path / "offline")
    rows = [len(recorded(tmp_path / "live")[f"waveforms/{k}/time"]) for k in range(2)]
    assert rows == [last - first + 1 for first, last in edges]


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
    assert realtime(tmp_path / "run")["from_s"] == 0.0
    simulate(tmp_path / "run", live=Executive(HURRY), resume=True)
    assert same(tmp_path / "run", offline)
    found, at = realtime(tmp_path / "run"), results.summary["simulated_s"]
    assert found["from_s"] == at and found["simulated_s"] == pytest.approx(1.5 - at, abs=STEP)
    assert found["verdict"].endswith(f"; since {at:g} s, where the run was continued")


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


def test_what_a_killed_live_run_was_told_is_repeated_when_it_is_continued_offline(commands, tmp_path):
    place = tmp_path / "run"
    child = os.fork()
    if child == 0:
        try:
            simulate(place, live=Executive(0.2, attached=manned(busy)), until=0.7)  # a snapshot at its start alone
        finally:
            os._exit(0)

    def told():
        files = [file for path in unfinished(place) if (file := path / UNFINISHED / COMMANDS).is_file()]
        return files and files[0].read_text().count("\n") == len(ASKED)

    assert waited(told)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    (left,) = unfinished(place)
    assert snapshot.read(left / UNFINISHED / SNAPSHOT)[0]["n"] == 0
    with (left / UNFINISHED / COMMANDS).open("a") as file:
        file.write("12000,bess_for.i_r")  # the line that was being written
    given = read_outside(left / UNFINISHED / COMMANDS, commands, torn=True)
    assert [(c.path, c.value) for c in given] == ASKED
    simulate(tmp_path / "repeat", outside=given, until=0.7)
    shutil.copytree(left, tmp_path / left.name.replace("run", "live"))
    simulate(place, until=0.7, resume=True)
    assert same(place, tmp_path / "repeat") and read_outside(place / COMMANDS, commands) == given
    simulate(
        tmp_path / "live", live=Executive(HURRY), until=0.7, resume=True
    )  # whoever commanded it is there, and may again
    assert not (tmp_path / "live" / COMMANDS).exists()


def test_a_plant_that_stands_still_writes_snapshots_with_events_in_their_order(tmp_path):
    executive, place = Executive(HURRY), tmp_path / "run"
    executive.pause()
    found = []

    @manned
    def attached(shared, run):
        ask(shared, run, "genset_for.on", 1.0)
        executive.step(500)
        waited(lambda: run.work.pace.pacer[0].steps >= 500)
        before = snapshots(place)
        executive.snapshot()
        waited(lambda: snapshots(place) - before)
        found.append(snapshot.read(unfinished(place)[0] / UNFINISHED / SNAPSHOT)[0])
        executive.stop()

    executive.attached = attached
    simulate(place, live=executive, until=0.3, waveforms=[])
    assert found[0]["n"] == 500
    events = [tuple(event) for event in found[0]["events"]]
    assert (0.0, "genset_for.on", "set to true, by Modbus") in events
    assert any(who == "genset_for" for _, who, _ in events)  # what it led to
    assert [t for t, _, _ in events] == sorted(t for t, _, _ in events)


def test_an_executive_is_used_again_as_if_it_were_new(tmp_path):
    executive = Executive(HURRY)

    @manned
    def attached(shared, run):
        waited(lambda: run.work.pace.pacer[0].steps >= 500)
        executive.pause()
        executive.snapshot()
        executive.stop()

    executive.attached = attached
    how = {"live": executive, "until": 0.3, "waveforms": []}
    assert simulate(tmp_path / "run", **how).summary["interrupted"]
    executive.attached = None
    again = simulate(tmp_path / "run", **how, resume=True).summary
    assert not again["interrupted"] and again["steps"] == round(0.3 / STEP)


def test_single_steps_asked_for_while_a_pause_begins_are_all_made(tmp_path):
    executive, stood = Executive(1e-3), []  # a step takes 70 ms

    @manned
    def attached(shared, run):
        p = run.work.pace.pacer[0]
        waited(lambda: p.steps >= 3)
        executive.step(100)  # nobody stands still: not kept for later
        before = int(p.steps)
        executive.pause()
        executive.step(4)
        waited(lambda: p.steps >= before + 4, 2.0)
        time.sleep(0.7)  # in which ten more would be made
        stood.append(int(p.steps) - before)
        executive.stop()

    executive.attached = attached
    simulate(tmp_path / "run", live=executive, until=0.3, waveforms=[])
    assert 4 <= stood[0] <= 8  # the step under way is ended first; a busy machine may look late


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is locked on Linux")
def test_memory_is_locked_as_long_as_the_run_lasts(tmp_path, monkeypatch):
    called = []

    class Library:
        def mlockall(self, flags):
            called.append("locked")
            return 0

        def munlockall(self):
            called.append("released")
            return 0

    fake = SimpleNamespace(CDLL=lambda *_, **__: Library(), get_errno=lambda: 0)
    monkeypatch.setattr("shipgrid.realtime.executive.ctypes", fake)
    results = simulate(tmp_path / "run", live=Executive(HURRY), until=0.1, waveforms=[])
    assert results.summary["realtime"]["scheduling"]["memory"] == "locked"
    assert called == ["locked", "released"]


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
