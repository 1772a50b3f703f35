"""Stub lines: what a cut does to a circuit, against the closed form of a lossless line whose delay is one step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import root_scalar

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.energy import stored_energy
from shipgrid.assembly.tables import arguments
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.model.connections import Across, Pole
from shipgrid.solvers.companion import GAMMA, KAPPA
from shipgrid.solvers.stub_lines import first_waves
from verification.circuits import Hold, SourceBranch, Wave
from verification.parted import CUT, FILTER, buses, circuit, run, started, step_matrix, traced, two_buses, value

H = 30e-6


def resonance(plan, near):
    """The oscillation of a step, as a complex angular frequency, that is nearest to this one."""
    found = np.log(np.linalg.eigvals(step_matrix(plan)) + 0j) / plan.h
    return found[np.argmin(np.abs(found - 1j * near))]


@pytest.mark.parametrize("C", [(50e-6, 50e-6), (480e-6, 20e-6)])
def test_a_resonance_across_a_cut_is_that_of_a_line_with_the_delay_of_a_step(C):
    """Of C_1 and the line that C_2 ends the admittances are opposite: tan(w h) (w^2 Z^2 C_1 C_2 - 1) = w Z (C_1 + C_2).

    The integration rule has a shift of its own, second order too. In the uncut circuit it acts on the inductance and on
    the capacitances, in the cut one, whose delay is exact, on the capacitances alone: half of it.
    """
    L = 0.849e-3
    plain = math.sqrt((C[0] + C[1]) / (L * C[0] * C[1]))
    shifts, rests = [], []
    for h in (H, H / 2):
        Z = L / h
        line = root_scalar(
            lambda w, h=h, Z=Z: np.sin(w * h) * (w**2 * Z**2 * C[0] * C[1] - 1.0) - np.cos(w * h) * w * Z * sum(C),
            bracket=(0.8 * plain, 1.05 * plain),
        ).root
        cut, uncut = resonance(two_buses(h, CUT, C), plain), resonance(two_buses(h, None, C), plain)
        shifts.append(cut.imag / plain - 1.0)
        rests.append(abs((1.0 + shifts[-1]) / (line / plain * math.sqrt(uncut.imag / plain)) - 1.0))
        assert 0.0 <= -cut.real < -uncut.real  # what damps is the rule, and the line has no part in it
    assert abs(shifts[0]) > 1e-3  # there is something to predict
    assert shifts[0] / shifts[1] == pytest.approx(4.0, rel=0.05)  # the next term is of fourth order
    assert rests[0] < 0.02 * abs(shifts[0])
    assert rests[0] / rests[1] > 12.0  # what neither explains is of fourth order


def test_a_direct_current_through_a_cut_is_that_of_the_resistances():
    net = circuit()
    a, b = buses(net, a=50e-6, b=20e-6)
    net.add("source", SourceBranch(R=0.1, L=1e-4), ports={"ends": a}, inputs={"e": -100.0})
    net.add("cable", RlBranch(R=0.4, L=0.849e-3), ports={"branch": Across(a, b)})
    net.conductance(b, 0.5)
    plan = assemble(net, H, parts=CUT)
    work = started(plan)
    run(plan, work, 20000)
    assert value(plan, work, "cable.i") == pytest.approx(100.0 / 2.5, rel=1e-12)
    assert value(plan, work, "cable.far.i") == pytest.approx(-100.0 / 2.5, rel=1e-12)
    assert value(plan, work, "b.v_dc") == pytest.approx(80.0, rel=1e-12)
    assert value(plan, work, "cable.v") == pytest.approx(16.0, rel=1e-12)


def test_an_alternating_current_meets_the_two_port_of_the_line_and_its_capacitance():
    """60 Hz in 600 steps. The surplus capacitance h^2 / L gives a reactive power that the uncut cable does not give."""
    h, omega, L = 1.0 / 36000.0, 2 * math.pi * 60.0, 0.849e-3

    def phasors(parts):
        net = circuit()
        a, b = buses(net, a=50e-6, b=20e-6)
        net.add("wave", Wave(peak=100.0, omega=omega))
        net.add("source", SourceBranch(R=1.0, L=1e-4), ports={"ends": a}, inputs={"e": "wave.e_alpha"})
        net.add("cable", RlBranch(R=0.0, L=L), ports={"branch": Across(a, b)})
        net.conductance(b, 0.1)
        plan = assemble(net, h, parts=parts)
        work = started(plan)
        run(plan, work, 60 * 600)
        turn = np.exp(-1j * omega * h * np.arange(600)) / 300.0
        paths = ["a.v_dc", "b.v_dc", "cable.i", *(["cable.far.i"] if parts else [])]
        v, w, i, *far = turn @ traced(plan, work, 600, paths)
        return v, w, i, -far[0] if far else i

    v, w, i, j = phasors(CUT)
    theta, Z = omega * h, L / h
    assert v == pytest.approx(w * math.cos(theta) + 1j * Z * j * math.sin(theta), rel=1e-9)
    assert i == pytest.approx(1j * w / Z * math.sin(theta) + j * math.cos(theta), rel=1e-9)

    def reactive(v, w, i, j):
        return 0.5 * (v * np.conj(i) - w * np.conj(j)).imag

    v0, w0, i0, j0 = phasors(None)
    # the source is held over a step, so that voltages are not smooth within: an error of the order of (w h)^2 = 1.1e-4
    assert reactive(v0, w0, i0, j0) == pytest.approx(0.5 * omega * L * abs(i0) ** 2, rel=4.0 * theta**2)
    surplus = reactive(v, w, i, j) - 0.5 * omega * L * 0.5 * (abs(i) ** 2 + abs(j) ** 2)
    C = h**2 / L  # half of it at each end
    assert surplus == pytest.approx(-0.5 * omega * C * 0.5 * (abs(v) ** 2 + abs(w) ** 2), rel=1e-3)


def switched(parts):
    net = circuit()
    a, b = buses(net, a=10e-3, b=10e-3)
    net.add("hold", Hold(), inputs={"wanted": net.command("c.open")})
    net.add("cable", RlBranch(R=1e-3, L=100e-6), ports={"branch": Across(a, b)}, variant="hold.value")
    return assemble(net, H, audit=H, parts=parts)


def test_a_contact_in_a_cut_interrupts_at_both_ends_at_once_and_the_books_close():
    plan = switched(CUT)
    work = started(plan, a__v_dc=110.0, b__v_dc=100.0)
    run(plan, work, 20)
    i = traced(plan, work, 1, ["cable.i", "cable.far.i"])[0]  # the contact moves a step after its command
    work.sig[plan.layout.index["command:c.open"]] = 1.0
    energy, books = sum(stored_energy(plan, work).values()), work.energy
    after = traced(plan, work, 40, ["cable.i", "cable.far.i", "a.v_dc", "b.v_dc"])
    assert i[0] > 30.0 and i[0] == pytest.approx(-i[1], rel=1e-3)
    assert np.all(after[0, :2] / i > 1.0)
    assert np.all(after[1:, :2] == 0.0)
    assert np.all(after[1:, 2:] == after[1, 2:])  # nothing rings, nothing drifts
    lost = dict(zip(plan.energy_items, work.energy - books, strict=True))["cable", "losses"]
    interrupted = 0.5 * 100e-6 * after[0, 0] ** 2
    first = i[0] + GAMMA * (after[0, 0] - i[0])  # current of the step's first stage, whose weight is 1 - gamma
    resistive = 1e-3 * H * ((1.0 - GAMMA) * first**2 + GAMMA * after[0, 0] ** 2)
    assert lost == pytest.approx(interrupted + resistive, rel=1e-6)
    left = sum(stored_energy(plan, work).values()) - energy + lost
    assert abs(left) < 2e-4 * interrupted  # the rule's damping of what rings between both buses


def test_a_contact_in_a_cut_closes_like_that_of_an_inductance_and_without_ripple():
    currents = {}
    for parts in (CUT, None):
        plan = switched(parts)
        work = started(plan, **{"command:c.open": 1.0}, a__v_dc=110.0, b__v_dc=100.0)
        assert np.all(traced(plan, work, 5, ["cable.i"]) == 0.0)
        work.sig[plan.layout.index["command:c.open"]] = 0.0
        currents[bool(parts)] = traced(plan, work, 60, ["cable.i", *(["cable.far.i"] if parts else [])])
    near, far, plain = currents[True][1:, 0], -currents[True][1:, 1], currents[False][:-1, 0]
    assert near[0] == pytest.approx(10.0 * H / 100e-6, rel=2e-3)  # 0.1 % falls at the capacitances, 0.03 % at R
    assert near == pytest.approx(plain, rel=2e-3)
    assert far == pytest.approx(plain, rel=2e-3)
    # a ripple shows in the second differences
    assert np.max(np.abs(np.diff(near, 2))) < 2.0 * np.max(np.abs(np.diff(plain, 2)))


def test_a_step_that_is_solved_again_begins_from_the_same_waves():
    """While a contact closes, the first solution leaves its own wave where the last step's was."""
    plan = switched(CUT)
    work = started(plan, **{"command:c.open": 1.0}, a__v_dc=110.0, b__v_dc=100.0)
    run(plan, work, 5)
    work.sig[plan.layout.index["command:c.open"]] = 0.0
    run(plan, work, 1)  # the position has been handed over: the next step closes
    begun = []
    for left in (0.0, 1e3):
        for part in plan.parts:
            net = part.net
            work.sig[net.line_out[0]] += left
            sig = work.sig.copy()
            first_waves.py_func(
                sig, net.line_in, net.line_sent, net.line_wave, net.line_select, net.line_before, net.line_closed
            )
            begun.append(sig[net.line_wave])
            assert not np.array_equal(sig[net.line_wave], sig[net.line_in[0]])  # it does close
    assert np.array_equal(begun[:2], begun[2:])


