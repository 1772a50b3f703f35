"""The memory of a plan and a workspace as compiled code finds it: tables of addresses and shapes of arrays.

A row of the table is of a part, or of the plan itself. The arrays of the core come first, then for each component type
that the part has those of its unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from shipgrid.assembly import code_store
from shipgrid.assembly.core_text import core_arrays, moving_arrays, numbers_of
from shipgrid.assembly.layout import Layout, TypeLayout
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.schedule import WALKS
from shipgrid.assembly.unit_text import LEDGERS, NORTON, OPERATION, SHARED, unit_arrays
from shipgrid.assembly.workspace import Workspace, new_workspace
from shipgrid.model.kernel import ArrayTable, TableRow, in_one_piece, without_sign
from shipgrid.model.records import parameter_dtype, record_dtype
from shipgrid.solvers.crew import new_posts
from shipgrid.solvers.nodal import NetworkPlan

COPIES = ("start", "stage", "rate")
"""Scratch memory for the states of each component."""


class Memory:
    """What the core works on, at an address; it keeps alive what is named there.

    Attributes
    ----------
    address : int
    rows : ArrayTable
        A row of each part, and last of the plan itself.
    whole, real : ndarray
        Numbers of each row, those of `core_text.numbers_of`.
    """

    def __init__(self, rows: ArrayTable, whole: np.ndarray, real: np.ndarray, crew: np.ndarray, posts: np.ndarray):
        self.rows, self.whole, self.real = rows, whole, real
        self.kept = rows.addresses, whole, real, crew, posts
        self.table = np.array([n for a in self.kept for n in (a.ctypes.data, *a.shape)], dtype=np.int64)
        self.address = self.table.ctypes.data


def arguments(plan: Plan, work: Workspace) -> tuple[int, Memory]:
    """What the core takes after the step numbers, for one thread that runs the whole plant."""
    return crew_arguments(plan, work, new_posts(1), [0] * len(plan.parts))[0]


def crew_arguments(plan: Plan, work: Workspace, posts: np.ndarray, crew: Sequence[int]) -> list[tuple[int, Memory]]:
    """What the core takes after the step numbers, for each of several threads: its number, and the memory of all.

    What a row names is written by the thread alone that has its part.

    Parameters
    ----------
    plan : Plan
    work : Workspace
    posts : ndarray
        Of `solvers.crew.new_posts`, one a thread.
    crew : sequence of int
        Worker of each part; each worker has one part at least.
    """
    pieces = list(zip((*plan.parts, plan), (*work.parts, work), strict=True))
    table = ArrayTable([_table_row(piece) for piece, _ in pieces], [_moving(*both) for both in pieces])
    numbers = [numbers_of(piece).values() for piece, _ in pieces]
    whole = np.array([[n for n in row if isinstance(n, int)] for row in numbers], dtype=np.int64)
    real = np.array([[n for n in row if not isinstance(n, int)] for row in numbers])
    memory = Memory(table, whole, real, np.array(crew, dtype=np.int64), posts)
    return [(worker, memory) for worker in range(len(posts))]


_ROWS: WeakKeyDictionary[Layout, tuple[NetworkPlan, TableRow]] = WeakKeyDictionary()
"""Rows by the layout of their plan, each with the network plan whose arrays it names."""


def _table_row(plan: Plan) -> TableRow:
    """Where the arrays of a plan lie: made once for all copies of it that differ in their `step` alone."""
    net, row = _ROWS.get(plan.layout, (None, None))
    if row is None or net is not plan.net:
        work = new_workspace(plan)
        moving = _moving(plan, work)
        row = TableRow(named_arrays(plan, work, moving["scratch"]), moving)
        _ROWS[plan.layout] = plan.net, row
    return row


def _moving(plan: Plan, work: Workspace) -> dict[str, np.ndarray]:
    """The arrays that another workspace, or a copy of the plan with another `step`, has its own of; scratch memory."""
    return moving_arrays(plan, work) | {"scratch": scratch_of(plan)}


def scratch_of(plan: Plan) -> np.ndarray:
    """Memory for copies of the states of every component."""
    size = sum(len(COPIES) * _even(len(t.placed) * t.nx) for t in plan.layout.types)
    return in_one_piece({"scratch": np.zeros(size)})["scratch"]


def _even(count: int) -> int:
    """A number of floating-point numbers that fill whole units of 16 bytes."""
    return count + count % 2


def named_arrays(plan: Plan, work: Workspace, scratch: np.ndarray) -> dict[str, np.ndarray]:
    """By name, the arrays of a row: those of the core, then those of each unit with the type's key before them."""
    units = code_store.load(t.kind for t in plan.layout.types)
    found = core_arrays(plan, work)
    begins: dict[str, int] = {}
    at = sum(1 + array.ndim for array in found.values())
    entry, used = 0, 0
    for t in plan.layout.types:
        count = len(t.placed)
        own = {name: found[name] for name in SHARED}
        own |= {name: without_sign(value) for name, value in plan.gathers.get(t.kind.key, {}).items()}
        own["place_in_books"] = np.array([entry])
        own["clock"] = without_sign(plan.clock_of[t.kind.key])
        own |= type_views(plan, work, t)
        for name in COPIES if t.nx else ():
            flat = scratch[used : used + count * t.nx].reshape(count, t.nx)
            own |= {f"{name}_flat": flat, name: flat.ravel().view(record_dtype(t.kind.state))}
            used += _even(count * t.nx)
        entry += count * len([ledger for ledger in LEDGERS if ledger in t.kind.kernels])
        if count and t.kind.key in units:
            begins[t.kind.key] = at
            for name, (element, ndim) in unit_arrays(t.kind).items():
                array = found[f"{t.kind.key}.{name}"] = own[name]
                assert (array.dtype, array.ndim) == (element, ndim), (t.kind.key, name, array.dtype, element)
                at += 1 + ndim
    calls = []
    for number, walk in enumerate(WALKS):
        found["call_start"][number] = len(calls)
        calls += [
            (units[call.type], OPERATION[call.operation], begins[call.type], call.condition)
            for call in plan.schedule.walks[walk]
            if call.type in begins
        ]
    found["call_start"][-1] = len(calls)
    made = np.array(calls, dtype=np.int64).reshape(-1, 4)
    found["calls"][: len(calls)], found["call_due"][: len(calls)] = made[:, :3], made[:, 3]
    return found


def type_views(plan: Plan, work: Workspace, t: TypeLayout) -> dict[str, Any]:
    """By name, what the kernels of a type see of a plan and a workspace: records of all its instances."""
    kind, count = t.kind, len(t.placed)
    found: dict[str, Any] = {}
    if t.nx:
        flat = work.sig[t.x : t.x + count * t.nx]
        found["x"] = flat.view(record_dtype(kind.state))
        found["x_flat"] = flat.reshape(count, t.nx)
    if t.nu:
        found["u"] = work.sig[t.u : t.u + count * t.nu].view(record_dtype(kind.input))
    if t.ny:
        found["y"] = work.sig[t.y : t.y + count * t.ny].view(record_dtype(kind.output))
    if parameter_dtype(kind.cls).names:
        found["p"] = t.parameters.view(parameter_dtype(kind.cls))
    if kind.stamped:
        first = _first_machine(plan, t)
        found["n"] = work.net.norton[first : first + count].ravel().view(NORTON)
    found["weight"] = np.array([p.axis_weight for p in t.placed])
    return found


def _first_machine(plan: Plan, t: TypeLayout) -> int:
    before = 0
    for other in plan.layout.types:
        if other is t:
            return before
        before += len(other.placed) if other.kind.stamped else 0
    raise AssertionError
