"""The clock in the loop counts to the step and to the nanosecond: on a clock that does not exist, so that nothing here
depends on this machine's time."""

from __future__ import annotations

import json

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.assembly.code_store import core
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.io.report import clock_table
from shipgrid.realtime import monitor
from shipgrid.solvers import pacing

STEPS = 1000
USUAL = 10_000
"""Computation [ns] of a step of 30 us."""


@pytest.fixture(scope="module")
def circuit():
    net = sg.Network("R-L")
    feed = net.dc_bus("feed", v_n=100.0)
    net.add("source", sg.DcSource(v_0=100.0, R=0.1), a=feed)
    net.add("load", sg.RlBranch(R=1.0, L=1e-3), a=feed)
    return sg.assemble(net, step=30e-6)


def paced(circuit, costs, *, policy="catch-up", steps=STEPS, factor=(1, 1), window=100):
    """Clock and workspace after some steps that took `costs`, in turn."""
    work = new_workspace(circuit)
    pace = pacing.pace_work(bins=40_000, windows=64, worst=4, commands=16, signals=0)
    work.pace = pace._replace(virtual_cost=np.array(costs))
    p = work.pace.pacer[0]
    p.on, p.virtual, p.num, p.den, p.window = 1, 1, 30_000 * factor[1], factor[0], window
    p.reanchor = int(policy == "re-anchor")
    assert core()(steps, 0, *arguments(circuit, work)) == steps
    return p, work


def stalled(at, length, steps=STEPS):
    costs = np.full(steps, USUAL)
    costs[at] += length
    return costs


