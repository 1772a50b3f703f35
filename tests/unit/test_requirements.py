"""Requirements: the verdict, the value that decides, the margin, the first violation."""

import json
import math

import numpy as np
import pytest

from shipgrid.analysis.requirements import Requirement, Series, evaluate, judge
from shipgrid.errors import ParameterError

TIME = np.arange(11.0)


def series(value, low=None, high=None, time=TIME):
    return Series(time, np.asarray(value, float), low, high, "V")


def asked(**limits):
    return Requirement.from_mapping({"name": "DC bus", "signal": "dc_for.v_dc", **limits})


def test_a_band_is_met_with_the_distance_of_the_nearest_value_as_margin():
    verdict = judge(asked(band=[0.0, 12.0]), series(TIME))
    assert (verdict.verdict, verdict.value, verdict.margin, verdict.at) == ("met", 0.0, 0.0, 0.0)
    verdict = judge(asked(band=[-5.0, 12.0]), series(TIME))
    assert (verdict.value, verdict.margin, verdict.at) == (10.0, 2.0, 10.0)


def test_a_violated_band_names_the_first_time_and_the_worst_value():
    verdict = judge(asked(band=[0.0, 6.5]), series(TIME))
    assert (verdict.verdict, verdict.first_violation, verdict.at) == ("violated", 7.0, 10.0)
    assert (verdict.value, verdict.margin) == (10.0, -3.5)


def test_only_the_window_counts():
    assert judge(asked(max=6.5, **{"from": 1.0, "until": 6.0}), series(TIME)).ok
    assert not judge(asked(max=6.5, **{"from": 1.0, "until": 7.0}), series(TIME)).ok


def test_a_peak_between_two_samples_violates():
    high = TIME.copy()
    high[5] = 99.0
    verdict = judge(asked(max=20.0), series(TIME, TIME, high))
    assert (verdict.verdict, verdict.value, verdict.at) == ("violated", 99.0, 5.0)


def test_a_peak_before_the_window_does_not_count_in_its_first_interval():
    high = TIME.copy()
    high[5] = 99.0  # somewhere between 4 and 5
    assert judge(asked(max=20.0, **{"from": 5.0}), series(TIME, TIME, high)).ok
    assert not judge(asked(max=20.0, **{"from": 4.0}), series(TIME, TIME, high)).ok


@pytest.mark.parametrize(
    ("limits", "value", "met"),
    [
        ({"min": 0.0}, TIME, True),
        ({"min": 0.5}, TIME, False),
        ({"max": 10.0}, TIME, True),
        ({"max": 9.9}, TIME, False),
        ({"abs_max": 10.0}, -TIME, True),
        ({"abs_max": 9.9}, -TIME, False),
        ({"mean": [4.9, 5.1]}, TIME, True),
        ({"mean": [5.1, 6.0]}, TIME, False),
    ],
)
def test_each_measure_is_met_and_can_be_violated(limits, value, met):
    assert judge(asked(**limits), series(value)).ok is met


def test_abs_max_reports_the_magnitude_also_of_recorded_extremes():
    verdict = judge(asked(abs_max=30.0), series(TIME, TIME - 45.0, TIME))
    assert verdict.value == 44.0 and verdict.first_violation == 1.0


def test_a_mean_weighs_by_time_and_not_by_samples():
    time = np.array([0.0, 0.1, 0.2, 10.0])
    verdict = judge(asked(mean=[0.0, 1.0]), series([0.0, 0.0, 1.0, 1.0], time=time))
    assert verdict.value == pytest.approx((0.05 + 9.8) / 10.0)


def test_a_run_that_ended_early_leaves_the_verdict_open_unless_it_is_violated_already():
    assert judge(asked(max=20.0, until=60.0), series(TIME)).verdict == "not evaluated"
    assert judge(asked(max=5.0, until=60.0), series(TIME)).verdict == "violated"
    assert judge(asked(max=5.0, **{"from": 50.0}), series(TIME)).verdict == "not evaluated"


def test_a_value_that_is_not_a_number_violates_and_is_still_valid_json():
    value = TIME.copy()
    value[3] = math.nan
    verdict = judge(asked(band=[-1.0, 20.0]), series(value))
    assert (verdict.verdict, verdict.first_violation) == ("violated", 3.0)
    json.dumps(verdict.as_dict(), allow_nan=False)


