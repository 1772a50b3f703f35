"""Writes the source of a unit: everything that the step and the analyses ask of one component type, in one function.

A unit loops over all instances of its type. It depends on the type alone: how many instances there are, their
parameters, connections and clocks are contents of arrays, which it finds in a table (`unit_arrays`). So a type is
compiled once, whatever ship it sails in (docs/decisions/0023-units.md).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from shipgrid.assembly.layout import NORTON_FIELDS
from shipgrid.model.component import ComponentType
from shipgrid.model.kernel import PLACE, argument_names
from shipgrid.model.ops import wrap
from shipgrid.model.records import parameter_dtype, record_dtype, size_of

LEDGERS = ("losses", "supplied", "consumed")
"""Kernels that give a power [W], each with a ledger of the energy audit."""

OPERATIONS = (
    # of a signal component
    "run",  # a sampled one: update, outputs
    "modulate",
    "begin_alone",  # a continuous one that is coupled with no other: before the network is stepped, and after
    "end_alone",
    "first_rates",  # the steps of Heun's rule by themselves, for those that are
    "last_rates",
    "move_half",
    "move",
    "correct",
    "outputs",
    "outputs_ahead",
    # of a machine, within the stages of the network
    "begin",
    "first_stamp",
    "advance",
    "second_stamp",
    "finish",
    # of all that have a ledger
    "book_first_stage",
    "book_second_stage",
    "book",
)
"""What a unit can be asked for; its first argument is the place in this list."""

OPERATION = {name: number for number, name in enumerate(OPERATIONS)}

NORTON = np.dtype((np.record, [(name, "f8") for name in NORTON_FIELDS]))
"""Record of a machine's Norton equivalent."""

SHARED = {
    "sig": ("f8", 1),
    "previous": ("f8", 1),
    "lead": ("f8", 1),
    "clock_before": ("f8", 1),
    "clock_ahead": ("f8", 1),
    "clock_phase": ("i8", 1),
    "clock_inc": (PLACE, 1),
    "clock_den": (PLACE, 1),
    "clock_period": ("f8", 1),
    "tables": ("f8", 1),
    "delays": ("f8", 1),
    "energy": ("f8", 1),
    "stage_power": ("f8", 1),
    "exchanged": ("f8", 1),
}
"""Arrays of the plant that every unit finds in its table, with their element and number of dimensions."""

GATHERS = {
    "now_start": 1,
    "now": 2,
    "measured_start": 1,
    "measured_smooth": 1,
    "measured_turn": 1,
    "measured": 2,
    "measured_lead": 1,
    "latest_start": 1,
    "latest": 2,
}
"""Arrays of places that say where the inputs of each instance come from (`Plan.gathers`), with their dimensions."""

STATES = {"x": "state", "start": "at the step's start", "stage": "where the stage starts", "rate": "its rates"}
"""Copies of the states of all instances; each is there as records and, with `_flat` in its name, as a matrix."""


def unit_arrays(kind: ComponentType) -> dict[str, tuple[Any, int]]:
    """Arrays in the table of a unit, in their order: element type and number of dimensions of each.

    Parameters
    ----------
    kind : ComponentType
    """
    found: dict[str, tuple[Any, int]] = {name: (np.dtype(element), ndim) for name, (element, ndim) in SHARED.items()}
    found["place_in_books"] = np.dtype("i8"), 1  # first entry of `energy`
    found["clock"] = np.dtype(PLACE), 1
    found["weight"] = np.dtype("f8"), 1
    if size_of(kind.state):
        for name in STATES:
            found[name] = record_dtype(kind.state), 1
            found[f"{name}_flat"] = np.dtype("f8"), 2
    for name, record in (("u", kind.input), ("y", kind.output)):
        if size_of(record):
            found[name] = record_dtype(record), 1
    if parameter_dtype(kind.cls).names:
        found["p"] = parameter_dtype(kind.cls), 1
    if kind.stamped:
        found["n"] = NORTON, 1
    if not kind.linear:
        found |= {name: (np.dtype(PLACE), ndim) for name, ndim in GATHERS.items()}
    return found


