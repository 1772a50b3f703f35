"""A bar of the hotel grid with shore, a pump, and a galley of constant power: picked up, synchronised, handed over.

One inverter on a stiff DC bus; one day of switching, each event judged in its own window.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import shipgrid as sg
from scenarios.story import Story, ship_of
from shipgrid.errors import InputErrors
from shipgrid.model.network import Network

HARBOUR = """
schema: 1
ship: harbour
buses:
  dc: {kind: dc, v_n: 750 V, capacitance: 1000 F}
  ac: {kind: ac, v_n: 400 V, f_n: 60 Hz}
equipment:
  bess: {kind: bess, bus: dc}
  # The gains for motors of docs/theory/loads.md.
  inverter:
    kind: inverter
    bus: dc
    grid: ac
    control: {R_v: 0.25 pu, omega_RV: 11 rad/s, K_pv: 0.5 pu, K_iv: 120 1/s, F_i: 0.86}
  lights: {kind: ac_load, bus: ac, p: 8 kW, power_factor: 0.9}
  galley: {kind: ac_load, bus: ac, p: 6 kW, power_factor: 0.95, model: voltage_dependent}
  pump: {kind: ac_motor, bus: ac, p: 4 kW}
  shore: {kind: shore_connection, bus: ac}
"""
EXAMPLE = Path(__file__).parents[2] / "examples" / "harbour"
STEP, EVERY = 60e-6, 6
V_B = 400.0 * math.sqrt(2.0 / 3.0)
BAR = ["ac.v_alpha", "ac.v_beta"]
CURRENTS = [f"inverter.filter.{axis}.i_1" for axis in ("alpha", "beta")]


class Day:
    """What was asked when, and what came of it."""

    def __init__(self):
        self.story = Story(ship_of(HARBOUR), STEP, every=EVERY, watch=BAR + CURRENTS)
        self.asked = {}

    def then(self, what, seconds, **commands):
        self.asked[what] = self.story.now
        self.story.set(**commands).go(seconds)
        return self

    def event(self, owner, text, after):
        """Time of an item's first event that says so, after something was asked."""
        said = (t for t, who, what in self.story.events if who == owner and text in what and t > self.asked[after])
        return next(said)

    def history(self, name, since, until):
        return self.story.history(name, since, until)[1]

    def mean(self, name, at):
        """Mean over 50 ms."""
        return self.history(name, at - 0.05, at).mean()

    def length(self, since, until):
        return np.hypot(*(self.history(name, since, until) for name in BAR)) / V_B


@pytest.fixture(scope="module")
def day():
    day = Day()
    day.then("black start", 3.0, inverter__on=1)
    day.then("pump", 2.0, pump__on=1)
    day.then("shore", 15.0, shore__close=1)
    day.then("inverter off", 2.0, inverter__on=0)
    day.then("inverter joins", 12.0, inverter__on=1)
    day.then("leave", 8.0, shore__close=0)
    day.then("pump off", 1.0, pump__on=0)
    day.then("dark", 3.0, inverter__on=0)
    day.then("black bar", 1.0, shore__close=1)
    return day


@pytest.mark.full  # one compiled module of its own: a minute
def test_a_pump_starts_direct_on_line_on_an_inverter(day):
    """Six times its current at a bar that the inverter's limit pulls down; then the slip of its torque."""
    on = day.asked["pump"]
    i, v = day.history("pump.i_rms", on, on + 1.0), day.length(on, on + 1.0)
    running = day.mean("pump.i_rms", on + 2.0)
    assert 5.0 * running < i[10:].max() < 12.0 * running
    assert 0.6 < v[100:].min() < 0.85
    bridge = np.hypot(*(day.history(name, on, on + 1.0) for name in CURRENTS))
    assert bridge.max() < 1.35 * math.sqrt(2.0 / 3.0) * 50e3 / 400.0  # the limit of 1.25 pu, and its first ripple
    omega, f = day.mean("pump.omega", on + 2.0), day.mean("inverter.f", on + 2.0) / 60.0
    assert 1.0 - omega / f == pytest.approx(0.035, abs=0.01)
    assert day.length(on + 1.5, on + 2.0).mean() > 0.97


@pytest.mark.full
def test_the_shore_is_synchronised_and_takes_the_whole_load_along_a_line_of_ten_seconds(day):
    asked, closed = day.asked["shore"], day.event("shore", "closed", "shore")
    assert day.event("shore", "synchronising", "shore") < closed < asked + 5.0
    before = day.mean("inverter.p_ac", asked)
    jump = np.abs(day.history("shore.p_ac", closed, closed + 0.1)).max()
    assert jump < 0.05 * 50e3  # within 2 degrees and 1 %
    p_shore = [day.mean("shore.p_ac", closed + t) for t in (2.5, 5.0, 7.5)]
    assert p_shore == pytest.approx([before * share for share in (0.25, 0.5, 0.75)], abs=0.05 * before)
    end = closed + 12.5
    assert abs(day.mean("inverter.p_ac", end)) < 0.005 * 50e3
    total = sum(day.mean(f"{load}.p_ac", end) for load in ("lights", "galley", "pump"))
    assert day.mean("shore.p_ac", end) + day.mean("inverter.p_ac", end) == pytest.approx(total, rel=1e-3)
    assert day.mean("inverter.f", end) == pytest.approx(60.0, abs=1e-3)
    v = day.length(asked, end)
    assert v[20:].min() > 0.97 and v.max() < 1.02
    # constant power stays what it was while the bar's voltage moves, the lights' does not
    galley, lights = (day.history(f"{load}.p_ac", asked, end) for load in ("galley", "lights"))
    assert np.abs(galley - 6e3).mean() < 1e-3 * 6e3 and np.ptp(lights) > 0.02 * 8e3
    assert np.abs(galley - 6e3).max() < 0.02 * 6e3  # while the breaker closes, faster than its filter


