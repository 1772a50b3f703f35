"""The folder a run writes: made under another name beside its place, and put there by rename when it is complete.

So a folder of results is never half-written, a failed disk or a read-only place is found before the run, and what is
replaced is only ever an older folder of results.
"""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from shipgrid.errors import ParameterError

MARK = "run.yaml"
"""File by which a folder is known to hold the results of a run."""


@dataclass(frozen=True)
class OutputFolder:
    """A folder being written.

    Attributes
    ----------
    place : Path
        Where it will stand.
    path : Path
        Where it is written until `commit`.
    """

    place: Path
    path: Path

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
        return self.place

    def discard(self) -> None:
        """Throw away what was written; an older folder in its place is untouched."""
        shutil.rmtree(self.path, ignore_errors=True)


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
    free = shutil.disk_usage(temporary).free
    if free < bytes_needed:
        temporary.rmdir()
        for folder in made:
            folder.rmdir()
        what = f"--out: {place} has {_size(free)} free, expected at least {_size(bytes_needed)} for this run"
        raise ParameterError(what)
    return OutputFolder(place, temporary)


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
