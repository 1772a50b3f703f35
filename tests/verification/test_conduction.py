"""Blocked legs in the network: natural rectification, floating legs, freewheeling, and the power of it all."""

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
from shipgrid.components.converters.two_level_bridge import HalfBridge, TwoLevelBridge
from shipgrid.components.electrical.choke import Choke
from shipgrid.components.machines.pmsm import Pmsm
from shipgrid.components.sources.dc_source import DcSource
from shipgrid.errors import TopologyError
from shipgrid.model.kernel import uncompiled
from shipgrid.model.network import Network
from shipgrid.model.placed import Sampled
from shipgrid.modulators.time_stamped import Carrier, TimeStampedLeg
from shipgrid.solvers.conduction import ALL_AT_ONCE, stands_still, wait_for_gates
from verification.circuits import Gates, LegGates, Sampler, SourceBranch, Wave

OMEGA = 2.0 * math.pi * 60.0
PEAK = 480.0 * math.sqrt(2.0 / 3.0)
MEAN = 3.0 * math.sqrt(2.0) / math.pi * 480.0
"""Mean of the six-pulse voltage without load, 648 V."""


def stepped(plan, work, seconds, names, rounds=None):
    """Values of signals after every step."""
    places = [plan.layout.index[name] for name in names]
    entry, values = core(), arguments(plan, work)
    rows = np.empty((round(seconds / plan.h), len(names)))
    for k in range(len(rows)):
        assert entry(1, work.n, *values) == 1
        work.n += 1
        work.step.rows[:] = 0
        rows[k] = work.sig[places]
        if rounds is not None:
            rounds.append(int(work.net.conduct[1]))
    return dict(zip(names, rows.T, strict=True))


def start(net, step, **voltages):
    plan = assemble(net, step)
    work = new_workspace(plan)
    for name, value in voltages.items():
        work.sig[plan.layout.index[f"{name}.v_dc"]] = value
    settle_outputs(plan, work)
    return plan, work


def six_pulse(step, *, L=0.3e-3, R=0.0, C=0.0, load=(10.0, 0.0)):
    """Grid behind R-L, blocked bridge, a capacitor or none, and a load of (R, L)."""
    net = Network("six-pulse rectifier")
    bus = net.dc_bus("bus", 750.0)
    net.capacitance(bus, C)
    net.add("grid", Wave(peak=PEAK, omega=OMEGA))
    net.add("gates", Gates())
    poles = net.bridge("bridge", TwoLevelBridge(), bus, modulator="gates")
    net.add_three_phase(
        "line", SourceBranch(R=R, L=L), ports={"ends": poles}, inputs={"e": ("grid.e_alpha", "grid.e_beta")}
    )
    if load[1] > 0.0:
        net.add("load", SourceBranch(R=load[0], L=load[1]), ports={"ends": bus})
    else:
        net.conductance(bus, 1.0 / load[0])
    return start(net, step)


@pytest.mark.parametrize("current", [20.0, 60.0, 120.0])
def test_mean_of_a_loaded_diode_bridge_is_that_of_the_commutation_formula(current):
    """On a smoothed current I the mean is 648 V - 3/pi omega L I; the bus has no capacitor to help."""
    L = 0.3e-3
    expected = MEAN - 3.0 / math.pi * OMEGA * L * current
    plan, work = six_pulse(10e-6, L=L, load=(expected / current, 40.0 * expected / current / 1000.0))
    stepped(plan, work, 0.25, [])  # six time constants of the load
    found = stepped(plan, work, 0.05, ["bus.v_dc", "load.i"])
    i = found["load.i"].mean()
    assert np.ptp(found["load.i"]) < 0.02 * i  # smoothed, as the formula has it
    assert found["bus.v_dc"].mean() == pytest.approx(MEAN - 3.0 / math.pi * OMEGA * L * i, rel=2e-3)


