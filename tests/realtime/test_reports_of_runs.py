"""Every kind of run has its report, and its folder has nothing in it but what shipgrid is known to write."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from test_live_runs import HURRY, ask, manned, waited

from scenarios.killed_runs import case, simulate
from scenarios.test_resume import interrupt_at, killed_in_the_middle
from shipgrid.analysis.settling import carried_over
from shipgrid.errors import SolverError
from shipgrid.realtime.executive import Executive
from shipgrid.scenarios import session
from shipgrid.scenarios import simulate as simulation
from shipgrid.scenarios.output_folder import foreign, prepare, unfinished
from shipgrid.scenarios.outside import Outside
from shipgrid.scenarios.results import open_results

PARTS = {"for": ["dc_for"], "aft": ["dc_aft"], "grid": ["ac_for", "ac_aft"]}
STEP = 70e-6
SHORT = {"until": 0.12, "waveforms": [], "report": True}
GIVEN = [Outside(200, "bess_for.i_ref", 30.0, "UDP")]


@pytest.fixture(scope="module", autouse=True)
def starts():
    """The start is searched for once; the workspaces that runs begin with, the newest last."""
    ship, scenario = case()
    mean, made = simulation.build(ship, STEP), []
    work, drift = simulation.start(mean, ship, scenario)

    def start(plan, *_):
        made.append(carried_over(mean, work, plan))
        return made[-1], drift

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "start", start)
        yield made


def text_of(folder):
    """Words of a report; its data can be read as JSON."""
    page = (folder / "report.html").read_text()
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert data is not None and json.loads(data[1])["panels"]
    assert foreign(folder) == []
    return re.sub(r"\s+", " ", re.sub(r"<script.*?</script>|<style.*?</style>|<[^>]+>", " ", page, flags=re.DOTALL))


def test_offline_with_commands_that_came_from_outside(tmp_path):
    simulate(tmp_path / "run", **SHORT, outside=GIVEN)
    text = text_of(tmp_path / "run")
    assert "all 1 requirements met" in text and "set to 30 A, by UDP" in text and "Real time" not in text
    prepare(tmp_path / "run").discard()  # it may be replaced


def test_offline_switching_with_waveforms(tmp_path):
    how = SHORT | {"waveforms": [(0.05, 0.12)]}
    simulate(tmp_path / "run", **how, fidelity="switching", step=STEP)
    text = text_of(tmp_path / "run")
    assert "switching fidelity" in text and "Waveforms from 0.05" in text and "Harmonics" in text


def test_interrupted_and_continued(tmp_path, monkeypatch):
    monkeypatch.setattr(session, "WALL_PER_CHUNK", 1e-3)
    first = simulate(tmp_path / "run", **SHORT, progress=interrupt_at(0.05))
    assert first.summary["interrupted"] and "interrupted" in text_of(tmp_path / "run")
    assert (tmp_path / "run" / "unfinished").is_dir()
    simulate(tmp_path / "run", **SHORT, resume=True)
    assert "all 1 requirements met" in text_of(tmp_path / "run")
    assert not (tmp_path / "run" / "unfinished").exists()


def test_failed(starts, tmp_path, monkeypatch):
    """What a run that diverges leaves: here a value that is not a number appears in it."""
    monkeypatch.setattr(session, "WALL_PER_CHUNK", 1e-3)

    def spoil(now, end):
        if now > 0.05:
            starts[-1].sig[:] = np.nan

    with pytest.raises(SolverError, match="results up to then are in"):
        simulate(tmp_path / "run", **SHORT, progress=spoil)
    assert "the simulation failed" in text_of(tmp_path / "run")


def test_live_on_one_core_with_commands_from_outside(tmp_path):
    def act(shared, run):
        assert waited(lambda: run.work.pace.pacer[0].steps >= 200)
        ask(shared, run, "bess_for.i_ref", 30.0)

    simulate(tmp_path / "run", **SHORT, live=Executive(0.4, attached=manned(act)))
    text = text_of(tmp_path / "run")
    assert "Real time" in text and "Time of a step" in text and "all cores" not in text
    assert "set to 30 A, by Modbus" in text


def test_live_in_parts_on_several_threads(tmp_path):
    simulate(tmp_path / "run", **SHORT, parts=PARTS, live=Executive(HURRY, cores=[0, 0, 0]))
    text = text_of(tmp_path / "run")
    assert "when all cores have run their parts" in text and "core 3" in text


def test_killed_and_opened_unfinished(tmp_path, monkeypatch):
    monkeypatch.setattr(session, "WALL_PER_CHUNK", 1e-3)
    killed_in_the_middle(tmp_path / "run", 0.05, **SHORT)
    (left,) = unfinished(tmp_path / "run")
    assert foreign(left) == []
    with open_results(left) as run:
        run.report()
    assert "no summary: the run was not finished" in text_of(left)