def operations(kind: ComponentType) -> dict[str, tuple[str, list[str]]]:
    """Operations of a type's unit: the function that does each, and what it is called with beside table, t, h and gh.

    Parameters
    ----------
    kind : ComponentType
    """
    kernels = kind.kernels
    found: dict[str, tuple[str, list[str]]] = {}

    def offer(*names: str) -> None:
        found.update({name: (name, []) for name in names})

    if is_continuous(kind):
        found["first_rates"] = "rates", ["0.0"]
        found["last_rates"] = "rates", ["1.0"]
        offer("move_half", "move", "correct", *(["outputs", "outputs_ahead"] if "outputs" in kernels else []))
    elif kind.stage != "network" and not kind.terminals:
        if "modulate" in kernels:
            offer("modulate")
        elif "update" in kernels:
            offer("run")
        elif "outputs" in kernels:
            offer("run", "outputs_ahead")
            found["outputs"] = found["run"]
    if kind.stamped:
        offer("begin", "first_stamp", "advance", "second_stamp", "finish")
    if any(ledger in kernels for ledger in LEDGERS):
        if kind.terminals:
            found["book_first_stage"] = "book_stage", ["True", "1.0 - GAMMA"]
            found["book_second_stage"] = "book_stage", ["False", "GAMMA"]
        offer("book")  # in the place of `gh` the period of the audit
    return found


def is_continuous(kind: ComponentType) -> bool:
    """Whether a type has rates that are integrated beside the network."""
    return "derivatives" in kind.kernels and not kind.terminals


def together(kind: ComponentType, operation: str) -> list[str]:
    """What the operations `begin_alone` and `end_alone` of a continuous type consist of; else the operation itself."""
    if operation == "begin_alone":
        return ["first_rates", "move_half"]
    if operation == "end_alone":
        return ["move", "last_rates", "correct", *(["outputs"] if "outputs" in kind.kernels else [])]
    return [operation]


def unit_text(kind: ComponentType) -> str:
    """Source of a type's unit; empty if nothing is ever asked of it.

    Parameters
    ----------
    kind : ComponentType
    """
    return _Unit(kind).text()