def test_without_load_the_capacitor_is_charged_to_the_line_peak():
    plan, work = six_pulse(30e-6, L=1e-3, R=1.0, C=1e-3, load=(1e7, 0.0))
    work.sig[plan.layout.index["bus.v_dc"]] = 670.0
    found = stepped(plan, work, 2.0, ["bus.v_dc"])
    peak = math.sqrt(2.0) * 480.0
    assert np.all(np.diff(found["bus.v_dc"]) > -1e-5)  # rises, but for what 70 uA take in a step
    assert found["bus.v_dc"][-1] == pytest.approx(peak, rel=1e-3)  # the last volt comes slowly: ever shorter pulses


def test_thirty_microseconds_agree_with_one_and_the_error_falls_with_the_step():
    found = {}
    for step in (30e-6, 10e-6, 3e-6, 1e-6):
        plan, work = six_pulse(step, L=1e-3, R=0.05, C=2e-3, load=(10.0, 0.0))
        core()(round(0.25 / step), 0, *arguments(plan, work))
        work.n = round(0.25 / step)
        work.step.rows[:] = 0
        rounds: list[int] = []
        run = stepped(plan, work, 0.05, ["bus.v_dc", "line.alpha.i"], rounds)
        rms = math.sqrt(np.mean(run["line.alpha.i"] ** 2))
        found[step] = np.array([run["bus.v_dc"].mean(), np.ptp(run["bus.v_dc"]), rms])
        assert np.mean(rounds) < 1.05  # twelve changes of state in a period of 555 steps
        assert max(rounds) < ALL_AT_ONCE
    error = {step: np.abs(found[step] / found[1e-6] - 1.0) for step in found}
    assert error[30e-6][0] < 1e-5
    assert error[30e-6][1] < 1e-3  # ripple
    assert error[30e-6][2] < 5e-4
    assert np.all(error[3e-6] < np.maximum(0.3 * error[30e-6], 2e-5))  # below: where the period ends in the window


def test_a_bridge_without_current_floats_and_takes_no_part():
    """A bus above the line peak: nothing flows, and no leg changes state."""
    plan, work = six_pulse(30e-6, L=1e-3, R=0.05, C=2e-3, load=(1e6, 0.0))
    work.sig[plan.layout.index["bus.v_dc"]] = 700.0
    rounds: list[int] = []
    found = stepped(plan, work, 0.02, ["line.alpha.i", "line.beta.i", "bridge.p_dc"], rounds)
    assert np.abs(found["line.alpha.i"]).max() < 1e-9
    assert np.abs(found["line.beta.i"]).max() < 1e-9
    assert max(rounds) == 1


def test_current_drawn_from_the_bus_is_the_poles_power_through_every_commutation():
    """The capacitor's charge, step by step, against the bridge's own meter, which measures at the poles."""
    C = 2e-3
    plan, work = six_pulse(30e-6, L=1e-3, R=0.05, C=C, load=(1e12, 0.0))
    work.sig[plan.layout.index["bus.v_dc"]] = 400.0
    found = stepped(plan, work, 0.3, ["bus.v_dc", "bridge.i_dc"])
    charge = C * np.diff(found["bus.v_dc"], prepend=400.0) / plan.h
    assert np.abs(found["bridge.i_dc"]).max() > 100.0
    assert np.abs(charge + found["bridge.i_dc"]).max() < 1e-6 * np.abs(charge).max()
    # the share of a landing current is taken at the bus voltage of the step's start: what that leaves over 10 000 steps
    energy = np.sum((charge + found["bridge.i_dc"]) * found["bus.v_dc"]) * plan.h
    assert abs(energy) < 1e-9 * 596e3 * 0.3


