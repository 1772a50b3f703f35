"""Snapshots of a run under way, and how a run that was interrupted or killed is continued."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.errors import InputErrors
from shipgrid.scenarios import snapshot
from shipgrid.scenarios.conclude import limiter_rows
from shipgrid.scenarios.output_folder import (
    COMMANDS,
    MARK,
    SNAPSHOT,
    SUMMARY,
    UNFINISHED,
    OutputFolder,
    check_room,
    copy_rows,
    prepare,
    taken_over,
    unfinished,
    write_text,
)
from shipgrid.scenarios.outside import Outside, as_lines, read_outside
from shipgrid.scenarios.row_log import RowLog, bytes_needed
from shipgrid.scenarios.session import Run
from shipgrid.scenarios.timeline import Timeline
from shipgrid.scenarios.waveforms import Window

SNAPSHOT_S = 10.0
"""Wall-clock time [s] between two snapshots of a run under way: what is lost when it is killed."""


@dataclass
class SnapshotWriter:
    """Writes the snapshots of a run under way.

    Parameters
    ----------
    path : Path
        Of the snapshot.
    log : RowLog
        Where the run's rows go.
    due : Timeline
        It remembers what those who command the plant do.
    about : dict
        What does not change during the run.
    """

    path: Path
    log: RowLog
    due: Timeline
    about: dict[str, Any]
    written: float = 0.0

    def look(self, run: Run) -> None:
        """Write a snapshot if it is time to; the buffers of the workspace are empty."""
        if time.monotonic() - self.written >= SNAPSHOT_S:
            self.write(run)

    def write(self, run: Run) -> None:
        """Put the rows on the disk, then the snapshot that goes with them."""
        self.put(run.work, self.logged(run), self.log.sync())

    def logged(self, run: Run) -> dict[str, Any]:
        """A copy of what the run and those who command it remember besides the workspace."""
        events = sorted(run.events, key=lambda event: event[0])  # of a live run they come as they are looked for
        return {"events": events, "limiters": limiter_rows(run), "wall_s": run.wall_s} | self.due.remembered()

    def put(self, work: Workspace, logged: dict[str, Any], rows: dict[str, int]) -> None:
        """Write a snapshot whose rows are on the disk."""
        snapshot.write(self.path, work, self.about | logged | {"rows": rows})
        self.written = time.monotonic()


def unfinished_run(
    place: Path, plan: Plan, whole: Mapping[str, Any], end: float, windows: Sequence[Window]
) -> tuple[OutputFolder, dict[str, Any], dict[str, np.ndarray]]:
    """The run of a plan that got furthest towards a place: a folder to write it on in, and what its snapshot has."""
    fitting, problems = [], []
    for path in unfinished(place):
        try:
            saved, arrays = snapshot.read(path / UNFINISHED / SNAPSHOT)
        except InputErrors as wrong:
            problems += wrong.problems
            continue
        differing = snapshot.differences(saved["identity"], whole)
        if differing:
            problems += [f"--resume: the unfinished run in {path} is another one:", *(f"  {d}" for d in differing)]
        elif saved["n"] > round(end / plan.h):
            at = f"{saved['n'] * plan.h:g} s"
            problems.append(f"--resume: the unfinished run in {path} is at {at} already, expected a later end")
        else:
            fitting.append((saved, path, arrays))
    if not fitting:
        beside = f"{place.parent}/.{place.name}-*"
        state = f"{place} has a finished run" if (place / MARK).is_file() else f"there is no {place}"
        problems = problems or [
            f"--resume: nothing to continue: {state}, and no unfinished one lies beside it ({beside})"
        ]
        raise InputErrors(problems)
    saved, path, arrays = max(fitting, key=lambda found: found[0]["n"])
    saved["from"] = path
    needed = bytes_needed(plan, end - saved["n"] * plan.h, windows)
    if path == Path(os.path.abspath(place)):  # interrupted, and put there: it stays until there is more
        folder = prepare(place, needed)
        try:
            copy_rows(path, folder)
        except BaseException:
            folder.discard()
            raise
        return folder, saved, arrays
    check_room(place, needed)
    folder = taken_over(path, place)
    if folder is None:
        raise InputErrors([f"--resume: the unfinished run in {path} is being run by another process"])
    (path / SUMMARY).unlink(missing_ok=True)  # of an end that was not reached
    return folder, saved, arrays


def logged_commands(folder: OutputFolder, ship: Any, forget: int | None) -> list[Outside]:
    """What an unfinished live run was given while it ran; commands from step `forget` on are dropped for ever.

    Those that came after its snapshot are repeated offline. Live, whoever gave them meets the plant as it was before
    them, and will give his own.
    """
    path = folder.unfinished / COMMANDS
    if not path.is_file():
        return []
    found = read_outside(path, ship.commands, torn=True)
    found = [command for command in found if forget is None or command.step < forget]
    write_text(path, as_lines(found))
    return found
