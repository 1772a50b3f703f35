"""Writes the plain Python module that calls each kernel in turn, and loads it.

The module depends on the set of component types in use and on nothing else: sizes, parameters and connections are
contents of arrays, so that editing a ship file recompiles nothing. Its name carries a hash of every source that can
change what it computes; only its entry point is kept on disk (docs/decisions/0002-woven-module.md).
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numba
import numpy as np

import shipgrid
from shipgrid.assembly.continuous import Continuous, owner_of
from shipgrid.assembly.layout import NORTON_FIELDS, Layout, TypeLayout
from shipgrid.assembly.plan import LEDGERS, Plan, StepPlan, StepWork, Workspace, axis_weight, new_workspace
from shipgrid.assembly.stiff import capacitor_path
from shipgrid.assembly.woven_lines import copy_lines, for_all, gather_lines, pass_to, where_due
from shipgrid.errors import TopologyError
from shipgrid.model.component import STAGES, type_of
from shipgrid.model.kernel import ArrayTable, TableRow, argument_names, call_uncompiled, in_one_piece, without_sign
from shipgrid.model.network import Delayed, Network
from shipgrid.model.ops import wrap
from shipgrid.model.records import parameter_dtype, record_dtype
from shipgrid.solvers import bookkeeping, conduction, nodal, pacing, stub_lines
from shipgrid.solvers.companion import GAMMA
from shipgrid.solvers.crew import new_posts
from shipgrid.solvers.nodal import NetworkPlan, NetworkWork
from shipgrid.solvers.pacing import PaceWork

HASHED = ("model", "components", "controllers", "modulators", "equipment", "automation", "solvers", "assembly")
"""Folders whose sources can change what a woven module computes."""


def cache_folder() -> Path:
    """The user's cache folder for woven modules and their compiled code (`SHIPGRID_CACHE` overrides it)."""
    if "SHIPGRID_CACHE" in os.environ:
        return Path(os.environ["SHIPGRID_CACHE"])
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(base) / "shipgrid"


def source_hash(types: list[TypeLayout]) -> str:
    """Hash of every source, and every version, that the woven module's results depend on."""
    digest = hashlib.sha256(_package_sources())
    for path in sorted({Path(inspect.getfile(t.kind.cls)) for t in types}):
        digest.update(path.read_bytes())
    for word in (sys.version, numba.__version__, np.__version__, *(t.kind.key for t in types)):
        digest.update(word.encode())
    return digest.hexdigest()[:16]


@cache
def _package_sources() -> bytes:
    """Digest of the package's own sources: read once, since a process runs what it has imported."""
    digest = hashlib.sha256()
    root = Path(shipgrid.__file__).parent
    for path in (path for folder in HASHED for path in sorted((root / folder).rglob("*.py"))):
        digest.update(str(path).encode())
        digest.update(path.read_bytes())
    return digest.digest()


@dataclass(frozen=True)
class Woven:
    """A woven module: the network that it was made for, its text, and the name it has by that."""

    network: Network
    text: str
    name: str


_WOVEN: WeakKeyDictionary[Layout, Woven] = WeakKeyDictionary()
"""Modules by the layout of their plans. A copy of a plan that records other signals has its layout, and its module."""


def woven(plan: Plan) -> Woven:
    """The woven module of a plan: made once, since to make it takes as long as some thousand steps."""
    module = _WOVEN.get(plan.layout)
    if module is None or module.network is not plan.network:
        text = weave(plan)
        digest = hashlib.sha256(text.encode()).hexdigest()[:8]
        module = Woven(plan.network, text, f"woven_{source_hash(plan.layout.types)}_{digest}")
        _WOVEN[plan.layout] = module
    return module


def woven_name(plan: Plan) -> str:
    """Name of a plan's woven module: hashes of the sources and of its text, which holds the order within a stage."""
    return woven(plan).name


def woven_entry(plan: Plan) -> Callable[..., int]:
    """The compiled `run(n_steps, first_step, ...)` of a plan's set of component types."""
    name, text = woven(plan).name, woven(plan).text
    if name in sys.modules:
        return sys.modules[name].run
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.py"
        if not path.exists() or path.read_text() != text:
            with tempfile.NamedTemporaryFile("w", dir=folder, suffix=".tmp", delete=False) as part:
                part.write(text)
            os.replace(part.name, path)
    except OSError:  # no cache folder to write to: compile for this process only
        path = Path(tempfile.mkdtemp()) / f"{name}.py"
        path.write_text(text)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module.run


