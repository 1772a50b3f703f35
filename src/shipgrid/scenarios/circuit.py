"""Circuits without a ship around them: a plan that can be run by itself, and what comes of a run.

    plan = sg.assemble(network, step=30e-6)
    run = plan.run({"bus.v_dc": 750.0}, events=[sg.At(0.1, sg.Close("breaker"))], until=0.5)
    run["bus.v_dc"].plot()

Everything stays in memory, in double precision, every step unless asked otherwise; nothing is written.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shipgrid.analysis.steady_state import OperatingPoint
from shipgrid.assembly.assemble import assemble as assemble_plan
from shipgrid.assembly.energy import energy_balance, powers, stored_energy
from shipgrid.assembly.hand_over import (
    places_to_set,
    places_to_start,
    remembered,
    same_plant,
)
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.equipment.ship import Ship
from shipgrid.errors import InputErrors, ParameterError, SolverError, TopologyError
from shipgrid.html_table import table
from shipgrid.model.frames import alpha_beta_to_abc
from shipgrid.model.kernel import uncompiled
from shipgrid.model.network import FIDELITIES, Network
from shipgrid.names import nearest
from shipgrid.scenarios import snapshot
from shipgrid.scenarios.case import DEFAULT_STEP, build
from shipgrid.scenarios.conclude import limiter_meaning, limiter_rows
from shipgrid.scenarios.events import At, seconds, timeline, with_times_asked_for
from shipgrid.scenarios.notebook import ledgers
from shipgrid.scenarios.provenance import provenance
from shipgrid.scenarios.results import Event, Limiter, bibliography
from shipgrid.scenarios.session import Run, run_until
from shipgrid.scenarios.start import LOGS, begin_at
from shipgrid.scenarios.timeline import Timeline

if TYPE_CHECKING:
    import xarray

NEVER = 2**62
"""Steps between the rows of a group that has no signals."""
MOST_VALUES = 50_000_000
"""Numbers a run may keep in memory: 400 MB."""


def assemble(network: Network, step: float = 30e-6) -> RunnablePlan:
    """Turn a network into a plan that can be run.

    Parameters
    ----------
    network : Network
        The circuit, or a whole plant.
    step : float
        Step length [s].

    Returns
    -------
    RunnablePlan

    Raises
    ------
    TopologyError
        If a name does not exist, an input is left open, or components wait for each other within a step.
    ParameterError
        If the step is too long for a sampled controller.
    """
    return _runnable(assemble_plan(network, step))


def plan(ship: Ship, step: float = DEFAULT_STEP, fidelity: str = "averaged") -> RunnablePlan:
    """Plan of a ship, for operating points, eigenvalues and runs of one's own; a scenario needs none.

    Parameters
    ----------
    ship : Ship
    step : float
        Step length [s].
    fidelity : {"averaged", "switching"}
        Detail of the converters.

    Returns
    -------
    RunnablePlan

    Raises
    ------
    ParameterError
        If there is no such fidelity, or the step is too long for a sampled controller.
    """
    if fidelity not in FIDELITIES:
        raise ParameterError(f"there is no fidelity '{fidelity}', expected one of {', '.join(FIDELITIES)}")
    return _runnable(build(ship, step, fidelity))


def _runnable(made: Plan) -> RunnablePlan:
    return RunnablePlan(**{f.name: getattr(made, f.name) for f in dataclasses.fields(Plan)})


@dataclass(frozen=True, eq=False)
class RunnablePlan(Plan):
    """A `Plan` with `run`: what `assemble` makes of a network."""

    def run(
        self,
        start: Workspace | OperatingPoint | Mapping[str, float] | None = None,
        *,
        events: Iterable[At] = (),
        until: float,
        record: Sequence[str] | None = None,
        every: int = 1,
        begin: float | None = None,
    ) -> CircuitRun:
        """Step from a start to an end.

        Parameters
        ----------
        start : Workspace, OperatingPoint or mapping of str to float, optional
            An operating point, or the `end` of another run, which stays as it is. One of another plan with the same
            buses and elements is handed over by name: what the plant remembers, not its parameters; a command or
            constant input that is declared otherwise there is the one declared here. Or values [SI] by path, such as
            `final` of another run: of states, bus voltages, outputs held from sample to sample, commands and constant
            inputs; everything else is at its declared initial value, and delay lines hold what goes into them.
        events : iterable of At
            What happens on the way; each at the step that begins nearest to its time.
        until : float
            Time [s] at which to end.
        record : sequence of str, optional
            Paths or public names of the signals to keep; all of them if left out.
        every : int
            Number of steps from one kept value to the next; the extremes between them are kept as well.
        begin : float, optional
            Time [s] of a start that is given by values; 0 if left out. A start that is the end of a run goes on at its
            time, to the nearest step where the steps differ.

        Returns
        -------
        CircuitRun

        Raises
        ------
        InputErrors
            All of start and events that cannot be set; currents that have no path at the start.
        TopologyError
            If the start is of a network with other buses, elements or connections; names them.
        ParameterError
            If `until` or `begin` is no number or `until` lies before the start, or more is to be kept than fits.
        SolverError
            If the run diverged; its attribute `run` has what was computed before.
        """
        until = seconds("until", until)
        sources = self._sources(record)
        watching = self._watching(sources, every)
        work = begin_at(watching, start, None if begin is None else seconds("begin", begin))
        began = work.n * self.h
        if not (math.isfinite(until) and round(until / self.h) > work.n):
            raise ParameterError(f"until = {until!r} s, expected a time after the start at {began:g} s")
        rows = (round(until / self.h) - work.n) // every + 2
        if rows * len(sources) * (1 if every == 1 else 3) > MOST_VALUES:
            raise ParameterError(
                f"{rows} values of {len(sources)} signals do not fit in memory, "
                "expected fewer signals (`record`) or longer intervals (`every`)"
            )
        lines = timeline(self, events, began, until)
        run, memory = Run(watching, work), _Memory(every > 1)
        before, first = stored_energy(watching, work), powers(watching, work)
        value = work.sig[watching.step.recorded][None, :]
        memory.append("plant", np.array([began]), value, value, value, value)
        run_until(run, Timeline(watching, work, run.events, lines, _said, places_to_set(self)), until, memory)
        # of signal components each step was counted with the power at its end: half of the difference too much
        work.step.energy[:] += 0.5 * self.h * (first - powers(watching, work))
        run.events[:] = with_times_asked_for(self, lines, run.events)
        result = CircuitRun(self, run, memory, list(sources), before)
        if run.failure:
            error = SolverError(run.failure)
            error.run = result
            raise error
        return result

    def common(self, values: Mapping[str, float]) -> dict[str, float]:
        """Those of some values by path that this plan can start from.

        Parameters
        ----------
        values : mapping of str to float
            `final` of a run of another network, say; what only the other has is left out.
        """
        known = places_to_start(self)
        return {path: value for path, value in values.items() if path in known}

    def save(self, work: Workspace | OperatingPoint, path: str | Path) -> None:
        """Write the end of a run, or an operating point, to a file, whole or not at all.

        Parameters
        ----------
        work : Workspace or OperatingPoint
            Of this plan: `run.end`, say.
        path : str or Path
            The file, `.npz`.

        Raises
        ------
        TopologyError
            If it is of another plan.
        OSError
            If it cannot be written; an older one is untouched.
        """
        work = work.workspace() if isinstance(work, OperatingPoint) else work
        if not same_plant(work, self):
            other = work.plan.network.name
            raise TopologyError(f"{path}: the state is of another plan of '{other}', expected one of this plan")
        snapshot.write(Path(path), work, {"identity": snapshot.identity(self)}, without=LOGS)

    def load(self, path: str | Path) -> Workspace:
        """What `save` wrote, to start a run from; that run gives the same bits as one that went on at once.

        Parameters
        ----------
        path : str or Path
            The file.

        Raises
        ------
        InputErrors
            If there is none, it is damaged, or was written by another plan: with what differs.
        """
        about, arrays = snapshot.read(Path(path))
        differing = snapshot.differences(about["identity"], snapshot.identity(self))
        if differing:
            raise InputErrors([f"{path}: is a snapshot of another plan:", *(f"  {line}" for line in differing)])
        return snapshot.restore(self, about["n"], arrays)

    def _sources(self, record: Sequence[str] | None) -> dict[str, str]:
        """Path of each signal that is to be kept, by the name it is asked for."""
        public = {name: signal.source for name, signal in self.network.published.items()}
        if record is None:
            everything = {path: path for path in self.layout.index if path in self.layout.unit}
            return everything | public
        wrong = []
        for name in record:
            if name not in public and name not in self.layout.index:
                hint = nearest(name, [*public, *self.layout.unit])
                wrong.append(f"record: there is no signal '{name}'{hint}")
        if wrong:
            raise InputErrors(wrong)
        return {name: public.get(name, name) for name in record}

    def _watching(self, sources: Mapping[str, str], every: int) -> Plan:
        """The same plan with other signals recorded, and its energy audited in every step."""
        if every < 1 or every != int(every):
            raise ParameterError(f"every = {every!r} steps, expected a whole number from 1")
        recorded = np.array([self.layout.index[path] for path in sources.values()], dtype=np.int64)
        step = self.step._replace(
            recorded=recorded, n_plant=len(recorded), record_every=int(every), audit_every=1, slow_every=NEVER
        )
        return dataclasses.replace(self, step=step)


class CircuitRun:
    """One run of a circuit: signals over time, what happened, where the energy went.

    Parameters
    ----------
    plan : Plan
        What was run.
    run : Run
        Its workspace and logs.
    memory : object
        The rows that were kept.
    names : list of str
        Their columns.
    before : mapping of str to float
        Stored energy [J] at the start, by component.

    Attributes
    ----------
    end : Workspace
        The state at the end, from which another run may go on, of this plan or of one with other parameters.
    final : dict of str to float
        The same as values [SI] by path: states, bus voltages, outputs held from sample to sample, commands and constant
        inputs; not the content of delay lines. They start a plan of another network too (`plan.common`).
    events : list of Event
        What happened: time [s], source, text.
    limiters : list of Limiter
        Which limiters acted, and in what share of the time.
    energy : dict
        Energy [J] by component path in the ledgers `sources`, `consumers`, `losses` and `stored` (its change).
    energy_balance_error : float
        (sources - consumers - losses - stored) over the energy exchanged: what sources gave or took, what was stored in
        the network at the start, and the change of what is stored in everything else.
    failure : str
        Why the run broke off; empty if it did not.
    """

    def __init__(self, plan: Plan, run: Run, memory: _Memory, names: list[str], before: Mapping[str, float]):
        self._plan, self._names = plan, names
        self._time, self._layers = memory.arrays()
        self.end = run.work
        self.events = sorted((Event(*row) for row in run.events), key=lambda e: e.time)
        length = run.t - float(self._time[0])
        self.limiters = [Limiter.of(row, length, limiter_meaning(plan, row[0])) for row in limiter_rows(run)]
        self.energy, self.energy_balance_error = energy_balance(run.plan, run.work, before)
        self.failure = run.failure

    @cached_property
    def final(self) -> dict[str, float]:
        """What the plant remembers at the end, by path [SI]."""
        return remembered(self.end)

    def __repr__(self) -> str:
        return f"<CircuitRun of {self._plan.network.name}: {len(self._names)} signals to {self._time[-1]:g} s>"

    def _repr_html_(self) -> str:
        rows = [(event.time, event.source, event.text) for event in self.events]
        events = table("what happened", ("time [s]", "source", "event"), rows)
        energy = ledgers(f"energy, balance {self.energy_balance_error:.1e}", self.energy)
        return f"<p>{escape(repr(self)[1:-1])}</p>{events if rows else ''}{energy}"

    def _ipython_key_completions_(self) -> list[str]:
        return self.signals

    @property
    def signals(self) -> list[str]:
        """Names of all recorded signals."""
        return sorted(self._names)

    def __contains__(self, signal: str) -> bool:
        return signal in self._names

    def __getitem__(self, signal: str) -> xarray.DataArray:
        """One signal over time, with its unit; with `every` above 1 also `<signal>_min` and `<signal>_max`."""
        layer, name = 0, signal
        for k, ending in ((1, "_min"), (2, "_max")):
            if signal not in self._names and signal.endswith(ending) and len(self._layers) == 3:
                layer, name = k, signal.removesuffix(ending)
        if name not in self._names:
            raise ParameterError(f"no signal {signal!r} was recorded{nearest(signal, self._names)}")
        return self._array(signal, self._layers[layer][:, self._names.index(name)], *self._meaning(name))

    def phases(self, stem: str) -> xarray.DataArray:
        """The three phase quantities of an alpha-beta pair.

        Parameters
        ----------
        stem : str
            Its common name: `grid.v` of a bus, `cable.i` of an element placed per axis, `transformer.i_1`.

        Returns
        -------
        xarray.DataArray
            With the dimensions `phase` (a, b, c) and `time`.
        """
        owner, _, symbol = stem.rpartition(".")
        patterns = ("{owner}.{symbol}_{axis}", "{owner}.{axis}.{symbol}", "{owner}.{symbol}_{axis}_in")
        for pattern in patterns:
            names = [pattern.format(owner=owner, symbol=symbol, axis=axis) for axis in ("alpha", "beta")]
            if all(name in self._names for name in names):
                alpha, beta = (self._layers[0][:, self._names.index(name)] for name in names)
                unit, text = self._meaning(names[0])
                text = text.replace(", alpha axis", "").replace(", alpha", "")
                found = np.array(uncompiled(alpha_beta_to_abc)(alpha, beta))
                return self._array(stem, found, unit, text)
        raise ParameterError(f"no alpha-beta pair of the name {stem!r} was recorded")

    def dataset(self) -> xarray.Dataset:
        """All recorded signals, with the versions they depend on as attributes."""
        import xarray

        return xarray.Dataset({name: self[name] for name in self._names}, attrs=provenance(self._plan))

    def cite(self) -> str:
        """BibTeX entries of what the components and methods of this run come from."""
        return bibliography(provenance(self._plan)["references"].split())

    def _meaning(self, name: str) -> tuple[str, str]:
        if name in self._plan.network.published:
            public = self._plan.network.published[name]
            return public.unit, public.description
        return self._plan.layout.unit.get(name, "1"), self._plan.layout.description.get(name, "")

    def _array(self, name: str, values: np.ndarray, unit: str, text: str) -> xarray.DataArray:
        import xarray

        time = xarray.Variable("time", self._time, {"units": "s", "long_name": "time"})
        phases = {"phase": ["a", "b", "c"]} if values.ndim == 2 else {}
        return xarray.DataArray(
            values,
            dims=[*phases, "time"],
            coords={**phases, "time": time},
            name=name,
            attrs={"units": unit, "long_name": text},
        )


class _Memory:
    """Rows of a run as the runner hands them over, kept."""

    def __init__(self, extremes: bool):
        self.extremes = extremes
        self.times: list[np.ndarray] = []
        self.rows: list[tuple[np.ndarray, ...]] = []

    def append(
        self,
        group: str,
        time: np.ndarray,
        value: np.ndarray,
        low: np.ndarray | None = None,
        high: np.ndarray | None = None,
        mean: np.ndarray | None = None,
    ) -> None:
        """Keep copies of rows of the group `plant`."""
        if group != "plant" or low is None or high is None:
            return
        self.times.append(time.copy())
        self.rows.append(tuple(layer.copy() for layer in ((value, low, high) if self.extremes else (value,))))

    def arrays(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Times, and values (values, lows, highs), each a row an instant."""
        return np.concatenate(self.times), [np.concatenate(layer) for layer in zip(*self.rows, strict=True)]


def _said(path: str, value: Any) -> str:
    if path.endswith(".close"):
        return "closed" if value > 0.5 else "opened"
    return f"set to {value:.6g}"
