"""The command `shipgrid`: what a person types, what is said back, and the exit status.

Everything heavy is imported inside the command that needs it, so that `--help` and `check` answer at once.
Exit status: 0 done; 1 a requirement is violated, or what the time-line waited for never happened; 2 bad input; 3 the
simulation failed; 130 interrupted.
"""

from __future__ import annotations

import difflib
import ipaddress
import json
import math
import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

VIOLATED, BAD_INPUT, FAILED, INTERRUPTED = 1, 2, 3, 130
LISTS = ("ships", "scenarios", "equipment", "components", "signals", "commands", "registers")
SCHEMAS = ("ship", "scenario")
TOKEN = "SHIPGRID_TOKEN"
PERCENTILES = ("p50", "p99", "p99.99", "worst")
WORST_SHOWN = 5
SAILED = 2.0
"""Time [s] beyond the first command that a cut plant and a whole one are sailed."""

app = typer.Typer(
    name="shipgrid",
    help="Electromagnetic-transient simulation of shipboard DC microgrids.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

ScenarioArgument = Annotated[str, typer.Argument(help="A bundled scenario by name, a .yaml file, or a run.yaml.")]
ShipOption = Annotated[str, typer.Option(help="A bundled ship by name, or a .yaml file.", metavar="NAME|FILE")]
RunShipOption = Annotated[
    str | None,
    typer.Option(help="A bundled ship by name, or a .yaml file.", metavar="NAME|FILE", show_default="ferry"),
]
FidelityOption = Annotated[
    str | None,
    typer.Option(help="Detail of the converters.", metavar="averaged|switching", show_default="averaged"),
]
StepOption = Annotated[str | None, typer.Option(help="Step, such as 30us.", show_default="the scenario's, or 30us")]
UntilOption = Annotated[str | None, typer.Option(help="Stop at this time, such as 600s.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", help="Change one value of either file, by its path in the YAML.", metavar="PATH=VALUE"),
]
PartsOption = Annotated[
    str | None,
    typer.Option(help="Cut the plant: into a number of parts, or as the ship's file says.", metavar="N|ship"),
]
OutOption = Annotated[
    Path | None,
    typer.Option(help="Folder of the results, replaced whole.", show_default="results/<scenario>-<fidelity>"),
]
WaveformsOption = Annotated[
    list[str] | None,
    typer.Option(help="Record phase quantities at every step of a window.", metavar="FROM:TO"),
]


@app.command()
def run(
    scenario: ScenarioArgument = "mission",
    ship: RunShipOption = None,
    fidelity: FidelityOption = None,
    step: StepOption = None,
    until: UntilOption = None,
    set_: SetOption = None,
    out: OutOption = None,
    waveforms: WaveformsOption = None,
    parts: PartsOption = None,
    threads: Annotated[
        int, typer.Option(min=1, help="Threads that share the parts of a plant that is cut; the results are the same.")
    ] = 1,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no report.html.")] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the unfinished run of that folder from its last snapshot.")
    ] = False,
    reference: Annotated[
        bool, typer.Option("--reference", help="Run a window with the reference solver too and print the differences.")
    ] = False,
) -> None:
    """Run a scenario offline, as fast as it goes; or repeat a run, given the run.yaml in its folder.

    A run that was interrupted or killed is continued by the same command with --resume, or by the path of its run.yaml
    with --resume, to the results of one that never was.
    """
    with _errors_as_exit_status():
        if resume and reference:
            _refuse("--resume: --reference keeps nothing that could be continued, expected one or the other")
        if parts and reference:
            _refuse("--parts: --reference runs the whole plant, expected one or the other; see `shipgrid parts`")
        if resume:
            scenario, out = _unfinished_case(scenario, out)
        case = _case(scenario, ship, fidelity, step, until, set_ or [], waveforms or [], parts)
        if reference:
            _against_reference(case)
            return
        if threads > 1 and "parts" not in case.options:
            _refuse("--threads: the plant is in one piece, expected --parts 2 or more, or --parts ship")
        if threads > 1:
            case.options["workers"] = min(len(case.options["parts"]), threads)
        results = _simulate(case, out, report=not no_report, resume=resume)
        _say_results(results)
        if results.summary.get("interrupted"):
            raise typer.Exit(INTERRUPTED)
        if not results.ok:
            raise typer.Exit(VIOLATED)


