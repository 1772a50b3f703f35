"""The network as a one-line diagram has it: buses, elements between them, controllers, commands, public signals.

A `Network` is a description and nothing else: `assembly.assemble` turns it into arrays. Everything is named by path,
`<item>.<part>.<field>`, and may be added in any order; names are resolved at assembly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from shipgrid.errors import ParameterError, TopologyError
from shipgrid.model.component import ComponentType, fields_of, type_of
from shipgrid.model.connections import (
    AcBus,
    Bus,
    DcBus,
    Legs,
    Pole,
    Pole3,
    PortBinding,
    axis_binding,
    buses_of,
    ends_by_terminal,
    in_words,
    is_three_phase,
    scalar_binding,
    terminals_in_words,
)
from shipgrid.model.frames import PHASES
from shipgrid.model.placed import Every, Placed, Sampled, WhenClosed
from shipgrid.model.public_signals import PublicSignal, Watched, Waveform
from shipgrid.names import checked_path

FIDELITIES = ("averaged", "switching")
"""Mean values of the converters, or every edge."""


@dataclass(repr=False)
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
    fidelity: str = FIDELITIES[0]
    buses: dict[str, Bus] = field(default_factory=dict, init=False)
    capacitances: dict[str, float] = field(default_factory=dict, init=False)
    conductances: dict[str, float] = field(default_factory=dict, init=False)
    shunts: list[tuple[str, float, str, str]] = field(default_factory=list, init=False)
    placed: dict[str, Placed] = field(default_factory=dict, init=False)
    legs: dict[str, Legs] = field(default_factory=dict, init=False)
    commands: dict[str, float] = field(default_factory=dict, init=False)
    published: dict[str, PublicSignal] = field(default_factory=dict, init=False)
    waveforms: dict[str, Waveform] = field(default_factory=dict, init=False)
    watched: list[Watched] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        if self.fidelity not in FIDELITIES:
            raise ParameterError(f"there is no fidelity '{self.fidelity}', expected one of {', '.join(FIDELITIES)}")

    def __repr__(self) -> str:
        return f"<Network {self.name}: {len(self.placed)} components on {len(self.buses)} buses>"

    def dc_bus(self, name: str, v_n: float) -> DcBus:
        """Add a DC bus.

        Parameters
        ----------
        name : str
        v_n : float
            Nominal voltage, pole to pole [V].
        """
        return self._bus(DcBus(name, v_n))

    def ac_bus(self, name: str, v_n: float, f_n: float) -> AcBus:
        """Add a three-wire AC bus.

        Parameters
        ----------
        name : str
        v_n : float
            Nominal voltage, line to line [V rms].
        f_n : float
            Nominal frequency [Hz].
        """
        return self._bus(AcBus(name, v_n, f_n))

    def _bus(self, bus: Any) -> Any:
        checked_path(bus.name, self.name)
        if bus.name in self.buses:
            raise TopologyError(f"{self.name}: two buses of the name '{bus.name}'")
        self.buses[bus.name] = bus
        return bus

    def bus(self, name: str) -> Any:
        """The bus of a name.

        Parameters
        ----------
        name : str

        Raises
        ------
        TopologyError
            If there is none.
        """
        if name not in self.buses:
            raise TopologyError(f"{self.name}: no bus '{name}', there are {sorted(self.buses)}")
        return self.buses[name]

    def capacitance(self, bus: Bus, farad: float) -> None:
        """Add capacitance to a bus; capacitors in parallel merge.

        Parameters
        ----------
        bus : DcBus or AcBus
        farad : float
            Between the poles of a DC bus, or per axis of an AC bus [F].
        """
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
        contact: str | None = None,
        axis_weight: float = 1.0,
        **ends: Any,
    ) -> None:
        """Place one component: `net.add("cable", RlBranch(R=0.01, L=1e-4), a=source, b=load)`.

        Terminals are connected by their names, to a bus or to a `Pole`. The ends of a branch are `a` and `b`, and
        its current counts from `a` to `b`; without `b` the branch lies between the poles of a DC bus, or from each
        phase of an AC bus to the star point. On AC buses a per-axis element is placed twice, as `path.alpha` and
        `path.beta`.

        Parameters
        ----------
        path : str
            Its name, unique in the plant.
        item : component instance
            Parameters; or a device of several components, which places them itself (`SaturableTransformer`).
        ports : mapping of str to DcBus, AcBus, Across, Pole, Pole3 or PortBinding
            For a network element: where each terminal is connected; `ends` says the same.
        inputs : mapping of str to str or float
            Path of the signal an input reads, or a constant.
        initial : mapping of str to float
            Initial values of states, in place of the declared ones.
        clock : Every or Sampled, optional
            When it runs; every step if left out.
        variant : str, optional
            For a linear element: path of the signal that selects the position of its contacts.
        contact : {"closed", "open"}, optional
            For a linear element with a contact: gives it the command `<path>.close`, and its position at the start.
            A breaker has it unless `variant` moves it.
        axis_weight : float
            What its energy counts: 3/2 for one axis of a three-phase element.
        **ends : DcBus, AcBus, Across, Pole, Pole3 or PortBinding
            Where each terminal is connected, by its name; `a` and `b` for the ends of a branch.

        Raises
        ------
        TopologyError
            If the path is taken, or terminals and connections do not match.
        """
        if hasattr(item, "place"):  # several components that stand for one device
            item.place(self, path, {**(ports or {}), **ends})
            return
        kind = type_of(item)
        given = self._ends(path, kind, {**(ports or {}), **ends})
        if contact is not None and not kind.variants and "close" in {f.name for f in fields_of(kind.input)}:
            inputs, contact = {**(inputs or {}), "close": _closed(path, kind, contact)}, None
        variant = self._position(path, kind, variant, contact)
        if any(is_three_phase(end) for end in given.values()) or (
            kind.two_axis_ends and not any(isinstance(end, PortBinding) for end in given.values())
        ):
            self._add_three_phase(path, item, given, inputs or {}, initial, clock, variant)
            return
        self._check_free(path)
        bound = {name: scalar_binding(f"{path} ({kind.name}): terminal '{name}'", end) for name, end in given.items()}
        names = {terminal.name for terminal in kind.terminals}
        if set(bound) != names:
            raise TopologyError(f"{path} ({kind.name}) has {terminals_in_words(kind)}, connected are {sorted(bound)}")
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
        given = self._ends(path, type_of(item), ports)
        self._add_three_phase(path, item, given, inputs or {}, initial, clock, variant)

    def _add_three_phase(
        self,
        path: str,
        item: Any,
        ports: Mapping[str, Any],
        inputs: Mapping[str, Any],
        initial: Mapping[str, float] | None,
        clock: Every | Sampled | None,
        variant: str | None,
    ) -> None:
        kind = type_of(item)
        axes = kind.two_axis_ends
        if not axes:
            for k, axis in enumerate(("alpha", "beta")):
                self.add(
                    f"{path}.{axis}",
                    item,
                    ports={
                        name: axis_binding(f"{path} ({kind.name}): terminal '{name}'", end, k)
                        for name, end in ports.items()
                    },
                    inputs={name: v[k] if isinstance(v, tuple) else v for name, v in inputs.items()},
                    initial=initial,
                    clock=clock,
                    variant=variant,
                    axis_weight=1.5,
                )
            return
        if len(ports) == len(axes) == 1:  # whatever the only end of a machine is called
            ports = dict.fromkeys(axes, *ports.values())
        if set(ports) != set(axes):
            raise TopologyError(f"{path} ({kind.name}) has {terminals_in_words(kind)}, connected are {sorted(ports)}")
        bound = {
            terminal: axis_binding(f"{path} ({kind.name}): terminal '{name}'", end, k)
            for name, end in ports.items()
            for k, terminal in enumerate(axes[name])
        }
        # the books of a machine are those of the device, of a linear element those of its axes
        weight = 1.0 if kind.stamped else 1.5
        self.add(
            path, item, ports=bound, inputs=inputs, initial=initial, clock=clock, variant=variant, axis_weight=weight
        )

    def _check_free(self, path: str) -> None:
        checked_path(path, self.name)
        if path in self.placed:
            raise TopologyError(f"{self.name}: two components of the name '{path}'")

    def _ends(self, path: str, kind: ComponentType, ends: Mapping[str, Any]) -> dict[str, Any]:
        """Ends by terminal; their buses have to be of this network."""
        for name, end in ends.items():
            for bus in buses_of(end):
                if self.buses.get(bus.name) is not bus:
                    raise TopologyError(
                        f"{path} ({kind.name}): terminal '{name}' is connected to {in_words(bus)}, "
                        f"which is no bus of {self.name}; it has {sorted(self.buses)}"
                    )
        return ends_by_terminal(path, kind, ends)

    def _position(self, path: str, kind: ComponentType, variant: str | None, contact: str | None) -> str | None:
        """Path of the signal that moves an element's contacts, its own command where it has one."""
        if contact is None and not (kind.operated and variant is None):
            return variant
        contact = contact or "closed"
        if next(iter(kind.variants), None) != "open":
            raise TopologyError(f"{path} ({kind.name}) has no contact that opens")
        if variant is not None:
            raise TopologyError(
                f"{path} ({kind.name}): contact = '{contact}', but '{variant}' moves its contact already"
            )
        return WhenClosed(self.command(f"{path}.close", _closed(path, kind, contact)))

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

    def reconnect(self, path: str, **inputs: str | float) -> dict[str, str | float]:
        """Let inputs of a placed component read other signals; returns what they read before.

        Parameters
        ----------
        path : str
            Of the component.
        **inputs : str or float
            Path of the signal each reads from now on, or a constant.
        """
        own = self.placed[path].inputs
        before = {name: own[name] for name in inputs}
        own.update(inputs)
        return before

    def command(self, path: str, value: float = 0.0) -> str:
        """Path of the signal of a command, which is declared with that.

        Parameters
        ----------
        path : str
            Name of the command.
        value : float
            At the start; of one that is declared already nothing changes.
        """
        self.commands.setdefault(checked_path(path, self.name), value)
        return f"command:{path}"

    def publish(self, name: str, *, source: str, unit: str, description: str, group: str = "plant") -> None:
        """Make a signal public: recorded and listed under a name.

        Parameters
        ----------
        name : str
        source : str
            Path of the signal.
        unit, description : str
        group : {"plant", "slow"}
            Recorder group.
        """
        if name in self.published:
            raise TopologyError(f"{self.name}: two public signals of the name '{name}'")
        self.published[checked_path(name, self.name)] = PublicSignal(name, source, unit, description, group)

    def publish_waveform(self, waveform: Waveform) -> None:
        """Make a quantity public in waveform windows, beside all public signals.

        Parameters
        ----------
        waveform : Waveform
        """
        if waveform.name in self.waveforms or waveform.name in self.published:
            raise TopologyError(f"{self.name}: two public signals of the name '{waveform.name}'")
        self.waveforms[checked_path(waveform.name, self.name)] = waveform

    def publish_phases(
        self,
        stem: str,
        *,
        alpha: str,
        beta: str,
        unit: str,
        description: str,
        sign: float = 1.0,
        lines: bool = False,
        mean: bool = False,
        carrier: float = 0.0,
    ) -> None:
        """Publish the three phases of an alpha-beta pair as `<stem>_a` ..., or their differences as `<stem>_ab` ...

        Parameters
        ----------
        stem : str
            Public name without the phase.
        alpha, beta : str
            Paths of the signals of the two axes.
        unit, description : str
            The phase is added to the description.
        sign : float
            What both are multiplied by: -1 turns the direction in which a current counts.
        lines : bool
            Whether to publish the differences between phases in place of the phases.
        mean, carrier
            As in `Waveform`.
        """
        of = PHASES
        if lines:
            of = {a + b: (of[a][0] - of[b][0], of[a][1] - of[b][1]) for a, b in ("ab", "bc", "ca")}
        for phase, (on_alpha, on_beta) in of.items():
            where = f"{'between phases ' + ' and '.join(phase) if lines else 'phase ' + phase}"
            terms = tuple((path, sign * k) for path, k in ((alpha, on_alpha), (beta, on_beta)) if k != 0.0)
            self.publish_waveform(
                Waveform(f"{stem}_{phase}", terms, unit, f"{description}, {where}", mean=mean, carrier=carrier)
            )

    def watch_state(self, owner: str, source: str, states: Mapping[int, str]) -> None:
        """Log each change of a sequence's state, with its name.

        Parameters
        ----------
        owner : str
            Whose sequence it is.
        source : str
            Path of the signal that is the state's code.
        states : mapping of int to str
            Names by code.
        """
        self.watched.append(Watched(owner, source, dict(states)))

    def watch_refusal(self, owner: str, source: str, reasons: Mapping[int, str]) -> None:
        """Log each refusal of a command, with its reason.

        Parameters
        ----------
        owner : str
            Who refuses.
        source : str
            Path of the signal that is the reason's code.
        reasons : mapping of int to str
            Texts by code.
        """
        self.watched.append(Watched(owner, source, dict(reasons), refusal=True))


def _closed(path: str, kind: ComponentType, contact: str) -> float:
    """1.0 or 0.0 for a contact that is closed or open at the start."""
    if contact not in ("closed", "open"):
        raise TopologyError(f"{path} ({kind.name}): contact = {contact!r}, expected 'closed' or 'open'")
    return 1.0 if contact == "closed" else 0.0
