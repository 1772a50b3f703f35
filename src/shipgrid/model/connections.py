"""Buses, and what a terminal can be connected to: a bus, two of them, or a pole of a converter's bridge."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from shipgrid.errors import TopologyError
from shipgrid.model.component import ComponentType


@dataclass(frozen=True)
class DcBus:
    """A DC bus: one node, pole to pole."""

    name: str
    v_n: float

    @property
    def nodes(self) -> tuple[str, ...]:
        """Path of its node voltage."""
        return (f"{self.name}.v_dc",)


@dataclass(frozen=True)
class AcBus:
    """A three-wire AC bus: two nodes, alpha and beta; `v_n` is line to line, rms."""

    name: str
    v_n: float
    f_n: float

    @property
    def nodes(self) -> tuple[str, ...]:
        """Paths of its node voltages."""
        return (f"{self.name}.v_alpha", f"{self.name}.v_beta")


Bus = DcBus | AcBus


@dataclass(frozen=True)
class Across:
    """Connects a two-pole branch between two buses: its voltage is v(a) - v(b)."""

    a: Bus
    b: Bus


@dataclass(frozen=True)
class Pole:
    """A half-bridge leg: the terminal's voltage is s v_dc, and the bus delivers weight s i (`s`: path of a signal)."""

    bus: DcBus
    s: str
    weight: float = 1.0


@dataclass(frozen=True)
class Pole3:
    """A two-level bridge: v_alpha = s_alpha v_dc, so beta; the bus delivers 3/2 (s_alpha i_alpha + s_beta i_beta)."""

    bus: DcBus
    s_alpha: str
    s_beta: str


@dataclass(frozen=True)
class Legs:
    """The legs of one bridge on a DC bus, and the modulator that drives their gates."""

    path: str
    bus: DcBus
    modulator: str
    phases: tuple[str, ...]  # suffixes of the modulator's `lo`, `hi` and `lead`
    poles: tuple[str, ...]  # paths of the switching functions of its poles: alpha and beta, or one
    weight: float


@dataclass(frozen=True)
class PortBinding:
    """Where one scalar terminal meets the nodes: v = c (v_plus - v_minus); the nodes see weight c i."""

    plus: str | None
    minus: str | None = None
    coefficient: str | None = None
    weight: float = 1.0


def axis_weight(node: str) -> float:
    """What energy at a node counts: 3/2 for one axis of a three-phase bus (amplitude-invariant), 1 for a DC bus.

    Parameters
    ----------
    node : str
        Path of its voltage.
    """
    return 1.5 if node.endswith((".v_alpha", ".v_beta")) else 1.0


def is_three_phase(end: Any) -> bool:
    """Whether a connection is three-phase.

    Parameters
    ----------
    end : DcBus, AcBus, Across, Pole, Pole3 or PortBinding
    """
    return isinstance(end, AcBus | Pole3) or (isinstance(end, Across) and isinstance(end.a, AcBus))


def buses_of(end: Any) -> tuple[Any, ...]:
    """The buses of a connection; none of a `PortBinding`.

    Parameters
    ----------
    end : DcBus, AcBus, Across, Pole, Pole3 or PortBinding
    """
    if isinstance(end, DcBus | AcBus):
        return (end,)
    if isinstance(end, Across):
        return (end.a, end.b)
    return (end.bus,) if isinstance(end, Pole | Pole3) else ()


def in_words(end: Any) -> str:
    """What a connection leads to, for messages.

    Parameters
    ----------
    end : DcBus, AcBus, Across, Pole, Pole3 or PortBinding
    """
    if isinstance(end, DcBus | AcBus):
        return f"{'DC' if isinstance(end, DcBus) else 'AC'} bus '{end.name}'"
    if isinstance(end, Across):
        return f"{in_words(end.a)} and {in_words(end.b)}"
    if isinstance(end, Pole | Pole3):
        return f"{'a half-bridge leg' if isinstance(end, Pole) else 'a three-phase bridge'} on {in_words(end.bus)}"
    return repr(end)


