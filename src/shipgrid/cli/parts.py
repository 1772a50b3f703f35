"""`shipgrid parts`: the parts of a plant, the lines between them, and what error the cut introduces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from shipgrid.cli.exit_status import errors_as_exit_status, refuse
from shipgrid.cli.options import (
    FidelityOption,
    RunShipOption,
    ScenarioArgument,
    SetOption,
    StepOption,
    quantity_of_option,
)
from shipgrid.cli.request import TypedOptions, read_request
from shipgrid.cli.table import table

if TYPE_CHECKING:
    from shipgrid.assembly.partition import Partition
    from shipgrid.scenarios.against_reference import Deviation

SAILED = 2.0
"""Time [s] beyond the first command that a cut plant and a whole one are sailed."""
WORST = 10
"""Signals that are shown besides the voltages of the buses."""


def parts(
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
    with errors_as_exit_status():
        sails = quantity_of_option("--until", until, "s") != 0.0
        typed = TypedOptions(scenario, ship, fidelity, step, until if sails else None, set_ or (), parts=parts, cores=2)
        request = read_request(typed)
        groups = request.options.get("parts")
        if groups is None:
            refuse("parts: the plant stays whole, so that there is nothing to show")
        from shipgrid.scenarios.against_uncut import against_uncut
        from shipgrid.scenarios.parts import partition_of

        h, detail = request.step, request.options["fidelity"]
        show_parts(partition_of(request.ship, groups, h, detail, request.scenario.rules), h)
        if sails:
            first = min((t for t, *_ in request.scenario.events), default=0.0)
            end = request.options["until"] or min(first + SAILED, request.scenario.duration)
            typer.echo(f"sailing {request.scenario.name} for {end:g} s at {detail} fidelity, cut and whole", err=True)
            deviations = against_uncut(request.ship, request.scenario, groups, end, fidelity=detail, step=h)
            show_error(request.ship, deviations, end)


def show_parts(partition: Partition, step: float) -> None:
    """Print parts and lines of a plant.

    Parameters
    ----------
    partition : Partition
        Of the plant.
    step : float
        Step [s].
    """
    rows = [
        (name, ", ".join(buses), str(len(part.placed)), str(len(part.foreign)))
        for (name, buses), part in zip(partition.buses.items(), partition.parts, strict=True)
    ]
    table("Parts", ("part", "buses", "components", "signals it reads of others"), rows)
    show_lines(partition, step)


def show_lines(partition: Partition, step: float, *, stderr: bool = False) -> None:
    """Print the stub lines between the parts of a plant.

    Parameters
    ----------
    partition : Partition
        Of the plant.
    step : float
        Step [s], which is the delay of each line.
    stderr : bool
        Print them to the error stream.
    """
    rows = [
        (line.path, " and ".join(line.parts), f"{1e6 * line.L:.4g} uH", f"{1e6 * line.C:.4g} uF", _share(line.share))
        for line in partition.lines
    ]
    heads = ("element", "between", "inductance", "surplus capacitance", "over that of its better end")
    table(f"Lines of a delay of {1e6 * step:g} us where the plant is cut", heads, rows, stderr=stderr)


def show_error(ship: Any, deviations: Sequence[Deviation], until: float) -> None:
    """Print how far a cut plant was from the whole one: the voltages of the buses, and the worst of all signals.

    Parameters
    ----------
    ship : Ship
        Whose buses are shown.
    deviations : sequence of Deviation
        By signal, the worst first.
    until : float
        How long both were sailed [s].
    """
    buses = [f"{name}.{bar.signals[0].name}" for name, bar in ship.buses.items()]
    shown = [d for d in deviations if d.signal in buses]
    shown += [d for d in deviations if d.signal not in buses][:WORST]
    rows = [
        (d.signal, d.unit, f"{d.largest:.3g}", f"{d.at:.6g}", f"{d.rms:.3g}", f"{d.size:.4g}", f"{d.relative:.1e}")
        for d in shown
    ]
    heads = ("signal", "unit", "largest difference", "at, s", "rms", "largest of its unit", "relative")
    table(f"Cut minus whole, {until:g} s: bus voltages, and the worst signals", heads, rows)


def _share(share: float) -> str:
    return f"{100.0 * share:.3g} %" if share < 1e6 else "there is none"
