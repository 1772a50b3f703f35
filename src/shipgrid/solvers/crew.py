"""Several threads that step the parts of one plant together: who begins when, and who waits for whom.

The first worker leads: it waits for the wall clock, takes commands, releases a step, runs its own parts, waits until
the others have run theirs, exchanges what the parts read of each other, and keeps the books. The others wait for the
release. What is computed does not depend on how many there are: in a step every part reads and writes its own.

Each worker writes one row of `posts` only, as wide as two cache lines. To wait it spins; where there are more workers
than cores, or after a while in vain, it lets others run between two looks.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import kernel
from shipgrid.model.kernel import breathe, in_one_piece, monotonic_ns, seen, shows

DONE, WRONG, BUSY = range(3)
"""Columns of `posts`: the last step run (of the leader: released), what failed in it, or -1, and the time it took [ns]
(of the leader: for which it waited)."""
CROWDED, LISTENING = 3, 4
"""Columns of `posts`: 1 if the workers have to share cores; 1 once a worker has begun to wait for the leader."""
WIDTH = 16
OVER = -1
"""The step that the leader releases last."""
PATIENCE = 20_000
"""Looks in vain after which a worker lets others run: about a millisecond."""


def new_posts(workers: int, *, crowded: bool = False) -> np.ndarray:
    """Posts of a crew that has not begun."""
    posts = in_one_piece({"posts": np.zeros((workers, WIDTH), dtype=np.int64)})["posts"]
    posts[:, CROWDED] = int(crowded)
    posts[:, WRONG] = -1
    return posts


@kernel
def release(posts, done):
    """Let the others run step number `done`."""
    shows(posts, DONE, done)


@kernel
def released(posts, worker):
    """Wait for a step to run; its number, or `OVER`."""
    last = posts[worker, DONE]
    posts[worker, LISTENING] = 1
    looks = 0
    found = seen(posts, DONE)
    while found == last:
        looks += 1
        breathe(1 if posts[worker, CROWDED] != 0 or looks > PATIENCE else 0)
        found = seen(posts, DONE)
    posts[worker, BUSY] = monotonic_ns()
    return found


@kernel
def arrive(posts, worker, done, wrong):
    """Say that this worker's parts have been run."""
    posts[worker, BUSY] = monotonic_ns() - posts[worker, BUSY]
    posts[worker, WRONG] = wrong
    shows(posts, worker * WIDTH + DONE, done)


@kernel
def gather(posts, done):
    """Wait until all have run step number `done`; what failed first, by worker, or -1."""
    wrong = -1
    posts[0, BUSY] = 0
    if posts.shape[0] == 1:
        return wrong
    began = monotonic_ns()
    for worker in range(1, posts.shape[0]):
        looks = 0
        while seen(posts, worker * WIDTH + DONE) != done:
            looks += 1
            breathe(1 if posts[0, CROWDED] != 0 or looks > PATIENCE else 0)
        if wrong < 0:
            wrong = posts[worker, WRONG]
    posts[0, BUSY] = monotonic_ns() - began
    return wrong
