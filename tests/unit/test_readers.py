"""Who opens results changes nothing: not of a run under way, not of one that was killed, not in a read-only folder."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import synthetic_run
from typer.testing import CliRunner

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.workspace import new_workspace
from shipgrid.cli.main import app
from shipgrid.errors import InputErrors
from shipgrid.model.network import Network
from shipgrid.scenarios import results, row_log, snapshot
from shipgrid.scenarios.output_folder import MARK, MARK_BEGINS, RESULTS, SNAPSHOT, SUMMARY, UNFINISHED
from shipgrid.scenarios.results import open_results
from shipgrid.scenarios.row_log import RowLog, make_results

GROUPS = {"plant": [("dc_for.v_dc", "V", "main bus voltage"), ("bess_for.i_b", "A", "battery current")]}
IN_SNAPSHOT, WRITTEN = 20, 27
"""Rows that belong to the last snapshot, and rows in the file."""


def rows(n):
    time = 0.1 * np.arange(n)
    return time, *(np.stack([750.0 + time, time], axis=1),) * 4


def killed(folder):
    """A folder as a killed run leaves it, with some rows behind its last snapshot."""
    log = folder / UNFINISHED
    log.mkdir(parents=True)
    (folder / MARK).write_text(
        f"{MARK_BEGINS} test\nschema: 1\nship: |2\n  ship: raft\nscenario: |2\n  scenario: drift\n"
    )
    with RowLog(log, GROUPS, {"plant": 0.1}, {"version": "0.1.0"}) as writer:
        writer.append("plant", *rows(WRITTEN))
        writer.sync()
    about = {"events": [(1.0, "bess_for", "on")], "limiters": [], "rows": {"plant": IN_SNAPSHOT}}
    snapshot.write(log / SNAPSHOT, new_workspace(assemble(Network("raft"))), about)
    return folder


def state(folder):
    """Every file and folder with its contents and the time of its last change."""
    paths = [folder, *folder.rglob("*")]
    return {path: (path.stat().st_mtime_ns, path.is_file() and path.read_bytes()) for path in paths}


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A folder for temporary files of its own, to see what is left in it."""
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


@pytest.fixture
def left(tmp_path):
    return killed(tmp_path / "results" / ".raft-averaged-k3f9w2ab")


def test_a_killed_run_is_read_up_to_its_last_snapshot_and_stays_as_it_was(left, temporary):
    before = state(left)
    with open_results(left) as run:
        assert len(run["dc_for.v_dc"]) == IN_SNAPSHOT
        assert run["bess_for.i_b_max"].values == pytest.approx(0.1 * np.arange(IN_SNAPSHOT), rel=1e-6)
        assert [event.text for event in run.events] == ["on"] and "not finished" in repr(run)
        assert run.settings["ship"] == {"ship": "raft"}
        assert len(list(temporary.iterdir())) == 1
        assert state(left) == before
    assert state(left) == before
    assert list(temporary.iterdir()) == []


def test_results_that_have_just_been_made_keep_all_their_rows(left, temporary):
    """Between the moment when a run makes them and the moment when it writes its summary."""
    make_results(left, left / UNFINISHED, [], [])
    before = state(left)
    with open_results(left) as run:
        assert len(run["dc_for.v_dc"]) == IN_SNAPSHOT  # it is not said yet that they are complete
    assert state(left) == before
    (left / SUMMARY).write_text("{}")
    with open_results(left) as run:
        assert len(run["dc_for.v_dc"]) == WRITTEN
        assert list(temporary.iterdir()) == []


def test_a_reader_that_is_not_closed_leaves_nothing_behind(left, temporary):
    signal = open_results(left)["dc_for.v_dc"]
    gc.collect()
    assert list(temporary.iterdir()) == []
    if os.name == "posix":
        assert len(signal.values) == IN_SNAPSHOT, "what is open can still be read"
    code = f"from shipgrid import open_results; run = open_results({str(left)!r}); print(len(run['bess_for.i_b']))"
    surroundings = os.environ | {"TMPDIR": str(temporary)}
    done = subprocess.run([sys.executable, "-c", code], env=surroundings, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(IN_SNAPSHOT)
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ["plot", "{left}", "dc_for.v_dc", "--out", "{out}/plot.svg"],
        ["compare", "{left}", "{left}"],
        ["compare", "{left}", "{whole}", "--means"],
    ],
)
def test_commands_that_read_change_nothing(words, left, tmp_path, temporary):
    whole = synthetic_run.write(tmp_path)
    before = state(left)
    result = CliRunner().invoke(app, [word.format(left=left, out=tmp_path, whole=whole) for word in words])
    assert result.exit_code == 0, result.output
    assert state(left) == before and list(temporary.iterdir()) == []


