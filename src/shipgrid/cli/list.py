"""`shipgrid list`: what there is to choose from; the tables are made in `list_tables.py`."""

from __future__ import annotations

from typing import Annotated

import typer

from shipgrid.cli.exit_status import errors_as_exit_status, refuse
from shipgrid.names import similar

LISTS = ("ships", "scenarios", "equipment", "components", "signals", "commands", "registers")
"""What can be listed: the names of the functions of `list_tables.py`."""


def list_(
    what: Annotated[str | None, typer.Argument(help="What to list.", metavar=f"[{'|'.join(LISTS)}]")] = None,
    ship: Annotated[
        str | None,
        typer.Option(help="Whose registers: a bundled ship by name, or a .yaml file.", metavar="NAME|FILE"),
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Registers as comma-separated values.")] = False,
) -> None:
    """List ships, scenarios, equipment, components, signals, commands, or the registers that field buses have."""
    with errors_as_exit_status():
        from shipgrid.cli import list_tables

        if what is not None and what not in LISTS:
            refuse(f"list: nothing to list of the name '{what}'{similar(what, LISTS)}, expected {', '.join(LISTS)}")
        if what == "registers":
            list_tables.registers(ship or "ferry", csv=csv)
            return
        for option, given in (("ship", ship is not None), ("csv", csv)):
            if given:
                refuse(f"--{option}: belongs to `list registers`")
        for name in (what,) if what else ("ships", "scenarios"):
            getattr(list_tables, name)()
        if what is None:
            typer.echo(f"More: shipgrid list {'|'.join(LISTS[2:])}")
