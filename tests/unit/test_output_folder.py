"""The folder of results: checked before the run, put in place whole."""

import os
import shutil
from collections import namedtuple

import pytest

from shipgrid.errors import ParameterError
from shipgrid.scenarios import output_folder
from shipgrid.scenarios.output_folder import MARK, prepare


def results(folder, text):
    folder.mkdir(parents=True)
    (folder / MARK).write_text(text)
    return folder


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_nothing_stands_in_the_place_until_it_is_complete(tmp_path):
    out = tmp_path / "a" / "b"
    folder = prepare(out)
    (folder.path / MARK).write_text("new")
    assert not out.exists()
    assert folder.path.parent == out.parent  # same disk: the rename is one
    assert folder.commit() == out
    assert names(out) == [MARK] and names(out.parent) == ["b"]


def test_an_older_folder_is_replaced_whole(tmp_path):
    out = results(tmp_path / "out", "old")
    (out / "results.nc").write_text("old")
    folder = prepare(out)
    (folder.path / MARK).write_text("new")
    assert (out / MARK).read_text() == "old"
    folder.commit()
    assert names(out) == [MARK] and (out / MARK).read_text() == "new"
    assert names(tmp_path) == ["out"]


def test_discarding_leaves_the_older_folder_as_it_was(tmp_path):
    out = results(tmp_path / "out", "old")
    folder = prepare(out)
    (folder.path / MARK).write_text("new")
    folder.discard()
    assert names(tmp_path) == ["out"] and (out / MARK).read_text() == "old"


def test_an_empty_folder_may_be_replaced_but_nothing_else_of_a_persons(tmp_path):
    (tmp_path / "empty").mkdir()
    prepare(tmp_path / "empty").discard()
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "letter.txt").write_text("dear")
    with pytest.raises(ParameterError, match=r"holds something else than results \(no run.yaml\)"):
        prepare(tmp_path / "home")
    assert (tmp_path / "home" / "letter.txt").exists()


def test_a_file_in_the_place_or_on_the_way_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ParameterError, match="is a file, expected a folder"):
        prepare(tmp_path / "file")
    with pytest.raises(ParameterError, match="cannot be written: a file is in the way, expected another folder"):
        prepare(tmp_path / "file" / "out")


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_folder_without_permission_is_refused_before_the_run(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ParameterError, match="cannot be written: no permission"):
        prepare(tmp_path / "out")
    tmp_path.chmod(0o700)


def test_a_read_only_disk_is_refused_before_the_run(tmp_path, monkeypatch):
    def refuse(**_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(output_folder.tempfile, "mkdtemp", refuse)
    with pytest.raises(ParameterError, match="cannot be written: the disk is read-only, expected another folder"):
        prepare(tmp_path / "out")


def test_too_little_room_is_refused_before_the_run_and_leaves_nothing(tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**9, 10**9, 4096))
    with pytest.raises(ParameterError, match=r"has 4 kB free, expected at least 250 MB for this run"):
        prepare(tmp_path / "a" / "b", bytes_needed=250_000_000)
    assert names(tmp_path) == []


def test_a_folder_that_cannot_be_put_in_place_keeps_old_and_new(tmp_path):
    out = results(tmp_path / "out", "old")
    folder = prepare(out)
    (folder.path / MARK).write_text("new")
    (out / MARK).unlink()
    (out / "letter.txt").write_text("put here while the run went on")
    with pytest.raises(ParameterError, match="holds something else"):
        folder.commit()
    assert (out / "letter.txt").exists() and (folder.path / MARK).read_text() == "new"
