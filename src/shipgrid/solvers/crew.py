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

TURN, STEP, WRONG, BUSY = range(4)
"""Columns of `posts`: turns that the leader has released or a worker done; of the leader, the step to run; of a worker,
what failed in it, or -1; and the time that it took, of the leader that for which it waited [ns]."""
CROWDED, LISTENING = 4, 5
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
    return posts


@kernel
def release(posts, done):
    """Let the others run step number `done`."""
    posts[0, STEP] = done
    shows(posts, TURN, posts[0, TURN] + 1)


@kernel
def released(posts, worker):
    """Wait for a step to run; its number, or `OVER`."""
    last = posts[worker, TURN]
    posts[worker, LISTENING] = 1
    looks = 0
    while seen(posts, TURN) == last:
        looks += 1
        breathe(1 if posts[worker, CROWDED] != 0 or looks > PATIENCE else 0)
    posts[worker, BUSY] = monotonic_ns()
    return posts[0, STEP]


@kernel
def arrive(posts, worker, wrong):
    """Say that this worker's parts have been run."""
    posts[worker, BUSY] = monotonic_ns() - posts[worker, BUSY]
    posts[worker, WRONG] = wrong
    shows(posts, worker * WIDTH + TURN, posts[worker, TURN] + 1)


@kernel
def gather(posts):
    """Wait until all have run the step that was released; what failed first, by worker, or -1."""
    wrong = -1
    posts[0, BUSY] = 0
    if posts.shape[0] == 1:
        return wrong
    began = monotonic_ns()
    for worker in range(1, posts.shape[0]):
        looks = 0
        while seen(posts, worker * WIDTH + TURN) != posts[0, TURN]:
            looks += 1
            breathe(1 if posts[0, CROWDED] != 0 or looks > PATIENCE else 0)
        if wrong < 0:
            wrong = posts[worker, WRONG]
    posts[0, BUSY] = monotonic_ns() - began
    return wrong
