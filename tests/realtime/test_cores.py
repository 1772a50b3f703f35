"""A plant in parts gives the same bits whatever the number of threads that share it, offline and live."""

from __future__ import annotations

import json

import pytest
from test_live_runs import ASKED, HURRY, busy, manned

from scenarios.killed_runs import case, simulate
from scenarios.test_resume import same
from shipgrid.analysis.settling import carried_over
from shipgrid.errors import InputErrors
from shipgrid.realtime.executive import Executive
from shipgrid.scenarios import session
from shipgrid.scenarios import simulate as simulation
from shipgrid.scenarios.output_folder import COMMANDS, unfinished
from shipgrid.scenarios.outside import read_outside

PARTS = {"for": ["dc_for"], "aft": ["dc_aft"], "grid": ["ac_for", "ac_aft"]}
UNTIL = 0.7
"""The tie, which is cut, opens under load at 0.6 s."""


@pytest.fixture(scope="module", autouse=True)
def start():
    """The start is found once, of the plant in one piece."""
    ship, scenario = case()
    mean = simulation.build(ship, scenario.step)
    work, drift = simulation.start(mean, ship, scenario)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "start", lambda plan, *_: (carried_over(mean, work, plan), drift))
        yield


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """All parts run by one thread."""
    folder = tmp_path_factory.mktemp("results") / "alone"
    simulate(folder, parts=PARTS, until=UNTIL)
    return folder


def test_three_threads_give_the_bits_of_one(alone, tmp_path):
    simulate(tmp_path / "three", parts=PARTS, until=UNTIL, workers=3)
    assert same(tmp_path / "three", alone)


def test_a_live_run_on_several_cores_is_the_offline_run_on_one(alone, tmp_path):
    simulate(tmp_path / "live", parts=PARTS, until=UNTIL, live=Executive(HURRY, cores=[0, 0, 0]))
    assert same(tmp_path / "live", alone)
    found = json.loads((tmp_path / "live" / "summary.json").read_text())["realtime"]
    assert sorted(part for core in found["crew"] for part in core["parts"]) == sorted(PARTS)
    assert len(found["cores"]) == 3
    for core in found["cores"]:
        assert core["worst"] >= core["p50"] > 0.0


def test_commands_from_outside_are_repeated_at_their_steps(tmp_path):
    executive = Executive(0.5, cores=[0, 0], attached=manned(busy))
    simulate(tmp_path / "live", parts=PARTS, until=UNTIL, live=executive)
    given = read_outside(tmp_path / "live" / COMMANDS, case()[0].commands)
    assert [(c.path, c.value) for c in given] == ASKED
    simulate(tmp_path / "again", parts=PARTS, until=UNTIL, outside=given)
    assert same(tmp_path / "live", tmp_path / "again")


def test_an_interrupted_run_is_continued_by_another_number_of_threads(alone, tmp_path):
    def stop(t, end):
        if t > 0.3:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "WALL_PER_CHUNK", 0.005)
        simulate(tmp_path / "out", parts=PARTS, until=UNTIL, workers=2, progress=stop)
    assert unfinished(tmp_path / "out")
    with pytest.raises(InputErrors, match="parts"):
        simulate(tmp_path / "out", until=UNTIL, resume=True)
    simulate(tmp_path / "out", parts=PARTS, until=UNTIL, resume=True)
    assert same(tmp_path / "out", alone)
