"""A linear component's equations -> its matrices for one implicit Euler step, the building block of the solver.

The integration rule is SDIRK2 (docs/decisions/0003-integration-rule.md): two implicit Euler steps of the same length
gamma h, so that one set of matrices a component and a step length is all there is.

    x+ = M x + N u+,   M = (I - gh A)^-1,   N = gh M B          (companion-1)
    i+ = C x+ + D u+ = C M x + W u+,        W = C N + D         (companion-2)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from shipgrid.errors import ParameterError
from shipgrid.model.component import POSITION, type_of
from shipgrid.model.kernel import call_uncompiled, reads_time
from shipgrid.model.records import names_of, parameter_record

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
"""Diagonal coefficient of SDIRK2 [Alexander1977]: L-stable and of order two."""

LINEAR = "a network element without a stamp has to be linear in states and inputs"

KAPPA = (1.0 - GAMMA) / GAMMA
"""The second stage starts from x0 + KAPPA (x1 - x0)."""


@dataclass(frozen=True)
class StateSpace:
    """Continuous-time matrices of a linear component; the columns of B and D are terminals first, then sources.

    Attributes
    ----------
    A, B, C, D : ndarray, shapes (n, n), (n, q), (m, n), (m, q)
        dx/dt = A x + B u, i = C x + D u, SI units; m terminals, q inputs.
    sources : tuple of str
        Names of the inputs after the terminals.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    sources: tuple[str, ...]


@lru_cache(maxsize=4096)
def state_space(item: Any, position: int = 0) -> StateSpace:
    """Read a linear component's matrices off its kernels.

    Parameters
    ----------
    item : component instance
        A component with terminals and without a stamp.
    position : int
        Position of its contacts, for kernels that have it as their input `position`.

    Returns
    -------
    StateSpace
        Its arrays are read-only: equal items share them.

    Raises
    ------
    ParameterError
        If the kernels are not linear or read the time, or an output is not the current of a terminal.
    """
    kind = type_of(item)
    for name in ("derivatives", "outputs"):
        if reads_time(kind.kernels.get(name)):
            raise ParameterError(
                f"{kind.name}: `{name}` reads the time, but the matrices of a linear element are constant: expected an "
                "input in its place, which a signal component or a command moves"
            )
    p, _ = parameter_record(item)
    ends = [terminal.v for terminal in kind.terminals]
    sources = tuple(name for name in names_of(kind.input) if name not in ends and name != POSITION)
    inputs = [*ends, *sources]
    currents = [terminal.i for terminal in kind.terminals]
    if sorted(names_of(kind.output)) != sorted(currents):
        raise ParameterError(f"{kind.name}: the outputs of a linear element are its terminals' currents {currents}")
    states = names_of(kind.state)
    n, q = len(states), len(inputs)
    # one call does for all: each field holds a row of numbers, from the unit vectors, a probe and nothing at all
    probe = -np.arange(2.0, n + q + 2)
    points = np.column_stack([np.eye(n + q), probe, np.zeros(n + q)])
    x = SimpleNamespace(**dict(zip(states, points[:n], strict=True)))
    u = SimpleNamespace(**dict(zip(inputs, points[n:], strict=True)), **{POSITION: float(position)})
    dx, y = SimpleNamespace(**dict.fromkeys(states, 0.0)), SimpleNamespace()
    values = {"t": 0.0, "x": x, "u": u, "p": p, "dx": dx, "y": y}
    try:
        if states:
            call_uncompiled(kind.kernels["derivatives"], values)
        call_uncompiled(kind.kernels["outputs"], values)
    except ValueError:  # a branch on a state or an input
        raise ParameterError(f"{kind.name}: {LINEAR}") from None
    table = np.empty((n + len(ends), n + q + 2))
    for row, (record, name) in enumerate([*((dx, name) for name in states), *((y, name) for name in currents)]):
        table[row] = getattr(record, name)
    matrix, probed, zero = table[:, : n + q], table[:, -2], table[:, -1]
    error, size = np.abs(probed - matrix @ probe), np.abs(matrix) @ np.abs(probe)
    if np.any(zero != 0.0) or not np.all(error <= 1e-9 * (1.0 + size)):  # also if it is not a number
        raise ParameterError(f"{kind.name}: {LINEAR}")
    matrix = matrix.copy()
    matrix.flags.writeable = False
    A, B, C, D = matrix[:n, :n], matrix[:n, n:], matrix[n:, :n], matrix[n:, n:]
    return StateSpace(A, B, C, D, sources)


def stage_matrices(
    space: StateSpace, gh: float, held: tuple[int, ...] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Matrices of one implicit Euler step.

    Parameters
    ----------
    space : StateSpace
        The component.
    gh : float
        Length of the step [s].
    held : tuple of int, optional
        States that are held at zero (open contacts); with all of them held nothing flows any more, of
        an element without states neither. None: nothing is open.

    Returns
    -------
    M, N, C, D, W : ndarray
        As in (companion-1) and (companion-2); W has the terminals' columns only.

    Raises
    ------
    ParameterError
        If I - gh A is singular.
    """
    n, m = len(space.A), len(space.C)
    A, B, C, D = space.A.copy(), space.B.copy(), space.C.copy(), space.D.copy()
    rows = list(held or ())
    A[rows, :] = 0.0
    A[:, rows] = 0.0
    B[rows, :] = 0.0
    C[:, rows] = 0.0
    try:
        M = np.linalg.inv(np.eye(n) - gh * A)
    except np.linalg.LinAlgError:
        raise ParameterError(f"the step is too long: I - {gh:g} s A is singular") from None
    M[rows, :] = 0.0
    M[:, rows] = 0.0
    N = gh * M @ B
    if held is not None and len(rows) == n:
        D = np.zeros_like(D)
    W = C @ N[:, :m] + D[:, :m]
    return M, N, C, D, W
