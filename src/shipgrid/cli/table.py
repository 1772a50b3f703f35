"""Tables and durations, as the commands print them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence


def table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], *, stderr: bool = False) -> None:
    """Print a table; into a file or a pipe as wide as its text, so that lines stay whole.

    Parameters
    ----------
    title : str
        Line above the table.
    heads : sequence of str
        Heads of the columns.
    rows : iterable of sequence of str
        Cells, row by row.
    stderr : bool
        Print it to the error stream.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    width = None if (sys.stderr if stderr else sys.stdout).isatty() else 240
    made = Table(title=title, title_justify="left", box=None, pad_edge=False, header_style="bold")
    for head in heads:
        made.add_column(head, overflow="fold")
    for row in rows:
        made.add_row(*(Text(cell) for cell in row))
    Console(width=width, stderr=stderr).print(made)


def duration_text(seconds: float) -> str:
    """Minutes and seconds, or seconds alone where there are less than sixty.

    Parameters
    ----------
    seconds : float
        Duration [s].
    """
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{seconds:.2g} s"
