"""Battery energy storage system: battery, buck-boost converter, control, and its on/off sequence.

    off -> pre-charge -> connect -> ramp in -> on -> unload -> off

Off, the contactor is open. Pre-charge: it closes through its resistor, gates blocked, and the leg's upper diode charges
a bus that is below the battery's voltage; on a live bus no current flows. Connect: the contactor closes. Ramp in: gates
released, references move from the measured state to their commands. Unload: droop with its set point moved
until the current is zero. Nothing here asks who else feeds the bus: if its voltage falls to `v_unload` while the
battery is being unloaded, nobody carries the load, the battery takes it back, and the command is refused.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from shipgrid.components.converters.buck_boost import BuckBoost
from shipgrid.components.sources.battery import Battery, internal_resistance, voltage_at_rest
from shipgrid.controllers.battery_control import BatteryControl
from shipgrid.equipment.declaration import Command, Published, as_in, equipment, reference, switch
from shipgrid.equipment.wiring import add_leg
from shipgrid.errors import ParameterError
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute
from shipgrid.model.placed import Every, Sampled
from shipgrid.model.public_signals import Waveform
from shipgrid.units import (
    Ampere,
    AmperePerSecond,
    Coulomb,
    Farad,
    Henry,
    Hertz,
    Ohm,
    PerUnit,
    PerUnitPerSecond,
    Ratio,
    Second,
    Volt,
    VoltPerSecond,
)

OFF, PRECHARGE, CONNECT, RAMP_IN, ON, UNLOAD = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
STATES = {0: "off", 1: "pre-charge", 2: "connect", 3: "ramp in", 4: "on", 5: "unload"}
NOT_CHARGED, LAST_SOURCE = 1.0, 2.0
REFUSALS = {
    1: "the bus does not charge: it is loaded or short-circuited",
    2: "no other source carries the bus: its voltage falls while this battery is unloaded",
}
DROOP = 1.0
CLOSED, OPEN, RESISTOR = 0.0, 1.0, 2.0  # positions of the contactor


class State:
    state: Ratio = signal("state of the sequence, a code")
    elapsed: Second = signal("time in this state")
    refused: Ratio = signal("why the standing command is refused, 0: it is not")


class Input:
    on: Ratio = signal("command: on")
    mode_ref: Ratio = signal("command: mode")
    v_dc: Volt = signal("bus voltage")
    v_b: Volt = signal("voltage at the battery's terminals")
    i_b: Ampere = signal("battery current, positive discharging")
    ramping: Ratio = signal("1 while a reference of the control moves to its command")


class Output:
    enable: Ratio = signal("1 while the gates are released")
    unload: Ratio = signal("1 while the control brings the current to zero")
    mode: Ratio = signal("mode for the control")
    position: Ratio = signal("position of the contactor: 0 closed, 1 open, 2 through the resistor", initial=OPEN)


@kernel
def update(t, dt, x: State, u: Input, p: BessSequence, x_next: State, y: Output):
    wanted = u.on.real > 0.5
    state = x.state.real
    refused = x.refused.real
    if refused == (LAST_SOURCE if wanted else NOT_CHARGED):
        refused = 0.0  # the command that had been refused stands no more
    now = state
    if state == OFF:
        if wanted and refused != NOT_CHARGED:
            now = PRECHARGE
    elif state == PRECHARGE:
        if not wanted:
            now = OFF
        elif u.v_dc.real >= p.charged.real * u.v_b.real and x.elapsed.real >= p.t_contact.real:
            now = CONNECT
        elif x.elapsed.real > p.t_charge.real:
            now = OFF
            refused = NOT_CHARGED
    elif state == CONNECT:
        if not wanted:
            now = OFF
        elif x.elapsed.real >= p.t_contact.real:
            now = RAMP_IN
    elif state == UNLOAD:
        if wanted:
            now = RAMP_IN
        elif absolute(u.i_b).real < p.i_idle.real:
            now = OFF
        elif u.v_dc.real < p.v_unload.real:
            now = RAMP_IN
            refused = LAST_SOURCE
    elif not wanted and refused != LAST_SOURCE:
        now = UNLOAD
    elif state == RAMP_IN and u.ramping.real < 0.5 and x.elapsed.real >= p.t_contact.real:
        now = ON
    x_next.state = now
    x_next.elapsed = x.elapsed + dt if now == state else 0.0 * x.elapsed
    x_next.refused = refused
    y.enable = 1.0 if now >= RAMP_IN else 0.0
    y.position = OPEN if now == OFF else (RESISTOR if now == PRECHARGE else CLOSED)
    y.unload = 1.0 if now == UNLOAD else 0.0
    y.mode = DROOP if now == UNLOAD else u.mode_ref


@component(state=State, input=Input, output=Output, stage="supervise", update=update)
class BessSequence:
    """On/off sequence of a battery system."""

    t_contact: Second = param("time of a contactor", default=0.1, at_least=0.0, source="typical")
    t_charge: Second = param("longest pre-charge", default=10.0, above=0.0, source="typical: 14 time constants")
    charged: Ratio = param(
        "bus voltage over battery voltage at which the contactor may close",
        default=0.97,
        above=0.5,
        at_most=1.0,
        source="typical: closing draws less than the rated current",
    )
    i_idle: Ampere = param("current at which the contactor may open", default=2.0, above=0.0, source="typical")
    v_unload: Volt = param(
        "bus voltage at which unloading is given up", default=712.5, above=0.0, source="0.95 of 750 V: the full droop"
    )


def parameters_for(cls: type, item: Any, **others: float) -> Any:
    """Instance of a component with its parameters taken from an item's keys of the same names."""
    names = [f.name for f in dataclasses.fields(cls)]
    return cls(**{name: others[name] if name in others else getattr(item, name) for name in names})


