"""Comparison of two runs."""

import numpy as np
import pytest

from shipgrid.analysis.compare import compare
from shipgrid.analysis.requirements import Series


class Recorded(dict):
    @property
    def signals(self):
        return sorted(self)

    def series(self, name):
        return self.get(name)


def recorded(**values):
    return Recorded(
        {k: Series(np.asarray(t, float), np.asarray(v, float), None, None, "V") for k, (t, v) in values.items()}
    )


T = np.linspace(0.0, 1.0, 11)


def test_a_run_equals_itself():
    run = recorded(a=(T, T), b=(T, 0.0 * T))
    assert [(d.largest, d.mean, d.relative) for d in compare(run, run).differences] == [(0.0, 0.0, 0.0)] * 2


def test_largest_and_mean_difference_and_the_time_of_the_largest():
    other = T.copy()
    other[3] += 0.5
    (d,) = compare(recorded(a=(T, T)), recorded(a=(T, other))).differences
    assert d.largest == pytest.approx(0.5) and d.at == pytest.approx(0.3)
    assert d.mean == pytest.approx(0.5 / 11) and d.relative == pytest.approx(0.5)


def test_other_sampling_of_a_straight_line_makes_no_difference():
    t = np.linspace(0.0, 1.0, 7)
    (d,) = compare(recorded(a=(T, 3.0 * T)), recorded(a=(t, 3.0 * t))).differences
    assert d.largest < 1e-14  # rounding


def test_the_worst_signal_comes_first_and_signals_of_one_run_only_are_named():
    first = recorded(a=(T, T + 1.0), b=(T, T + 1.0), c=(T, T))
    second = recorded(a=(T, T + 1.1), b=(T, T + 2.0), d=(T, T))
    result = compare(first, second)
    assert [d.signal for d in result.differences] == ["b", "a"]
    assert (result.only_first, result.only_second) == (["c"], ["d"])


def test_only_the_time_both_runs_cover_is_compared():
    (d,) = compare(recorded(a=(T, T)), recorded(a=([0.0, 0.5], [0.0, 0.5]))).differences
    assert d.largest < 1e-14  # rounding
    assert compare(recorded(a=(T, T)), recorded(a=([5.0, 6.0], [0.0, 0.5]))).differences == []


def test_a_value_that_is_not_a_number_is_an_infinite_difference():
    bad = T.copy()
    bad[2] = np.nan
    (d,) = compare(recorded(a=(T, T)), recorded(a=(T, bad))).differences
    assert d.largest == np.inf


def test_of_means_a_ripple_between_the_rows_makes_no_difference():
    flat, ripple = np.full(11, 5.0), np.full(11, 7.0)
    first = Recorded(a=Series(T, flat, None, None, "V", flat))
    second = Recorded(a=Series(T, ripple, None, None, "V", flat))
    assert compare(first, second).differences[0].largest == 2.0
    assert compare(first, second, means=True).differences[0].largest == 0.0
