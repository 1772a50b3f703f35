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
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numba
import numpy as np

import shipgrid
from shipgrid.assembly.layout import Layout, TypeLayout
from shipgrid.assembly.plan import LEDGERS, Plan, StepPlan, StepWork, Workspace, axis_weight, new_workspace
from shipgrid.assembly.stiff import capacitor_path
from shipgrid.errors import TopologyError
from shipgrid.model.component import STAGES, ComponentType, type_of
from shipgrid.model.kernel import ArrayTable, TableRow, argument_names, call_uncompiled, in_one_piece, without_sign
from shipgrid.model.network import Delayed, Network, Placed
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


NORTON = np.dtype((np.record, [(name, "f8") for name in ("g_aa", "g_ab", "g_ba", "g_bb", "h_a", "h_b")]))


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

    moving_on = _Continuous(plan, ordered, imported, function)
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


def _pass(kernel: Any, key: str, **values: str) -> str:
    function = getattr(kernel, "py_func", kernel)
    given = {
        "t": "t",
        "tables": "tables",
        "delays": "delays",
        "x": f"{key}_x[i]",
        "u": f"{key}_u[i]",
        "y": f"{key}_y[i]",
        "p": f"{key}_p[i]",
        "n": f"{key}_n[i]",
        "gh": "gh",
    } | values
    names = argument_names(kernel)
    missing = [name for name in names if name not in given]
    if missing:
        raise TypeError(f"kernel {function.__module__}.{function.__name__} asks for unknown arguments {missing}")
    return ", ".join(given[name] for name in names)


def _gather_lines(key: str, at: str, wrap: str = "") -> list[str]:
    """Lines that hand an instance its inputs: all as they are now, or what is measured at another time.

    Parameters
    ----------
    key : str
        Of the type.
    at : {"now", "sampled", "ahead"}
        Sampled: at the fraction `f` of the last step. Ahead: what is smooth carried on by the share `part` of a step.
    wrap : str
        Name of the kernel that brings an angle into -pi .. pi: it goes the short way round.
    """
    now = [
        f"for j in range({key}_now_start[i], {key}_now_start[i + 1]):",
        f"    sig[{key}_now[j, 0]] = sig[{key}_now[j, 1]]",
    ]
    if at == "now":
        return now
    latest = [
        f"for j in range({key}_latest_start[i], {key}_latest_start[i + 1]):",
        f"    sig[{key}_latest[j, 0]] = sig[{key}_latest[j, 1]]",
    ]
    if at == "ahead":
        return [
            *latest,
            f"for j in range({key}_measured_start[i], {key}_measured_smooth[i]):",
            f"    sig[{key}_measured[j, 0]] = sig[{key}_measured[j, 1]]",
            f"for j in range({key}_measured_smooth[i], {key}_measured_turn[i]):",
            f"    a = sig[{key}_measured[j, 1]]",
            f"    sig[{key}_measured[j, 0]] = a + part * (a - previous[{key}_measured[j, 1]])",
            f"for j in range({key}_measured_turn[i], {key}_measured_start[i + 1]):",
            f"    a = sig[{key}_measured[j, 1]]",
            f"    sig[{key}_measured[j, 0]] = {wrap}(a + part * {wrap}(a - previous[{key}_measured[j, 1]]))",
        ]
    between = [
        *latest,
        f"for j in range({key}_measured_start[i], {key}_measured_turn[i]):",
        f"    b = previous[{key}_measured[j, 1]]",
        f"    a = sig[{key}_measured[j, 1]]",
        f"    sig[{key}_measured[j, 0]] = b + f * (a - b) + lead[{key}_measured_lead[j]]",
        f"for j in range({key}_measured_turn[i], {key}_measured_start[i + 1]):",
        f"    b = previous[{key}_measured[j, 1]]",
        f"    a = sig[{key}_measured[j, 1]]",
        f"    sig[{key}_measured[j, 0]] = {wrap}(b + f * {wrap}(a - b))",
    ]
    return ["if f == 1.0:", *(f"    {line}" for line in now), "else:", *(f"    {line}" for line in between)]


def _copy(key: str, to: str, origin: str) -> list[str]:
    return [f"for j in range({key}_xf.shape[1]):", f"    {key}_{to}f[i, j] = {key}_{origin}f[i, j]"]