def test_a_cut_starts_from_a_current_under_way_as_the_uncut_circuit_does():
    rows = {}
    for parts in (CUT, None):
        plan = two_buses(H, parts, C=(10e-3, 10e-3), R=1e-3, L=100e-6)
        work = started(plan, a__v_dc=110.0, b__v_dc=100.0, cable__i=7.0)
        rows[bool(parts)] = traced(plan, work, 40, ["cable.i", "a.v_dc", "b.v_dc"])
    assert rows[True] == pytest.approx(rows[False], rel=1e-3)
    assert np.diff(rows[True][:, 0], 2) == pytest.approx(np.diff(rows[False][:, 0], 2), abs=0.05)


@pytest.mark.parametrize("R", [0.0, 0.2])
def test_the_energy_of_a_line_is_what_its_ends_take_in(R):
    """(stub-2). The powers are found without the line: from the charge that the capacitances give, stage by stage."""
    C = (50e-6, 3e-6)
    plan = two_buses(H, CUT, C, R)
    work = started(plan, a__v_dc=150.0, b__v_dc=-40.0, cable__i=3.0)
    Z, gh, weights = 0.849e-3 / H, GAMMA * H, (1.0 - GAMMA, GAMMA)
    index = plan.layout.index
    waves = [[index[f"cable.{side}.in_{k}"] for side in ("near", "far")] for k in (1, 2)]

    def energy():
        squares = [float(np.sum(work.sig[places] ** 2)) for places in waves]
        return H * Z / 4.0 * sum(b * a for b, a in zip(weights, squares, strict=True))

    bus = [index["a.v_dc"], index["b.v_dc"]]
    node = [int(np.flatnonzero(part.net.node_signal == place)[0]) for part, place in zip(plan.parts, bus, strict=True)]
    start, moved = energy(), 0.0
    entry, given = core(), arguments(plan, work)
    for _ in range(400):
        before, stored = work.sig[bus].copy(), energy()
        entry(1, 0, *given)
        begun = np.array([own.net.v_stage[k] for own, k in zip(work.parts, node, strict=True)])
        taken = 0.0
        stages = (before + (begun - before) / KAPPA, before), (work.sig[bus], begun)
        for b, (v, v_start) in zip(weights, stages, strict=True):
            i = -np.array(C) * (v - v_start) / gh
            taken += H * b * float(v @ i - R * i[0] ** 2)
        assert energy() - stored == pytest.approx(taken, abs=1e-12 * start)
        moved += abs(taken)
    assert moved > 10.0 * start  # it went to and fro