def ends_by_terminal(path: str, kind: ComponentType, ends: Mapping[str, Any]) -> dict[str, Any]:
    """Connections by terminal: the ends `a` and `b` of a branch become its only terminal.

    Parameters
    ----------
    path : str
        Of the element, for messages.
    kind : ComponentType
        Its type.
    ends : mapping of str to DcBus, AcBus, Across, Pole, Pole3 or PortBinding
        As `Network.add` takes them.

    Raises
    ------
    TopologyError
        If the ends are not those of a branch.
    """
    single = [*kind.two_axis_ends] or [terminal.name for terminal in kind.terminals]
    if single == ["a", "b"] and kind.stamped and set(ends) == {"a"}:
        return {**ends, "b": PortBinding(None)}  # the other pole of the bus
    branch = single[0] if len(single) == 1 else ""
    if not branch or not set(ends) & {"a", "b"} or set(ends) & {branch}:
        return dict(ends)
    if "a" not in ends or set(ends) - {"a", "b"}:
        raise TopologyError(f"{path} ({kind.name}) is a branch with the ends a and b, connected are {sorted(ends)}")
    if "b" not in ends:
        return {branch: ends["a"]}
    a, b = ends["a"], ends["b"]
    for name, end in ends.items():
        if not isinstance(end, DcBus | AcBus):
            raise TopologyError(
                f"{path} ({kind.name}): end '{name}' of a branch between two buses is {in_words(end)}, expected "
                "a bus (a Choke takes a converter's pole at either end)"
            )
    if type(a) is not type(b):
        raise TopologyError(
            f"{path} ({kind.name}): end 'a' is at {in_words(a)}, end 'b' at {in_words(b)}; "
            "expected two buses of one kind"
        )
    if a is b:
        raise TopologyError(f"{path} ({kind.name}): both ends are at {in_words(a)}")
    return {branch: Across(a, b)}


def terminals_in_words(kind: ComponentType) -> str:
    """The terminals of a device as connections call them, for messages.

    Parameters
    ----------
    kind : ComponentType
    """
    if kind.two_axis_ends:
        return f"the three-phase terminals {sorted(kind.two_axis_ends)}"
    names = sorted(terminal.name for terminal in kind.terminals)
    return "no terminals" if not names else f"the terminal{'s' * (len(names) > 1)} {names}"


def scalar_binding(terminal: str, end: Any) -> PortBinding:
    """Where a single-phase terminal meets the nodes.

    Parameters
    ----------
    terminal : str
        Element and terminal, for messages.
    end : DcBus, Across, Pole or PortBinding

    Raises
    ------
    TopologyError
        If the connection is three-phase.
    """
    if isinstance(end, PortBinding):
        return end
    if isinstance(end, Pole):
        return PortBinding(end.bus.nodes[0], None, end.s, end.weight)
    if isinstance(end, Across) and isinstance(end.a, DcBus) and isinstance(end.b, DcBus):
        return PortBinding(end.a.nodes[0], end.b.nodes[0])
    if isinstance(end, DcBus):
        return PortBinding(end.nodes[0])
    raise TopologyError(f"{terminal} is single-phase and cannot be connected to {in_words(end)}")


def axis_binding(terminal: str, end: Any, axis: int) -> PortBinding:
    """Where one axis of a three-phase terminal meets the nodes.

    Parameters
    ----------
    terminal : str
        Element and terminal, for messages.
    end : AcBus, Across or Pole3
    axis : {0, 1}
        Alpha or beta.

    Raises
    ------
    TopologyError
        If the connection is single-phase.
    """
    if isinstance(end, Pole3):
        return PortBinding(end.bus.nodes[0], None, (end.s_alpha, end.s_beta)[axis], 1.5)
    if isinstance(end, Across) and isinstance(end.a, AcBus) and isinstance(end.b, AcBus):
        return PortBinding(end.a.nodes[axis], end.b.nodes[axis])
    if isinstance(end, AcBus):
        return PortBinding(end.nodes[axis])
    raise TopologyError(f"{terminal} is three-phase here and cannot be connected to {in_words(end)}")