@app.command()
def live(
    scenario: ScenarioArgument = "mission",
    ship: RunShipOption = None,
    fidelity: FidelityOption = None,
    step: StepOption = None,
    until: UntilOption = None,
    set_: SetOption = None,
    out: OutOption = None,
    waveforms: WaveformsOption = None,
    parts: PartsOption = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no report.html.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted run.")] = False,
    cores: Annotated[
        str | None,
        typer.Option(
            help="Processor cores to run the steps on, such as 1 or 0,1,2. On several the plant is cut: as --parts or "
            "the ship's file says, else into as many parts."
        ),
    ] = None,
    factor: Annotated[float, typer.Option(help="Simulated over wall-clock time.")] = 1.0,
    overrun: Annotated[
        str,
        typer.Option(help="After an overrun: catch up, or let the plan begin anew.", metavar="catch-up|re-anchor"),
    ] = "catch-up",
    console: Annotated[str | None, typer.Option(help="Serve the operator console.", metavar="HOST:PORT")] = None,
    modbus: Annotated[str | None, typer.Option(help="Serve Modbus TCP.", metavar="HOST:PORT")] = None,
    udp: Annotated[str | None, typer.Option(help="Send and receive UDP.", metavar="HOST:PORT")] = None,
    on_loss: Annotated[
        str,
        typer.Option(
            help="What becomes of the commands of a lost controller: they are held, go to standstill over a ramp, or "
            "back to the scenario's.",
            metavar="hold|safe|local",
        ),
    ] = "hold",
    timeout: Annotated[str, typer.Option(help="Silence after which a controller is lost.")] = "500ms",
) -> None:
    """Run a scenario paced to the wall clock, at 30 us unless a step is given; Ctrl-C stops it, --resume goes on.

    A step that ends too late is an overrun; how many there were, how late, and why, is said at the end. Controllers on
    --udp and --modbus need a token: that of the environment variable SHIPGRID_TOKEN (16 hexadecimal digits), else one
    is drawn and printed.
    """
    if console is not None:
        _refuse("--console: not in this version")
    with _errors_as_exit_status():
        from shipgrid.realtime.executive import Executive
        from shipgrid.scenarios.simulate import default_place

        gateway = _gateway({"udp": udp, "modbus": modbus}, on_loss, timeout)
        asked, found = _cores(cores)
        executive = Executive(factor, overrun, cores=found, attached=gateway and partial(_serve, gateway))
        if resume:
            scenario, out = _unfinished_case(scenario, out)
        case = _case(scenario, ship, fidelity, step, until, set_ or [], waveforms or [], parts, asked, live=True)
        executive.cores = found[: max(1, len(case.options.get("parts") or ()))]
        for core in found[len(executive.cores) :]:
            typer.echo(f"--cores: the plant has no part for core {core}", err=True)
        place = out or default_place(case.scenario, "live")
        results = _simulate(case, place, report=not no_report, resume=resume, live=executive)
        _say_results(results)
        _say_realtime(results.summary["realtime"])
        if gateway is not None:
            _say_gateway(results.summary["realtime"]["gateway"])
        if results.summary.get("interrupted"):
            raise typer.Exit(INTERRUPTED)
        if not results.ok:
            raise typer.Exit(VIOLATED)


@app.command("parts")
def parts_(
    scenario: ScenarioArgument = "mission",
    ship: RunShipOption = None,
    parts: Annotated[
        str | None,
        typer.Option(
            help="How many parts, or those of the ship's file.", metavar="N|ship", show_default="the ship's, or 2"
        ),
    ] = None,
    fidelity: FidelityOption = None,
    step: StepOption = None,
    until: Annotated[
        str | None,
        typer.Option(
            help="How long to sail, cut and whole; 0s: not at all.", show_default="2 s beyond the first command"
        ),
    ] = None,
    set_: SetOption = None,
) -> None:
    """Show the parts a plant can be cut into, the lines between them, and the error that the cut introduces.

    The error: both the cut plant and the whole one are sailed through the scenario, and every public signal is compared
    at every step. Nothing is written.
    """
    with _errors_as_exit_status():
        sails = _quantity("--until", until, "s") != 0.0
        case = _case(scenario, ship, fidelity, step, until if sails else None, set_ or [], [], parts, 2)
        groups = case.options.get("parts")
        if groups is None:
            _refuse("parts: the plant stays whole, so that there is nothing to show")
        from shipgrid.cli.parts import show_error, show_parts
        from shipgrid.scenarios.against_uncut import against_uncut
        from shipgrid.scenarios.parts import partition_of

        h, detail = case.step, case.options["fidelity"]
        show_parts(partition_of(case.ship, groups, h, detail, case.scenario.rules), h)
        if sails:
            first = min((t for t, *_ in case.scenario.events), default=0.0)
            end = case.options["until"] or min(first + SAILED, case.scenario.duration)
            typer.echo(f"sailing {case.scenario.name} for {end:g} s at {detail} fidelity, cut and whole", err=True)
            found = against_uncut(case.ship, case.scenario, groups, end, fidelity=detail, step=h)
            show_error(case.ship, found, end)


