"""Many breakers, no table of their positions: random ones against a dense solution written here; dead islands."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.workspace import new_workspace
from shipgrid.components.electrical.cable import ac_cable, dc_cable
from shipgrid.components.electrical.load import Load
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.model.connections import Across
from shipgrid.model.network import Network
from verification.circuits import Hold, SourceBranch
from verification.test_network_solver import run, value

BUSES, BREAKERS, H = 24, 40, 30e-6
GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
C, G, LENGTH, CONTACT = 2e-3, 1.0 / 50.0, 30.0, 1e-4
FEED_R, FEED_L, FEED_E = 0.2, 1e-3, 750.0


def ends() -> list[tuple[int, int]]:
    """A chain of buses, and ties that skip some: every bus has two ways at least, so it is fed with some open."""
    chain = [(k, k + 1) for k in range(BUSES - 1)]
    ties = [(k, (k + 5) % BUSES) for k in range(BREAKERS - len(chain))]
    return chain + ties


def switchboard(breakers: int = BREAKERS):
    """Buses with capacitor and bleeder, the first and the middle one fed, and breakers between them."""
    net = Network("switchboard")
    buses = [net.dc_bus(f"bus_{k:02d}", 750.0) for k in range(BUSES)]
    for bus in buses:
        net.capacitance(bus, C)
        net.conductance(bus, G)
    for k in (0, BUSES // 2):
        net.add(f"feed_{k}", SourceBranch(R=FEED_R, L=FEED_L), ports={"ends": buses[k]}, inputs={"e": -FEED_E})
    for j, (a, b) in enumerate(ends()[:breakers]):
        net.add(f"hold_{j:02d}", Hold(), inputs={"wanted": net.command(f"breaker_{j:02d}.open")})
        cable = dc_cable(LENGTH, contact=CONTACT)
        net.add(f"cable_{j:02d}", cable, ports={"branch": Across(buses[a], buses[b])}, variant=f"hold_{j:02d}.value")
    return assemble(net, H)


class Dense:
    """The same switchboard by two implicit Euler stages of one dense matrix: voltages, then currents of the closed."""

    def __init__(self):
        self.v = np.zeros(BUSES)
        self.i = np.zeros(BREAKERS + 2)

    def run(self, n: int, opened: set[int]) -> None:
        cable = dc_cable(LENGTH, contact=CONTACT)
        incidence = np.zeros((BUSES, BREAKERS + 2))  # +1 where a branch's current leaves the bus
        for j, (a, b) in enumerate(ends()):
            incidence[a, j], incidence[b, j] = 1.0, -1.0
        incidence[0, BREAKERS] = incidence[BUSES // 2, BREAKERS + 1] = 1.0
        R = np.r_[np.full(BREAKERS, cable.R), [FEED_R] * 2]
        L = np.r_[np.full(BREAKERS, cable.L), [FEED_L] * 2]
        e = np.r_[np.zeros(BREAKERS), [FEED_E] * 2]
        closed = [j for j in range(BREAKERS + 2) if j not in opened]
        self.i[sorted(opened)] = 0.0
        incidence, R, L, e = incidence[:, closed], R[closed], L[closed], e[closed]
        A = np.block([
            [-np.eye(BUSES) * G / C, -incidence / C],
            [incidence.T / L[:, None], -np.diag(R / L)],
        ])  # fmt: skip
        b = np.r_[np.zeros(BUSES), -e / L]
        step = np.linalg.inv(np.eye(len(A)) - GAMMA * H * A)
        x = np.r_[self.v, self.i[closed]]
        for _ in range(n):
            first = step @ (x + GAMMA * H * b)
            x = step @ (x + (1.0 - GAMMA) / GAMMA * (first - x) + GAMMA * H * b)
        self.v, self.i[closed] = x[:BUSES], x[BUSES:]


def test_forty_breakers_in_any_position_give_what_a_dense_solution_gives():
    plan = switchboard()
    work, dense, rng = new_workspace(plan), Dense(), np.random.default_rng(7)
    commands = [plan.layout.index[f"command:breaker_{j:02d}.open"] for j in range(BREAKERS)]
    v = [plan.layout.index[f"bus_{k:02d}.v_dc"] for k in range(BUSES)]
    i = [plan.layout.index[f"cable_{j:02d}.i"] for j in range(BREAKERS)]
    for opened_share in (0.0, 0.2, 0.5, 0.8, 1.0, 0.3):
        opened = {j for j in range(BREAKERS) if rng.random() < opened_share}
        work.sig[commands] = [float(j in opened) for j in range(BREAKERS)]
        run(plan, work, 40 * H)
        dense.run(40, opened)
        assert np.max(np.abs(dense.v)) > 10.0
        # rounding of another order of elimination, over 40 steps
        assert work.sig[v] == pytest.approx(dense.v, abs=1e-10 * 750.0)
        assert work.sig[i] == pytest.approx(dense.i[:BREAKERS], abs=1e-10 * 1e4)


def test_what_is_kept_for_breakers_grows_with_their_number_and_not_with_their_positions():
    sizes = {}
    for breakers in (20, 30, 40):
        plan = switchboard(breakers)
        arrays = [a for part in (plan.net, new_workspace(plan).net) for a in part if isinstance(a, np.ndarray)]
        assert plan.net.n_nodes == BUSES
        sizes[breakers] = sum(a.size for a in arrays)
    # matrices of two positions, and a few entries of the lists that scatter them; the elimination fills in a little
    assert sizes[30] - sizes[20] < 10 * 100
    assert sizes[40] - sizes[30] < 10 * 100


def test_a_dead_ac_island_behind_its_open_tie_stays_at_zero_comes_alive_with_it_and_dies_with_it():
    net = Network("hotel")
    live, dead = (net.ac_bus(name, 400.0, 60.0) for name in ("live", "dead"))
    net.add("hold", Hold(), inputs={"wanted": net.command("tie.open", 1.0)})
    for bus in (live, dead):
        net.add_three_phase(f"load_{bus.name}", Load(p_0=10e3), ports={"supply": bus})
    source = SourceBranch(R=0.05, L=0.2e-3)
    net.add_three_phase("source", source, ports={"ends": live}, inputs={"e": (-326.0, 0.0)})
    net.add_three_phase("tie", ac_cable(30.0), ports={"branch": Across(live, dead)}, variant="hold.value")
    plan = assemble(net, H)
    work = new_workspace(plan)
    run(plan, work, 0.02)
    assert value(plan, work, "live.v_alpha") > 300.0
    for path in ("dead.v_alpha", "dead.v_beta", "load_dead.alpha.i", "tie.alpha.i", "tie.beta.i"):
        assert value(plan, work, path) == 0.0
    work.sig[plan.layout.index["command:tie.open"]] = 0.0
    run(plan, work, 0.02)
    assert value(plan, work, "dead.v_alpha") > 300.0
    # The load's current is interrupted: an impulse of one step, which is no divergence, and nothing after it.
    work.sig[plan.layout.index["command:tie.open"]] = 1.0
    run(plan, work, 2 * H)
    for path in ("dead.v_alpha", "dead.v_beta", "load_dead.alpha.i", "tie.alpha.i"):
        assert value(plan, work, path) == pytest.approx(0.0, abs=1e-9)
    assert value(plan, work, "live.v_alpha") > 300.0
    assert np.all(np.isfinite(work.sig))


def test_a_capacitive_bus_that_nothing_feeds_decays_through_its_bleeder():
    capacitance, bleeder = 34e-3, 5e3
    net = Network("bleeder")
    fed, left = (net.dc_bus(name, 750.0) for name in ("fed", "left"))
    for bus in (fed, left):
        net.capacitance(bus, capacitance)
        net.conductance(bus, 1.0 / bleeder)
    net.add("hold", Hold(), inputs={"wanted": net.command("tie.open", 0.0)})
    net.add("feed", SourceBranch(R=0.05, L=0.2e-3), ports={"ends": fed}, inputs={"e": -750.0})
    net.add("tie", RlBranch(R=2e-3, L=9e-6), ports={"branch": Across(fed, left)}, variant="hold.value")
    plan = assemble(net, H)
    work = new_workspace(plan)
    run(plan, work, 0.5)
    work.sig[plan.layout.index["command:tie.open"]] = 1.0
    run(plan, work, H)
    start = value(plan, work, "left.v_dc")
    assert start == pytest.approx(750.0, abs=1.0)
    run(plan, work, 2.0)
    seconds = round(2.0 / H) * H
    assert value(plan, work, "left.v_dc") == pytest.approx(
        start * math.exp(-seconds / (bleeder * capacitance)), rel=1e-9
    )
    assert value(plan, work, "fed.v_dc") == pytest.approx(750.0, abs=1.0)