def test_a_turning_motor_charges_its_bus_to_the_peak_of_its_line_voltage():
    """models.md 6: 449 V line-to-line at 450 rpm, 635 V peak; blocked gates, bus at 500 V to begin with."""
    net = Network("windmilling motor")
    bus = net.dc_bus("bus", 750.0)
    net.capacitance(bus, 5e-3)
    net.conductance(bus, 1.0 / 5e3)
    net.add("gates", Gates())
    poles = net.bridge("bridge", TwoLevelBridge(), bus, modulator="gates")
    net.add_three_phase("motor", Pmsm(), ports={"stator": poles}, inputs={"omega_m": 2.0 * math.pi * 7.5})
    plan, work = start(net, 30e-6, bus=500.0)
    found = stepped(plan, work, 1.0, ["bus.v_dc", "motor.tau_e", "bridge.p_fed"])
    peak = math.sqrt(3.0) * 3.0 * 2.0 * math.pi * 7.5 * 2.595
    assert peak == pytest.approx(635.4, abs=0.5)
    # charged by a resonance of 1.8 mH with 5 mF it overshoots the peak, is held by the diodes, and bleeds down to it
    assert found["motor.tau_e"].min() < -1000.0  # braking
    assert found["bridge.p_fed"].max() > 50e3
    assert found["bus.v_dc"].min() >= 500.0 - 1e-6
    assert np.all(np.diff(found["bus.v_dc"][-2000:]) < 0.0)  # only the bleeder acts
    work.sig[plan.layout.index["bus.v_dc"]] = peak + 2.0
    quiet = stepped(plan, work, 0.05, ["motor.i_alpha"])
    assert np.abs(quiet["motor.i_alpha"]).max() < 1e-9  # models.md 6, check 2: no diode conducts above the peak


def test_a_short_circuited_bus_discharges_and_then_freewheels_through_the_diodes():
    """models.md 10: 750 V, 10 mF, 10 mohm, 20 uH: 14.23 kA at 0.656 ms, 13.88 kA at 0.757 ms, then the diodes."""
    R, L, C = 10e-3, 20e-6, 10e-3
    for step, tolerance in ((30e-6, 2e-3), (3e-6, 2e-4)):
        net = Network("short circuit")
        bus = net.dc_bus("bus", 750.0)
        net.capacitance(bus, C)
        net.add("aside", Wave(peak=PEAK, omega=OMEGA))  # the same types, and so the same module, as a rectifier
        net.add("gates", Gates())
        bridge = TwoLevelBridge()
        poles = net.bridge("bridge", bridge, bus, modulator="gates")
        net.add_three_phase("choke", SourceBranch(R=0.1, L=1e-3), ports={"ends": poles})
        net.add("fault", SourceBranch(R=R, L=L), ports={"ends": bus})
        plan, work = start(net, step, bus=750.0)
        found = stepped(plan, work, 4e-3, ["fault.i", "bus.v_dc"])
        t = plan.h * np.arange(1, len(found["fault.i"]) + 1)
        peak = int(np.argmax(found["fault.i"]))
        assert found["fault.i"][peak] == pytest.approx(14.23e3, rel=2e-3 + tolerance)
        assert t[peak] == pytest.approx(0.656e-3, abs=step)
        after = int(np.argmax(found["bus.v_dc"] < 0.0))
        assert t[after] == pytest.approx(0.757e-3, abs=1.5 * step)
        # then the current decays in the cable's resistance and the diodes': two in series, three legs side by side
        R_path = R + 2.0 / 3.0 * bridge.R_d
        decay = np.log(found["fault.i"][after + 10] / found["fault.i"][-1]) / (t[-1] - t[after + 10])
        assert decay == pytest.approx(R_path / L, rel=10.0 * tolerance)
        assert found["bus.v_dc"].min() > -2.0 / 3.0 * bridge.R_d * 14.3e3


