"""The end of a stub line that stands where an element is cut: what is left of it there, as the part solves it.

Two ends make a line (`solvers/stub_lines.py`). The near end has the rest of the element, the far end nothing but the
line; to both the line is a conductance and a wave that arrives. Where a plant is cut says `assembly/partition.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shipgrid.errors import TopologyError
from shipgrid.model.component import type_of
from shipgrid.model.connections import PortBinding
from shipgrid.model.placed import Placed
from shipgrid.model.records import names_of
from shipgrid.solvers.companion import StateSpace, stage_matrices, state_space

SIGNALS = {
    "in_1": ("A", "wave that arrives in the first stage"),
    "in_2": ("A", "wave that arrives in the second stage"),
    "position": ("1", "position of the contacts"),
    "before": ("1", "position of the contacts in the step before"),
    "sent": ("A", "wave that left in the first stage of the step before"),
    "wave": ("A", "wave that arrives in the stage under way"),
    "out_1": ("A", "wave that leaves in the first stage"),
    "out_2": ("A", "wave that leaves in the second stage"),
    "v": ("V", "voltage at the end"),
    "says": ("A", "current into the end; while its contact is open what it sends"),
    "i": ("A", "current into the end"),
}
"""Signals of an end of a stub line, with unit and meaning."""


@dataclass(frozen=True)
class LineEnd:
    """One end of a stub line, as the part it stands in has it.

    Attributes
    ----------
    placed : Placed
        The element that is cut.
    terminal : str
        Where.
    near : bool
        Whether this end has the rest of the element.
    L : float
        Inductance that becomes the line [H].
    """

    placed: Placed
    terminal: str
    near: bool
    L: float

    @property
    def name(self) -> str:
        """Path of the end's own signals."""
        return f"{self.placed.path}.{'near' if self.near else 'far'}"

    @property
    def other(self) -> str:
        """Path of the other end's."""
        return f"{self.placed.path}.{'far' if self.near else 'near'}"

    @property
    def rest(self) -> list[str]:
        """Terminals of the rest of the element."""
        return [name for name in self.placed.ports if name != self.terminal] if self.near else []

    @property
    def at_node(self) -> bool:
        """Whether the line begins at a node, and not behind the rest of the element."""
        return not self.rest

    @property
    def far_node(self) -> PortBinding:
        """Where the far end stands."""
        binding = self.placed.ports[self.terminal]
        return binding if len(self.placed.ports) > 1 else PortBinding(binding.minus)

    @property
    def node(self) -> PortBinding:
        """Where the line begins, if at a node."""
        return PortBinding(self.placed.ports[self.terminal].plus) if self.near else self.far_node

    @property
    def bindings(self) -> list[PortBinding]:
        """Where this end meets the nodes of its part."""
        return [self.placed.ports[name] for name in self.rest] + ([self.node] if self.at_node else [])

    @property
    def space(self) -> StateSpace:
        """The element that is cut."""
        return state_space(self.placed.item)

    @property
    def column(self) -> int:
        """Number of the terminal where it is cut."""
        return [t.name for t in type_of(self.placed.item).terminals].index(self.terminal)

    @property
    def row(self) -> int:
        """Number of the state that is the current there."""
        found = state_behind(self.space, self.column)
        assert found is not None
        return found

    @property
    def state(self) -> str:
        """Its name."""
        return names_of(type_of(self.placed.item).state)[self.row]

    @property
    def states(self) -> list[str]:
        """States of the rest of the element."""
        return [name for name in names_of(type_of(self.placed.item).state) if name != self.state] if self.near else []

    @property
    def position(self) -> str | None:
        """Path of the position of its contacts as the end has it, if there are any."""
        return f"{self.name}.position" if self.placed.variant else None

    @property
    def opens(self) -> list[bool]:
        """In which positions of its contacts no current flows into the line."""
        return [held is not None and self.state in held for held in self.placed.positions]

    @property
    def senses(self) -> tuple[float, float]:
        """1 where that state, and where the current of that terminal, count into the line; -1 where out of it."""
        if not self.near:
            return 1.0, 1.0
        through = 1.0 if len(self.placed.ports) == 1 else -1.0  # what leaves by a terminal goes into the line there
        return through * float(np.sign(self.space.B[self.row, self.column])), through


