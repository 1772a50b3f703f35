"""A program that starts runs and kills them: `python killed_runs.py FOLDER SEED COUNT`, for `test_resume.py`.

Each is a process of its own, killed by the system's signal 9 at an instant drawn from its whole life: while it steps,
writes a snapshot, makes its results or puts them in their place. Every second one is killed again while it goes on,
if it is not done before.
"""

from __future__ import annotations

import math
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import shipgrid as sg
from shipgrid.io.scenario_file import read_case
from shipgrid.io.ship_file import open_document
from shipgrid.io.yaml_lines import read_text
from shipgrid.scenarios import resume, session
from shipgrid.scenarios import simulate as simulation
from shipgrid.scenarios.output_folder import SNAPSHOT, UNFINISHED, unfinished

SCENARIO = """\
schema: 1
scenario: leaving
description: two batteries in voltage mode cannot be on one bus, so that the second waits until the tie is open
duration: 1.5 s
step: 70 us
start: {state: moored, closed: [dc_tie]}
timeline:
  - {at: 0.1 s, set: {propulsion_for.speed_ref: 6 kn, propulsion_aft.speed_ref: 6 kn}}
  - {at: 0.2 s, set: {bess_for.mode: voltage}}
  - {at: 0.3 s, set: {bess_aft.mode: voltage}}
  - {at: 0.6 s, set: {dc_tie.close: false}}
requirements:
  - {name: DC bus, signal: dc_for.v_dc, band: [700 V, 800 V]}
"""
WINDOWS = [(0.0, 0.05), (0.58, 0.68)]


def case(**changes: str) -> tuple[Any, Any]:
    """The ferry and the short scenario."""
    document = read_text(changes.pop("scenario", SCENARIO), "leaving.yaml")
    return read_case(open_document("ship", "ferry"), document, list(changes.items()))


def simulate(out: Path, *, made_of: tuple[Any, Any] | None = None, **options: Any) -> sg.Results:
    """Run it; its results are closed, since the library fails where a file is opened twice."""
    results = sg.simulate(*(made_of or case()), out=out, **{"report": False, "waveforms": WINDOWS, **options})
    with results:
        assert results.events is not None  # read before it is closed
    return results


def hurry() -> None:
    """Look about between chunks, and write snapshots, every few milliseconds."""
    resume.SNAPSHOT_S, session.WALL_PER_CHUNK = 0.02, 0.005


def started() -> Callable[..., Any]:
    """What finds the start, with what it finds: it is the same for every run here."""
    ship, scenario = case()
    work, drift = simulation.start(simulation.build(ship, scenario.step), ship, scenario)
    return lambda *_: (work.snapshot(), drift)


def life(out: Path, after: float = math.inf, *, resume: bool = False) -> float:
    """Let a run live in a process of its own, at most some time after its first snapshot.

    Returns the time [s] that it lived from then on; `inf` if it was killed.
    """
    before = snapshots(out)
    child = os.fork()
    if child == 0:
        try:
            simulate(out, resume=resume)
        finally:
            os._exit(0)
    done, began = 0, math.inf
    while not done and time.perf_counter() - began < after:
        if began == math.inf and snapshots(out) - before:
            began = time.perf_counter()
        time.sleep(5e-4)
        done, _ = os.waitpid(child, os.WNOHANG)
    if not done:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    return time.perf_counter() - began if done else math.inf


def snapshots(out: Path) -> set[tuple[Path, int]]:
    """Snapshots of runs for a place, with the time of each; none while somebody moves them about."""
    try:
        return {(path, (path / UNFINISHED / SNAPSHOT).stat().st_mtime_ns) for path in unfinished(out)}
    except FileNotFoundError:
        return set()


if __name__ == "__main__":
    folder, seed, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    hurry()
    simulation.start = started()
    whole = min(life(folder / "whole") for _ in range(2))
    instants = random.Random(seed)
    for k in range(count):
        out, after = folder / f"run-{k}", instants.uniform(0.0, whole)
        while life(out, after) < math.inf or not unfinished(out):  # it was faster than that
            after *= 0.8
        if k % 2 and unfinished(out):
            life(out, instants.uniform(0.0, 0.5 * whole), resume=True)