def _call(t: TypeLayout, every: bool, imported: Callable[[Any, str], str]) -> list[str]:
    """Lines that run all instances of one signal component that is not continuous; `every`: all of them, every step."""
    kind, key = t.kind, t.kind.key
    kernels = kind.kernels
    inner: list[str] = []
    if "modulate" in kernels:
        name = imported(kernels["modulate"], f"{key}_modulate")
        step = _pass(kernels["modulate"], key, dt="h", fraction="clock_ahead[c]", phase="start", phase_next="end")
        phases = [  # of the clock, in periods: a step's end is the very number at which the next one starts
            "start = (clock_phase[c] - clock_inc[c] + (clock_den[c] if clock_ahead[c] >= 0.0 else 0)) / clock_den[c]",
            "end = clock_phase[c] / clock_den[c]",
        ]
        inner = [
            *_gather_lines(key, "now"),
            *(phases if "phase" in argument_names(kernels["modulate"]) else []),
            f"{name}({step})",
        ]
        return _for_all(key, [f"c = {key}_clock[i]", *inner])
    between = "update" in kernels and not every
    inner += _gather_lines(key, "sampled", imported(wrap, "wrap")) if between else _gather_lines(key, "now")
    if "update" in kernels:
        name = imported(kernels["update"], f"{key}_update")
        inner += _copy(key, "a", "x") if t.nx else []
        instant, period = ("t", "h") if every else ("t - (1.0 - f) * h", "clock_period[c]")
        inner.append(f"{name}({_pass(kernels['update'], key, t=instant, dt=period, x_next=f'{key}_a[i]')})")
        inner += _copy(key, "x", "a") if t.nx else []
    if "outputs" in kernels:
        name = imported(kernels["outputs"], f"{key}_outputs")
        inner.append(f"{name}({_pass(kernels['outputs'], key)})")
    return _for_all(key, inner) if every else _where_due(key, inner)


def _for_all(key: str, lines: list[str]) -> list[str]:
    """Lines for each instance of a type of which all run in every step."""
    return [f"for i in range({key}_clock.shape[0]):", *(f"    {line}" for line in lines)]


def _where_due(key: str, lines: list[str]) -> list[str]:
    """Lines for each instance of a type whose clock struck, at the fraction `f` of the last step."""
    guarded = [f"c = {key}_clock[i]", "f = clock_before[c]", "if f >= 0.0:", *(f"    {line}" for line in lines)]
    return [f"for i in range({key}_clock.shape[0]):", *(f"    {line}" for line in guarded)]


@dataclass
class _Coupled:
    """Continuous types that read each other, by themselves or over types without states.

    Attributes
    ----------
    types : list of TypeLayout
    between : list of TypeLayout
        Types without states in between.
    """

    types: list[TypeLayout]
    between: list[TypeLayout]


