"""`shipgrid explain`: what the assembler makes of a ship; the tables are made in `explain_tables.py`."""

from __future__ import annotations

from shipgrid.cli.exit_status import errors_as_exit_status
from shipgrid.cli.options import ShipOption, StepOption, quantity_of_option


def explain(ship: ShipOption = "ferry", step: StepOption = None) -> None:
    """Show what the assembler makes of a ship: buses, islands, stages, stiffest time constants against the step."""
    with errors_as_exit_status():
        from shipgrid.cli.explain_tables import explain_ship
        from shipgrid.io.ship_file import load_ship

        seconds = quantity_of_option("--step", step, "s")
        explain_ship(load_ship(ship), seconds or 30e-6)
