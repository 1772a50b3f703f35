"""AC load of an AC bar: hotel services as a constant impedance, or with a power that follows the voltage."""

from __future__ import annotations

import dataclasses
from typing import Any

from shipgrid.components.electrical.load import Load
from shipgrid.components.electrical.voltage_dependent_load import VoltageDependentLoad
from shipgrid.equipment.declaration import Published, block, choice, equipment, reference, refuse_other
from shipgrid.errors import ParameterError
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
    """Three-phase load by its power at the bar's nominal voltage: a series R-L, or ZIP, exponential, constant power."""

    bus: str = reference("bar that feeds it", "ac")
    p: Watt = param("active power at nominal voltage", default=10e3, above=0.0, source="typical hotel load of a bar")
    power_factor: Ratio = param("cos phi, lagging", default=0.9, above=0.0, at_most=0.999, source="typical")
    model: str = choice(
        "series R-L of constant impedance, or power by voltage as `dependence` says (constant power, if nothing)",
        *("impedance", "voltage_dependent"),
        default="impedance",
    )
    dependence: VoltageDependentLoad = block(VoltageDependentLoad)

    def check(self) -> None:
        """Refuse a dependence that says the load's nominal values differently, or that nothing would read."""
        refuse_other(self, "dependence", (("p_0", "p"), ("power_factor", "power_factor"), ("v_n", "bus")))
        for name in VoltageDependentLoad.__dataclass_fields__ if self.model == "impedance" else ():
            said = getattr(self.dependence, name)
            if said != getattr(VoltageDependentLoad, name):
                what = "is read only with `model: voltage_dependent`"
                raise ParameterError(f"ac_load.dependence.{name} = {said:g} {what}")

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Place the load and its wattmeter."""
        bus = ship.bus(self.bus)
        if self.model == "impedance":
            load = Load(p_0=self.p, power_factor=self.power_factor, v_n=bus.v_n, f_n=bus.f_n)
            currents = {f"i_{axis}": f"{name}.load.{axis}.i" for axis in ("alpha", "beta")}
        else:
            load = dataclasses.replace(self.dependence, p_0=self.p, power_factor=self.power_factor, v_n=bus.v_n)
            currents = {f"i_{axis}": f"{name}.load.i_{axis}" for axis in ("alpha", "beta")}
        net.add(f"{name}.load", load, a=bus)
        v_alpha, v_beta = bus.nodes
        net.add(f"{name}.meter", LoadMeter(), inputs={"v_alpha": v_alpha, "v_beta": v_beta} | currents)
        alpha, beta = currents.values()
        net.publish_phases(f"{name}.i", alpha=alpha, beta=beta, unit="A", description="current of the load")
        net.publish(f"{name}.p_ac", source=f"{name}.meter.p_ac", unit="W", description="active power taken")
