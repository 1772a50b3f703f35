"""Writes the source of the core: the loop over steps, the solver in it, that calls the units of a plant.

There is one core for all plants: what it works on, and which units it calls in which order, are contents of arrays
(docs/decisions/0023-units.md). Its text is the one below, with the arguments of the solver's kernels put in for `...`:
they are named after the fields of the plan and the workspace that they are.
"""

from __future__ import annotations

import importlib
import re
from functools import cache

import numpy as np

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.schedule import WALKS
from shipgrid.assembly.unit_text import table_places
from shipgrid.assembly.workspace import Workspace, new_workspace
from shipgrid.model.kernel import argument_names, without_sign
from shipgrid.model.network import Network

TEXT = '''\
"""Core of a step, written by shipgrid. Do not edit."""
from shipgrid.model.kernel import array_view, call_unit, kernel
from shipgrid.solvers import bookkeeping, conduction, nodal, pacing, stub_lines
from shipgrid.solvers import crew as team

VIEWS


@kernel
def walk(table, number, t, h, gh):
    """Call the units of one list, where they are due."""
    calls = calls_view(table, CALLS)
    call_due = call_due_view(table, CALL_DUE)
    call_start = call_start_view(table, CALL_START)
    due = due_view(table, DUE)
    for k in range(call_start[number], call_start[number + 1]):
        if due[call_due[k]] != 0:
            call_unit(calls[k, 0], calls[k, 1], table + 8 * calls[k, 2], t, h, gh)


@kernel
def step(table, done, NUMBERS):
    """One step of what a row of the table holds: the place of what failed in it, or -1."""
    t = (done - 1) * h
    bad = -1
    bookkeeping.tick_clocks(...)
    walk(table, WALK_before, t, h, gh)
    bookkeeping.remember(...)
    nodal.begin_step(...)
    if moved_view(table, MOVED)[0] != 0:
        bookkeeping.book_contacts(...)
    walk(table, WALK_begin, t, h, gh)
    booked = booked_view(table, BOOKED)
    conduction.set_legs(...)
    while True:
        conduction.begin_round(...)
        nodal.linear_admittance(...)
        stub_lines.first_waves(...)
        nodal.element_history(...)
        walk(table, WALK_first_stamp, t, h, gh)
        nodal.machine_history(...)
        for _ in range(2):  # again where a current has no path
            nodal.nodal_equations(...)
            conduction.constrain(...)
            if nodal.solve(...):
                break
        conduction.release(...)
        nodal.element_advance(...)
        stub_lines.first_sent(...)
        walk(table, WALK_advance, t, h, gh)
        if booked[0] != 0:
            nodal.publish(...)
            walk(table, WALK_book_first_stage, t, h, gh)
            bookkeeping.book_shunts_first(...)
        nodal.second_stage(...)
        stub_lines.second_waves(...)
        nodal.element_history(...)
        walk(table, WALK_second_stamp, t, h, gh)
        nodal.machine_history(...)
        for _ in range(2):
            nodal.nodal_equations(...)
            conduction.constrain(...)
            if nodal.solve(...):
                break
        conduction.release(...)
        nodal.element_advance(...)
        stub_lines.second_sent(...)
        walk(table, WALK_advance, t, h, gh)
        if booked[0] != 0:
            nodal.publish(...)
            walk(table, WALK_book_second_stage, t, h, gh)
            bookkeeping.book_shunts_second(...)
        if conduction.settle_legs(...):
            break
    walk(table, WALK_finish, t, h, gh)
    bad = nodal.finish_step(...)
    if conduction.unsettled(...):
        bad = n_nodes
    conduction.meter_bridges(...)
    conduction.lead_samples(...)
    walk(table, WALK_after, t, h, gh)
    return bad


@kernel
def keep(table, done, NUMBERS):
    """Record and keep the books after step number `done`: the place of a signal that is absurd, or -1."""
    if not bookkeeping.record(...):
        return -1
    walk(table, WALK_book, done * h, h, audit_every * h)
    return bookkeeping.audit(...)


@kernel
def before_step(done, worker, addresses, whole, real, crew, posts):
    """Number of the step to run, or that there is none: the leader waits for the clock, others for it."""
    if worker != 0:
        return team.released(posts, worker)
    ROW(addresses.shape[0] - 1)
    if pacing.begin_step(...):
        return team.OVER
    if posts.shape[0] > 1:
        team.release(posts, done)
    return done


def core(n_steps, first_step, worker, master):
    """Run steps; how many were, negative if the last of them failed. Below zero steps: release the others for good.

    `master` is the address of a table: addresses of the rows, one a part and last the plan itself; their whole
    and other numbers; worker of each part; posts of the crew.
    """
    addresses = addresses_view(master, 0)
    whole = whole_view(master, 2)
    real = real_view(master, 5)
    crew = crew_view(master, 8)
    posts = whole_view(master, 10)
    if n_steps < 0:
        if posts.shape[0] > 1:
            team.release(posts, team.OVER)
        return 0
    books = addresses.shape[0] - 1
    for k in range(n_steps):
        done = before_step(first_step + k + 1, worker, addresses, whole, real, crew, posts)
        if done == team.OVER:
            return k
        bad = -1
        for p in range(books + 1):
            if p < books and crew[p] != worker:
                continue
            if p == books and worker != 0:
                team.arrive(posts, worker, bad)
                break
            ROW(p)
            if p == books and books > 0:
                wrong = team.gather(posts)
                if bad < 0:
                    bad = wrong
                stub_lines.exchange(...)
            if p < books or books == 0:
                wrong = step(table, done, NUMBERS)
                if bad < 0:
                    bad = wrong
            wrong = keep(table, done, NUMBERS)
            if bad < 0:
                bad = wrong
            if p == books:
                pacing.end_step(...)
        if worker == 0 and bad >= 0:
            return -(k + 1)
    return n_steps
'''


