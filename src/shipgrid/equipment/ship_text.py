"""Writes a ship as the text of a ship file: what differs from the defaults of its kinds, in SI units."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from shipgrid.equipment.declaration import default_of, fields_of_kind, is_required
from shipgrid.model.component import unit_of

PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_./+-]*( [A-Za-z0-9_./+-]+)*")
"""Texts that stand in a file as they are."""


def ship_text(
    name: str,
    buses: Mapping[str, Any],
    equipment: Mapping[str, Any],
    hull: Any = None,
    parts: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """Text of a ship file.

    Parameters
    ----------
    name : str
        Of the ship.
    buses, equipment : mapping of str to object
        Buses and plant items by name: instances of their kinds' classes, or mappings of keys to texts as a file has
        them, `{"kind": "dc", "v_n": "750 V"}`.
    hull : object or mapping, optional
    parts : mapping of str to sequence of str, optional
        Buses by the name of a part.
    """
    lines = ["schema: 1", f"ship: {_word(name)}"]
    for section, entries in (("buses", buses), ("equipment", equipment)):
        lines.append(f"{section}:" if entries else f"{section}: {{}}")
        lines += [f"  {_word(key)}: {_entry(entry)}" for key, entry in entries.items()]
    if hull is not None:
        lines.append(f"hull: {_entry(hull, kind=False)}")
    if parts:
        lines.append("parts:")
        lines += [f"  {_word(key)}: [{', '.join(map(_word, names))}]" for key, names in parts.items()]
    return "\n".join([*lines, ""])


def mapping_text(entries: Mapping[str, Any]) -> str:
    """Text of a file with these keys at its top.

    Parameters
    ----------
    entries : mapping of str to object
        Texts, numbers, true and false, lists and mappings of such.
    """
    return "\n".join([*(f"{_word(key)}: {_text(value)}" for key, value in entries.items()), ""])


def _entry(entry: Any, *, kind: bool = True) -> str:
    """A bus, an item or a hull in braces."""
    if isinstance(entry, Mapping):
        return _mapping({key: _text(value) for key, value in entry.items()})
    return _mapping(({"kind": _word(_kind(entry))} if kind else {}) | _fields(entry, {}))


def _kind(entry: Any) -> str:
    declared = getattr(entry, "__equipment__", None)
    return declared.kind if declared is not None else entry.kind


def _fields(entry: Any, defaults: Mapping[str, Any]) -> dict[str, str]:
    """Fields that are required or not at their default, as texts."""
    found = {}
    for key, (field, hint) in fields_of_kind(type(entry)).items():
        value = getattr(entry, field.name)
        if not is_required(field) and value == defaults.get(field.name, default_of(field)):
            continue
        if "block" in field.metadata:
            found[key] = _mapping(_fields(value, field.metadata["defaults"]))
        elif "curve" in field.metadata and not isinstance(value, str):
            found[key] = f"[{', '.join(_pair(pair, field.metadata['curve']) for pair in value)}]"
        elif unit_of(hint) is not None:
            found[key] = _quantity(float(value), unit_of(hint) or "1")
        else:
            found[key] = _text(value)
    return found


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return _mapping({key: _text(inner) for key, inner in value.items()})
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return _word(value) if isinstance(value, str) else repr(value)


def _mapping(texts: Mapping[str, str]) -> str:
    return "{" + ", ".join(f"{_word(key)}: {text}" for key, text in texts.items()) + "}"


def _quantity(value: float, unit: str) -> str:
    return repr(float(value)) if unit == "1" else f"{float(value)!r} {unit}"


def _pair(values: Sequence[float], units: tuple[str, str]) -> str:
    return f"[{_quantity(values[0], units[0])}, {_quantity(values[1], units[1])}]"


def _word(text: str) -> str:
    return text if PLAIN.fullmatch(text) else json.dumps(text, ensure_ascii=False)
