"""Parts of a plant item that every converter needs, wired once."""

from __future__ import annotations

from shipgrid.components.converters.two_level_bridge import HalfBridge, TwoLevelBridge
from shipgrid.model.network import DcBus, Every, Network, Pole, Pole3, Sampled
from shipgrid.modulators.averaged import AveragedBridge, AveragedLeg, DirectBridge


def add_bridge(
    net: Network, name: str, bus: DcBus, *, control: str, gates: str | float, clock: Every | Sampled | None
) -> Pole3:
    """Add a three-phase bridge `name.bridge` and its averaged modulator `name.modulator`.

    Parameters
    ----------
    net : Network
        The plant.
    name : str
        The item.
    bus : DcBus
    control : str
        Path of the controller with the outputs `s_alpha` and `s_beta`.
    gates : str or float
        Path of the signal that releases the gates; 1.0: they are always driven.
    clock : Every, Sampled or None
        The controller's clock; None: it acts at every step, without computation delay.

    Returns
    -------
    Pole3
        What the three-phase terminal behind it connects to.
    """
    suffix = "" if clock is None else "_ref"
    item = DirectBridge() if clock is None else AveragedBridge()
    inputs = {f"{s}{suffix}": f"{control}.{s}" for s in ("s_alpha", "s_beta")}
    net.add(f"{name}.modulator", item, inputs={**inputs, "gates": gates}, clock=clock)
    return net.bridge(f"{name}.bridge", TwoLevelBridge(), bus, modulator=f"{name}.modulator")


def add_leg(net: Network, name: str, bus: DcBus, *, control: str, gates: str | float, clock: Every | Sampled) -> Pole:
    """Add a half-bridge leg `name.leg` and its averaged modulator `name.modulator`; as `add_bridge`, of `control.s`."""
    net.add(f"{name}.modulator", AveragedLeg(), inputs={"s_ref": f"{control}.s", "gates": gates}, clock=clock)
    return net.half_bridge(f"{name}.leg", HalfBridge(), bus, modulator=f"{name}.modulator")
