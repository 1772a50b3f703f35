"""Small circuits of one set of component types, for every test of plants in parts."""

from __future__ import annotations

import numpy as np

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.model.connections import Across
from shipgrid.model.network import Network
from verification.circuits import Hold, Sampler, SourceBranch, Wave

FILTER = LclFilter(L_1=0.5e-3, R_1=0.02, C=50e-6, R_d=0.3, L_2=0.849e-3, R_2=0.03)


def circuit(name="cut") -> Network:
    """A network with a bus 'spare' that nothing is joined to, and on it one of each type."""
    net = Network(name)
    bus = net.dc_bus("spare", 200.0)
    net.capacitance(bus, 1e-3)
    net.add("spare_branch", RlBranch(R=1.0, L=1e-3), ports={"branch": bus})
    net.add("spare_source", SourceBranch(R=1.0, L=1e-3), ports={"ends": bus})
    net.add("spare_filter", FILTER, ports={"converter": bus, "grid": bus})
    net.add("spare_hold", Hold(), inputs={"wanted": 0.0})
    net.add("spare_sampler", Sampler(), inputs={"v": "spare.v_dc"})
    net.add("spare_wave", Wave(peak=1.0, omega=1.0))
    return net


def buses(net, **capacitance):
    """DC buses of 200 V, by name with their capacitance."""
    found = {name: net.dc_bus(name, 200.0) for name in capacitance}
    for name, farad in capacitance.items():
        net.capacitance(found[name], farad)
    return list(found.values())


def two_buses(h, parts, C=(50e-6, 50e-6), R=0.0, L=0.849e-3, **options):
    """Two capacitances joined by a cable."""
    net = circuit()
    a, b = buses(net, a=C[0], b=C[1])
    net.add("cable", RlBranch(R=R, L=L), ports={"branch": Across(a, b)}, **options)
    return assemble(net, h, parts=parts)


CUT = {"one": ["a"], "two": ["b"]}


def started(plan, **values):
    """A workspace with these values, `a__v_dc` for `a.v_dc`, everything else in agreement with them."""
    work = new_workspace(plan)
    for name, value in values.items():
        work.sig[plan.layout.index[name.replace("__", ".")]] = value
    settle_outputs(plan, work)
    return work


def run(plan, work, steps):
    done = core()(steps, work.n, *arguments(plan, work))
    assert done == steps
    work.n += steps


def value(plan, work, path):
    return float(work.sig[plan.layout.index[path]])


def traced(plan, work, steps, paths):
    """Values of signals after each of some steps."""
    places = [plan.layout.index[path] for path in paths]
    found = np.empty((steps, len(paths)))
    entry, given = core(), arguments(plan, work)
    for k in range(steps):
        assert entry(1, work.n, *given) == 1
        work.n += 1
        found[k] = work.sig[places]
    return found


def step_matrix(plan, held=False):
    """What one step does to the network, and where it remembers: voltages, states, and the waves under way.

    Parameters
    ----------
    plan : Plan
    held : bool
        Whether both stages take the wave of the second, as a line with one wave a step would.
    """
    index = plan.layout.index
    places, twins = [], []
    for piece in plan.pieces:
        places += [*piece.net.node_signal, *piece.net.state_signal]
        for end in getattr(piece.network, "ends", []):
            places += [index[f"{end.name}.in_{k}"] for k in ((2,) if held else (1, 2))]
            twins.append((index[f"{end.name}.in_1"], index[f"{end.name}.in_2"]))
    work = new_workspace(plan)
    entry, given = core(), arguments(plan, work)
    found = np.empty((len(places), len(places)))
    for column, place in enumerate(places):
        work.sig[:] = 0.0
        work.sig[[1, place]] = 1.0
        for first, second in twins if held else ():
            work.sig[first] = work.sig[second]
        entry(1, 0, *given)
        found[:, column] = work.sig[places]
    return found