def arguments(plan: Plan, work: Workspace) -> tuple[Any, ...]:
    """What the entry point takes after the step numbers, for one thread that runs the whole plant."""
    return crew_arguments(plan, work, new_posts(1), [0] * len(plan.parts))[0]


def crew_arguments(plan: Plan, work: Workspace, posts: np.ndarray, crew: Sequence[int]) -> list[tuple[Any, ...]]:
    """What the entry point takes after the step numbers, for each of several threads.

    For each part, and last for the plan itself, a row: where all arrays are, whole numbers, and other numbers. The
    threads share them: what a row names is written by the thread alone that has its part.

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
    shared = table.numbers, whole, real, np.array(crew, dtype=np.int64), posts
    return [(worker, *shared) for worker in range(len(posts))]


_ROWS: WeakKeyDictionary[Layout, tuple[NetworkPlan, TableRow]] = WeakKeyDictionary()
"""Rows of the table of arrays by the layout of their plan, each with the network plan whose arrays it names."""


def _table_row(plan: Plan) -> TableRow:
    """Where the arrays of a plan lie: made once for all copies of it that differ in their `step` alone."""
    net, row = _ROWS.get(plan.layout, (None, None))
    if row is None or net is not plan.net:
        work = new_workspace(plan)
        moving = _moving(plan, work)
        row = TableRow(named_values(plan, work, moving["scratch"]), moving)
        _ROWS[plan.layout] = plan.net, row
    return row


def _moving(plan: Plan, work: Workspace) -> dict[str, np.ndarray]:
    """The arrays that another workspace, or a copy of the plan with another `step`, has its own of; scratch memory."""
    of_step = {name: without_sign(a) for name, a in plan.step._asdict().items() if isinstance(a, np.ndarray)}
    of_work = {"sig": work.sig, **work.net._asdict(), **work.step._asdict(), **work.pace._asdict()}
    return of_work | of_step | {"scratch": scratch_of(plan)}


def scratch_of(plan: Plan) -> np.ndarray:
    """Memory for copies of the states of every component: start of step, stage, rates."""
    size = sum(len("abc") * _even(len(t.placed) * t.nx) for t in plan.layout.types)
    return in_one_piece({"scratch": np.zeros(size)})["scratch"]


def _even(count: int) -> int:
    """A number of floating-point numbers that fill whole units of 16 bytes."""
    return count + count % 2


def numbers_of(plan: Plan) -> dict[str, float]:
    """By name, the numbers that a woven module works with."""
    fields = {**plan.net._asdict(), **plan.step._asdict()}
    return {name: value for name, value in fields.items() if not isinstance(value, np.ndarray)}


def named_values(plan: Plan, work: Workspace, scratch: np.ndarray) -> dict[str, np.ndarray]:
    """By name, the arrays that a woven module works on: plan, workspace, views of the flat vector and of scratch."""
    constant: dict[str, Any] = {
        "sources": plan.gathers["network"]["latest"],
        **plan.net._asdict(),
        **plan.step._asdict(),
    }
    moving: dict[str, Any] = {"sig": work.sig, **work.net._asdict(), **work.step._asdict(), **work.pace._asdict()}
    at = 0
    for t in plan.layout.types:
        moving |= dict(type_views(plan, work, t))
        for name in "abc" if t.nx else "":
            size = len(t.placed) * t.nx
            flat = scratch[at : at + size].reshape(len(t.placed), t.nx)
            moving[f"{t.kind.key}_{name}f"] = flat
            moving[f"{t.kind.key}_{name}"] = flat.ravel().view(record_dtype(t.kind.state))
            at += _even(size)
        constant |= {f"{t.kind.key}_{name}": value for name, value in plan.gathers.get(t.kind.key, {}).items()}
        constant[f"{t.kind.key}_clock"] = plan.clock_of[t.kind.key]
    return moving | {name: without_sign(value) for name, value in constant.items() if isinstance(value, np.ndarray)}


def type_views(plan: Plan, work: Workspace, t: TypeLayout) -> list[tuple[str, Any]]:
    """Names and values of one type's arguments."""
    kind, count, key = t.kind, len(t.placed), t.kind.key
    found: list[tuple[str, Any]] = []

    def view(name: str, flat: np.ndarray, record: Any) -> None:
        found.append((f"{key}_{name}", flat.view(record)))

    if t.nx:
        view("x", work.sig[t.x : t.x + count * t.nx], record_dtype(kind.state))
        flat = work.sig[t.x : t.x + count * t.nx].reshape(count, t.nx)
        found.append((f"{key}_xf", flat))
    if t.nu:
        view("u", work.sig[t.u : t.u + count * t.nu], record_dtype(kind.input))
    if t.ny:
        view("y", work.sig[t.y : t.y + count * t.ny], record_dtype(kind.output))
    if parameter_dtype(kind.cls).names:
        view("p", t.parameters, parameter_dtype(kind.cls))
    if kind.stamped:
        first = _first_machine(plan, t)
        block = work.net.norton[first : first + count].ravel()
        view("n", block, NORTON)
    found.append((f"{key}_weight", np.array([p.axis_weight for p in t.placed])))
    return found


