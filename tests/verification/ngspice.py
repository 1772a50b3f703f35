"""Runs a netlist in ngspice and reads what it wrote: the same circuit, solved by somebody else's program.

ngspice comes with the system's packages (`apt-get install ngspice`; `make install-test` does it where it may).
Without it these tests fail and say so: they are not skipped.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

MISSING = "ngspice is not installed: run `make install-test` as root, or `apt-get install ngspice` (CONTRIBUTING.md)"

COMPLAINTS = re.compile(
    r"^.*\b(error|singular|too small|aborted|unknown|no convergence)\b.*$", re.IGNORECASE | re.MULTILINE
)
"""Lines in ngspice's log after which its results are not what the netlist says."""


def run(netlist: str, *, limit: float = 120.0) -> dict[str, np.ndarray]:
    """Transient analysis of a netlist.

    Parameters
    ----------
    netlist : str
        With `.tran` and `.save`.
    limit : float
        Time it may take [s].

    Returns
    -------
    dict of str to ndarray
        `time`, and each saved quantity by ngspice's name for it (`v(bus)`, `i(l1)`), at the steps ngspice took.

    Raises
    ------
    RuntimeError
        If ngspice is missing, complains or stops early.
    """
    program = shutil.which("ngspice")
    if program is None:
        raise RuntimeError(MISSING)
    with tempfile.TemporaryDirectory() as folder:
        circuit, raw, log = (Path(folder) / name for name in ("circuit.cir", "waves.raw", "log.txt"))
        circuit.write_text(netlist)
        command = [program, "-n", "-b", "-r", str(raw), "-o", str(log), str(circuit)]
        binary = os.environ | {"SPICE_ASCIIRAWFILE": "0"}
        done = subprocess.run(
            command, cwd=folder, env=binary, timeout=limit, check=False, capture_output=True, text=True
        )
        said = (log.read_text() if log.exists() else "") + done.stdout + done.stderr
        complaint = COMPLAINTS.search(said)
        if done.returncode or complaint or not raw.exists():
            raise RuntimeError(f"ngspice: {complaint.group(0).strip() if complaint else said[-2000:]}")
        waves = read_raw(raw.read_bytes())
    stop = stop_time(netlist)
    if waves["time"][-1] < stop * (1.0 - 1e-9):
        raise RuntimeError(f"ngspice stopped at {waves['time'][-1]:g} s of {stop:g} s")
    return waves


def stop_time(netlist: str) -> float:
    """Third word of `.tran`, a plain number of seconds."""
    found = re.search(r"^\.tran\s+\S+\s+(\S+)", netlist, re.MULTILINE)
    if found is None:
        raise RuntimeError("the netlist has no .tran")
    return float(found.group(1))


def read_raw(data: bytes) -> dict[str, np.ndarray]:
    """Quantities of a binary raw file with one real-valued plot."""
    head, _, body = data.partition(b"Binary:\n")
    text = head.decode("latin-1")
    count = int(re.search(r"^No\. Variables:\s*(\d+)", text, re.MULTILINE).group(1))
    points = int(re.search(r"^No\. Points:\s*(\d+)", text, re.MULTILINE).group(1))
    names = [line.split()[1].lower() for line in text.partition("Variables:\n")[2].splitlines()[:count]]
    table = np.frombuffer(body, dtype=float, count=points * count).reshape(points, count)
    return {name: table[:, k].copy() for k, name in enumerate(names)}


def version() -> str:
    """Version of the ngspice that is found, e.g. `ngspice-39`."""
    program = shutil.which("ngspice")
    if program is None:
        raise RuntimeError(MISSING)
    said = subprocess.run([program, "--version"], check=True, capture_output=True, text=True).stdout
    return re.search(r"ngspice-\S+", said).group(0)
