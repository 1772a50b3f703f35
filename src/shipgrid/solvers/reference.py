"""Reference solver: the same plant by an adaptive implicit method, slow and trusted.

It shares the kernels with the fast solver and nothing of how they are stepped: no companion matrices, no stamps, no
rule of its own. Between two instants at which something discrete happens the plant is an ordinary differential
equation of its continuous states z (voltages of capacitive nodes, states of elements and machines, states of
continuous components), which SciPy's Radau method of order five integrates to a tolerance:

    C dv/dt = -G v - S i(z)                 nodes with capacitance           (1)
    0 = G v + S i(z, v)                     the others: algebraic            (2)
    0 = S di/dt                             where (2) does not contain v     (3)

S holds, port by port, the node, its sign, the weight and the switching function. (3) is the time derivative of
(2) at a node that only inductances meet; it is linear in v, since every element's di/dt is.

What is discrete happens at its exact instant: sampled controllers, references put in force, edges of switches,
clocks of whole steps at the same multiples of the step. Components that run every step are discrete at the step by
the plan's own definition.

Switching functions are 0 or 1 (averaged: constant) in between. A modulator gives their means over any interval that
holds no instant of its own; where such a mean is not what it is over the interval's very beginning, there is an edge,
and bisection ends the interval there, to a millionth of a step. Hysteresis control predicts its edges from the
currents at the interval's beginning, which is anew after every edge and every step. What the gates leave open the
diodes decide, from one event to the next (`solvers/reference_diodes.py`): the integration is taken again from the
last step to the event, until the condition that fails there fails by less than its tolerance.
Continuous components with a slower clock, and what they read, are continuous here; so the comparison shows what
holding their inputs over a period costs.

Kernels run uncompiled, on plain Python objects: about a second of computing for a millisecond of the ferry.

What is where: the run from instant to instant here, their times in `reference_clocks.py`, what happens at them and
dz/dt in `reference_plant.py`, nodes and elements in `reference_network.py`, diodes in `reference_diodes.py`, Radau and
the search for events in `reference_integration.py`, kernels and their records in `reference_components.py`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.solvers.reference_clocks import ReferenceClocks
from shipgrid.solvers.reference_integration import Integration
from shipgrid.solvers.reference_plant import ReferencePlant


@dataclass(frozen=True)
class Trajectory:
    """What a reference run found.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Instants [s], a step of the plan apart (or as many as `every` said).
    signals : dict of str to ndarray
        The chosen signals at those instants.
    """

    time: np.ndarray
    signals: dict[str, np.ndarray]

    def __getitem__(self, path: str) -> np.ndarray:
        return self.signals[path]


def reference_run(
    plan: Plan,
    work: Workspace,
    until: float,
    signals: Iterable[str] | None = None,
    *,
    every: int = 1,
    rtol: float = 1e-8,
    atol: float | None = None,
) -> Trajectory:
    """Run a plant on from any state with an adaptive solver.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Where it starts; left as it is.
    until : float
        Time of the end [s], counted as the workspace counts.
    signals : iterable of str, optional
        Paths of the signals to keep; all states and node voltages if left out.
    every : int
        Steps between two kept values.
    rtol : float
        Relative tolerance of each integration between two instants.
    atol : float, optional
        Absolute tolerance on the size of a state (10 V, 10 A, 0.1 of any other unit); `rtol` if left out.

    Returns
    -------
    Trajectory

    Raises
    ------
    SolverError
        If the integration fails, or no state of the diodes holds.
    """
    plan.refuse_parts()
    plant = ReferencePlant(plan, work.snapshot())
    integration = Integration(plant, rtol, rtol if atol is None else atol)
    names = list(signals) if signals is not None else [*plan.layout.nodes, *sorted(plan.layout.states)]
    places = np.array([plan.layout.place(name, "reference run") for name in names], dtype=np.int64)
    end = round(until / plan.h)
    clocks = ReferenceClocks(plan, work)
    with np.errstate(all="ignore"):  # a kernel that divides by zero gives inf or nan, as when it is compiled
        now = Fraction(work.n)
        plant.t = float(now) * plan.h
        plant.start({c: f for c, f in enumerate(work.step.clock_ahead) if f >= 0.0}, clocks)
        times, rows = [work.n * plan.h], [plant.sig[places].copy()]
        keep = work.n + every
        while now < end:
            then = plant.segment(clocks, now, min(clocks.next(), Fraction(keep), Fraction(end)))
            integration.integrate(float(now) * plan.h, float(then - now) * plan.h)
            now = then
            if now in (keep, end):
                times.append(float(now) * plan.h)
                rows.append(plant.sig[places].copy())
                keep += every
            plant.instant(float(now) * plan.h, clocks.due(now), clocks)
    table = np.array(rows)
    return Trajectory(np.array(times), {name: table[:, k] for k, name in enumerate(names)})