@pytest.mark.parametrize("R", np.geomspace(0.05, 5.0, 12).tolist())
def test_diodes_of_a_reversed_bus_let_go_again_and_their_losses_are_booked(R):
    """A source behind R and 1 mH feeds the fault: it reverses the bus, the diodes take over, and then let go."""
    net = Network("fed short circuit")
    bus = net.dc_bus("bus", 750.0)
    net.capacitance(bus, 10e-3)
    net.add("aside", Wave(peak=PEAK, omega=OMEGA))
    net.add("gates", Gates())
    poles = net.bridge("bridge", TwoLevelBridge(), bus, modulator="gates")
    net.add_three_phase("choke", SourceBranch(R=0.1, L=1e-3), ports={"ends": poles})
    net.add("fault", SourceBranch(R=10e-3, L=20e-6), ports={"ends": bus})
    net.add("source", SourceBranch(R=R, L=1e-3), ports={"ends": bus}, inputs={"e": -750.0})
    plan = assemble(net, 5e-6, audit=5e-6)
    work = new_workspace(plan)
    work.sig[plan.layout.index["bus.v_dc"]] = 750.0
    settle_outputs(plan, work)
    before = sum(stored_energy(plan, work).values())
    rounds: list[int] = []
    found = stepped(plan, work, 0.03, ["bus.v_dc", "bridge.i_r", "bridge.i_dc", "fault.i"], rounds)
    carried = found["bridge.i_r"] > 0.0
    assert carried.any()
    assert not carried[-1]  # the source's current has taken over the fault, and the bus is positive
    assert found["bus.v_dc"][-1] > 0.0
    assert np.allclose(found["bridge.i_dc"][carried], -found["bridge.i_r"][carried], rtol=1e-9)
    assert max(rounds) <= 3
    ledger = dict(zip(plan.energy_items, work.step.energy, strict=True))
    supplied = ledger["source", "supplied"]
    lost = sum(value for (_, kind), value in ledger.items() if kind == "losses")
    after = sum(stored_energy(plan, work).values())
    assert ledger["bridge", "losses"] > 10.0
    # rectangles of 5 us under a discharge of 0.65 ms, and what the solver's rule damps
    assert before + supplied == pytest.approx(lost + after, rel=0.01)


def test_two_bridges_at_one_element_are_refused():
    net = Network("full bridge")
    bus = net.dc_bus("bus", 750.0)
    net.add("gates", LegGates())
    ends = [net.half_bridge(name, HalfBridge(), bus, modulator="gates") for name in ("left", "right")]
    net.add("choke", Choke(L=1e-3, R=0.1), ports=dict(zip(("a", "b"), ends, strict=True)))
    with pytest.raises(TopologyError, match="left and right feed the same element"):
        assemble(net, 30e-6)


def test_a_blocked_leg_charges_a_dead_bus_in_one_half_wave_and_then_holds_it():
    """Battery, choke, upper diode, capacitor: half a period of the resonance; the current lands on zero for good."""
    E, R, L, C = 474.0, 0.05, 0.8e-3, 10e-3
    net = Network("leg")
    bus = net.dc_bus("bus", 750.0)
    net.capacitance(bus, C)
    net.add("gates", LegGates())
    pole = net.half_bridge("leg", HalfBridge(), bus, modulator="gates")
    net.add("choke", SourceBranch(R=R, L=L), ports={"ends": pole}, inputs={"e": -E})
    plan, work = start(net, 30e-6)
    found = stepped(plan, work, 0.05, ["bus.v_dc", "choke.i", "leg.s"])
    a = R / (2.0 * L)
    w = math.sqrt(1.0 / (L * C) - a**2)
    assert found["bus.v_dc"][-1] == pytest.approx(E * (1.0 + math.exp(-a * math.pi / w)), rel=1e-4)
    assert found["choke.i"].max() <= 0.0  # counted out of the leg: no current ever back into the battery
    assert found["choke.i"].min() == pytest.approx(
        -E / (w * L) * math.exp(-a * math.atan2(w, a) / w) * math.sin(math.atan2(w, a)), rel=1e-3
    )
    landed = int(np.argmax(found["choke.i"] > -1e-6))
    assert 30e-6 * landed == pytest.approx(math.pi / w, abs=60e-6)
    assert np.abs(found["choke.i"][landed + 1 :]).max() < 1e-9
    assert found["leg.s"][-1] * found["bus.v_dc"][-1] == pytest.approx(
        E, rel=1e-9
    )  # it floats at the battery's voltage