@equipment(
    "bess",
    commands=(
        switch("on", "battery system on or off", moored=True, refusals=REFUSALS),
        Command(
            "mode",
            "1",
            "what the converter regulates",
            1.0,
            3.0,
            1.0,
            words={"droop": 1.0, "voltage": 2.0, "current": 3.0},
        ),
        Command("v_dc_ref", "V", "bus voltage reference of droop and voltage forming", 700.0, 800.0, 750.0),
        Command("i_ref", "A", "battery current set point, positive discharging", -192.0, 192.0, 0.0),
    ),
    signals=(
        Published("i_b", "A", "battery current, positive discharging"),
        Published("v_b", "V", "battery terminal voltage"),
        Published("soc", "1", "state of charge", "slow"),
        Published("p_dc", "W", "power into the DC bus"),
        Published("i_dc", "A", "current into the DC bus"),
        Published("mode", "1", "0 off, 1 droop, 2 voltage, 3 current", "slow"),
    ),
    states=STATES,
)
class Bess:
    """Battery on a DC bus through a buck-boost converter."""

    bus: str = reference("DC bus it feeds", "dc")
    soc_0: Ratio = param(
        "state of charge at the start", default=0.5, at_least=0.02, at_most=1.0, source="[DAgostino2020] sec. 6.3"
    )
    f_sw: Hertz = param("switching and sampling frequency", default=5e3, above=0.0, source="[DAgostino2020] table A1")

    v_n: Volt = as_in(Battery, "v_n")
    capacity: Coulomb = as_in(Battery, "capacity")
    r: PerUnit = as_in(Battery, "r")
    t_n: Second = as_in(Battery, "t_n")
    v_full: PerUnit = as_in(Battery, "v_full")
    v_exp: PerUnit = as_in(Battery, "v_exp")
    q_exp: PerUnit = as_in(Battery, "q_exp")
    q_nom: PerUnit = as_in(Battery, "q_nom")
    T_r: Second = as_in(Battery, "T_r")

    L: Henry = as_in(BuckBoost, "L")
    R: Ohm = as_in(BuckBoost, "R")
    C: Farad = as_in(BuckBoost, "C")
    R_p: Ohm = as_in(BuckBoost, "R_p")

    f_c: Hertz = as_in(BatteryControl, "f_c")
    i_n: Ampere = as_in(BatteryControl, "i_n")
    k_dr: PerUnit = as_in(BatteryControl, "k_dr")
    f_filter: Hertz = as_in(BatteryControl, "f_filter")
    k_p_v: PerUnit = as_in(BatteryControl, "k_p_v")
    k_i_v: PerUnitPerSecond = as_in(BatteryControl, "k_i_v")
    v_band: Volt = as_in(BatteryControl, "v_band")
    i_rate: AmperePerSecond = as_in(BatteryControl, "i_rate")
    i_rate_mode: AmperePerSecond = as_in(BatteryControl, "i_rate_mode")
    v_rate: VoltPerSecond = as_in(BatteryControl, "v_rate")
    i_limit: PerUnit = as_in(BatteryControl, "i_limit")
    s_min: Ratio = as_in(BatteryControl, "s_min")
    s_max: Ratio = as_in(BatteryControl, "s_max")
    soc_min: Ratio = as_in(BatteryControl, "soc_min")
    soc_max: Ratio = as_in(BatteryControl, "soc_max")
    soc_fade: Ratio = as_in(BatteryControl, "soc_fade")

    t_contact: Second = as_in(BessSequence, "t_contact")
    t_charge: Second = as_in(BessSequence, "t_charge")
    charged: Ratio = as_in(BessSequence, "charged")
    i_idle: Ampere = as_in(BessSequence, "i_idle")
    v_unload: Volt = as_in(BessSequence, "v_unload")

    def check(self) -> None:
        """Refuse what is right number by number but not together."""
        if self.soc_max - self.soc_min < 2.0 * self.soc_fade:
            raise ParameterError(
                f"bess: soc_min = {self.soc_min:g} and soc_max = {self.soc_max:g} leave no room for twice "
                f"soc_fade = {self.soc_fade:g}"
            )
        if self.f_c > self.f_sw / 10.0:
            raise ParameterError(
                f"bess: f_c = {self.f_c:g} Hz is above a tenth of f_sw = {self.f_sw:g} Hz: the current loop would ring"
            )

    def full_load_voltage(self, v_n: float) -> float:
        """DC voltage [V] at which its droop asks for its rated current, on a bus of nominal voltage `v_n` [V]."""
        return v_n * (1.0 - 1.0 / self.k_dr) if self.k_dr > 0.0 else v_n

    def build(self, net: Any, name: str, ship: Any) -> None:
        """Wire the item into the network."""
        bus = ship.bus(self.bus)
        battery = parameters_for(Battery, self)
        R_b = internal_resistance(battery)
        v_dc = f"{self.bus}.v_dc"
        path = {part: f"{name}.{part}" for part in ("battery", "converter", "control")}
        sequence, i_b = f"{name}.sequence", f"{name}.converter.i_l"

        net.add(
            path["battery"],
            battery,
            inputs={"i": i_b},  # the capacitor's share is 12 uF times the slope of the battery's voltage
            initial={"q": (1.0 - self.soc_0) * self.capacity},
            clock=Every(1e-3),
        )
        clock, gates = Sampled(self.f_sw), f"{path['control']}.gates"
        leg = add_leg(net, name, bus, control=path["control"], gates=gates, clock=clock, f_sw=self.f_sw)
        net.add(
            path["converter"],
            parameters_for(BuckBoost, self, R_b=R_b),
            ports={"leg": leg},
            inputs={"e": f"{path['battery']}.e"},
            initial={"v_c": voltage_at_rest(battery, self.soc_0)},
            variant=f"{sequence}.position",
        )
        net.add(
            sequence,
            parameters_for(BessSequence, self),
            inputs={
                "on": net.command(f"{name}.on"),
                "mode_ref": net.command(f"{name}.mode"),
                "v_dc": v_dc,
                "v_b": f"{path['converter']}.v_c",
                "i_b": i_b,
                "ramping": f"{path['control']}.ramping",
            },
            clock=Every(10e-3),
        )
        net.add(
            path["control"],
            parameters_for(BatteryControl, self, v_dc_n=bus.v_n),
            inputs={
                "i_l": f"{path['converter']}.i_l",
                "v_b": f"{path['converter']}.v_c",
                "v_dc": v_dc,
                "soc": f"{path['battery']}.soc",
                "enable": f"{sequence}.enable",
                "unload": f"{sequence}.unload",
                "mode_ref": f"{sequence}.mode",
                "v_dc_ref": net.command(f"{name}.v_dc_ref"),
                "i_ref": net.command(f"{name}.i_ref"),
                "alternate": 0.0 if net.fidelity == "averaged" else 1.0,
            },
            clock=clock,
        )

        sources = {
            "i_b": i_b,
            "v_b": f"{path['converter']}.v_c",
            "soc": f"{path['battery']}.soc",
            "p_dc": f"{name}.leg.p_fed",
            "i_dc": f"{name}.leg.i_fed",
            "mode": f"{path['control']}.mode",
        }
        for public in type(self).__equipment__.signals:  # type: ignore[attr-defined]
            net.publish(
                f"{name}.{public.name}",
                source=sources[public.name],
                unit=public.unit,
                description=public.description,
                group=public.group,
            )
        net.publish_waveform(
            Waveform(
                f"{name}.s",
                ((f"{name}.leg.s", 1.0),),
                "1",
                "switching function of the upper switch, mean of a step",
                mean=True,
                carrier=self.f_sw,
            )
        )
        net.watch_state(name, f"{sequence}.state", states=STATES)
        net.watch_refusal(name, f"{sequence}.refused", reasons=REFUSALS)
