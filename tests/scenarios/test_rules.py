"""Rules of power management at work: what a drive does when a source is lost, and a genset that starts by itself."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

import shipgrid as sg
from scenarios import killed_runs
from scenarios.story import RING, Story, ship_of
from scenarios.test_resume import same
from shipgrid.automation.load_limit import NOBODY
from shipgrid.automation.power_management import BlackoutPrevention
from shipgrid.scenarios import session
from shipgrid.scenarios.case import build

TUG = """
schema: 1
ship: tug
buses:
  dc: {kind: dc, v_n: 750 V}
equipment:
  bess_one: {kind: bess, bus: dc}
  bess_two: {kind: bess, bus: dc}
  drive: {kind: propulsion, bus: dc, propeller: screw}
hull: {}
"""
STEP = 50e-6  # divides the millisecond of the limiter and the 10 of the sequence: they look at the same instants
RATED = 128.0
KNOT = 1852.0 / 3600.0


def tug(*rules):
    """The tug at 9.5 kn on both batteries, at three quarters of their rated currents."""
    ship = ship_of(TUG)
    story = Story(ship, plan=build(ship, STEP, rules=rules), every=16)
    story.work.sig[story.index["hull.surge.u_ship"]] = 9.5 * KNOT
    story.set(bess_one__on=1, bess_two__on=1, drive__speed_ref=9.5 * KNOT).go(0.5)
    return story.set(drive__on=1).go(14.5)


@pytest.fixture
def guarded():
    return tug(BlackoutPrevention())


def lose(story, battery):
    """A contactor that opens by itself, as a fuse would: no command, no ramp."""
    story.work.sig[story.index[f"{battery}.sequence.state"]] = 0.0
    story.set(**{f"{battery}__on": 0})
    return story.now


def test_when_a_battery_is_lost_the_other_one_is_at_its_rating_within_a_fifth_of_a_second(guarded):
    assert 0.65 * RATED < guarded["bess_one.i_b"] < 0.85 * RATED
    at = lose(guarded, "bess_two")
    guarded.go(1.5)
    _, i_b = guarded.history("bess_one.i_b", since=at)
    _, later = guarded.history("bess_one.i_b", since=at + 0.2)
    _, v_dc = guarded.history("dc.v_dc", since=at)
    assert i_b.max() > 1.2 * RATED  # it would have been overloaded
    assert later.max() < 1.02 * RATED
    assert later[-1] == pytest.approx(RATED, rel=2e-3)
    assert v_dc.min() > 690.0  # the drive's own limit, within a step, holds it there
    assert (at, "blackout_prevention", "drive cut back for bess_one") in [
        (pytest.approx(t, abs=0.02), who, what) for t, who, what in guarded.events
    ]


def test_at_the_limit_nothing_hunts_and_nothing_winds_up(guarded):
    guarded.set(drive__speed_ref=12.0 * KNOT).go(90.0)
    _, i_b = guarded.history("bess_one.i_b", since=guarded.now - 10.0)
    assert i_b.max() < 1.01 * RATED and i_b.min() > 0.99 * RATED
    assert abs(guarded["drive.cruise.u_lag"] - guarded["hull.u_ship"]) < 0.1 * KNOT  # of the 3.4 kn that are missing
    assert (
        abs(guarded["drive.cruise.n_ref"] - guarded["drive.shaft.omega_pu"]) < 0.01
    )  # it asks for no more than it gets
    assert [what for _, who, what in guarded.events if who == "blackout_prevention"] == ["drive cut back for bess_one"]
    guarded.set(drive__speed_ref=8.0 * KNOT).go(20.0)  # ordered to slow down, it does
    assert guarded["bess_one.i_b"] < 0.6 * RATED
    assert guarded.when("blackout_prevention", "drive free again") > guarded.now - 10.0


@pytest.mark.full
def test_while_no_source_is_overloaded_the_rule_changes_not_a_bit(guarded):
    bare = tug()
    for name in ("dc.v_dc", "bess_one.i_b", "drive.tau_e", "hull.u_ship"):
        assert np.array_equal(guarded.history(name)[1], bare.history(name)[1]), name
    at = lose(bare, "bess_two")
    bare.go(1.5)
    _, v_dc = bare.history("dc.v_dc", since=at + 0.5)
    _, i_b = bare.history("bess_one.i_b", since=at + 0.5)
    assert i_b.min() > 1.49 * RATED and v_dc.max() < 700.0  # at its limit, on a bus that nobody holds


@pytest.mark.full
def test_in_a_ring_a_source_counts_as_long_as_one_way_to_the_drive_is_closed():
    ship = ship_of(RING)
    ring = Story(ship, plan=build(ship, STEP, rules=[BlackoutPrevention()]), every=16)
    ring.set(bess_c__on=1, tie_ab__close=1, tie_bc__close=1, tie_ca__close=1).go(1.0)
    ring.set(drive__on=1).go(2.0)
    assert abs(ring["bess_c.i_b"]) < 2.0  # at rest
    loading = "drive.load_limit.loading"
    assert ring[loading] == pytest.approx(ring["bess_c.control.i_star"] / RATED, abs=1e-3)
    assert ring.set(tie_ca__close=0).go(0.1)[loading] == pytest.approx(ring["bess_c.control.i_star"] / RATED, abs=1e-3)
    assert ring.set(tie_bc__close=0).go(0.1)[loading] == NOBODY


LOW = """\
schema: 1
scenario: low
duration: 24 s
step: 70 us
start: {state: moored, closed: [dc_tie], soc: {bess_for: 30.9 %, bess_aft: 30.9 %}}
rules:
  start_genset_on_low_soc: {below: 30.88 %, until: 30.91 %, recharge: 64 A}