def test_a_driven_bridge_does_what_ideal_poles_do():
    """Bounds that are equal leave nothing to the diodes: v = s v_dc, i_dc = s i in every step."""
    plan, work = six_pulse(30e-6, L=1e-3, R=0.05, C=2e-3, load=(10.0, 0.0))
    work.sig[plan.layout.index["bus.v_dc"]] = 600.0
    rng = np.random.default_rng(5)
    index = plan.layout.index
    for _ in range(50):
        s = rng.random(3)
        for leg, value in zip("abc", s, strict=True):
            work.sig[[index[f"gates.lo_{leg}"], index[f"gates.hi_{leg}"]]] = value
        found = stepped(plan, work, 30e-6, ["bridge.s_alpha", "bridge.s_beta", "line.alpha.v", "bus.v_dc"])
        assert found["bridge.s_alpha"][0] == pytest.approx((2.0 * s[0] - s[1] - s[2]) / 3.0, abs=1e-15)
        assert found["bridge.s_beta"][0] == pytest.approx((s[1] - s[2]) / math.sqrt(3.0), abs=1e-15)
        assert found["line.alpha.v"][0] == pytest.approx(found["bridge.s_alpha"][0] * found["bus.v_dc"][0], rel=1e-12)
        assert work.net.conduct[0] == 0


def test_gates_that_are_blocked_under_current_hand_it_to_the_diodes():
    """From driving a current the bridge goes on as a rectifier: currents are continuous, the energy goes to the bus."""
    plan, work = six_pulse(30e-6, L=1e-3, R=0.05, C=2e-3, load=(1e6, 0.0))
    index = plan.layout.index
    work.sig[index["bus.v_dc"]] = 750.0
    gates = [index[f"gates.{bound}_{leg}"] for leg in "abc" for bound in ("lo", "hi")]
    work.sig[gates] = 0.5
    stepped(plan, work, 0.0021, [])
    names = ["line.alpha.i", "line.beta.i", "bus.v_dc", "bridge.p_fed"]
    before = stepped(plan, work, 30e-6, names)
    work.sig[gates] = [0.0, 1.0] * 3
    after = stepped(plan, work, 0.02, names)
    moved = abs(after["line.alpha.i"][0] - before["line.alpha.i"][0])
    assert abs(before["line.alpha.i"][0]) + abs(before["line.beta.i"][0]) > 100.0
    assert moved < (750.0 + PEAK) / 1e-3 * 30e-6  # no jump: what the voltages give in a step
    assert after["bridge.p_fed"][0] > 0.0
    assert abs(after["line.alpha.i"][-1]) < 1e-9  # the bus is above the line peak: it ends with the current at zero
    assert after["bus.v_dc"][-1] > 750.0


LOWER, UPPER = 2.0, 3.0


def one_switch(gates, duty, ohms, step):
    """A leg at 5 kHz with one switch driven: boost from 474 V or buck from 750 V, 100 uF, and a resistor."""
    net = Network("one switch")
    dc = net.dc_bus("dc", 750.0)
    net.add("carrier", Carrier(), clock=Sampled(5e3))
    phase = {name: f"carrier.{name}" for name in ("phase", "phase_next", "turns")}
    net.add("meter", Sampler(), inputs={"v": "choke.i"}, clock=Sampled(5e3))
    inputs = {"s_ref": duty, "gates": gates, **phase}
    net.add("modulator", TimeStampedLeg(), inputs=inputs, initial={"active": duty}, clock=Sampled(5e3))
    pole = net.half_bridge("leg", HalfBridge(), dc, modulator="modulator")
    low, fed = net.dc_bus("low", 750.0), gates == UPPER
    net.add("source", DcSource(v_0=750.0 if fed else 474.0, R=0.01), a=dc if fed else low)
    net.add("choke", Choke(R=0.25, L=0.8e-3), a=pole, b=low)
    loaded = low if fed else dc
    net.capacitance(loaded, 1e-4)
    net.conductance(loaded, 1.0 / ohms)
    return start(net, step, **({"dc": 750.0, "low": 400.0} if fed else {"dc": 600.0, "low": 474.0}))


