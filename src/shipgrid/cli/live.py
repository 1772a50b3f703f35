"""`shipgrid live`: a scenario paced to the wall clock, with controllers on field buses."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from shipgrid.cli.exit_status import errors_as_exit_status, exit_for_results, refuse
from shipgrid.cli.gateway import gateway_of_options, print_gateway, start_gateway
from shipgrid.cli.options import (
    FidelityOption,
    NoReportOption,
    OutOption,
    PartsOption,
    RunShipOption,
    ScenarioArgument,
    SetOption,
    StepOption,
    UntilOption,
    WaveformsOption,
)
from shipgrid.cli.progress import run_with_progress
from shipgrid.cli.request import TypedOptions, locate_unfinished_run, read_request
from shipgrid.cli.summary import print_realtime, print_results

CoresOption = Annotated[
    str | None,
    typer.Option(
        help="Processor cores to run the steps on, such as 1 or 0,1,2. On several the plant is cut: as --parts or "
        "the ship's file says, else into as many parts."
    ),
]
OverrunOption = Annotated[
    str,
    typer.Option(help="After an overrun: catch up, or let the plan begin anew.", metavar="catch-up|re-anchor"),
]
OnLossOption = Annotated[
    str,
    typer.Option(
        help="What becomes of the commands of a lost controller: they are held, go to standstill over a ramp, or "
        "back to the scenario's.",
        metavar="hold|safe|local",
    ),
]


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
    no_report: NoReportOption = False,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted run.")] = False,
    cores: CoresOption = None,
    factor: Annotated[float, typer.Option(help="Simulated over wall-clock time.")] = 1.0,
    overrun: OverrunOption = "catch-up",
    console: Annotated[str | None, typer.Option(help="Serve the operator console.", metavar="HOST:PORT")] = None,
    modbus: Annotated[str | None, typer.Option(help="Serve Modbus TCP.", metavar="HOST:PORT")] = None,
    udp: Annotated[str | None, typer.Option(help="Send and receive UDP.", metavar="HOST:PORT")] = None,
    on_loss: OnLossOption = "hold",
    timeout: Annotated[str, typer.Option(help="Silence after which a controller is lost.")] = "500ms",
) -> None:
    """Run a scenario paced to the wall clock, at 30 us unless a step is given; Ctrl-C stops it, --resume goes on.

    A step that ends too late is an overrun; how many there were, how late, and why, is said at the end. Controllers on
    --udp and --modbus need a token: that of the environment variable SHIPGRID_TOKEN (16 hexadecimal digits), else one
    is drawn and printed.
    """
    if console is not None:
        refuse("--console: not in this version")
    with errors_as_exit_status():
        from shipgrid.realtime.executive import Executive
        from shipgrid.scenarios.simulate import default_place

        gateway = gateway_of_options({"udp": udp, "modbus": modbus}, on_loss, timeout)
        wanted, present = _cores(cores)
        executive = Executive(factor, overrun, cores=present, attached=gateway and partial(start_gateway, gateway))
        if resume:
            scenario, out = locate_unfinished_run(scenario, out)
        changes, windows = set_ or (), waveforms or ()
        typed = TypedOptions(scenario, ship, fidelity, step, until, changes, windows, parts, wanted, live=True)
        request = read_request(typed)
        executive.cores = present[: max(1, len(request.options.get("parts") or ()))]
        for core in present[len(executive.cores) :]:
            typer.echo(f"--cores: the plant has no part for core {core}", err=True)
        place = out or default_place(request.scenario, "live")
        results = run_with_progress(request, place, report=not no_report, resume=resume, live=executive)
        print_results(results)
        print_realtime(results.summary["realtime"])
        if gateway is not None:
            print_gateway(results.summary["realtime"]["gateway"])
        exit_for_results(results)


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