def inductance(placed: Placed, terminal: str) -> float:
    """Inductance behind a terminal of an element [H].

    Parameters
    ----------
    placed : Placed
        The element.
    terminal : str
        Its name.

    Raises
    ------
    TopologyError
        If the current there is not that of an inductance.
    """
    space, kind = state_space(placed.item), type_of(placed.item)
    found = state_behind(space, [t.name for t in kind.terminals].index(terminal))
    if found is None or (len(kind.terminals) == 1 and (len(space.A) > 1 or space.sources)):
        raise TopologyError(
            f"{placed.path} ({kind.name}) lies between two parts and cannot be cut: expected an element whose current "
            f"at its terminal '{terminal}' is that of an inductance, a cable for instance"
        )
    return 1.0 / abs(float(space.B[found, [t.name for t in kind.terminals].index(terminal)]))


def end_matrices(end: LineEnd, h: float, gh: float) -> list[tuple[np.ndarray, ...]]:
    """What `stage_matrices` gives of the element at an end of a line, in each position of its contacts.

    Parameters
    ----------
    end : LineEnd
    h : float
        Step [s].
    gh : float
        Length [s] of a stage, `GAMMA` times the step.
    """
    found = []
    for position, (open_, held) in enumerate(zip(end.opens, end.placed.positions, strict=True)):
        space = end_space(end, position, h)
        rows = None if held is None or not end.states else tuple(end.states.index(s) for s in held if s in end.states)
        M, N, C, D, W = stage_matrices(space, gh, rows)
        if open_:  # also with all states held, when nothing flows, the end says what it sends
            D[-1] = space.D[-1]
            W[-1] = C[-1] @ N[:, : len(C)] + space.D[-1, : len(C)]
        found.append((M, N, C, D, W))
    return found


def end_space(end: LineEnd, position: int, h: float) -> StateSpace:
    """The element at an end, the line in the place of its inductance (stub-1).

    Its last terminal stands for the line and meets no node: its current is that into the line, or v / Z while a contact
    is open. Its last source is the wave that arrives.

    Parameters
    ----------
    end : LineEnd
    position : int
        Of its contacts.
    h : float
        Step [s].
    """
    space, Z, open_, column, s = (
        state_space(end.placed.item, position),
        end.L / h,
        end.opens[position],
        end.column,
        end.row,
    )
    R = -space.A[s, s] * end.L if end.near else 0.0
    y, r = (0.0, 0.0) if open_ else (1.0 / (Z + R), Z / (Z + R))
    said = 1.0 / Z if open_ else y
    if end.at_node:
        D = np.array([[y, 0.0, -r], [said, 0.0, -r]])
        return StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((2, 0)), D, ("wave",))
    sign = end.senses[0]
    states = [k for k in range(len(space.A)) if k != s]
    inputs = [k for k in range(space.B.shape[1]) if k != column]
    others = [k for k in range(len(space.C)) if k != column]
    drive_x, drive_u = sign * end.L * space.A[s, states], sign * end.L * space.B[s, inputs]  # voltage at the end
    into_x, into_out = sign * space.A[np.ix_(states, [s])], sign * space.C[np.ix_(others, [s])]
    A = space.A[np.ix_(states, states)] + into_x * y * drive_x
    B = np.column_stack([space.B[np.ix_(states, inputs)] + into_x * y * drive_u, -into_x * r])
    C = np.vstack([space.C[np.ix_(others, states)] + into_out * y * drive_x, said * drive_x])
    D = np.column_stack([space.D[np.ix_(others, inputs)] + into_out * y * drive_u, -into_out * r])
    D = np.vstack([D, np.append(said * drive_u, -r)])
    # the voltage of the line's terminal comes after those of the others and before the sources; it drives nothing
    B, D = (np.insert(matrix, len(others), 0.0, axis=1) for matrix in (B, D))
    return StateSpace(A, B, C, D, (*space.sources, "wave"))


def state_behind(space: StateSpace, column: int) -> int | None:
    """The state that is the current at a terminal, driven by its voltage; None if there is no such state.

    Parameters
    ----------
    space : StateSpace
        Of the element.
    column : int
        Number of the terminal.
    """
    row, drive = space.C[column], space.B[:, column]
    at = np.flatnonzero(row)
    if len(at) != 1 or abs(row[at[0]]) != 1.0 or np.any(space.D[column]):
        return None
    return int(at[0]) if list(np.flatnonzero(drive)) == [at[0]] else None
