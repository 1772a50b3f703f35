"""Propulsion: motor and drive on a DC bus, shaft, screw, and the cruise control above them.

Sequence (`state`): 0 off, gates blocked; 1 ramping up: gates released, the torque limit rises to full in `t_ramp`; 2
on; 3 ramping down: the torque limit falls to zero in `t_ramp`, then the gates block. A speed reference of zero is not
off: the drive stays on and holds the ship. Switching on is refused while the bus is below `v_on` (torque would be
reduced), and a bus below `v_trip` blocks the gates at once; the drive comes back by itself when the bus has recovered
and the command still stands.

Off in a moving ship, the screw turns freely in the stream. While its back-emf stays below the bus voltage (up to
635 V line-to-line peak at rated speed) no diode conducts and it feeds nothing.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from shipgrid.components.converters.two_level_bridge import TwoLevelBridge
from shipgrid.components.machines.pmsm import Pmsm
from shipgrid.components.marine.propeller import Propeller
from shipgrid.components.mechanical.shaft import Shaft
from shipgrid.controllers.drive_current import DriveCurrent
from shipgrid.controllers.motor_speed import MotorSpeed
from shipgrid.controllers.ship_speed import ShipSpeed
from shipgrid.equipment.declaration import Command, Published, as_in, block, choice, equipment, reference, switch
from shipgrid.equipment.hull import T_MARINE
from shipgrid.equipment.wiring import publish_switching
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.network import Network
from shipgrid.model.ops import clip
from shipgrid.model.placed import Delayed, Every
from shipgrid.modulators.averaged import DirectBridge
from shipgrid.modulators.hysteresis import HysteresisBridge
from shipgrid.units import Ampere, Farad, KilogramMetre2, Ohm, RadianPerSecond, Ratio, Second, Volt, Watt, rpm

OFF, RAMP_UP, ON, RAMP_DOWN = 0.0, 1.0, 2.0, 3.0
STATES = {0: "off", 1: "ramping up", 2: "on", 3: "ramping down"}
REFUSALS = {1: "the DC bus voltage is too low"}
SPEED_MAX = 6.5
"""Largest speed that can be commanded [m/s]: 12.6 kn, beyond what the motors can drive the ferry to."""


class State:
    state: Ratio = signal("0 off, 1 ramping up, 2 on, 3 ramping down")
    share: Ratio = signal("part of the torque limit granted")


class Input:
    on: Ratio = signal("command: on")
    v_dc: Volt = signal("bus voltage at the drive")


class Output:
    blocked: Ratio = signal("1 while the gates are blocked", initial=1.0)
    enabled: Ratio = signal("1 while the gates are released")
    refused: Ratio = signal("why the command is refused, 0 if it is not")


@kernel
def update(dt, x: State, u: Input, p: PropulsionSequence, x_next: State, y: Output):
    on = u.on.real > 0.5
    state = x.state.real
    y.refused = 1.0 if on and state == OFF and u.v_dc.real < p.v_on.real else 0.0
    if u.v_dc.real < p.v_trip.real:
        state = OFF
    elif (on and state == OFF and u.v_dc.real >= p.v_on.real) or (on and state == RAMP_DOWN):
        state = RAMP_UP
    elif not on and state in (RAMP_UP, ON):
        state = RAMP_DOWN
    rising = state in (RAMP_UP, ON)
    share = clip(x.share + (dt if rising else -dt) / p.t_ramp, 0.0, 1.0)
    if state == OFF:
        share = 0.0 * share
    elif state == RAMP_UP and share.real >= 1.0:
        state = ON
    elif state == RAMP_DOWN and share.real <= 0.0 and x.share.real <= 0.0:  # a period later: the current has gone
        state = OFF
    x_next.state = state
    x_next.share = share
    y.blocked = 1.0 if state == OFF else 0.0
    y.enabled = 1.0 - y.blocked


@component(state=State, input=Input, output=Output, stage="supervise", update=update)
class PropulsionSequence:
    """On and off of a propulsion drive."""

    t_ramp: Second = param("time of the torque ramps", default=1.0, above=0.0, source="chosen")
    v_on: Volt = param("least bus voltage to switch on", default=700.0, above=0.0, source="where torque is not reduced")
    v_trip: Volt = param(
        "bus voltage that blocks the gates", default=600.0, above=0.0, source="chosen: below zero torque at 660 V"
    )


@equipment(
    "propulsion",
    commands=(
        switch("on", "drive on (gates released)", moored=True, refusals=REFUSALS),
        Command(
            "speed_ref",
            "m/s",
            "ship speed for the cruise control, positive ahead",
            -SPEED_MAX,
            SPEED_MAX,
            0.0,
            moored=0.0,
        ),
    ),
    signals=(
        Published("omega_m", "rad/s", "shaft speed"),
        Published("tau_e", "N m", "air-gap torque of the motor"),
        Published("i_q", "A", "quadrature-axis current of the motor (peak)"),
        Published("p_dc", "W", "power the drive takes from the DC bus"),
    ),
    states=STATES,
)
class Propulsion:
    """A propulsion line: by default 270 kW at 450 rpm on a 1.25 m screw."""

    bus: str = reference("DC bus that feeds the drive", "dc")
    propeller: str = dataclasses.field(
        metadata={"name": True, "description": "name under which the screw's signals are published"}
    )
    rating: Watt = param("rated power of the motor", default=270e3, above=0.0, source="[DAgostino2020] table A1")
    speed_n: RadianPerSecond = param(
        "rated speed of the motor", default=rpm(450.0), above=0.0, source="[DAgostino2020] table A1"
    )
    C_dc: Farad = param(
        "capacitance of the drive's DC link", default=5e-3, above=0.0, source="typical for 270 kW at 750 V"
    )
    R_on: Ohm = param("resistance of a closed switch", default=2e-3, at_least=0.0, source="docs/theory/propulsion.md")
    tau_c: Second = param(
        "time constant of the current control", default=1e-3, above=0.0, source="docs/theory/propulsion.md"
    )
    band: Ampere = as_in(HysteresisBridge, "band")
    inertia: KilogramMetre2 = param(
        "inertia of motor, shaft and screw", default=383.4, above=0.0, source="[DAgostino2020] table A1"
    )
    shaft_efficiency: Ratio = param(
        "shaft efficiency", default=0.98, above=0.0, at_most=1.0, source="[DAgostino2020] table A1"
    )
    ends: str = choice(
        "mirrored: one diagram for both ends and directions, against the flow half of a pair that faces outwards; "
        "fixed_pitch_outwards: the tested screw in its own axes, see faces: for ordinary screws, which face aft, too",
        "mirrored",
        "fixed_pitch_outwards",
        default="mirrored",
    )
    faces: str = choice("which way a screw in its own axes faces", "aft", "fore", default="aft")
    motor: Pmsm = block(Pmsm)
    screw: Propeller = block(Propeller)
    speed: MotorSpeed = block(MotorSpeed)
    cruise: ShipSpeed = block(ShipSpeed)
    sequence: PropulsionSequence = block(PropulsionSequence)

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Wire the line from bus to screw."""
        bus, v_dc = ship.bus(self.bus), f"{self.bus}.v_dc"
        net.capacitance(bus, self.C_dc)
        # a closed switch is always in series with each phase: its resistance is one with the winding's
        motor = dataclasses.replace(self.motor, R_s=self.motor.R_s + self.R_on)
        enabled, blocked = f"{name}.sequence.enabled", f"{name}.sequence.blocked"
        omega_m, omega_pu = f"{name}.shaft.omega_m", f"{name}.shaft.omega_pu"

        net.add(
            f"{name}.sequence",
            self.sequence,
            inputs={"on": net.command(f"{name}.on"), "v_dc": v_dc},
            clock=Every(10e-3),
        )
        cruise = {
            "speed_ref": net.command(f"{name}.speed_ref"),
            "omega_pu": omega_pu,
            "enabled": enabled,
            "all_torque": Delayed(f"{name}.speed.all_torque"),
        }
        water = {}
        if ship.hull is not None:
            cruise["u_ship"] = "hull.surge.u_ship"
            water = {"v_a": "hull.surge.v_a", "u_thrust": "hull.surge.u_thrust"}
        ring = list(ship.items("propulsion"))
        neighbour = ring[(ring.index(name) + 1) % len(ring)]
        if neighbour != name:
            cruise["i_neighbour"] = f"{neighbour}.cruise.speed.i"
            cruise["neighbour_enabled"] = f"{neighbour}.sequence.enabled"
        # as often as the ship moves: a coarser staircase of its reference would make steps of torque
        net.add(f"{name}.cruise", self.cruise, inputs=cruise, clock=Every(T_MARINE))
        net.add(
            f"{name}.speed",
            self.speed,
            inputs={
                "n_ref": f"{name}.cruise.n_ref",
                "omega_pu": omega_pu,
                "v_dc": v_dc,
                "enabled": enabled,
                "share": f"{name}.sequence.share",
            },
        )
        of_motor = {symbol: getattr(motor, symbol) for symbol in ("n_p", "psi_f", "L_d", "L_q")}
        net.add(
            f"{name}.drive",
            DriveCurrent(
                R=motor.R_s,
                **of_motor,
                tau_n=self.rating / self.speed_n,
                tau_c=self.tau_c,
            ),
            inputs={
                "tau_ref": f"{name}.speed.tau_ref",
                "i_d": f"{name}.motor.i_d",
                "i_q": f"{name}.motor.i_q",
                "theta_e": f"{name}.motor.theta_e",
                "omega_m": omega_m,
                "v_dc": v_dc,
                "blocked": blocked,
            },
        )
        if net.fidelity == "averaged":
            modulator, inputs = DirectBridge(), {s: f"{name}.drive.{s}" for s in ("s_alpha", "s_beta")}
        else:
            modulator = HysteresisBridge(band=self.band, R=motor.R_s, **of_motor)
            inputs = {field: f"{name}.motor.{field}" for field in ("i_d", "i_q", "theta_e")}
            inputs |= {"omega_m": omega_m, "v_dc": v_dc, "i_q_ref": f"{name}.drive.i_q_ref"}
        net.add(f"{name}.modulator", modulator, inputs={**inputs, "gates": enabled})
        net.add_three_phase(
            f"{name}.motor",
            motor,
            ports={"stator": net.bridge(f"{name}.bridge", TwoLevelBridge(), bus, modulator=f"{name}.modulator")},
            inputs={"omega_m": omega_m},
        )
        facing = 0.0 if self.ends == "mirrored" else (1.0 if self.faces == "aft" else -1.0)
        net.add(
            f"{name}.propeller",
            dataclasses.replace(self.screw, ends=facing),
            inputs={"omega_m": omega_m, **water},
            clock=Every(T_MARINE),
        )
        net.add(
            f"{name}.shaft",
            Shaft(J=self.inertia, eta_s=self.shaft_efficiency, omega_n=self.speed_n),
            inputs={"tau_e": f"{name}.motor.tau_e", "tau": f"{name}.propeller.tau"},
        )

        # what moves goes with its extremes; the advance ratio is a quotient that is anything near standstill
        drive, screw, ratio = "plant", "plant", "slow"
        for public, source, unit, text, group in (
            (f"{name}.omega_m", omega_m, "rad/s", "shaft speed", drive),
            (f"{name}.tau_e", f"{name}.motor.tau_e", "N m", "air-gap torque of the motor", drive),
            (f"{name}.i_q", f"{name}.motor.i_q", "A", "quadrature-axis current of the motor (peak)", drive),
            (f"{name}.p_dc", f"{name}.bridge.p_dc", "W", "power the drive takes from the DC bus", drive),
            (f"{self.propeller}.thrust", f"{name}.propeller.thrust", "N", "thrust of the screw, positive ahead", screw),
            (f"{self.propeller}.tau", f"{name}.propeller.tau", "N m", "torque the screw takes from the shaft", screw),
            (f"{self.propeller}.J_adv", f"{name}.propeller.J_adv", "1", "advance ratio of the screw", ratio),
        ):
            net.publish(public, source=source, unit=unit, description=text, group=group)
        alpha, beta = (f"{name}.motor.i_{axis}" for axis in ("alpha", "beta"))
        text = "current of the motor, from bridge to motor"
        net.publish_phases(f"{name}.i", alpha=alpha, beta=beta, unit="A", description=text)
        publish_switching(net, name)
        alpha, beta = (f"{name}.motor.v_{axis}" for axis in ("alpha", "beta"))
        text = "voltage of the bridge, mean of a step"
        net.publish_phases(f"{name}.v", alpha=alpha, beta=beta, unit="V", description=text, lines=True, mean=True)
        net.watch_state(name, f"{name}.sequence.state", states=STATES)
        net.watch_refusal(name, f"{name}.sequence.refused", reasons=REFUSALS)
