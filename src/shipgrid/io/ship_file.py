"""A ship file read, checked as a whole against the declarations of the equipment, and built into a network.

What a file may say is what `shipgrid.equipment` declares; there is no second list here. Every mistake is found before
anything is built, and named by file, line and path.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from shipgrid.assembly.partition import divide
from shipgrid.equipment.declaration import EQUIPMENT, EquipmentType, default_of, fields_of_kind, is_required
from shipgrid.equipment.ship import BUSBARS, Catalogue, DcBusbar, Ship, breakers_of, commands_of, modes_of
from shipgrid.equipment.ship_text import mapping_text
from shipgrid.errors import ParameterError, ShipgridError, TopologyError
from shipgrid.io.quantities import EXAMPLES, expectation, parse_quantity
from shipgrid.io.yaml_lines import (
    Document,
    Listing,
    Node,
    Place,
    Problems,
    Scalar,
    Section,
    read_document,
    read_text,
    replaced,
)
from shipgrid.model.component import Bounds, load_all, unit_of
from shipgrid.model.network import Network
from shipgrid.names import ITEM_EXPECTED, ITEM_NAME, PART_NAME, nearest, refusal, shown

FEEDS = {
    "rectifier": (None, "bus"),
    "bess": (None, "bus"),
    "inverter": ("bus", "grid"),
    "dc_breaker": ("from_", "to"),
    "ac_breaker": ("from_", "to"),
    "shore_connection": (None, "bus"),
}
"""Kinds that feed a bus: field of the bus the power comes from (None: a source of its own), field of the bus fed."""

BOTH_WAYS = ("dc_breaker", "ac_breaker")
"""Kinds in `FEEDS` through which power goes in either direction."""

NEED_HULL = ("propulsion",)
"""Kinds that push a hull."""


@dataclass(frozen=True)
class ShipReading:
    """What came of reading a ship file: a ship if it has no mistakes, and in any case what a scenario can refer to."""

    ship: Ship | None
    problems: Problems
    catalogue: Catalogue

    def checked(self) -> Ship:
        """The ship.

        Raises
        ------
        InputErrors
            With all its mistakes, if it has any.
        """
        self.problems.raise_if_any()
        assert self.ship is not None
        return self.ship


def load_ship(
    name_or_path: str | Path | Mapping[str, Any] = "ferry", overrides: Iterable[tuple[str, str]] = ()
) -> Ship:
    """Read a ship, a bundled one by name or a file by path.

    Parameters
    ----------
    name_or_path : str, Path or mapping
        Name of a bundled ship, or a path that ends in `.yaml` or `.yml`; or a mapping that says what a file would.
    overrides : iterable of (path, value)
        Entries to change before it is checked, as `--set` does.

    Raises
    ------
    InputErrors
        With every mistake in it.
    """
    return read_ship(open_document("ship", name_or_path), overrides).checked()


def bundled(what: str) -> dict[str, Path]:
    """Bundled files by name; `what` is `ship` or `scenario`."""
    folder = {"ship": "vessels", "scenario": "scenarios/library"}[what]
    root = Path(str(files("shipgrid"))) / folder
    return {path.stem: path for path in sorted(root.glob("*.yaml"))}


def open_document(what: str, source: str | Path | Mapping[str, Any]) -> Document:
    """Read a bundled file by name, any file by path, or what a file would say; a wrong name is among its problems.

    Parameters
    ----------
    what : {"ship", "scenario"}
    source : str, Path or mapping
        A mapping has the keys of a file and its texts: `{"scenario": "short", "duration": "60 s"}`.
    """
    if isinstance(source, Mapping):
        return read_text(mapping_text({"schema": 1, **source}), f"{what} made in Python")
    text, name_or_path = str(source), source
    if isinstance(name_or_path, Path) or "/" in text or "\\" in text or text.endswith((".yaml", ".yml")):
        return read_document(text)
    known = bundled(what)
    if text in known:
        return read_document(known[text], f"{text}.yaml")
    problems = Problems()
    expected = f"no bundled {what} of that name{nearest(text, known)}; expected one, or the path of a .yaml file"
    problems.add(Place(text), "", expected)
    return Document(Section({}, {}, Place(text)), text, problems)


def _ship_of(source: str | Document) -> Ship:
    """The ship of a document, or of a text."""
    return read_ship(read_text(source, "ship made in Python") if isinstance(source, str) else source).checked()


def _drawing_of(ship: Ship) -> str:
    """The one-line diagram with its style, to stand by itself."""
    from shipgrid.io.one_line import one_line, style_by_itself

    title = escape(repr(ship)[1:-1])
    return f"<figure><style>{style_by_itself()}</style>{one_line(ship.document.plain())}<p>{title}</p></figure>"


Ship.reader, Ship.drawer = _ship_of, _drawing_of


def read_ship(document: Document, overrides: Iterable[tuple[str, str]] = ()) -> ShipReading:
    """Check a ship document and make the ship of it."""
    load_all()
    for path, value in overrides:
        document = replaced(document, path, value, f"--set {path}={value}")
    return _ShipReader(document).read()


@dataclass(frozen=True)
class _Reference:
    """A name met in the file, to be looked up once all items are known."""

    owner: str
    field: str
    name: str
    kinds: tuple[str, ...]
    place: Place
    path: str


class _ShipReader:
    def __init__(self, document: Document):
        self.document = document
        self.problems = Problems(list(document.problems.found))
        self.buses: dict[str, Any] = {}
        self.bus_kinds: dict[str, str] = {}
        self.items: dict[str, Any] = {}
        self.kinds: dict[str, EquipmentType] = {}
        self.places: dict[str, Place] = {}
        self.references: list[_Reference] = []

    def read(self) -> ShipReading:
        root = self.document.root
        name, hull, parts = "", None, {}
        # Without a root there is one mistake, that of the syntax; what is missing because of it is not news.
        if root.entries:
            self.head(root)
            name = self.word(root, "ship", "", "the name of the ship") or ""
            if name and (wrong := refusal(name)):
                self.problems.add(root.entries["ship"].place, "ship", wrong)
            self.read_buses(root)
            self.read_items(root)
            hull = self.read_hull(root)
            parts = read_parts(root, self.problems)
            self.check_references()
            self.check_fed()
            self.check_ties(root)
            self.check_batteries(root)
            self.check_gensets(root)
        ship = None
        if not self.problems:
            ship = Ship(name, dict(self.buses), dict(self.items), hull, parts, self.document)
            try:
                catalogue = ship.catalogue
                if parts:
                    self.check_parts(ship, root.keys["parts"])
                return ShipReading(None if self.problems else ship, self.problems, catalogue)
            except ShipgridError as wrong:
                self.problems.add(root.place, "", str(wrong))
        return ShipReading(None, self.problems, self.catalogue())

    def catalogue(self) -> Catalogue:
        """What can be referred to, as far as the items declare it and are readable."""
        signals = {f"{name}.{s.name}": s for name, kind in self.bus_kinds.items() for s in BUSBARS[kind].signals}
        named = {**self.kinds, **({"hull": EQUIPMENT["hull"]} if "hull" in self.document.root else {})}
        signals |= {f"{name}.{s.name}": s for name, kind in named.items() for s in kind.signals}
        unreadable = frozenset(self.places) - set(self.kinds) - set(self.bus_kinds)
        return Catalogue(commands_of(named), signals, breakers_of(self.kinds), unreadable, modes_of(self.kinds))

    def head(self, root: Section) -> None:
        check_head(root, self.problems, ("schema", "ship", "description", "buses", "equipment", "hull", "parts"))

    def word(self, section: Section, key: str, path: str, what: str) -> str | None:
        inside = f"{path}.{key}" if path else key
        node = section.get(key)
        if node is None:
            self.problems.add(section.place, inside, f"missing, expected {what}")
        elif not isinstance(node, Scalar) or node.empty:
            self.problems.add(node.place, inside, f"is not a word, expected {what}")
        else:
            return node.text
        return None

    def sections(self, root: Section, key: str, what: str) -> list[tuple[str, Section, Place]]:
        node = root.get(key)
        if node is None or (isinstance(node, Scalar) and node.empty):
            place = root.place if node is None else node.place
            self.problems.add(place, key, f"missing, expected {what}")
            return []
        if not isinstance(node, Section):
            self.problems.add(node.place, key, f"is not a mapping, expected {what}")
            return []
        found = []
        for name, inner in node:
            place = node.keys[name]
            path = f"{key}.{name}"
            if ITEM_NAME.fullmatch(name) is None or name == "hull":
                self.problems.add(place, f"{key}.{shown(name)[1:-1]}", f"is not a name, {ITEM_EXPECTED} (not 'hull')")
            elif name in self.places:
                self.problems.add(place, path, f"the name is taken on line {self.places[name].line}, expected another")
            elif not isinstance(inner, Section):
                self.problems.add(inner.place, path, "is not a mapping, expected {kind: ..., ...}")
            else:
                self.places[name] = place
                found.append((name, inner, place))
        return found

    def read_buses(self, root: Section) -> None:
        for name, section, _ in self.sections(root, "buses", "the buses, name: {kind: dc, v_n: 750 V}"):
            path = f"buses.{name}"
            kind = self.word(section, "kind", path, "dc or ac")
            if kind is None:
                continue
            if kind not in BUSBARS:
                place = section.entries["kind"].place
                self.problems.add(place, f"{path}.kind", f"no kind of bus '{kind}', expected dc or ac")
                continue
            self.bus_kinds[name] = kind
            values = self.fields(BUSBARS[kind], section, path, name, ("kind",))
            if values is not None:
                self.buses[name] = BUSBARS[kind](**values)

    def read_items(self, root: Section) -> None:
        valid = [kind for kind in EQUIPMENT if kind != "hull"]
        for name, section, place in self.sections(root, "equipment", "the plant items, name: {kind: ..., ...}"):
            path = f"equipment.{name}"
            kind = self.word(section, "kind", path, f"one of {', '.join(valid)}")
            if kind is None:
                continue
            if kind not in valid:
                where = section.entries["kind"].place
                self.problems.add(where, f"{path}.kind", f"no kind of equipment '{kind}'{nearest(kind, valid)}")
                continue
            self.kinds[name] = EQUIPMENT[kind]
            item = self.instance(EQUIPMENT[kind], section, path, name, place, ("kind",))
            if item is not None:
                self.items[name] = item

    def read_hull(self, root: Section) -> Any:
        if "hull" not in root:
            pushers = [name for name, kind in self.kinds.items() if kind.kind in NEED_HULL]
            if pushers:
                self.problems.add(root.place, "hull", f"missing, expected what {pushers[0]} pushes")
            return None
        node = root.entries["hull"]
        if isinstance(node, Scalar) and node.empty:
            node = Section({}, {}, node.place)
        if not isinstance(node, Section):
            self.problems.add(node.place, "hull", "is not a mapping, expected {displacement: 377 t, ...}")
            return None
        return self.instance(EQUIPMENT["hull"], node, "hull", "hull", root.keys["hull"], ())

    def instance(
        self, kind: EquipmentType, section: Section, path: str, name: str, place: Place, known: tuple[str, ...]
    ) -> Any:
        values = self.fields(kind.cls, section, path, name, known)
        if values is None:
            return None
        try:
            return kind.cls(**values)
        except ParameterError as wrong:
            self.problems.add(place, path, str(wrong))
        return None

    def fields(
        self, cls: type, section: Section, path: str, owner: str, known: tuple[str, ...]
    ) -> dict[str, Any] | None:
        """Values for the fields of a declared class, or None if there is a mistake among them."""
        before = len(self.problems)
        declared = fields_of_kind(cls)
        for key, _ in section:
            if key not in declared and key not in known:
                hint = nearest(key, list(declared))
                self.problems.add(section.keys[key], f"{path}.{key}", f"no such key{hint}, expected one of its kind")
        values = {}
        for key, (field, hint) in declared.items():
            inside = f"{path}.{key}"
            node = section.get(key)
            if node is None:
                self.absent(field, hint, section, inside, owner)
                continue
            value = self.value(field, hint, node, inside, owner)
            if value is not None:
                values[field.name] = value
        return values if len(self.problems) == before else None

    def absent(self, field: dataclasses.Field[Any], hint: Any, section: Section, path: str, owner: str) -> None:
        if is_required(field):
            self.problems.add(section.place, path, f"missing, expected {_expected(field, hint)}")
        elif "reference" in field.metadata and default_of(field):
            self.refer(field, default_of(field), section.place, path, owner)

    def value(self, field: dataclasses.Field[Any], hint: Any, node: Node, path: str, owner: str) -> Any:
        """Value of one field, or None and a problem."""
        if "block" in field.metadata:
            if not isinstance(node, Section):
                self.problems.add(node.place, path, "is not a mapping, expected {key: value, ...}")
                return None
            cls = field.metadata["block"]
            values = self.fields(cls, node, path, owner, ())
            return None if values is None else _with_defaults(cls, field.metadata["defaults"], values, self, node, path)
        if "curve" in field.metadata and isinstance(node, Listing):
            return self.curve(node, field.metadata["curve"], path)
        if not isinstance(node, Scalar) or node.empty:
            self.problems.add(node.place, path, f"is not one value, expected {_expected(field, hint)}")
            return None
        if "choice" in field.metadata:
            words = field.metadata["choice"]
            if node.text not in words:
                self.problems.add(node.place, path, f"'{node.text}' is no choice, expected {_words(field)}")
                return None
            return node.text
        if "reference" in field.metadata:
            self.refer(field, node.text, node.place, path, owner)
            return node.text
        if "name" in field.metadata:
            return self.new_name(node, path)
        unit = unit_of(hint)
        if unit is not None:
            return self.quantity(node, unit, field.metadata.get("bounds"), path)
        if hint is bool:
            if node.text not in ("true", "false"):
                self.problems.add(node.place, path, f"'{node.text}' is neither, expected true or false")
                return None
            return node.text == "true"
        return node.text

    def new_name(self, node: Scalar, path: str) -> str | None:
        """A name that the item gives to a part of itself."""
        if ITEM_NAME.fullmatch(node.text) is None:
            self.problems.add(node.place, path, f"{shown(node.text)} is not a name, {ITEM_EXPECTED}")
        elif node.text in self.places:
            what = f"the name '{node.text}' is taken on line {self.places[node.text].line}, expected another"
            self.problems.add(node.place, path, what)
        else:
            self.places[node.text] = node.place
            return node.text
        return None

    def quantity(self, node: Scalar, unit: str, bounds: Bounds | None, path: str) -> float | None:
        try:
            value = parse_quantity(node.text, unit)
        except ParameterError as wrong:
            self.problems.add(node.place, path, str(wrong))
            return None
        if bounds is not None and not bounds.contains(value):
            what = f"{node.text} is out of range, expected {_with_unit(bounds, unit)} ({bounds.description})"
            self.problems.add(node.place, path, what)
            return None
        return value

    def curve(self, node: Listing, units: tuple[str, str], path: str) -> tuple[tuple[float, ...], ...] | None:
        """Pairs of values, each of which rises from above zero, or None and every problem among them."""
        before = len(self.problems)
        points: list[tuple[float, ...]] = []
        last = ""
        for k, pair in enumerate(node.items):
            inside = f"{path}.{k}"
            listed = pair.items if isinstance(pair, Listing) else ()
            ends = [end for end in listed if isinstance(end, Scalar) and not end.empty]
            if len(ends) != 2 or len(listed) != 2:
                self.problems.add(pair.place, inside, f"is not a pair, expected {_pair(units)}")
                continue
            positive = Bounds("both rise from above zero", above=0.0)
            found = [self.quantity(end, unit, positive, inside) for end, unit in zip(ends, units, strict=True)]
            if None in found:
                continue
            written = f"[{ends[0].text}, {ends[1].text}]"
            point = tuple(value for value in found if value is not None)
            if points and not all(new > old for new, old in zip(point, points[-1], strict=True)):
                self.problems.add(pair.place, inside, f"{written} comes after {last}, expected both to rise")
            points.append(point)
            last = written
        if not node.items:
            self.problems.add(node.place, path, f"is empty, expected a list of pairs {_pair(units)}")
        return tuple(points) if len(self.problems) == before else None

    def refer(self, field: dataclasses.Field[Any], name: str, place: Place, path: str, owner: str) -> None:
        kinds = tuple(field.metadata["reference"])
        self.references.append(_Reference(owner, field.name, name, kinds, place, path))

    def check_parts(self, ship: Ship, place: Place) -> None:
        """The plant can be cut between its parts; at which step does not matter."""
        network = Network(ship.name)
        ship.build(network)
        try:
            divide(network, ship.parts, 1.0)
        except TopologyError as wrong:
            self.problems.add(place, "parts", str(wrong))

    def check_references(self) -> None:
        all_kinds = {**{n: k.kind for n, k in self.kinds.items()}, **self.bus_kinds}
        for reference in self.references:
            wanted = " or ".join(_named(kind) for kind in reference.kinds)
            right = [name for name, kind in all_kinds.items() if kind in reference.kinds]
            if reference.name not in self.places:
                what = f"there is no '{reference.name}'{nearest(reference.name, right)}, expected the name of {wanted}"
                self.problems.add(reference.place, reference.path, what)
            elif reference.name in all_kinds and reference.kinds and reference.name not in right:
                found = _named(all_kinds[reference.name])
                what = f"'{reference.name}' is {found}{nearest(reference.name, right)}, expected the name of {wanted}"
                self.problems.add(reference.place, reference.path, what)

    def check_fed(self) -> None:
        """Every bus is reached by a source when all breakers are closed."""
        ends = {(r.owner, r.field): r.name for r in self.references}
        links = []
        for name, kind in self.kinds.items():
            if kind.kind in FEEDS:
                start, end = FEEDS[kind.kind]
                source = ends.get((name, start)) if start else ""
                links.append((source, ends.get((name, end))))
                if kind.kind in BOTH_WAYS:
                    links.append((ends.get((name, end)), source))
        fed = {""}
        while True:
            reached = {end for start, end in links if start in fed and end is not None} - fed
            if not reached:
                break
            fed |= reached
        sources = [kind for kind, (start, _) in FEEDS.items() if start is None or kind == "inverter"]
        for name in self.bus_kinds:
            if name not in fed:
                what = "nobody feeds this bus, even with all breakers closed; expected "
                self.problems.add(self.places[name], f"buses.{name}", what + ", ".join(map(_named, sources)) + " on it")

    def place_in(self, root: Section, name: str, *keys: str) -> Place:
        """Where the value of a plant item stands, or the item if it has been left out."""
        node: Node | None = root.entries["equipment"]
        place = self.places[name]
        for key in (name, *keys):
            node = node.get(key) if isinstance(node, Section) else None
            place = node.place if node is not None and key != name else place
        return place

    def check_ties(self, root: Section) -> None:
        """A tie joins two buses that can be one."""
        for name, kind in self.kinds.items():
            item = self.items.get(name)
            if item is None or kind.kind not in BOTH_WAYS:
                continue
            place, path = self.place_in(root, name, "to"), f"equipment.{name}.to"
            if item.from_ == item.to:
                what = f"both ends are '{item.to}', expected two buses"
                self.problems.add(place, path, what)
                continue
            one, other = self.buses.get(item.from_), self.buses.get(item.to)
            if one is None or type(one) is not type(other):
                continue  # the reference itself is wrong
            for field, unit, what in (("v_n", "V", "nominal voltage"), ("f_n", "Hz", "nominal frequency")):
                values = getattr(one, field, None), getattr(other, field, None)
                if values[0] != values[1]:
                    found = f"'{item.from_}' has {values[0]:g} {unit}, '{item.to}' {values[1]:g} {unit}"
                    self.problems.add(place, path, f"{found}, expected two buses of one {what} ({field})")

    def check_batteries(self, root: Section) -> None:
        """A battery that is full lies below its DC bus: its converter only steps up."""
        for name, kind in self.kinds.items():
            item = self.items.get(name)
            if item is None or kind.kind != "bess" or not isinstance(self.buses.get(item.bus), DcBusbar):
                continue
            full, bus = item.v_full * item.v_n, self.buses[item.bus].v_n
            if full >= bus:
                what = f"a full battery has {full:g} V and its bus '{item.bus}' {bus:g} V, expected less than the bus"
                self.problems.add(self.place_in(root, name, "v_n"), f"equipment.{name}.v_n", what)

    def check_gensets(self, root: Section) -> None:
        """A genset feeds the ship through a rectifier."""
        equipment = root.get("equipment")
        if not isinstance(equipment, Section) or any(name not in self.kinds for name in equipment.entries):
            return  # what could not be read may take it
        kinds = {name: kind.kind for name, kind in self.kinds.items()}
        used = {r.owner: r.name for r in self.references if r.field == "source" and kinds[r.owner] == "rectifier"}
        unknown = any(kind == "rectifier" and kinds.get(used.get(name, "")) != "genset" for name, kind in kinds.items())
        for name, kind in kinds.items():
            if kind == "genset" and name not in used.values() and not unknown:
                what = f"no rectifier takes this genset, expected one with 'source: {name}'"
                self.problems.add(self.places[name], f"equipment.{name}", what)


def check_head(root: Section, problems: Problems, keys: tuple[str, ...]) -> None:
    """Check the schema number and the keys at the top of a file."""
    schema = root.get("schema")
    if schema is None:
        problems.add(root.place, "schema", "missing, expected 'schema: 1'")
    elif not isinstance(schema, Scalar) or schema.text != "1":
        shown = schema.text if isinstance(schema, Scalar) else "this"
        problems.add(schema.place, "schema", f"'{shown}' is not known to this version, expected 1")
    for key, _ in root:
        if key not in keys:
            problems.add(root.keys[key], key, f"no such key{nearest(key, keys)}")


def read_parts(root: Section, problems: Problems) -> dict[str, tuple[str, ...]]:
    """Buses by the name of a part, as the section `parts` of a ship or a run file has them; empty without one.

    A bus that equipment makes for itself (`genset_for.terminals`) is known only once the ship is built.

    Parameters
    ----------
    root : Section
        Of the file.
    problems : Problems
        Where every mistake is added.
    """
    node, buses = root.get("parts"), root.get("buses")
    if node is None:
        return {}
    before, expected = len(problems), "expected two parts or more, each name: [bus, ...]"
    if not isinstance(node, Section):
        problems.add(node.place, "parts", f"is not a mapping, {expected}")
        return {}
    if len(node.entries) < 2:
        problems.add(node.place, "parts", f"is not enough, {expected}")
    known = list(buses.entries) if isinstance(buses, Section) else None
    found: dict[str, tuple[str, ...]] = {}
    part_of: dict[str, str] = {}
    for name, listed in node:
        path = f"parts.{name}"
        if PART_NAME.fullmatch(name) is None:
            problems.add(node.keys[name], f"parts.{shown(name)[1:-1]}", f"is not a name, {ITEM_EXPECTED}")
        if not isinstance(listed, Listing) or not listed.items:
            problems.add(listed.place, path, "has no buses, expected a list of them, such as [dc_for, ac_for]")
            continue
        for k, bus in enumerate(listed.items):
            inside = f"{path}.{k}"
            if not isinstance(bus, Scalar) or bus.empty:
                problems.add(bus.place, inside, "is not one value, expected the name of a bus")
            elif known is not None and bus.text not in known and "." not in bus.text:
                what = f"there is no bus '{bus.text}'{nearest(bus.text, known)}, expected the name of one"
                problems.add(bus.place, inside, what)
            elif bus.text in part_of:
                what = f"bus '{bus.text}' is in the part '{part_of[bus.text]}' already, expected in one part"
                problems.add(bus.place, inside, what)
            else:
                part_of[bus.text] = name
        found[name] = tuple(bus for bus, part in part_of.items() if part == name)
    return found if len(problems) == before else {}


def _with_defaults(
    cls: type, defaults: Mapping[str, float], values: Mapping[str, Any], reader: _ShipReader, node: Node, path: str
) -> Any:
    try:
        return cls(**{**defaults, **values})
    except ParameterError as wrong:
        reader.problems.add(node.place, path, str(wrong))
    return None


def _expected(field: dataclasses.Field[Any], hint: Any) -> str:
    """What a field wants, in words."""
    if "choice" in field.metadata:
        return f"one of {_words(field)}"
    if "reference" in field.metadata:
        return "the name of " + " or ".join(_named(kind) for kind in field.metadata["reference"])
    if "block" in field.metadata:
        return "{key: value, ...}"
    unit = unit_of(hint)
    if unit is None:
        return "a word"
    bounds = field.metadata.get("bounds")
    return expectation(unit) + (f" ({bounds.description})" if bounds else "")


def _words(field: dataclasses.Field[Any]) -> str:
    """The words of a choice, and what else may stand in their place."""
    pairs = f", or a list of pairs {_pair(field.metadata['curve'])}" if "curve" in field.metadata else ""
    return ", ".join(field.metadata["choice"]) + pairs


def _pair(units: tuple[str, str]) -> str:
    """What a pair looks like: `[6 kn, 18 kN]`."""
    return f"[{', '.join(EXAMPLES[unit] for unit in units)}]"


def _with_unit(bounds: Bounds, unit: str) -> str:
    return str(bounds) if unit == "1" else f"{bounds} {unit}"


def _named(kind: str) -> str:
    """A kind with its article: `a genset`, `an AC bus`."""
    words = {"dc": "a DC bus", "ac": "an AC bus"}
    return words.get(kind) or ("an " if kind[0] in "aeiou" else "a ") + kind
