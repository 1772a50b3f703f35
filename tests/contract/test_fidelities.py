"""Every element that can hang on a leg, behind one: averaged, every edge, and the reference solver's run agree.

Found in the registry: linear kinds with a terminal whose current does not jump with its voltage. Their other terminals
lie on a loaded bus.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from contract.test_components import KINDS, benches, drawn
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.workspace import new_workspace
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.equipment.wiring import add_bridge, add_leg
from shipgrid.model.component import fields_of
from shipgrid.model.network import Network
from shipgrid.model.placed import Sampled
from shipgrid.model.records import names_of
from shipgrid.modulators.open_loop import SineModulation
from shipgrid.solvers.companion import state_space
from verification.circuits import Hold
from verification.test_reference import difference, fast_run

CARRIER, DUTY = 5e3, 0.6137


def inductive_ends() -> dict[str, str]:
    """Kinds that can hang on a leg, each with the terminal that does."""
    found = {}
    for name, kind in KINDS.items():
        if kind.linear and kind.state.__annotations__ and not kind.two_axis_ends:
            D = state_space(drawn(name, 1)[0]).D
            ends = [t.name for k, t in enumerate(kind.terminals) if not D[k].any() and not D[:, k].any()]
            if ends:
                found[name] = ends[0]
    return found


ENDS = inductive_ends()


def plant(fidelity: str, step: float):
    """Each element on a leg of its own, and a three-phase bridge, all on one stiff bus."""
    net = Network("legs", fidelity)
    high = net.dc_bus("high", 750.0)
    net.capacitance(high, 1e4)
    net.add("hold", Hold(), inputs={"wanted": DUTY}, clock=Sampled(CARRIER))
    for name, end in ENDS.items():
        leg = add_leg(net, f"leg_{name}", high, control="hold", gates=1.0, clock=Sampled(CARRIER), f_sw=CARRIER)
        ports = {}
        for terminal in KINDS[name].terminals:
            if terminal.name != end:
                low = net.dc_bus(f"low_{name}_{terminal.name}", 750.0)
                net.capacitance(low, 1e-3)
                net.conductance(low, 0.5)
                ports[terminal.name] = low
        volts = {terminal.v for terminal in KINDS[name].terminals}
        sources = {f.name: 474.0 for f in fields_of(KINDS[name].input) if f.signal.required and f.name not in volts}
        net.add(name, drawn(name, 2)[1], ports={end: leg} | ports, inputs=sources)
    net.add("sine", SineModulation(), inputs={"m": 0.8}, clock=Sampled(CARRIER))
    bridge = add_bridge(net, "bridge", high, control="sine", gates=1.0, clock=Sampled(CARRIER), f_sw=CARRIER)
    net.add_three_phase("wound", RlBranch(R=2.0, L=5e-3), ports={"branch": bridge})
    plan = assemble(net, step)
    work = new_workspace(plan)
    work.sig[plan.layout.index["high.v_dc"]] = 750.0
    settle_outputs(plan, work)
    return plan, work


STATES = [f"{name}.{state}" for name in ENDS for state in names_of(KINDS[name].state)] + [
    "wound.alpha.i",
    "wound.beta.i",
]


@pytest.mark.full
def test_means_of_both_fidelities_agree():
    means, sizes = [], []
    for fidelity in ("averaged", "switching"):
        plan, work = plant(fidelity, 25e-6)
        last = fast_run(plan, work, 4000, STATES)[:, -800:]  # 100 carrier periods, of eight steps each
        means.append(last.mean(axis=1))
        sizes.append(np.abs(last).max(axis=1))  # with its ripple, where that is all there is
    off = dict(zip(STATES, np.abs(means[1] - means[0]) / np.maximum(*sizes), strict=True))
    # eight values of a ripple that is no triangle are not quite its mean
    assert {name: value for name, value in off.items() if not value < 5e-3} == {}


@pytest.mark.full
def test_every_edge_converges_to_the_reference_with_order_two():
    steps = (20e-6, 10e-6, 5e-6)
    found = [np.array(list(difference(*plant("switching", h), 2e-3, STATES).values())) for h in steps]
    for coarse, fine in pairwise(found):
        assert np.median(np.log2(coarse / fine)) == pytest.approx(2.0, abs=0.4), found
    assert found[-1].max() < 2e-3


def two_axis_ends() -> dict[str, str]:
    """Kinds that take both axes at once, each with its first end whose current does not jump with its voltage."""
    found = {}
    for name, kind in KINDS.items():
        currents = {terminal.i: terminal.v for terminal in kind.terminals}
        for end, pair in kind.two_axis_ends.items():
            ports = [terminal for terminal in kind.terminals if terminal.name in pair]
            (bench, *_) = benches(name, 1)
            by_v = bench.jacobian("outputs", "y", "u")
            rows = [names_of(kind.output).index(terminal.i) for terminal in ports]
            columns = [names_of(kind.input).index(v) for v in currents.values()]
            if not by_v[np.ix_(rows, columns)].any():
                found.setdefault(name, end)
    return found


TWO_AXIS_ENDS = two_axis_ends()
TURNING = {"SynchronousGenerator": {"omega": 1.0}, "InductionMotor": {"omega": 0.97}}
"""Speeds to start at; a motor or generator that stands draws its short-circuit current."""


def three_phase_plant(fidelity: str, step: float):
    """Each two-axis element behind a bridge of its own, all on one stiff bus; its other end on a loaded one."""
    net = Network("bridges", fidelity)
    high = net.dc_bus("high", 750.0)
    net.capacitance(high, 1e4)
    net.add("sine", SineModulation(), inputs={"m": 0.8}, clock=Sampled(CARRIER))
    for name, end in TWO_AXIS_ENDS.items():
        bridge = add_bridge(
            net, f"bridge_{name}", high, control="sine", gates=1.0, clock=Sampled(CARRIER), f_sw=CARRIER
        )
        kind, ports = KINDS[name], {end: bridge}
        for other in kind.two_axis_ends:
            if other != end:
                bus = net.ac_bus(f"far_{name}", 400.0, 60.0)
                net.conductance(bus, 0.2)
                ports[other] = bus
        volts = {terminal.v for terminal in kind.terminals}
        needed = {f.name: 0.5 for f in fields_of(kind.input) if f.signal.required and f.name not in volts}
        net.add_three_phase(name, drawn(name, 2)[1], ports=ports, inputs=needed, initial=TURNING.get(name))
    plan = assemble(net, step)
    work = new_workspace(plan)
    work.sig[plan.layout.index["high.v_dc"]] = 750.0
    settle_outputs(plan, work)
    return plan, work


@pytest.mark.full
def test_means_of_both_fidelities_agree_for_elements_of_two_axes():
    """Over a whole carrier period each, in every state, while the modulation turns."""
    assert {"Transformer", "SecondaryWinding", "Pmsm", "SynchronousGenerator", "InductionMotor"} <= set(TWO_AXIS_ENDS)
    states = [f"{name}.{state}" for name in TWO_AXIS_ENDS for state in names_of(KINDS[name].state)]
    turning = [f.name for kind in KINDS.values() if kind.stamped for f in fields_of(kind.state) if f.signal.rotates]
    states = [path for path in states if path.rpartition(".")[2] not in turning]
    means, sizes = [], []
    for fidelity in ("averaged", "switching"):
        plan, work = three_phase_plant(fidelity, 25e-6)
        periods = fast_run(plan, work, 2000, states)[:, 1:].reshape(len(states), -1, 8)[
            :, 50:
        ]  # without what starting jolts
        means.append(periods.mean(axis=2))
        sizes.append(np.abs(periods).max(axis=(1, 2)))
    off = dict(zip(states, np.abs(means[1] - means[0]).max(axis=1) / np.maximum(*sizes), strict=True))
    assert {name: value for name, value in off.items() if not value < 1e-2} == {}
