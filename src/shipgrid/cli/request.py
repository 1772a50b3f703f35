"""What one run is asked for: the options as they are typed and the files they name, read and checked together.

Every mistake of all of them is reported in one go.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer

from shipgrid.cli.options import quantity_of_option
from shipgrid.names import similar


@dataclass(frozen=True)
class TypedOptions:
    """Arguments and options of a command that runs something, as they are typed.

    Parameters
    ----------
    scenario : str
        Name of a bundled scenario, or path of a scenario or run file.
    ship : str, optional
        Name or path; the ferry, or the ship of the run file.
    fidelity, step, until : str, optional
        Likewise the run file's, or the defaults of `RunRequest`.
    changes : sequence of str
        `PATH=VALUE` each.
    waveforms : sequence of str
        `FROM:TO` each.
    parts : str, optional
        A number of parts, or "ship".
    cores : int
        On more than one a plant is cut, if it is not said how: as its file says, else into as many parts.
    live : bool
        Whether the run is paced to the wall clock. Such a one has no use for the scenario's step, which is for offline
        runs.
    """

    scenario: str
    ship: str | None = None
    fidelity: str | None = None
    step: str | None = None
    until: str | None = None
    changes: Sequence[str] = ()
    waveforms: Sequence[str] = ()
    parts: str | None = None
    cores: int = 1
    live: bool = False


@dataclass(frozen=True)
class RunRequest:
    """What one run is asked for, checked.

    Parameters
    ----------
    ship : Ship
    scenario : Scenario
    options : dict
        Arguments of `shipgrid.scenarios.simulate.simulate`: always `fidelity`, `step`, `until` and `overrides`; and
        `waveforms`, `outside`, `parts`, where there are any.
    """

    ship: Any
    scenario: Any
    options: dict[str, Any]

    @property
    def step(self) -> float:
        """Step [s]: what is asked for, or the scenario's (averaged only), or 30 us."""
        from shipgrid.scenarios.case import DEFAULT_STEP

        of_scenario = self.scenario.step if self.options["fidelity"] == "averaged" else None
        return self.options["step"] or of_scenario or DEFAULT_STEP


@dataclass
class _Values:
    """Values of the options that were typed, in SI; where one was not typed, that of the run file, if there is one."""

    fidelity: str | None
    step: float | None
    until: float | None
    windows: list[tuple[float, float]]
    overrides: list[tuple[str, str]]
    parts: str | None
    outside: Sequence[Any] = ()
    groups: Mapping[str, Sequence[str]] | None = None


@dataclass(frozen=True)
class _Reader:
    """Reads the options that were typed, and collects the mistakes in them."""

    typed: TypedOptions
    problems: list[str] = field(default_factory=list)

    def values(self) -> _Values:
        """Values of the options, before any file is read."""
        from shipgrid.io.scenario_file import LONGEST_STEP, SHORTEST_STEP, step_range
        from shipgrid.model.network import FIDELITIES

        fidelity, step, until = self.typed.fidelity, self.typed.step, self.typed.until
        if fidelity is not None and fidelity not in FIDELITIES:
            expected = " or ".join(FIDELITIES)
            self.problems.append(
                f"--fidelity: no fidelity '{fidelity}'{similar(fidelity, FIDELITIES)}, expected {expected}"
            )
        step_s, until_s = self._seconds("--step", step), self._seconds("--until", until)
        if step_s is not None and not SHORTEST_STEP <= step_s <= LONGEST_STEP:
            self.problems.append(f"--step: {step} is out of range, expected {step_range()}")
        if until_s is not None and until_s <= 0.0:
            self.problems.append(f"--until: {until} is not after the start, expected a time after 0 s")
        windows = [window for text in self.typed.waveforms if (window := self._window(text))]
        return _Values(fidelity, step_s, until_s, windows, self._overrides(), self.typed.parts)

    def _seconds(self, option: str, text: str | None) -> float | None:
        from shipgrid.errors import InputErrors

        try:
            return quantity_of_option(option, text, "s")
        except InputErrors as wrong:
            self.problems.extend(wrong.problems)
        return None

    def _window(self, text: str) -> tuple[float, float] | None:
        """From and to [s] of `170s:170.2s`; None, and a problem more, if it is no window."""
        from shipgrid.errors import ParameterError
        from shipgrid.io.quantities import parse_quantity

        try:
            start, end = (parse_quantity(part, "s") for part in text.split(":", 1))
            if 0.0 <= start < end:
                return start, end
            self.problems.append(f"--waveforms: {text} ends before it begins or begins before 0 s, expected FROM:TO")
        except (ParameterError, ValueError) as wrong:
            what = wrong if isinstance(wrong, ParameterError) else f"'{text}' is not a window"
            self.problems.append(f"--waveforms: {what}, expected FROM:TO, such as 170s:170.2s")
        return None

    def _overrides(self) -> list[tuple[str, str]]:
        overrides = []
        for text in self.typed.changes:
            path, equals, value = text.partition("=")
            if not equals or not path.strip():
                self.problems.append(f"--set {text}: is not PATH=VALUE, such as equipment.bess_for.capacity='160 Ah'")
            else:
                overrides.append((path.strip(), value.strip()))
        return overrides

    def files(self, values: _Values) -> tuple[Any, Any]:
        """Ship and scenario, with their overrides; what was not typed is taken from the run file, if it is one."""
        from shipgrid.errors import InputErrors
        from shipgrid.io.run_file import is_run_file
        from shipgrid.io.scenario_file import read_case
        from shipgrid.io.ship_file import open_document

        document = open_document("scenario", self.typed.scenario)
        try:
            if is_run_file(document):
                return self._run_file(document, values)
            ship, scenario = read_case(open_document("ship", self.typed.ship or "ferry"), document, values.overrides)
        except InputErrors as wrong:
            raise InputErrors([*self.problems, *wrong.problems]) from None
        if self.typed.cores > 1:
            values.parts = values.parts or ("ship" if ship.parts else str(self.typed.cores))
        return ship, scenario

    def _run_file(self, document: Any, values: _Values) -> tuple[Any, Any]:
        from shipgrid.io.run_file import read_run_file

        path = self.typed.scenario
        if self.typed.ship is not None:
            self.problems.append(f"--ship: {path} has its ship in it, expected none")
        repeated = read_run_file(document, values.overrides)
        values.overrides = list(repeated.overrides.items())
        values.fidelity, values.step = values.fidelity or repeated.fidelity, values.step or repeated.step
        values.until, values.windows = values.until or repeated.until, values.windows or list(repeated.waveforms)
        values.outside, values.groups = repeated.outside, repeated.parts or None
        if values.outside and values.step != repeated.step:
            self.problems.append(
                f"--step: the commands of {path} belong to steps of {repeated.step:g} s, expected none"
            )
        _print_other_version(path, repeated.version)
        return repeated.ship, repeated.scenario

    def check_times(self, values: _Values, duration: float) -> None:
        """Check end and windows against the scenario's duration [s]."""
        if values.until is not None and values.until > duration:
            self.problems.append(
                f"--until: {self.typed.until} is after the scenario's end, expected at most {duration:g} s "
                "(or --set duration)"
            )
        run_end = min(values.until or math.inf, duration)
        for start, stop in values.windows:
            if stop > run_end:
                self.problems.append(
                    f"--waveforms: {start:g} s to {stop:g} s is not within the run, expected an end up to {run_end:g} s"
                )


