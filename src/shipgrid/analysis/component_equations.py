"""What one component says at a point: its kernels called uncompiled, on complex records, and their derivatives.

A complex step in one state or input, far below rounding, gives the derivative by it exactly: a kernel is called once
for each of them, and once for the values.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from shipgrid.assembly.layout import TypeLayout
from shipgrid.assembly.plan import Plan
from shipgrid.errors import SteadyStateError
from shipgrid.model.kernel import argument_names, reads_time, uncompiled
from shipgrid.model.records import names_of, parameter_dtype

COMPLEX_STEP = 1e-40
PROBE = 1e-9
"""Time [s] by which a state is moved on to see whether a limiter holds it."""


class _Line:
    """A delay line whose content is one value: what a kernel sees of it at rest."""

    def __init__(self, value: complex):
        self.value = value

    def __getitem__(self, _: Any) -> complex:
        return self.value

    def __setitem__(self, _: Any, __: Any) -> None:
        """What is written comes out later, by the dead time that stands beside."""


@dataclass
class Block:
    """What one component says at a point: values and derivatives of its equations.

    Attributes
    ----------
    path : str
    sampled : bool
        `rate` is then the next state, not the rate of change.
    period : float
        Sampling period [s].
    x, y, u : ndarray of int
        Places of states, outputs and inputs.
    rate, output : ndarray
    by_rate, by_output : ndarray
        Derivatives by states and inputs, in this order.
    held : ndarray of bool
        States that a limiter holds.
    """

    path: str
    sampled: bool
    period: float
    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    rate: np.ndarray
    output: np.ndarray
    by_rate: np.ndarray
    by_output: np.ndarray
    held: np.ndarray

    @property
    def columns(self) -> np.ndarray:
        """Places of what it is differentiated by."""
        return np.concatenate([self.x, self.u])


class _Record:
    """Named numbers on plain objects, blocks nested: for a kernel that runs uncompiled much faster than a recarray."""

    def __init__(self, names: list[str]):
        self.top = SimpleNamespace()
        self.slots: list[tuple[dict[str, Any], str]] = []
        for name in names:
            *blocks, last = name.split(".")
            owner = self.top
            for block in blocks:
                if not hasattr(owner, block):
                    setattr(owner, block, SimpleNamespace())
                owner = getattr(owner, block)
            self.slots.append((vars(owner), last))
        self.write(np.zeros(len(names), dtype=complex))

    def write(self, values: np.ndarray) -> None:
        for (owner, name), value in zip(self.slots, values, strict=True):
            owner[name] = value

    def read(self) -> np.ndarray:
        return np.array([owner[name] for owner, name in self.slots], dtype=complex)


class ComponentKernels:
    """One component's kernels on complex records of its own.

    Parameters
    ----------
    plan : Plan
    t : TypeLayout
        Of the component's type.
    k : int
        Number of the component in its type.

    Attributes
    ----------
    x, y, u : ndarray of int
        Places of states, outputs and inputs.
    parameters : SimpleNamespace
    clock : int
        Number of its clock.
    period : float
        Sampling period [s].
    sampled : bool
        It has next states, not rates.
    late : dict of int to float
        Dead time [s] of the inputs that have one, by their number.

    Raises
    ------
    SteadyStateError
        If a kernel reads the time.
    """

    def __init__(self, plan: Plan, t: TypeLayout, k: int):
        kind, placed = t.kind, t.placed[k]
        self.plan, self.kind, self.path = plan, kind, placed.path
        self.clock = int(plan.clock_of[kind.key][k])
        self.period = float(plan.periods[self.clock])
        self.x = np.arange(t.x + k * t.nx, t.x + (k + 1) * t.nx)
        self.u = np.arange(t.u + k * t.nu, t.u + (k + 1) * t.nu)
        self.y = np.arange(t.y + k * t.ny, t.y + (k + 1) * t.ny)
        parts = {"x": kind.state, "x_next": kind.state, "dx": kind.state, "u": kind.input, "y": kind.output}
        self.named = {name: _Record(names_of(record)) for name, record in parts.items()}
        width = len(t.parameters) // len(t.placed)
        p = _Record(list(parameter_dtype(kind.cls).names or ()))
        p.write(t.parameters[k * width : (k + 1) * width].astype(complex))
        self.parameters = p.top
        self.records: dict[str, Any] = {name: record.top for name, record in self.named.items()}
        self.records |= {"t": 0.0, "dt": self.period, "tables": plan.step.tables, "p": p.top}
        self.sampled = "update" in kind.kernels
        reads = [name for name in ("derivatives", "outputs", "update") if reads_time(kind.kernels.get(name))]
        if reads:
            raise SteadyStateError(
                f"no operating point: '{self.path}' ({kind.name}) reads the time in `{reads[0]}`; "
                "expected a state in its place, for an angle one that `rotates`"
            )
        late = getattr(placed.item, "dead_times", dict)()
        names = names_of(kind.input)
        self.late = {names.index(name): seconds for name, seconds in late.items()}

    def _call(self, name: str) -> None:
        kernel = self.kind.kernels[name]
        uncompiled(kernel)(*[self.records[argument] for argument in argument_names(kernel)])

    def evaluate(self, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates (or next states) and outputs.

        Parameters
        ----------
        x, u, y : ndarray of complex
            States, inputs, and outputs so far.
        """
        named = self.named
        named["x"].write(x)
        named["u"].write(u)
        named["y"].write(y)
        if self.late:
            self.records["delays"] = _Line(u[next(iter(self.late))])
        kernels = self.kind.kernels
        rate = np.zeros(0, dtype=complex)
        if self.sampled:
            named["x_next"].write(x)
            self._call("update")
            rate = named["x_next"].read()
            named["x"].write(rate)  # outputs, where there are any beside, are those of the new state
        elif "derivatives" in kernels:
            named["dx"].write(0.0 * x)
            self._call("derivatives")
            rate = named["dx"].read()
        if "outputs" in kernels:
            self._call("outputs")
        return rate, named["y"].read()

    def limited(self, x: np.ndarray, u: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Which states the limiter holds: a moment on, it makes them the same whatever they are.

        Parameters
        ----------
        x, u, rate : ndarray
            States, inputs, and rates of the states.
        """
        held = np.zeros(len(x), dtype=bool)
        if "limit" not in self.kind.kernels or self.sampled:
            return held
        base = x + PROBE * rate
        for k in range(len(x)):
            stepped = base.astype(complex)
            stepped[k] += 1j * COMPLEX_STEP
            self.named["x"].write(stepped)
            self.named["u"].write(u.astype(complex))
            self._call("limit")
            held[k] = not self.named["x"].read()[k].imag
        return held

    def block(self, sig: np.ndarray, alias: np.ndarray) -> Block:
        """Values and derivatives at a point.

        Parameters
        ----------
        sig : ndarray
            All signals.
        alias : ndarray of int
            Place of the signal that each place sees.
        """
        x, y = sig[self.x], sig[self.y]
        source = alias[self.u]
        u = sig[source]
        y = y.astype(complex)
        rate, output = self.evaluate(x.astype(complex), u.astype(complex), y)
        n, m = len(x), len(u)
        by_rate, by_output = np.zeros((len(rate), n + m)), np.zeros((len(output), n + m))
        for k in range(n + m):
            xs, us = x.astype(complex), u.astype(complex)
            (xs if k < n else us)[k if k < n else k - n] += 1j * COMPLEX_STEP
            stepped_rate, stepped_output = self.evaluate(xs, us, y)
            by_rate[:, k] = np.imag(stepped_rate) / COMPLEX_STEP
            by_output[:, k] = np.imag(stepped_output) / COMPLEX_STEP
        held = self.limited(x, u, np.real(rate)) if len(rate) else np.zeros(n, dtype=bool)
        return Block(
            self.path, self.sampled, self.period, self.x, self.y, self.u,
            np.real(rate), np.real(output), by_rate, by_output, held,
        )  # fmt: skip
