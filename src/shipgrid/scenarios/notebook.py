"""What notebooks show of a run: its verdicts and figures as a table in HTML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from shipgrid.html_table import table

SIGN = {"met": "✓", "violated": "✗", "not evaluated": "–"}


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
