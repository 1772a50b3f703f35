"""What `shipgrid bench` times: steps, and nothing that comes before or between them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from shipgrid.assembly import crew
from shipgrid.cli import bench_case
from shipgrid.errors import SolverError

STEP_US = 4.0


class Clock:
    """A clock that shows what the stand-ins below take."""

    def __init__(self):
        self.now = 0.0

    def perf_counter(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    """Stepping takes 4 us a step, to enter and to leave a crew 35 ms, to write a row 1 ms."""
    clock = Clock()

    class Crew:
        entered, spells = 0, []

        def __init__(self, plan, work):
            clock.now += 0.02

        def __enter__(self):
            Crew.entered += 1
            clock.now += 0.015
            return self

        def __call__(self, steps, first):
            Crew.spells.append((steps, first))
            clock.now += 1e-6 * STEP_US * steps
            return steps

        def __exit__(self, *exception):
            clock.now += 0.035

    monkeypatch.setattr(crew, "Crew", Crew)
    monkeypatch.setattr(bench_case, "time", clock)
    clock.crew = Crew
    return clock


def plant(every):
    step = SimpleNamespace(rows=np.array([3, 1]), event_count=np.array([7]))
    plan = SimpleNamespace(step=SimpleNamespace(record_every=every, slow_every=10 * every))
    return plan, SimpleNamespace(n=0, step=step)


def test_a_step_takes_what_stepping_takes(clock):
    plan, work = plant(every=3333)
    figures = bench_case.spell_times(plan, work, spells=9)
    assert clock.crew.entered == 1
    assert clock.crew.spells == [(bench_case.SPELL, k * bench_case.SPELL) for k in range(10)]
    assert figures == dict.fromkeys(figures, pytest.approx(STEP_US, rel=1e-9))
    assert work.n == 10 * bench_case.SPELL and not work.step.rows.any() and not work.step.event_count.any()


def test_a_spell_is_no_longer_than_the_buffers_of_rows(clock):
    plan, work = plant(every=2)
    bench_case.spell_times(plan, work, spells=1)
    assert clock.crew.spells[0][0] == 2 * 511


def test_a_run_that_diverges_is_no_figure(clock, monkeypatch):
    monkeypatch.setattr("shipgrid.analysis.divergence.culprit", lambda plan, work: f"diverged at {work.n} steps")
    monkeypatch.setattr(clock.crew, "__call__", lambda self, steps, first: -100)
    with pytest.raises(SolverError, match="diverged at 100 steps"):
        bench_case.spell_times(*plant(every=3333))
