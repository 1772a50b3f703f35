"""`shipgrid warm` and `shipgrid bench`: the bundled cases, from cold files to steps."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from shipgrid.cli.exit_status import errors_as_exit_status
from shipgrid.cli.table import table


def warm() -> None:
    """Compile the kernels of the bundled ship into the user's cache, so that no run waits for the compiler."""
    with errors_as_exit_status():
        typer.echo(f"kernels ready in {warm_up():.1f} s")


def bench(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Measure start-up, compile and step times of the bundled cases (minutes: it compiles everything anew)."""
    with errors_as_exit_status():
        figures = measure()
        if as_json:
            typer.echo(json.dumps(figures, indent=2))
        else:
            rows = [(name, f"{value:.4g}" if isinstance(value, float) else str(value)) for name, value in flat(figures)]
            table("bench", ("figure", "value"), rows)


def warm_up() -> float:
    """Compile every component type of the package, so that no ship waits for one; returns the seconds it took."""
    from shipgrid.assembly.code_store import compile_missing
    from shipgrid.model.component import load_all

    began = time.perf_counter()
    compile_missing(kind for kind in load_all().values() if kind.cls.__module__.startswith("shipgrid."))
    return time.perf_counter() - began


def measure() -> dict[str, Any]:
    """Times of every bundled case, each started in processes of their own, on one core.

    Returns
    -------
    dict
        `cases`, by ship, scenario and fidelity: `cold` and `warm` start (`start_case`, and `process_s` from the start
        of the process to its first step) and `steps` by step length (`step_times`); and the provenance. The first case
        of a ship and fidelity starts with nothing compiled, its `cold` is with the compiler; the others find what that
        one compiled.
    """
    import tempfile

    from shipgrid.errors import InputErrors
    from shipgrid.io.scenario_file import load_case
    from shipgrid.io.ship_file import bundled
    from shipgrid.model.network import FIDELITIES
    from shipgrid.scenarios import provenance
    from shipgrid.scenarios import simulate as simulation
    from shipgrid.scenarios.case import DEFAULT_STEP

    cases: dict[str, Any] = {}
    for ship in bundled("ship"):
        with tempfile.TemporaryDirectory() as cache:
            for scenario, fidelity in itertools.product(bundled("scenario"), FIDELITIES):
                try:
                    loaded = load_case(ship, scenario)[1]
                except InputErrors:  # a scenario for another ship
                    continue
                of_scenario = loaded.step if fidelity == "averaged" else None
                steps = sorted({DEFAULT_STEP, of_scenario or DEFAULT_STEP})
                case = (cache, ship, scenario, fidelity)
                cold, warm = _in_a_process(*case, []), _in_a_process(*case, steps)
                cases[f"{ship} {scenario} {fidelity}"] = {"cold": cold, "steps": warm.pop("steps"), "warm": warm}
    return {
        "cases": cases,
        **provenance.provenance(simulation.build(load_case("ferry", "mission")[0], DEFAULT_STEP)),
    }


def flat(figures: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Names, joined by points, and values of nested figures.

    Parameters
    ----------
    figures : mapping of str to Any
        Values, or mappings like it.
    above : str
        What every name begins with.
    """
    for name, value in figures.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def _in_a_process(cache: str, ship: str, scenario: str, fidelity: str, steps: list[float]) -> dict[str, Any]:
    code = f"from shipgrid.cli.bench_case import child; child({ship!r}, {scenario!r}, {fidelity!r}, {steps!r})"
    began = time.time()
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "SHIPGRID_CACHE": cache},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    figures = json.loads(done.stdout)
    figures["process_s"] = figures.pop("first_step_at") - began
    return figures