def test_the_source_of_a_requirement_is_that_of_its_verdict():
    assert judge(asked(max=785.0, source="paper axis"), series(750.0 + TIME)).as_dict()["source"] == "paper axis"
    assert judge(asked(max=785.0), series(750.0 + TIME)).source == ""


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({}, "no measure"),
        ({"min": 0.0, "max": 1.0}, "exactly one"),
        ({"band": [2.0, 1.0]}, "empty"),
        ({"max": 1.0, "from": 5.0, "until": 5.0}, "window"),
    ],
)
def test_a_requirement_that_makes_no_sense_is_refused(limits, message):
    with pytest.raises(ParameterError, match=message):
        asked(**limits)


def test_a_mean_is_taken_of_the_recorded_means_of_the_intervals_wholly_inside_the_window():
    """A ripple that the samples always meet at its crest: the samples say 1, the signal's mean is 0."""
    time = np.array([0.0, 1.0, 2.0, 4.0, 5.0])
    kept = Series(time, np.ones(5), -np.ones(5), np.ones(5), "V", np.array([1.0, 7.0, 0.3, -0.3, 9.0]))
    verdict = judge(asked(mean=[-0.2, 0.2], **{"from": 1.0, "until": 4.5}), kept)
    assert verdict.verdict == "met"
    assert verdict.value == pytest.approx((0.3 * 1.0 - 0.3 * 2.0) / 3.0)  # the rows at 2 and 4
    assert judge(asked(mean=[-0.2, 0.2], **{"from": 1.2, "until": 4.5}), kept).value == pytest.approx(-0.3)
    assert judge(asked(band=[-0.5, 0.5], **{"from": 1.0, "until": 4.5}), kept).verdict == "violated"  # extremes decide


class Nothing:
    """A run that recorded nothing."""

    signals = ()

    def series(self, name):
        return None


@pytest.mark.parametrize(
    ("error", "word"), [(4e-4, "met"), (-4e-4, "met"), (-2e-3, "violated"), (math.nan, "violated")]
)
def test_a_figure_of_the_whole_run_is_judged_at_its_end(error, word):
    balance = Requirement.from_mapping({"name": "balance", "signal": "energy_balance_error", "abs_max": 1e-3})
    (verdict,) = evaluate([balance], Nothing(), 60.0, {"energy_balance_error": error})
    assert (verdict.verdict, verdict.at) == (word, 60.0)
    (verdict,) = evaluate([balance], Nothing(), 60.0)
    assert verdict.verdict == "not evaluated"


def test_a_spread_is_from_the_smallest_to_the_greatest_value_with_the_moment_it_grew_too_wide():
    swing = [5.0, 7.0, 3.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0]
    assert judge(asked(spread=4.0), series(swing)).ok
    verdict = judge(asked(spread=3.9), series(swing))
    assert (verdict.verdict, verdict.value, verdict.first_violation) == ("violated", 4.0, 2.0)
    assert judge(asked(spread=3.9, **{"from": 3.0}), series(swing)).value == 0.0


DIP = [750.0, 750.0, 700.0, 690.0, 750.0, 750.0, 700.0, 750.0, 750.0, 750.0, 750.0]  # 2 s outside, then 1 s


def test_recovery_allows_a_time_outside_and_measures_the_longest_stretch():
    verdict = judge(asked(band=[720.0, 780.0], recovery=2.0), series(DIP))
    assert (verdict.verdict, verdict.value, verdict.margin, verdict.unit) == ("met", 2.0, 0.0, "s")
    assert (verdict.at, verdict.first_violation) == (3.0, None)
    assert (verdict.limit, verdict.inside, verdict.inside_unit) == ([None, 2.0], [720.0, 780.0], "V")
    verdict = judge(asked(band=[720.0, 780.0], recovery=1.5), series(DIP))
    assert (verdict.verdict, verdict.margin) == ("violated", -0.5)
    assert verdict.first_violation == 2.5  # outside since 1, when 1.5 s were over
    assert judge(asked(min=720.0, recovery=1.0), series(DIP[4:], time=TIME[:7])).ok


def test_recovery_sees_a_peak_between_two_samples_as_their_whole_interval():
    low = np.full(11, 750.0)
    low[5] = 600.0
    assert judge(asked(min=720.0, recovery=1.0), series(np.full(11, 750.0), low, np.full(11, 750.0))).value == 1.0


def test_recovery_counts_only_the_instants_it_is_told_to():
    counts = np.ones(11, bool)
    counts[3] = False
    assert judge(asked(band=[720.0, 780.0], recovery=1.0), series(DIP), counts).ok
    assert judge(asked(band=[720.0, 780.0]), series(DIP), TIME > 6.0).ok
    assert judge(asked(band=[720.0, 780.0]), series(DIP), TIME > 99.0).verdict == "not evaluated"


