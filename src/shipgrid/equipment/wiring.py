"""Parts of a plant item that every converter needs, wired once."""

from __future__ import annotations

from shipgrid.model.network import Every, Network, Sampled
from shipgrid.modulators.averaged import AveragedBridge, AveragedLeg


def add_modulator(net: Network, path: str, *, kind: str, source: str, clock: Every | Sampled) -> None:
    """Add the averaged modulator of a converter (`modulators/averaged.py`) between its controller and its poles.

    Parameters
    ----------
    net : Network
        The plant.
    path : str
        Name of the modulator; provides `path.s_alpha` and `path.s_beta`, or `path.s`.
    kind : {"bridge", "leg"}
        Three-phase bridge, or half-bridge leg.
    source : str
        Path of the controller with the outputs of those names.
    clock : Every or Sampled
        The controller's clock.
    """
    names = ("s_alpha", "s_beta") if kind == "bridge" else ("s",)
    item = AveragedBridge() if kind == "bridge" else AveragedLeg()
    net.add(path, item, inputs={f"{name}_ref": f"{source}.{name}" for name in names}, clock=clock)
