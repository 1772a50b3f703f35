"""The network as a one-line diagram has it: buses, elements between them, controllers, commands, public signals.

A `Network` is a description and nothing else: `assembly.assemble` turns it into arrays. Everything is named by path,
`<item>.<part>.<field>`, and may be added in any order; names are resolved at assembly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from shipgrid.errors import TopologyError
from shipgrid.model.component import type_of


@dataclass(frozen=True)
class Every:
    """A clock of period `seconds`, rounded to a whole number of steps."""

    seconds: float


@dataclass(frozen=True)
class Sampled:
    """A clock of exactly `hertz`, whose instants fall anywhere inside a step."""

    hertz: float


class Delayed(str):
    """Path of a signal read as the last instant left it: breaks a loop within one step where it may be broken."""


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


@dataclass
class Placed:
    """One component in its place."""

    path: str
    item: Any
    ports: dict[str, PortBinding]
    inputs: dict[str, str | float]
    initial: dict[str, float]
    clock: Every | Sampled | None
    variant: str | None
    axis_weight: float


@dataclass(frozen=True)
class PublicSignal:
    """A signal people see: name, where it comes from, unit, meaning, recorder group."""

    name: str
    source: str
    unit: str
    description: str
    group: str


@dataclass(frozen=True)
class Watched:
    """A code signal whose changes are events, with the texts of its codes."""

    owner: str
    source: str
    texts: Mapping[int, str]
    refusal: bool = False


@dataclass
class Network:
    """Buses, components, commands and public signals of a plant.

    Parameters
    ----------
    name : str
        Name of the plant, for messages.
    fidelity : {"averaged", "switching"}
        Which modulators equipment puts before its bridges: mean values, or every edge.
    """

    name: str
    fidelity: str = "averaged"
    buses: dict[str, Bus] = field(default_factory=dict, init=False)
    capacitances: dict[str, float] = field(default_factory=dict, init=False)
    conductances: dict[str, float] = field(default_factory=dict, init=False)
    shunts: list[tuple[str, float, str, str]] = field(default_factory=list, init=False)
    placed: dict[str, Placed] = field(default_factory=dict, init=False)
    legs: dict[str, Legs] = field(default_factory=dict, init=False)
    commands: dict[str, float] = field(default_factory=dict, init=False)
    published: dict[str, PublicSignal] = field(default_factory=dict, init=False)
    watched: list[Watched] = field(default_factory=list, init=False)

    def dc_bus(self, name: str, v_n: float) -> DcBus:
        """Add a DC bus of nominal voltage `v_n` [V]."""
        return self._bus(DcBus(name, v_n))

    def ac_bus(self, name: str, v_n: float, f_n: float) -> AcBus:
        """Add a three-wire AC bus of nominal line voltage `v_n` [V rms] and frequency `f_n` [Hz]."""
        return self._bus(AcBus(name, v_n, f_n))

    def _bus(self, bus: Any) -> Any:
        if bus.name in self.buses:
            raise TopologyError(f"{self.name}: two buses of the name '{bus.name}'")
        self.buses[bus.name] = bus
        return bus

    def bus(self, name: str) -> Any:
        """The bus of that name."""
        if name not in self.buses:
            raise TopologyError(f"{self.name}: no bus '{name}', there are {sorted(self.buses)}")
        return self.buses[name]

    def capacitance(self, bus: Bus, farad: float) -> None:
        """Add capacitance between the poles of a DC bus (per axis of an AC bus); capacitors in parallel merge."""
        for node in bus.nodes:
            self.capacitances[node] = self.capacitances.get(node, 0.0) + farad

    def conductance(self, bus: Bus, siemens: float, *, consumer: str = "") -> None:
        """Add a resistive shunt to a bus (per axis of an AC bus).

        Parameters
        ----------
        bus : DcBus or AcBus
        siemens : float
            Conductance between the poles, or of each phase of a star [S].
        consumer : str, optional
            Path under which its power counts as consumed; a loss of the bus if left out.
        """
        for node in bus.nodes:
            self.conductances[node] = self.conductances.get(node, 0.0) + siemens
            path, ledger = (consumer, "consumed") if consumer else (f"{bus.name}.shunt", "losses")
            self.shunts.append((node, siemens, path, ledger))

    def add(
        self,
        path: str,
        item: Any,
        *,
        ports: Mapping[str, Any] | None = None,
        inputs: Mapping[str, str | float] | None = None,
        initial: Mapping[str, float] | None = None,
        clock: Every | Sampled | None = None,
        variant: str | None = None,
        axis_weight: float = 1.0,
    ) -> None:
        """Place one component.

        Parameters
        ----------
        path : str
            Its name, unique in the plant.
        item : component instance
            Parameters.
        ports : mapping of str to DcBus, Across, Pole or PortBinding
            For a network element: where each terminal is connected.
        inputs : mapping of str to str or float
            Path of the signal an input reads, or a constant.
        initial : mapping of str to float
            Initial values of states, in place of the declared ones.
        clock : Every or Sampled, optional
            When it runs; every step if left out.
        variant : str, optional
            For a linear element: path of the signal that selects the position of its contacts.
        axis_weight : float
            What its energy counts: 3/2 for one axis of a three-phase element.

        Raises
        ------
        TopologyError
            If the path is taken, or terminals and connections do not match.
        """
        if path in self.placed:
            raise TopologyError(f"{self.name}: two components of the name '{path}'")
        kind = type_of(item)
        bound = {name: _scalar_binding(end) for name, end in (ports or {}).items()}
        names = {terminal.name for terminal in kind.terminals}
        if set(bound) != names:
            raise TopologyError(f"{path} ({kind.name}) has terminals {sorted(names)}, connected are {sorted(bound)}")
        self.placed[path] = Placed(
            path, item, bound, dict(inputs or {}), dict(initial or {}), clock, variant, axis_weight
        )

    def add_three_phase(
        self,
        path: str,
        item: Any,
        *,
        ports: Mapping[str, Any],
        inputs: Mapping[str, Any] | None = None,
        initial: Mapping[str, float] | None = None,
        clock: Every | Sampled | None = None,
        variant: str | None = None,
    ) -> None:
        """Place a three-phase element: a per-axis one twice, as `path.alpha` and `path.beta`; a machine once.

        Parameters
        ----------
        path, item, initial, clock, variant
            As in `add`.
        ports : mapping of str to AcBus, Across or Pole3
            For a machine the only one is called `stator`.
        inputs : mapping
            As in `add`; for a per-axis element a pair gives the alpha and the beta axis each its own.
        """
        inputs = inputs or {}
        if type_of(item).stamped:
            (end,) = ports.values()
            axes = {"alpha": _axis_binding(end, 0), "beta": _axis_binding(end, 1)}
            self.add(path, item, ports=axes, inputs=inputs, initial=initial, clock=clock)
            return
        for k, axis in enumerate(("alpha", "beta")):
            self.add(
                f"{path}.{axis}",
                item,
                ports={name: _axis_binding(end, k) for name, end in ports.items()},
                inputs={name: v[k] if isinstance(v, tuple) else v for name, v in inputs.items()},
                initial=initial,
                clock=clock,
                variant=variant,
                axis_weight=1.5,
            )

    def bridge(self, path: str, bridge: Any, bus: DcBus, *, modulator: str) -> Pole3:
        """Place a three-phase bridge; what it returns is what a three-phase terminal connects to.

        Parameters
        ----------
        path : str
            Its name.
        bridge : component instance
            Its parameters: a component with the outputs of `components/converters/two_level_bridge.py`.
        bus : DcBus
        modulator : str
            Path of the component with the outputs `lo_a`, `hi_a`, `lead_a` ... of the three legs.

        Returns
        -------
        Pole3
            For exactly one terminal, without delay in either direction.
        """
        self.add(path, bridge)
        poles = (f"{path}.s_alpha", f"{path}.s_beta")
        self.legs[path] = Legs(path, bus, modulator, ("_a", "_b", "_c"), poles, 1.5)
        return Pole3(bus, *poles)

    def half_bridge(self, path: str, leg: Any, bus: DcBus, *, modulator: str) -> Pole:
        """Place a half-bridge leg; what it returns is what a single-phase terminal connects to.

        Parameters
        ----------
        path, leg, bus
            As for `bridge`.
        modulator : str
            Path of the component with the outputs `lo`, `hi` and `lead`.

        Returns
        -------
        Pole
        """
        self.add(path, leg)
        self.legs[path] = Legs(path, bus, modulator, ("",), (f"{path}.s",), 1.0)
        return Pole(bus, f"{path}.s")

    def command(self, path: str, value: float = 0.0) -> str:
        """Path of the signal of a command, declared with its value at the start."""
        self.commands.setdefault(path, value)
        return f"command:{path}"

    def publish(self, name: str, *, source: str, unit: str, description: str, group: str = "plant") -> None:
        """Make a signal public: recorded and listed under `name`."""
        if name in self.published:
            raise TopologyError(f"{self.name}: two public signals of the name '{name}'")
        self.published[name] = PublicSignal(name, source, unit, description, group)

    def watch_state(self, owner: str, source: str, states: Mapping[int, str]) -> None:
        """Log each change of a sequence's state, with its name."""
        self.watched.append(Watched(owner, source, dict(states)))

    def watch_refusal(self, owner: str, source: str, reasons: Mapping[int, str]) -> None:
        """Log each refusal of a command, with its reason."""
        self.watched.append(Watched(owner, source, dict(reasons), refusal=True))


def _scalar_binding(end: Any) -> PortBinding:
    if isinstance(end, PortBinding):
        return end
    if isinstance(end, Pole):
        return PortBinding(end.bus.nodes[0], None, end.s, end.weight)
    if isinstance(end, Across) and isinstance(end.a, DcBus):
        return PortBinding(end.a.nodes[0], end.b.nodes[0])
    if isinstance(end, DcBus):
        return PortBinding(end.nodes[0])
    raise TopologyError(f"{end!r} cannot be connected to a single-phase terminal")


def _axis_binding(end: Any, axis: int) -> PortBinding:
    if isinstance(end, Pole3):
        return PortBinding(end.bus.nodes[0], None, (end.s_alpha, end.s_beta)[axis], 1.5)
    if isinstance(end, Across) and isinstance(end.a, AcBus):
        return PortBinding(end.a.nodes[axis], end.b.nodes[axis])
    if isinstance(end, AcBus):
        return PortBinding(end.nodes[axis])
    raise TopologyError(f"{end!r} cannot be connected to a three-phase terminal")
