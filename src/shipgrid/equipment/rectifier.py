"""Active rectifier of a diesel genset: LCL filter, two-level bridge, control, and how it takes and sheds load.

    off -> pre-charging -> synchronising -> connected -> (waiting ->) unloading -> blocked -> off

Off, the contactor on the generator's side is open. When the genset is ready it closes through its resistor, gates
blocked: the filter charges, and the diodes charge the DC bus where it is below nine tenths of what they give. A bus
that does not come up is loaded or short-circuited: it opens, and is refused until the genset is called again. On a
charged bus the resistor is bridged; the PLL locks; the gates switch without making current; then the bound on
both current references opens along a ramp, and the voltage reference goes from the measured bus voltage to its
command. Told to unload, it waits until its DC power is one that the other sources can take over, and closes the bound
along the same ramp. If the bus falls below `v_release` meanwhile, nobody takes over: it carries on and tries again
later. Nothing here knows who else feeds the bus; the bus voltage tells.

A connected rectifier whose bus falls below that voltage opens, and begins anew.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.controllers.blocks.ramp import ramp
from shipgrid.controllers.rectifier_control import RectifierControl
from shipgrid.equipment.capability import (
    ENDS,
    Carried,
    FilterAtRest,
    Rated,
    RectifierLimits,
    Resonance,
    largest_choke,
    voltage_limit,
)
from shipgrid.equipment.declaration import Command, Published, as_in, block, choice, equipment, reference, refuse_other
from shipgrid.equipment.filter_rules import REACTIVE_POWER, RIPPLE, inductance_for_ripple, resonance_band
from shipgrid.equipment.wiring import add_bridge, publish_bridge_voltage
from shipgrid.errors import ParameterError
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute, hypot, maximum, minimum
from shipgrid.model.placed import Every, Sampled
from shipgrid.units import Farad, Hertz, Ohm, PerUnit, PerUnitPerSecond, Ratio, Second, Volt, VoltPerSecond, Watt

L_1_PAPER = 1.29
L_1_PRESETS = {"paper": L_1_PAPER, "phase_voltage_rule": 0.742, "compact": 0.129}
"""Converter-side inductance [pu of the rectifier's own rating]: as printed; by the sizing rule it follows,
L_1 = V_dc / (6 f_sw dI), with the phase voltage where the printed value has the line-to-line one; a tenth of it."""
DESIGN_RULES = "design_rules"
"""The filter preset that follows from rules (`equipment/filter_rules.py`) and the ratings, not from printed values."""

OFF, SYNCHRONISING, CONNECTED, WAITING, UNLOADING, BLOCKED, PRECHARGING = range(7)
STATES = {
    OFF: "off",
    SYNCHRONISING: "synchronising",
    CONNECTED: "connected",
    WAITING: "waiting: the other sources cannot take over its load yet",
    UNLOADING: "unloading",
    BLOCKED: "blocked",
    PRECHARGING: "pre-charging",
}
NOT_CHARGED = 1
REFUSALS = {NOT_CHARGED: "the DC bus does not charge: it is loaded or short-circuited"}
CLOSED, OPEN, RESISTOR = 0.0, 1.0, 2.0  # positions of the contactor
SEQUENCE_PERIOD = 10e-3
"""Clock of the sequence [s]: a switchboard's relay logic."""
DIODES = 3.0 * math.sqrt(2.0) / math.pi
"""Mean of a six-pulse rectified voltage over the line-to-line rms value."""


class State:
    state: Ratio = signal("state of the sequence, code")
    refused: Ratio = signal("why connecting is refused, code, 0 is not")
    timer: Second = signal("time during which what this state waits for has held")
    limit: PerUnit = signal("bound on the current references")
    v_ref: Volt = signal("DC voltage reference along its ramp")


class Input:
    ready: Ratio = signal("1 while the genset allows it to be connected")
    stop: Ratio = signal("1 while the genset asks it to unload and open")
    v_dc_ref: Volt = signal("command: DC voltage at no load")
    v_dc: Volt = signal("DC bus voltage")
    p_dc: Watt = signal("power into the DC bus")
    v_d: PerUnit = signal("capacitor voltage, d axis of the PLL")
    v_q: PerUnit = signal("capacitor voltage, q axis of the PLL")
    i_d: PerUnit = signal("d-axis current")
    i_q: PerUnit = signal("q-axis current")
    i_d_ref: PerUnit = signal("reference of the d-axis current")
    i_q_ref: PerUnit = signal("reference of the q-axis current")


class Output:
    contacts: Ratio = signal("position of the contactor: 0 closed, 1 open, 2 through the resistor", initial=OPEN)
    connected: Ratio = signal("1 while the contactor is closed")
    enable: Ratio = signal("1 while the gates switch")
    limit: PerUnit = signal("bound on the current references")
    v_dc_ref: Volt = signal("DC voltage reference")


@kernel
def update(t, dt, x: State, u: Input, p: RectifierSequence, x_next: State, y: Output):
    fed, stop = u.ready.real > 0.5, u.stop.real > 0.5
    charged = u.v_dc.real >= (p.charged * DIODES * p.v_n).real
    small = u.p_dc.real < p.release_power.real
    state = was = int(x.state.real)
    timer = 0.0
    refused = int(x.refused.real) if fed and not stop else 0

    if not fed:
        state = OFF
    elif was == OFF:
        if not stop and refused == 0:
            state = PRECHARGING
    elif was == PRECHARGING:
        timer = x.timer.real + dt
        if stop:
            state = OFF
        elif charged and timer >= p.t_contact.real:
            state = SYNCHRONISING
        elif timer >= p.t_charge.real:
            state = OFF
            refused = NOT_CHARGED
    elif not charged:
        state = OFF
    elif was == SYNCHRONISING:
        locked = u.v_d.real > p.v_locked.real and absolute(u.v_q).real < p.v_q_locked.real
        timer = x.timer.real + dt if locked else 0.0
        if stop:
            state = OFF
        elif timer >= p.t_lock.real:
            state = CONNECTED
    elif was == CONNECTED:
        if stop:
            state = UNLOADING if small else WAITING
    elif was == WAITING:
        timer = x.timer.real + dt if small else minimum(x.timer.real + dt, 0.0)  # below zero: it tries again later
        if not stop:
            state = CONNECTED
        elif timer >= p.t_small.real:
            state = UNLOADING
    elif was == UNLOADING:
        idle = x.limit.real <= 0.0 and hypot(u.i_d, u.i_q).real < p.i_idle.real
        if not stop:
            state = CONNECTED
        elif u.v_dc.real < p.v_release.real:
            state = WAITING
        elif idle:
            state = BLOCKED
    else:
        timer = x.timer.real + dt
        if timer >= p.t_contact.real:
            state = OFF

    gates = CONNECTED <= state <= UNLOADING
    limit = x.limit + 0.0
    if state == UNLOADING and was != UNLOADING:
        limit = minimum(limit, maximum(u.i_d_ref, absolute(u.i_q_ref)))  # what it carries now, so that it acts at once
    if state == WAITING and was == UNLOADING:
        limit = p.i_max + 0.0 * limit  # the bus falls: it takes back what it needs at once
    x_next.limit = ramp(0.0 if state == UNLOADING else p.i_max, limit, p.load_rate, dt) if gates else 0.0 * limit
    x_next.v_ref = ramp(u.v_dc_ref, x.v_ref, p.v_rate, dt) if gates else u.v_dc
    x_next.state = float(state)
    x_next.refused = float(refused)
    x_next.timer = timer if state == was else (-p.t_retry.real if was == UNLOADING and state == WAITING else 0.0)
    y.contacts = OPEN if state == OFF else (RESISTOR if state == PRECHARGING else CLOSED)
    y.connected = 0.0 if state == OFF else 1.0
    y.enable = 1.0 if gates else 0.0
    y.limit = x_next.limit
    y.v_dc_ref = x_next.v_ref


@component(state=State, input=Input, output=Output, stage="supervise", update=update)
class RectifierSequence:
    """Connecting, loading, unloading and opening of an active rectifier."""

    v_n: Volt = param("nominal AC voltage, line to line", default=480.0, above=0.0, source="[DAgostino2020] table A1")
    charged: Ratio = param(
        "DC voltage over the diodes' up to which it is pre-charged",
        default=0.9,
        above=0.0,
        source="usual end of a pre-charge",
    )
    t_charge: Second = param("longest pre-charge", default=10.0, above=0.0, source="typical: tens of time constants")
    v_locked: PerUnit = param("capacitor voltage at which the PLL may lock", default=0.8, above=0.0, source="typical")
    v_q_locked: PerUnit = param(
        "capacitor voltage across the d axis taken as locked", default=0.02, above=0.0, source="typical: 1 degree"
    )
    t_lock: Second = param("time for which the PLL must be locked", default=0.2, at_least=0.0, source="typical")
    t_contact: Second = param("time of the contactor", default=0.1, at_least=0.0, source="typical")
    load_rate: PerUnitPerSecond = param(
        "rate at which load is taken and shed",
        default=0.1,
        above=0.0,
        source="design choice: half load in 5 s, gentle for the diesel",
    )
    v_rate: VoltPerSecond = param("rate of the DC voltage reference", default=50.0, above=0.0, source="design choice")
    i_max: PerUnit = param(
        "bound on the current references when loaded", default=1.2, above=0.0, source="as the control's own"
    )
    i_idle: PerUnit = param("current at which the gates may be blocked", default=0.02, above=0.0, source="typical")
    release_power: Watt = param(
        "DC power below which it may unload", default=100e3, at_least=0.0, source="what two 128 A batteries take over"
    )
    t_small: Second = param("time below that power", default=1.0, at_least=0.0, source="typical")
    v_release: Volt = param(
        "DC voltage below which unloading is broken off",
        default=715.0,
        above=0.0,
        source="two 128 A batteries in droop hold 716 V at 50 kW each, 728 V with +40 A",
    )
    t_retry: Second = param(
        "time until the next attempt after that", default=30.0, at_least=0.0, source="design choice"
    )


@equipment(
    "rectifier",
    commands=(
        Command("v_dc_ref", "V", "DC voltage at no load", 700.0, 800.0, 750.0),
        Command(
            "mode",
            "1",
            "shares the bus by droop, or forms it alone",
            0.0,
            1.0,
            0.0,
            words={"droop": 0.0, "voltage": 1.0},
        ),
    ),
    signals=(
        Published("p_dc", "W", "power into the DC bus"),
        Published("i_dc", "A", "current into the DC bus"),
        Published("modulation", "1", "converter voltage over its limit"),
    ),
    states=STATES,
)
class Rectifier:
    """Active rectifier between a genset and a DC bus.

    The gains K_p, K_i of the current control belong to the paper's filter; with another `lcl_preset` they are scaled
    with L_1, which keeps the bandwidth.
    """

    source: str = reference("genset that feeds it", "genset")
    bus: str = reference("DC bus it feeds", "dc")
    rating: Watt = param(
        "rating, base of the per-unit values", default=596e3, above=0.0, source="[DAgostino2020] table A1"
    )
    f_sw: Hertz = param(
        "carrier frequency; it is sampled at twice that", default=1620.0, above=0.0, source="[DAgostino2020] table A1"
    )
    dc_droop: PerUnit = param("droop of the DC voltage", default=0.05, above=0.0, source="[DAgostino2020] table A1")
    ac_droop: PerUnit = param("droop of the AC voltage", default=0.05, above=0.0, source="[DAgostino2020] table A1")
    dc_pi: str = choice(
        "what the PI of the droop acts on: the error of the current, or (reading A of the paper) of the voltage",
        "current",
        "voltage",
        default="current",
    )
    q_ref: str = choice(
        "reference of the reactive power: the voltage error over its droop, or (literal) times it",
        "over_droop",
        "times_droop",
        default="over_droop",
    )
    C_dc: Farad = param(
        "capacitance of the DC side",
        default=10e-3,
        at_least=0.0,
        source="typical; with drive and inverter 17 mF a side, which the droop loop needs",
    )
    lcl_preset: str = choice(
        "converter-side inductance; `design_rules` has it and C from the ratings, docs/theory/converters.md",
        *L_1_PRESETS,
        DESIGN_RULES,
        "custom",
        default="paper",
    )
    ripple: Ratio = param(
        "largest ripple of the converter's current over its rated peak, peak to peak, of the preset `design_rules`",
        default=RIPPLE,
        above=0.0,
        below=1.0,
        source="design choice: docs/theory/converters.md",
    )
    L_1: PerUnit = param(
        "converter-side inductance of the preset `custom`",
        default=L_1_PAPER,
        above=0.0,
        source="[DAgostino2020] table A1",
    )
    C: PerUnit = param("filter capacitance", default=0.07, above=0.0, source="[DAgostino2020] table A1")
    L_2: PerUnit = param(
        "grid-side inductance, the transformer's leakage", default=0.09, above=0.0, source="[DAgostino2020] table A1"
    )
    R_1: PerUnit = param("resistance of the converter-side choke", default=0.005, at_least=0.0, source="typical")
    R_2: PerUnit = param("resistance of the transformer", default=0.005, at_least=0.0, source="typical")
    R_p: Ohm = as_in(LclFilter, "R_p")
    damping: Ratio = param(
        "damping resistance over the capacitor's reactance at resonance",
        default=1.0 / 3.0,
        at_least=0.0,
        source="usual rule for passive damping",
    )
    control: RectifierControl = block(RectifierControl)
    sequence: RectifierSequence = block(RectifierSequence)

    def check(self) -> None:
        """Refuse a control block that says differently what is said above it."""
        owners = (
            ("S_n", "rating"),
            ("K_v", "dc_droop"),
            ("K_e", "ac_droop"),
            ("L_1", "lcl_preset"),
            ("R_d", "damping"),
        )
        refuse_other(self, "control", (*owners, ("V_n", "source"), ("f_n", "source"), ("V_dc_n", "bus")))
        refuse_other(self, "sequence", (("v_n", "source"),))
        for key, read_with in (("L_1", ("custom",)), ("ripple", (DESIGN_RULES,)), ("C", (*L_1_PRESETS, "custom"))):
            said = getattr(self, key)
            if self.lcl_preset not in read_with and said != getattr(Rectifier, key):
                word = "read only with that" if key == "ripple" else f"set by lcl_preset: {self.lcl_preset}"
                raise ParameterError(f"rectifier.{key} = {said:g} is {word}, expected lcl_preset: {read_with[-1]}")

    def outer_loops(self) -> dict[str, float]:
        """Droops and gains of the outer loops in the reading of the paper that is chosen.

        Reading A, i_d* = PI(v* - K_v i - v), is reading B, PI((v* - v)/K_v - i), with gains K_v times as large.
        """
        scale = self.dc_droop if self.dc_pi == "voltage" else 1.0
        return {
            "K_v": self.dc_droop,
            "K_p_dc": scale * self.control.K_p_dc,
            "K_i_dc": scale * self.control.K_i_dc,
            "K_e": self.ac_droop if self.q_ref == "over_droop" else 1.0 / self.ac_droop,
        }

    def per_unit_filter(self, v_n: float, f_n: float, v_dc_n: float) -> tuple[float, float]:
        """Converter-side inductance and capacitance of its filter [pu of the rating].

        Parameters
        ----------
        v_n, f_n : float
            Nominal voltage, line to line, rms [V], and frequency [Hz] of the AC side.
        v_dc_n : float
            Nominal DC voltage [V].
        """
        if self.lcl_preset == DESIGN_RULES:
            L_1 = inductance_for_ripple(self.ripple, v_dc_n, self.f_sw, self.rating, v_n)
            return 2.0 * math.pi * f_n * L_1 * self.rating / v_n**2, REACTIVE_POWER
        return L_1_PRESETS.get(self.lcl_preset, self.L_1), self.C

    def lcl(self, v_n: float, f_n: float, v_dc_n: float) -> LclFilter:
        """Its filter, SI.

        Parameters
        ----------
        v_n, f_n : float
            Nominal voltage, line to line, rms [V], and frequency [Hz] of the AC side.
        v_dc_n : float
            Nominal DC voltage [V].
        """
        L_1, C = self.per_unit_filter(v_n, f_n, v_dc_n)
        return LclFilter.per_unit(self.rating, v_n, f_n, L_1, C, self.L_2, self.R_1, self.R_2, self.damping, self.R_p)

    def fitted_control(self, v_n: float, f_n: float, v_dc_n: float) -> RectifierControl:
        """Its control with ratings, filter and droops filled in; gains of the current scaled with L_1.

        Parameters
        ----------
        v_n, f_n : float
            Nominal voltage, line to line, rms [V], and frequency [Hz] of the AC side.
        v_dc_n : float
            Nominal DC voltage [V].
        """
        lcl, (L_1, _) = self.lcl(v_n, f_n, v_dc_n), self.per_unit_filter(v_n, f_n, v_dc_n)
        return dataclasses.replace(
            self.control,
            S_n=self.rating,
            V_n=v_n,
            f_n=f_n,
            V_dc_n=v_dc_n,
            L_1=lcl.L_1,
            R_d=lcl.R_d,
            K_p=self.control.K_p * L_1 / L_1_PAPER,
            K_i=self.control.K_i * L_1 / L_1_PAPER,
            **self.outer_loops(),
        )

    def limits(self, v_dc: float, v_n: float, f_n: float, v_dc_n: float, e: float = 1.0) -> RectifierLimits:
        """What bounds it at a DC voltage; its property `end` is the most it carries.

        Parameters
        ----------
        v_dc : float
            DC voltage [V].
        v_n, f_n : float
            Nominal voltage, line to line, rms [V], and frequency [Hz] of the AC side.
        v_dc_n : float
            Nominal DC voltage [V].
        e : float
            Voltage at the source's terminals over its nominal one.
        """
        lcl = FilterAtRest.of(self.lcl(v_n, f_n, v_dc_n), self.rating, v_n, f_n)
        v_lim = self.control.margin * voltage_limit(v_dc, v_n, self.control.m_max)
        return RectifierLimits(lcl, v_lim, self.control.share, self.control.i_max, e)

    def full_load_voltage(self, v_n: float) -> float:
        """DC voltage [V] at which its droop asks for its rated current, on a bus of nominal voltage `v_n` [V]."""
        return v_n * (1.0 - self.dc_droop)

    def rated(self, net: Any, ship: Any) -> tuple[Rated, ...]:
        """What it can carry, at nominal DC voltage and at that of its droop at full load.

        Parameters
        ----------
        net : Network
            The plant it is built into.
        ship : ShipInNetwork
            Its ship.
        """
        v_dc_n, terminals = ship.bus(self.bus).v_n, net.bus(f"{self.source}.terminals")
        sides = terminals.v_n, terminals.f_n, v_dc_n
        lowest = self.full_load_voltage(v_dc_n)

        def end(item: Rectifier, v_dc: float) -> Carried | None:
            try:
                return item.limits(v_dc, *sides).end
            except ParameterError:
                return None

        def said(point: Carried | None) -> str:
            if point is None:
                return "nothing: the DC voltage is too low"
            return f"by {ENDS[point.ended_by]}, taking {1e-3 * point.q_ac * self.rating:.3g} kvar"

        points = [(v_dc, end(self, v_dc)) for v_dc in (v_dc_n, lowest)]
        carries = tuple((v_dc, point.p_dc * self.rating if point else 0.0, said(point)) for v_dc, point in points)
        row = Rated(self.rating, "W", "", carries)
        if not row.short:
            return (row,)

        def enough(item: Rectifier) -> bool:
            found = end(item, lowest)
            return found is not None and found.p_dc >= 1.0

        L_1, C = self.per_unit_filter(*sides)
        remedies = []
        if self.lcl_preset != DESIGN_RULES:
            ruled = dataclasses.replace(self, lcl_preset=DESIGN_RULES, L_1=L_1_PAPER, C=Rectifier.C)
            if enough(ruled):
                L_rules, _ = ruled.per_unit_filter(*sides)
                remedies.append(f"lcl_preset: {DESIGN_RULES} carries the rating with {L_rules:.3g} pu")
        custom = dataclasses.replace(self, lcl_preset="custom", C=C, ripple=RIPPLE)
        most = largest_choke(lambda x: enough(dataclasses.replace(custom, L_1=x)), L_1)
        if most is not None:
            remedies.append(f"lcl_preset: custom with up to {most:g} pu")
        remedy = ", ".join(remedies) or "no smaller one carries the rating: DC voltage or current limit are too low"
        return (row._replace(remedy=f"L_1 is {L_1:.3g} pu; {remedy}"),)

    def resonances(self, net: Any, ship: Any) -> tuple[Resonance, ...]:
        """Where its filter resonates, behind the genset's subtransient reactance and on a stiff voltage.

        Parameters
        ----------
        net : Network
            The plant it is built into.
        ship : ShipInNetwork
            Its ship.
        """
        terminals = net.bus(f"{self.source}.terminals")
        lcl = self.lcl(terminals.v_n, terminals.f_n, ship.bus(self.bus).v_n)
        band = resonance_band(terminals.f_n, self.f_sw)
        L_source = ship.item(self.source).subtransient_inductance
        return (
            Resonance(lcl.resonance(L_source), *band, "its source's X'', mean of both axes"),
            Resonance(lcl.resonance(), *band, "a stiff voltage"),
        )

    def build(self, net: Any, name: str, ship: Any) -> None:
        """Wire the item into the network."""
        bus, terminals = ship.bus(self.bus), net.bus(f"{self.source}.terminals")
        sides = terminals.v_n, terminals.f_n, bus.v_n
        lcl, control = self.lcl(*sides), self.fitted_control(*sides)
        net.capacitance(bus, self.C_dc)

        states = {f"{x}_{axis}": f"{name}.lcl.{axis}.{x}" for x in ("v_c", "i_1", "i_2") for axis in ("alpha", "beta")}
        clock = Sampled(2.0 * self.f_sw)
        enable = f"{name}.sequence.enable"
        bridge = add_bridge(net, name, bus, control=f"{name}.control", gates=enable, clock=clock, f_sw=self.f_sw)
        (v_dc,) = bus.nodes
        net.add_three_phase(
            f"{name}.lcl",
            lcl,
            ports={"converter": bridge, "grid": terminals},
            variant=f"{name}.sequence.contacts",
        )
        net.add(
            f"{name}.control",
            control,
            inputs=states
            | {
                "v_dc": v_dc,
                "v_dc_ref": f"{name}.sequence.v_dc_ref",
                "mode": net.command(f"{name}.mode"),
                "enable": enable,
                "limit": f"{name}.sequence.limit",
            },
            clock=clock,
        )
        measured = ("p_dc", "v_d", "v_q", "i_d", "i_q", "i_d_ref", "i_q_ref")
        net.add(
            f"{name}.sequence",
            dataclasses.replace(self.sequence, v_n=terminals.v_n),
            inputs={
                "ready": f"{self.source}.sequence.ready",
                "stop": f"{self.source}.sequence.stop",
                "v_dc_ref": net.command(f"{name}.v_dc_ref"),
                "v_dc": v_dc,
            }
            | {field: f"{name}.control.{field}" for field in measured},
            clock=Every(SEQUENCE_PERIOD),
        )

        sources = {"p_dc": "bridge.p_fed", "i_dc": "bridge.i_fed", "modulation": "control.modulation"}
        for public in type(self).__equipment__.signals:  # type: ignore[attr-defined]
            net.publish(
                f"{name}.{public.name}",
                source=f"{name}.{sources[public.name]}",
                unit=public.unit,
                description=public.description,
                group=public.group,
            )
        for stem, field, unit, sign, text in (
            ("i", "i_1", "A", -1.0, "current of the bridge, from genset to bridge"),
            ("i_g", "i_2", "A", -1.0, "current of the transformer, from genset to bridge"),
            ("v_c", "v_c", "V", 1.0, "voltage of the filter's capacitor"),
        ):
            paths = {axis: f"{name}.lcl.{axis}.{field}" for axis in ("alpha", "beta")}
            net.publish_phases(f"{name}.{stem}", **paths, unit=unit, description=text, sign=sign, carrier=self.f_sw)
        publish_bridge_voltage(net, name, f"{name}.lcl", self.f_sw)
        net.watch_state(name, f"{name}.sequence.state", states=STATES)
        net.watch_refusal(name, f"{name}.sequence.refused", reasons=REFUSALS)
