"""Grid-forming inverter: bridge, LCL filter, 390/400 V transformer and output contactor, from a DC bus to an AC bar.

The transformer's leakage is the filter's second inductance; all values are referred to the bar's side. Black start:
the contactor closes on the dead bar with no voltage and the set point rises on a ramp, so that no inrush occurs. A live
bar it joins: it runs up on its own capacitors with the contactor open, is brought into step with the bar, and closes;
its trims are then taken back slowly and droop gives it its share. The synchroniser is that of an AC tie, between the
capacitors and the bar (`automation/ac_tie.py`); where the bar's frequency is out of its reach (a load of more than 0.5
pu on the others) it gives up and says so, until the command is given anew.
'Off' unloads first: the power set point goes down. If the power follows, others feed the bar: the voltage set point is
moved as well until hardly any power flows, and the load stays with them. If it does not follow, the inverter is alone,
and takes the bar down along the voltage ramp.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from shipgrid.automation.ac_tie import AcTie
from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.controllers.grid_forming import PRESETS, GridForming
from shipgrid.equipment.breakers import AC_CONTROL_PERIOD, trims_of
from shipgrid.equipment.capability import (
    ENDS,
    FilterAtRest,
    LoadedInverter,
    Rated,
    Resonance,
    inverter_end,
    largest_choke,
    lowest_full_load_voltage,
    voltage_limit,
)
from shipgrid.equipment.declaration import Published, block, choice, equipment, reference, switch
from shipgrid.equipment.filter_rules import resonance_band
from shipgrid.equipment.wiring import add_bridge, add_filter_voltage, publish_bridge_voltage
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.network import Network
from shipgrid.model.ops import absolute, clip, hypot
from shipgrid.model.placed import Every, Sampled
from shipgrid.units import (
    Ampere,
    Farad,
    Hertz,
    PerUnit,
    PerUnitPerSecond,
    Ratio,
    Second,
    Var,
    Volt,
    VoltAmpere,
    Watt,
)

STATES = {0: "off", 1: "starting", 2: "on", 3: "unloading", 4: "synchronising"}
OFF, STARTING, ON, UNLOADING, SYNCHRONISING = 0.0, 1.0, 2.0, 3.0, 4.0
CLOSED, OPEN, IDLE = 0.0, 1.0, 3.0  # positions of the contactor

REFUSALS = {
    1: "the DC bus is below 650 V",
    2: "the AC bar is live and the inverter could not be brought into step with it",
}


class SequenceState:
    """State of the sequence."""

    state: Ratio = signal("0 off, 1 starting, 2 on, 3 unloading, 4 synchronising")
    v_ref: PerUnit = signal("voltage set point")
    p_ref: PerUnit = signal("power set point")
    elapsed: Second = signal("time of unloading")
    p_before: PerUnit = signal("power delivered when unloading began")
    alone: Ratio = signal("1: unloading showed that nobody else feeds the bar")
    joined: Ratio = signal("1: it synchronises with a live bar or has done so")
    join: Ratio = signal("1: the synchroniser is to close, and then to stay closed")
    gave_up: Ratio = signal("1: it could not, and the command stands")


class SequenceInput:
    """Input of the sequence."""

    on: Ratio = signal("command")
    v_dc: Volt = signal("DC bus voltage")
    v_alpha: Volt = signal("bar voltage, alpha axis")
    v_beta: Volt = signal("bar voltage, beta axis")
    v_set: PerUnit = signal("voltage set point on the controller's ramp")
    p: PerUnit = signal("power delivered")
    q: PerUnit = signal("reactive power delivered")
    in_step: Ratio = signal("1: the synchroniser closes", initial=0.0)
    no_step: Ratio = signal("1: the synchroniser gave up", initial=0.0)


class SequenceOutput:
    """Output of the sequence."""

    code: Ratio = signal("state of the sequence")
    refused: Ratio = signal("reason why it does not start, 0: none")
    enable: Ratio = signal("1: gates work")
    position: Ratio = signal("contact position of the filter: 0 closed, 1 open, 3 open and running", initial=OPEN)
    on: Ratio = signal("1: on, at its voltage")


class Derived:
    """Base."""

    v_b: Volt = signal("base voltage, peak of a phase")


def derive(p: InverterSequence) -> dict[str, float]:
    """Base voltage."""
    return {"v_b": math.sqrt(2.0 / 3.0) * p.v_n}


@kernel
def unload(dt, x: SequenceState, u: SequenceInput, p: InverterSequence, x_next: SequenceState):
    """Move the set points against the power that still flows; whether little enough is left to open."""
    x_next.elapsed = x.elapsed + dt
    if x.elapsed.real < p.t_judge.real:
        x_next.alone = 1.0 if absolute(u.p - x.p_before).real < absolute(p.follows * x.p_ref).real else 0.0
    if x.alone.real > 0.5 and x.elapsed.real >= p.t_judge.real:
        x_next.v_ref = 0.0 * x.v_ref
        return u.v_set.real <= 0.0  # whatever still flows before would be torn off
    x_next.p_ref = clip(x.p_ref - p.rate * dt * clip(u.p / p.p_open, -1.0, 1.0), -1.0, 1.0)
    if x.elapsed.real >= p.t_judge.real:
        x_next.v_ref = clip(x.v_ref - p.v_rate * dt * clip(u.q / p.q_open, -1.0, 1.0), 0.0, 1.0)
    little = absolute(u.p).real < p.p_open.real and absolute(u.q).real < p.q_open.real
    return little or u.v_set.real <= 0.0


@kernel
def update(t, dt, x: SequenceState, u: SequenceInput, p: InverterSequence, x_next: SequenceState, y: SequenceOutput):
    wanted = u.on.real > 0.5
    y.refused = 0.0
    if x.state == OFF and wanted:
        if u.v_dc.real < p.v_dc_min.real:
            y.refused = 1.0
        elif hypot(u.v_alpha, u.v_beta).real > (p.v_dead * p.v_b).real:
            if x.gave_up.real > 0.5:
                y.refused = 2.0
            else:
                x_next.state = SYNCHRONISING
                x_next.joined = 1.0
        else:
            x_next.state = STARTING
    elif x.state == STARTING or x.state == ON:
        if not wanted:
            x_next.state = UNLOADING
        elif x.state == STARTING and hypot(u.v_alpha, u.v_beta).real > ((u.v_set + p.v_foreign) * p.v_b).real:
            x_next.state = OFF  # a tie closed onto the bar at the same moment: this is not its own voltage
        elif u.v_set.real >= 1.0:
            x_next.state = ON
    elif x.state == UNLOADING:
        if wanted:
            x_next.state = STARTING
        elif unload(dt, x, u, p, x_next):
            x_next.state = OFF
    elif x.state == SYNCHRONISING:
        if not wanted:
            x_next.state = OFF
        elif u.in_step.real > 0.5:
            x_next.state = ON
        elif u.no_step.real > 0.5:
            x_next.state = OFF
            x_next.gave_up = 1.0
    if not wanted:
        x_next.gave_up = 0.0
    if x_next.state != UNLOADING or x.state != UNLOADING:
        x_next.v_ref = 1.0
        x_next.p_ref = 0.0
        x_next.elapsed = 0.0
        x_next.p_before = u.p
        x_next.alone = 0.0
    running = x_next.state != OFF
    if not running:
        x_next.joined = 0.0
    y.code = x_next.state
    y.enable = 1.0 if running else 0.0
    y.position = IDLE if x_next.state == SYNCHRONISING else (CLOSED if running else OPEN)
    # not before its own voltage is there: a dead side would be closed onto
    own = x_next.state != SYNCHRONISING or u.v_set.real >= 1.0
    x_next.join = 1.0 if x_next.joined.real > 0.5 and own else 0.0
    y.on = 1.0 if x_next.state == ON else 0.0


@component(
    state=SequenceState,
    input=SequenceInput,
    output=SequenceOutput,
    derived=Derived,
    derive=derive,
    update=update,
    stage="supervise",
)
class InverterSequence(Derived):
    """On/off sequence of a grid-forming inverter."""

    v_n: Volt = param("nominal voltage of the bar, line to line, rms", default=400.0, above=0.0, source="table A1")
    v_dc_min: Volt = param("lowest DC voltage to start at", default=650.0, above=0.0, source="sqrt 2 400 V and 15 %")
    v_dead: PerUnit = param("below this the bar is dead", default=0.05, above=0.0, source="dead-bus rule")
    v_foreign: PerUnit = param(
        "voltage above its own at which a starting inverter gives way", default=0.3, above=0.0, source="typical"
    )
    rate: PerUnitPerSecond = param("ramp of the power when unloading", default=0.25, above=0.0, source="typical")
    v_rate: PerUnitPerSecond = param(
        "ramp of the voltage when unloading beside others", default=0.05, above=0.0, source="4 1/s on reactive power"
    )
    t_judge: Second = param(
        "time of unloading after which it judges whether others take over",
        default=0.5,
        above=0.0,
        source="ten times the angle loop's",
    )
    follows: Ratio = param(
        "change of power over that of its set point below which it is alone",
        default=0.05,
        above=0.0,
        source="one of 20 equal units changes by 0.95, one of 20 times the other's rating by 0.05",
    )
    p_open: PerUnit = param("power at which the contactor opens", default=0.03, above=0.0, source="typical")
    q_open: PerUnit = param("reactive power at which the contactor opens", default=0.05, above=0.0, source="typical")


class MeterInput:
    """Input of the meter."""

    v_alpha: Volt = signal("bar voltage, alpha axis")
    v_beta: Volt = signal("bar voltage, beta axis")
    i_2_alpha: Ampere = signal("current into the bar, alpha axis")
    i_2_beta: Ampere = signal("current into the bar, beta axis")


class MeterOutput:
    """Output of the meter."""

    p_ac: Watt = signal("power into the bar")
    q_ac: Var = signal("reactive power into the bar")


@kernel
def meter_outputs(t, u: MeterInput, y: MeterOutput):
    y.p_ac = 1.5 * (u.v_alpha * u.i_2_alpha + u.v_beta * u.i_2_beta)
    y.q_ac = 1.5 * (u.v_beta * u.i_2_alpha - u.v_alpha * u.i_2_beta)


@component(input=MeterInput, output=MeterOutput, outputs=meter_outputs, stage="measure")
class InverterMeter:
    """Powers at both sides of the inverter."""


@equipment(
    "inverter",
    commands=(switch("on", "feed the AC bar, in step with it if it is live", moored=True, refusals=REFUSALS),),
    signals=(
        Published("p_ac", "W", "active power into the AC bar"),
        Published("q_ac", "var", "reactive power into the AC bar"),
        Published("f", "Hz", "internal frequency"),
        Published("p_dc", "W", "power taken from the DC bus"),
        Published("on", "1", "1: on, at its voltage"),
    ),
    states=STATES,
)
class Inverter:
    """Grid-forming inverter with LCL filter, transformer and contactor.

    The filter preset `paper` brings its own inductance and gains in place of every value that stands at its declared
    default; a value that the ship file sets otherwise stays.
    """

    bus: str = reference("DC bus that feeds it", "dc")
    grid: str = reference("AC bar it feeds", "ac")
    rating: VoltAmpere = param("rating", default=50e3, above=0.0, source="[DAgostino2020] table A1")
    filter: str = choice("filter and gains", "default", "paper", default="default")
    L_1: PerUnit = param("converter-side inductance", default=0.891, above=0.0, source="phase-voltage sizing rule")
    C: PerUnit = param("filter capacitance", default=0.06, above=0.0, source="[DAgostino2020] table A1")
    L_t: PerUnit = param("leakage of the transformer", default=0.10, above=0.0, source="[DAgostino2020] table A1")
    R_1: PerUnit = param("resistance of the converter-side choke", default=0.005, at_least=0.0, source="typical")
    R_t: PerUnit = param("resistance of the transformer", default=0.005, at_least=0.0, source="typical")
    C_dc: Farad = param("capacitance of the DC side", default=2e-3, at_least=0.0, source="typical, 11 ms at 50 kVA")
    f_sw: Hertz = param("carrier and sampling frequency", default=1620.0, above=0.0, source="as the rectifier's")
    control: GridForming = block(GridForming)

    def lcl(self, v_n: float, f_n: float) -> LclFilter:
        """Filter and transformer of an inverter whose preset is resolved, SI.

        Parameters
        ----------
        v_n, f_n : float
            Nominal voltage, line to line, rms [V], and frequency [Hz] of the bar.
        """
        return LclFilter.per_unit(
            self.rating, v_n, f_n, L_1=self.L_1, C=self.C, L_2=self.L_t, R_1=self.R_1, R_2=self.R_t
        )

    def end(self, v_dc: float, v_n: float, f_n: float, power_factor: float) -> LoadedInverter:
        """The most an inverter whose preset is resolved carries of a lagging load, per unit of its rating.

        Parameters
        ----------
        v_dc : float
            DC voltage [V].
        v_n, f_n : float
            Nominal voltage, line to line, rms [V], and frequency [Hz] of the bar.
        power_factor : float
            cos phi of the load.
        """
        lcl = FilterAtRest.of(self.lcl(v_n, f_n), self.rating, v_n, f_n)
        return inverter_end(lcl, voltage_limit(v_dc, v_n), self.control.i_max, self.control.m_q, power_factor)

    def rated(self, net: Network, ship: Any) -> tuple[Rated, ...]:
        """What it can carry at power factor 1 and at those of the loads on its bar.

        Parameters
        ----------
        net : Network
            The plant it is built into.
        ship : ShipInNetwork
            Its ship.
        """
        v_dc_n, grid = ship.bus(self.bus).v_n, ship.bus(self.grid)
        lowest, chosen = lowest_full_load_voltage(ship, self.bus), self.resolved()
        loads = {load.power_factor for load in ship.items("ac_load").values() if load.bus == self.grid}
        rows = []
        for power_factor in sorted({1.0, *loads}, reverse=True):

            def most(item: Inverter, v_dc: float, power_factor: float = power_factor) -> LoadedInverter:
                return item.end(v_dc, grid.v_n, grid.f_n, power_factor)

            ends = [(v_dc, most(chosen, v_dc)) for v_dc in (v_dc_n, lowest)]
            carries = tuple((v_dc, end.s * self.rating, f"by {ENDS[end.ended_by]}") for v_dc, end in ends)
            row = Rated(self.rating, "VA", f"power factor {power_factor:g}", carries)
            if row.short:

                def enough(L_1: float, most: Any = most) -> bool:
                    return most(dataclasses.replace(chosen, L_1=L_1), lowest).s >= 1.0

                L_1 = largest_choke(enough, chosen.L_1)
                needs = "no smaller one carries the rating"
                if L_1 is not None:
                    needs = f"up to {L_1:g} pu carry the rating, with gains found for them"
                row = row._replace(remedy=f"L_1 is {chosen.L_1:g} pu; {needs}")
            rows.append(row)
        return tuple(rows)

    def resonances(self, net: Network, ship: Any) -> tuple[Resonance, ...]:
        """Where its filter resonates on a stiff bar.

        Parameters
        ----------
        net : Network
            The plant it is built into.
        ship : ShipInNetwork
            Its ship.
        """
        grid = ship.bus(self.grid)
        f_res = self.resolved().lcl(grid.v_n, grid.f_n).f_res
        return (Resonance(f_res, *resonance_band(grid.f_n, self.f_sw), "a stiff voltage"),)

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Place bridge, filter, control, sequence and meter, and publish."""
        bus, grid = ship.bus(self.bus), ship.bus(self.grid)
        chosen = self.resolved()
        lcl = chosen.lcl(grid.v_n, grid.f_n)
        control = dataclasses.replace(
            chosen.control,
            S_n=self.rating,
            v_n=grid.v_n,
            f_n=grid.f_n,
            L_1=chosen.L_1,
            C=self.C,
            R_d=lcl.R_d * self.rating / grid.v_n**2,
        )
        net.capacitance(bus, self.C_dc)
        clock = Sampled(self.f_sw)
        enable = f"{name}.sequence.enable"
        bridge = add_bridge(net, name, bus, control=f"{name}.control", gates=enable, clock=clock, f_sw=self.f_sw)
        net.add_three_phase(
            f"{name}.filter", lcl, ports={"converter": bridge, "grid": grid}, variant=f"{name}.sequence.position"
        )
        voltage = add_filter_voltage(net, f"{name}.filter", lcl, Every(AC_CONTROL_PERIOD))
        axes = dict(zip(("alpha", "beta"), grid.nodes, strict=True))
        v_bar = {f"v_{axis}": node for axis, node in axes.items()}

        def filter_state(field: str, symbol: str) -> dict[str, str]:
            return {f"{field}_{axis}": f"{name}.filter.{axis}.{symbol}" for axis in axes}

        net.add(
            f"{name}.control",
            control,
            inputs=filter_state("v_c", "v_c")
            | filter_state("i_1", "i_1")
            | filter_state("i_g", "i_2")
            | {"v_dc": bus.nodes[0], "enable": enable}
            | {"v_ref": f"{name}.sequence.v_ref", "p_ref": f"{name}.sequence.p_ref"}
            | {"dw_join": f"{name}.synchroniser.dw_sync", "dV_join": f"{name}.synchroniser.dV_sync"}
            | trims_of(self.grid, ship),
            clock=clock,
        )
        net.add(
            f"{name}.sequence",
            InverterSequence(v_n=grid.v_n),
            inputs=v_bar
            | {"on": net.command(f"{name}.on"), "v_dc": bus.nodes[0]}
            | {"v_set": f"{name}.control.v_set", "p": f"{name}.control.p", "q": f"{name}.control.q"}
            | {"in_step": f"{name}.synchroniser.closed", "no_step": f"{name}.synchroniser.refused"},
            clock=Every(10e-3),
        )
        net.add(
            f"{name}.synchroniser",
            AcTie(v_n=grid.v_n, S_n=self.rating),
            inputs={f"from_{axis}": node for axis, node in axes.items()}
            | {f"to_{axis}": path for axis, path in voltage.items()}
            | filter_state("i", "i_2")
            | {"close": f"{name}.sequence.join"},
            clock=Every(AC_CONTROL_PERIOD),
        )
        net.add(
            f"{name}.meter",
            InverterMeter(),
            inputs=v_bar | filter_state("i_2", "i_2"),
        )
        sources = {"p_ac": "meter", "q_ac": "meter", "p_dc": "bridge", "f": "control", "on": "sequence"}
        for signal_ in Inverter.__equipment__.signals:  # type: ignore[attr-defined]
            source = f"{name}.{sources[signal_.name]}.{signal_.name}"
            net.publish(f"{name}.{signal_.name}", source=source, unit=signal_.unit, description=signal_.description)
        for stem, field, unit, text in (
            ("i", "i_1", "A", "current of the bridge, from bridge to bar"),
            ("i_g", "i_2", "A", "current of the transformer, from bridge to bar"),
            ("v_c", "v_c", "V", "voltage of the filter's capacitor"),
        ):
            alpha, beta = (f"{name}.filter.{axis}.{field}" for axis in axes)
            net.publish_phases(f"{name}.{stem}", alpha=alpha, beta=beta, unit=unit, description=text, carrier=self.f_sw)
        publish_bridge_voltage(net, name, f"{name}.filter", self.f_sw)
        net.watch_state(name, f"{name}.sequence.state", STATES)
        net.watch_refusal(name, f"{name}.sequence.refused", REFUSALS)

    def resolved(self) -> Inverter:
        """The same inverter with the values of its filter preset in place of those left at their defaults."""
        plain = GridForming()
        preset = PRESETS[self.filter]
        gains = {
            symbol: value
            for symbol, value in preset.items()
            if symbol != "L_1" and getattr(self.control, symbol) == getattr(plain, symbol)
        }
        L_1 = preset["L_1"] if self.L_1 == plain.L_1 else self.L_1
        return dataclasses.replace(self, L_1=L_1, control=dataclasses.replace(self.control, **gains))