NORTON = np.dtype((np.record, [(name, "f8") for name in NORTON_FIELDS]))


def _first_machine(plan: Plan, t: TypeLayout) -> int:
    before = 0
    for other in plan.layout.types:
        if other is t:
            return before
        before += len(other.placed) if other.kind.stamped else 0
    raise AssertionError


def weave(plan: Plan) -> str:
    """Text of the woven module for a plan's set of component types."""
    types = plan.layout.types  # all that there are, also where a part has no instance
    imports: dict[tuple[str, str], str] = {}

    def imported(kernel: Any, label: str) -> str:
        function = getattr(kernel, "py_func", kernel)
        return imports.setdefault((function.__module__, function.__name__), label)

    functions: list[str] = []
    calls: list[str] = []
    arrays, numbers = named_values(plan, new_workspace(plan), scratch_of(plan)), numbers_of(plan)
    places = TableRow(arrays, {}).places
    views: dict[tuple[str, int], str] = {}
    ordered = type_order(plan)

    def with_views(body: list[str]) -> list[str]:
        """Lines of a function, after those that find the arrays they name in the table."""
        used = set(re.findall(r"[A-Za-z_]\w*", "\n".join(body)))
        found = []
        for name in (name for name in arrays if name in used):
            dtype = arrays[name].dtype
            kind = repr(dtype.descr if dtype.names else dtype.str), arrays[name].ndim
            found.append(f"{name} = {views.setdefault(kind, f'view_{len(views)}')}(table, {places[name]})")
        return found + body

    def function(name: str, body: list[str], *given: str) -> str:
        """Add one function of the module, since small ones compile fastest. Returns its call."""
        used = set(re.findall(r"[A-Za-z_]\w*", "\n".join(body)))
        known = numbers if given else ("t", *numbers)  # who knows the step's number finds its time
        passed = ", ".join(["table", *given, *(name for name in known if name in used)])
        functions.extend(["", "", "@kernel", f"def {name}({passed}):", *(f"    {line}" for line in with_views(body))])
        return f"{name}({passed})"

    made: dict[str, str] = {}

    def solver(kernel: Any) -> str:
        """Call of a solver kernel, which becomes a function of the module."""
        call = _shared(kernel)
        name = call.split("(")[0].replace(".", "_")
        if name not in made:
            given = [word for word in ("done", "posts") if word in argument_names(kernel)]
            made[name] = function(name, [f"return {call}"], *given)
        return made[name]

    moving_on = Continuous(plan, ordered, imported, function)
    for stage in STAGES:
        if stage == "network":
            calls += moving_on.begin()
            calls += _network(types, bool(plan.network.legs), imported, function, solver)
            calls += moving_on.end()
            continue
        for t in (t for t in ordered if t.kind.stage == stage):
            if stage == "advance" and moving_on.has(t):
                continue
            body = _call(t, t.kind.key in moving_on.every, imported)
            call = function(f"{stage}_{t.kind.key}", body)
            always = stage == "modulate" or t.kind.key in moving_on.every
            calls += [call] if always else [f"if due[{types.index(t)}] != 0:", f"    {call}"]
    books = function("keep_books", _audit(types, imported))
    step = function(
        "step", ["t = (done - 1) * h", "bad = -1", solver(bookkeeping.tick_clocks), *calls, "return bad"], "done"
    )
    keep = function(
        "keep",
        [
            f"if not {solver(bookkeeping.record)}:",
            "    return -1",
            "t = done * h",
            books,
            f"return {solver(bookkeeping.audit)}",
        ],
        "done",
    )
    begin, end = solver(pacing.begin_step), solver(pacing.end_step)
    exchange = solver(stub_lines.exchange)
    whole = [name for name, value in numbers.items() if isinstance(value, int)]
    real = [name for name in numbers if name not in whole]

    def of_row(row: str) -> list[str]:
        """Lines that find the table and the numbers of a row."""
        return [
            f"table = addresses[{row}]",
            *(f"{name} = whole[{row}, {k}]" for k, name in enumerate(whole)),
            *(f"{name} = real[{row}, {k}]" for k, name in enumerate(real)),
        ]

    parts = "worker, addresses, whole, real, crew, posts"
    functions += [
        *("", "", "@kernel", f"def before_step(done, {parts}):"),
        '    """Number of the step to run, or that there is none: the leader waits for the clock, others for it."""',
        "    if worker != 0:",
        "        return team.released(posts, worker)",
        *(f"    {line}" for line in of_row("addresses.shape[0] - 1")),
        f"    if {begin}:",
        "        return team.OVER",
        "    if posts.shape[0] > 1:",
        "        team.release(posts, done)",
        "    return done",
    ]
    entry = [
        *("", "", "@entry_point", f"def run(n_steps, first_step, {parts}):"),
        "    books = addresses.shape[0] - 1",
        "    for k in range(n_steps):",
        f"        done = before_step(first_step + k + 1, {parts})",
        "        if done == team.OVER:",
        "            return k",
        "        bad = -1",
        "        for p in range(books + 1):",
        "            if p < books and crew[p] != worker:",
        "                continue",
        "            if p == books and worker != 0:",
        "                team.arrive(posts, worker, bad)",
        "                break",
        *(f"            {line}" for line in of_row("p")),
        "            if p == books and books > 0:",
        "                wrong = team.gather(posts)",
        "                if bad < 0:",
        "                    bad = wrong",
        f"                {exchange}",
        "            if p < books or books == 0:",
        f"                wrong = {step}",
        "                if bad < 0:",
        "                    bad = wrong",
        f"            wrong = {keep}",
        "            if bad < 0:",
        "                bad = wrong",
        "            if p == books:",
        f"                {end}",
        "        if worker == 0 and bad >= 0:",
        "            return -(k + 1)",
        "    return n_steps",
    ]
    return "\n".join(
        [
            '"""Woven by shipgrid: one step of a plant with these component types, kernel by kernel. Do not edit."""',
            "from shipgrid.model.kernel import array_view, entry_point, kernel",
            "from shipgrid.solvers import bookkeeping, conduction, nodal, pacing, stub_lines",
            "from shipgrid.solvers import crew as team",
            *(f"from {module} import {name} as {label}" for (module, name), label in imports.items()),
            "",
            *(f"{name} = array_view({element}, {ndim})" for (element, ndim), name in views.items()),
            *functions,
            *entry,
            "",
        ]
    )


