"""Motor of a pump or fan on an AC bar, switched direct on line by its contactor.

'On' closes the contactor at once: the motor starts with several times its rated current, which its bar has to stand.
'Off' opens it, each pole at the zero of its current; the motor runs out on its pump.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from shipgrid.components.electrical.three_pole_breaker import ThreePoleBreaker
from shipgrid.components.machines.induction_motor import InductionMotor
from shipgrid.equipment.declaration import Published, block, equipment, reference, refuse_other, switch
from shipgrid.model import param
from shipgrid.model.network import Network
from shipgrid.units import Ohm, Watt

SIGNALS = (
    Published("p_ac", "W", "active power taken, three phases"),
    Published("q_ac", "var", "reactive power taken, three phases"),
    Published("i_rms", "A", "current of a phase, rms"),
    Published("omega", "pu", "speed, 1 is synchronous at nominal frequency"),
)


@equipment("ac_motor", commands=(switch("on", "close the contactor"),), signals=SIGNALS)
class AcMotor:
    """Squirrel-cage motor with its pump or fan, behind a contactor."""

    bus: str = reference("bar that feeds it", "ac")
    p: Watt = param("rated shaft power", default=5e3, above=0.0, source="a small pump")
    R_on: Ohm = param("resistance of a closed contact", default=1e-3, at_least=1e-6, source="typical")
    machine: InductionMotor = block(InductionMotor)

    def check(self) -> None:
        """Refuse a machine block that says differently what the item or its bar says."""
        refuse_other(self, "machine", (("p_n", "p"), ("v_n", "bus"), ("f_n", "bus")))

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Place contactor and motor, and publish."""
        bar = ship.bus(self.bus)
        terminals = net.ac_bus(f"{name}.terminals", bar.v_n, bar.f_n)
        close = {"close": net.command(f"{name}.on")}
        net.add(f"{name}.contactor", ThreePoleBreaker(R_on=self.R_on), a=bar, b=terminals, inputs=close)
        machine = dataclasses.replace(self.machine, p_n=self.p, v_n=bar.v_n, f_n=bar.f_n)
        net.add(f"{name}.machine", machine, a=terminals)
        alpha, beta = f"{name}.machine.i_alpha", f"{name}.machine.i_beta"
        net.publish_phases(f"{name}.i", alpha=alpha, beta=beta, unit="A", description="current of the motor")
        for signal in SIGNALS:
            source = f"{name}.machine.{signal.name}"
            net.publish(f"{name}.{signal.name}", source=source, unit=signal.unit, description=signal.description)
