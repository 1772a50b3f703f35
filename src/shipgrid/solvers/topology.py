"""Which nodes meet, in which order they are eliminated, and which of them form islands.

No table of switch positions: the pattern is that of all contacts closed, and the solve itself finds what is cut off.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def elimination_order(n: int, pairs: Iterable[tuple[int, int]]) -> list[int]:
    """Order of elimination by least degree.

    Parameters
    ----------
    n : int
        Number of nodes.
    pairs : iterable of (int, int)
        Nodes that share an element.

    Returns
    -------
    list of int
        Old numbers in their new order.
    """
    around: list[set[int]] = [set() for _ in range(n)]
    for a, b in pairs:
        if a != b:
            around[a].add(b)
            around[b].add(a)
    left, order = set(range(n)), []
    while left:
        k = min(left, key=lambda j: (len(around[j]), j))
        order.append(k)
        left.remove(k)
        for a in around[k]:
            around[a] |= around[k] - {a}
            around[a].discard(k)
    return order


def later_neighbours(n: int, pairs: Iterable[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """For each pivot in order, the later nodes it touches once the earlier ones are eliminated.

    Parameters
    ----------
    n : int
        Number of nodes, numbered in the order of elimination.
    pairs : iterable of (int, int)
        Nodes that share an element.

    Returns
    -------
    start : ndarray of int, shape (n + 1,)
    neighbour : ndarray of int
        Those of pivot k are `neighbour[start[k]:start[k + 1]]`.
    """
    around: list[set[int]] = [set() for _ in range(n)]
    for a, b in pairs:
        around[min(a, b)].add(max(a, b))
    start, flat = [0], []
    for k in range(n):
        later = sorted(j for j in around[k] if j > k)
        if later:
            around[later[0]].update(later[1:])
        flat += later
        start.append(len(flat))
    return np.array(start, dtype=np.int64), np.array(flat, dtype=np.int64)


def islands(nodes: Iterable[str], pairs: Iterable[tuple[str, str]]) -> list[list[str]]:
    """Groups of nodes that are connected with each other."""
    leader = {node: node for node in nodes}

    def find(node: str) -> str:
        while leader[node] != node:
            node = leader[node]
        return node

    for a, b in pairs:
        leader[find(a)] = find(b)
    groups: dict[str, list[str]] = {}
    for node in leader:
        groups.setdefault(find(node), []).append(node)
    return sorted(groups.values())