def random_plant(rng):
    """Three parts in a row: a cable and the grid side of a filter are cut. Values over the decades of any plant."""

    def decades(low, high):
        return float(10.0 ** rng.uniform(low, high))

    net = circuit()
    found = []
    for name in "abc":
        bus = net.dc_bus(name, 200.0)
        net.capacitance(bus, 0.0 if rng.random() < 0.2 else decades(-9.0, -1.5))
        if rng.random() < 0.5:
            net.conductance(bus, decades(-6.0, 1.0))
        net.add(f"shunt_{name}", RlBranch(R=decades(-4.0, 1.0), L=decades(-6.0, 0.0)), ports={"branch": bus})
        found.append(bus)
    R = 0.0 if rng.random() < 0.5 else decades(-6.0, 0.0)
    net.add("cable", RlBranch(R=R, L=decades(-6.0, -2.0)), ports={"branch": Across(found[0], found[1])})
    values = {k: decades(*v) for k, v in {"L_1": (-6, -2), "R_1": (-4, 0), "C": (-9, -3), "L_2": (-6, -2)}.items()}
    lcl = type(FILTER)(**values, R_d=decades(-4, 1), R_2=decades(-5, 0))
    net.add("filter", lcl, ports={"converter": found[1], "grid": found[2]})
    return assemble(net, H, parts={"one": ["a"], "two": ["b"], "three": ["c"]})


