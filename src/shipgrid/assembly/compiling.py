"""Compiles several objects at a time, in processes of their own (`compile_worker.py`), and says how far it is."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence

MOST = 8
"""Processes at a time: each takes some 300 MB."""


def compile_in_parallel(jobs: Sequence[str]) -> None:
    """Compile objects into the store, on as many cores as this process may use.

    What a process fails to compile stays missing: who needs it compiles it itself and meets the error.

    Parameters
    ----------
    jobs : sequence of str
        Names by `code_store.job_of`; the longest first.
    """
    waiting = sorted(jobs, key=lambda job: job != "core")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    progress = Progress(len(waiting))
    lock = threading.Lock()

    def work() -> None:
        surroundings = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        with subprocess.Popen(
            [sys.executable, "-m", "shipgrid.assembly.compile_worker"],
            env=surroundings,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as process:
            assert process.stdin is not None and process.stdout is not None
            while True:
                with lock:
                    job = waiting.pop(0) if waiting else None
                if job is None:
                    break
                try:
                    process.stdin.write(f"{job}\n")
                    process.stdin.flush()
                    answer = process.stdout.readline()
                except OSError:
                    break
                if not answer:
                    break
                with lock:
                    progress.advance()

    threads = [threading.Thread(target=work) for _ in range(min(cores, MOST, len(waiting)))]
    try:
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    except BaseException:
        waiting.clear()
        raise
    finally:
        progress.end()


class Progress:
    """A line on standard error while objects are compiled.

    Parameters
    ----------
    total : int
        Number of objects.
    """

    def __init__(self, total: int):
        self.total, self.done, self.began = total, 0, time.perf_counter()
        self.terminal = sys.stderr is not None and sys.stderr.isatty()
        self._write(f"shipgrid: compiling {total} parts, once for this version and processor")

    def advance(self) -> None:
        """One more is done."""
        self.done += 1
        if self.terminal:
            self._write(f"\rshipgrid: compiled {self.done} of {self.total}, {self._seconds():.0f} s ", end="")

    def end(self) -> None:
        """All are done."""
        begin = "\r" if self.terminal else ""
        self._write(f"{begin}shipgrid: compiled {self.done} parts in {self._seconds():.0f} s")

    def _seconds(self) -> float:
        return time.perf_counter() - self.began

    def _write(self, text: str, end: str = "\n") -> None:
        if sys.stderr is not None:
            sys.stderr.write(text + end)
            sys.stderr.flush()
