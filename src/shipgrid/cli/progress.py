"""A run behind a progress bar: what will be done, before it, and how far it is, during it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from shipgrid.cli.parts import show_lines
from shipgrid.cli.request import RunRequest
from shipgrid.cli.table import duration_text

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from shipgrid.scenarios.results import Results


def run_with_progress(
    request: RunRequest, out: Path | None, *, report: bool, resume: bool, live: Any = None
) -> Results:
    """Print what will be done, then do it behind a progress bar.

    Parameters
    ----------
    request : RunRequest
    out : Path, optional
        Folder of the results.
    report : bool
        Write report.html.
    resume : bool
        Continue the unfinished run of that folder.
    live : Executive, optional
        What paces the run to the wall clock.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from shipgrid.scenarios import simulate as simulation

    console = Console(stderr=True)
    _print_plan(console, request, live)
    if not resume:
        _print_unfinished(console, out or simulation.default_place(request.scenario, request.options["fidelity"]))
    columns = (
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        TextColumn("{task.fields[speed]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        shown = _Shown(console, bar, _end(request), request.step, live)
        return simulation.simulate(
            request.ship,
            request.scenario,
            out=out,
            report=report,
            progress=shown.progress,
            planned=shown.planned,
            resume=resume,
            found=shown.continued,
            live=live,
            **request.options,
        )


class _Shown:
    """What a run shows of itself while it goes on, on one console; times in s."""

    def __init__(self, console: Console, bar: Progress, end: float, step: float, live: Any) -> None:
        self.console, self.bar, self.end, self.step, self.live = console, bar, end, step, live
        self.begun = 0.0
        self.task = bar.add_task("run", total=end, speed="starting")

    def continued(self, at: float, folder: Path) -> None:
        """A snapshot was found: the run goes on from there."""
        self.begun = at
        self.console.print(
            f"continued at {at:g} s of {self.end:g} s, from the last snapshot in {folder}", soft_wrap=True
        )

    def planned(self, seconds: float) -> None:
        """Steps were timed in a trial: how long all of them will take."""
        each = 1e6 * seconds / max(1, round((self.end - self.begun) / self.step))
        took = f"{each:.1f} us a step in a trial at the start"
        paced = "" if self.live is None else f" of {1e6 * self.step / self.live.factor:.4g} us"
        text = f"{took}{paced}" if paced else f"about {duration_text(seconds)}: {took}"
        self.console.print(text, soft_wrap=True)
        self.bar.reset(self.task, speed="")

    def progress(self, now: float, total: float) -> None:
        """The run has come so far."""
        elapsed = self.bar.tasks[0].elapsed or 0.0
        speed = f"{(now - self.begun) / elapsed:.1f} x real time" if elapsed > 0.0 else ""
        self.bar.update(self.task, completed=now, total=total, speed=speed)


def _end(request: RunRequest) -> float:
    return request.options["until"] or request.scenario.duration


def _print_plan(console: Console, request: RunRequest, live: Any) -> None:
    scenario, options, end, step = request.scenario, request.options, _end(request), request.step
    waiting = f"{len(scenario.entries)} entries that wait, " if scenario.entries else ""
    contents = f"{len(scenario.events)} commands, {waiting}{len(scenario.requirements)} requirements"
    console.print(
        f"[bold]{scenario.name}[/] of {request.ship.name}: {end:g} s in {round(end / step):,} steps of "
        f"{step * 1e6:g} us, {options['fidelity']}; {contents}",
        soft_wrap=True,
    )
    if "parts" in options:
        _print_cut(request, len(live.cores) or 1 if live else options.get("workers", 1))


def _print_cut(request: RunRequest, threads: int) -> None:
    """Print where the plant is cut."""
    from shipgrid.scenarios.parts import partition_of

    options = request.options
    made = partition_of(request.ship, options["parts"], request.step, options["fidelity"], request.scenario.rules)
    names = ", ".join(made.buses)
    typer.echo(f"cut into {len(made.parts)} parts ({names}) on {threads} core{'s' if threads > 1 else ''}", err=True)
    show_lines(made, request.step, stderr=True)


def _print_unfinished(console: Console, place: Path) -> None:
    from shipgrid.scenarios.output_folder import place_of, unfinished

    for folder in unfinished(place):
        what = "is replaced by this run" if folder == place_of(folder) else "stays as it is"
        console.print(f"an unfinished run lies in {folder} and {what}; --resume would continue it", soft_wrap=True)
