"""A plan ready to be stepped: by one thread, or by several that share its parts."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable

from shipgrid.assembly.code_store import core
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.tables import crew_arguments
from shipgrid.assembly.workspace import Workspace
from shipgrid.solvers.crew import LISTENING, TURN, new_posts

FOREVER = 2**62


def cores() -> list[int]:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def shared_out(plan: Plan, workers: int) -> list[int]:
    """Worker of each part: the heaviest first, to whom has least; the leader, who keeps the books, has least of all.

    Parameters
    ----------
    plan : Plan
    workers : int
    """
    load = [0] * workers
    found = [0] * len(plan.parts)
    weight = [len(part.network.placed) for part in plan.parts]
    for part in sorted(range(len(weight)), key=lambda k: (-weight[k], k)):
        found[part] = min(range(workers), key=lambda w: (load[w], w))
        load[found[part]] += weight[part]
    order = sorted(range(workers), key=lambda w: (load[w], w))
    return [order.index(worker) for worker in found]


class Crew:
    """Steps a plan: `crew(steps, first_step)`.

    What is computed does not depend on the number of threads. The thread that calls leads; the others wait for it in
    compiled code, without the interpreter lock, until the crew is left.

    Parameters
    ----------
    plan : Plan
    work : Workspace
    workers : int
        Threads; no more than the plan has parts.
    joined : callable, optional
        Called in each of the other threads with its number before it begins.
    crowded : bool, optional
        Whether they have to share processor cores; judged by those that this process may use if left out.
    """

    def __init__(
        self,
        plan: Plan,
        work: Workspace,
        workers: int = 1,
        joined: Callable[[int], object] | None = None,
        crowded: bool | None = None,
    ) -> None:
        workers = max(1, min(workers, len(plan.parts)))
        self.plan, self.entry = plan, core()
        self.posts = new_posts(workers, crowded=workers > len(cores()) if crowded is None else crowded)
        self.crew = shared_out(plan, workers)
        self.arguments = crew_arguments(plan, work, self.posts, self.crew)
        self.joined = joined or (lambda worker: None)
        self.threads: list[threading.Thread] = []
        self.wrong: BaseException | None = None

    def __call__(self, steps: int, first_step: int) -> int:
        """Run steps; how many were, negative if the last of them failed."""
        if len(self.threads) < len(self.posts) - 1:
            raise RuntimeError("a crew of several threads has to be entered before it is called")
        return self.entry(steps, first_step, *self.arguments[0])

    def __enter__(self) -> Crew:
        self.posts[:, [TURN, LISTENING]] = 0
        try:
            for worker in range(1, len(self.posts)):
                name = f"shipgrid-core-{worker}"
                self.threads.append(threading.Thread(target=self._follow, args=[worker], name=name, daemon=True))
                self.threads[-1].start()
            for worker, thread in enumerate(self.threads, start=1):
                while thread.is_alive() and self.posts[worker, LISTENING] == 0:
                    time.sleep(1e-4)
            if self.wrong is not None:
                raise self.wrong
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        if self.threads:
            self.entry(-1, 0, *self.arguments[0])
        for thread in self.threads:
            if thread.ident is not None:  # it has been started
                thread.join()
        self.threads.clear()

    def parts(self, worker: int) -> list[str]:
        """Names of the parts that a worker has."""
        names = self.plan.partition.buses if self.plan.partition else ()
        return [name for name, owner in zip(names, self.crew, strict=True) if owner == worker]

    def _follow(self, worker: int) -> None:
        try:
            self.joined(worker)
            self.entry(FOREVER, 0, *self.arguments[worker])
        except BaseException as wrong:  # who enters the crew raises it: the leader would wait for ever
            self.wrong = wrong
