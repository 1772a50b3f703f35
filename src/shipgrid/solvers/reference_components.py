"""Components of the reference solver: their kernels uncompiled, on plain Python objects."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from shipgrid.assembly.layout import TypeLayout
from shipgrid.assembly.plan import Plan
from shipgrid.model.kernel import uncompiled
from shipgrid.model.records import PlainRecord, names_of, parameter_dtype


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
        self.records = {key: PlainRecord(names_of(record), np.float64(0.0)) for key, record in records.items()}
        p = PlainRecord(parameter_dtype(kind.cls).names or (), np.float64(0.0))
        p.write(t.parameters[k * len(p.names) : (k + 1) * len(p.names)])
        self.values: dict[str, Any] = {key: record.top for key, record in self.records.items()}
        self.values |= {"p": p.top, "tables": plan.step.tables, "delays": delays, "t": 0.0}
        self.kernels = {}
        for name, kernel in kind.kernels.items():
            function = uncompiled(kernel)
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
