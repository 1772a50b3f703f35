"""The ferry with every edge of its forty switches, against its averaged self and against arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.assembly.plan import Workspace
from shipgrid.assembly.weave import arguments, woven_entry
from shipgrid.scenarios.runner import build, start

H = 30e-6


@pytest.fixture(scope="module")
def moored():
    """Plans of both fidelities, each with the moored start."""
    ship, scenario = sg.load_ship("ferry"), sg.load_scenario("mission")
    plans = {fidelity: build(ship, H, fidelity) for fidelity in ("averaged", "switching")}
    return {fidelity: (plan, start(plan, ship, scenario)[0]) for fidelity, plan in plans.items()}


def means(plan, work: Workspace, seconds: float) -> dict[str, float]:
    """Mean of every public signal, over every step of a whole number of cycles of 60 Hz."""
    entry, values = woven_entry(plan), arguments(plan, work)
    places = np.array([plan.layout.index[p.source] for p in plan.network.published.values()])
    total, n = np.zeros(len(places)), round(seconds / plan.h)
    for _ in range(n):
        assert entry(1, work.n, *values) == 1
        work.n += 1
        work.step.rows[:] = 0
        total += work.sig[places]
    return dict(zip(plan.network.published, total / n, strict=True))


def advance(plan, work: Workspace, seconds: float) -> None:
    entry, values = woven_entry(plan), arguments(plan, work)
    for _ in range(round(seconds / plan.h / 2000)):
        assert entry(2000, work.n, *values) == 2000
        work.n += 2000
        work.step.rows[:] = 0
        work.step.event_count[0] = 0


RATED = {"V": 750.0, "A": 128.0, "W": 50e3, "var": 50e3, "Hz": 60.0, "rad/s": 47.1, "N m": 5730.0, "N": 2e4}


def compare(moored, seconds):
    found = {}
    for fidelity, (plan, work) in moored.items():
        run = work.snapshot()
        advance(plan, run, 0.5)
        found[fidelity] = means(plan, run, seconds)
    plan = moored["averaged"][0]
    return {
        name: (found["switching"][name] - value) / RATED.get(plan.network.published[name].unit, 1.0)
        for name, value in found["averaged"].items()
    }


def test_moored_the_means_of_both_fidelities_agree(moored):
    difference = compare(moored, 12.0 / 60.0)
    assert max(difference.values(), key=abs) == pytest.approx(0.0, abs=5e-3), difference


def test_a_battery_s_choke_ripples_as_the_duty_ratio_says(moored):
    plan, work = moored["switching"]
    run = work.snapshot()
    advance(plan, run, 0.5)
    places = [plan.layout.index[f"bess_for.{name}"] for name in ("converter.i_l", "converter.v_c", "modulator.active")]
    entry, values = woven_entry(plan), arguments(plan, run)
    rows = []
    for _ in range(2000):
        entry(1, run.n, *values)
        run.n += 1
        run.step.rows[:] = 0
        rows.append(run.sig[places])
    i, v_b, s = np.array(rows).T
    v_dc = run.sig[plan.layout.index["dc_for.v_dc"]]
    expected = s.mean() * (1.0 - s.mean()) * v_dc / (0.8e-3 * 5e3)
    assert expected == pytest.approx(43.0, abs=1.0)  # 45 A with 474 V at 100 A
    # steps end anywhere in the triangle: of its 43 A the two tips go unseen by up to a step's share of a slope
    assert 0.9 * expected < np.ptp(i) < 1.02 * expected
    assert v_b.mean() == pytest.approx(474.0, abs=2.0)


def test_two_switching_runs_are_bit_identical(moored):
    plan, work = moored["switching"]
    ends = []
    for _ in range(2):
        run = work.snapshot()
        advance(plan, run, 0.3)
        ends.append(run.sig.copy())
    assert np.array_equal(*ends)
