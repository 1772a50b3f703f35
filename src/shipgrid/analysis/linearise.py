"""Small signals: a plant's equations linearised at an operating point, in frames that turn with its AC islands.

Everything is put together from exact derivatives of the components' own kernels (`equations`, `pencil`). What is made
of a controller that acts at instants, x_next = P x + Q u, `method` says:

`continuous`  Any plant. Such a component is taken over by the bilinear transformation z = (1 + s T/2) / (1 - s T/2),
    with w = (x_next + x)/2 the state half way,

        T dw/dt = (P - I) x + Q u,      0 = ((P + I) x + Q u)/2 - w                             (1)

    and the bridge obeys by a Pade quotient of 1.5 T. Good where signals are slow against the sampling: the error in
    phase is (omega T)^3/12, and there are no side bands.

`sampled`     Exact for the components on one clock: `sampled_control`. Those on other clocks are as above.

The eigenvalues at zero of islands that turn evenly are taken out (`turning`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, overload

import numpy as np
from scipy import sparse
from scipy.linalg import expm
from scipy.sparse.linalg import splu

from shipgrid.analysis.modes import Modes, modes_of
from shipgrid.analysis.pencil import Pencil, pencil_at, states_of
from shipgrid.analysis.point import Point
from shipgrid.analysis.sampled_control import SampledModel, sampled_model
from shipgrid.analysis.steady_state import OperatingPoint, input_place, steady_state
from shipgrid.analysis.step_response import Response
from shipgrid.analysis.turning import state_names, without_turning
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.errors import ParameterError


@dataclass(frozen=True, repr=False)
class LinearModel:
    """A plant beside an operating point, sampled control as continuous; made by `linearise`.

    Attributes
    ----------
    plan : Plan
    point : OperatingPoint
    pencil : Pencil
    """

    plan: Plan
    point: OperatingPoint
    pencil: Pencil

    def __repr__(self) -> str:
        return f"<LinearModel of {self.plan.network.name}: {len(self.pencil.places)} unknowns>"

    def modes(self) -> Modes:
        """Eigenvalues with the states that take part in each."""
        states = states_of(self.pencil)
        places = self.pencil.places[states.rows]
        generators = [g[places] for g in self.point.equations.generators(self.point.sig)]
        A, basis, coordinates = without_turning(
            states.A, states.basis, states.coordinates, generators, places, self.point
        )
        names = state_names(self.point)
        return modes_of(A, basis, coordinates, [names[int(p)] for p in places])

    def transfer(self, at: Sequence[str], to: Sequence[str], frequency: np.ndarray) -> np.ndarray:
        """Responses of signals to disturbances of inputs or commands.

        Parameters
        ----------
        at : sequence of str
            Paths of what is disturbed: inputs (beside what they are connected to) or commands.
        to : sequence of str
            Paths of the signals that answer.
        frequency : ndarray
            Frequencies [Hz].

        Returns
        -------
        ndarray of complex, shape (frequencies, to, at)
        """
        model = self.stirred(at)
        B = np.column_stack([model.disturbance(path) for path in at])
        return model.respond(B, [model.signal_row(path) for path in to], frequency)

    def step(self, at: str, amount: float, until: float, signals: Sequence[str], n: int = 201) -> Response:
        """What a step of an input or a command does to signals.

        Parameters
        ----------
        at : str
            Path of the input or command.
        amount : float
            Size of the step.
        until : float
            Length of the response [s].
        signals : sequence of str
            Paths of the signals wanted; vectors in the island's frame.
        n : int
            Number of instants.

        Returns
        -------
        Response
        """
        model = self.stirred([at])
        states = states_of(model.pencil, amount * model.disturbance(at)[:, None], steps=True)
        time = np.linspace(0.0, until, n)
        size = len(states.A)
        hold = np.zeros((size + 1, size + 1))
        hold[:size, :size], hold[:size, size] = states.A, states.B[:, 0]
        forward = expm(hold * (time[1] - time[0]))
        z = np.zeros((n, size + 1))
        z[:, size] = 1.0
        for k in range(1, n):
            z[k] = forward @ z[k - 1]
        rows = [model.signal_row(path) for path in signals]
        values = z[:, :size] @ states.S[rows].T + states.D[rows, 0]
        return Response(time, dict(zip(signals, values.T, strict=True)))

    # what the functions of `frequency_response` are made of

    def stirred(self, at: Sequence[str]) -> LinearModel:
        """The same with everything that commands or inputs act on, constants as they are otherwise.

        Parameters
        ----------
        at : sequence of str
            Paths of the commands or inputs.
        """
        point = Point(self.point.equations, self.point.sig, [input_place(self.plan, path) for path in at])
        return LinearModel(self.plan, self.point, pencil_at(point, self.point.omega))

    def disturbance(self, at: str) -> np.ndarray:
        """Column of a unit disturbance of an input, beside what it is connected to; or of a command or open input.

        Parameters
        ----------
        at : str
            Path of the input or command.

        Raises
        ------
        ParameterError
            If it acts on nothing that moves.
        """
        e, place = self.point.equations, input_place(self.plan, at)
        readers = [place] if ("u", at) in self.plan.layout.slots else np.flatnonzero(e.inner == e.alias[place])
        column = np.asarray(self.pencil.columns[:, readers].sum(axis=1)).ravel()
        if not np.any(column):
            raise ParameterError(f"'{at}' acts on nothing that moves at this operating point")
        return column

    def injection(self, node: str) -> np.ndarray:
        """Column of a unit current [A] into a node: a DC bus, or one axis of an AC bus.

        Parameters
        ----------
        node : str
            Path of the node.
        """
        e, place = self.point.equations, self.plan.layout.place(node, "a current")
        column = np.zeros(len(self.pencil.places))
        column[self.pencil.row(place)] = 1.0 / (e.nodes[place][0] or 1.0)
        return column

    def signal_row(self, path: str) -> int:
        """Number of a signal among the unknowns; of what an input reads.

        Parameters
        ----------
        path : str
            Of the signal or input.
        """
        return self.pencil.row(int(self.point.equations.inner[input_place(self.plan, path)]))

    def respond(self, B: np.ndarray, rows: Sequence[int], frequency: np.ndarray) -> np.ndarray:
        """Responses of unknowns to disturbances.

        Parameters
        ----------
        B : ndarray
            A column for each disturbance.
        rows : sequence of int
            Numbers of the unknowns.
        frequency : ndarray
            Frequencies [Hz].

        Returns
        -------
        ndarray of complex, shape (frequencies, rows, columns)
        """
        E = sparse.diags(self.pencil.rates.astype(complex)).tocsc()
        found = np.empty((len(frequency), len(rows), B.shape[1]), dtype=complex)
        for k, f in enumerate(frequency):
            found[k] = splu((2j * np.pi * f * E - self.pencil.A).tocsc()).solve(B.astype(complex))[list(rows)]
        return found


@overload
def linearise(plan: Plan, point: OperatingPoint | Workspace) -> LinearModel: ...


@overload
def linearise(plan: Plan, point: OperatingPoint | Workspace, *, method: Literal["continuous"]) -> LinearModel: ...


@overload
def linearise(
    plan: Plan, point: OperatingPoint | Workspace, *, method: Literal["sampled"], rate: float | None = None
) -> SampledModel: ...


def linearise(
    plan: Plan,
    point: OperatingPoint | Workspace,
    *,
    method: str = "continuous",
    rate: float | None = None,
) -> LinearModel | SampledModel:
    """Linearise a plant at an operating point.

    Parameters
    ----------
    plan : Plan
    point : OperatingPoint or Workspace
        From `steady_state`; a workspace at rest is brought to rest exactly first.
    method : {"continuous", "sampled"}
        How sampled controllers are treated: as continuous ones with a delay, or exactly for those of one clock.
    rate : float, optional
        With `sampled`: the clock's rate [Hz]; that of the plant's modulators if left out.

    Returns
    -------
    LinearModel or SampledModel

    Raises
    ------
    ParameterError
        If `method` is unknown, or the plant has no controllers of that rate, or several rates and none is given.
    """
    if method not in ("continuous", "sampled"):
        raise ParameterError(f"method = {method!r}: expected 'continuous' or 'sampled'")
    if isinstance(point, Workspace):
        point = steady_state(plan, start=point)
    if method == "sampled":
        return sampled_model(plan, point, rate)
    return LinearModel(plan, point, pencil_at(Point(point.equations, point.sig), point.omega))
