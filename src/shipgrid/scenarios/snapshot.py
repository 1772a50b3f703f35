"""Everything of a run that moves, in one file: written whole or not at all, and only taken back by the same plan.

The file is an uncompressed `.npz`: the arrays of the workspace, and a text (JSON) with the step number, what the run
has logged, and what it was made of. Nothing in it is executed when it is read. A run continued from it gives the same
bits as one that was never interrupted, so it is refused to another plan, with what differs.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import importlib
import inspect
import json
import os
import platform
import zipfile
from collections.abc import Collection, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
import numpy as np

import shipgrid
from shipgrid.assembly.code_store import code_names
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace, new_workspace
from shipgrid.errors import InputErrors
from shipgrid.scenarios.output_folder import sync_folder

SCHEMA = 2
HEAD = "about"
EMPTIED = ("plant_rows", "slow_rows", "wave_rows", "event_step", "event_which", "event_value")
"""Arrays of a workspace that are emptied before it looks at the clock: what they hold is not read again."""
LOOP = "shipgrid.scenarios.simulate"
ACTING = ("shipgrid.scenarios.", "shipgrid.automation.")
"""The module that steps a run, and the packages whose modules act between its steps, as far as it reaches them."""
MOST_LINES = 12
"""Differences that are said one by one."""


def identity(plan: Plan) -> dict[str, Any]:
    """What a run of a plan depends on: versions, code, numbers, and every element with its parameters and connections.

    What made the plan enters by what it made of it: an edit there that changes no number changes no run. What acts
    between the steps enters with its source.

    Parameters
    ----------
    plan : Plan
    """
    network = plan.network
    elements = {
        path: {f.name: repr(getattr(placed.item, f.name)) for f in dataclasses.fields(placed.item)}
        | {f.name: repr(getattr(placed, f.name)) for f in dataclasses.fields(placed) if f.name not in ("path", "item")}
        for path, placed in network.placed.items()
    }
    return {
        "step": f"{plan.h!r} s",
        "fidelity": network.fidelity,
        "program": {
            "shipgrid": shipgrid.__version__,
            "Python": platform.python_version(),
            "numba": numba.__version__,
            "numpy": np.__version__,
            "processor": llvmlite.binding.get_host_cpu_name(),
        },
        "code": dict(name.rsplit("_", 1) for name in code_names(plan.kinds)),
        "sources": _sources(),
        "elements": elements,
        **({"parts": {k: ", ".join(v) for k, v in plan.partition.buses.items()}} if plan.partition else {}),
        "numbers": {
            f"{of}{name}": hashlib.sha256(np.asarray(value).tobytes()).hexdigest()[:16]
            for of, piece in [("", plan), *((f"{part.network.name}: ", part) for part in plan.parts)]
            for part in (piece.net._asdict(), piece.step._asdict(), _beside(piece))
            for name, value in part.items()
        },
    }  # fmt: skip


def differences(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between the plan of a snapshot and this one, a line each; empty if nothing does.

    Parameters
    ----------
    was, now : mapping
        `identity`, with the texts of `ship` and `scenario` where there are such files.
    """
    found: list[str] = []
    for file in ("ship", "scenario"):
        if file in was or file in now:
            found += _lines(file, str(was.get(file, "")), str(now.get(file, "")))
    told = ("ship", "scenario", "elements", "numbers", "sources", "code")
    flat_was, flat_now = (_flat({k: v for k, v in made.items() if k not in told}) for made in (was, now))
    for key in dict.fromkeys([*flat_was, *flat_now]):
        if flat_was.get(key) != flat_now.get(key):
            found.append(f"{key}: {_said(flat_was.get(key))} in the snapshot, {_said(flat_now.get(key))} now")
    before, after = was.get("sources", {}), now.get("sources", {})
    changed = [name for name in dict.fromkeys([*before, *after]) if before.get(name) != after.get(name)]
    found += [f"{name}: this source file of the program has been changed" for name in changed]
    before, after = was.get("code", {}), now.get("code", {})
    changed = [name for name in after if name in before and before[name] != after[name]]
    found += [f"{name}: its code has been changed" for name in changed]
    if not found:  # else it follows from that
        flat_was, flat_now = (_flat(made.get("elements", {})) for made in (was, now))
        for key in dict.fromkeys([*flat_was, *flat_now]):
            if flat_was.get(key) != flat_now.get(key):
                found.append(f"{key}: {_said(flat_was.get(key))} in the snapshot, {_said(flat_now.get(key))} now")
    if not found:
        other = [name for name, digest in now.get("numbers", {}).items() if was.get("numbers", {}).get(name) != digest]
        found += [f"{name} of the plan differs" for name in other]
    if len(found) > MOST_LINES:
        found[MOST_LINES:] = [f"and {len(found) - MOST_LINES} more"]
    return found


def write(path: Path, work: Workspace, about: Mapping[str, Any], without: Collection[str] = ()) -> None:
    """Write a snapshot: on the disk when this returns, and an older one stays until then.

    Parameters
    ----------
    path : Path
        Where it shall be.
    work : Workspace
        Its buffers of rows and events must be empty.
    about : mapping
        What shall be kept beside it: numbers, texts, lists and mappings of such.
    without : collection of str
        Arrays of the workspace's `step` that are left out, and new when it is restored.

    Raises
    ------
    OSError
        If it cannot be written; an older one is untouched.
    """
    part = path.with_name(path.name + ".part")
    text = json.dumps({"schema": SCHEMA, **about, "n": work.n})
    arrays = {name: array for name, array in _arrays(work).items() if name.removeprefix("step.") not in without}
    with part.open("wb") as file:
        np.savez(file, allow_pickle=False, **{HEAD: np.frombuffer(text.encode(), np.uint8)} | arrays)
        file.flush()
        os.fsync(file.fileno())
    os.replace(part, path)
    sync_folder(path.parent)


