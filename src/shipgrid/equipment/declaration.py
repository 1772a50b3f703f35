"""How a plant item is declared: its ship-file keys, commands, states and public signals.

An equipment kind is a frozen dataclass made by `equipment`. Its fields are what a ship file may say: quantities
(`param`, with unit and bounds), nested blocks of a component's parameters (`block`), one of several words
(`choice`), the name of another item (`reference`). Its `build` wires components into a `Network`, once.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar, dataclass_transform

from shipgrid.errors import ParameterError
from shipgrid.model.component import check_parameters, param, unit_of


@dataclass(frozen=True)
class Command:
    """One command of an equipment kind.

    Attributes
    ----------
    name, unit, description : str
        Name after the dot; unit of the value inside (SI, `"1"` for on/off and words).
    low, high : float
        Range; a value outside is refused where it enters.
    default, moored : float
        Value at a cold start, and at the start state `moored` (None: as `default`).
    words : mapping of str to float, optional
        Where the value is one of several words: their codes.
    refusals : mapping of int to str
        Reasons for which the item's sequence may refuse it, by the code its `refused` signal shows.
    """

    name: str
    unit: str
    description: str
    low: float
    high: float
    default: float
    moored: float | None = None
    words: Mapping[str, float] | None = None
    refusals: Mapping[int, str] = dataclasses.field(default_factory=dict)


def switch(name: str, description: str, *, moored: bool = False, refusals: Mapping[int, str] | None = None) -> Command:
    """An on/off command, off at a cold start."""
    words = {"false": 0.0, "true": 1.0}
    return Command(name, "1", description, 0.0, 1.0, 0.0, float(moored), words, refusals or {})


@dataclass(frozen=True)
class Published:
    """One public signal of an equipment kind: name after the dot, unit, meaning, recorder group."""

    name: str
    unit: str
    description: str
    group: str = "plant"


@dataclass(frozen=True)
class EquipmentType:
    """Everything the ship file, the runner and the documentation need to know about a kind."""

    kind: str
    cls: type
    commands: tuple[Command, ...]
    signals: tuple[Published, ...]
    states: Mapping[int, str]


Declared = TypeVar("Declared")

EQUIPMENT: dict[str, EquipmentType] = {}


def block(cls: type, **defaults: float) -> Any:
    """A nested block of a component's parameters, with `defaults` in place of the component's own."""
    return dataclasses.field(default_factory=lambda: cls(**defaults), metadata={"block": cls, "defaults": defaults})


def choice(description: str, *words: str, default: str) -> Any:
    """One of several words."""
    return dataclasses.field(default=default, metadata={"choice": words, "description": description})


def curve(description: str, *words: str, units: tuple[str, str], default: str) -> Any:
    """One of several words, or a list of pairs in `units`, both of which rise from above zero."""
    metadata = {"choice": words, "curve": units, "description": description}
    return dataclasses.field(default=default, metadata=metadata)


def reference(description: str, *kinds: str, default: str | None = None) -> Any:
    """Name of a bus (kinds `dc`, `ac`) or of another item (its kind)."""
    metadata = {"reference": kinds, "description": description}
    if default is None:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


@dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(param, block, choice, curve, reference)
)
def equipment(
    kind: str,
    *,
    commands: tuple[Command, ...] = (),
    signals: tuple[Published, ...] = (),
    states: Mapping[int, str] | None = None,
) -> Callable[[type[Declared]], type[Declared]]:
    """Register an equipment kind.

    Parameters
    ----------
    kind : str
        Word after `kind:` in a ship file.
    commands : tuple of Command
        What it can be told.
    signals : tuple of Published
        What `build` publishes.
    states : mapping of int to str
        Names of the states of its sequence, by the code its `state` signal shows.
    """

    def decorate(cls: type[Declared]) -> type[Declared]:
        checks = getattr(cls, "check", None)

        def post_init(self: Any) -> None:
            check_parameters(self)
            if checks is not None:
                checks(self)

        cls.__post_init__ = post_init  # type: ignore[attr-defined]
        made = dataclass(frozen=True, kw_only=True)(cls)
        made.__equipment__ = EquipmentType(kind, made, commands, signals, dict(states or {}))  # type: ignore[attr-defined]
        EQUIPMENT[kind] = made.__equipment__  # type: ignore[attr-defined]
        return made

    return decorate


def refuse_other(item: Any, part: str, owners: Iterable[tuple[str, str]]) -> None:
    """Refuse a block that says differently what the item itself, or what it refers to, says.

    Parameters
    ----------
    item : equipment
    part : str
        Key of the block.
    owners : iterable of (str, str)
        Keys of the block, and the item's key that has the say.

    Raises
    ------
    ParameterError
        For the first that does.
    """
    own = getattr(item, part)
    for name, owner in owners:
        said, default = getattr(own, name), getattr(type(own), name)
        if said not in (default, getattr(item, owner)):
            kind = item.__equipment__.kind
            raise ParameterError(f"{kind}.{part}.{name} = {said:g} is set by {kind}.{owner}")


def is_quantity(hint: Any) -> bool:
    """Whether a field's annotation is a quantity with a unit."""
    return unit_of(hint) is not None


def as_in(cls: type, name: str) -> Any:
    """Parameter `name` of a component, declared once there, as a key of the equipment."""
    field = cls.__dataclass_fields__[name]  # type: ignore[attr-defined]
    return dataclasses.field(default=field.default, metadata=field.metadata)


def kind_of(item: Any) -> EquipmentType:
    """Equipment type of a plant item."""
    return item.__equipment__


@lru_cache(maxsize=256)
def fields_of_kind(cls: type) -> dict[str, tuple[dataclasses.Field[Any], Any]]:
    """What a file may say about an item of a class: field and type by key (`from` for the field `from_`)."""
    hints = typing.get_type_hints(cls, include_extras=True)
    return {f.name.rstrip("_"): (f, hints[f.name]) for f in dataclasses.fields(cls)}


def is_required(field: dataclasses.Field[Any]) -> bool:
    """Whether a field has no default."""
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def default_of(field: dataclasses.Field[Any]) -> Any:
    """Default of a field that has one."""
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
