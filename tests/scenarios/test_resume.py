"""A run that is interrupted, killed or out of disk is continued to what it would have been, to the last bit."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import netCDF4
import numpy as np
import pytest
from typer.testing import CliRunner

import shipgrid as sg
from scenarios.killed_runs import SCENARIO, WINDOWS, case, simulate, started
from shipgrid.cli.main import app
from shipgrid.errors import InputErrors, ParameterError, SolverError
from shipgrid.scenarios import conclude, resume, session
from shipgrid.scenarios import simulate as simulation
from shipgrid.scenarios.output_folder import MARK_BEGINS, SNAPSHOT, UNFINISHED, taken_over, unfinished
from shipgrid.scenarios.outside import Outside, read_outside

FIND_START = simulation.start
GROUPS = ("plant", "slow", "waveforms/0", "waveforms/1", "events", "limiters")


def recorded(folder):
    """Every number and text in a file of results, by group and variable."""
    with netCDF4.Dataset(folder / "results.nc") as file:
        return {
            f"{group}/{name}": np.asarray(variable[:])
            for group in GROUPS
            for name, variable in file[group].variables.items()
        }


def same(folder, whole):
    """Whether two runs have the same results, every bit of them."""
    ours, theirs = recorded(folder), recorded(whole)
    assert ours.keys() == theirs.keys()
    for name, values in theirs.items():
        assert ours[name].shape == values.shape, name
        assert (
            ours[name].tolist() == values.tolist()
            if values.dtype == object
            else (ours[name].tobytes() == values.tobytes())
        ), name
    a, b = (json.loads((path / "summary.json").read_text()) for path in (folder, whole))
    for figure in ("energy", "energy_balance_error", "limiters", "requirements", "steps", "start_drift_per_s"):
        assert a[figure] == b[figure], figure
    assert not a["interrupted"] and not a["failure"]
    return True


@pytest.fixture(scope="module", autouse=True)
def start():
    """The start is found once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "start", started())
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The run that nothing disturbs."""
    folder = tmp_path_factory.mktemp("results") / "whole"
    simulate(folder)
    return folder


@pytest.fixture
def hurried(monkeypatch):
    monkeypatch.setattr(resume, "SNAPSHOT_S", 0.0)
    monkeypatch.setattr(session, "WALL_PER_CHUNK", 0.01)


def interrupt_at(t):
    """A progress callback that presses Ctrl-C at a simulated time."""
    return lambda now, end: os.kill(os.getpid(), signal.SIGINT) if now >= t else None


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_the_undisturbed_run_has_what_a_continued_one_could_lose(whole):
    data = recorded(whole)
    texts = data["events/text"].tolist()
    assert len(data["plant/time"]) == 16 and len(data["slow/time"]) == 3
    assert len(data["waveforms/0/time"]) > 700 and len(data["waveforms/1/time"]) > 1400
    assert any(text.startswith("refused: bess_for and bess_aft would both form") for text in texts)
    assert any(text.endswith("as it had been asked to") for text in texts)
    assert names(whole) == ["results.nc", "run.yaml", "summary.json"]


def test_how_often_a_run_stops_for_a_moment_changes_nothing(whole, tmp_path, monkeypatch):
    """What is held back is looked at every 0.1 s of ship time, not whenever the runner looks about."""
    monkeypatch.setattr(session, "WALL_PER_CHUNK", 1e-9)
    simulate(tmp_path / "out")
    assert same(tmp_path / "out", whole)


def killed(folder, seed, count):
    """Start runs and kill them, in processes of their own."""
    program = Path(__file__).with_name("killed_runs.py")
    words = [sys.executable, str(program), str(folder), str(seed), str(count)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=1800, check=False)
    assert done.returncode == 0, done.stderr


def continued(folder, count, whole):
    """Whether each of them is continued to the results of the undisturbed one, and nothing else is left of it."""
    for k in range(count):
        out = folder / f"run-{k}"
        if unfinished(out):  # else it was done before its second kill
            simulate(out, resume=True)
        assert same(out, whole), k
        assert not unfinished(out)
        assert names(out) == ["results.nc", "run.yaml", "summary.json"]
        assert json.loads((out / "summary.json").read_text())["continued_at_s"]
    return True


def test_a_killed_run_is_continued_to_the_same_bits(whole, tmp_path):
    killed(tmp_path, seed=6, count=2)
    assert continued(tmp_path, 2, whole)


@pytest.mark.full
def test_fifty_killed_runs_are_continued_to_the_same_bits(whole, tmp_path):
    killed(tmp_path, seed=50, count=50)
    assert continued(tmp_path, 50, whole)


GENSET = """\
schema: 1
scenario: starting
description: an engine with its delay, a generator that builds up its voltage, a rectifier that pre-charges and connects
duration: 12 s
start: {state: moored, closed: [dc_tie]}
timeline:
  - {at: 0.1 s, set: {genset_for.on: true, propulsion_for.speed_ref: 6 kn}}
