"""AC load of an AC bar: hotel services as a constant impedance."""

from __future__ import annotations

from typing import Any

from shipgrid.components.electrical.load import Load
from shipgrid.equipment.declaration import Published, equipment, reference
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.network import Network
from shipgrid.units import Ampere, Ratio, Volt, Watt


class MeterInput:
    """Input of the wattmeter."""

    v_alpha: Volt = signal("bar voltage, alpha axis")
    v_beta: Volt = signal("bar voltage, beta axis")
    i_alpha: Ampere = signal("current into the load, alpha axis")
    i_beta: Ampere = signal("current into the load, beta axis")


class MeterOutput:
    """Output of the wattmeter."""

    p_ac: Watt = signal("power taken")


@kernel
def outputs(t, u: MeterInput, y: MeterOutput):
    y.p_ac = 1.5 * (u.v_alpha * u.i_alpha + u.v_beta * u.i_beta)


@component(input=MeterInput, output=MeterOutput, outputs=outputs, stage="measure")
class LoadMeter:
    """Wattmeter of a three-wire load."""


@equipment("ac_load", signals=(Published("p_ac", "W", "active power taken, three phases"),))
class AcLoad:
    """Three-phase load of constant impedance, series R-L, at the bar's nominal voltage and frequency."""

    bus: str = reference("bar that feeds it", "ac")
    p: Watt = param("active power at nominal voltage", default=10e3, above=0.0, source="typical hotel load of a bar")
    power_factor: Ratio = param("cos phi, lagging", default=0.9, above=0.0, at_most=0.999, source="typical")

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Place the load and its wattmeter."""
        bus = ship.bus(self.bus)
        load = Load(p_0=self.p, power_factor=self.power_factor, v_n=bus.v_n, f_n=bus.f_n)
        net.add_three_phase(f"{name}.load", load, ports={"supply": bus})
        v_alpha, v_beta = bus.nodes
        currents = {"i_alpha": f"{name}.load.alpha.i", "i_beta": f"{name}.load.beta.i"}
        net.add(f"{name}.meter", LoadMeter(), inputs={"v_alpha": v_alpha, "v_beta": v_beta} | currents)
        alpha, beta = currents["i_alpha"], currents["i_beta"]
        net.publish_phases(f"{name}.i", alpha=alpha, beta=beta, unit="A", description="current of the load")
        net.publish(f"{name}.p_ac", source=f"{name}.meter.p_ac", unit="W", description="active power taken")
