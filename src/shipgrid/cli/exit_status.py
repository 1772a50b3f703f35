"""Exit status of the command `shipgrid`, and how errors become one.

0 done; 1 a requirement is violated, or what the time-line waited for never happened; 2 bad input; 3 the simulation
failed; 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import typer

VIOLATED, BAD_INPUT, FAILED, INTERRUPTED = 1, 2, 3, 130


def refuse(message: str) -> NoReturn:
    """End the command for bad input.

    Parameters
    ----------
    message : str
        What is wrong and what is expected; it goes to the error stream.
    """
    typer.echo(message, err=True)
    raise typer.Exit(BAD_INPUT)


def exit_for_results(results: Any) -> None:
    """End the command with the status of a run, where that is not 0.

    Parameters
    ----------
    results : Results
        Of the run, as far as it went.
    """
    if results.summary.get("interrupted"):
        raise typer.Exit(INTERRUPTED)
    if not results.ok:
        raise typer.Exit(VIOLATED)


@contextmanager
def errors_as_exit_status() -> Iterator[None]:
    """Turn the error family into messages on the error stream and the exit status of its kind."""
    from shipgrid.errors import InputErrors, ParameterError, ShipgridError, TopologyError

    try:
        yield
    except InputErrors as wrong:
        for line in wrong.problems:
            typer.echo(line, err=True)
        raise typer.Exit(BAD_INPUT) from None
    except (ParameterError, TopologyError) as wrong:
        typer.echo(str(wrong), err=True)
        raise typer.Exit(BAD_INPUT) from None
    except ShipgridError as wrong:
        typer.echo(f"the simulation failed: {wrong}", err=True)
        raise typer.Exit(FAILED) from None
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        # `shipgrid list signals | head` is no mistake.
        sys.stderr.close()
        raise typer.Exit(0) from None