def read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What was kept beside a snapshot, and its arrays.

    Raises
    ------
    InputErrors
        If there is none, or it is damaged or of another program.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(arrays.pop(HEAD).tobytes())
    except FileNotFoundError:
        raise InputErrors([f"{path}: there is no snapshot"]) from None
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as wrong:
        raise InputErrors([f"{path}: is damaged or no snapshot ({wrong})"]) from wrong
    if about.get("schema") != SCHEMA:
        raise InputErrors([f"{path}: is a snapshot of schema {about.get('schema')}, expected {SCHEMA}"])
    return about, arrays


def copied(work: Workspace) -> Workspace:
    """A copy of what a snapshot has of a workspace, its buffers taken for empty: some ten microseconds.

    Parameters
    ----------
    work : Workspace
        Of a run that goes on.
    """
    kept = {name: value.copy() for name, value in work.step._asdict().items() if name not in EMPTIED}
    kept["rows"][:], kept["event_count"][:], kept["wave_row"][:] = 0, 0, -1
    net = work.net._replace(**{name: value.copy() for name, value in work.net._asdict().items()})
    parts = tuple(copied(part) for part in work.parts)
    return Workspace(work.plan, work.n, work.sig.copy(), net, work.step._replace(**kept), work.pace, parts)


def take_back(work: Workspace, state: Workspace) -> None:
    """Let a workspace be as another one of its plan is, in its own memory; its buffers are empty then.

    Parameters
    ----------
    work : Workspace
        Changed in place.
    state : Workspace
        Of `copied`, say.
    """
    work.n = state.n
    theirs = _arrays(state)
    for name, array in _arrays(work).items():
        array[...] = theirs[name]


def restore(plan: Plan, n: int, arrays: Mapping[str, np.ndarray]) -> Workspace:
    """A workspace of a plan, with the contents of a snapshot of that plan."""
    work = new_workspace(plan)
    work.n = n
    own = _arrays(work)
    for name, array in arrays.items():
        own[name][...] = array
    return work


def _arrays(work: Workspace) -> dict[str, np.ndarray]:
    """Every array of a workspace that is read again, by name."""
    found = {"sig": work.sig}
    for k, piece in enumerate((work, *work.parts)):
        of = f"part_{k}." if k else ""
        found |= {f"{of}net.{name}": value for name, value in piece.net._asdict().items()}
        found |= {f"{of}step.{name}": value for name, value in piece.step._asdict().items() if name not in EMPTIED}
    return found


def _beside(plan: Plan) -> dict[str, np.ndarray]:
    """What a plan has of each component type, and of its signals, beside the fields of `net` and `step`."""
    found = {"commands": plan.layout.initial, "periods": plan.periods}
    for t in plan.layout.types:
        found[f"parameters of {t.kind.key}"] = t.parameters
        found[f"clocks of {t.kind.key}"] = plan.clock_of[t.kind.key]
    found |= {
        f"connections of {key}: {name}": places
        for key, gather in plan.gathers.items()
        for name, places in gather.items()
    }
    calls = [(call.type, call.operation, call.condition) for walk in plan.schedule.walks.values() for call in walk]
    return found | {"calls": np.frombuffer(repr(calls).encode(), np.uint8)}


@cache
def _sources() -> dict[str, str]:
    """Digest of each source that acts between the steps: read once, since a process runs what it has imported."""
    found: dict[str, str] = {}
    waiting = [LOOP]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        module = importlib.import_module(name)
        found[name] = hashlib.sha256(Path(str(module.__file__)).read_bytes()).hexdigest()[:16]
        owners = {v.__name__ if inspect.ismodule(v) else getattr(v, "__module__", "") for v in vars(module).values()}
        waiting += sorted(owner for owner in owners if isinstance(owner, str) and owner.startswith(ACTING))
    return dict(sorted(found.items()))


def _lines(file: str, was: str, now: str) -> Iterator[str]:
    """Lines in which the text of a file differs, but for comments and empty lines."""
    before, after = (text.splitlines() for text in (was, now))
    plain = [["" if line.lstrip().startswith("#") else line.split(" #")[0].rstrip() for line in text]
             for text in (before, after)]  # fmt: skip
    for tag, a, b, c, d in difflib.SequenceMatcher(None, *plain, autojunk=False).get_opcodes():
        if tag == "equal" or not any(plain[0][a:b] + plain[1][c:d]):
            continue
        gone, come = ("; ".join(line.strip() for line in text if line) for text in (plain[0][a:b], plain[1][c:d]))
        yield f"{file} file, line {c + 1}: {_said(gone or None)} in the snapshot, {_said(come or None)} now"


def _flat(tree: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in tree.items():
        found |= _flat(value, f"{path}{key}.") if isinstance(value, Mapping) else {f"{path}{key}": value}
    return found


def _said(value: Any) -> str:
    return "nothing" if value is None else f"'{value}'"
