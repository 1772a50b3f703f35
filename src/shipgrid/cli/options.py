"""Arguments and options that several commands share, and the reading of a quantity in one.

What an argument of a command means is its help, so that it is written once; the docstring of a command is its help too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
NoReportOption = Annotated[bool, typer.Option("--no-report", help="Write no report.html.")]


def quantity_of_option(option: str, text: str | None, unit: str) -> float | None:
    """Value in SI of a quantity with its unit; None where the option is not given.

    Parameters
    ----------
    option : str
        As it is typed, such as "--until".
    text : str, optional
        What is typed behind it, such as "600 s".
    unit : str
        SI unit, such as "s".

    Raises
    ------
    InputErrors
        If the text is no such quantity.
    """
    if text is None:
        return None
    from shipgrid.errors import InputErrors, ParameterError
    from shipgrid.io.quantities import parse_quantity

    try:
        return parse_quantity(text, unit)
    except ParameterError as wrong:
        raise InputErrors([f"{option}: {wrong}"]) from None