@pytest.mark.parametrize(("gates", "bus"), [(LOWER, "dc.v_dc"), (UPPER, "low.v_dc")])
@pytest.mark.parametrize(("share", "ohms"), [(0.1, 300.0), (0.1, 60.0), (0.3, 300.0), (0.3, 60.0), (0.4, 20.0)])
def test_one_driven_switch_at_thirty_microseconds_has_the_mean_of_one(gates, bus, share, ohms):
    """Discontinuous and continuous conduction; pulses shorter than a step, and any place of them in it."""
    found = []
    for step in (30e-6, 7e-6, 1e-6):
        plan, work = one_switch(gates, 1.0 - share if gates == LOWER else share, ohms, step)
        settled = round(0.08 / step)
        core()(settled, 0, *arguments(plan, work))
        work.n, work.step.rows[:] = settled, 0
        run = stepped(plan, work, 0.012, [bus, "meter.sample", "choke.i"])
        found.append([run[bus].mean(), run["meter.sample"].mean(), np.ptp(run["choke.i"])])
    coarse, middle, fine = found
    assert abs(coarse[0] / fine[0] - 1.0) < 0.01  # 0.8 % for the buck's shortest pulse at the least load; else 0.4 %
    assert abs(middle[0] / fine[0] - 1.0) < 1e-4
    # what a controller samples, in the middle of boost's pulse and of buck's pause: 0.08 % of the ripple
    assert abs(coarse[1] - fine[1]) < 1e-3 * fine[2]
    assert abs(middle[1] - fine[1]) < 1e-3 * fine[2]


def test_a_leg_without_current_waits_for_its_switch():
    """From rest, in the step with the first pulse, the current is what the pulse gives: e (1 - wait) h / L."""
    plan, work = one_switch(LOWER, 0.9, 300.0, 30e-6)
    found = stepped(plan, work, 210e-6, ["choke.i", "modulator.wait", "leg.s"])
    # on for 10 us from time zero (the carrier's crest); then at rest from some 50 us on; on again from 190 us
    assert found["modulator.wait"][:7] == pytest.approx([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0 / 3.0], abs=1e-9)
    assert np.abs(found["choke.i"][2:6]).max() < 1e-9
    assert found["choke.i"][6] == pytest.approx(-474.0 * 20e-6 / 0.8e-3, rel=5e-3)  # 0.25 ohm takes a little


def test_volt_seconds_of_a_wait_land_a_current_and_then_keep_it_at_zero():
    h, rate, v_dc = 30e-6, 1.0 / 0.8e-3, 750.0
    wait_ = uncompiled(wait_for_gates)
    per_ampere = 1.0 / (rate * h * v_dc)
    assert wait_(0.6, 0.632, per_ampere, 0.0) == pytest.approx(0.6 * 0.632)
    # 3 A into the leg, which fell from 10 A at s = 1 in the step before: stands still at what that says
    rest = uncompiled(stands_still)(per_ampere, 1.0, -10.0, -3.0)
    assert rest == pytest.approx(1.0 - 7.0 * 0.8e-3 / (30e-6 * 750.0))
    assert wait_(0.6, rest, per_ampere, -3.0) == pytest.approx(0.6 * rest + 3.0 * per_ampere)
    assert wait_(0.6, rest, per_ampere, -50.0) == 0.6  # conducts throughout
    assert wait_(0.6, rest, per_ampere, 50.0) == 0.0