@pytest.mark.full
def test_an_inverter_leaves_the_load_to_the_shore_and_joins_it_again(day):
    off = day.event("inverter", "off", "inverter off")
    assert off < day.asked["inverter off"] + 1.0
    assert np.abs(np.diff(day.length(off - 0.1, off + 0.1))).max() < 0.02
    assert day.mean("shore.p_ac", off + 1.0) == pytest.approx(16.9e3, rel=0.01)
    joined = day.event("inverter", "on", "inverter joins")
    assert joined < day.asked["inverter joins"] + 6.0
    assert np.abs(day.history("inverter.p_ac", joined, joined + 0.2)).max() < 0.05 * 50e3


@pytest.mark.full
def test_leaving_the_shore_hands_the_load_back_before_the_breaker_opens(day):
    asked, opened = day.asked["leave"], day.event("shore", "open", "leave")
    assert day.event("shore", "unloading", "leave") < opened < asked + 4.0
    assert abs(day.mean("shore.p_ac", opened)) < 0.06 * 50e3
    end = asked + 8.0
    assert day.mean("shore.p_ac", end) == 0.0
    total = sum(day.mean(f"{load}.p_ac", end) for load in ("lights", "galley", "pump"))
    assert day.mean("inverter.p_ac", end) == pytest.approx(total, rel=2e-3)
    assert day.length(asked, end).min() > 0.93


@pytest.mark.full
def test_a_dead_bar_is_picked_up_from_the_shore_at_once(day):
    closed = day.event("shore", "closed", "black bar")
    assert closed - day.asked["black bar"] < 0.2
    at = closed + 0.9
    assert day.length(at - 0.05, at).mean() == pytest.approx(0.993, abs=0.003)
    assert day.mean("shore.p_ac", at) == pytest.approx(13.9e3, rel=0.01)
    impedance = complex(0.0225 + 0.006, 0.08 + 0.0314)  # (1) of the connection: transformer, cable, grid ashore
    s = complex(day.mean("shore.p_ac", at), day.mean("shore.q_ac", at))
    v = day.length(at - 0.05, at).mean() * 400.0
    assert abs(v + impedance * s.conjugate() / v) == pytest.approx(400.0, rel=1e-3)


def test_the_parts_of_a_harbour_are_laid_out_as_their_file_says():
    net = Network("harbour")
    ship_of(HARBOUR, **{"equipment.galley.dependence.alpha_p": "1.5", "equipment.shore.S_sc": "2 MVA"}).build(net)
    load, supply = net.placed["galley.load"].item, net.placed["shore.supply"].item
    assert (load.p_0, load.power_factor, load.v_n, load.alpha_p) == (6e3, 0.95, 400.0, 1.5)
    assert math.hypot(supply.R, 2.0 * math.pi * 60.0 * supply.L) == pytest.approx(400.0**2 / 2e6, rel=1e-12)
    assert net.placed["pump.machine"].item.p_n == 4e3
    assert net.placed["shore.sequence"].item.t_decay == 10.0 and net.placed["shore.sequence"].item.S_n == 50e3
    assert net.placed["inverter.control"].inputs["dw_sync"] == "shore.sequence.dw_sync"


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("equipment.lights.dependence.z_p", "0.5", r"z_p = 0.5 is read only with `model: voltage_dependent`"),
        ("equipment.galley.dependence.p_0", "5 kW", r"dependence.p_0 = 5000 is set by ac_load.p"),
        ("equipment.pump.machine.v_n", "380 V", r"machine.v_n = 380 is set by ac_motor.bus"),
        ("equipment.galley.model", "zip", "'zip'"),
    ],
)
def test_options_that_cannot_be_are_refused(path, value, reason):
    with pytest.raises(InputErrors, match=reason):
        ship_of(HARBOUR, **{path: value})


def test_two_that_would_move_one_bar_are_refused():
    with pytest.raises(InputErrors, match="shore and other both move ac"):
        ship_of(HARBOUR + "  other: {kind: shore_connection, bus: ac}\n")


def example():
    ship = sg.load_ship(EXAMPLE / "ferry.yaml")
    return ship, sg.load_scenario(EXAMPLE / "alongside.yaml", ship)


def test_the_ferry_in_harbour_is_the_bundled_one_and_three_more_items():
    ship, _ = example()
    bundled = sg.load_ship("ferry")
    assert {name: item for name, item in ship.equipment.items() if name in bundled.equipment} == bundled.equipment
    assert sorted(set(ship.equipment) - set(bundled.equipment)) == ["galley", "pump", "shore"]


@pytest.mark.full
def test_a_stay_at_berth_keeps_its_bands(tmp_path):
    run = sg.simulate(*example(), out=tmp_path / "alongside")
    assert run.ok, [r for r in run.requirements if r["verdict"] != "met"]
    assert abs(run.summary["energy_balance_error"]) < 1e-3
