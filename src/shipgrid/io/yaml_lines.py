"""YAML 1.2 read into a tree in which every key and every value knows its file and line.

Scalars stay the text they were written as: what `12:30`, `1e3` or `true` means is for the reader of that entry to
say, not for YAML. Mistakes are collected in `Problems`, all of them, a duplicate key among them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from shipgrid.errors import InputErrors
from shipgrid.names import nearest


@dataclass(frozen=True)
class Place:
    """Where something is written: a file (or `--set`) and a line counted from 1 (0: no line)."""

    file: str
    line: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}" if self.line else self.file


@dataclass
class Problems:
    """The mistakes found so far."""

    found: list[tuple[Place, str]] = field(default_factory=list)

    def add(self, place: Place, path: str, what: str) -> None:
        """Note one mistake: `what` is wrong with the entry `path` at `place`, and what is expected."""
        line = f"{place}: {path}: {what}" if path else f"{place}: {what}"
        if (place, line) not in self.found:
            self.found.append((place, line))

    def extend(self, other: Problems) -> None:
        """Note all of another list."""
        self.found += [entry for entry in other.found if entry not in self.found]

    def __len__(self) -> int:
        return len(self.found)

    def lines(self) -> list[str]:
        """All mistakes as text, in the order of the file."""
        order = {place.file: k for k, (place, _) in reversed(list(enumerate(self.found)))}
        return [line for _, line in sorted(self.found, key=lambda entry: (order[entry[0].file], entry[0].line))]

    def raise_if_any(self) -> None:
        """Raise all of them at once.

        Raises
        ------
        InputErrors
            If there is any.
        """
        if self.found:
            raise InputErrors(self.lines())


@dataclass(frozen=True)
class Scalar:
    """A single value, as text; `empty` where nothing is written."""

    text: str
    place: Place
    empty: bool = False


@dataclass(frozen=True)
class Section:
    """A mapping of keys to nodes, in the order of the file; `keys` has the place of each key."""

    entries: dict[str, Node]
    keys: dict[str, Place]
    place: Place

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    def __iter__(self) -> Iterator[tuple[str, Node]]:
        return iter(self.entries.items())

    def get(self, key: str) -> Node | None:
        """Node of a key, or None."""
        return self.entries.get(key)


@dataclass(frozen=True)
class Listing:
    """A list of nodes."""

    items: tuple[Node, ...]
    place: Place


Node = Scalar | Section | Listing


@dataclass(frozen=True)
class Document:
    """One file as read.

    Attributes
    ----------
    root : Section
        Its content.
    file : str
        What it is called in messages.
    problems : Problems
        The mistakes of its syntax.
    source : str or None
        Its text, comments and all; None where entries were changed since.
    """

    root: Section
    file: str
    problems: Problems
    source: str | None = None

    def replaced(self, path: str, text: str, shown_as: str) -> Document:
        """A variant with one entry changed or added, see the function `replaced`."""
        return replaced(self, path, text, shown_as)

    def plain(self) -> dict[str, Any]:
        """The content as dictionaries, lists and texts."""
        return _plain(self.root)

    def text(self) -> str:
        """The content as YAML: as it was read, or, with entries changed since, without comments."""
        if self.source is not None:
            return self.source
        from io import StringIO

        from ruamel.yaml import YAML

        stream = StringIO()
        yaml = YAML(typ="safe", pure=True)
        yaml.default_flow_style = False
        yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
        # What would otherwise be read as a number or a boolean is quoted, and reads back as the same text.
        yaml.dump(self.plain(), stream)
        return stream.getvalue()


def read_document(path: str | Path, shown_as: str | None = None) -> Document:
    """Read a YAML file.

    Parameters
    ----------
    path : str or Path
        The file.
    shown_as : str, optional
        What messages call it; its path if left out.

    Returns
    -------
    Document
        Whatever could be read; `problems` has what is wrong with the syntax, and duplicate keys.
    """
    shown = shown_as or str(path)
    try:
        return read_text(Path(path).read_bytes().decode("utf-8"), shown)
    except UnicodeDecodeError as wrong:
        return _unreadable(shown, f"is not UTF-8 text ({wrong.reason})")
    except OSError as wrong:
        return _unreadable(shown, f"cannot be read: {wrong.strerror}")


def read_text(text: str, shown_as: str) -> Document:
    """Read YAML from text; see `read_document`."""
    problems = Problems()
    node = _compose(text, shown_as, problems)
    if not isinstance(node, Section):
        if not problems:
            problems.add(Place(shown_as, 1), "", "is not a mapping of keys to values, expected 'schema: 1' and so on")
        node = Section({}, {}, Place(shown_as, 1))
    return Document(node, shown_as, problems, text)


def read_value(text: str, place: Place, problems: Problems) -> Node | None:
    """Read one value, as on the right of a colon, that is written at `place`."""
    node = _compose(text, place.file, problems)
    return None if node is None else _moved(node, place)


def replaced(document: Document, path: str, text: str, shown_as: str) -> Document:
    """The document with one entry changed or added.

    Parameters
    ----------
    document : Document
        The original, not changed.
    path : str
        Keys from the root, joined by points; a place in a list by its number from 0.
    text : str
        New value, as in the file.
    shown_as : str
        What messages call the place of the new value, such as `--set`.

    Returns
    -------
    Document
        The variant; if the path leads nowhere or the value is no YAML, `problems` says so.
    """
    problems = Problems(list(document.problems.found))
    place = Place(shown_as)
    root: Node = document.root
    value = read_value(text, place, problems) if text.strip() else Scalar("", place, empty=True)
    if isinstance(value, Scalar) and value.empty:
        problems.add(place, path, "no value given, expected one")
    elif not all(path.split(".")):
        problems.add(place, path or "''", "is not a path, expected keys joined by points")
    elif value is not None:
        try:
            root = _put(document.root, path.split("."), value, place, 0)
        except LookupError as wrong:
            problems.add(place, path, str(wrong.args[0]))
    assert isinstance(root, Section)
    return replace(document, root=root, problems=problems, source=None)


def _put(node: Node, steps: Sequence[str], value: Node, place: Place, depth: int) -> Node:
    if not steps:
        return value
    if isinstance(node, Listing):
        if not steps[0].isdigit() or int(steps[0]) >= len(node.items):
            raise LookupError(f"'{steps[0]}' is not a place in a list of {len(node.items)}, expected a number from 0")
        k = int(steps[0])
        items = list(node.items)
        items[k] = _put(items[k], steps[1:], value, place, depth + 1)
        return Listing(tuple(items), node.place)
    if isinstance(node, Scalar):
        raise LookupError(f"there is nothing inside '{node.text}', expected the path of an entry")
    length = _key_length(node, steps)
    key = ".".join(steps[:length])
    inner = node.entries.get(key, Section({}, {}, place))
    rest = steps[length:]
    # A block left out of the file may be begun here; an item may not: it would be a slip in its name. The hull is one.
    if depth < 2 and rest and key not in node and key != "set":
        raise LookupError(f"no entry '{key}'{nearest(key, node.entries)}, expected the path of one")
    # Commands are keys with a point in them: `set: {bess_for.i_ref: -128 A}`.
    below = depth + (2 if key == "hull" else 1)
    changed = _put(inner, [".".join(rest)] if key == "set" and rest else rest, value, place, below)
    return Section({**node.entries, key: changed}, {**node.keys, key: node.keys.get(key, place)}, node.place)


def _key_length(section: Section, steps: Sequence[str]) -> int:
    """How many steps make up the key: the most that together are a key of the section, or one."""
    lengths = range(len(steps), 1, -1)
    return next((length for length in lengths if ".".join(steps[:length]) in section), 1)


def _unreadable(shown: str, what: str) -> Document:
    problems = Problems()
    problems.add(Place(shown), "", what)
    return Document(Section({}, {}, Place(shown)), shown, problems)


def _compose(text: str, shown_as: str, problems: Problems) -> Node | None:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError
    from ruamel.yaml.reader import ReaderError

    try:
        raw = YAML(typ="rt").compose(text)
    except MarkedYAMLError as wrong:
        mark = wrong.problem_mark or wrong.context_mark
        line = mark.line + 1 if mark is not None else 1
        problems.add(Place(shown_as, line), "", f"is not YAML: {wrong.problem or wrong.context}")
        return None
    except ReaderError as wrong:
        line = text.count("\n", 0, wrong.position) + 1 if isinstance(wrong.position, int) else 1
        problems.add(Place(shown_as, line), "", "has a character that YAML does not allow")
        return None
    except (YAMLError, RecursionError, ValueError) as wrong:
        problems.add(Place(shown_as, 1), "", f"is not YAML: {wrong}")
        return None
    if raw is None:
        problems.add(Place(shown_as, 1), "", "is empty")
        return None
    return _Converter(shown_as, problems).node(raw, "")


class _Converter:
    """Turns ruamel's node graph into the tree; an alias is the node it stands for."""

    def __init__(self, file: str, problems: Problems):
        self.file = file
        self.problems = problems
        self.done: dict[int, Node] = {}
        self.open: set[int] = set()

    def node(self, raw: Any, path: str) -> Node:
        place = self.place(raw)
        if id(raw) in self.open:
            self.problems.add(place, path, "contains itself, expected a tree")
            return Scalar("", place, empty=True)
        if id(raw) not in self.done:
            self.open.add(id(raw))
            self.done[id(raw)] = self.convert(raw, place, path)
            self.open.discard(id(raw))
        return self.done[id(raw)]

    def convert(self, raw: Any, place: Place, path: str) -> Node:
        if raw.id == "sequence":
            return Listing(tuple(self.node(item, f"{path}.{k}") for k, item in enumerate(raw.value)), place)
        if raw.id == "scalar":
            return Scalar(raw.value, place, empty=raw.value == "" or str(raw.tag).endswith(":null"))
        section = Section({}, {}, place)
        for raw_key, raw_value in raw.value:
            here = self.place(raw_key)
            if raw_key.id != "scalar":
                self.problems.add(here, path, "a key is not a word")
                continue
            key = raw_key.value
            if self.is_decimal_comma(section, raw_key, raw_value):
                last = next(reversed(section.entries))
                before = section.entries[last]
                assert isinstance(before, Scalar)
                section.entries[last] = replace(before, text=f"{before.text},{key}")
                continue
            inside = f"{path}.{key}" if path else key
            value = self.node(raw_value, inside)
            if key in section.entries:
                first = section.keys[key].line
                self.problems.add(here, inside, f"duplicate key, first given on line {first}; expected once")
                continue
            section.entries[key] = value
            section.keys[key] = here
        return section

    def is_decimal_comma(self, section: Section, raw_key: Any, raw_value: Any) -> bool:
        """Whether `{v_n: 1,5 kV}` was meant as one value: inside braces the comma begins another key, `5 kV`."""
        before = next(reversed(section.entries.values()), None)
        empty = (
            raw_value.id == "scalar" and raw_value.value == "" and raw_value.start_mark.index == raw_key.end_mark.index
        )
        return empty and isinstance(before, Scalar) and before.text[-1:].isdigit() and raw_key.value[:1].isdigit()

    def place(self, raw: Any) -> Place:
        return Place(self.file, raw.start_mark.line + 1)


def _moved(node: Node, place: Place) -> Node:
    if isinstance(node, Scalar):
        return replace(node, place=place)
    if isinstance(node, Listing):
        return Listing(tuple(_moved(item, place) for item in node.items), place)
    entries = {key: _moved(value, place) for key, value in node}
    return Section(entries, dict.fromkeys(entries, place), place)


def _plain(node: Node) -> Any:
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Listing):
        return [_plain(item) for item in node.items]
    return {key: _plain(value) for key, value in node}