"""


@pytest.fixture(scope="module")
def low(tmp_path_factory):
    """A genset that starts by itself, recharges for some seconds, and stops again."""
    folder = tmp_path_factory.mktemp("results") / "low"
    killed_runs.simulate(folder, made_of=killed_runs.case(scenario=LOW))
    return folder


def test_what_a_rule_commands_is_in_the_log_with_its_origin_and_reason(low):
    with sg.open_results(low) as run:
        said = [(e.source, e.text) for e in run.events if " by " in e.text]
        looks = [e.time / (1429 * 70e-6) for e in run.events if " by " in e.text]  # 0.1 s, in whole steps
    rule = "by start_genset_on_low_soc: "
    assert said == [
        ("genset_for.on", f"set to true {rule}bess_for at 30.9 %"),
        ("bess_for.i_ref", f"set to -64 A {rule}genset_for is connected"),
        ("bess_aft.i_ref", f"set to -64 A {rule}genset_for is connected"),
        ("bess_for.i_ref", f"set to 0 A {rule}bess_aft at 30.9 %"),
        ("bess_aft.i_ref", f"set to 0 A {rule}bess_aft at 30.9 %"),
        ("genset_for.on", f"set to false {rule}bess_aft at 30.9 %"),
    ]
    assert looks == pytest.approx(
        [round(k) for k in looks], abs=1e-6
    )  # so that every run has them at the same instants


@pytest.mark.parametrize("share", [pytest.param(0.3, marks=pytest.mark.full), 0.7])
def test_a_run_with_a_rule_is_continued_to_the_same_bits(low, tmp_path, monkeypatch, share):
    monkeypatch.setattr(session, "WALL_PER_CHUNK", 0.01)
    case, out = killed_runs.case(scenario=LOW), tmp_path / "out"

    def press(now, end):
        if now >= share * end:
            os.kill(os.getpid(), signal.SIGINT)

    killed_runs.simulate(out, made_of=case, progress=press)
    killed_runs.simulate(out, made_of=case, resume=True)
    assert same(out, low)
