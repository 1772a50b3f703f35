"""What notebooks show of a run: its verdicts and figures as a table in HTML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

MOST_ROWS = 40
"""Rows of a table that are shown; it says how many more there are."""
SIGN = {"met": "✓", "violated": "✗", "not evaluated": "–"}


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


def verdicts(caption: str, requirements: Iterable[Any]) -> str:
    """Requirements, what became of them.

    Parameters
    ----------
    caption : str
    requirements : iterable of Verdict
    """
    head = ("", "requirement", "signal", "value", "limits", "unit")
    rows = [(SIGN.get(v.verdict, v.verdict), v.name, v.signal, v.value, _limits(v.limit), v.unit) for v in requirements]
    return table(caption, head, rows)


def _limits(limit: Sequence[float] | None) -> str:
    return "" if limit is None else " .. ".join(f"{end:.4g}" for end in limit if end is not None)


def ledgers(caption: str, energy: Mapping[str, Mapping[str, float]]) -> str:
    """Energies by ledger and component.

    Parameters
    ----------
    caption : str
    energy : mapping of str to mapping of str to float
        Energy [J] by ledger and path.
    """
    rows = [(ledger, path, joule) for ledger, of in energy.items() for path, joule in of.items() if joule]
    return table(caption, ("ledger", "component", "energy [J]"), rows)
