"""`shipgrid check`: every mistake of ship and scenario files at once, and the JSON Schema of such files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from shipgrid.cli.exit_status import errors_as_exit_status, refuse
from shipgrid.names import similar

SCHEMAS = ("ship", "scenario")


def check(
    files: Annotated[list[Path] | None, typer.Argument(help="Ship and scenario files.")] = None,
    schema: Annotated[
        str | None, typer.Option(help="Print the JSON Schema of such files, for editors.", metavar="|".join(SCHEMAS))
    ] = None,
) -> None:
    """Validate files: every error at once, as file:line: path: what is wrong, what is expected.

    Scenarios are checked for the ships given with them, or for the ferry.
    """
    with errors_as_exit_status():
        if schema is not None:
            _print_schema(schema, files)
            return
        if not files:
            refuse("check: no files given, expected ship and scenario files, or --schema ship|scenario")
        from shipgrid.errors import InputErrors

        problems = _mistakes_in(files)
        if problems:
            raise InputErrors(list(dict.fromkeys(problems)))
        typer.echo(f"{len(files)} file{'s' if len(files) > 1 else ''} checked, no mistakes found")


def _mistakes_in(files: list[Path]) -> list[str]:
    """Mistakes of run files, of ships, and of scenarios for each of these ships; a scenario's may come repeatedly."""
    from shipgrid.errors import InputErrors
    from shipgrid.io.run_file import is_run_file, read_run_file
    from shipgrid.io.scenario_file import read_scenario
    from shipgrid.io.ship_file import open_document, read_ship
    from shipgrid.io.yaml_lines import read_document

    documents = [read_document(path) for path in files]
    runs = [document for document in documents if is_run_file(document)]
    scenarios = [document for document in documents if "scenario" in document.root and document not in runs]
    ships = [read_ship(document) for document in documents if document not in [*scenarios, *runs]]
    problems = []
    for document in runs:
        try:
            read_run_file(document)
        except InputErrors as wrong:
            problems += wrong.problems
    problems += [line for reading in ships for line in reading.problems.lines()]
    for scenario in scenarios:
        for reading in ships or [read_ship(open_document("ship", "ferry"))]:
            problems += read_scenario(scenario, reading.catalogue).problems.lines()
    return problems


def _print_schema(what: str, files: list[Path] | None) -> None:
    from shipgrid.io import schema

    if what not in SCHEMAS:
        refuse(f"--schema: no schema of the name '{what}'{similar(what, SCHEMAS)}, expected {' or '.join(SCHEMAS)}")
    if files:
        refuse("--schema: prints a schema and checks no files, expected one or the other")
    made = schema.ship_schema() if what == "ship" else schema.scenario_schema()
    typer.echo(json.dumps(made, indent=2))