SHARED = (
    "t",
    "sig",
    "sources",
    *NetworkPlan._fields,
    *NetworkWork._fields,
    *StepPlan._fields,
    *StepWork._fields,
    *PaceWork._fields,
)
"""Names that every function of a woven module may use."""


def _shared(kernel: Any) -> str:
    """Call of a solver kernel: its arguments are named after the fields they are."""
    function = getattr(kernel, "py_func", kernel)
    names = inspect.signature(function).parameters
    unknown = set(names) - {*SHARED, "done", "posts"}
    if unknown:
        raise TypeError(f"{function.__name__} asks for unknown arguments {sorted(unknown)}")
    return f"{function.__module__.rsplit('.', 1)[-1]}.{function.__name__}({', '.join(names)})"


def _call(t: TypeLayout, every: bool, imported: Callable[[Any, str], str]) -> list[str]:
    """Lines that run all instances of one signal component that is not continuous; `every`: all of them, every step."""
    kind, key = t.kind, t.kind.key
    kernels = kind.kernels
    inner: list[str] = []
    if "modulate" in kernels:
        name = imported(kernels["modulate"], f"{key}_modulate")
        step = pass_to(kernels["modulate"], key, dt="h", fraction="clock_ahead[c]", phase="start", phase_next="end")
        phases = [  # of the clock, in periods: a step's end is the very number at which the next one starts
            "start = (clock_phase[c] - clock_inc[c] + (clock_den[c] if clock_ahead[c] >= 0.0 else 0)) / clock_den[c]",
            "end = clock_phase[c] / clock_den[c]",
        ]
        inner = [
            *gather_lines(key, "now"),
            *(phases if "phase" in argument_names(kernels["modulate"]) else []),
            f"{name}({step})",
        ]
        return for_all(key, [f"c = {key}_clock[i]", *inner])
    between = "update" in kernels and not every
    inner += gather_lines(key, "sampled", imported(wrap, "wrap")) if between else gather_lines(key, "now")
    if "update" in kernels:
        name = imported(kernels["update"], f"{key}_update")
        inner += copy_lines(key, "a", "x") if t.nx else []
        instant, period = ("t", "h") if every else ("t - (1.0 - f) * h", "clock_period[c]")
        inner.append(f"{name}({pass_to(kernels['update'], key, t=instant, dt=period, x_next=f'{key}_a[i]')})")
        inner += copy_lines(key, "x", "a") if t.nx else []
    if "outputs" in kernels:
        name = imported(kernels["outputs"], f"{key}_outputs")
        inner.append(f"{name}({pass_to(kernels['outputs'], key)})")
    return for_all(key, inner) if every else where_due(key, inner)