@app.command()
def check(
    files: Annotated[list[Path] | None, typer.Argument(help="Ship and scenario files.")] = None,
    schema: Annotated[
        str | None, typer.Option(help="Print the JSON Schema of such files, for editors.", metavar="|".join(SCHEMAS))
    ] = None,
) -> None:
    """Validate files: every error at once, as file:line: path: what is wrong, what is expected.

    Scenarios are checked for the ships given with them, or for the ferry.
    """
    with _errors_as_exit_status():
        if schema is not None:
            _print_schema(schema, files)
            return
        if not files:
            _refuse("check: no files given, expected ship and scenario files, or --schema ship|scenario")
        from shipgrid.errors import InputErrors
        from shipgrid.io.run_file import is_run_file, read_run_file
        from shipgrid.io.scenario_file import read_scenario
        from shipgrid.io.ship_file import open_document, read_ship
        from shipgrid.io.yaml_lines import read_document

        documents = [read_document(path) for path in files]
        runs = [document for document in documents if is_run_file(document)]
        scenarios = [document for document in documents if "scenario" in document.root and document not in runs]
        ships = [read_ship(document) for document in documents if document not in [*scenarios, *runs]]
        problems = []
        for document in runs:
            try:
                read_run_file(document)
            except InputErrors as wrong:
                problems += wrong.problems
        problems += [line for reading in ships for line in reading.problems.lines()]
        for scenario in scenarios:
            for reading in ships or [read_ship(open_document("ship", "ferry"))]:
                problems += read_scenario(scenario, reading.catalogue).problems.lines()
        if problems:
            raise InputErrors(list(dict.fromkeys(problems)))
        typer.echo(f"{len(files)} file{'s' if len(files) > 1 else ''} checked, no mistakes found")


def _print_schema(what: str, files: list[Path] | None) -> None:
    from shipgrid.io import schema

    if what not in SCHEMAS:
        _refuse(f"--schema: no schema of the name '{what}'{_nearest(what, SCHEMAS)}, expected {' or '.join(SCHEMAS)}")
    if files:
        _refuse("--schema: prints a schema and checks no files, expected one or the other")
    made = schema.ship_schema() if what == "ship" else schema.scenario_schema()
    typer.echo(json.dumps(made, indent=2))


@app.command()
def explain(ship: ShipOption = "ferry", step: StepOption = None) -> None:
    """Show what the assembler makes of a ship: buses, islands, stages, stiffest time constants against the step."""
    with _errors_as_exit_status():
        from shipgrid.cli.explain import explain_ship
        from shipgrid.io.ship_file import load_ship

        seconds = _quantity("--step", step, "s")
        explain_ship(load_ship(ship), seconds or 30e-6)


@app.command("list")
def list_(
    what: Annotated[str | None, typer.Argument(help="What to list.", metavar=f"[{'|'.join(LISTS)}]")] = None,
    ship: Annotated[
        str | None,
        typer.Option(help="Whose registers: a bundled ship by name, or a .yaml file.", metavar="NAME|FILE"),
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Registers as comma-separated values.")] = False,
) -> None:
    """List ships, scenarios, equipment, components, signals, commands, or the registers that field buses have."""
    with _errors_as_exit_status():
        from shipgrid.cli import listing

        if what is not None and what not in LISTS:
            _refuse(f"list: nothing to list of the name '{what}'{_nearest(what, LISTS)}, expected {', '.join(LISTS)}")
        if what == "registers":
            listing.registers(ship or "ferry", csv=csv)
            return
        for option, given in (("ship", ship is not None), ("csv", csv)):
            if given:
                _refuse(f"--{option}: belongs to `list registers`")
        for name in (what,) if what else ("ships", "scenarios"):
            getattr(listing, name)()
        if what is None:
            typer.echo(f"More: shipgrid list {'|'.join(LISTS[2:])}")


@app.command()
def plot(
    results: Annotated[Path, typer.Argument(help="Folder of a run.")],
    signals: Annotated[list[str], typer.Argument(help="Signals, such as dc_for.v_dc.", metavar="SIGNAL...")],
    from_: Annotated[str | None, typer.Option("--from", help="Begin here, such as 170s.")] = None,
    to: Annotated[str | None, typer.Option(help="End here, such as 200s.")] = None,
    out: Annotated[Path, typer.Option(help="Picture to write: .png, .svg or .pdf.")] = Path("plot.png"),
) -> None:
    """Plot signals of a run, those of one unit in one panel."""
    with _errors_as_exit_status():
        start, end = _quantity("--from", from_, "s"), _quantity("--to", to, "s")
        from shipgrid.io.plot import plot as draw
        from shipgrid.scenarios.results import open_results

        with open_results(results) as opened:
            draw(opened, signals, out, -math.inf if start is None else start, math.inf if end is None else end)
        typer.echo(f"{out} written")


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(help="Folder of a run.", metavar="RESULTS")],
    second: Annotated[Path, typer.Argument(help="Folder of another.", metavar="RESULTS")],
    means: Annotated[
        bool, typer.Option("--means", help="Compare means over recording intervals, without ripple.")
    ] = False,
) -> None:
    """Compare two runs signal by signal: largest and mean difference."""
    with _errors_as_exit_status():
        from shipgrid.analysis.compare import compare as compare_runs
        from shipgrid.cli import listing
        from shipgrid.scenarios.results import open_results

        with open_results(first) as a, open_results(second) as b:
            comparison = compare_runs(a, b, means=means)
        rows = [
            (d.signal, d.unit, f"{d.largest:.4g}", f"{d.at:.2f}", f"{d.mean:.4g}", f"{d.relative:.2e}")
            for d in comparison.differences
        ]
        heads = ("signal", "unit", "largest difference", "at, s", "mean difference", "largest, relative")
        listing.table(f"{second} minus {first}", heads, rows)
        for folder, only in ((first, comparison.only_first), (second, comparison.only_second)):
            if only:
                typer.echo(f"only in {folder}: {', '.join(only)}")


