"""The folder a run writes: made under another name beside its place, and put there by rename when it is complete.

So a folder of results is never half-written, a failed disk or a read-only place is found before the run, and what is
replaced is only ever an older folder of results.

What a run needs to be continued lies in its sub-folder `unfinished` as long as there is something to continue: in the
folder that is being written, or in its place after an interrupt.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from shipgrid.errors import ParameterError

try:
    import fcntl
except ImportError:  # not a POSIX system: that a folder is being written is not seen there
    fcntl = None

MARK = "run.yaml"
"""File by which a folder is known to hold the results of a run."""
UNFINISHED, SNAPSHOT = "unfinished", "snapshot.npz"
"""Sub-folder with what a run is continued from, and the file in it that is written whole, when the rest is there."""


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

        Raises
        ------
        ParameterError
            If it cannot be put there; the results then stay in `path`, and an older folder stays as it was.
        """
        older = self.path.with_name(self.path.name + ".old")
        try:
            if self.place.exists():
                _check_replaceable(self.place)
                self.place.rename(older)
            try:
                self.path.rename(self.place)
            except OSError:
                if older.exists():
                    older.rename(self.place)
                raise
        except OSError as wrong:
            what = f"--out: {self.place} cannot be replaced ({wrong.strerror}); the results are in {self.path}"
            raise ParameterError(what) from wrong
        shutil.rmtree(older, ignore_errors=True)
        self.release()
        return self.place

    def discard(self) -> None:
        """Throw away what was written; an older folder in its place is untouched."""
        shutil.rmtree(self.path, ignore_errors=True)
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
        If nothing can be written there, the disk has not the room, or something else than results is there.
    """
    place = Path(os.path.abspath(out))
    _check_replaceable(place)
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
        temporary.rmdir()
        for folder in made:
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
    """The place of a folder of results: its own, or the one it was being written for."""
    path = Path(os.path.abspath(path))
    hidden = re.fullmatch(r"\.(.+)-[a-z0-9_]{8}", path.name)
    return path.with_name(hidden[1]) if hidden and (path / UNFINISHED).is_dir() else path


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
    shutil.rmtree(final / UNFINISHED, ignore_errors=True)


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


def _check_replaceable(place: Path) -> None:
    if place.is_dir():
        if any(place.iterdir()) and not (place / MARK).is_file():
            raise ParameterError(
                f"--out: {place} holds something else than results (no {MARK}), expected a new folder or one of results"
            )
    elif place.exists() or place.is_symlink():
        raise ParameterError(f"--out: {place} is a file, expected a folder")


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
