"""What is printed after a run: requirements, limits, the energy balance, and the clock of a live run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import typer

from shipgrid.cli.table import duration_text, table

PERCENTILES = ("p50", "p99", "p99.99", "worst")
WORST_SHOWN = 5
"""Steps of a live run that are shown one by one, the worst first."""


def print_results(results: Any) -> None:
    """Print verdicts, limiters, times and the folder of a run.

    Parameters
    ----------
    results : Results
        Of the run, as far as it went.
    """
    summary = results.summary
    _print_requirements(results)
    for outcome in results.timeline:
        if outcome.missing:
            typer.echo(f"time-line: {outcome.text}")
    for verdict in results.class_limits:
        if verdict.verdict == "violated":
            value = f"{verdict.value:.5g} {verdict.unit}"
            typer.echo(f"limit of class violated: {verdict.name}, {verdict.signal}, {_limits(verdict)}: {value}")
    if results.at_limit:
        rows = [
            (limiter.signal, f"{100.0 * limiter.share:.3g} %", duration_text(limiter.duration_s), limiter.meaning)
            for limiter in results.at_limit
        ]
        table("at a limit for 1 % of the time or more", ("limiter", "of the time", "in all", "while"), rows)
    typer.echo(
        f"{summary.get('simulated_s', 0.0):g} s in {summary.get('wall_s', 0.0):.1f} s "
        f"({summary.get('us_per_step', 0.0):.2f} us a step); "
        f"energy balance {100.0 * summary.get('energy_balance_error', 0.0):.3f} %; {results.folder}"
    )
    if summary.get("interrupted"):
        typer.echo(
            "interrupted: the results so far are kept; the same command with --resume continues the run", err=True
        )


def _print_requirements(results: Any) -> None:
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
        table("requirements", heads[:shown], [row[:shown] for row in rows])
    if outside:
        typer.echo(f"{outside} not evaluated (outside the run)")
    if unknown:
        typer.echo(f"{len(unknown)} not evaluated (not recorded: {', '.join(dict.fromkeys(unknown))})")


def print_realtime(realtime: Mapping[str, Any]) -> None:
    """Print what became of the clock, and of what would have helped it.

    Parameters
    ----------
    realtime : mapping of str to Any
        The part `realtime` of the summary of a live run.
    """
    from shipgrid.realtime.monitor import LONGEST, NAMES

    def micro(which: str, seconds: float | None) -> str:
        more = ">= " if which != "worst" and seconds is not None and seconds >= LONGEST else ""
        return "" if seconds is None else f"{more}{1e6 * seconds:.2f}"

    rows = [(name, *(micro(p, realtime[name].get(p)) for p in PERCENTILES)) for name in NAMES]
    for k, (who, core) in enumerate(zip(realtime.get("crew", ()), realtime.get("cores", ()), strict=True), start=1):
        name = f"core {k} ({who['core']}): {', '.join(who['parts'])}"
        rows.append((name, *(micro(p, core.get(p)) for p in PERCENTILES)))
    table("time of a step, us", ("", *PERCENTILES), rows)
    for worst in realtime["worst_steps"][:WORST_SHOWN]:
        took = f"{1e6 * worst['computation_s']:.1f} us"
        typer.echo(
            f"at {worst['t_s']:.5f} s a step took {took}, begun {1e6 * worst['lateness_s']:.1f} us late: "
            f"{worst['cause']}"
        )
    for group, rows_lost in realtime["rows_lost"].items():
        typer.echo(f"{rows_lost} rows of {group} were lost: the disk was too slow", err=True)
    scheduling = "; ".join(f"{what}: {state}" for what, state in realtime["scheduling"].items())
    typer.echo(
        f"{scheduling}; {realtime['stalls_while_waiting']} stalls of the machine while there was nothing to do, "
        f"the longest {1e6 * realtime['longest_stall_s']:.0f} us"
    )
    typer.echo(realtime["verdict"])


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