@app.command()
def warm() -> None:
    """Compile the kernels of the bundled ship into the user's cache, so that no run waits for the compiler."""
    with _errors_as_exit_status():
        from shipgrid.cli.bench import warm_up

        typer.echo(f"kernels ready in {warm_up():.1f} s")


@app.command()
def bench(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Measure start-up, compile and step times of the bundled cases (minutes: it compiles everything anew)."""
    with _errors_as_exit_status():
        from shipgrid.cli import listing
        from shipgrid.cli.bench import flat, measure

        figures = measure()
        if as_json:
            typer.echo(json.dumps(figures, indent=2))
        else:
            rows = [(name, f"{value:.4g}" if isinstance(value, float) else str(value)) for name, value in flat(figures)]
            listing.table("bench", ("figure", "value"), rows)


class Case:
    """What one run is asked for, checked."""

    def __init__(self, ship: Any, scenario: Any, options: dict[str, Any]):
        self.ship = ship
        self.scenario = scenario
        self.options = options

    @property
    def step(self) -> float:
        """Step [s]: what is asked for, or the scenario's (averaged only), or 30 us."""
        from shipgrid.scenarios.case import DEFAULT_STEP

        of_scenario = self.scenario.step if self.options["fidelity"] == "averaged" else None
        return self.options["step"] or of_scenario or DEFAULT_STEP


def _case(
    scenario: str,
    ship: str | None,
    fidelity: str | None,
    step: str | None,
    until: str | None,
    changes: list[str],
    waveforms: list[str],
    parts: str | None = None,
    cores: int = 1,
    *,
    live: bool = False,
) -> Case:
    """Read files and options; every mistake of all of them in one go.

    On more than one core a plant is cut, if it is not said how: as its file says, else into as many parts. A live run
    has no use for the scenario's step, which is for offline runs.
    """
    from shipgrid.assembly.partition import SURPLUS
    from shipgrid.errors import InputErrors, ParameterError
    from shipgrid.io.run_file import is_run_file, read_run_file
    from shipgrid.io.scenario_file import LONGEST_STEP, SHORTEST_STEP, read_case, step_range
    from shipgrid.io.ship_file import open_document
    from shipgrid.model.network import FIDELITIES
    from shipgrid.scenarios.case import DEFAULT_STEP
    from shipgrid.scenarios.parts import parts_wanted

    problems: list[str] = []

    def seconds(option: str, text: str | None) -> float | None:
        try:
            return _quantity(option, text, "s")
        except InputErrors as wrong:
            problems.extend(wrong.problems)
        return None

    if fidelity is not None and fidelity not in FIDELITIES:
        expected = " or ".join(FIDELITIES)
        problems.append(f"--fidelity: no fidelity '{fidelity}'{_nearest(fidelity, FIDELITIES)}, expected {expected}")
    step_s, until_s = seconds("--step", step), seconds("--until", until)
    if step_s is not None and not SHORTEST_STEP <= step_s <= LONGEST_STEP:
        problems.append(f"--step: {step} is out of range, expected {step_range()}")
    if until_s is not None and until_s <= 0.0:
        problems.append(f"--until: {until} is not after the start, expected a time after 0 s")
    windows = [window for text in waveforms if (window := _window(text, problems))]
    overrides = []
    for text in changes:
        path, equals, value = text.partition("=")
        if not equals or not path.strip():
            problems.append(f"--set {text}: is not PATH=VALUE, such as equipment.bess_for.capacity='160 Ah'")
        else:
            overrides.append((path.strip(), value.strip()))
    document, given, groups = open_document("scenario", scenario), (), None
    try:
        if is_run_file(document):
            if ship is not None:
                problems.append(f"--ship: {scenario} has its ship in it, expected none")
            repeated = read_run_file(document, overrides)
            loaded_ship, loaded_scenario, overrides = repeated.ship, repeated.scenario, list(repeated.overrides.items())
            fidelity, step_s = fidelity or repeated.fidelity, step_s or repeated.step
            until_s, windows = until_s or repeated.until, windows or list(repeated.waveforms)
            given, groups = repeated.outside, repeated.parts or None
            if given and step_s != repeated.step:
                problems.append(
                    f"--step: the commands of {scenario} belong to steps of {repeated.step:g} s, expected none"
                )
            _say_version(scenario, repeated)
        else:
            loaded_ship, loaded_scenario = read_case(open_document("ship", ship or "ferry"), document, overrides)
            if cores > 1:
                parts = parts or ("ship" if loaded_ship.parts else str(cores))
    except InputErrors as wrong:
        raise InputErrors([*problems, *wrong.problems]) from None
    if until_s is not None and until_s > loaded_scenario.duration:
        end = f"{loaded_scenario.duration:g} s"
        problems.append(f"--until: {until} is after the scenario's end, expected at most {end} (or --set duration)")
    run_end = min(until_s or math.inf, loaded_scenario.duration)
    for start, stop in windows:
        if stop > run_end:
            problems.append(
                f"--waveforms: {start:g} s to {stop:g} s is not within the run, expected an end up to {run_end:g} s"
            )
    step_s = step_s or (DEFAULT_STEP if live else None)
    options: dict[str, Any] = {"fidelity": fidelity or "averaged", "step": step_s, "until": until_s}
    options |= ({"waveforms": windows} if windows else {}) | ({"outside": given} if given else {})
    case = Case(loaded_ship, loaded_scenario, options | {"overrides": dict(overrides)})
    if parts is not None:
        try:
            groups = parts_wanted(loaded_ship, parts, case.step)
        except ParameterError as wrong:
            problems.append(f"--{wrong}")
    if problems:
        raise InputErrors(problems)
    if parts is not None and parts.isdecimal() and int(parts) > len(groups or [""]):
        found = f"has {len(groups)} parts" if groups else "stays whole"
        typer.echo(
            f"--parts: {loaded_ship.name} {found} at steps of {1e6 * case.step:g} us: any other line would have a "
            f"surplus above {100.0 * SURPLUS:g} %; what is to be cut all the same can be said in the ship's file",
            err=True,
        )
    if groups:
        case.options["parts"] = groups
    return case


def _unfinished_case(scenario: str, out: Path | None) -> tuple[str, Path | None]:
    """The run.yaml and the place of a run that is to be continued, where it is named by the run.yaml in its folder."""
    from shipgrid.scenarios.output_folder import MARK, place_of, unfinished

    path = Path(scenario)
    if path.name != MARK:
        return scenario, out
    place = place_of(path.parent)
    if not path.exists():  # killed before there was a folder in the place
        path = next((folder / MARK for folder in unfinished(place)), path)
    return str(path), out or place


def _say_version(path: str, repeated: Any) -> None:
    """A run repeats to the bit with the program that made it; say so where this is another."""
    import shipgrid

    if repeated.version != shipgrid.__version__:
        typer.echo(f"{path} was written by shipgrid {repeated.version}, this is {shipgrid.__version__}", err=True)


def _window(text: str, problems: list[str]) -> tuple[float, float] | None:
    """From and to [s] of `170s:170.2s`; None, and a problem more, if it is no window."""
    from shipgrid.errors import ParameterError
    from shipgrid.io.quantities import parse_quantity

    try:
        start, end = (parse_quantity(part, "s") for part in text.split(":", 1))
        if 0.0 <= start < end:
            return start, end
        problems.append(f"--waveforms: {text} ends before it begins or begins before 0 s, expected FROM:TO")
    except (ParameterError, ValueError) as wrong:
        what = wrong if isinstance(wrong, ParameterError) else f"'{text}' is not a window"
        problems.append(f"--waveforms: {what}, expected FROM:TO, such as 170s:170.2s")
    return None


def _cores(text: str | None) -> tuple[int, list[int]]:
    """How many processor cores `--cores` names, and which of them there are: the others are left out, and said."""
    from shipgrid.assembly.crew import cores
    from shipgrid.errors import InputErrors

    if text is None:
        return 1, []
    words = [word.strip() for word in text.split(",")]
    if not all(word.isdecimal() for word in words) or len({int(word) for word in words}) < len(words):
        raise InputErrors([f"--cores: '{text}' is no list of cores, expected numbers such as 0,1,2, each once"])
    present, asked = cores(), [int(word) for word in words]
    found = [core for core in asked if core in present]
    there = ", ".join(map(str, present))
    if not found:
        raise InputErrors([f"--cores: '{text}' is no core of this machine, expected one of {there}"])
    if len(found) < len(asked):
        left = ", ".join(str(core) for core in asked if core not in present)
        typer.echo(f"--cores: there is no core {left} here ({there}); the plant is cut all the same", err=True)
    return len(asked), found


def _gateway(buses: dict[str, str | None], on_loss: str, timeout: str) -> Any:
    """The gateway that is asked for, if any; what listens where others can reach it is said."""
    from shipgrid.errors import InputErrors
    from shipgrid.realtime.desk import LOST
    from shipgrid.realtime.gateway import Gateway

    problems: list[str] = []
    if on_loss not in LOST:
        problems.append(f"--on-loss: nothing is done by the name '{on_loss}', expected {', '.join(LOST)}")
    seconds = 0.0
    try:
        seconds = _quantity("--timeout", timeout, "s") or 0.0
        if seconds <= 0.0:
            problems.append(f"--timeout: {timeout} is no time to wait, expected more than 0 s")
    except InputErrors as wrong:
        problems += wrong.problems
    places = {name: _address(f"--{name}", text, problems) for name, text in buses.items() if text is not None}
    digits = os.environ.get(TOKEN, "") if places else ""
    if digits and (len(digits) != 16 or not set(digits.lower()) <= set("0123456789abcdef")):
        problems.append(f"{TOKEN}: is no token, expected 16 hexadecimal digits")
    if problems:
        raise InputErrors(problems)
    if not places:
        return None
    for name, address in places.items():
        if address is not None and not ipaddress.ip_address(address[0]).is_loopback:
            said = (
                f"--{name}: listens on {address[0]}, which other machines may reach; the token goes there unencrypted"
            )
            typer.echo(said, err=True)
    gateway = Gateway(places.get("udp"), places.get("modbus"), on_loss, seconds)
    if digits:
        gateway.token = int(digits, 16)
    else:
        typer.echo(f"token of this run: {gateway.token:016x} (or set {TOKEN})", err=True)
    return gateway


def _address(option: str, text: str, problems: list[str]) -> tuple[str, int] | None:
    """Address in numbers and port of `HOST:PORT`, `[::1]:502`; None, and a problem more, if it is none."""
    host, colon, port = text.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    expected = "expected HOST:PORT, such as 127.0.0.1:5020 or [::1]:5020"
    if not colon or not host or (":" in host and not bracketed):
        problems.append(f"{option}: '{text}' is no address, {expected}")
    elif not (port.isascii() and port.isdecimal()) or int(port) > 65535:
        problems.append(f"{option}: '{port}' is no port, expected 0 to 65535 (0: any that is free)")
    else:
        try:
            found = socket.getaddrinfo(host.strip("[]") if bracketed else host, int(port), type=socket.SOCK_STREAM)
            return str(found[0][4][0]), int(port)
        except (OSError, UnicodeError) as wrong:
            problems.append(f"{option}: there is no host '{host}' ({wrong}), {expected}")
    return None


def _serve(gateway: Any, shared: Any, run: Any) -> Callable[[], dict[str, Any]]:
    """Start the gateway with the run, and say where it listens and what the registers are."""
    end = gateway.start(shared, run)
    for bus, (host, port) in gateway.listening.items():
        typer.echo(f"{bus} on {f'[{host}]' if ':' in host else host}:{port}", err=True)
    typer.echo(f"registers in {run.folder / 'registers.csv'}", err=True)
    return end


def _say_gateway(found: dict[str, Any]) -> None:
    counted = {what: count for what, count in found.items() if what not in ("listening", "on_loss", "failure")}
    said = ", ".join(f"{count} {what}" for what, count in sorted(counted.items())) or "nobody called"
    typer.echo(f"gateway: {said}")
    if found["failure"]:
        typer.echo(f"{found['failure']}; commands were held, and the run went on without it", err=True)


def _simulate(case: Case, out: Path | None, *, report: bool, resume: bool, live: Any = None) -> Any:
    """Say what will be done, then do it behind a progress bar."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from shipgrid.scenarios import simulate as simulation
    from shipgrid.scenarios.output_folder import place_of, unfinished

    console = Console(stderr=True)
    scenario, options = case.scenario, case.options
    end, step = options["until"] or scenario.duration, case.step
    console.print(
        f"[bold]{scenario.name}[/] of {case.ship.name}: {end:g} s in {round(end / step):,} steps of {step * 1e6:g} us, "
        f"{options['fidelity']}; {_contents(scenario)}",
        soft_wrap=True,
    )
    if "parts" in options:
        _say_cut(case, len(live.cores) or 1 if live else options.get("workers", 1))
    left = [] if resume else unfinished(out or simulation.default_place(scenario, options["fidelity"]))
    for folder in left:
        what = "is replaced by this run" if folder == place_of(folder) else "stays as it is"
        console.print(f"an unfinished run lies in {folder} and {what}; --resume would continue it", soft_wrap=True)
    columns = (
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        TextColumn("{task.fields[speed]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("run", total=end, speed="starting")
        begun = 0.0

        def found(at: float, folder: Path) -> None:
            nonlocal begun
            begun = at
            console.print(f"continued at {at:g} s of {end:g} s, from the last snapshot in {folder}", soft_wrap=True)

        def planned(seconds: float) -> None:
            each = 1e6 * seconds / max(1, round((end - begun) / step))
            took = f"{each:.1f} us a step in a trial at the start"
            paced = "" if live is None else f" of {1e6 * step / live.factor:.4g} us"
            console.print(f"{took}{paced}" if paced else f"about {_duration(seconds)}: {took}", soft_wrap=True)
            bar.reset(task, speed="")

        def progress(now: float, total: float) -> None:
            elapsed = bar.tasks[0].elapsed or 0.0
            speed = f"{(now - begun) / elapsed:.1f} x real time" if elapsed > 0.0 else ""
            bar.update(task, completed=now, total=total, speed=speed)

        return simulation.simulate(
            case.ship,
            scenario,
            out=out,
            report=report,
            progress=progress,
            planned=planned,
            resume=resume,
            found=found,
            live=live,
            **options,
        )


def _contents(scenario: Any) -> str:
    """What a scenario has, in words."""
    waiting = f"{len(scenario.entries)} entries that wait, " if scenario.entries else ""
    return f"{len(scenario.events)} commands, {waiting}{len(scenario.requirements)} requirements"


def _say_cut(case: Case, threads: int) -> None:
    """Say where the plant is cut."""
    from shipgrid.cli.parts import show_lines
    from shipgrid.scenarios.parts import partition_of

    made = partition_of(case.ship, case.options["parts"], case.step, case.options["fidelity"], case.scenario.rules)
    names = ", ".join(made.buses)
    typer.echo(f"cut into {len(made.parts)} parts ({names}) on {threads} core{'s' if threads > 1 else ''}", err=True)
    show_lines(made, case.step, stderr=True)


def _against_reference(case: Case) -> None:
    """Run the window of `--waveforms` with both solvers and print how far each signal differs; nothing is written."""
    from shipgrid.cli import listing

    windows = case.options.get("waveforms", [])
    if len(windows) != 1:
        _refuse("--reference: needs the window to run with both solvers, expected one --waveforms FROM:TO")
    from shipgrid.scenarios.against_reference import against_reference

    start, end = windows[0]
    took = (
        f"{1e3 * (end - start):g} ms with the reference solver, seconds of computing for each; no results are written"
    )
    typer.echo(took, err=True)
    fidelity, step = case.options["fidelity"], case.options["step"]
    found = against_reference(case.ship, case.scenario, windows[0], fidelity=fidelity, step=step)
    rows = [
        (d.signal, d.unit, f"{d.largest:.3g}", f"{d.at:.6g}", f"{d.rms:.3g}", f"{d.size:.4g}", f"{d.relative:.1e}")
        for d in found
    ]
    heads = ("signal", "unit", "largest difference", "at, s", "rms", "largest value", "relative")
    listing.table("fast solver minus reference solver", heads, rows)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{seconds:.2g} s"


def _say_results(results: Any) -> None:
    from shipgrid.cli import listing

    summary = results.summary
    rows, outside, unknown = [], 0, []
    for verdict in results.requirements:
        value = "" if verdict.value is None else f"{verdict.value:.5g} {verdict.unit}"
        if verdict.verdict != "not evaluated":
            rows.append((verdict.name, verdict.signal, _limits(verdict), value, verdict.verdict, verdict.source))
        elif verdict.unit:
            outside += 1
        else:  # nothing of that name was recorded
            unknown.append(verdict.signal)
    if rows:
        heads = ("name", "signal", "limit", "value", "verdict", "source")
        shown = len(heads) if any(row[-1] for row in rows) else len(heads) - 1  # where none says its source: no column
        listing.table("requirements", heads[:shown], [row[:shown] for row in rows])
    if outside:
        typer.echo(f"{outside} not evaluated (outside the run)")
    if unknown:
        typer.echo(f"{len(unknown)} not evaluated (not recorded: {', '.join(dict.fromkeys(unknown))})")
    for outcome in results.timeline:
        if outcome.missing:
            typer.echo(f"time-line: {outcome.text}")
    for verdict in results.class_limits:
        if verdict.verdict == "violated":
            value = f"{verdict.value:.5g} {verdict.unit}"
            typer.echo(f"limit of class violated: {verdict.name}, {verdict.signal}, {_limits(verdict)}: {value}")
    if results.at_limit:
        rows = [
            (limiter.signal, f"{100.0 * limiter.share:.3g} %", _duration(limiter.duration_s), limiter.meaning)
            for limiter in results.at_limit
        ]
        listing.table("at a limit for 1 % of the time or more", ("limiter", "of the time", "in all", "while"), rows)
    typer.echo(
        f"{summary.get('simulated_s', 0.0):g} s in {summary.get('wall_s', 0.0):.1f} s "
        f"({summary.get('us_per_step', 0.0):.2f} us a step); "
        f"energy balance {100.0 * summary.get('energy_balance_error', 0.0):.3f} %; {results.folder}"
    )
    if summary.get("interrupted"):
        typer.echo(
            "interrupted: the results so far are kept; the same command with --resume continues the run", err=True
        )


def _say_realtime(found: dict[str, Any]) -> None:
    """Say what became of the clock, and of what would have helped it."""
    from shipgrid.cli import listing
    from shipgrid.realtime.monitor import LONGEST, NAMES

    def micro(which: str, seconds: float | None) -> str:
        more = ">= " if which != "worst" and seconds is not None and seconds >= LONGEST else ""
        return "" if seconds is None else f"{more}{1e6 * seconds:.2f}"

    rows = [(name, *(micro(p, found[name].get(p)) for p in PERCENTILES)) for name in NAMES]
    for k, (who, core) in enumerate(zip(found.get("crew", ()), found.get("cores", ()), strict=True), start=1):
        name = f"core {k} ({who['core']}): {', '.join(who['parts'])}"
        rows.append((name, *(micro(p, core.get(p)) for p in PERCENTILES)))
    listing.table("time of a step, us", ("", *PERCENTILES), rows)
    for worst in found["worst_steps"][:WORST_SHOWN]:
        took = f"{1e6 * worst['computation_s']:.1f} us"
        typer.echo(
            f"at {worst['t_s']:.5f} s a step took {took}, begun {1e6 * worst['lateness_s']:.1f} us late: "
            f"{worst['cause']}"
        )
    for group, rows_lost in found["rows_lost"].items():
        typer.echo(f"{rows_lost} rows of {group} were lost: the disk was too slow", err=True)
    said = "; ".join(f"{what}: {state}" for what, state in found["scheduling"].items())
    typer.echo(
        f"{said}; {found['stalls_while_waiting']} stalls of the machine while there was nothing to do, "
        f"the longest {1e6 * found['longest_stall_s']:.0f} us"
    )
    typer.echo(found["verdict"])


def _limits(verdict: Any) -> str:
    if not verdict.rule:
        return f"{verdict.measure} {_range(verdict.limit, verdict.unit)}"
    words = {"recovery": "outside for", "settles": "settled in"}[verdict.rule]
    band = _range(verdict.inside, verdict.inside_unit)
    return f"{verdict.measure} {band}, {words} {_range(verdict.limit, 's')}"


def _range(limit: Any, unit: str) -> str:
    low, high = limit
    if low is None:
        return f"<= {high:.5g} {unit}"
    return f">= {low:.5g} {unit}" if high is None else f"{low:.5g} .. {high:.5g} {unit}"


def _quantity(option: str, text: str | None, unit: str) -> float | None:
    if text is None:
        return None
    from shipgrid.errors import InputErrors, ParameterError
    from shipgrid.io.quantities import parse_quantity

    try:
        return parse_quantity(text, unit)
    except ParameterError as wrong:
        raise InputErrors([f"{option}: {wrong}"]) from None


def _nearest(word: str, valid: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(word, valid, n=1, cutoff=0.5)
    return f" (nearest: '{near[0]}')" if near else ""


def _refuse(what: str) -> NoReturn:
    typer.echo(what, err=True)
    raise typer.Exit(BAD_INPUT)


@contextmanager
def _errors_as_exit_status() -> Iterator[None]:
    """Turn the error family into messages on the error stream and the exit status of its kind."""
    from shipgrid.errors import InputErrors, ParameterError, ShipgridError, TopologyError

    try:
        yield
    except InputErrors as wrong:
        for line in wrong.problems:
            typer.echo(line, err=True)
        raise typer.Exit(BAD_INPUT) from None
    except (ParameterError, TopologyError) as wrong:
        typer.echo(str(wrong), err=True)
        raise typer.Exit(BAD_INPUT) from None
    except ShipgridError as wrong:
        typer.echo(f"the simulation failed: {wrong}", err=True)
        raise typer.Exit(FAILED) from None
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        # `shipgrid list signals | head` is no mistake.
        sys.stderr.close()
        raise typer.Exit(0) from None


main: Callable[[], None] = app

if __name__ == "__main__":
    main()
