"""The nodal solver on circuits with closed forms: order, switching, islands, bridges, bookkeeping."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.energy import stored_energy
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.errors import TopologyError
from shipgrid.model.connections import Across, Pole, PortBinding
from shipgrid.model.network import Network
from shipgrid.model.placed import Sampled
from verification.circuits import Hold, Sampler, SourceBranch

R, L, C, E = 0.1, 1e-3, 100e-6, 100.0


def run(plan, work, seconds):
    n = round(seconds / plan.h)
    assert core()(n, work.n, *arguments(plan, work)) == n
    work.n += n


def value(plan, work, path):
    return work.sig[plan.layout.index[path]]


def rlc(step, **options):
    net = Network("rlc")
    bus = net.dc_bus("bus", 200.0)
    net.capacitance(bus, C)
    net.add("source", SourceBranch(R=R, L=L), ports={"ends": bus}, inputs={"e": -E})
    return assemble(net, step, **options)


def test_error_of_a_series_rlc_step_falls_with_the_square_of_the_step():
    a, T = R / (2 * L), 10e-3
    w = math.sqrt(1 / (L * C) - a**2)
    exact = E * (1 - math.exp(-a * T) * (math.cos(w * T) + a / w * math.sin(w * T)))
    errors = []
    for step in (25e-6, 12.5e-6, 6.25e-6):
        plan = rlc(step)
        work = new_workspace(plan)
        run(plan, work, T)
        errors.append(value(plan, work, "bus.v_dc") - exact)
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders == pytest.approx(2.0, abs=0.15)  # the next term of the error is a third-order one
    assert abs(errors[-1]) < 1e-4 * E


def test_a_time_constant_far_below_the_step_neither_rings_nor_grows():
    """12 uF behind 34 mohm at 30 us: trapezoidal integration has a root of -0.946 here, this rule none near -1."""
    net = Network("stiff")
    bus = net.dc_bus("bus", 200.0)
    net.capacitance(bus, 12e-6)
    net.add("source", SourceBranch(R=0.034, L=1e-9), ports={"ends": bus}, inputs={"e": -E})
    plan = assemble(net, 30e-6)
    work = new_workspace(plan)
    run(plan, work, 30e-6)
    first = abs(value(plan, work, "bus.v_dc") - E)
    run(plan, work, 30e-6)
    second = abs(value(plan, work, "bus.v_dc") - E)
    assert second < 0.1 * first + 1e-9


def test_energy_supplied_is_energy_lost_and_stored():
    """Audited every step, with the rule's own weights: what is left is the rule's damping."""
    gaps = []
    for step in (10e-6, 5e-6):
        plan = rlc(step, audit=step)
        work = new_workspace(plan)
        before = sum(stored_energy(plan, work).values())
        run(plan, work, 20e-3)
        after = sum(stored_energy(plan, work).values())
        ledger = dict(zip(plan.energy_items, work.step.energy, strict=True))
        supplied = ledger["source", "supplied"]
        gaps.append(supplied - ledger["source", "losses"] - after + before)
    assert abs(gaps[1]) < 1e-4 * supplied
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.1)


def test_an_open_contact_carries_nothing_and_its_current_is_gone_at_once():
    net = Network("contact")
    bus = net.dc_bus("bus", 200.0)
    net.capacitance(bus, C)
    net.conductance(bus, 0.01)
    net.add("hold", Hold(), inputs={"wanted": net.command("contact.open")})
    net.add("source", SourceBranch(R=R, L=L), ports={"ends": bus}, inputs={"e": -E}, variant="hold.value")
    plan = assemble(net, 10e-6)
    work = new_workspace(plan)
    run(plan, work, 2e-3)
    assert abs(value(plan, work, "source.i")) > 1.0
    work.sig[plan.layout.index["command:contact.open"]] = 1.0
    run(plan, work, plan.h)
    assert value(plan, work, "source.i") == 0.0
    v0 = value(plan, work, "bus.v_dc")
    run(plan, work, 1e-2)
    assert value(plan, work, "bus.v_dc") == pytest.approx(v0 * math.exp(-1e-2 * 0.01 / C), rel=1e-6)


def test_a_node_without_capacitance_and_source_goes_to_zero_and_nothing_becomes_singular():
    net = Network("floating")
    a, b, c = (net.dc_bus(name, 200.0) for name in "abc")
    net.add("between", SourceBranch(R=R, L=L), ports={"ends": Across(a, b)}, inputs={"e": 10.0})
    net.capacitance(c, C)
    plan = assemble(net, 10e-6)
    work = new_workspace(plan)
    run(plan, work, 1e-3)
    assert np.all(np.isfinite(work.sig))
    assert value(plan, work, "between.i") == pytest.approx(0.0, abs=1e-12)
    assert abs(value(plan, work, "a.v_dc") - value(plan, work, "b.v_dc")) == pytest.approx(10.0)
    assert value(plan, work, "c.v_dc") == 0.0


@pytest.mark.parametrize("step", [30e-6, 7e-6])
def test_a_half_bridge_takes_from_one_side_what_it_gives_to_the_other(step):
    s, load = 0.6, 5.0
    net = Network("buck")
    high, low = net.dc_bus("high", 750.0), net.dc_bus("low", 750.0)
    net.capacitance(high, 1e-3)
    net.capacitance(low, 1e-3)
    net.conductance(low, 1.0 / load)
    net.add("feed", SourceBranch(R=0.5, L=1e-3), ports={"ends": high}, inputs={"e": -750.0})
    net.add("hold", Hold(), inputs={"wanted": s})
    net.add(
        "choke",
        SourceBranch(R=0.25, L=0.8e-3),
        ports={"ends": PortBinding("low.v_dc", "mid.v_dc")},
    )
    mid = net.dc_bus("mid", 750.0)
    net.add("leg", SourceBranch(R=1e-3, L=1e-6), ports={"ends": Pole(high, "hold.s")}, inputs={"e": 0.0})
    del mid, low
    plan = assemble(net, step)
    work = new_workspace(plan)
    settle_outputs(plan, work)
    run(plan, work, 50e-3)
    v_dc, i = value(plan, work, "high.v_dc"), value(plan, work, "leg.i")
    assert i == pytest.approx(s * v_dc / 1e-3, rel=1e-9)  # v_leg = s v_dc
    assert 750.0 - v_dc == pytest.approx(0.5 * s * i, rel=1e-9)  # i_dc = s i


def test_sampling_instants_inside_a_step_see_the_value_at_the_instant():
    net = Network("sampled")
    bus = net.dc_bus("bus", 200.0)
    net.capacitance(bus, C)
    net.add("source", SourceBranch(R=R, L=L), ports={"ends": bus}, inputs={"e": -E})
    net.add("sampler", Sampler(), inputs={"v": "bus.v_dc"}, clock=Sampled(1620.0))
    plan = assemble(net, 30e-6)
    work = new_workspace(plan)
    run(plan, work, 0.1)
    assert value(plan, work, "sampler.count") == 162 + 1 - 1  # instants 0, 1/1620 ... before the last step's start
    k = 161
    a = R / (2 * L)
    w = math.sqrt(1 / (L * C) - a**2)
    T = k / 1620.0
    exact = E * (1 - math.exp(-a * T) * (math.cos(w * T) + a / w * math.sin(w * T)))
    assert value(plan, work, "sampler.sample") == pytest.approx(exact, abs=0.005 * E)  # rule and interpolation at 30 us


def test_a_name_that_does_not_exist_is_named_with_the_nearest():
    net = Network("typo")
    bus = net.dc_bus("bus", 200.0)
    net.capacitance(bus, C)
    net.add("hold", Hold(), inputs={"wanted": "bus.v_cd"})
    with pytest.raises(TopologyError, match=r"hold.wanted reads 'bus.v_cd'.*nearest: 'bus.v_dc'"):
        assemble(net, 30e-6)


def test_two_runs_are_bit_identical():
    results = []
    for _ in range(2):
        plan = rlc(10e-6)
        work = new_workspace(plan)
        run(plan, work, 5e-3)
        results.append(work.sig.copy())
    assert np.array_equal(*results)