class _Continuous:
    """Calls that integrate the continuous components of a plant side by side: Heun's rule over all of them at once.

    What they read of each other is taken where they are: at the step's start for the first rates, where these lead for
    the second ones. What the network reads of a component that runs in every step is half-way there, and stands for the
    mean of the step; the network's own smooth quantities are carried on to there from the step before. So a chain of
    components is of second order as each of them is, and so is a loop through the network, but for a direct path from
    something that jumps (the voltage of a node without capacitance), which is that of the step's start. A component
    with a clock of its own is moved on once for its whole period, and seen as it was until then.

    Types that nothing couples are moved on one after the other, which costs less and gives the same; so are those of
    which all else that they are coupled with is not due in a step.

    Parameters
    ----------
    plan : Plan
    ordered : list of TypeLayout
        All types in the order of `type_order`.
    imported, function : callable
        Of `weave`.
    """

    def __init__(
        self,
        plan: Plan,
        ordered: list[TypeLayout],
        imported: Callable[[Any, str], str],
        function: Callable[..., str],
    ):
        self.due = {t.kind.key: k for k, t in enumerate(plan.layout.types)}
        self.imported, self.function = imported, function
        self.made: dict[str, str] = {}
        stages = sorted(ordered, key=lambda t: STAGES.index(t.kind.stage))
        self.groups, self.itself = _coupled(plan, stages)
        self.to_network = _read_by_network(plan)
        self.every = {t.kind.key for t in stages if all(p.clock is None for p in _placed(plan, t))}

    def has(self, t: TypeLayout) -> bool:
        """Whether a type is one of them."""
        return _is_continuous(t)

    def begin(self) -> list[str]:
        """Calls before the network is stepped."""
        lines = []
        for group in self.groups:
            types = group.types
            together = [*self._rates(types, "0.0"), *self._moves(types, "0.5")]
            together += self._outputs([t for t in self._with_outputs(group) if t.kind.key in self.to_network], "0.5")
            alone = {t.kind.key: self._begin_alone(t) for t in types}
            lines += self._together_or_alone(group, together, "begin", alone)
        return lines

    def end(self) -> list[str]:
        """Calls after that."""
        lines = []
        for group in self.groups:
            types, seen = group.types, self._with_outputs(group)
            finish = {t.kind.key: self._once(f"finish_{t.kind.key}", self._finish(t)) for t in types}
            last = [t for t in seen if _is_continuous(t) or t.kind.stage == "advance"]
            together = [*self._moves(types, "1.0"), *self._outputs(seen, "0.0"), *self._rates(types, "1.0")]
            together += [*self._calls(types, finish), *self._outputs(last, "0.0")]
            alone = {t.kind.key: self._end_alone(t) for t in types}
            lines += self._together_or_alone(group, together, "end", alone)
        return lines

    def _with_outputs(self, group: _Coupled) -> list[TypeLayout]:
        both = [t for t in (*group.types, *group.between) if "outputs" in t.kind.kernels]
        return sorted(both, key=lambda t: STAGES.index(t.kind.stage))

    def _together_or_alone(
        self, group: _Coupled, together: list[str], name: str, alone: Mapping[str, list[str]]
    ) -> list[str]:
        """What is done in a step with all of a group, or with those alone that run when nothing else is due."""
        single = len(group.types) == 1 and not group.between and not self.itself & {group.types[0].kind.key}
        if single:
            return self._calls(group.types, self._alone(group.types, name, alone))
        every = [t for t in group.types if t.kind.key in self.every]
        seldom = [t for t in (*group.types, *group.between) if t not in every]
        if len(every) != 1 or self.itself & {every[0].kind.key} or any(t.kind.key in self.every for t in seldom):
            return together
        due = " or ".join(f"due[{self.due[t.kind.key]}] != 0" for t in seldom)
        rest = self._alone(every, name, alone).values()
        return [f"if {due}:", *(f"    {line}" for line in together), "else:", *(f"    {line}" for line in rest)]

    def _alone(self, types: list[TypeLayout], name: str, alone: Mapping[str, list[str]]) -> dict[str, str]:
        return {t.kind.key: self._once(f"{name}_{t.kind.key}", alone[t.kind.key], "t") for t in types}

    def _begin_alone(self, t: TypeLayout) -> list[str]:
        evaluate = self._evaluate(t, "0.5") if t.kind.key in self.to_network and "outputs" in t.kind.kernels else []
        return self._for_each(t, [*self._rate(t, "t"), *self._move(t, self._dt(t, "0.5"), keep=True), *evaluate])

    def _end_alone(self, t: TypeLayout) -> list[str]:
        evaluate = self._evaluate(t, "0.0") if "outputs" in t.kind.kernels else []
        period = "h" if t.kind.key in self.every else "clock_period[c]"
        moved = [*self._move(t, self._dt(t, "1.0")), *self._rate(t, f"t + {period}")]
        return self._for_each(t, [*moved, *self._correct(t, f"0.5 * {period}"), *evaluate])

    def _dt(self, t: TypeLayout, share: str) -> str:
        """Time by which a share of a component's period moves it on, half-way only if its period is the step."""
        if t.kind.key in self.every:
            return f"{share} * h"
        only = "" if share == "1.0" else " if clock_inc[c] == clock_den[c] else 0.0"
        return f"({share} * clock_period[c]{only})"

    def _for_each(self, t: TypeLayout, lines: list[str]) -> list[str]:
        return (_for_all if t.kind.key in self.every else _where_due)(t.kind.key, lines)

    def _rates(self, types: list[TypeLayout], late: str) -> list[str]:
        """Rates of types, at the start of what they are moved by, or at its end."""
        calls = {}
        for t in types:
            body = _where_due(t.kind.key, self._rate(t, "t + late * clock_period[c]"))
            calls[t.kind.key] = re.sub(r"\blate\b", late, self._once(f"rates_{t.kind.key}", body, "t", "late"))
        return self._calls(types, calls)

    def _moves(self, types: list[TypeLayout], share: str) -> list[str]:
        """Types moved on with their first rates: half-way for the network to see, then the whole way."""
        which, keep = ("on", False) if share == "1.0" else ("half", True)
        made = {}
        for t in types:
            body = _where_due(t.kind.key, self._move(t, self._dt(t, share), keep=keep))
            made[t.kind.key] = self._once(f"move_{t.kind.key}_{which}", body)
        return self._calls(types, made)

    def _outputs(self, types: list[TypeLayout], ahead: str) -> list[str]:
        """Outputs, what is smooth in the network carried on by a share of the last step."""
        made = {}
        for t in types:
            name = f"outputs_{t.kind.key}{'_half' if ahead != '0.0' else ''}"
            made[t.kind.key] = self._once(name, _where_due(t.kind.key, self._evaluate(t, ahead)), "t")
        return self._calls(types, made)

    def _finish(self, t: TypeLayout) -> list[str]:
        return _where_due(t.kind.key, self._correct(t, "0.5 * clock_period[c]"))

    # lines for one instance

    def _rate(self, t: TypeLayout, time: str) -> list[str]:
        kernel, key = t.kind.kernels["derivatives"], t.kind.key
        name = self.imported(kernel, f"{key}_derivatives")
        return [*_gather_lines(key, "now"), f"{name}({_pass(kernel, key, dx=f'{key}_c[i]', t=time)})"]

    def _move(self, t: TypeLayout, dt: str, *, keep: bool = False) -> list[str]:
        key = t.kind.key
        kept = [f"    {key}_af[i, j] = {key}_xf[i, j]", f"    {key}_bf[i, j] = {key}_cf[i, j]"] if keep else []
        return [
            f"for j in range({key}_xf.shape[1]):",
            *kept,
            f"    {key}_xf[i, j] = {key}_af[i, j] + {dt} * {key}_bf[i, j]",
            *self._limit(t),
        ]

    def _correct(self, t: TypeLayout, dt: str) -> list[str]:
        key = t.kind.key
        rates = f"({key}_bf[i, j] + {key}_cf[i, j])"
        return [
            f"for j in range({key}_xf.shape[1]):",
            f"    {key}_xf[i, j] = {key}_af[i, j] + {dt} * {rates}",
            *self._limit(t),
        ]

    def _evaluate(self, t: TypeLayout, ahead: str) -> list[str]:
        kernel, key = t.kind.kernels["outputs"], t.kind.key
        gather: list[str] = []
        if "u" in argument_names(kernel) and ahead == "0.0":
            gather = _gather_lines(key, "now")
        elif "u" in argument_names(kernel):
            part = ahead if key in self.every else f"{ahead} if clock_inc[c] == clock_den[c] else 0.0"
            gather = [f"part = {part}", *_gather_lines(key, "ahead", self.imported(wrap, "wrap"))]
        return [*gather, f"{self.imported(kernel, f'{key}_outputs')}({_pass(kernel, key)})"]

    def _limit(self, t: TypeLayout) -> list[str]:
        kernel, key = t.kind.kernels.get("limit"), t.kind.key
        return [] if kernel is None else [f"{self.imported(kernel, f'{key}_limit')}({_pass(kernel, key)})"]

    def _calls(self, types: list[TypeLayout], call: Mapping[str, str]) -> list[str]:
        return [line for t in types for line in (f"if due[{self.due[t.kind.key]}] != 0:", f"    {call[t.kind.key]}")]

    def _once(self, name: str, body: list[str], *given: str) -> str:
        """Call of a function that is made when it is first asked for."""
        if name not in self.made:
            self.made[name] = self.function(name, body, *given)
        return self.made[name]


