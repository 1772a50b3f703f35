"""Diesel genset: engine, governor, generator, exciter, the loads at its own terminals, and how it starts and stops.

    off -> cranking -> running up -> exciting -> on -> unloading -> cooling down -> running down -> off

The starter turns the engine until it fires; the governor takes it to its speed along a ramp; the regulator builds the
voltage up along another. Then the rectifier fed from it may connect (`ready`). Told to stop, it asks the rectifier to
unload and open (`stop`) and waits until it has; it cools down without load, the fuel is cut, and friction stops it.
A start command finds its way from wherever the sequence is.

The local load is a resistance at the terminals and counts in the genset's own measured power.
"""

from __future__ import annotations

import dataclasses
import math

from shipgrid.components.mechanical.diesel_engine import DieselEngine
from shipgrid.components.sources.synchronous_generator import SynchronousGenerator, derive
from shipgrid.controllers.blocks.ramp import ramp
from shipgrid.controllers.exciter_ac1a import Ac1a
from shipgrid.controllers.governor_degov1 import Degov1
from shipgrid.equipment.declaration import EQUIPMENT, Command, Published, block, equipment, refuse_other, switch
from shipgrid.errors import TopologyError
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute
from shipgrid.model.placed import Delayed, Every
from shipgrid.units import Hertz, PerUnit, PerUnitPerSecond, Ratio, Second, Volt, Watt

OFF, CRANKING, RUNNING_UP, EXCITING, ON, UNLOADING, COOLING, RUNNING_DOWN = range(8)
STATES = {
    OFF: "off",
    CRANKING: "cranking",
    RUNNING_UP: "running up",
    EXCITING: "building up voltage",
    ON: "on",
    UNLOADING: "unloading",
    COOLING: "cooling down",
    RUNNING_DOWN: "running down",
}
NOT_FIRED, NOT_AT_SPEED, NO_VOLTAGE = 1, 2, 3
REFUSALS = {
    NOT_FIRED: "the engine did not fire",
    NOT_AT_SPEED: "the engine did not reach its speed",
    NO_VOLTAGE: "the voltage did not build up",
}
CONTROL_PERIOD = 0.5e-3
"""Clock of governor, engine and exciter [s]: an eighteenth of their shortest time constant (9 ms, the actuator's)."""
SEQUENCE_PERIOD = 10e-3
"""Clock of the sequence [s]: a switchboard's relay logic."""


class State:
    state: Ratio = signal("state of the sequence, code")
    refused: Ratio = signal("why the start command is refused, code, 0 is not")
    timer: Second = signal("time in this state")
    steady: Second = signal("time inside the band this state waits for")
    omega_ref: PerUnit = signal("speed reference along its ramp")
    v_t_ref: PerUnit = signal("voltage reference along its ramp")


class Input:
    on: Ratio = signal("command: run")
    speed_ref: PerUnit = signal("command: speed at no load")
    v_ref: PerUnit = signal("command: terminal voltage")
    omega: PerUnit = signal("shaft speed")
    v_t: PerUnit = signal("terminal voltage")
    rectifier_connected: Ratio = signal("1 while the rectifier's contactor is closed", initial=0.0)


class Output:
    crank: Ratio = signal("1 while the starter is engaged")
    fuel: Ratio = signal("1 while fuel is admitted")
    excite: Ratio = signal("1 while the regulator is excited")
    ready: Ratio = signal("1 while the rectifier may connect and stay connected")
    stop: Ratio = signal("1 while the rectifier is asked to unload and open")
    on: Ratio = signal("1 from ready to unloaded")


@kernel
def flag(condition):
    """1.0 or 0.0."""
    return 1.0 if condition else 0.0


