"""What `shipgrid explain` says: what the assembler makes of a ship, and how stiff it is against the step."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import typer

from shipgrid.assembly.partition import divide
from shipgrid.cli.parts import show_parts
from shipgrid.cli.table import table
from shipgrid.components.marine.hull import Hull
from shipgrid.components.marine.propeller import Propeller, characteristic, mismatch, stand_in
from shipgrid.components.marine.wind_and_waves import WindAndWaves
from shipgrid.equipment.capability import Rated, Resonance
from shipgrid.equipment.ship import ShipInNetwork
from shipgrid.io.report import si
from shipgrid.model.component import STAGES, type_of
from shipgrid.model.connections import AcBus
from shipgrid.model.network import Network
from shipgrid.model.placed import Every, Placed, Sampled
from shipgrid.model.records import parameter_record
from shipgrid.solvers.companion import state_space
from shipgrid.solvers.topology import islands
from shipgrid.units import KNOT

SORTS = {0.0: "mirrored", 1.0: "facing astern", -1.0: "facing ahead"}
"""Which way a screw faces, by `ends` of the propeller."""
AGAINST_THE_FLOW = np.radians([150.0])
"""An angle beta at which screws that stop a ship work; in the middle of where the sorts differ."""


def explain_ship(ship: Any, step: float) -> None:
    """Print buses, network elements, stages and time constants of a ship.

    Parameters
    ----------
    ship : Ship
    step : float
        Step [s].
    """
    network = Network(ship.name)
    ship.build(network)
    _buses(network)
    _elements(network, step)
    ties = tie_rows(network, step)
    heads = ("element", "between", "shortest time constant with them", f"{1e6 * step:g} us over it", "which is")
    table("Ties between capacitive buses", heads, ties)
    _islands(network)
    if ship.parts:
        show_parts(divide(network, ship.parts, step), step)
    _stages(network, step)
    _water(network)
    _converters(network, ShipInNetwork(ship, network))
    types = {type_of(placed.item).name for placed in network.placed.values()}
    typer.echo(
        f"{ship.name}: {len(network.placed)} components of {len(types)} types, "
        f"{sum(len(bus.nodes) for bus in network.buses.values())} nodes, {len(network.commands)} commands, "
        f"{len(network.published)} public signals"
    )


def _buses(network: Network) -> None:
    rows = []
    for name, bus in network.buses.items():
        farad, siemens = (values.get(bus.nodes[0], 0.0) for values in (network.capacitances, network.conductances))
        kind = f"ac {bus.f_n:g} Hz" if isinstance(bus, AcBus) else "dc"
        at = [p.path for p in network.placed.values() if any(_touches(binding, bus) for binding in p.ports.values())]
        shunt = f"{1.0 / siemens:g} ohm" if siemens else "none"
        rows.append((name, kind, f"{bus.v_n:g} V", f"{1e3 * farad:g} mF", shunt, ", ".join(at)))
    table("Buses", ("bus", "kind", "nominal", "capacitance, all merged", "shunt", "elements"), rows)


def _touches(binding: Any, bus: Any) -> bool:
    return binding.plus in bus.nodes or binding.minus in bus.nodes


def _islands(network: Network) -> None:
    """Buses that hang together: with all contacts closed, and with every element that has contacts taken out."""
    owner = {node: name for name, bus in network.buses.items() for node in bus.nodes}

    def joined(placed: Iterable[Placed]) -> list[tuple[str, str]]:
        pairs = []
        for item in placed:
            ends = sorted({owner[n] for b in item.ports.values() for n in (b.plus, b.minus) if n is not None})
            pairs += [(ends[0], other) for other in ends[1:]]
        return pairs

    fixed = [item for item in network.placed.values() if item.variant is None]
    rows = [
        (position, str(len(groups)), "; ".join(", ".join(sorted(group)) for group in groups))
        for position, groups in (
            ("all closed", islands(network.buses, joined(network.placed.values()))),
            ("all open", islands(network.buses, joined(fixed))),
        )
    ]
    table("Islands", ("contacts", "islands", "buses of each"), rows)


def _elements(network: Network, step: float) -> None:
    rows = []
    for placed in network.placed.values():
        kind = type_of(placed.item)
        if not kind.terminals:
            continue
        if kind.stamped:
            rows.append((placed.path, kind.name, "own stamp", "", ""))
            continue
        a = state_space(placed.item).A
        roots = np.linalg.eigvals(a) if a.size else np.zeros(0)
        fastest = float(np.max(np.abs(roots))) if len(roots) and np.max(np.abs(roots)) > 0.0 else 0.0
        constant = f"{1e6 / fastest:.3g} us" if fastest else ""
        ratio = f"{step * fastest:.3g}" if fastest else ""
        rows.append((placed.path, kind.name, f"{len(a)} states", constant, ratio))
    heads = ("element", "type", "solved as", "shortest time constant, terminals shorted", f"{1e6 * step:g} us over it")
    table("Network elements", heads, rows)


STIFF = 10.0
"""A tie whose time constant with the capacitances at its ends is below a tenth of the step settles within the step."""


def tie_rows(network: Network, step: float) -> list[tuple[str, str, str, str, str]]:
    """Elements between two buses with capacitance: how fast they equalise them, and what the solver makes of that.

    Nothing is merged but what lies in parallel at one bus: a tie keeps its current and its contact, and the rule takes
    one that is faster than a step (docs/decisions/0011-stiff-ties.md).

    Parameters
    ----------
    network : Network
    step : float
        Step [s].
    """
    rows = []
    for placed in network.placed.values():
        if not type_of(placed.item).linear or placed.path.endswith(".beta"):
            continue
        space = state_space(placed.item)
        for k, terminal in enumerate(type_of(placed.item).terminals):
            binding = placed.ports[terminal.name]
            ends = [network.capacitances.get(node or "", 0.0) for node in (binding.plus, binding.minus)]
            if min(ends) <= 0.0:
                continue
            series = ends[0] * ends[1] / (ends[0] + ends[1])
            row, column = -space.C[k : k + 1] / series, space.B[:, k : k + 1]
            roots = np.linalg.eigvals(np.block([[space.A, column], [row, -space.D[k : k + 1, k : k + 1] / series]]))
            fastest = float(np.max(np.abs(roots)))
            names = " and ".join(str(node).rpartition(".")[0] for node in (binding.plus, binding.minus))
            said = "solved; settles within a step, not merged" if step * fastest > STIFF else "solved, step by step"
            path = placed.path.removesuffix(".alpha")
            rows.append((path, names, f"{1e6 / fastest:.3g} us", f"{step * fastest:.3g}", said))
    return rows


def _stages(network: Network, step: float) -> None:
    rows = []
    for stage in STAGES:
        for placed in network.placed.values():
            kind = type_of(placed.item)
            if not kind.terminals and kind.stage == stage:
                rows.append((stage, placed.path, kind.name, _clock(placed.clock, step)))
    table("Stages of a step", ("stage", "component", "type", "runs"), rows)


def _water(network: Network) -> None:
    """What screws and hull are made of: tested propellers, points of resistance, limits of wind and waves."""
    items = {path: placed.item for path, placed in network.placed.items()}
    screws, rows = {}, []
    for path, item in items.items():
        if isinstance(item, Propeller):
            screws.setdefault((item.P_D, item.A_E, item.Z, item.ends), []).append(path)
        elif isinstance(item, Hull):
            points = ", ".join(f"{R / 1e3:.4g} kN at {u / KNOT:.4g} kn" for u, R in item.resistance)
            rows.append((path, f"resistance {points}; by the square of speed beyond half the first and twice the last"))
        elif isinstance(item, WindAndWaves):
            limit = f"head sea up to {parameter_record(item)[0].H_max:.3g} m"
            rows.append((path, f"wind on {item.A_T:g} m2 with C_x {item.C_x:g}; {limit}"))
    for (*shape, ends), paths in screws.items():
        P_D, A_E, Z = shape
        (blades, area), pitch = stand_in(*shape)
        apart = "{:.4f} in CT*, {:.4f} in CQ*".format(*mismatch(*shape))
        series = (
            f"four quadrants by B{blades:g}-{100 * area:g}, P/D {pitch:g}, {apart} off the polynomials at the joins"
        )
        braking = {facing: float(characteristic("T", AGAINST_THE_FLOW, facing, *shape)[0]) for facing in SORTS}
        against = (
            f"against the flow CT* {braking[ends]:.3f} at beta {float(np.degrees(AGAINST_THE_FLOW[0])):g} degrees"
            f" (facing astern {braking[1.0]:.3f}, facing ahead {braking[-1.0]:.3f})"
        )
        which = f"B{Z:g}-{100 * A_E:g}, P/D {P_D:g}, {SORTS[ends]}"
        rows.append((", ".join(paths), f"{which}; {series}; {against}"))
    if rows:
        table("Screws and hull", ("component", "which is"), rows)


def _converters(network: Network, ship: ShipInNetwork) -> None:
    """What converters can carry against their ratings, and where their filters resonate; alike ones in one row."""
    rated: dict[Rated, list[str]] = {}
    resonances: dict[Resonance, list[str]] = {}
    for name, item in ship.equipment.items():
        for row in item.rated(network, ship) if hasattr(item, "rated") else ():
            rated.setdefault(row, []).append(name)
        for found in item.resonances(network, ship) if hasattr(item, "resonances") else ():
            resonances.setdefault(found, []).append(name)
    rows = [
        (", ".join(names), si(row.rating, row.unit), row.under, f"{v_dc:g} V", si(power, row.unit), share, said)
        for row, names in rated.items()
        for v_dc, power, said in row.carries
        for share in [f"{100.0 * power / row.rating:.0f} %"]
    ]
    if rows:
        heads = ("item", "rating", "at", "DC voltage", "carries", "of it", "how it ends")
        table("What converters can carry at nominal AC voltage", heads, rows)
    for row, names in rated.items():
        if row.short:
            v_dc, power, _ = min(row.carries, key=lambda point: point[1])
            under = f" at {row.under}" if row.under else ""
            less = f"{si(power, row.unit)} of {si(row.rating, row.unit)}{under} on {v_dc:g} V"
            typer.echo(f"{', '.join(names)}: less than the rating, {less}. {row.remedy}")
    rows = [
        (", ".join(names), f"{r.frequency:.0f} Hz", r.behind, f"{r.low:g} to {r.high:g} Hz", r.placed)
        for r, names in resonances.items()
    ]
    if rows:
        table("Resonances of filters", ("item", "resonance", "behind", "wanted: 10 f_1 to f_sw / 2", "is"), rows)


def _clock(clock: Any, step: float) -> str:
    if isinstance(clock, Sampled):
        return f"at {clock.hertz:g} Hz exactly, every {1.0 / (clock.hertz * step):.3f} steps"
    if isinstance(clock, Every):
        return f"every {round(clock.seconds / step)} steps"
    return "every step"
