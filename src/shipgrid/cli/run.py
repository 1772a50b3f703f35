"""`shipgrid run`: a scenario offline, as fast as it goes."""

from __future__ import annotations

from typing import Annotated

import typer

from shipgrid.cli.exit_status import errors_as_exit_status, exit_for_results, refuse
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
from shipgrid.cli.request import RunRequest, TypedOptions, locate_unfinished_run, read_request
from shipgrid.cli.summary import print_results
from shipgrid.cli.table import table


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
    no_report: NoReportOption = False,
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
    with errors_as_exit_status():
        if resume and reference:
            refuse("--resume: --reference keeps nothing that could be continued, expected one or the other")
        if parts and reference:
            refuse("--parts: --reference runs the whole plant, expected one or the other; see `shipgrid parts`")
        if resume:
            scenario, out = locate_unfinished_run(scenario, out)
        typed = TypedOptions(scenario, ship, fidelity, step, until, set_ or (), waveforms or (), parts)
        request = read_request(typed)
        if reference:
            _compare_with_reference(request)
            return
        if threads > 1 and "parts" not in request.options:
            refuse("--threads: the plant is in one piece, expected --parts 2 or more, or --parts ship")
        if threads > 1:
            request.options["workers"] = min(len(request.options["parts"]), threads)
        results = run_with_progress(request, out, report=not no_report, resume=resume)
        print_results(results)
        exit_for_results(results)


def _compare_with_reference(request: RunRequest) -> None:
    """Run the window of `--waveforms` with both solvers and print how far each signal differs; nothing is written."""
    windows = request.options.get("waveforms", [])
    if len(windows) != 1:
        refuse("--reference: needs the window to run with both solvers, expected one --waveforms FROM:TO")
    from shipgrid.scenarios.against_reference import against_reference

    start, end = windows[0]
    took = (
        f"{1e3 * (end - start):g} ms with the reference solver, seconds of computing for each; no results are written"
    )
    typer.echo(took, err=True)
    fidelity, step = request.options["fidelity"], request.options["step"]
    deviations = against_reference(request.ship, request.scenario, windows[0], fidelity=fidelity, step=step)
    rows = [
        (d.signal, d.unit, f"{d.largest:.3g}", f"{d.at:.6g}", f"{d.rms:.3g}", f"{d.size:.4g}", f"{d.relative:.1e}")
        for d in deviations
    ]
    heads = ("signal", "unit", "largest difference", "at, s", "rms", "largest value", "relative")
    table("fast solver minus reference solver", heads, rows)