def test_the_report_of_an_unfinished_run_is_all_that_is_written_and_only_where_it_is_wanted(left, tmp_path, temporary):
    before = state(left)
    with open_results(left) as run:
        page = run.report(tmp_path / "report.html").read_text()
        assert "the run was not finished" in page and "Written by shipgrid" in page
        assert state(left) == before
        run.report()
    assert {path for path in state(left) if path not in before} == {left / "report.html"}


def test_results_in_a_folder_that_one_may_only_read(left, monkeypatch):
    """Also as a user who is not the superuser, who may write anywhere."""
    outside = Path(tempfile.mkdtemp())
    try:
        folder = Path(shutil.copytree(left, outside / "run"))
        outside.chmod(0o755)
        for path in (*folder.rglob("*"), folder):
            path.chmod(0o555 if path.is_dir() else 0o444)
        before = state(folder)
        root = os.geteuid() == 0
        try:
            if root:
                os.seteuid(65534)
            assert not os.access(folder, os.W_OK, effective_ids=True)
            with open_results(folder) as run:
                assert len(run["dc_for.v_dc"].values) == IN_SNAPSHOT
        finally:
            if root:
                os.seteuid(0)
        assert state(folder) == before
    finally:
        for path in (outside, *(path for path in outside.rglob("*") if path.is_dir())):
            path.chmod(0o755)
        shutil.rmtree(outside)


def ending(monkeypatch, act):
    """Let something happen to the folder after a reader has begun to look, before it has its first row."""
    real = row_log.read

    def read(path):
        act()
        return real(path)

    monkeypatch.setattr(row_log, "read", read)


def test_a_run_that_is_put_in_its_place_meanwhile_is_named(left, temporary, monkeypatch):
    place = left.with_name("raft-averaged")
    ending(monkeypatch, lambda: left.rename(place))
    with pytest.raises(InputErrors, match=rf"{left}: the run has ended in the meantime, expected {place}"):
        open_results(left)
    assert list(temporary.iterdir()) == []


def test_a_run_that_ends_in_its_place_meanwhile_is_read_whole(left, temporary, monkeypatch):
    make_results(left, left / UNFINISHED, [], [])

    def end():
        (left / SUMMARY).write_text('{"simulated_s": 2.7}')
        shutil.rmtree(left / UNFINISHED)

    ending(monkeypatch, end)
    with open_results(left) as run:
        assert len(run["dc_for.v_dc"]) == WRITTEN and run.summary == {"simulated_s": 2.7}
    assert list(temporary.iterdir()) == []


def test_a_summary_that_comes_after_the_rows_were_read_is_not_that_of_those_rows(left, temporary, monkeypatch):
    ending(monkeypatch, lambda: (left / SUMMARY).write_text('{"simulated_s": 2.7}'))
    with open_results(left) as run:
        assert len(run["dc_for.v_dc"]) == IN_SNAPSHOT and run.summary == {} and "not finished" in repr(run)


def test_rows_that_are_missing_or_no_room_to_read_them_is_said(left, temporary, monkeypatch):
    def full(**_):
        raise OSError(28, "No space left on device")

    with (
        monkeypatch.context() as patch,
        pytest.raises(InputErrors, match=r"cannot be read \(.*No space left on device"),
    ):
        patch.setattr(results.tempfile, "mkdtemp", full)
        open_results(left)
    path = left / UNFINISHED / "plant.rows"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputErrors, match=r"what this run has recorded so far cannot be read .*plant.rows is damaged"):
        open_results(left)
    (left / UNFINISHED / SNAPSHOT).write_bytes(b"torn")
    with pytest.raises(InputErrors, match=r"snapshot.npz: is damaged"):
        open_results(left)
    assert list(temporary.iterdir()) == []
    assert not (left / RESULTS).exists()


@pytest.mark.parametrize("group", ["../x", "plant/../../x", "/etc/x", "a\\b", "", "waveforms/0/1"])
def test_a_group_of_rows_is_no_path(group, tmp_path):
    (tmp_path / "log").mkdir()
    with pytest.raises(ValueError, match="is not the name of a group"):
        RowLog(tmp_path / "log", {group: GROUPS["plant"]}, {}, {})
    assert [path.name for path in tmp_path.rglob("*")] == ["log"]
