"""What `shipgrid parts` says: the parts of a plant, the lines between them, and what error the cut introduces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shipgrid.assembly.partition import Partition
from shipgrid.cli.listing import table
from shipgrid.scenarios.against_reference import Deviation

WORST = 10
"""Signals that are shown besides the voltages of the buses."""


def show_parts(partition: Partition, step: float) -> None:
    """Print parts and lines of a plant at a step [s]."""
    rows = [
        (name, ", ".join(buses), str(len(part.placed)), str(len(part.foreign)))
        for (name, buses), part in zip(partition.buses.items(), partition.parts, strict=True)
    ]
    table("Parts", ("part", "buses", "components", "signals it reads of others"), rows)
    show_lines(partition, step)


def show_lines(partition: Partition, step: float, *, stderr: bool = False) -> None:
    """Print the stub lines between the parts of a plant at a step [s]."""
    rows = [
        (line.path, " and ".join(line.parts), f"{1e6 * line.L:.4g} uH", f"{1e6 * line.C:.4g} uF", _share(line.share))
        for line in partition.lines
    ]
    heads = ("element", "between", "inductance", "surplus capacitance", "over that of its better end")
    table(f"Lines of a delay of {1e6 * step:g} us where the plant is cut", heads, rows, stderr=stderr)


def show_error(ship: Any, found: Sequence[Deviation], until: float) -> None:
    """Print how far a cut plant was from the whole one: the voltages of the buses, and the worst of all signals."""
    buses = [f"{name}.{bar.signals[0].name}" for name, bar in ship.buses.items()]
    shown = [d for d in found if d.signal in buses]
    shown += [d for d in found if d.signal not in buses][:WORST]
    rows = [
        (d.signal, d.unit, f"{d.largest:.3g}", f"{d.at:.6g}", f"{d.rms:.3g}", f"{d.size:.4g}", f"{d.relative:.1e}")
        for d in shown
    ]
    heads = ("signal", "unit", "largest difference", "at, s", "rms", "largest of its unit", "relative")
    table(f"Cut minus whole, {until:g} s: bus voltages, and the worst signals", heads, rows)


def _share(share: float) -> str:
    return f"{100.0 * share:.3g} %" if share < 1e6 else "there is none"
