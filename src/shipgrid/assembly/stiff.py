"""What follows within a step: capacitors charged faster than the step resolves, and what hangs on them.

The rule is L-stable: a time constant far below the step settles within it, and voltages and charges come out right.
Two things have to be known for it. The energy that a charging current loses in resistances, half of what the source
gives, is in none of the two stages; the rule has it all the same (`solvers.nodal.finish_step`). Beside a bridge
such a voltage, or the current through a resistance there, follows the mean switching function of the step: it is
published as the mean of the step, since at the step's end the switch has one position or the other and not their mean.
"""

from __future__ import annotations

import math

import numpy as np

from shipgrid.assembly.contacts import energy_form
from shipgrid.assembly.layout import Layout
from shipgrid.model.component import type_of
from shipgrid.model.network import Network
from shipgrid.model.placed import Placed
from shipgrid.model.records import names_of
from shipgrid.solvers.companion import state_space
from shipgrid.solvers.nodal import NetworkPlan

RESOLVED = 3.0
"""Time constant, in steps, from which a step resolves an exponential: the rule is then off by 1 % of it at most."""


def stiff_storage(
    network: Network, layout: Layout, net: NetworkPlan, step: float, energy_items: list[tuple[str, str]], weight: dict
) -> tuple[dict[str, np.ndarray], list[tuple[str, str]]]:
    """Fields `stiff_...` of `StepPlan`, and the entries that the energy audit needs on top for them.

    Parameters
    ----------
    network : Network
    layout : Layout
    net : NetworkPlan
    step : float
        Step length [s].
    energy_items : list of (str, str)
        Path and ledger of each entry there is.
    weight : dict of str to float
        What energy at each node counts.
    """
    items = list(energy_items)

    def entry(path: str) -> int:
        if (path, "losses") not in items:
            items.append((path, "losses"))
        return items.index((path, "losses"))

    node_number = {int(place): k for k, place in enumerate(net.node_signal)}
    around = resistances(network)
    nodes = []
    for node, constant in time_constants(network).items():
        if not 0.0 < constant < RESOLVED * step:
            continue
        s, total = 0.5 * weight[node] * network.capacitances[node], sum(around[node].values())
        shares = {path: g / total for path, g in around[node].items()} or {capacitor_path(node): 1.0}
        nodes += [(node_number[layout.index[node]], s * share, entry(path)) for path, share in shares.items()]
    state_number = {int(place): k for k, place in enumerate(net.state_signal)}
    states = []
    for placed in (p for t in layout.types if t.kind.linear for p in t.placed):
        A, names = state_space(placed.item).A, names_of(type_of(placed.item).state)
        for k, name in enumerate(names):
            number = state_number.get(layout.slots["x", f"{placed.path}.{name}"])
            if number is None or -A[k, k] * step * RESOLVED <= 1.0:
                continue
            form = energy_form(placed).get((name, name), 0.0)
            if form:
                states.append((number, form, entry(placed.path)))
    fields = {
        "stiff_node": np.array([[k for k, *_ in nodes], [e for *_, e in nodes]], dtype=np.int64),
        "stiff_node_s": np.array([s for _, s, _ in nodes], dtype=float),
        "stiff_state": np.array([[k for k, *_ in states], [e for *_, e in states]], dtype=np.int64),
        "stiff_state_s": np.array([s for _, s, _ in states], dtype=float),
    }
    return fields, items[len(energy_items) :]


def capacitor_path(node: str) -> str:
    """Path under which the capacitance of a node stands in the books."""
    return f"{node.rsplit('.', 1)[0]}.capacitance"


def resistances(network: Network) -> dict[str, dict[str, float]]:
    """By node, the elements that conduct there at once, contacts closed, and their conductances [S]."""
    found: dict[str, dict[str, float]] = {node: {} for bus in network.buses.values() for node in bus.nodes}
    for placed in _resistive(network):
        space = state_space(placed.item)
        for r, terminal in enumerate(type_of(placed.item).terminals):
            binding, g = placed.ports[terminal.name], abs(float(space.D[r, r]))
            for node in (binding.plus, binding.minus):
                if node in found and binding.coefficient is None and g > 0.0:
                    found[node][placed.path] = found[node].get(placed.path, 0.0) + g
    return found


def _resistive(network: Network) -> list[Placed]:
    """Linear elements with currents that follow their voltages at once."""
    linear = [placed for placed in network.placed.values() if type_of(placed.item).linear]
    spaces = [state_space(placed.item) for placed in linear]
    return [placed for placed, space in zip(linear, spaces, strict=True) if np.any(space.D[:, : len(space.C)])]


def time_constants(network: Network) -> dict[str, float]:
    """By node, its capacitance over the conductances that meet it, contacts closed [s]; inf where nothing conducts."""
    total = {n: sum(g.values()) + network.conductances.get(n, 0.0) for n, g in resistances(network).items()}
    return {n: network.capacitances.get(n, 0.0) / g if g > 0.0 else math.inf for n, g in total.items()}


def means_of_steps(network: Network, layout: Layout, net: NetworkPlan, step: float) -> dict[str, np.ndarray]:
    """Fields `mean_port` and `mean_node` of `NetworkPlan`: what follows the mean switching function of a step.

    From the DC nodes of bridges on, all nodes that a resistance ties to one of them and that settle within the step;
    and the ports there of elements without states.

    Parameters
    ----------
    network : Network
    layout : Layout
    net : NetworkPlan
    step : float
        Step length [s].
    """
    constants = time_constants(network)

    def follows(node: str) -> bool:
        return constants.get(node, math.inf) < RESOLVED * step

    reached = {legs.bus.nodes[0] for legs in network.legs.values() if follows(legs.bus.nodes[0])}
    stateless = [placed for placed in _resistive(network) if not names_of(type_of(placed.item).state)]
    joined = [
        {n for b in p.ports.values() if b.coefficient is None for n in (b.plus, b.minus) if n is not None}
        for p in stateless
    ]
    grown = True
    while grown:
        more = {n for nodes in joined if nodes & reached for n in nodes if follows(n)} - reached
        reached |= more
        grown = bool(more)
    port_number = {int(place): k for k, place in enumerate(net.port_i)}
    ports = [
        port_number[layout.slots["y", f"{placed.path}.{terminal.i}"]]
        for placed in stateless
        for terminal in type_of(placed.item).terminals
        if {placed.ports[terminal.name].plus, placed.ports[terminal.name].minus} & reached
    ]
    node_number = {int(place): k for k, place in enumerate(net.node_signal)}
    nodes = [node_number[layout.index[n]] for n in reached if network.capacitances.get(n, 0.0) == 0.0]
    return {"mean_port": np.array(sorted(ports), dtype=np.int64), "mean_node": np.array(sorted(nodes), dtype=np.int64)}
