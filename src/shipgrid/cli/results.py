"""`shipgrid plot` and `shipgrid compare`: what is made of the folders of runs that have been."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from shipgrid.cli.exit_status import errors_as_exit_status
from shipgrid.cli.options import quantity_of_option
from shipgrid.cli.table import table


def plot(
    results: Annotated[Path, typer.Argument(help="Folder of a run.")],
    signals: Annotated[list[str], typer.Argument(help="Signals, such as dc_for.v_dc.", metavar="SIGNAL...")],
    from_: Annotated[str | None, typer.Option("--from", help="Begin here, such as 170s.")] = None,
    to: Annotated[str | None, typer.Option(help="End here, such as 200s.")] = None,
    out: Annotated[Path, typer.Option(help="Picture to write: .png, .svg or .pdf.")] = Path("plot.png"),
) -> None:
    """Plot signals of a run, those of one unit in one panel."""
    with errors_as_exit_status():
        start, end = quantity_of_option("--from", from_, "s"), quantity_of_option("--to", to, "s")
        from shipgrid.io.plot import plot as draw
        from shipgrid.scenarios.results import open_results

        with open_results(results) as opened:
            draw(opened, signals, out, -math.inf if start is None else start, math.inf if end is None else end)
        typer.echo(f"{out} written")


def compare(
    first: Annotated[Path, typer.Argument(help="Folder of a run.", metavar="RESULTS")],
    second: Annotated[Path, typer.Argument(help="Folder of another.", metavar="RESULTS")],
    means: Annotated[
        bool, typer.Option("--means", help="Compare means over recording intervals, without ripple.")
    ] = False,
) -> None:
    """Compare two runs signal by signal: largest and mean difference."""
    with errors_as_exit_status():
        from shipgrid.analysis.compare import compare as compare_runs
        from shipgrid.scenarios.results import open_results

        with open_results(first) as a, open_results(second) as b:
            comparison = compare_runs(a, b, means=means)
        rows = [
            (d.signal, d.unit, f"{d.largest:.4g}", f"{d.at:.2f}", f"{d.mean:.4g}", f"{d.relative:.2e}")
            for d in comparison.differences
        ]
        heads = ("signal", "unit", "largest difference", "at, s", "mean difference", "largest, relative")
        table(f"{second} minus {first}", heads, rows)
        for folder, only in ((first, comparison.only_first), (second, comparison.only_second)):
            if only:
                typer.echo(f"only in {folder}: {', '.join(only)}")
