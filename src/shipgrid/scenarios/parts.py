"""Which parts a plant is cut into: what a person asks for, turned into groups of buses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from shipgrid.assembly.partition import Partition, divide, propose
from shipgrid.automation.power_management import equip
from shipgrid.errors import ParameterError
from shipgrid.model.network import Network
from shipgrid.names import PART_NAME

SHIP = "ship"
"""Word for the parts that the ship's own file has."""

Groups = Mapping[str, Sequence[str]]


def parts_wanted(ship: Any, asked: str | int | Groups | None, step: float) -> dict[str, tuple[str, ...]] | None:
    """Groups of buses that a plant is to be cut into; None: it stays whole.

    Parameters
    ----------
    ship : Ship
    asked : str, int, mapping or None
        "ship": as its file says. A number: that many parts, or as many as there can be, cut where the surplus of a line
        is small at that step; 1, or None: one. A mapping: buses by the name of a part, taken as it is.
    step : float
        Step [s].

    Raises
    ------
    ParameterError
        If it is none of these, or the ship's file has no parts.
    """
    if asked is None:
        return None
    if isinstance(asked, Mapping):
        groups = {name: tuple(buses) for name, buses in asked.items()}
        for name, buses in asked.items():
            if not PART_NAME.fullmatch(name) or isinstance(buses, str) or not buses:
                raise ParameterError(f"parts: '{name}': {buses!r}, expected a lower-case name and a list of buses")
    elif asked == SHIP:
        groups = dict(ship.parts)
        if not groups:
            raise ParameterError(f"parts: the file of {ship.name} has no section 'parts', expected one, or a number")
    elif isinstance(asked, bool) or not str(asked).isdecimal() or int(asked) < 1:
        raise ParameterError(f"parts: '{asked}' is no number of parts, expected 1 or more, or '{SHIP}'")
    else:
        groups = propose(_network(ship), int(asked), step) if int(asked) > 1 else {}
    return groups if len(groups) > 1 else None


def partition_of(
    ship: Any, groups: Groups, step: float, fidelity: str = "averaged", rules: Sequence[Any] = ()
) -> Partition:
    """A ship's plant in parts, with the lines between them.

    Parameters
    ----------
    ship : Ship
    groups : mapping of str to sequence of str
        Of `parts_wanted`.
    step : float
        Step [s].
    fidelity : {"averaged", "switching"}
        Detail of the converters.
    rules : sequence of object
        Rules of power management in force.

    Raises
    ------
    TopologyError
        If the plant cannot be cut so.
    """
    network = _network(ship, fidelity)
    equip(network, ship, rules)
    return divide(network, groups, step)


def _network(ship: Any, fidelity: str = "averaged") -> Network:
    network = Network(ship.name, fidelity)
    ship.build(network)
    return network
