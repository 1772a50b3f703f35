"""The folder a run writes: made under another name beside its place, and put there by rename when it is complete.

So a folder of results is never half-written, and a failed disk or a read-only place is noticed before the run. What is
replaced is only ever an older folder of results, and only one with nothing in it that shipgrid does not write: this
module has the list of all that it does. What a person has put there stays.

What a run needs to be continued lies in its sub-folder `unfinished` as long as there is something to continue: in the
folder that is being written, or in its place after an interrupt.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from shipgrid.errors import ParameterError

try:
    import fcntl
except ImportError:  # not a POSIX system: that a folder is being written is not seen there
    fcntl = None

MARK = "run.yaml"
"""File by which a folder is known to hold the results of a run."""
MARK_BEGINS = "# Written by shipgrid:"
"""How that file begins."""
RESULTS, SUMMARY, REALTIME, REPORT = "results.nc", "summary.json", "realtime.json", "report.html"
COMMANDS, REGISTERS = "commands.csv", "registers.csv"
"""Files of a folder of results; the last two in those of live runs."""
UNFINISHED, SNAPSHOT, COLUMNS = "unfinished", "snapshot.npz", "columns.json"
"""Sub-folder with what a run is continued from; the file in it that is written whole, when the rest is there; and the
file that says what the rows are."""
ROWS = ".rows"
"""Ending of the files of rows."""

_WHOLE = re.compile("|".join(map(re.escape, (MARK, RESULTS, SUMMARY, REALTIME, REPORT, COMMANDS, REGISTERS))))
_BEGUN = re.compile("|".join(map(re.escape, (SNAPSHOT, COLUMNS, COMMANDS, RESULTS))) + rf"|[a-z]+(-[0-9]+)?{ROWS}")
"""Names of all files that shipgrid writes into a folder of results, and into its sub-folder."""
_PART = re.compile(r"\.?(.+)\.part")
"""A file that is being written, and left behind where the process was killed."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class OutputFolder:
    """A folder being written.

    Attributes
    ----------
    place : Path
        Where it will stand.
    path : Path
        Where it is written until `commit`.
    lock : int
        Open descriptor by which other processes see that it is being written; -1 where the system has no such.
    """

    place: Path
    path: Path
    lock: int = -1

    @property
    def unfinished(self) -> Path:
        """Where what is needed to continue the run lies while it is written."""
        return self.path / UNFINISHED

    def commit(self) -> Path:
        """Put the folder in its place, in place of an older one, and return the place.

        An older folder of results in which somebody has put something during the run is kept beside the place; a
        warning with its new name is logged.

        Raises
        ------
        ParameterError
            If it cannot be put there; the results then stay in `path`, and what is in the place stays as it is.
        """
        older, moved = self.path.with_name(f"{self.path.name}.old"), False
        try:
            if os.path.lexists(self.place):
                obstacle = obstacle_at(self.place, foreign_too=False)
                if obstacle:
                    raise ParameterError(
                        f"--out: {self.place} {obstacle}; the results are in {self.path}, and --resume puts them there "
                        "when that has been moved away"
                    )
                remove(older)  # of an attempt that was killed between the two renames
                older = _free(older)
                self.place.rename(older)
                moved = True
            try:
                self.path.rename(self.place)
            except OSError:
                if moved:
                    older.rename(self.place)
                raise
        except OSError as wrong:
            what = f"--out: {self.place} cannot be replaced ({wrong.strerror}); the results are in {self.path}"
            raise ParameterError(what) from wrong
        finally:
            self.release()
        if os.path.lexists(older) and not remove(older):
            self._keep(older)
        return self.place

    def _keep(self, older: Path) -> None:
        """Give a folder that is not removed a name that people see, and say which."""
        names: list[str] = []
        with contextlib.suppress(OSError):
            older = older.rename(_free(self.place.with_name(f"{self.place.name}.old")))
            names = foreign(older)
        what = f"had something that shipgrid did not write when the run ended ({', '.join(names)})"
        why = what if names else "had older results, which could not be removed"
        _LOG.warning("--out: %s %s; they are kept in %s", self.place, why, older)

    def discard(self) -> None:
        """Throw away what was written; an older folder in its place is untouched."""
        if not remove(self.path):
            _LOG.warning("%s stays: it has something that shipgrid did not write", self.path)
        self.release()

    def release(self) -> None:
        """Leave it as it is to whoever continues it."""
        if self.lock >= 0:
            os.close(self.lock)


