"""The ferry's hotel grid parallel, meshed and fed from one side, in the order of [DAgostino2020] sec. 6.2."""

from __future__ import annotations

import numpy as np
import pytest

import shipgrid as sg
from scenarios.story import Story
from shipgrid.analysis.settling import run_to_rest
from shipgrid.scenarios.case import build

SIDES = ("for", "aft")
AXES = [f"ac_{side}.v_{axis}" for side in SIDES for axis in ("alpha", "beta")]
V_B = 400.0 * np.sqrt(2.0 / 3.0)
STEP, EVERY = 60e-6, 8


@pytest.fixture(scope="module")
def story():
    ship = sg.load_ship("ferry")
    plan = build(ship, STEP)
    commands = sg.load_scenario("mission").start_commands(ship)
    work, _ = run_to_rest(plan, commands | {"dc_tie.close": 0.0, "ac_tie.close": 0.0})
    story = Story(ship, plan=plan, work=work, every=EVERY, watch=AXES, interlocks=True)
    story.asked = {}
    for what, commands, seconds in (
        ("apart", {"inverter_for.on": 1.0}, 0.5),
        ("parallel", {"ac_tie.close": 1.0}, 8.0),
        ("meshed", {"dc_tie.close": 1.0}, 2.0),
        ("opened", {"ac_tie.close": 0.0}, 2.0),
        ("aft off", {"inverter_aft.on": 0.0}, 3.0),
        ("one feeds both", {"ac_tie.close": 1.0}, 2.0),
    ):
        story.asked[what] = story.now
        story.tell(commands).go(seconds)
    return story


def rms(story, side, since, until):
    """One-cycle rms of a bar [pu], by its time."""
    cycle = round(1.0 / 60.0 / (STEP * EVERY))
    t, a = story.history(f"ac_{side}.v_alpha", since, until)
    _, b = story.history(f"ac_{side}.v_beta", since, until)
    return t[cycle - 1 :], np.sqrt(np.convolve(a**2 + b**2, np.full(cycle, 1.0 / cycle), "valid")) / V_B


def first(story, owner, text, after):
    return next(t for t, who, what in story.events if who == owner and what == text and t > story.asked[after])


def test_every_command_is_obeyed(story):
    assert not [e for e in story.events if "refused" in e[2]]
    closed = [t for t, who, what in story.events if (who, what) == ("ac_tie", "closed")]
    assert len(closed) == 2
    assert story["dc_tie.closed"] == 1.0
    assert story["inverter_aft.on"] == 0.0


def test_energised_bars_stay_in_their_bands(story):
    for side, end in (("for", story.now), ("aft", story.asked["aft off"])):
        f = story.history(f"ac_{side}.f", 0.2, end)[1]
        assert f.min() > 59.2
        assert f.max() < 60.6
        assert rms(story, side, 0.2, end)[1].min() > 0.95 - 0.02  # within half a second of an event
    for what in ("meshed", "opened", "aft off"):
        for side in SIDES:
            since = story.asked[what]
            v = rms(story, side, since - 0.3, since)[1]
            assert v.min() > 0.95
            assert v.max() < 1.05
            f = story.history(f"ac_{side}.f", since - 0.3, since)[1]
            assert f.min() > 59.4
            assert f.max() < 60.0


def test_tied_bars_have_one_frequency_and_share_the_power(story):
    since, until = first(story, "ac_tie", "closed", "parallel") + 6.0, story.asked["opened"]
    means = {side: story.history(f"ac_{side}.f", since, until)[1].mean() for side in SIDES}
    assert means["for"] == pytest.approx(means["aft"], abs=1e-3)
    powers = [story.history(f"inverter_{side}.p_ac", since, until)[1].mean() for side in SIDES]
    assert abs(powers[0] - powers[1]) < 0.01 * 50e3  # required: 5 %


def test_meshing_moves_hardly_any_power(story):
    since = story.asked["meshed"]
    for bus in ("dc_for.v_dc", "dc_aft.v_dc"):
        v = story.history(bus, since - 0.5, story.asked["opened"])[1]
        assert np.ptp(v) < 0.002 * 750.0


def test_closing_onto_the_dead_loaded_bar(story):
    closed = first(story, "ac_tie", "closed", "one feeds both")
    t, v = rms(story, "for", closed - 0.1, story.now)
    assert v[t < closed][-1] - v.min() < 0.1
    assert np.abs(v[t > closed + 0.05] / v[-50:].mean() - 1.0).max() < 0.05
    for side in SIDES:
        assert rms(story, side, story.now - 0.3, story.now)[1].min() > 0.95
    assert story["inverter_for.p_ac"] == pytest.approx(
        20e3 * rms(story, "for", story.now - 0.1, story.now)[1][-1] ** 2, rel=0.03
    )
