"""Tables in HTML, as notebooks show them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

MOST_ROWS = 40
"""Rows of a table that are shown; it says how many more there are."""


def table(caption: str, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table, its longest rows cut off.

    Parameters
    ----------
    caption : str
    head : sequence of str
        Names of the columns.
    rows : iterable of sequence
        Texts, and numbers, which are shown with four digits.
    """
    shown = [list(row) for row in rows]
    more = len(shown) - MOST_ROWS
    parts = [f"<table><caption>{escape(caption)}</caption><tr>"]
    parts += [f"<th>{escape(name)}</th>" for name in head]
    for row in shown[:MOST_ROWS]:
        parts += ["</tr><tr>", *(f"<td>{escape(_cell(cell))}</td>" for cell in row)]
    if more > 0:
        parts += [f'</tr><tr><td colspan="{len(head)}">and {more} more</td>']
    return "".join([*parts, "</tr></table>"])


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)
