"""The folder of results: checked before the run, put in place whole."""

import os
import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from shipgrid.errors import ParameterError
from shipgrid.scenarios import output_folder
from shipgrid.scenarios.output_folder import MARK, MARK_BEGINS, finish, foreign, prepare, remove, taken_over

WHOLE = ("results.nc", "summary.json", "realtime.json", "report.html", "commands.csv", "registers.csv")
BEGUN = ("columns.json", "snapshot.npz", "commands.csv", "results.nc", "plant.rows", "waveforms-12.rows")
"""Files of a folder of results besides `run.yaml`, and of its sub-folder."""


def results(folder, text):
    folder.mkdir(parents=True)
    (folder / MARK).write_text(f"{MARK_BEGINS} {text}\n")
    return folder


def everything(folder):
    """A folder with every file that a run writes, those that a kill leaves half-written among them."""
    results(folder, "old")
    (folder / "unfinished").mkdir()
    for name in (*WHOLE, *(f"unfinished/{begun}" for begun in BEGUN)):
        (folder / name).write_text("old")
        (folder / f"{name}.part").write_text("old")
    (folder / ".report.html.part").write_text("old")
    return folder


def text_of(folder):
    return (folder / MARK).read_text().removeprefix(MARK_BEGINS).strip()


def contents(folder):
    """Everything below a folder, with what it is."""
    return {
        str(path.relative_to(folder)): os.readlink(path) if path.is_symlink() else path.is_file() and path.read_bytes()
        for path in folder.rglob("*")
    }


def a_file(folder):
    (folder / "thesis.tex").write_text("years of work")
    return "thesis.tex"


def a_plot(folder):
    (folder / "plot.png").write_bytes(b"PNG")
    return "plot.png"


def a_repository(folder):
    (folder / ".git").mkdir()
    (folder / ".git" / "HEAD").write_text("ref: main")
    return ".git"


def an_empty_folder(folder):
    (folder / "later").mkdir()
    return "later"


def a_folder_of_a_known_name(folder):
    (folder / "report.html").unlink(missing_ok=True)
    (folder / "report.html").mkdir()
    return "report.html"


def a_file_among_the_rows(folder):
    (folder / "unfinished").mkdir(exist_ok=True)
    (folder / "unfinished" / "notes.rows.txt").write_text("mine")
    return "unfinished/notes.rows.txt"


def a_file_in_the_place_of_the_rows(folder):
    for path in (folder / "unfinished").iterdir() if (folder / "unfinished").exists() else ():
        path.unlink()
    if (folder / "unfinished").exists():
        (folder / "unfinished").rmdir()
    (folder / "unfinished").write_text("mine")
    return "unfinished"


def a_link(folder):
    (folder.parent / "elsewhere.nc").write_text("precious")
    (folder / "results.nc").unlink(missing_ok=True)
    (folder / "results.nc").symlink_to("../elsewhere.nc")
    return "results.nc"


def a_linked_folder(folder):
    (folder.parent / "elsewhere").mkdir()
    (folder.parent / "elsewhere" / "snapshot.npz").write_text("precious")
    a_file_in_the_place_of_the_rows(folder)
    (folder / "unfinished").unlink()
    (folder / "unfinished").symlink_to("../elsewhere")
    return "unfinished"


FOREIGN = [
    *(a_file, a_plot, a_repository, an_empty_folder, a_folder_of_a_known_name, a_file_among_the_rows),
    *(a_file_in_the_place_of_the_rows, a_link, a_linked_folder),
]


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
    assert text_of(out) == "old"
    folder.commit()
    assert names(out) == [MARK] and (out / MARK).read_text() == "new"
    assert names(tmp_path) == ["out"]


def test_discarding_leaves_the_older_folder_as_it_was(tmp_path):
    out = results(tmp_path / "out", "old")
    folder = prepare(out)
    (folder.path / MARK).write_text("new")
    folder.discard()
    assert names(tmp_path) == ["out"] and text_of(out) == "old"


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
    with pytest.raises(
        ParameterError, match=rf"holds something else .*; the results are in {folder.path}, and --resume"
    ):
        folder.commit()
    assert (out / "letter.txt").exists() and (folder.path / MARK).read_text() == "new"