def _network(
    types: list[TypeLayout],
    legs: bool,
    imported: Callable[[Any, str], str],
    function: Callable[..., str],
    solver: Callable[[Any], str],
) -> list[str]:
    """Calls of the network stage; the machines' part of it is made with `function`, the bridges' if there are any."""
    machines = [t for t in types if t.kind.stamped]

    def machine_function(name: str, body_of: Callable[[TypeLayout], list[str]]) -> list[str]:
        return [
            function(
                f"{name}_{t.kind.key}",
                [f"for i in range({t.kind.key}_clock.shape[0]):", *(f"    {line}" for line in body_of(t))],
            )
            for t in machines
        ]

    def begin(t: TypeLayout) -> list[str]:
        return [*gather_lines(t.kind.key, "now"), *copy_lines(t.kind.key, "a", "x")]

    def stamp(t: TypeLayout) -> list[str]:
        name = imported(t.kind.kernels["stamp"], f"{t.kind.key}_stamp")
        return [f"{name}({pass_to(t.kind.kernels['stamp'], t.kind.key, x=f'{t.kind.key}_b[i]')})"]

    def first(t: TypeLayout) -> list[str]:
        return [*copy_lines(t.kind.key, "b", "a"), *stamp(t)]

    def second(t: TypeLayout) -> list[str]:
        key = t.kind.key
        start = f"{key}_bf[i, j] = {key}_af[i, j] + nodal.KAPPA * ({key}_xf[i, j] - {key}_af[i, j])"
        return [f"for j in range({key}_xf.shape[1]):", f"    {start}", *stamp(t)]

    def advance(t: TypeLayout) -> list[str]:
        key = t.kind.key
        name = imported(t.kind.kernels["advance"], f"{key}_advance")
        return [f"{name}({pass_to(t.kind.kernels['advance'], key, x=f'{key}_b[i]', x_next=f'{key}_x[i]')})"]

    def finish(t: TypeLayout) -> list[str]:
        lines = []
        for ending in ("limit", "outputs"):
            if ending in t.kind.kernels:
                name = imported(t.kind.kernels[ending], f"{t.kind.key}_{ending}")
                lines.append(f"{name}({pass_to(t.kind.kernels[ending], t.kind.key)})")
        return lines or ["pass"]

    advances = machine_function("advance", advance)
    book = function("book_stage", _stage_books(types, imported, solver(nodal.publish)), "first", "share")

    def stage(stamps: list[str], waves: Any, sent: Any, first: bool) -> list[str]:
        given = {"first": str(first), "share": "1.0 - nodal.GAMMA" if first else "nodal.GAMMA"}
        return [
            solver(waves),
            solver(nodal.element_history),
            *stamps,
            solver(nodal.machine_history),
            "for _ in range(2):",  # again where a current has no path
            f"    {solver(nodal.nodal_equations)}",
            *([f"    {solver(conduction.constrain)}"] if legs else []),
            f"    if {solver(nodal.solve)}:",
            "        break",
            *([solver(conduction.release)] if legs else []),
            solver(nodal.element_advance),
            solver(sent),
            *advances,
            "if booked[0] != 0:",
            "    " + re.sub(r"\b(first|share)\b", lambda word: given[word[0]], book),
        ]

    once = [
        solver(conduction.begin_round),
        solver(nodal.linear_admittance),
        *stage(machine_function("first_stamp", first), stub_lines.first_waves, stub_lines.first_sent, True),
        solver(nodal.second_stage),
        *stage(machine_function("second_stamp", second), stub_lines.second_waves, stub_lines.second_sent, False),
    ]
    begun = [
        solver(bookkeeping.remember),
        solver(nodal.begin_step),
        *["if moved[0] != 0:", f"    {solver(bookkeeping.book_contacts)}"],
        *machine_function("begin", begin),
    ]
    ended = [*machine_function("finish", finish), f"bad = {solver(nodal.finish_step)}"]
    if not legs:
        return [*begun, *once, *ended]
    return [
        *begun,
        solver(conduction.set_legs),
        "while True:",
        *(f"    {line}" for line in once),
        f"    if {solver(conduction.settle_legs)}:",
        "        break",
        *ended,
        f"if {solver(conduction.unsettled)}:",
        "    bad = n_nodes",
        solver(conduction.meter_bridges),
        solver(conduction.lead_samples),
    ]


