"""Parts of a plant item that every converter needs, wired once."""

from __future__ import annotations

from typing import Any

from shipgrid.components.converters.two_level_bridge import HalfBridge, TwoLevelBridge
from shipgrid.components.electrical.filter_voltage import FilterVoltage
from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.model.connections import DcBus, Pole, Pole3
from shipgrid.model.network import Network
from shipgrid.model.placed import Every, Sampled
from shipgrid.model.public_signals import Waveform
from shipgrid.modulators.averaged import AveragedBridge, AveragedLeg
from shipgrid.modulators.time_stamped import Carrier, TimeStampedBridge, TimeStampedLeg


def add_bridge(
    net: Network, name: str, bus: DcBus, *, control: str, gates: str | float, clock: Sampled, f_sw: float
) -> Pole3:
    """Add a three-phase bridge `name.bridge` and its modulator `name.modulator`.

    Parameters
    ----------
    net : Network
        The plant; its fidelity decides which modulator.
    name : str
        The item.
    bus : DcBus
    control : str
        Path of the controller with the outputs `s_alpha` and `s_beta`.
    gates : str or float
        Path of the signal that releases the gates; 1.0: they are always driven.
    clock : Sampled
        The controller's clock.
    f_sw : float
        Frequency of the carrier [Hz].

    Returns
    -------
    Pole3
        What the three-phase terminal behind it connects to.
    """
    inputs = {f"{s}_ref": f"{control}.{s}" for s in ("s_alpha", "s_beta")}
    item, carrier = _modulator(net, name, f_sw, AveragedBridge, TimeStampedBridge)
    net.add(f"{name}.modulator", item, inputs={**inputs, **carrier, "gates": gates}, clock=clock)
    return net.bridge(f"{name}.bridge", TwoLevelBridge(), bus, modulator=f"{name}.modulator")


def add_leg(
    net: Network, name: str, bus: DcBus, *, control: str, gates: str | float, clock: Sampled, f_sw: float
) -> Pole:
    """Add a half-bridge leg `name.leg` and its modulator `name.modulator`; as `add_bridge`, of `control.s`."""
    item, carrier = _modulator(net, name, f_sw, AveragedLeg, TimeStampedLeg)
    inputs = {"s_ref": f"{control}.s", **carrier, "gates": gates}
    net.add(f"{name}.modulator", item, inputs=inputs, clock=clock)
    return net.half_bridge(f"{name}.leg", HalfBridge(), bus, modulator=f"{name}.modulator")


def add_filter_voltage(net: Network, path: str, lcl: LclFilter, clock: Every) -> dict[str, str]:
    """Add the voltage transducer `path_voltage` of the LCL filter at `path`; the paths of its outputs, by axis.

    Its clock is that of its reader: what nobody looks at need not be computed.
    """
    states = {f"{x}_{axis}": f"{path}.{axis}.{x}" for x in ("v_c", "i_1", "i_2") for axis in ("alpha", "beta")}
    net.add(f"{path}_voltage", FilterVoltage(R_d=lcl.R_d), inputs=states, clock=clock)
    return {axis: f"{path}_voltage.v_{axis}" for axis in ("alpha", "beta")}


def publish_switching(net: Network, name: str, f_sw: float = 0.0) -> None:
    """Publish the switching functions of a bridge's legs as waveforms `name.s_a` ..., from its modulator."""
    for leg in "abc":
        bounds = tuple((f"{name}.modulator.{bound}_{leg}", 0.5) for bound in ("lo", "hi"))
        text = f"switching function of the upper switch of leg {leg}, mean of a step; 0.5 while its gates are blocked"
        net.publish_waveform(Waveform(f"{name}.s_{leg}", bounds, "1", text, mean=True, carrier=f_sw))


def publish_bridge_voltage(net: Network, name: str, lcl: str, f_sw: float) -> None:
    """Publish a bridge's line voltages, `name.v_ab` ..., from the LCL filter `lcl` behind it, and what its legs do."""
    publish_switching(net, name, f_sw)
    net.publish_phases(
        f"{name}.v",
        alpha=f"{lcl}.alpha.v_conv",
        beta=f"{lcl}.beta.v_conv",
        unit="V",
        description="voltage of the bridge, mean of a step",
        lines=True,
        mean=True,
        carrier=f_sw,
    )


def _modulator(net: Network, name: str, f_sw: float, averaged: type, switching: type) -> tuple[Any, dict[str, str]]:
    """The modulator that the plant's fidelity asks for, and the inputs that it has from its carrier."""
    if net.fidelity == "averaged":
        return averaged(), {}
    net.add(f"{name}.carrier", Carrier(), clock=Sampled(f_sw))
    return switching(), {field: f"{name}.carrier.{field}" for field in ("phase", "phase_next", "turns")}
