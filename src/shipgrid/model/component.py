"""What a device declares: parameters, signals, kernels, terminals; and the registry of all of them.

A component is a frozen dataclass whose fields are its parameters, decorated with `component`, which attaches a
`ComponentType`: the record classes, the kernels and the terminals. Nothing here knows how time is stepped.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import math
import pkgutil
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar, dataclass_transform

from shipgrid.errors import ParameterError
from shipgrid.model.kernel import argument_names
from shipgrid.model.kernel_contract import CONTRACT, refuse_unknown
from shipgrid.units import Unit

STAGES = ("measure", "supervise", "outer", "inner", "modulate", "network", "advance")


@dataclass(frozen=True)
class Signal:
    """One declared signal of a record class.

    Attributes
    ----------
    description : str
        One sentence.
    initial : float
        Value at the start; for an input, the value while nothing is connected.
    required : bool
        For an input: it must be connected.
    rotates : bool
        A state that turns for ever (an angle); steady state leaves it out.
    counts : bool
        A state that counts (charge drawn, distance made good): a start leaves it at its initial value.
    limiter : bool
        An output that is 1 while a limiter acts; the run logs how long.
    absurd : float or None
        Magnitude beyond which the run has diverged; None takes that of the unit (`assembly/plausible.py`).
    """

    description: str
    initial: float = 0.0
    required: bool = True
    rotates: bool = False
    counts: bool = False
    limiter: bool = False
    absurd: float | None = None


def signal(
    description: str,
    *,
    initial: float | None = None,
    rotates: bool = False,
    counts: bool = False,
    limiter: bool = False,
    absurd: float | None = None,
) -> Any:
    """Declare a signal.

    Parameters
    ----------
    description : str
        One sentence.
    initial : float, optional
        Value at the start, 0 if left out; an input that has one may stay unconnected.
    rotates : bool
        A state that turns for ever (an angle); steady state leaves it out.
    counts : bool
        A state that counts (charge drawn, distance made good): a start leaves it at its initial value.
    limiter : bool
        An output that is 1 while a limiter acts; the run logs how long.
    absurd : float, optional
        Magnitude that no plant reaches, in the signal's unit: a run in which it is passed has diverged and stops.
    """
    return Signal(description, 0.0 if initial is None else initial, initial is None, rotates, counts, limiter, absurd)


@dataclass(frozen=True)
class Bounds:
    """Declared range of a parameter, and where its default comes from."""

    description: str
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    source: str = ""

    def __str__(self) -> str:
        low = f"> {self.above:g}" if self.above is not None else None
        low = f">= {self.at_least:g}" if self.at_least is not None else low
        high = f"< {self.below:g}" if self.below is not None else None
        high = f"<= {self.at_most:g}" if self.at_most is not None else high
        return " and ".join(part for part in (low, high) if part) or "any finite number"

    def contains(self, value: float) -> bool:
        """Whether a finite `value` lies inside."""
        return (
            math.isfinite(value)
            and (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.below is None or value < self.below)
            and (self.at_most is None or value <= self.at_most)
        )


def param(
    description: str,
    *,
    default: float | None = None,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    source: str = "",
) -> Any:
    """Declare a parameter.

    Parameters
    ----------
    description : str
        One sentence.
    default : float, optional
        Value where none is given; without it the parameter is required.
    above, at_least, below, at_most : float, optional
        Bounds.
    source : str
        Where the default comes from.
    """
    bounds = Bounds(description, above, at_least, below, at_most, source)
    metadata = {"bounds": bounds}
    if default is None:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Terminal:
    """Where a device meets the network.

    Attributes
    ----------
    name : str
        Its name, as connections call it.
    v, i : str
        The input that is its voltage, the output that is its current (into the device).
    """

    name: str
    v: str
    i: str


@dataclass(frozen=True)
class Field:
    """One field of a record: name, unit symbol, declaration (None for a nested block)."""

    name: str
    unit: str
    signal: Signal


class Empty:
    """A record with nothing in it."""


@dataclass(frozen=True)
class ComponentType:
    """Everything the assembler needs to know about a device; see `component`."""

    name: str
    cls: type
    stage: str
    state: type
    input: type
    output: type
    derived: type
    kernels: Mapping[str, Any]
    terminals: tuple[Terminal, ...] = ()
    variants: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    derive: Callable[[Any], Mapping[str, Any]] | None = None
    passive: bool = False
    operated: bool = False

    @property
    def two_axis_ends(self) -> dict[str, tuple[str, str]]:
        """Three-phase ends of a device that takes both axes at once, with their terminals; empty for any other.

        Terminals `alpha` and `beta` are the only end of a machine, its stator; `grid_alpha` and `grid_beta` the end
        `grid`.
        """
        names = [terminal.name for terminal in self.terminals]
        if names == ["alpha", "beta"]:
            return {"stator": ("alpha", "beta")}
        stems = [name.removesuffix("_alpha") for name in names if name.endswith("_alpha")]
        pairs = {stem: (f"{stem}_alpha", f"{stem}_beta") for stem in stems}
        return pairs if stems and sorted(names) == sorted(n for pair in pairs.values() for n in pair) else {}

    @property
    def linear(self) -> bool:
        """A network element whose matrices are constant."""
        return bool(self.terminals) and "stamp" not in self.kernels

    @property
    def stamped(self) -> bool:
        """A network element with a hand-written Norton equivalent."""
        return "stamp" in self.kernels

    @property
    def key(self) -> str:
        """Name usable as an identifier: module and class."""
        return self.cls.__module__.rsplit(".", 1)[-1] + "_" + self.cls.__name__


Declared = TypeVar("Declared")

REGISTRY: dict[str, ComponentType] = {}

POSITION = "position"
"""Name of the input by which the equations of a linear element depend on the position of its contacts."""

KERNELS = tuple(CONTRACT)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(param,))
def component(
    *,
    state: type = Empty,
    input: type = Empty,  # the declaration reads like the file it stands in
    output: type = Empty,
    derived: type = Empty,
    derive: Callable[[Any], Mapping[str, Any]] | None = None,
    stage: str = "advance",
    terminals: tuple[Terminal, ...] = (),
    variants: Mapping[str, tuple[str, ...]] | None = None,
    passive: bool = False,
    operated: bool = False,
    **kernels: Any,
) -> Callable[[type[Declared]], type[Declared]]:
    """Register a device: its record classes, kernels and terminals.

    Parameters
    ----------
    state, input, output : type
        Record classes: annotated with units, values from `signal`; a record class as annotation nests.
    derived : type
        Constants computed once from the parameters by `derive`; kernels read them from `p` as well. The component
        class has it as its base, so that the type checker knows all of `p`; values exist in `p` only.
    derive : callable, optional
        `derive(parameters) -> {name: float or array}`; an array goes to the pool `tables`, and `p.name` is its offset.
    stage : str
        When in a step it runs, one of `STAGES`; network elements ignore it.
    terminals : tuple of Terminal
        Makes it a network element: linear if it has no `stamp`, else with its own Norton equivalent.
    variants : mapping of str to tuple of str
        For a linear element: named positions of its contacts, each the tuple of states that are held at zero. An input
        field `position` is the number of the position in force (0: closed, then in the order of `variants`).
    passive : bool
        Its losses are never negative (contract test).
    operated : bool
        Its contact, the variant `open`, has a command of its own unless a connection says what moves it.
    **kernels
        Any of `KERNELS`.

    Raises
    ------
    TypeError
        If a kernel or stage is unknown, or the name is taken by another module.
    """
    unknown = set(kernels) - set(KERNELS)
    if unknown:
        raise TypeError(f"unknown kernels {sorted(unknown)}, expected some of {KERNELS}")
    for name, function in kernels.items():
        refuse_unknown(name, function, argument_names(function))
    if stage not in STAGES:
        raise TypeError(f"unknown stage {stage!r}, expected one of {STAGES}")

    def decorate(cls: type[Declared]) -> type[Declared]:
        cls.__post_init__ = check_parameters  # type: ignore[attr-defined]
        made = dataclass(frozen=True, kw_only=True)(cls)
        kind = ComponentType(
            made.__name__,
            made,
            "network" if terminals else stage,
            state,
            input,
            output,
            derived,
            dict(kernels),
            terminals,
            dict(variants or {}),
            derive,
            passive,
            operated,
        )
        made.__component__ = kind  # type: ignore[attr-defined]
        made.__doc__ = described(made)
        other = REGISTRY.get(made.__name__)
        if other is not None and other.cls.__module__ != made.__module__:
            raise TypeError(f"component {made.__name__} is declared in {other.cls.__module__} already")
        REGISTRY[made.__name__] = kind
        return made

    return decorate


def described(cls: type) -> str:
    """Docstring of a component class with its parameters: what they are, unit, bounds and default."""
    rows = []
    for name, unit, bounds, default in parameters_of(cls):
        given = "" if default is None else f"; {default:g} if left out"
        rows += [f"{name} : float", f"    {bounds.description}, {bounds} [{unit}]{given}"]
    text = inspect.cleandoc(cls.__doc__ or "")
    return "\n".join([text, "", "Parameters", "----------", *rows]) if rows else text


def type_of(item: Any) -> ComponentType:
    """Component type of an instance or class made by `component`."""
    return item.__component__


@cache
def fields_of(record: type) -> tuple[Field, ...]:
    """Flat sequence of a record class's fields; a nested block's fields are named `block.field`."""
    found = []
    module = inspect.getmodule(record)
    for name, hint in typing.get_type_hints(record, vars(module), include_extras=True).items():
        unit = unit_of(hint)
        if unit is None:
            found += [Field(f"{name}.{f.name}", f.unit, f.signal) for f in fields_of(hint)]
        else:
            declared = getattr(record, name, None)
            found.append(Field(name, unit, declared if isinstance(declared, Signal) else Signal("")))
    return tuple(found)


def unit_of(hint: Any) -> str | None:
    """Unit symbol of an annotation, or None for a nested record."""
    for item in getattr(hint, "__metadata__", ()):
        if isinstance(item, Unit):
            return item.symbol
    return None


@cache
def parameters_of(cls: type) -> tuple[tuple[str, str, Bounds, float | None], ...]:
    """Name, unit symbol, bounds and default (None: required) of each parameter of a component class."""
    hints = typing.get_type_hints(cls, include_extras=True)
    return tuple(
        (
            f.name,
            unit_of(hints[f.name]) or "1",
            f.metadata["bounds"],
            None if f.default is dataclasses.MISSING else f.default,
        )
        for f in dataclasses.fields(cls)
        if "bounds" in f.metadata
    )


def check_parameters(self: Any) -> None:
    """Refuse a parameter outside its bounds; make the others floats.

    Raises
    ------
    ParameterError
        For the first that is no finite number inside its bounds.
    """
    for name, unit, bounds, _ in parameters_of(type(self)):
        value = getattr(self, name)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not bounds.contains(value):
            raise ParameterError(
                f"{type(self).__name__}.{name} = {value!r} {unit} is outside {bounds} {unit} ({bounds.description})"
            )
        object.__setattr__(self, name, float(value))


def load_all() -> dict[str, ComponentType]:
    """Import every module that may declare a component, and return the registry."""
    for folder in ("components", "controllers", "modulators", "equipment", "automation"):
        package = importlib.import_module(f"shipgrid.{folder}")
        for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            importlib.import_module(info.name)
    return REGISTRY
