"""A window of a run by the fast solver and by the reference solver, from one state: how far apart are they?

The run goes to the window's beginning as always; from there both solvers go on from the same workspace. What only one
of them has is left out: means over a step (powers and currents metered at a bridge, bridge voltages).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.automation.interlocks import Interlocks
from shipgrid.automation.power_management import operator_of
from shipgrid.errors import InputErrors, SolverError
from shipgrid.model.public_signals import PublicSignal, Waveform, terms_of
from shipgrid.scenarios.case import DEFAULT_STEP, build
from shipgrid.scenarios.session import Run, run_until
from shipgrid.scenarios.start import start
from shipgrid.scenarios.timeline import Timeline
from shipgrid.scenarios.waveforms import merged
from shipgrid.solvers.reference import reference_run


@dataclass(frozen=True)
class Deviation:
    """How far one signal of the fast solver lies from the reference solver's.

    Attributes
    ----------
    signal, unit : str
    largest, at : float
        Largest difference, and the time [s] of it.
    rms : float
        Of the difference, over the window.
    size : float
        Largest magnitude of the reference's signal, and `relative` the largest difference over it.
    """

    signal: str
    unit: str
    largest: float
    at: float
    rms: float
    size: float

    @property
    def relative(self) -> float:
        """Largest difference over the largest magnitude."""
        return self.largest / self.size if self.size > 0.0 else (0.0 if self.largest == 0.0 else np.inf)


def against_reference(
    ship: Any,
    scenario: Any,
    window: tuple[float, float],
    *,
    fidelity: str = "averaged",
    step: float | None = None,
    rtol: float = 1e-7,
) -> list[Deviation]:
    """Run a window with both solvers.

    Parameters
    ----------
    ship : Ship
    scenario : Scenario
    window : (float, float)
        From and to [s]; the reference takes seconds of computing for each of its milliseconds.
    fidelity : {"averaged", "switching"}
    step : float, optional
        Step [s] of the fast solver; the scenario's own (averaged only), or 30 us.
    rtol : float
        Tolerance of the reference solver.

    Returns
    -------
    list of Deviation
        The largest relative one first.

    Raises
    ------
    InputErrors
        If the window is none, or a command falls into it.
    SolverError
        If the run fails before the window, or the reference cannot follow it.
    """
    h = step or (scenario.step if fidelity == "averaged" else None) or DEFAULT_STEP
    (span,) = merged([window], h, scenario.duration)
    inside = sorted({t for t, *_ in scenario.events if span.first <= round(t / h) < span.last})
    if inside:
        raise InputErrors([f"--reference: a command comes at {inside[0]:g} s, expected a window without commands"])
    ship = scenario.ship_at_start(ship)
    plan = build(ship, h, fidelity, scenario.rules)
    work, _ = start(plan, ship, scenario)
    run = Run(plan, work)
    who = {"interlocks": Interlocks(ship, plan), "operator": operator_of(scenario.rules, ship, plan)}
    who |= {"entries": scenario.entries, "named_times": scenario.named_times}
    due = Timeline(plan, work, run.events, scenario.events, **who)
    run_until(run, due, span.first * h)
    if run.failure:
        raise SolverError(run.failure)
    begin = work.snapshot()
    waves = comparable(plan)
    paths = list(dict.fromkeys(path for wave in waves for path, _ in terms_of(wave)))
    truth = reference_run(plan, begin, span.last * h, paths, rtol=rtol)
    fast = _Kept(plan)
    run_until(run, None, span.last * h, fast, windows=[span])
    if run.failure:
        raise SolverError(run.failure)
    found = []
    for wave in waves:
        true = sum((weight * truth[path] for path, weight in terms_of(wave)), np.zeros(len(truth.time)))
        gap = np.abs(fast[wave.name] - true)
        gap[0] = 0.0  # there the reference has meters of this instant already, the fast solver those of a step ago
        k = int(np.argmax(gap))
        rms = float(np.sqrt(np.mean(gap**2)))
        found.append(
            Deviation(wave.name, wave.unit, float(gap[k]), float(truth.time[k]), rms, float(np.max(np.abs(true))))
        )
    return sorted(found, key=lambda d: -d.relative)


def comparable(plan: Plan) -> list[PublicSignal | Waveform]:
    """What both solvers have: everything public but the means over a step.

    Parameters
    ----------
    plan : Plan
    """
    network = plan.network
    metered = tuple(f"{path}." for path in network.legs)
    public = [p for p in network.published.values() if not p.source.startswith(metered)]
    return [*public, *(wave for wave in network.waveforms.values() if not wave.mean)]


class _Kept:
    """Rows of a window, by name."""

    def __init__(self, plan: Plan):
        names = [*plan.network.published, *plan.network.waveforms]
        self.column = {name: k for k, name in enumerate(names)}
        self.rows: list[np.ndarray] = []

    def append(
        self,
        group: str,
        time: np.ndarray,
        value: np.ndarray,
        low: np.ndarray | None = None,
        high: np.ndarray | None = None,
        mean: np.ndarray | None = None,
    ) -> None:
        """Keep what a window gets."""
        if group.startswith("waveforms"):
            self.rows.append(value)

    def __getitem__(self, name: str) -> np.ndarray:
        return np.concatenate([rows[:, self.column[name]] for rows in self.rows])