"""


@pytest.mark.full
@pytest.mark.parametrize("fidelity", ["averaged", "switching"])
def test_a_genset_that_starts_while_the_run_is_interrupted_again_and_again(fidelity, tmp_path, monkeypatch):
    """Delay lines, blocked and switching bridges, contacts: with either fidelity the same bits."""
    monkeypatch.setattr(simulation, "start", FIND_START)
    monkeypatch.setattr(session, "WALL_PER_CHUNK", 0.02)
    how = {
        "made_of": case(scenario=GENSET),
        "fidelity": fidelity,
        "step": 30e-6,
        "waveforms": [(0.0, 0.05), (10.0, 10.2)],
    }
    simulate(tmp_path / "whole", **how)
    simulate(tmp_path / "out", **how, progress=interrupt_at(2.0))
    for t in (4.0, 6.0, 8.0, 8.5, 9.0, 10.1, 11.0):
        assert simulate(tmp_path / "out", **how, resume=True, progress=interrupt_at(t)).summary["interrupted"]
    done = simulate(tmp_path / "out", **how, resume=True)
    assert len(done.summary["continued_at_s"]) == 8
    assert any(event.source == "rectifier_for" for event in done.events)
    assert same(tmp_path / "out", tmp_path / "whole")


def test_results_of_a_killed_run_can_be_opened_as_far_as_its_last_snapshot(whole, tmp_path, hurried, monkeypatch):
    out = tmp_path / "out"
    killed_in_the_middle(out, 1.1)
    (left,) = unfinished(out)
    assert not out.exists() and left.name.startswith(".out-")
    theirs = recorded(whole)["plant/dc_for.v_dc"]
    with sg.open_results(left) as run:
        ours = run["dc_for.v_dc"].values
        assert 8 <= len(ours) < len(theirs)
        assert ours.tobytes() == theirs[: len(ours)].tobytes()
        assert "not finished" in repr(run) and run.events
    with pytest.raises(InputErrors, match=r"is at .* already, expected a later end"):
        simulate(out, until=0.68, resume=True)
    simulate(out, resume=True)
    assert same(out, whole) and names(tmp_path) == ["out"]


def test_who_reads_a_run_under_way_takes_nothing_from_it(whole, tmp_path, hurried, monkeypatch):
    """Not even when its results have just been made, and their summary has not."""
    out, lengths, instants = tmp_path / "out", [], [0.8]

    def read():
        (folder,) = unfinished(out)
        with sg.open_results(folder) as run:
            lengths.append(len(run["dc_for.v_dc"]))

    def under_way(now, end):
        if instants and now > instants[0]:
            instants.pop(0)
            read()

    real = conclude.energy_balance
    monkeypatch.setattr(conclude, "energy_balance", lambda *words: (read(), real(*words))[1])
    simulate(out, progress=under_way)
    assert same(out, whole)
    assert len(lengths) == 2 and 8 <= lengths[0] < lengths[1] < 16


class Killed(BaseException):
    """Nothing in the program handles it: what it leaves is what a kill at that instant would."""


def killed_in_the_middle(out, t, **options):
    """A run that is gone at a simulated time, in this process."""

    def gone(now, end):
        if now >= t:
            raise Killed

    with pytest.raises(Killed):
        simulate(out, progress=gone, **options)


def test_an_interrupted_run_stands_in_its_place_until_it_is_continued_and_done(whole, tmp_path, hurried):
    out = tmp_path / "out"
    first = simulate(out, progress=interrupt_at(0.4))
    assert first.summary["interrupted"] and names(tmp_path) == ["out"]
    at = first.summary["simulated_s"]
    assert first.events[-1].text == "interrupted"
    (out / "plot.png").write_bytes(b"PNG")  # it is put in place of this folder when it is done
    with pytest.raises(ParameterError, match=r"holds 'plot.png', which shipgrid did not write"):
        simulate(out, resume=True)
    (out / "plot.png").unlink()
    second = simulate(out, resume=True, progress=interrupt_at(0.8))
    assert second.summary["interrupted"] and second.summary["simulated_s"] > at
    assert second.summary["continued_at_s"] == [at]
    third = simulate(out, resume=True)
    assert same(out, whole) and names(tmp_path) == ["out"]
    assert third.summary["continued_at_s"] == [at, second.summary["simulated_s"]]
    assert third.summary["wall_s"] > second.summary["wall_s"] > first.summary["wall_s"]
    with pytest.raises(InputErrors, match="has a finished run, and no unfinished one"):
        simulate(out, resume=True)
    assert same(out, whole)


def test_commands_from_outside_are_silenced_as_before_and_keep_their_order(tmp_path, hurried):
    """One event a second for each of them, however often the run is continued."""
    out = tmp_path / "out"
    given = [Outside(k, "bess_for.i_ref", float(k % 1000) / 20.0, "UDP") for k in range(2000, 21_000, 700)]
    given += [Outside(21_000, "bess_aft.i_ref", value, "UDP") for value in (3.0, 1.0, 2.0, 5.0, 4.0)]
    simulate(tmp_path / "whole", outside=given)
    simulate(out, outside=given, progress=interrupt_at(0.4))
    killed_in_the_middle(out, 0.8, outside=given, resume=True)
    simulate(out, progress=interrupt_at(1.1), resume=True)
    simulate(out, resume=True)
    assert same(out, tmp_path / "whole")
    said = [text for text in recorded(out)["events/text"].tolist() if "by UDP" in text]
    assert len(said) == 3 and "after" in said[1]
    assert read_outside(out / "commands.csv", case()[0].commands) == given


def test_the_run_that_got_furthest_is_continued_and_an_end_may_be_put_off(whole, tmp_path, hurried, monkeypatch):
    out = tmp_path / "out"
    simulate(out, until=1.2, progress=interrupt_at(0.4))
    killed_in_the_middle(out, 1.0, until=1.2, resume=True)
    assert len(unfinished(out)) == 2
    found: list[tuple] = []
    simulate(out, resume=True, found=lambda *which: found.append(which))
    assert found[0][0] >= 0.9 and found[0][1].name.startswith(".out-")
    assert same(out, whole) and names(tmp_path) == ["out"]


def test_nothing_to_continue_is_said_and_nothing_is_written(tmp_path):
    with pytest.raises(
        InputErrors, match=r"nothing to continue: there is no .*out, and no unfinished one lies beside it"
    ):
        simulate(tmp_path / "deep" / "out", resume=True)
    assert names(tmp_path) == []


@pytest.fixture(scope="module")
def killed_early(tmp_path_factory, start):
    """Place of a run that was killed early on."""
    out = tmp_path_factory.mktemp("results") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "WALL_PER_CHUNK", 0.01)
        killed_in_the_middle(out, 0.2)
    return out


@pytest.fixture
def left(killed_early, tmp_path):
    """A copy of it."""
    shutil.copytree(killed_early.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / "out"


def lines_of(left, **options):
    before = {path: path.read_bytes() for path in unfinished(left)[0].rglob("*") if path.is_file()}
    with pytest.raises(InputErrors) as caught:
        simulate(left, resume=True, **options)
    assert "is another one" in caught.value.problems[0]
    assert {path: path.read_bytes() for path in unfinished(left)[0].rglob("*") if path.is_file()} == before
    return "\n".join(caught.value.problems[1:])


def test_a_run_of_another_plan_is_refused_with_what_differs(left, monkeypatch):
    said = lines_of(left, made_of=case(**{"equipment.bess_for.capacity": "100 Ah"}))
    assert re.search(r"ship file, line \d+: '.*capacity: 128 Ah.*' in the snapshot, '.*capacity: 100 Ah.*' now", said)
    later = SCENARIO.replace("at: 0.6 s", "at: 0.7 s")
    said = lines_of(left, made_of=case(scenario=later))
    assert re.search(r"scenario file, line 11: '.*at: 0.6 s.*' in the snapshot, '.*at: 0.7 s.*' now", said)
    assert "step: '7e-05 s' in the snapshot, '6e-05 s' now" in lines_of(left, step=60e-6)
    said = lines_of(left, fidelity="switching", step=70e-6)
    assert "fidelity: 'averaged' in the snapshot, 'switching' now" in said
    assert "waveforms: '0.0 s to" in lines_of(left, waveforms=[]) and "nothing now" in lines_of(left, waveforms=[])
    monkeypatch.setattr(sg, "__version__", "9.9")
    assert "program.shipgrid: '0.1.0' in the snapshot, '9.9' now" in lines_of(left)


def test_a_comment_in_a_file_is_no_other_ship(left, whole):
    simulate(
        left,
        made_of=case(scenario="# as before\n" + SCENARIO.replace("timeline:", "\ntimeline:  # what happens")),
        resume=True,
    )
    assert same(left, whole)


def test_a_changed_source_of_the_program_is_named(left, monkeypatch):
    from shipgrid.scenarios import snapshot

    name = "shipgrid.automation.interlocks"
    changed = snapshot._sources() | {name: "0" * 16}
    monkeypatch.setattr(snapshot, "_sources", lambda: changed)
    assert lines_of(left) == f"  {name}: this source file of the program has been changed"


def test_a_run_under_way_is_not_continued_by_another_process(left):
    (path,) = unfinished(left)
    held = taken_over(path, left)  # as the process that writes it
    assert held is not None
    with pytest.raises(InputErrors, match="is being run by another process"):
        simulate(left, resume=True)
    held.release()


def test_a_damaged_snapshot_is_refused(left):
    path = unfinished(left)[0] / UNFINISHED / SNAPSHOT
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], whole[:2000] + bytes(64) + whole[2064:], b""):
        path.write_bytes(damaged)
        with pytest.raises(InputErrors, match=r"snapshot.npz: is damaged or no snapshot"):
            simulate(left, resume=True)


@pytest.mark.parametrize("what", ["rows", "snapshot", "results"])
def test_a_run_whose_disk_fills_up_is_continued_when_there_is_room(what, whole, tmp_path, hurried, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    older = f"{MARK_BEGINS} older"
    (out / "run.yaml").write_text(older)
    names_of = {
        "rows": (simulation.RowLog, "append"),
        "snapshot": (resume.snapshot, "write"),
        "results": (conclude, "make_results"),
    }
    owner, name = names_of[what]
    real, calls = getattr(owner, name), []

    def full(*words, **options):
        calls.append(words)
        if len(calls) > (0 if what == "results" else 6):
            raise OSError(28, "No space left on device")
        return real(*words, **options)

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, full)
        with pytest.raises(SolverError, match=r"No space left on device; what was computed is in .*\.out-.*--resume"):
            simulate(out)
    assert (out / "run.yaml").read_text() == older  # results that were there are not lost for half a run
    simulate(out, resume=True)
    assert same(out, whole) and names(tmp_path) == ["out"]


def shipgrid(*words):
    return CliRunner().invoke(app, [*words, "--no-report"])


def test_the_command_line_continues_a_run_by_its_options_or_its_run_yaml(whole, tmp_path, hurried, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("leaving.yaml").write_text(SCENARIO)
    windows = [word for a, b in WINDOWS for word in ("--waveforms", f"{a}s:{b}s")]
    out = Path("results/leaving-averaged")
    options = ["run", "leaving.yaml", *windows]
    said = shipgrid(*options, "--resume")
    assert said.exit_code == 2 and "nothing to continue: there is no results/leaving-averaged" in said.stderr
    simulate(out, progress=interrupt_at(0.4))
    said = shipgrid(*options, "--resume")
    assert said.exit_code == 0, said.output
    assert re.search(
        r"continued at 0\.\d+ s of 1.5 s, from the last snapshot in .*/results/leaving-averaged", said.stderr
    )
    assert same(out, whole)
    shutil.rmtree(out)
    killed_in_the_middle(out, 0.4)
    (left,) = unfinished(out)
    said = shipgrid(
        "run", "results/leaving-averaged/run.yaml", "--resume", "--set", "equipment.bess_for.capacity=90 Ah"
    )
    assert said.exit_code == 2 and "ship file, line" in said.stderr
    said = shipgrid(*options, "--until", "0.2s", "--out", str(out / ".." / "other"))
    assert said.exit_code == 2  # the second window is beyond that end
    said = shipgrid("run", "results/leaving-averaged/run.yaml", "--resume")
    assert said.exit_code == 0, said.output
    assert same(out, whole) and not left.exists()


def test_a_new_run_says_that_an_unfinished_one_is_there(left, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("leaving.yaml").write_text(SCENARIO)
    said = shipgrid("run", "leaving.yaml", "--until", "0.1s", "--out", "out")
    assert said.exit_code == 0, said.output
    assert re.search(
        r"an unfinished run lies in .*\.out-\w+ and stays as it is; --resume would continue it", said.stderr
    )
    assert len(unfinished(left)) == 1