class _Unit:
    """The source of one unit while it is written."""

    def __init__(self, kind: ComponentType):
        self.kind = kind
        self.arrays = unit_arrays(kind)
        self.places = dict(zip(self.arrays, table_places(self.arrays), strict=True))
        self.imports: dict[tuple[str, str], str] = {}
        self.views: dict[tuple[str, int], str] = {}

    def text(self) -> str:
        offered = operations(self.kind)
        if not offered:
            return ""
        functions = [line for name in dict.fromkeys(n for n, _ in offered.values()) for line in self._function(name)]
        asked = [*offered, *(["begin_alone", "end_alone"] if is_continuous(self.kind) else [])]
        entry = ["", "", "@kernel", "def unit(operation, table, t, h, gh):"]
        for k, name in enumerate(asked):
            entry.append(f"    {'el' if k else ''}if operation == {OPERATION[name]}:  # {name}")
            for step in together(self.kind, name):
                function, values = offered[step]
                entry.append(f"        {function}({', '.join(['table', 't', 'h', 'gh', *values])})")
        return "\n".join(
            [
                f'"""Unit of {self.kind.cls.__module__}.{self.kind.name}, written by shipgrid. Do not edit."""',
                "from shipgrid.model.kernel import array_view, inlined, kernel",
                "from shipgrid.solvers.companion import GAMMA, KAPPA",
                *(f"from {module} import {name} as {label}" for (module, name), label in self.imports.items()),
                "",
                *(f"{name} = array_view({element}, {ndim})" for (element, ndim), name in self.views.items()),
                *functions,
                *entry,
                "",
            ]
        )

    def _function(self, name: str) -> list[str]:
        given = {"rates": ", late", "book_stage": ", first, share"}.get(name, "")
        body = getattr(self, f"_{name}")()
        head = f"def {name}(table, t, h, gh{given}):"
        return ["", "", "@inlined", head, *(f"    {line}" for line in [*self._views_in(body), *body])]

    def _views_in(self, body: Sequence[str]) -> list[str]:
        """Lines that find the arrays that a function names."""
        used = set(re.findall(r"(?<![.\w])[A-Za-z_]\w*", "\n".join(body)))
        found = []
        for name in (name for name in self.arrays if name in used):
            element, ndim = self.arrays[name]
            view = repr(element.descr if element.names else element.str), ndim
            label = self.views.setdefault(view, f"view_{len(self.views)}")
            found.append(f"{name} = {label}(table, {self.places[name]})")
        return found

    def _imported(self, kernel: Any, label: str) -> str:
        function = getattr(kernel, "py_func", kernel)
        return self.imports.setdefault((function.__module__, function.__name__), label)

    def _call(self, name: str, **values: str) -> str:
        """Call of one of the type's kernels for instance `i`."""
        kernel = self.kind.kernels[name]
        return f"{self._imported(kernel, f'kernel_{name}')}({pass_to(kernel, **values)})"

    # bodies of functions

    def _run(self) -> list[str]:
        kernels = self.kind.kernels
        inner = self._gather("sampled") if "update" in kernels else self._gather("now")
        if "update" in kernels:
            states = size_of(self.kind.state)
            inner += _copy("start", "x") if states else []
            inner.append(self._call("update", t="t - (1.0 - f) * h", dt="clock_period[c]", x_next="start[i]"))
            inner += _copy("x", "start") if states else []
        if "outputs" in kernels:
            inner.append(self._call("outputs"))
        return _where_due(inner)

    def _modulate(self) -> list[str]:
        # of the clock, in periods: a step's end is the very number at which the next one starts
        begun = "(clock_phase[c] - clock_inc[c] + (clock_den[c] if clock_ahead[c] >= 0.0 else 0)) / clock_den[c]"
        phases = [f"phase = {begun}", "phase_next = clock_phase[c] / clock_den[c]"]
        takes = "phase" in argument_names(self.kind.kernels["modulate"])
        call = self._call("modulate", dt="h", fraction="clock_ahead[c]", phase="phase", phase_next="phase_next")
        return _for_all(["c = clock[i]", *self._gather("now"), *(phases if takes else []), call])

    def _rates(self) -> list[str]:
        call = self._call("derivatives", dx="rate[i]", t="t + late * clock_period[c]")
        return _where_due([*self._gather("now"), call])

    def _move_half(self) -> list[str]:
        # half-way for the network to see, but for a component with a longer period, which is seen as it was
        share = "(0.5 * clock_period[c] if clock_inc[c] == clock_den[c] else 0.0)"
        keep = ["    start_flat[i, j] = x_flat[i, j]", "    stage_flat[i, j] = rate_flat[i, j]"]
        moved = f"    x_flat[i, j] = start_flat[i, j] + {share} * stage_flat[i, j]"
        return _where_due(["for j in range(x_flat.shape[1]):", *keep, moved, *self._limit()])

    def _move(self) -> list[str]:
        moved = "    x_flat[i, j] = start_flat[i, j] + clock_period[c] * stage_flat[i, j]"
        return _where_due(["for j in range(x_flat.shape[1]):", moved, *self._limit()])

    def _correct(self) -> list[str]:
        rates = "(stage_flat[i, j] + rate_flat[i, j])"
        moved = f"    x_flat[i, j] = start_flat[i, j] + 0.5 * clock_period[c] * {rates}"
        return _where_due(["for j in range(x_flat.shape[1]):", moved, *self._limit()])

    def _outputs(self) -> list[str]:
        reads = "u" in argument_names(self.kind.kernels["outputs"])
        return _where_due([*(self._gather("now") if reads else []), self._call("outputs")])

    def _outputs_ahead(self) -> list[str]:
        reads = "u" in argument_names(self.kind.kernels["outputs"])
        part = "part = 0.5 if clock_inc[c] == clock_den[c] else 0.0"
        return _where_due([*([part, *self._gather("ahead")] if reads else []), self._call("outputs")])

    def _begin(self) -> list[str]:
        return _for_all([*self._gather("now"), *_copy("start", "x")])

    def _first_stamp(self) -> list[str]:
        return _for_all([*_copy("stage", "start"), self._call("stamp", x="stage[i]")])

    def _second_stamp(self) -> list[str]:
        start = "    stage_flat[i, j] = start_flat[i, j] + KAPPA * (x_flat[i, j] - start_flat[i, j])"
        return _for_all(["for j in range(x_flat.shape[1]):", start, self._call("stamp", x="stage[i]")])

    def _advance(self) -> list[str]:
        return _for_all([self._call("advance", x="stage[i]", x_next="x[i]")])

    def _finish(self) -> list[str]:
        endings = [name for name in ("limit", "outputs") if name in self.kind.kernels]
        return _for_all([self._call(name) for name in endings] or ["pass"])

    def _book_stage(self) -> list[str]:
        """A stage's share of the mean power of the step."""
        lines = ["e = place_in_books[0]"]
        for power in self._powers():
            add = "stage_power[e + i] = watt if first else stage_power[e + i] + watt"
            lines += [*_for_all([f"watt = share * {power}", add]), "e += clock.shape[0]"]
        return lines

    def _book(self) -> list[str]:
        """Powers added to the ledgers: of an element the mean of the step, of a signal component the power now."""
        lines = ["e = place_in_books[0]"]
        ledgers = [ledger for ledger in LEDGERS if ledger in self.kind.kernels]
        for ledger, power in zip(ledgers, self._powers(), strict=True):
            watt = "stage_power[e + i]" if self.kind.terminals else power
            exchanged = ["exchanged[0] += abs(joule)"] if ledger == "supplied" else []
            joule = f"joule = gh * {watt}"
            lines += [*_for_all([joule, "energy[e + i] += joule", *exchanged]), "e += clock.shape[0]"]
        return lines

    def _powers(self) -> list[str]:
        return [f"weight[i] * {self._call(ledger)}" for ledger in LEDGERS if ledger in self.kind.kernels]

    def _limit(self) -> list[str]:
        return [self._call("limit")] if "limit" in self.kind.kernels else []

    def _gather(self, at: str) -> list[str]:
        """Lines that hand instance `i` its inputs.

        Parameters
        ----------
        at : {"now", "sampled", "ahead"}
            All as they are; what is measured at the fraction `f` of the last step; what is smooth carried on by the
            share `part` of a step. An angle goes the short way round.
        """
        now = ["for j in range(now_start[i], now_start[i + 1]):", "    sig[now[j, 0]] = sig[now[j, 1]]"]
        if at == "now":
            return now
        turned = self._imported(wrap, "wrap")
        latest = [
            "for j in range(latest_start[i], latest_start[i + 1]):",
            "    sig[latest[j, 0]] = sig[latest[j, 1]]",
        ]
        if at == "ahead":
            return [
                *latest,
                "for j in range(measured_start[i], measured_smooth[i]):",
                "    sig[measured[j, 0]] = sig[measured[j, 1]]",
                "for j in range(measured_smooth[i], measured_turn[i]):",
                "    after = sig[measured[j, 1]]",
                "    sig[measured[j, 0]] = after + part * (after - previous[measured[j, 1]])",
                "for j in range(measured_turn[i], measured_start[i + 1]):",
                "    after = sig[measured[j, 1]]",
                f"    sig[measured[j, 0]] = {turned}(after + part * {turned}(after - previous[measured[j, 1]]))",
            ]
        between = [
            *latest,
            "for j in range(measured_start[i], measured_turn[i]):",
            "    before = previous[measured[j, 1]]",
            "    after = sig[measured[j, 1]]",
            "    sig[measured[j, 0]] = before + f * (after - before) + lead[measured_lead[j]]",
            "for j in range(measured_turn[i], measured_start[i + 1]):",
            "    before = previous[measured[j, 1]]",
            "    after = sig[measured[j, 1]]",
            f"    sig[measured[j, 0]] = {turned}(before + f * {turned}(after - before))",
        ]
        return ["if f == 1.0:", *_indented(now), "else:", *_indented(between)]