def _audit(types: list[TypeLayout], imported: Callable[[Any, str], str]) -> list[str]:
    """Lines that add each component's powers to its ledgers, in the order of `Plan.energy_items`.

    Of an element the mean of the step, weighted as the rule weights its stages; of a signal component the power now.
    """
    lines = ["e = 0"]
    for t in types:
        for ledger, power in _ledgers(t, imported):
            lines += [
                f"for i in range({t.kind.key}_clock.shape[0]):",
                f"    joule = audit_every * h * {'stage_power[e + i]' if t.kind.terminals else power}",
                "    energy[e + i] += joule",
                *(["    exchanged[0] += abs(joule)"] if ledger == "supplied" else []),
                f"e += {t.kind.key}_clock.shape[0]",
            ]
    return lines


def _stage_books(types: list[TypeLayout], imported: Callable[[Any, str], str], publish: str) -> list[str]:
    """Lines that add a stage's share to the mean power of the step, of elements and shunts."""
    lines = [publish, "e = 0"]

    def add(entry: str, power: str) -> list[str]:
        return [f"    watt = share * {power}", f"    {entry} = watt if first else {entry} + watt"]

    for t in types:
        for _, power in _ledgers(t, imported):
            if t.kind.terminals:
                lines += [f"for i in range({t.kind.key}_clock.shape[0]):", *add("stage_power[e + i]", power)]
            lines.append(f"e += {t.kind.key}_clock.shape[0]")
    return [
        *lines,
        "for i in range(shunt_node.shape[0]):",
        "    v = sig[shunt_node[i]]",
        *add("stage_power[n_energy - shunt_node.shape[0] + i]", "shunt_g[i] * v * v"),
    ]


def _is_of_the_network(t: TypeLayout) -> bool:
    """Whether what a type books is a mean of the step: of an element, and of a bridge, which has only such outputs."""
    return bool(t.kind.terminals) or t.kind.stage == "network"