def _is_continuous(t: TypeLayout) -> bool:
    return "derivatives" in t.kind.kernels and not t.kind.terminals


def _placed(plan: Plan, t: TypeLayout) -> list[Placed]:
    """All instances of a type in a plant, also where the plan itself has none since it is cut."""
    return [placed for placed in plan.network.placed.values() if type_of(placed.item) is t.kind]


def _without_states(kind: ComponentType) -> bool:
    """Whether all that a signal component does is to compute outputs from its inputs."""
    return set(kind.kernels) & {"outputs", "update", "modulate", "derivatives"} == {"outputs"} and not kind.terminals


def _chain(plan: Plan, first: Iterable[Placed]) -> tuple[set[str], set[str]]:
    """Keys of the continuous types that components read, and of the types without states in between."""
    placed_of = plan.network.placed
    continuous: set[str] = set()
    between: set[str] = set()
    asked, seen = list(first), set()
    while asked:
        for source in asked.pop().inputs.values():
            owner = _owner(source, placed_of)
            if owner is None or owner in seen:
                continue
            seen.add(owner)
            kind = type_of(placed_of[owner].item)
            if "derivatives" in kind.kernels and not kind.terminals:
                continuous.add(kind.key)
            elif _without_states(kind):
                between.add(kind.key)
                asked.append(placed_of[owner])
    return continuous, between


