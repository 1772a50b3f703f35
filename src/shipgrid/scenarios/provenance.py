"""What a run depends on and was made of, as its folder says it."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numba
import numpy as np

import shipgrid
from shipgrid.assembly.code_store import code_digest
from shipgrid.assembly.plan import Plan
from shipgrid.scenarios.output_folder import (
    COMMANDS,
    MARK_BEGINS,
)
from shipgrid.scenarios.parts import Groups
from shipgrid.scenarios.results import citation_keys
from shipgrid.scenarios.waveforms import Window


def provenance(plan: Plan) -> dict[str, str]:
    """Versions a result depends on, and what to cite.

    The commit is that of the working copy the package lies in, with `-dirty` where it has changes; "unknown" elsewhere.
    """
    home = Path(shipgrid.__file__).parent
    commit = "unknown"
    try:
        top = _git(home, "rev-parse", "--show-toplevel")
        if (Path(top) / "src" / "shipgrid").resolve() == home.resolve():
            commit = _git(home, "rev-parse", "HEAD") + ("-dirty" if _git(home, "status", "--porcelain") else "")
    except (OSError, subprocess.SubprocessError):
        pass
    modules = {t.kind.cls.__module__ for t in plan.layout.types} | {"shipgrid.solvers.companion"}
    return {
        "version": shipgrid.__version__,
        "commit": commit,
        "code": code_digest(plan.kinds),
        "python": platform.python_version(),
        "numba": numba.__version__,
        "numpy": np.__version__,
        "machine": platform.machine() + f", {os.cpu_count()} cores",
        "references": " ".join(citation_keys(sorted(modules))),
    }


def _git(folder: Path, *words: str) -> str:
    done = subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, timeout=5, check=True)
    return done.stdout.strip()


def spans(windows: Sequence[Window], h: float) -> str | None:
    """Windows in words, for a comparison; None if there are none."""
    return ", ".join(f"{w.first * h!r} s to {w.last * h!r} s" for w in windows) or None


def run_yaml(
    ship: Any,
    scenario: Any,
    fidelity: str,
    step: float,
    end: float,
    overrides: Mapping[str, str],
    about: Mapping[str, str],
    waveforms: Sequence[tuple[float, float]],
    parts: Groups | None,
) -> str:
    """Everything needed to repeat the run: the files as read, with the options."""
    lines = [
        f"{MARK_BEGINS} everything needed to repeat this run, with `shipgrid run` and the path of this file.",
        "schema: 1",
        f"fidelity: {fidelity}",
        f"step: {step!r} s",
        f"until: {end!r} s",
        f"version: {about['version']}",
        f"commit: {about['commit']}",
        *(["waveforms:", *(f"  - {a!r} s:{b!r} s" for a, b in waveforms)] if waveforms else []),
        *(["parts:", *(f"  {name}: [{', '.join(buses)}]" for name, buses in parts.items())] if parts else []),
        f"outside: {COMMANDS}  # beside this file, if there were any: commands given while a live run ran",
        "set:",
        *(f"  {path}: {json.dumps(value)}" for path, value in overrides.items()),
        "ship: |2",  # the indentation said, whatever the text begins with
        *(f"  {line}" for line in ship.text.splitlines()),
        "scenario: |2",
        *(f"  {line}" for line in scenario.text.splitlines()),
        "",
    ]
    return "\n".join(line if line != "set:" or overrides else "set: {}" for line in lines)