@kernel
def update(t, dt, x: State, u: Input, p: GensetSequence, x_next: State, y: Output):
    start, connected = u.on.real > 0.5, u.rectifier_connected.real > 0.5
    timer = x.timer.real + dt
    refused = int(x.refused.real) if start else 0
    state = was = int(x.state.real)
    at_speed = absolute(u.omega - u.speed_ref).real < p.band.real and x.omega_ref.real == u.speed_ref.real
    at_voltage = absolute(u.v_t - u.v_ref).real < p.band.real and x.v_t_ref.real == u.v_ref.real
    waits_for = at_speed if was == RUNNING_UP else at_voltage
    steady = x.steady.real + dt if waits_for else 0.0

    if was == OFF:
        if start and refused == 0:
            state = CRANKING
    elif was == CRANKING:
        if not start:
            state = RUNNING_DOWN
        elif u.omega.real >= p.omega_fire.real:
            state = RUNNING_UP
        elif timer > p.patience.real:
            refused, state = NOT_FIRED, RUNNING_DOWN
    elif was in (RUNNING_UP, EXCITING):
        if not start:
            state = RUNNING_DOWN if was == RUNNING_UP else COOLING
        elif steady >= p.settling.real:
            state = EXCITING if was == RUNNING_UP else ON
        elif timer > p.patience.real:
            refused, state = NOT_AT_SPEED if was == RUNNING_UP else NO_VOLTAGE, RUNNING_DOWN
    elif was == ON:
        if not start:
            state = UNLOADING
    elif was == UNLOADING:
        if start:
            state = ON
        elif not connected:
            state = COOLING
    elif was == COOLING:
        if connected:  # it closed in the instant in which `ready` fell
            state = UNLOADING
        elif start:
            state = EXCITING
        elif timer > p.cool_down.real:
            state = RUNNING_DOWN
    elif start and refused == 0 and u.omega.real >= p.omega_fire.real:
        state = RUNNING_UP
    elif u.omega.real < p.omega_stopped.real:
        state = OFF

    fuelled, excited = RUNNING_UP <= state <= COOLING, EXCITING <= state <= COOLING
    x_next.state = float(state)
    x_next.refused = float(refused)
    x_next.timer = timer if state == was else 0.0
    x_next.steady = steady if state == was else 0.0
    x_next.omega_ref = ramp(u.speed_ref, x.omega_ref, p.speed_rate, dt) if fuelled else u.omega
    x_next.v_t_ref = ramp(u.v_ref, x.v_t_ref, p.v_rate, dt) if excited else u.v_t
    y.crank = flag(state == CRANKING)
    y.fuel = flag(fuelled)
    y.excite = flag(excited)
    y.ready = flag(state in (ON, UNLOADING))
    y.stop = flag(state in (UNLOADING, COOLING))
    y.on = y.ready


@component(state=State, input=Input, output=Output, update=update, stage="supervise")
class GensetSequence:
    """Start and stop of a genset."""

    omega_fire: PerUnit = param("speed at which the engine fires", default=0.2, above=0.0, source="typical: 360 rpm")
    omega_stopped: PerUnit = param("speed taken as standstill", default=0.005, above=0.0, source="typical: 9 rpm")
    speed_rate: PerUnitPerSecond = param(
        "rate of the speed reference", default=0.25, above=0.0, source="typical: from firing to rated speed in 3 s"
    )
    v_rate: PerUnitPerSecond = param(
        "rate of the voltage reference",
        default=0.5,
        above=0.0,
        source="typical: soft start of a digital regulator, 2 s",
    )
    band: PerUnit = param(
        "distance from the reference taken as reached",
        default=0.02,
        above=0.0,
        source="typical; above the regulator's 0.003 pu and the droop at the local load, 0.004 pu",
    )
    settling: Second = param("time inside the band", default=0.5, at_least=0.0, source="typical")
    patience: Second = param("longest time in a state of the start", default=20.0, above=0.0, source="typical")
    cool_down: Second = param(
        "run without load before the stop", default=30.0, at_least=0.0, source="typical; after full load, minutes"
    )