def test_steps_on_time_are_idle_for_the_rest_and_never_late(circuit):
    p, work = paced(circuit, [USUAL])
    assert (p.steps, p.overruns, p.spells, p.worst_late) == (STEPS, 0, 0, 0)
    computation, idle, lateness = work.pace.pace_histogram
    assert computation[USUAL // 10] == idle[20_000 // 10] == lateness[0] == STEPS
    assert p.now == (STEPS - 1) * 30_000 + USUAL
    found = monitor.figures(work.pace, 30e-6, 1.0)
    assert found["duty"] == pytest.approx(1 / 3)
    assert monitor.verdict(found) == "in real time: no overrun in 1000 steps, mean computation 10.00 us of 30 us (33 %)"


def test_a_stall_is_caught_up_with_and_every_late_step_counted(circuit):
    # 310 us: the step ends 290 us late, each of those that follow gains 20 us on the plan, so 14 more end late
    p, work = paced(circuit, stalled(100, 310_000))
    assert (p.overruns, p.spells, p.longest_spell, p.worst_late, p.slip) == (15, 1, 15, 290_000, 0)
    assert p.now == (STEPS - 1) * 30_000 + USUAL  # on time again
    worst = max(work.pace.pace_worst, key=lambda w: w.computation)
    assert (worst.step, worst.computation, worst.lateness) == (101, 320_000, 0)
    late = work.pace.pace_histogram[pacing.LATENESS]
    assert late[0] == STEPS - 15 and np.sum(late[1:]) == 15 and late[290_000 // 10] == 1
    assert [int(n) for n in work.pace.pace_rows[0, : work.pace.pace_count[0], 3]] == [0] + [15] * 9


def test_a_stall_moves_the_grid_once_where_it_may_be_moved(circuit):
    p, work = paced(circuit, stalled(100, 310_000), policy="re-anchor")
    assert (p.overruns, p.spells, p.worst_late, p.slip) == (1, 1, 290_000, 290_000)
    assert p.now == (STEPS - 1) * 30_000 + USUAL + 290_000
    assert work.pace.pace_histogram[pacing.LATENESS][0] == STEPS
    said = monitor.verdict(monitor.figures(work.pace, 30e-6, 1.0))
    assert said.startswith("in real time but for 1 overruns") and "the plan was moved by 0.29 ms" in said
    _, work = paced(circuit, [31_000], policy="re-anchor")  # each a microsecond late, 1 ms in all
    assert monitor.verdict(monitor.figures(work.pace, 30e-6, 1.0)).startswith("not in real time")


def test_the_instants_of_a_year_are_exact(circuit):
    work = new_workspace(circuit)
    p, n = work.pace.pacer[0], 10**12  # a year of 30 us
    p.whole, p.num, p.den = 29_999, 999_997, 1_000_003
    assert pacing.instant(work.pace.pacer, n) == n * 29_999 + n * 999_997 // 1_000_003


def test_a_step_that_is_always_too_long_is_never_in_real_time(circuit):
    p, work = paced(circuit, [31_000])
    assert (p.overruns, p.spells, p.longest_spell, p.worst_late) == (STEPS, 1, STEPS, STEPS * 1000)
    found = monitor.figures(work.pace, 30e-6, 1.0)
    assert found["duty"] == pytest.approx(31 / 30)
    assert monitor.verdict(found).startswith("not in real time")


def test_a_step_that_ends_on_its_instant_is_on_time(circuit):
    p, _ = paced(circuit, [30_000])
    assert (p.overruns, p.now) == (0, STEPS * 30_000)
    p, _ = paced(circuit, [30_001])
    assert p.overruns == STEPS


@pytest.mark.parametrize("factor", [(1, 2), (2, 1), (7, 10)])
def test_a_factor_of_time_stretches_the_grid_without_adding_up(circuit, factor):
    p, _ = paced(circuit, [USUAL], factor=factor)
    # whole nanoseconds of the instant itself, not of a rounded step: exact however long the run
    assert p.now == (STEPS - 1) * 30_000 * factor[1] // factor[0] + USUAL


def test_windows_have_the_extremes_and_the_mean(circuit):
    _, work = paced(circuit, stalled(250, 5_000))
    low, high, mean = work.pace.pace_rows[1:, :10, pacing.COMPUTATION]
    assert work.pace.pace_count[0] == 10
    assert np.allclose(low, 10e-6) and np.allclose(np.delete(high, 2), 10e-6) and high[2] == pytest.approx(15e-6)
    assert mean[2] == pytest.approx(10.05e-6) and np.allclose(np.delete(mean, 2), 10e-6)
    idle_low = work.pace.pace_rows[1, :10, pacing.IDLE]
    assert idle_low[2] == pytest.approx(15e-6) and np.allclose(np.delete(idle_low, 2), 20e-6)


def test_percentiles_are_those_of_the_durations(circuit):
    durations = np.random.default_rng(1).integers(2_000, 90_000, STEPS)
    _, work = paced(circuit, durations)
    histogram = work.pace.pace_histogram[pacing.COMPUTATION]
    for share in (0.5, 0.99, 0.9999):
        exact = np.sort(durations)[int(np.ceil(share * STEPS)) - 1]
        assert 0.0 <= monitor.percentile(histogram, share) * 1e9 - exact <= pacing.BIN
    worst = sorted(int(w.computation) for w in work.pace.pace_worst)
    assert worst == sorted(durations.tolist())[-4:]


def test_a_run_that_is_stopped_before_its_first_step_has_figures_that_json_can_say():
    found = monitor.figures(pacing.pace_work(bins=100, windows=4, worst=4, commands=4, signals=0), 30e-6, 1.0)
    assert monitor.verdict(found) == "no step was run"
    assert '"p99": null' in json.dumps(found, allow_nan=False)
    assert ("computation", "0.00", "", "", "", "") in clock_table(found)


def test_what_lies_beyond_a_histogram_is_in_its_last_bin(circuit):
    _, work = paced(circuit, stalled(5, 10**9))
    assert work.pace.pace_histogram[pacing.COMPUTATION, -1] == 1
    assert np.all(work.pace.pace_histogram.sum(axis=1) == STEPS)


def test_the_loop_returns_before_a_step_when_it_is_asked_to(circuit):
    work = new_workspace(circuit)
    work.pace.pacer[0].on = work.pace.pacer[0].virtual = work.pace.pacer[0].stop = work.pace.pacer[0].window = 1
    before = work.sig.copy()
    assert core()(STEPS, 0, *arguments(circuit, work)) == 0
    assert np.array_equal(work.sig, before)


def test_the_clock_changes_nothing_of_what_is_computed(circuit):
    _, live = paced(circuit, stalled(100, 10**6))
    offline = new_workspace(circuit)
    core()(STEPS, 0, *arguments(circuit, offline))
    assert live.sig.tobytes() == offline.sig.tobytes()
    assert offline.pace.pacer[0].steps == 0


def test_commands_are_taken_in_their_order_a_few_a_step_and_remembered(circuit):
    work = new_workspace(circuit)
    place = circuit.layout.index["feed.v_dc"]
    pace = pacing.pace_work(bins=10, windows=4, worst=1, commands=16, signals=len(work.sig))
    work.pace = pace
    p = pace.pacer[0]
    p.on, p.virtual, p.num, p.den, p.window, p.publish_every = 1, 1, 30_000, 1, 100, 1
    for k in range(12):
        asked = pace.inbox[k]
        asked.place, asked.value, asked.origin, asked.measured = place, 100.0 + k, 2, 7
    pace.inbox_count[0] = 12
    run, values = core(), arguments(circuit, work)
    assert run(1, 0, *values) == 1 and pace.inbox_count[1] == pacing.MOST_COMMANDS
    assert run(1, 1, *values) == 1 and pace.inbox_count[1] == 12
    log = [(int(a.step), float(a.value), int(a.origin), int(a.measured)) for a in pace.applied[:12]]
    assert log == [(0 if k < pacing.MOST_COMMANDS else 1, 100.0 + k, 2, 7) for k in range(12)]
    assert pace.outbox_count[0] == 2 and pace.outbox_step[:2].tolist() == [1, 2]
    assert np.array_equal(pace.outbox[1], work.sig)