def test_no_cut_makes_a_passive_circuit_unstable():
    rng = np.random.default_rng(7)
    matrices = (step_matrix(random_plant(rng)) for _ in range(40))
    # eigenvalues near 1, of slow circuits, in a matrix that is not symmetric: far above rounding, far below growth
    assert max(np.max(np.abs(np.linalg.eigvals(matrix))) for matrix in matrices) <= 1.0 + 1e-9


def test_one_wave_for_both_stages_would_be_unstable_between_small_capacitances():
    C = (20e-9, 50e-9)  # 1 uF is the surplus of the line
    own, held = (np.abs(np.linalg.eigvals(step_matrix(two_buses(H, CUT, C), held))) for held in (False, True))
    assert max(own) <= 1.0 + 1e-9
    assert max(held) > 1.4


def test_a_resistance_in_the_line_damps_as_it_does_in_a_branch():
    values = {"C": (10e-3, 10e-3), "R": 1e-3, "L": 100e-6}
    cut = resonance(two_buses(H, CUT, **values), 1414.0)
    assert cut.real == pytest.approx(-values["R"] / (2.0 * values["L"]), rel=1e-3)


def filtered(h, parts, pole):
    """A filter that is cut at its grid terminal if its other one is the pole of a bridge, else at that other one."""
    net = circuit()
    a, b = buses(net, a=2e-3, b=49.7e-6)
    net.add("source", SourceBranch(R=0.5, L=2e-3), ports={"ends": a}, inputs={"e": -150.0})
    net.add("hold", Hold(), inputs={"wanted": 0.8})
    ports = {"converter": Pole(a, "hold.s") if pole else a, "grid": b}
    net.add("filter", FILTER, ports=ports, variant=net.command("filter.position"))
    net.conductance(b, 0.1)
    return assemble(net, h, parts=parts)


CASES = {"closed": (0, True), "open": (1, True), "precharge": (2, True), "idle": (3, True), "other side": (0, False)}


@pytest.mark.parametrize("name", CASES)
def test_a_filter_that_is_cut_converges_to_the_uncut_one(name):
    """In every position of its contacts, from rest to 4.2 ms, when the charge has passed through once."""
    position, pole = CASES[name]
    paths = ["a.v_dc", "b.v_dc", "filter.i_1", "filter.v_c", "filter.i_2"]

    def states(h, parts):
        plan = filtered(h, parts, pole)
        if plan.partition:
            assert [end.terminal for end in plan.partition.parts[0].ends] == ["grid" if pole else "converter"]
        work = started(plan, **{"command:filter.position": float(position)})
        run(plan, work, round(4.2e-3 / h))
        return work.sig[[plan.layout.index[path] for path in paths]]

    exact, plain = states(H / 32, None), states(H / 4, None)
    scale = np.maximum(np.abs(exact), 1.0)
    errors = np.array([np.abs(states(h, CUT) - exact) / scale for h in (H / 2, H / 4)])
    assert np.max(errors[1]) < 2e-3
    if name in ("open", "idle"):  # no current in the line: what is left is the rule's own error
        assert exact[4] == 0.0
        assert errors[1] == pytest.approx(np.abs(plain - exact) / scale, abs=1e-12)
    else:
        assert np.linalg.norm(errors[1]) > 1e-5
        assert np.linalg.norm(errors[0]) / np.linalg.norm(errors[1]) == pytest.approx(4.0, rel=0.15)