def table_places(arrays: dict[str, tuple[Any, int]]) -> list[int]:
    """Where the entry of each array begins: an address and its shape, one after the other."""
    places, at = [], 0
    for _, ndim in arrays.values():
        places.append(at)
        at += 1 + ndim
    return places


def pass_to(kernel: Callable[..., Any], **values: str) -> str:
    """Arguments of a call of a component's kernel, for instance `i` of its type.

    Parameters
    ----------
    kernel : function
    values : str
        What stands for arguments that depend on where it is called.

    Raises
    ------
    TypeError
        If it has an argument that nothing stands for.
    """
    known = {name: name for name in ("t", "gh", "tables", "delays")} | {name: f"{name}[i]" for name in "xuypn"}
    known |= values
    names = argument_names(kernel)
    missing = [name for name in names if name not in known]
    if missing:
        function = getattr(kernel, "py_func", kernel)
        raise TypeError(
            f"kernel {function.__module__}.{function.__name__} asks for unknown arguments {missing}, "
            f"expected some of {sorted(known)}"
        )
    return ", ".join(known[name] for name in names)


def _copy(to: str, origin: str) -> list[str]:
    return ["for j in range(x_flat.shape[1]):", f"    {to}_flat[i, j] = {origin}_flat[i, j]"]


def _for_all(lines: Sequence[str]) -> list[str]:
    """Lines for each instance."""
    return ["for i in range(clock.shape[0]):", *_indented(lines)]


def _where_due(lines: Sequence[str]) -> list[str]:
    """Lines for each instance whose clock struck, at the fraction `f` of the last step."""
    return _for_all(["c = clock[i]", "f = clock_before[c]", "if f >= 0.0:", *_indented(lines)])


def _indented(lines: Sequence[str]) -> list[str]:
    return [f"    {line}" for line in lines]
