"""What one component says at a point: its kernels called uncompiled, on complex records, and their derivatives.

A complex step in one state or input, far below rounding, gives the derivative by it exactly: a kernel is called once
for each of them, and once for the values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipgrid.assembly.layout import TypeLayout
from shipgrid.assembly.plan import Plan
from shipgrid.errors import SteadyStateError
from shipgrid.model.kernel import argument_names, reads_time, uncompiled
from shipgrid.model.records import COMPLEX_STEP, PlainRecord, names_of, parameter_dtype

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


def _stepped(values: np.ndarray, k: int) -> np.ndarray:
    """Complex numbers, the one at `k` moved by the complex step."""
    found = values.astype(complex)
    found[k] += 1j * COMPLEX_STEP
    return found


def _slope(values: np.ndarray) -> np.ndarray:
    """Derivatives by what was moved."""
    return np.imag(values) / COMPLEX_STEP


class ComponentKernels:
    """One component's kernels on complex records of its own.

    Parameters
    ----------
    plan : Plan
    t : TypeLayout
        Of the component's type.
    k : int
        Number of the component in its type.
    delays : ndarray, optional
        Content of the plan's delay lines; if left out each line of the component holds what goes into it.

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
    """

    def __init__(self, plan: Plan, t: TypeLayout, k: int, delays: np.ndarray | None = None):
        kind, placed = t.kind, t.placed[k]
        self.kind, self.path = kind, placed.path
        self.clock = int(plan.clock_of[kind.key][k])
        self.period = float(plan.periods[self.clock])
        self.x = np.arange(t.x + k * t.nx, t.x + (k + 1) * t.nx)
        self.u = np.arange(t.u + k * t.nu, t.u + (k + 1) * t.nu)
        self.y = np.arange(t.y + k * t.ny, t.y + (k + 1) * t.ny)
        parts = {"x": kind.state, "x_next": kind.state, "dx": kind.state, "u": kind.input, "y": kind.output}
        self.named = {name: PlainRecord(names_of(record), 0j) for name, record in parts.items()}
        width = len(t.parameters) // len(t.placed)
        p = PlainRecord(parameter_dtype(kind.cls).names or (), 0j)
        p.write(t.parameters[k * width : (k + 1) * width].astype(complex))
        self.parameters = p.top
        self.records: dict[str, Any] = {name: record.top for name, record in self.named.items()}
        self.records |= {"t": 0.0, "dt": self.period, "tables": plan.step.tables, "p": p.top, "delays": delays}
        self.sampled = "update" in kind.kernels
        late = getattr(placed.item, "dead_times", dict)()
        names = names_of(kind.input)
        self.late = {names.index(name): seconds for name, seconds in late.items()}
        self.holds_input = delays is None and bool(self.late)

    def refuse_time(self) -> None:
        """Refuse a component that never rests.

        Raises
        ------
        SteadyStateError
            If a kernel reads the time.
        """
        kernels = self.kind.kernels
        reads = [name for name in ("derivatives", "outputs", "update") if reads_time(kernels.get(name))]
        if reads:
            raise SteadyStateError(
                f"no operating point: '{self.path}' ({self.kind.name}) reads the time in `{reads[0]}`; "
                "expected a state in its place, for an angle one that `rotates`"
            )

    def _call(self, name: str) -> None:
        kernel = self.kind.kernels[name]
        uncompiled(kernel)(*[self.records[argument] for argument in argument_names(kernel)])

    def _read(self, name: str) -> np.ndarray:
        return np.array(self.named[name].read(), dtype=complex)

    def rate(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Rates of the states, or next states; none of a component that has neither.

        Parameters
        ----------
        x, u : ndarray of complex
            States and inputs.
        """
        self.named["x"].write(x)
        self.named["u"].write(u)
        if self.holds_input:
            self.records["delays"] = _Line(u[next(iter(self.late))])
        if self.sampled:
            self.named["x_next"].write(x)
            self._call("update")
            return self._read("x_next")
        if "derivatives" not in self.kind.kernels:
            return np.zeros(0, dtype=complex)
        self.named["dx"].write(0.0 * x)
        self._call("derivatives")
        return self._read("dx")

    def evaluate(self, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates (or next states) and outputs.

        Parameters
        ----------
        x, u, y : ndarray of complex
            States, inputs, and outputs so far.
        """
        self.named["y"].write(y)
        rate = self.rate(x, u)
        if self.sampled:
            self.named["x"].write(rate)  # outputs, where there are any beside, are those of the new state
        if "outputs" in self.kind.kernels:
            self._call("outputs")
        return rate, self._read("y")

    def rate_by_states(self, x: np.ndarray, u: np.ndarray, free: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Rates (or next states) of some states, and their derivatives by these.

        Parameters
        ----------
        x, u : ndarray
            States and inputs.
        free : sequence of int
            Numbers of the states.
        """
        rate = np.real(self.rate(x.astype(complex), u.astype(complex)))[free]
        by_state = np.empty((len(free), len(free)))
        for column, k in enumerate(free):
            by_state[:, column] = _slope(self.rate(_stepped(x, k), u.astype(complex)))[free]
        return rate, by_state

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
            self.named["x"].write(_stepped(base, k))
            self.named["u"].write(u.astype(complex))
            self._call("limit")
            held[k] = not self._read("x")[k].imag
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
        both, n = np.concatenate([x, u]), len(x)
        by_rate, by_output = np.zeros((len(rate), len(both))), np.zeros((len(output), len(both)))
        for k in range(len(both)):
            stepped = _stepped(both, k)
            stepped_rate, stepped_output = self.evaluate(stepped[:n], stepped[n:], y)
            by_rate[:, k], by_output[:, k] = _slope(stepped_rate), _slope(stepped_output)
        held = self.limited(x, u, np.real(rate)) if len(rate) else np.zeros(n, dtype=bool)
        return Block(
            self.path, self.sampled, self.period, self.x, self.y, self.u,
            np.real(rate), np.real(output), by_rate, by_output, held,
        )  # fmt: skip