def test_every_file_that_a_run_writes_is_replaced(tmp_path):
    out = everything(tmp_path / "out")
    assert foreign(out) == []
    folder = prepare(out)
    (folder.path / MARK).write_text("new")
    folder.commit()
    assert names(out) == [MARK] and names(tmp_path) == ["out"]


@pytest.mark.parametrize("put", FOREIGN)
@pytest.mark.parametrize("made", [lambda folder: results(folder, "old"), everything])
def test_a_folder_with_anything_foreign_in_it_is_refused_before_the_run_and_stays_as_it_was(made, put, tmp_path):
    out = made(tmp_path / "out")
    name = put(out)
    before = contents(tmp_path)
    assert foreign(out) == [name]
    with pytest.raises(ParameterError, match=rf"--out: {out} holds '{name}', which shipgrid did not write .* moved"):
        prepare(out)
    assert contents(tmp_path) == before
    assert not remove(out)
    assert contents(tmp_path) == before


def test_the_number_of_foreign_things_is_said(tmp_path):
    out = results(tmp_path / "out", "old")
    for name in ("a.txt", "b.txt", "c.txt"):
        (out / name).write_text("mine")
    with pytest.raises(ParameterError, match=r"holds 'a.txt' and 2 more, which shipgrid did not write"):
        prepare(out)


@pytest.mark.parametrize("text", ["x", "", "# notes of my own\n", "schema: 1\nship: ferry\n"])
def test_a_run_yaml_of_somebody_else_makes_no_folder_of_results(text, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / MARK).write_text(text)
    with pytest.raises(
        ParameterError, match=r"something else than results \(its run.yaml was not written by shipgrid\)"
    ):
        prepare(tmp_path / "mine")
    assert (tmp_path / "mine" / MARK).read_text() == text


@pytest.mark.parametrize("target", ["elsewhere", "nowhere"])
def test_a_link_in_the_place_is_refused_with_what_it_leads_to(target, tmp_path):
    results(tmp_path / "elsewhere", "old")
    (tmp_path / "out").symlink_to(target)
    with pytest.raises(ParameterError, match=rf"is a link to {tmp_path / target}, expected a folder"):
        prepare(tmp_path / "out")
    assert (tmp_path / "out").is_symlink() and text_of(tmp_path / "elsewhere") == "old"


@pytest.mark.parametrize("put", FOREIGN)
def test_what_is_put_there_during_the_run_is_kept_beside_the_new_results(put, tmp_path, caplog):
    out = everything(tmp_path / "out")
    folder = prepare(out)
    (folder.path / MARK).write_text("new")
    name = put(out)
    before = contents(out)
    assert folder.commit() == out
    assert contents(out) == {MARK: b"new"}
    assert contents(tmp_path / "out.old") == before, "the whole older folder: a note may be about what lies beside it"
    (said,) = caplog.messages
    assert said == (
        f"--out: {out} had something that shipgrid did not write when the run ended ({name}); "
        f"they are kept in {tmp_path / 'out.old'}"
    )


def test_a_second_folder_that_is_kept_takes_another_name(tmp_path):
    out = results(tmp_path / "out", "old")
    for k in range(3):
        folder = prepare(out)
        (folder.path / MARK).write_text(f"{MARK_BEGINS} {k}")
        (out / "note.txt").write_text(str(k))
        folder.commit()
    assert names(tmp_path) == ["out", "out.old", "out.old-2", "out.old-3"]
    assert (tmp_path / "out.old-3" / "note.txt").read_text() == "2"