def test_settling_is_the_last_time_outside_after_the_start():
    window = {"from": 1.0}
    verdict = judge(asked(band=[720.0, 780.0], settles=5.0, **window), series(DIP))
    assert (verdict.verdict, verdict.value, verdict.margin, verdict.at) == ("met", 5.0, 0.0, 6.0)
    verdict = judge(asked(band=[720.0, 780.0], settles=4.0, **window), series(DIP))
    assert (verdict.verdict, verdict.first_violation) == ("violated", 5.0)
    assert judge(asked(band=[720.0, 780.0], settles=4.0, **{"from": 7.0}), series(DIP)).value == 0.0


def test_what_never_settles_violates_and_a_window_cut_short_is_open():
    outside = series(np.full(11, 900.0))
    assert judge(asked(max=800.0, settles=5.0), outside).value == 10.0
    assert not judge(asked(max=800.0, settles=5.0), outside).ok
    assert judge(asked(max=800.0, settles=15.0, until=20.0), outside).verdict == "not evaluated"


@pytest.mark.parametrize(
    "limits",
    [
        {"mean": [0.0, 1.0], "recovery": 1.0},
        {"spread": 1.0, "settles": 1.0},
        {"max": 1.0, "recovery": 1.0, "settles": 1.0},
    ],
)
def test_rules_in_time_go_with_single_values_and_not_together(limits):
    with pytest.raises(ParameterError, match="expected one rule"):
        asked(**limits)


class TwoSignals:
    signals = ("a", "b")

    def series(self, name):
        return {"a": series(TIME, TIME - 9.0, TIME + 9.0), "b": series([0.0, 10.0], time=np.array([0.0, 10.0]))}.get(
            name
        )


def test_a_difference_of_two_signals_is_taken_instant_by_instant():
    close = Requirement("tied", "a", "abs_max", 0.0, 1e-9, minus="b")
    alone = Requirement("tied", "a", "abs_max", 0.0, 1e-9, minus="c")
    verdict, unknown = evaluate([close, alone], TwoSignals())
    assert verdict.ok and verdict.signal == "a - b"
    assert unknown.verdict == "not evaluated"


def test_a_ripple_between_two_rows_falls_out_of_a_band_of_means():
    flat = Series(TIME, np.full(11, 5.0), np.zeros(11), np.full(11, 10.0), "V", np.full(11, 5.0))
    assert not judge(asked(band=[4.0, 6.0]), flat).ok
    assert judge(asked(band_of_means=[4.0, 6.0]), flat).ok
    off = flat._replace(mean=np.where(TIME == 7.0, 6.5, 5.0))
    verdict = judge(asked(band_of_means=[4.0, 6.0]), off)
    assert (verdict.verdict, verdict.value, verdict.at, verdict.margin) == ("violated", 6.5, 7.0, -0.5)


def test_the_mean_of_an_interval_that_began_before_the_window_does_not_count():
    mean = np.where(TIME == 5.0, 99.0, 5.0)  # of the interval from 4 to 5
    recorded = Series(TIME, np.full(11, 5.0), None, None, "V", mean)
    assert judge(asked(band_of_means=[4.0, 6.0], **{"from": 5.0}), recorded).ok
    assert not judge(asked(band_of_means=[4.0, 6.0], **{"from": 4.0}), recorded).ok


def test_drift_is_the_rise_of_the_line_and_swing_what_is_left_about_it():
    wave = np.array([1.0, -1.0, -1.0, 1.0] * 5)  # at a right angle to any straight line
    time = np.arange(20.0)
    leaning = series(0.1 * time + wave, time=time)
    assert judge(asked(drift=2.0), leaning).value == pytest.approx(1.9)
    assert judge(asked(swing=3.0), leaning).value == pytest.approx(2.0)
    assert not judge(asked(drift=1.8), leaning).ok
    assert not judge(asked(swing=1.9), leaning).ok
    assert judge(asked(drift=1.9001), series(-0.1 * time, time=time)).ok  # a fall drifts as much as a rise


def test_a_drift_that_the_run_did_not_see_to_its_end_is_not_evaluated_unless_it_is_too_large_already():
    assert judge(asked(drift=20.0, until=50.0), series(TIME)).verdict == "not evaluated"
    assert judge(asked(drift=5.0, until=50.0), series(TIME)).verdict == "violated"