def _read_by_network(plan: Plan) -> set[str]:
    """Keys of the types whose outputs elements read, by themselves or over types without states."""
    elements = [placed for placed in plan.network.placed.values() if type_of(placed.item).terminals]
    _, between = _chain(plan, elements)
    readers = [*elements, *(p for p in plan.network.placed.values() if type_of(p.item).key in between)]
    owners = {
        _owner(source, plan.network.placed)
        for placed in readers
        for source in placed.inputs.values()
        if source not in plan.layout.states
    }
    return {type_of(plan.network.placed[owner].item).key for owner in owners if owner}


def _coupled(plan: Plan, ordered: list[TypeLayout]) -> tuple[list[_Coupled], set[str]]:
    """Continuous types in groups, no two of which read each other; and keys of those that read themselves directly."""
    types = [t for t in ordered if _is_continuous(t)]
    read = {t.kind.key: _chain(plan, _placed(plan, t)) for t in types}
    groups: list[set[str]] = []
    for key, (continuous, _) in read.items():
        met = [group for group in groups if group & ({key} | continuous)]
        groups = [group for group in groups if group not in met] + [set.union({key}, continuous, *met)]
    found = []
    for group in groups:
        between = set.union(*(read[key][1] for key in group))
        found.append(_Coupled([t for t in types if t.kind.key in group], [t for t in ordered if t.kind.key in between]))
    owners = {
        key: {_owner(source, plan.network.placed) for source in sources} for key, sources in _sources(plan).items()
    }
    kinds = {path: type_of(placed.item).key for path, placed in plan.network.placed.items()}
    return found, {key for key in read if any(kinds.get(owner or "") == key for owner in owners[key])}


def _sources(plan: Plan) -> dict[str, list[object]]:
    """What the components of each type read, by the type's key."""
    found: dict[str, list[object]] = {}
    for placed in plan.network.placed.values():
        found.setdefault(type_of(placed.item).key, []).extend(placed.inputs.values())
    return found


def _owner(source: object, placed_of: Mapping[str, Any]) -> str | None:
    """Path of the component that a signal is of."""
    if not isinstance(source, str):
        return None
    parts = source.split(".")
    return next((o for k in range(len(parts) - 1, 0, -1) if (o := ".".join(parts[:k])) in placed_of), None)


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
        return [*_gather_lines(t.kind.key, "now"), *_copy(t.kind.key, "a", "x")]

    def stamp(t: TypeLayout) -> list[str]:
        name = imported(t.kind.kernels["stamp"], f"{t.kind.key}_stamp")
        return [f"{name}({_pass(t.kind.kernels['stamp'], t.kind.key, x=f'{t.kind.key}_b[i]')})"]

    def first(t: TypeLayout) -> list[str]:
        return [*_copy(t.kind.key, "b", "a"), *stamp(t)]

    def second(t: TypeLayout) -> list[str]:
        key = t.kind.key
        start = f"{key}_bf[i, j] = {key}_af[i, j] + nodal.KAPPA * ({key}_xf[i, j] - {key}_af[i, j])"
        return [f"for j in range({key}_xf.shape[1]):", f"    {start}", *stamp(t)]

    def advance(t: TypeLayout) -> list[str]:
        key = t.kind.key
        name = imported(t.kind.kernels["advance"], f"{key}_advance")
        return [f"{name}({_pass(t.kind.kernels['advance'], key, x=f'{key}_b[i]', x_next=f'{key}_x[i]')})"]

    def finish(t: TypeLayout) -> list[str]:
        lines = []
        for ending in ("limit", "outputs"):
            if ending in t.kind.kernels:
                name = imported(t.kind.kernels[ending], f"{t.kind.key}_{ending}")
                lines.append(f"{name}({_pass(t.kind.kernels[ending], t.kind.key)})")
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
        (ledger, f"{key}_weight[i] * {imported(kernel, f'{key}_{ledger}')}({_pass(kernel, key)})")
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
            owner = _owner(source, placed_of)
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