def test_what_is_put_there_while_it_is_removed_stays(tmp_path, monkeypatch, caplog):
    """Somebody has the folder open and saves into it between the look and the removal."""
    out = results(tmp_path / "out", "old")
    folder = prepare(out)
    (folder.path / MARK).write_text("new")
    real = output_folder.foreign

    def looked(path):
        names = real(path)
        (path / "saved.txt").write_text("in the last moment")
        monkeypatch.setattr(output_folder, "foreign", real)
        return names

    monkeypatch.setattr(output_folder, "foreign", looked)
    folder.commit()
    assert contents(out) == {MARK: b"new"}
    assert contents(tmp_path / "out.old") == {"saved.txt": b"in the last moment"}
    assert "(saved.txt); they are kept in" in caplog.text


def test_older_results_that_cannot_be_removed_are_kept_under_a_name_that_people_see(tmp_path, monkeypatch, caplog):
    """Of another user, say, or opened by a program on a system that keeps what is open."""
    out = results(tmp_path / "out", "old")
    folder = prepare(out)
    (folder.path / MARK).write_text("new")

    def refuse(path):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(output_folder.os, "unlink", refuse)
        folder.commit()
    assert contents(out) == {MARK: b"new"} and text_of(tmp_path / "out.old") == "old"
    assert f"which could not be removed; they are kept in {tmp_path / 'out.old'}" in caplog.text


def test_results_that_a_disk_will_not_take_leave_the_older_ones_in_their_place(tmp_path, monkeypatch):
    out = results(tmp_path / "out", "old")
    folder = prepare(out)
    (folder.path / MARK).write_text("new")
    real = Path.rename

    def rename(self, target):
        if self == folder.path:
            raise OSError(5, "Input/output error")
        return real(self, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(
        ParameterError, match=rf"cannot be replaced \(Input/output error\); the results are in {folder.path}"
    ):
        folder.commit()
    assert text_of(out) == "old" and (folder.path / MARK).read_text() == "new"
    assert names(tmp_path) == sorted(["out", folder.path.name])


@pytest.mark.parametrize("meanwhile", [False, True])
def test_a_kill_between_the_two_renames_leaves_both_and_the_next_attempt_tidies_up(meanwhile, tmp_path, monkeypatch):
    out = results(tmp_path / "out", "old")
    folder = prepare(out)
    (folder.path / MARK).write_text(f"{MARK_BEGINS} new")
    real = Path.rename

    def rename(self, target):
        if self == folder.path:
            raise KeyboardInterrupt  # nothing in the program handles it here
        return real(self, target)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Path, "rename", rename)
        folder.commit()
    assert names(tmp_path) == sorted([folder.path.name, f"{folder.path.name}.old"])
    if meanwhile:
        results(out, "of another run")
    again = taken_over(folder.path, out)
    assert again is not None and again.commit() == out
    assert names(tmp_path) == ["out"] and text_of(out) == "new"


def test_what_a_run_is_continued_from_is_removed_but_for_what_a_person_put_there(tmp_path, caplog):
    out = everything(tmp_path / "out")
    finish(out)
    assert not (out / "unfinished").exists() and not caplog.messages
    (out / "unfinished").mkdir()
    for name in BEGUN:
        (out / "unfinished" / name).write_text("old")
    (out / "unfinished" / "notes.txt").write_text("mine")
    finish(out)
    assert names(out / "unfinished") == ["notes.txt"]
    assert f"{out / 'unfinished'} stays: it has something that shipgrid did not write" in caplog.text


def test_what_a_person_put_into_a_hidden_folder_is_not_thrown_away(tmp_path, caplog):
    folder = prepare(tmp_path / "out")
    (folder.path / "notes.txt").write_text("mine")
    folder.discard()
    assert (folder.path / "notes.txt").exists() and f"{folder.path} stays" in caplog.text


def test_a_folder_that_somebody_else_begins_to_use_does_not_hide_why_there_is_no_room(tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")

    def full(folder):
        (tmp_path / "a" / "other").mkdir()
        return usage(10**9, 10**9, 4096)

    monkeypatch.setattr(shutil, "disk_usage", full)
    with pytest.raises(ParameterError, match="has 4 kB free"):
        prepare(tmp_path / "a" / "b", bytes_needed=250_000_000)
    assert names(tmp_path / "a") == ["other"]