@equipment(
    "genset",
    commands=(
        switch("on", "run the genset", refusals=REFUSALS),
        Command("speed_ref", "pu", "speed at no load", 0.95, 1.05, 1.0),
        Command("v_ref", "pu", "terminal voltage", 0.9, 1.1, 1.0),
    ),
    signals=(
        Published("p_ac", "W", "active power at the stator terminals, local load included"),
        Published("q_ac", "var", "reactive power at the stator terminals, local load included"),
        Published("v_rms", "V", "terminal voltage, line to line"),
        Published("omega_pu", "1", "speed over synchronous speed"),
        Published("v_pu", "1", "terminal voltage over rated voltage"),
        Published("p_pu", "1", "active power over the rating"),
        Published("on", "1", "1 while the genset may be loaded"),
    ),
    states=STATES,
)
class Genset:
    """Diesel genset with governor, exciter and local load; per-unit values on its rating."""

    rating: Watt = param("rated power, at power factor 1", default=596e3, above=0.0, source="[DAgostino2020] table A1")
    v_n: Volt = param("rated voltage, line to line", default=480.0, above=0.0, source="[DAgostino2020] table A1")
    f_n: Hertz = param("nominal frequency", default=60.0, above=0.0, source="[DAgostino2020] table A1")
    inertia_H: Second = param(
        "inertia constant H", default=0.17, above=0.0, source="[DAgostino2020] table A1, read as H"
    )
    local_load: PerUnit = param(
        "resistive load at the terminals, at rated voltage", default=0.08, at_least=0.0, source="[DAgostino2020] fig. 9"
    )
    governor: Degov1 = block(Degov1)
    engine: DieselEngine = block(DieselEngine)
    exciter: Ac1a = block(Ac1a)
    machine: SynchronousGenerator = block(SynchronousGenerator)
    sequence: GensetSequence = block(GensetSequence)

    def check(self) -> None:
        """Refuse a machine block that says the rating again, or differently, and reactances out of order."""
        refuse_other(self, "machine", (("S_n", "rating"), ("v_n", "v_n"), ("f_n", "f_n"), ("H", "inertia_H")))
        derive(self.machine)

    @property
    def subtransient_inductance(self) -> float:
        """Inductance [H] that its machine shows to fast changes: the mean of both axes' subtransient reactances."""
        z = self.v_n**2 / self.rating
        return 0.5 * (self.machine.X_d2 + self.machine.X_q2) * z / (2.0 * math.pi * self.f_n)

    def build(self, net, name, ship):
        """Wire the genset; its terminals are the AC bus `<name>.terminals`."""
        terminals = net.ac_bus(f"{name}.terminals", self.v_n, self.f_n)
        net.conductance(terminals, self.local_load * self.rating / self.v_n**2, consumer=f"{name}.local_load")
        machine = dataclasses.replace(self.machine, S_n=self.rating, v_n=self.v_n, f_n=self.f_n, H=self.inertia_H)
        net.add_three_phase(
            f"{name}.machine",
            machine,
            ports={"stator": terminals},
            inputs={"E_fd": f"{name}.exciter.E_fd", "T_m": f"{name}.engine.T_m"},
        )
        net.add(
            f"{name}.engine",
            self.engine,
            inputs={
                "throttle": f"{name}.governor.throttle",
                "omega": f"{name}.machine.omega",
                "fuel": f"{name}.sequence.fuel",
                "crank": f"{name}.sequence.crank",
            },
            clock=Every(CONTROL_PERIOD),
        )
        net.add(
            f"{name}.governor",
            self.governor,
            inputs={
                "omega": f"{name}.machine.omega",
                "omega_ref": f"{name}.sequence.omega_ref",
                "p_e": f"{name}.machine.p_pu",
                "fuel": f"{name}.sequence.fuel",
            },
            clock=Every(CONTROL_PERIOD),
        )
        net.add(
            f"{name}.exciter",
            self.exciter,
            inputs={
                "v_t": f"{name}.machine.v_t",
                "v_ref": f"{name}.sequence.v_t_ref",
                "i_fd": f"{name}.machine.i_fd",
                "on": f"{name}.sequence.excite",
            },
            clock=Every(CONTROL_PERIOD),
        )
        sequence = {
            "on": net.command(f"{name}.on"),
            "speed_ref": net.command(f"{name}.speed_ref"),
            "v_ref": net.command(f"{name}.v_ref"),
            "omega": f"{name}.machine.omega",
            "v_t": f"{name}.machine.v_t",
        }
        rectifiers = [other for other, item in ship.items("rectifier").items() if item.source == name]
        if len(rectifiers) > 1:
            raise TopologyError(f"{name} feeds {' and '.join(rectifiers)}, expected one rectifier")
        if rectifiers:
            sequence["rectifier_connected"] = Delayed(f"{rectifiers[0]}.sequence.connected")
        net.add(f"{name}.sequence", self.sequence, inputs=sequence, clock=Every(SEQUENCE_PERIOD))

        sources = {"omega_pu": "machine.omega", "v_pu": "machine.v_t", "on": "sequence.on"}
        for s in EQUIPMENT["genset"].signals:
            source = f"{name}.{sources.get(s.name, f'machine.{s.name}')}"
            net.publish(f"{name}.{s.name}", source=source, unit=s.unit, description=s.description, group=s.group)
        v_alpha, v_beta = terminals.nodes
        text = "voltage of the terminals to the star point"
        net.publish_phases(f"{name}.v", alpha=v_alpha, beta=v_beta, unit="V", description=text)
        axes = {axis: f"{name}.machine.i_{axis}" for axis in ("alpha", "beta")}
        text = "current of the stator, out of the machine"
        net.publish_phases(f"{name}.i", **axes, unit="A", description=text, sign=-1.0)
        net.watch_state(name, f"{name}.sequence.state", states=STATES)
        net.watch_refusal(name, f"{name}.sequence.refused", reasons=REFUSALS)
