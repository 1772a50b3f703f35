"""Arrays that several processes see: one file in the machine's memory, with a head that names them.

Nothing is locked. Each entry has one writer; who reads what another process writes looks at that process' counters
(`solvers/pacing.py`).
"""

from __future__ import annotations

import json
import mmap
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

MEMORY = Path("/dev/shm")
"""Where files are memory and nothing else; a temporary folder takes its place where it is missing."""
ALIGNED = 64
"""Arrays begin on a cache line of their own, so that writers on two cores do not wait for each other [bytes]."""
HEAD = 8192
"""Place of the arrays' names, elements and shapes [bytes]."""


class SharedArrays:
    """A file of arrays, mapped into this process.

    Parameters
    ----------
    path : Path
        Made by `create`.

    Attributes
    ----------
    arrays : dict of str to ndarray
    """

    def __init__(self, path: Path):
        self.path = path
        with path.open("r+b") as file:
            self.memory = mmap.mmap(file.fileno(), 0)
        length = int.from_bytes(self.memory[:8], "little")
        self.arrays: dict[str, np.ndarray] = {}
        for name, (start, element, shape) in json.loads(self.memory[8 : 8 + length]).items():
            dtype = np.dtype([tuple(field) for field in element] if isinstance(element, list) else element)
            array = np.frombuffer(self.memory, dtype, int(np.prod(shape)), start).reshape(shape)
            self.arrays[name] = array.view(np.recarray) if dtype.names else array

    @classmethod
    def create(cls, arrays: Mapping[str, np.ndarray]) -> SharedArrays:
        """A new file with copies of these arrays, readable by its owner only.

        Raises
        ------
        OSError
            If there is no room.
        """
        head: dict[str, tuple[int, object, tuple[int, ...]]] = {}
        end = HEAD
        for name, array in arrays.items():
            element = [list(field) for field in array.dtype.descr] if array.dtype.names else array.dtype.str
            head[name] = (end, element, array.shape)
            end += -(-array.nbytes // ALIGNED) * ALIGNED
        text = json.dumps(head).encode()
        if len(text) + 8 > HEAD:
            raise ValueError("too many arrays for one file")
        number, name = tempfile.mkstemp(prefix="shipgrid-", dir=MEMORY if MEMORY.is_dir() else None)
        with os.fdopen(number, "wb") as file:
            try:
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(number, 0, end)  # or it would be found missing in the middle of a run
                else:
                    file.truncate(end)
                file.write(len(text).to_bytes(8, "little") + text)
            except OSError:
                os.unlink(name)
                raise
        made = cls(Path(name))
        for key, array in arrays.items():
            made.arrays[key][...] = array
        return made

    def __enter__(self) -> SharedArrays:
        return self

    def __exit__(self, *exception: object) -> None:
        """Take the file's name away; processes that have it mapped keep it."""
        self.path.unlink(missing_ok=True)
