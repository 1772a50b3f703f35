"""Components of the reference solver: their kernels uncompiled, on plain Python objects."""

from __future__ import annotations

import types
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np

from shipgrid.assembly.layout import TypeLayout
from shipgrid.assembly.plan import Plan
from shipgrid.model.records import names_of, parameter_dtype


@cache
def plain_function(function: Any) -> Any:
    """A kernel as a plain Python function that calls plain Python functions.

    Parameters
    ----------
    function : kernel
    """
    plain = getattr(function, "py_func", function)
    around = dict(plain.__globals__)
    for name in plain.__code__.co_names:
        if hasattr(around.get(name), "py_func"):
            around[name] = plain_function(around[name])
    return types.FunctionType(plain.__code__, around, plain.__name__, plain.__defaults__, plain.__closure__)


class Record:
    """Named numbers on plain Python objects, the blocks nested, in the order of the flat vector.

    Parameters
    ----------
    names : sequence of str
        Blocks before their fields, with points between them.
    """

    def __init__(self, names: Sequence[str]):
        self.top = types.SimpleNamespace()
        self.flat = not any("." in name for name in names)
        self.names = list(names)
        self.slots = []
        for name in names:
            *blocks, last = name.split(".")
            owner = self.top
            for block in blocks:
                if not hasattr(owner, block):
                    setattr(owner, block, types.SimpleNamespace())
                owner = getattr(owner, block)
            self.slots.append((owner.__dict__, last))
            setattr(owner, last, np.float64(0.0))

    def write(self, values: Iterable[Any]) -> None:
        """Put numbers in.

        Parameters
        ----------
        values : iterable of number
            In the order of the names.
        """
        if self.flat:
            self.top.__dict__.update(zip(self.names, values, strict=True))
        else:
            for (owner, name), value in zip(self.slots, values, strict=True):
                owner[name] = value

    def read(self) -> list[Any]:
        """The numbers, in the order of the names."""
        return [owner[name] for owner, name in self.slots]


class Instance:
    """One component in its place: its records, and its kernels called with them.

    Parameters
    ----------
    plan : Plan
    t : TypeLayout
        Its type.
    k : int
        Which of the type's instances it is.
    delays : ndarray
        Cells of all delay lines.
    """

    def __init__(self, plan: Plan, t: TypeLayout, k: int, delays: np.ndarray):
        kind = t.kind
        self.type, self.number, self.placed = t, k, t.placed[k]
        self.path = self.placed.path
        self.xs = slice(t.x + k * t.nx, t.x + (k + 1) * t.nx)
        self.us = slice(t.u + k * t.nu, t.u + (k + 1) * t.nu)
        self.ys = slice(t.y + k * t.ny, t.y + (k + 1) * t.ny)
        self.clock = int(plan.clock_of[kind.key][k])
        records = {"x": kind.state, "u": kind.input, "y": kind.output, "dx": kind.state, "x_next": kind.state}
        self.records = {key: Record(names_of(record)) for key, record in records.items()}
        p = Record(parameter_dtype(kind.cls).names or ())
        p.write(t.parameters[k * len(p.names) : (k + 1) * len(p.names)])
        self.values: dict[str, Any] = {key: record.top for key, record in self.records.items()}
        self.values |= {"p": p.top, "tables": plan.step.tables, "delays": delays, "t": 0.0}
        self.kernels = {}
        for name, kernel in kind.kernels.items():
            function = plain_function(kernel)
            self.kernels[name] = (function, function.__code__.co_varnames[: function.__code__.co_argcount])
        if not kind.linear:
            gather = plan.gathers[kind.key]
            cut = {
                name: gather[name][gather[f"{name}_start"][k] : gather[f"{name}_start"][k + 1]]
                for name in ("measured", "latest")
            }
            self.measured, self.latest = cut["measured"], cut["latest"]
            self.turns = np.isin(self.measured[:, 1], list(plan.layout.angles))  # of these the short way round
            both = np.concatenate([self.measured, self.latest])
            self.to, self.source = both[:, 0], both[:, 1]

    def gather(self, sig: np.ndarray) -> None:
        """Take what its inputs read into their places.

        Parameters
        ----------
        sig : ndarray
            The flat vector, changed in place.
        """
        sig[self.to] = sig[self.source]

    def read(self, sig: np.ndarray, parts: str = "xuy") -> None:
        """Fill records from the flat vector.

        Parameters
        ----------
        sig : ndarray
        parts : str
            Which: states x, inputs u, outputs y.
        """
        for part in parts:
            self.records[part].write(sig[getattr(self, part + "s")])

    def call(self, name: str, **extra: Any) -> Any:
        """Call a kernel with the records.

        Parameters
        ----------
        name : str
        **extra : Any
            Further arguments by name, time for instance; they stay for later calls.
        """
        function, names = self.kernels[name]
        self.values.update(extra)
        return function(*[self.values[n] for n in names])


def state_places(instances: Iterable[Instance]) -> list[int]:
    """Places of the states of components.

    Parameters
    ----------
    instances : iterable of Instance
    """
    return [k for i in instances for k in range(i.xs.start, i.xs.stop)]