def _ledgers(t: TypeLayout, imported: Callable[[Any, str], str]) -> list[tuple[str, str]]:
    """Ledgers of a type, and the power that instance `i` adds to each."""
    key = t.kind.key
    found = [(ledger, t.kind.kernels[ledger]) for ledger in LEDGERS if ledger in t.kind.kernels]
    return [
        (ledger, f"{key}_weight[i] * {imported(kernel, f'{key}_{ledger}')}({pass_to(kernel, key)})")
        for ledger, kernel in found
    ]


def type_order(plan: Plan) -> list[TypeLayout]:
    """Types in an order in which each runs after those of its own stage whose outputs it reads."""
    by_key = {t.kind.key: t for t in plan.layout.types}
    placed_of = plan.network.placed
    needs: dict[str, set[str]] = {key: set() for key in by_key}
    for placed in placed_of.values():
        kind = type_of(placed.item)
        for source in placed.inputs.values():
            if not isinstance(source, str) or isinstance(source, Delayed) or source in plan.layout.states:
                continue
            owner = owner_of(source, placed_of)
            if owner is None:
                continue
            key = type_of(placed_of[owner].item).key
            if key != kind.key and by_key[key].kind.stage == kind.stage:
                needs[kind.key].add(key)
    done: list[str] = []
    left = sorted(needs)
    while left:
        ready = [key for key in left if needs[key] <= set(done)]
        if not ready:
            loop = ", ".join(by_key[key].kind.name for key in left)
            raise TopologyError(
                f"{plan.network.name}: within one step these wait for each other: {loop}; "
                "one of them has to read a state, run in another stage, or read a `Delayed` signal"
            )
        done += ready
        left = [key for key in left if key not in ready]
    return [by_key[key] for key in done]


def powers(plan: Plan, work: Workspace) -> np.ndarray:
    """Power [W] at this instant of those entries of `Plan.energy_items` that are booked by it; 0 for means of steps."""
    found = []
    for part, own in zip((*plan.parts, plan), (*work.parts, work), strict=True):
        start = len(found)
        for t in part.layout.types:
            views = dict(type_views(part, own, t))
            for kernel in (t.kind.kernels[ledger] for ledger in LEDGERS if ledger in t.kind.kernels):
                if _is_of_the_network(t):
                    found += [0.0] * len(t.placed)
                    continue
                names = argument_names(kernel)
                for i, placed in enumerate(t.placed):
                    values = {n: part.step.tables if n == "tables" else views[f"{t.kind.key}_{n}"][i] for n in names}
                    found.append(placed.axis_weight * float(call_uncompiled(kernel, values)))
        found += [0.0] * (start + part.step.n_energy - len(found))
    return np.array(found)


def stored_energy(plan: Plan, work: Workspace) -> dict[str, float]:
    """Energy [J] stored in each component and bus capacitance at this instant."""
    found = {}
    for part, own in zip(plan.pieces, work.pieces, strict=True):
        for t in part.layout.types:
            kernel = t.kind.kernels.get("stored_energy")
            if kernel is None:
                continue
            views = dict(type_views(part, own, t))
            key = t.kind.key
            names = argument_names(kernel)
            for i, placed in enumerate(t.placed):
                values = {n: (part.step.tables if n == "tables" else views[f"{key}_{n}"][i]) for n in names}
                found[placed.path] = placed.axis_weight * float(call_uncompiled(kernel, values))
    for end in (end for part in (plan.partition.parts if plan.partition else ()) for end in part.ends if end.near):
        # of a line what is more than the energy of the current that its element has (stub-2)
        waves = [work.sig[[plan.layout.index[f"{name}.in_{k}"] for name in (end.name, end.other)]] for k in (1, 2)]
        line = 0.25 * end.L * sum(b * float(a @ a) for b, a in zip((1.0 - GAMMA, GAMMA), waves, strict=True))
        i = float(work.sig[plan.layout.slots["x", f"{end.placed.path}.{end.state}"]])
        found[f"{end.placed.path}.surplus"] = end.placed.axis_weight * (line - 0.5 * end.L * i**2)
    for node, farad in plan.network.capacitances.items():
        path = capacitor_path(node)
        energy = 0.5 * axis_weight(node) * farad * float(work.sig[plan.layout.index[node]]) ** 2
        found[path] = found.get(path, 0.0) + energy
    return found
