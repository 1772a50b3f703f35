"""Limits of class and standards: what they are on, when they count, and what violates them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shipgrid.analysis.class_limits import E5, E24, G2, G3, LIMITS, class_verdicts
from shipgrid.analysis.requirements import Series
from shipgrid.io.ship_file import load_ship

TIME = np.arange(0.0, 20.05, 0.1)
QUIET = {
    **{f"ac_{x}.{s}": v for x in ("for", "aft") for s, v in (("v_rms_pu", 0.99), ("f", 59.8))},
    **{f"dc_{x}.v_dc": 745.0 for x in ("for", "aft")},
    **{f"genset_{x}.{s}": v for x in ("for", "aft") for s, v in (("omega_pu", 0.99), ("v_pu", 1.0), ("on", 1.0))},
    **{f"inverter_{x}.on": 1.0 for x in ("for", "aft")},
    **{f"bess_{x}.mode": 1.0 for x in ("for", "aft")},
    "ac_tie.closed": 0.0,
    "dc_tie.closed": 0.0,
}


class Recording:
    """Every signal of a quiet ship for 20 s, some of them changed: a value, or one for each instant."""

    def __init__(self, waves=None, **changed):
        self.signals = list(QUIET)
        self.values = {**QUIET, **{name.replace("__", "."): value for name, value in changed.items()}}
        self.waves = waves or {}

    def series(self, name):
        if name in self.waves:
            time, value = self.waves[name]
            return Series(time, value, None, None, "V")
        if name not in self.values:
            return None
        value = np.broadcast_to(np.asarray(self.values[name], float), TIME.shape)
        return Series(TIME, value, value, value, "1", value)


@pytest.fixture(scope="module")
def ship():
    return load_ship("ferry")


def violated(ship, **changed):
    found = class_verdicts(ship, Recording(**changed))
    return {(v.name, v.signal) for v in found if v.verdict == "violated"}


def during(start, end, value, otherwise):
    return np.where((start < TIME) & (end > TIME), value, otherwise)


def test_a_quiet_ship_meets_every_limit_on_everything(ship):
    found = class_verdicts(ship, Recording())
    assert all(v.ok for v in found)
    assert len(found) == 2 * len(LIMITS)


@pytest.mark.parametrize(
    ("signal", "value", "allowed", "limit"),
    [
        ("ac_for.v_rms_pu", 0.85, 1.5, f"{E5}: voltage"),
        ("ac_for.v_rms_pu", 1.08, 1.5, f"{E5}: voltage"),
        ("ac_aft.f", 56.0, 5.0, f"{E5}: frequency"),
        ("genset_for.omega_pu", 0.94, 3.0, f"{G3}: speed"),
        ("genset_for.omega_pu", 1.03, 3.0, f"{G3}: speed"),
        ("genset_aft.v_pu", 1.02, 4.0, f"{G3}: voltage"),
    ],
)
def test_a_deviation_may_last_as_long_as_the_limit_allows(ship, signal, value, allowed, limit):
    usual = QUIET[signal]
    short, long = during(5.0, 5.0 + allowed - 0.25, value, usual), during(5.0, 5.0 + allowed + 0.25, value, usual)
    assert not violated(ship, **{signal: short})
    assert violated(ship, **{signal: long}) == {(limit, signal)}


@pytest.mark.parametrize(
    ("signal", "value", "limits"),
    [
        ("ac_for.v_rms_pu", 0.79, {f"{E5}: voltage, transient"}),
        ("ac_for.f", 66.1, {f"{E5}: frequency, transient"}),
        ("dc_aft.v_dc", 674.0, {f"{E5}: voltage"}),
        ("genset_for.omega_pu", 0.92, {f"{G3}: speed, transient"}),
        ("genset_for.omega_pu", 0.89, {f"{G2}: speed, transient", f"{G3}: speed, transient"}),
        ("genset_for.v_pu", 0.82, {f"{G3}: voltage, transient"}),
        ("genset_for.v_pu", 1.26, {f"{G2}: voltage, transient", f"{G3}: voltage, transient"}),
    ],
)
def test_the_transient_limits_hold_at_every_instant(ship, signal, value, limits):
    brief = during(4.95, 5.05, value, QUIET[signal])
    assert violated(ship, **{signal: brief}) == {(limit, signal) for limit in limits}


def test_a_dead_bar_and_a_genset_at_rest_are_not_judged(ship):
    dead = {
        "inverter_aft.on": 0.0,
        "ac_aft.v_rms_pu": 0.0,
        "ac_aft.f": 0.0,
        "genset_aft.on": 0.0,
        "genset_aft.v_pu": 0.0,
    }
    found = class_verdicts(ship, Recording(**dead))
    assert all(v.ok for v in found)
    assert not [v for v in found if v.signal.startswith(("ac_aft", "genset_aft"))]


def test_a_bar_without_an_inverter_counts_from_the_closing_of_its_tie(ship):
    closed = np.where(TIME >= 10.0, 1.0, 0.0)
    fed = {"inverter_aft.on": 0.0, "ac_tie.closed": closed, "ac_aft.f": 59.8 * closed}
    assert not violated(ship, **fed, **{"ac_aft.v_rms_pu": 0.99 * closed})
    assert (f"{E5}: voltage", "ac_aft.v_rms_pu") in violated(ship, **fed, **{"ac_aft.v_rms_pu": 0.7 * closed})


def test_a_dc_bus_counts_while_a_battery_or_a_rectifier_feeds_it(ship):
    low = {"dc_for.v_dc": 600.0}
    assert violated(ship, **low)
    assert not violated(ship, **low, **{"bess_for.mode": 0.0})
    assert violated(ship, **low, **{"bess_for.mode": 0.0, "rectifier_for.modulation": 0.9})
    assert violated(ship, **low, **{"bess_for.mode": 0.0, "dc_tie.closed": 1.0})


@pytest.mark.parametrize(
    ("fifth", "seventh", "broken"),
    [(0.04, 0.04, set()), (0.06, 0.0, {"largest harmonic"}), (0.048, 0.07, {"largest harmonic", "THD"})],
)
def test_harmonics_of_a_bar_are_judged_where_its_waveform_is_recorded(ship, fifth, seventh, broken):
    t = np.concatenate([np.arange(0.0, 0.2, 30e-6), np.arange(5.0, 5.1, 30e-6)])  # two windows
    angle = 2.0 * math.pi * 60.0 * t
    distorted = fifth * np.sin(5.0 * angle) + seventh * np.sin(7.0 * angle)
    v = 326.6 * (np.sin(angle) + np.where(t < 1.0, distorted, 0.0))
    found = class_verdicts(ship, Recording(waves={"ac_for.v_a": (t, v)}))
    first, second = (found[-4:-2], found[-2:])
    assert first[0].value == pytest.approx(math.hypot(fifth, seventh), rel=1e-3)
    assert {v.name for v in first if not v.ok} == {f"{E24}: {name}" for name in broken}
    assert second[0].value == pytest.approx(0.0, abs=1e-3) and second[0].window[0] == pytest.approx(5.0)