def numbers_of(plan: Plan) -> dict[str, float]:
    """By name, the numbers that the core works with."""
    fields = {**plan.net._asdict(), **plan.step._asdict()}
    return {name: value for name, value in fields.items() if not isinstance(value, np.ndarray)}


def core_arrays(plan: Plan, work: Workspace) -> dict[str, np.ndarray]:
    """By name, the arrays that the core works on, in the order in which its table has them."""
    moving = moving_arrays(plan, work)
    constant = {"sources": plan.gathers["network"]["latest"], **plan.net._asdict()}
    found = moving | {name: without_sign(a) for name, a in constant.items() if isinstance(a, np.ndarray)}
    size = sum(len(calls) for calls in plan.schedule.walks.values())
    of_calls = {"calls": (size, 3), "call_due": size, "call_start": len(WALKS) + 1}
    made = {name: np.zeros(shape, dtype=np.int64) for name, shape in of_calls.items()}
    return found | made | {name: without_sign(made[name]) for name in ("call_due", "call_start")}


def moving_arrays(plan: Plan, work: Workspace) -> dict[str, np.ndarray]:
    """Those of which another workspace, or a copy of the plan with another `step`, has its own."""
    of_work = {"sig": work.sig, **work.net._asdict(), **work.step._asdict(), **work.pace._asdict()}
    return of_work | {name: without_sign(a) for name, a in plan.step._asdict().items() if isinstance(a, np.ndarray)}


@cache
def core_text() -> str:
    """Source of the core: element types and numbers of dimensions of arrays are the same in every plan."""
    plan = assemble(Network("empty"))
    arrays, numbers = core_arrays(plan, new_workspace(plan)), numbers_of(plan)
    places = dict(zip(arrays, table_places({name: (a.dtype, a.ndim) for name, a in arrays.items()}), strict=True))
    views: dict[str, str] = {}
    made: dict[str, list[str]] = {}

    def view(name: str) -> str:
        array = arrays[name]
        element = repr(array.dtype.descr if array.dtype.names else array.dtype.str)
        views[f"{name}_view"] = f"array_view({element}, {array.ndim})"
        return f"{name}_view(table, {places[name]})"

    def call_of(match: re.Match[str]) -> str:
        module, name = match[1], match[2]
        arguments = argument_names(getattr(importlib.import_module(f"shipgrid.solvers.{module}"), name))
        unknown = set(arguments) - {*arrays, *numbers, "done", "posts"}
        if unknown:
            raise TypeError(f"{module}.{name} asks for unknown arguments {sorted(unknown)}")
        passed = ", ".join(["table", *(a for a in arguments if a not in arrays)])
        made[f"{module}_{name}"] = [
            *("", "", "@kernel", f"def {module}_{name}({passed}):"),
            *(f"    {a} = {view(a)}" for a in arguments if a in arrays),
            f"    return {module}.{name}({', '.join(arguments)})",
        ]
        return f"{module}_{name}({passed})"

    def row_of(match: re.Match[str]) -> str:
        space, row = match[1], match[2]
        whole = [name for name, value in numbers.items() if isinstance(value, int)]
        real = [name for name in numbers if name not in whole]
        lines = [f"table = addresses[{row}]"]
        lines += [f"{name} = whole[{row}, {k}]" for k, name in enumerate(whole)]
        lines += [f"{name} = real[{row}, {k}]" for k, name in enumerate(real)]
        return "\n".join(f"{space}{line}" for line in lines)

    text = re.sub(r"(\w+)\.(\w+)\(\.\.\.\)", call_of, TEXT)
    text = re.sub(r"^( *)ROW\((.*)\)$", row_of, text, flags=re.MULTILINE)
    text = re.sub(r"WALK_(\w+)", lambda m: str(WALKS.index(m[1])), text)
    text = text.replace("NUMBERS", ", ".join(numbers))
    for name in ("calls", "call_due", "call_start", "due", "moved", "booked"):
        view(name)
        text = re.sub(rf"\b{name.upper()}\b", str(places[name]), text)
    views |= {"addresses_view": "array_view('<i8', 1)", "crew_view": "array_view('<i8', 1)"}
    views |= {"whole_view": "array_view('<i8', 2)", "real_view": "array_view('<f8', 2)"}
    head, functions = text.split("VIEWS")
    lines = [*(f"{name} = {made_of}" for name, made_of in views.items()), *(line for f in made.values() for line in f)]
    return head + "\n".join(lines) + functions