def prepare(out: str | Path, bytes_needed: int = 0) -> OutputFolder:
    """Make ready to write a folder of results, before the run.

    Parameters
    ----------
    out : str or Path
        Where it shall stand; folders above it are made.
    bytes_needed : int
        What will be written, at most.

    Returns
    -------
    OutputFolder
        With an empty `path` beside the place.

    Raises
    ------
    ParameterError
        If nothing can be written there, the disk has not the room, or something is there that shipgrid did not write.
    """
    place = Path(os.path.abspath(out))
    obstacle = obstacle_at(place)
    if obstacle:
        raise ParameterError(f"--out: {place} {obstacle}")
    made = [folder for folder in (place.parent, *place.parent.parents) if not folder.exists()]
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{place.name}-", dir=place.parent))
        # mkdtemp makes folders for one user only; results are for whoever may read the folder above.
        temporary.chmod(0o777 & ~_umask())
    except OSError as wrong:
        raise ParameterError(f"--out: {place} cannot be written: {_reason(wrong)}, expected another folder") from wrong
    try:
        check_room(place, bytes_needed)
    except ParameterError:
        with contextlib.suppress(OSError):  # somebody else has begun to use a folder above it
            for folder in (temporary, *made):
                folder.rmdir()
        raise
    lock = _locked(temporary)
    return OutputFolder(place, temporary, -1 if lock is None else lock)


def check_room(place: Path, bytes_needed: int) -> None:
    """Refuse to write where there is too little room.

    Parameters
    ----------
    place : Path
        A folder or one that will be made.
    bytes_needed : int
        What will be written, at most.

    Raises
    ------
    ParameterError
        If the disk has not the room.
    """
    free = shutil.disk_usage(place.parent).free
    if free < bytes_needed:
        what = f"--out: {place} has {_size(free)} free, expected at least {_size(bytes_needed)} for this run"
        raise ParameterError(what)


def unfinished(out: str | Path) -> list[Path]:
    """Folders of runs for a place that can be continued: in the place, and beside it where no run got that far.

    Parameters
    ----------
    out : str or Path
        The place.
    """
    place = Path(os.path.abspath(out))
    own = re.compile(re.escape(f".{place.name}-") + "[a-z0-9_]{8}")
    beside = place.parent.iterdir() if place.parent.is_dir() else ()
    found = [place, *sorted(path for path in beside if own.fullmatch(path.name))]
    return [path for path in found if (path / UNFINISHED / SNAPSHOT).is_file()]


def place_of(path: Path) -> Path:
    """The place of a folder of results: its own, or the one it is written for, or was before it got there."""
    path = Path(os.path.abspath(path))
    hidden = re.fullmatch(r"\.(.+)-[a-z0-9_]{8}", path.name)
    return path.with_name(hidden[1]) if hidden and ((path / UNFINISHED).is_dir() or not path.exists()) else path


def taken_over(path: Path, place: Path) -> OutputFolder | None:
    """An unfinished folder beside its place, to be written on; None while another process writes it.

    Parameters
    ----------
    path : Path
        The folder, one of `unfinished`.
    place : Path
        Where it shall stand.
    """
    lock = _locked(path)
    return None if lock is None else OutputFolder(Path(os.path.abspath(place)), path, lock)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole, in place of an older one; on the disk when this returns."""
    part = path.with_name(path.name + ".part")
    part.write_text(text)
    sync_file(part)
    os.replace(part, path)


def sync_file(path: Path) -> None:
    """Put the contents of a file on the disk."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Put the names in a folder on the disk, where the system has a way to."""
    if os.name == "posix":
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def finish(final: Path) -> None:
    """Remove what a run in its place would be continued from: it is done, and on the disk."""
    sync_folder(final.parent)
    (final / UNFINISHED / SNAPSHOT).unlink(missing_ok=True)  # first: without it nobody takes the rest for a run
    if not _remove_files(final / UNFINISHED):
        _LOG.warning("%s stays: it has something that shipgrid did not write", final / UNFINISHED)


def copy_rows(path: Path, to: OutputFolder) -> None:
    """Copy what an unfinished run is continued from, but for its snapshot, into a folder being written.

    Parameters
    ----------
    path : Path
        The folder of that run.
    to : OutputFolder
        Where it is continued.

    Raises
    ------
    OSError
        If there is no room.
    """
    to.unfinished.mkdir()
    for entry in _scanned(path / UNFINISHED):
        if _ours(entry, _BEGUN) and entry.name != SNAPSHOT:
            shutil.copy2(entry.path, to.unfinished / entry.name)