def read_request(typed: TypedOptions) -> RunRequest:
    """Read files and options.

    Parameters
    ----------
    typed : TypedOptions

    Raises
    ------
    InputErrors
        With every mistake of all of them.
    """
    from shipgrid.errors import InputErrors, ParameterError
    from shipgrid.scenarios.case import DEFAULT_STEP
    from shipgrid.scenarios.parts import parts_wanted

    reader = _Reader(typed)
    values = reader.values()
    ship, scenario = reader.files(values)
    reader.check_times(values, scenario.duration)
    options: dict[str, Any] = {
        "fidelity": values.fidelity or "averaged",
        "step": values.step or (DEFAULT_STEP if typed.live else None),
        "until": values.until,
    }
    if values.windows:
        options["waveforms"] = values.windows
    if values.outside:
        options["outside"] = values.outside
    request = RunRequest(ship, scenario, options | {"overrides": dict(values.overrides)})
    groups = values.groups
    if values.parts is not None:
        try:
            groups = parts_wanted(ship, values.parts, request.step)
        except ParameterError as wrong:
            reader.problems.append(f"--{wrong}")
    if reader.problems:
        raise InputErrors(reader.problems)
    _print_fewer_parts(request, values.parts, len(groups or ()))
    if groups:
        request.options["parts"] = groups
    return request


def locate_unfinished_run(scenario: str, out: Path | None) -> tuple[str, Path | None]:
    """The run.yaml and the place of a run that is to be continued, where it is named by the run.yaml in its folder.

    Parameters
    ----------
    scenario : str
        Name or path, as it is typed; returned as it is, if it is no run.yaml.
    out : Path, optional
        Place of the results, as it is typed; it goes before the folder of the run.yaml.
    """
    from shipgrid.scenarios.output_folder import MARK, place_of, unfinished

    path = Path(scenario)
    if path.name != MARK:
        return scenario, out
    place = place_of(path.parent)
    if not path.exists():  # killed before there was a folder in the place
        path = next((folder / MARK for folder in unfinished(place)), path)
    return str(path), out or place


def _print_other_version(path: str, version: str) -> None:
    """A run repeats to the bit with the program that made it; say so where this is another."""
    import shipgrid

    if version != shipgrid.__version__:
        typer.echo(f"{path} was written by shipgrid {version}, this is {shipgrid.__version__}", err=True)


def _print_fewer_parts(request: RunRequest, parts: str | None, count: int) -> None:
    """Say why a plant is cut into fewer parts than were asked for by their number."""
    from shipgrid.assembly.partition import SURPLUS

    if parts is not None and parts.isdecimal() and int(parts) > max(1, count):
        outcome = f"has {count} parts" if count else "stays whole"
        typer.echo(
            f"--parts: {request.ship.name} {outcome} at steps of {1e6 * request.step:g} us: any other line would have "
            f"a surplus above {100.0 * SURPLUS:g} %; what is to be cut all the same can be said in the ship's file",
            err=True,
        )
