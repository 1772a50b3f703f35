"""A ship: plant items on buses, and a hull; made in Python, or read from a file by `io/ship_file.py`.

    ship = Ship(
        name="bench",
        buses={"dc": DcBusbar(v_n=750.0)},
        equipment={"bess": Bess(bus="dc", v_n=440.0, capacity=160.0 * 3600.0)},
    )

Either way it is checked as a whole, and is what its text says: a ship made in Python is written as a file and read.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from shipgrid.automation.modes import MODES, mode_commands
from shipgrid.components.electrical.bar_meter import BarMeter
from shipgrid.equipment.declaration import Command, EquipmentType, Published, kind_of
from shipgrid.equipment.ship_text import ship_text
from shipgrid.errors import ParameterError
from shipgrid.model.component import param
from shipgrid.model.network import Network
from shipgrid.names import nearest
from shipgrid.units import Farad, Hertz, Ohm, Volt

BUILD_ORDER = (
    "genset",
    "rectifier",
    "bess",
    "propulsion",
    "hull",
    "inverter",
    "ac_load",
    "ac_motor",
    "dc_breaker",
    "ac_breaker",
    "shore_connection",
)
"""Kinds in the order in which items are built; kinds not named here follow, in the order of the file."""

busbar = dataclass(frozen=True, kw_only=True)


@busbar
class DcBusbar:
    """A DC bus of the ship; `bleeder` keeps it defined when nothing is connected."""

    v_n: Volt = param("nominal voltage, pole to pole", above=0.0)
    bleeder: Ohm = param("bleeder resistance, pole to pole", default=5e3, above=0.0, source="docs/theory/network.md")
    capacitance: Farad = param("capacitance besides that of the equipment", default=0.0, at_least=0.0)

    kind: typing.ClassVar = "dc"
    signals: typing.ClassVar = (Published("v_dc", "V", "main bus voltage"),)


@busbar
class AcBusbar:
    """A three-wire AC bus of the ship."""

    v_n: Volt = param("nominal voltage, line to line, rms", above=0.0)
    f_n: Hertz = param("nominal frequency", above=0.0)

    kind: typing.ClassVar = "ac"
    signals: typing.ClassVar = (
        Published("v_pu", "1", "bus voltage over nominal"),
        Published("v_rms_pu", "1", "bus voltage over nominal, as a meter of one cycle's rms shows it"),
        Published("f", "Hz", "bus frequency"),
    )


BUSBARS: dict[str, type] = {"dc": DcBusbar, "ac": AcBusbar}


@dataclass(frozen=True)
class Catalogue:
    """Commands and public signals of a ship, by path: what a scenario can say about it.

    It exists for a ship with mistakes in it, too, so that the mistakes of a scenario are found in the same go;
    `unreadable` are then the items and buses whose kind is not known, and there is no `equipment`. `modes` are the
    operating modes, each with its commands as a scenario file would say them.
    """

    commands: Mapping[str, Command]
    signals: Mapping[str, Published]
    breakers: tuple[str, ...]
    unreadable: frozenset[str] = frozenset()
    modes: Mapping[str, Mapping[str, str]] = dataclasses.field(default_factory=dict)
    equipment: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def items(self, kind: str) -> dict[str, Any]:
        """All items of a kind, by name."""
        return {name: item for name, item in self.equipment.items() if kind_of(item).kind == kind}


@dataclass(frozen=True)
class Ship:
    """Equipment on buses.

    Parameters
    ----------
    name : str
        Name of the ship.
    buses : mapping of str to DcBusbar or AcBusbar
        Buses by name. In Python also mappings, as a ship file has them: `{"kind": "dc", "v_n": "750 V"}`.
    equipment : mapping of str to object
        Plant items by name, each an instance of its kind's class, or such a mapping; the hull is not among them.
    hull : object, optional
        The hull, of the kind `hull`, or such a mapping.
    parts : mapping of str to tuple of str
        Buses by the name of a part, for a plant that is cut; empty if it does not say.
    document : Document, optional
        The file it was read from, with the changes made since; of a ship made in Python the file it would be.

    Raises
    ------
    InputErrors
        With every mistake in a ship made in Python.
    """

    name: str
    buses: Mapping[str, Any]
    equipment: Mapping[str, Any]
    hull: Any = None
    parts: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    document: Any = dataclasses.field(default=None, repr=False, compare=False)

    reader: typing.ClassVar[Callable[[str], Ship]]
    """Reads the text of a ship file; `io/ship_file.py` gives it."""

    drawer: typing.ClassVar[Callable[[Ship], str]]
    """Draws the one-line diagram, in HTML; `io/ship_file.py` gives it."""

    def __post_init__(self) -> None:
        if self.document is None:
            read = Ship.reader(ship_text(self.name, self.buses, self.equipment, self.hull, self.parts))
            for field in dataclasses.fields(self):
                object.__setattr__(self, field.name, getattr(read, field.name))

    def __repr__(self) -> str:
        items, buses = len(self.equipment), len(self.buses)
        return f"<Ship {self.name}: {items} item{'s'[: items != 1]}, {buses} bus{'es'[: 2 * (buses != 1)]}>"

    def _repr_html_(self) -> str:
        return Ship.drawer(self)

    @property
    def text(self) -> str:
        """The file it was read from, changes included; of a ship made in Python the file that says the same."""
        return self.document.text()

    def item(self, name: str) -> Any:
        """The plant item of that name.

        Raises
        ------
        ParameterError
            If there is none.
        """
        if name not in self.equipment:
            raise ParameterError(f"{self.name} has no item '{name}'{nearest(name, self.equipment)}")
        return self.equipment[name]

    def items(self, kind: str) -> dict[str, Any]:
        """All items of a kind, by name."""
        return {name: item for name, item in self.equipment.items() if kind_of(item).kind == kind}

    def replace(self, path: str, value: str) -> Ship:
        """A variant with one value changed: `ship.replace("equipment.bess_for.capacity", "160 Ah")`.

        Parameters
        ----------
        path : str
            Path in the ship file.
        value : str
            As it would stand in the file.

        Raises
        ------
        InputErrors
            If the variant is not a valid ship.
        """
        return Ship.reader(self.document.replaced(path, str(value), f"replace {path}"))

    @cached_property
    def catalogue(self) -> Catalogue:
        """Commands and public signals, by path."""
        network = Network(self.name)
        self.build(network)
        signals = {n: Published(n, s.unit, s.description, s.group) for n, s in network.published.items()}
        kinds = {name: kind_of(item) for name, item in self.equipment.items()}
        return Catalogue(self.commands, signals, breakers_of(kinds), modes=modes_of(kinds), equipment=self.equipment)

    @cached_property
    def commands(self) -> Mapping[str, Command]:
        """Commands by path, `bess_for.i_ref`."""
        return commands_of({name: kind_of(item) for name, item in [*self.equipment.items(), *self._hull]})

    @property
    def signals(self) -> Mapping[str, Published]:
        """Public signals by path, `bess_for.soc`: what the built network publishes."""
        return self.catalogue.signals

    def build(self, network: Any, start: Mapping[str, float] | None = None) -> None:
        """Build buses and items into a `Network`, sources first (`BUILD_ORDER`).

        Parameters
        ----------
        network : Network
            An empty one.
        start : mapping of str to float, optional
            Values of commands at the start, by path (`Scenario.start.commands`); their defaults where left out.
        """
        for path, command in self.commands.items():
            network.command(path, (start or {}).get(path, command.default))
        for name, bar in self.buses.items():
            if isinstance(bar, DcBusbar):
                bus = network.dc_bus(name, bar.v_n)
                network.conductance(bus, 1.0 / bar.bleeder)
                if bar.capacitance > 0.0:
                    network.capacitance(bus, bar.capacitance)
                (signal,) = bar.signals
                network.publish(f"{name}.v_dc", source=f"{name}.v_dc", unit=signal.unit, description=signal.description)
            else:
                network.ac_bus(name, bar.v_n, bar.f_n)
                network.add(
                    f"{name}.meter",
                    BarMeter(v_n=bar.v_n, f_n=bar.f_n),
                    inputs={"v_alpha": f"{name}.v_alpha", "v_beta": f"{name}.v_beta"},
                )
                v_alpha, v_beta = (f"{name}.v_{axis}" for axis in ("alpha", "beta"))
                text = "voltage of the bar to the star point"
                network.publish_phases(f"{name}.v", alpha=v_alpha, beta=v_beta, unit="V", description=text)
                for signal in bar.signals:
                    network.publish(
                        f"{name}.{signal.name}",
                        source=f"{name}.meter.{signal.name}",
                        unit=signal.unit,
                        description=signal.description,
                    )
        view = ShipInNetwork(self, network)
        for name, item in self._in_build_order():
            item.build(network, name, view)

    @property
    def _hull(self) -> list[tuple[str, Any]]:
        return [] if self.hull is None else [("hull", self.hull)]

    def _in_build_order(self) -> list[tuple[str, Any]]:
        rank = {kind: k for k, kind in enumerate(BUILD_ORDER)}
        everything = [*self.equipment.items(), *self._hull]
        return sorted(everything, key=lambda named: rank.get(kind_of(named[1]).kind, len(rank)))


@dataclass(frozen=True)
class ShipInNetwork:
    """What an item sees of its ship while it is built: the other items, and the buses in the network."""

    ship: Ship
    network: Any

    def bus(self, name: str) -> Any:
        """The bus of that name, in the network."""
        return self.network.bus(name)

    def item(self, name: str) -> Any:
        """The plant item of that name."""
        return self.ship.item(name)

    def items(self, kind: str) -> dict[str, Any]:
        """All items of a kind, by name."""
        return self.ship.items(kind)

    @property
    def equipment(self) -> Mapping[str, Any]:
        """All plant items, by name; the hull is not among them."""
        return self.ship.equipment

    @property
    def hull(self) -> Any:
        """The hull."""
        return self.ship.hull

    @property
    def name(self) -> str:
        """Name of the ship."""
        return self.ship.name


def commands_of(kinds: Mapping[str, EquipmentType]) -> dict[str, Command]:
    """Commands by path of items by name.

    Parameters
    ----------
    kinds : mapping of str to EquipmentType
    """
    return {f"{name}.{command.name}": command for name, kind in kinds.items() for command in kind.commands}


def breakers_of(kinds: Mapping[str, EquipmentType]) -> tuple[str, ...]:
    """Names of the items that a command closes.

    Parameters
    ----------
    kinds : mapping of str to EquipmentType
    """
    return tuple(name for name, kind in kinds.items() if any(command.name == "close" for command in kind.commands))


def modes_of(kinds: Mapping[str, EquipmentType]) -> dict[str, dict[str, str]]:
    """Operating modes, each with its commands as a scenario file would say them.

    Parameters
    ----------
    kinds : mapping of str to EquipmentType
    """
    words = {name: kind.kind for name, kind in kinds.items()}
    return {mode: mode_commands(mode, commands_of(kinds), words) for mode in MODES}