def is_results(folder: Path) -> bool:
    """Whether a folder is one of results: its `run.yaml` is a file that shipgrid has written."""
    mark = folder / MARK
    try:
        with mark.open("rb") as file:
            return not mark.is_symlink() and file.read(len(MARK_BEGINS)) == MARK_BEGINS.encode()
    except OSError:
        return False


def foreign(folder: Path) -> list[str]:
    """What lies in a folder of results and was not written by shipgrid, by its path in the folder.

    Links are, and folders, whatever their names.

    Parameters
    ----------
    folder : Path

    Raises
    ------
    OSError
        If it cannot be read.
    """
    names = []
    for entry in _scanned(folder):
        if entry.name == UNFINISHED and entry.is_dir(follow_symlinks=False):
            inside = _scanned(folder / UNFINISHED)
            names += [f"{UNFINISHED}/{begun.name}" for begun in inside if not _ours(begun, _BEGUN)]
        elif not _ours(entry, _WHOLE):
            names.append(entry.name)
    return names


def remove(folder: Path) -> bool:
    """Remove a folder of results if all that is in it is shipgrid's own; whether it is gone.

    What is put there while it is being removed stays, and the folder with it.

    Parameters
    ----------
    folder : Path
    """
    try:
        return not foreign(folder) and _remove_files(folder / UNFINISHED) and _remove_files(folder)
    except OSError:
        return False


def obstacle_at(place: Path, *, foreign_too: bool = True) -> str:
    """Why results cannot be put in a place, and what is expected; nothing if they can.

    Parameters
    ----------
    place : Path
    foreign_too : bool
        Whether a folder of results with something foreign in it is refused.
    """
    if place.is_symlink():
        return f"is a link to {os.path.realpath(place)}, expected a folder; that one may be named itself"
    if not place.exists():
        return ""
    if not place.is_dir():
        return "is a file, expected a folder"
    expected = "expected a new folder or one of results"
    try:
        if not any(place.iterdir()):
            return ""
        if not is_results(place):
            why = f"its {MARK} was not written by shipgrid" if os.path.lexists(place / MARK) else f"no {MARK}"
            return f"holds something else than results ({why}), {expected}"
        names = foreign(place) if foreign_too else []
    except OSError as wrong:
        return f"cannot be read: {_reason(wrong)}, {expected}"
    if not names:
        return ""
    others = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return (
        f"holds {names[0]!r}{others}, which shipgrid did not write and would have to remove; expected it to be moved "
        "elsewhere, or another folder"
    )


def _scanned(folder: Path) -> list[os.DirEntry[str]]:
    with os.scandir(folder) as entries:
        return sorted(entries, key=lambda entry: entry.name)


def _ours(entry: os.DirEntry[str], names: re.Pattern[str]) -> bool:
    """Whether an entry of a folder is a file that shipgrid writes, or a part of one."""
    part = _PART.fullmatch(entry.name)
    return entry.is_file(follow_symlinks=False) and bool(names.fullmatch(part[1] if part else entry.name))


def _remove_files(folder: Path) -> bool:
    """Remove the files that shipgrid writes, and the folder if nothing else is in it; whether it is gone."""
    if not os.path.lexists(folder):
        return True
    names = _BEGUN if folder.name == UNFINISHED else _WHOLE
    try:
        for entry in _scanned(folder):
            if _ours(entry, names):
                os.unlink(entry.path)
        folder.rmdir()
    except OSError:
        return False
    return True


def _free(path: Path) -> Path:
    """A name that nothing has: this one, or with a number behind it."""
    return next(free for free in _numbered(path) if not os.path.lexists(free))


def _numbered(path: Path) -> Iterator[Path]:
    yield path
    yield from (path.with_name(f"{path.name}-{k}") for k in count(2))


def _locked(folder: Path) -> int | None:
    """A descriptor that holds a folder as long as this process lives; None if another process holds it."""
    if fcntl is None:
        return -1
    number = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(number)
        return None
    except OSError:  # a file system without locks
        pass
    return number


def _reason(wrong: OSError) -> str:
    reasons = {
        errno.EROFS: "the disk is read-only",
        errno.EACCES: "no permission",
        errno.EPERM: "no permission",
        errno.ENOSPC: "the disk is full",
        errno.ENOTDIR: "a file is in the way",
        errno.EEXIST: "a file is in the way",
    }
    return reasons.get(wrong.errno or 0, str(wrong.strerror))


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _size(count: int) -> str:
    value = float(count)
    for unit in ("B", "kB", "MB"):
        if value < 1000.0:
            return f"{value:.0f} {unit}"
        value /= 1000.0
    return f"{value:.1f} GB"
