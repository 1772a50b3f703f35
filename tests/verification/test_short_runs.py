"""Right values of small circuits: closed forms, SciPy, and what has to be refused or said (`short_runs.py`)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

RUNS = Path(__file__).with_name("short_runs.py")


@pytest.fixture(scope="module")
def found():
    """What every case found. Kernels stay plain Python: a few hundred steps are done before they were compiled."""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, RUNS], capture_output=True, text=True, env=environment, timeout=600)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# a state handed to another plan


def at_rest(R):
    return 100.0 / (R + 0.01)


def test_a_run_goes_on_with_the_resistance_of_the_plan_it_is_handed_to(found):
    runs = found["handed_over"]
    assert runs["same"][0] == runs["other"][0] == runs["end"]  # it begins where the other ended, and when
    assert runs["other begins"] == pytest.approx(4e-3, abs=30e-6)
    # 4 ms later: eight time constants of 2 ohm, sixteen of 4 ohm
    assert runs["same"][1] == pytest.approx(at_rest(2.0), rel=1e-5)
    assert runs["other"][1] == pytest.approx(at_rest(4.0), rel=1e-5)
    assert runs["command goes along"] == pytest.approx(0.5 * at_rest(4.0), rel=1e-3)  # as it was set in the first run


def test_another_step_goes_on_at_the_same_time(found):
    begins, i = found["handed_over"]["finer begins"]
    assert begins == pytest.approx(found["handed_over"]["other begins"], abs=1e-9)
    assert i == found["handed_over"]["end"]
    assert found["handed_over"]["finer ends"] == pytest.approx(8e-3, abs=1e-9)


def test_a_load_has_the_power_of_the_plan_it_is_handed_to(found):
    before, after, v = found["handed_over_with_parameters"]["load"]
    assert before == pytest.approx(20e3 / v, rel=1e-6) and after == pytest.approx(40e3 / v, rel=1e-3)


@pytest.mark.parametrize("of", ["end", "final"])
@pytest.mark.parametrize("name", ["same", "shorter", "longer"])
def test_a_dead_time_holds_what_went_into_it_whatever_its_length(found, name, of):
    assert found["handed_over_with_parameters"][f"{name} {of}"] == pytest.approx([0.5, 0.5], rel=1e-12)


def test_another_circuit_is_refused_with_what_differs_and_takes_values_by_name(found):
    runs = found["handed_over"]
    assert "'more': nothing there, Resistor (branch at bus.v_dc) here" in runs["refused"]
    begins, first, last = runs["by name"]
    assert begins == pytest.approx(4e-3, abs=30e-6)
    assert first == runs["end"]
    assert last == pytest.approx((100.0 - 0.01 * 102.0 / 50.0) / 2.01, rel=1e-3)  # 2 A more through 10 mohm
    assert "another plan" in runs["saved"]


# angles


def test_an_angle_that_passes_pi_is_sampled_the_short_way_round(found):
    """The rotor turns evenly, so that the sample between two steps is exact; the chord would be near zero."""
    case = found["angle_across_pi"]
    assert case["passed"] and case["samples"] > 25
    assert case["worst"] < 1e-12


# a reversed bus


def test_six_diodes_share_the_current_of_a_reversed_bus(found):
    """10 kA through three legs of two diodes in parallel: 2/3 of 2 mohm times 10 kA, whatever the phases carry."""
    case = found["reversed_bus"]
    assert case["v_dc"] == pytest.approx([-40.0 / 3.0, -40.0 / 3.0], abs=5e-4)  # 13.3 V at the start: 1 mF, 0.7 us
    assert case["largest phase current"] > 4e3
    assert case["loss off"] < 2e-3  # means of steps of 50 us against instants of a current of 60 Hz
    assert abs(case["energy"]) < 1e-6


# books


def test_the_mean_current_of_a_stiff_source_is_that_of_the_leg_it_feeds(found):
    case = found["stiff_source"]
    assert case["source"] == pytest.approx(case["leg"], rel=1e-8)
    assert case["sources"]["source"] == pytest.approx(750.0 * case["leg"] * 499 * 30e-6, rel=3e-3)  # and the first step
    assert abs(case["energy"]) < 1e-3


def test_a_capacitor_charged_within_a_step_takes_twice_what_it_keeps(found):
    case = found["capacitor_charged"]
    kept, load = 0.5 * 0.47e-6 * 12.0**2, 12.0**2 / 165.82  # the choke of the load lets in next to nothing in 0.2 ms
    assert case["v"] == pytest.approx(12.0, rel=1e-6)
    assert case["sources"]["source"] == pytest.approx(2.0 * kept, rel=0.02) and load * 2e-4 < 0.02
    assert case["losses"] == pytest.approx(kept, rel=1e-3)  # half of it, whatever the resistance
    assert abs(case["energy"]) < 1e-6


# currents without a path


def test_a_current_without_a_path_is_refused_before_the_run(found):
    for contact, text in found["without_a_path"]["refused"].items():
        assert "the current of feed into 'a.v_dc' has no path" in text, contact


def test_a_current_that_loses_its_path_does_not_flow_and_is_named_once(found):
    case = found["without_a_path"]
    assert [event[1] for event in case["events"]] == ["contact.close", "a", "contact.close"]
    time, _, text = case["events"][1]
    assert time == pytest.approx(0.6e-3, abs=30e-6) and text.startswith("the current of feed has no path there")
    assert case["open"] == 0.0
    assert case["closed"] == pytest.approx([-0.1, -0.1])
    assert case["v"] == pytest.approx(200.0, rel=1e-6)  # 2 kohm
    assert abs(case["energy"]) < 1e-6


def test_a_load_of_constant_current_ends_with_its_voltage_and_comes_back_with_it(found):
    case = found["load_behind_an_opened_breaker"]
    assert case["open"] == [0.0, 0.0]
    assert case["after"] == pytest.approx(10e3 / 750.0, rel=5e-3) and case["before"] > 13.0
    assert abs(case["energy"]) < 1e-3


def test_a_closed_contact_between_chokes_is_a_path(found):
    case = found["contact_between_chokes"]
    for L in (1e-3, 1.0):
        exact = 100.0 / 1.1001 * (1.0 - np.exp(-0.3e-3 * 1.1001 / (2.0 * L)))
        assert case[f"{L:g} H"] == pytest.approx(exact, rel=1e-4), L
    assert case["behind a breaker"][0] == pytest.approx(100.0, rel=1e-5)  # what the choke has beyond the sink: 0.1 A


def test_currents_of_chokes_that_do_not_add_up_are_refused_with_all_that_meet_there(found):
    case = found["currents_that_do_not_add_up"]
    assert case["both"] == pytest.approx(10.0)
    assert "at 'b.v_dc' do not add up (first 10 A, second 0 A, counted into each)" in case["one"]
    # a milliampere is made up for in the first step: by 1 mA x 0.5 mH / 8.8 us, 57 mV, beside half of the voltage
    assert case["nearly"][0] == pytest.approx(49.893, abs=2e-3) and case["nearly"][1] < 50.1


# components that are coupled by signals


@pytest.mark.parametrize(
    ("name", "least", "order"), [("coupled_by_signals", 1e-5, 1.95), ("coupled_over_the_network", 4e-4, 1.8)]
)
def test_continuous_components_that_read_each_other_are_of_second_order(found, name, least, order):
    """The loop over the network comes near two from below: 1.65, 1.84; the next halving has 1.92."""
    steps, errors = found[name]["steps"], found[name]["errors"]
    assert errors[-1] < least
    assert np.log(errors[-2] / errors[-1]) / np.log(steps[-2] / steps[-1]) > order


# remanence


def test_the_flux_of_a_core_rests_until_voltage_comes_and_then_rushes_in(found):
    case = found["remanence"]
    assert case["rests"] == 0.0 and case["current before"] == 0.0
    assert case["crest"] == pytest.approx(case["exact crest"], rel=1e-3)
    assert case["exact crest"] > 200.0
    assert abs(case["energy"]) < 1e-3


# discontinuous conduction


def test_discontinuous_conduction_with_few_steps_a_period_is_said_once(found):
    case = found["discontinuous_conduction"]
    assert len(case["few"]) == 1
    _, source, text = case["few"][0]
    assert source == "leg" and "1.67 steps" in text and "up to 80 %" in text
    assert len(case["on edges"]) == 1  # pulses that begin and end with steps are pulses too
    assert "4 steps" in case["on edges"][0][2] and "up to 45 %" in case["on edges"][0][2]
    assert case["more"] == [] and case["flowing"] == []


# operating points


@pytest.mark.parametrize("start", ["from values", "from a run"])
def test_meters_of_bridges_at_an_operating_point_agree_with_the_source(found, start):
    for name, (measured, right) in found["operating_point_meters"][start].items():
        assert measured == pytest.approx(right, rel=1e-9), name


def test_a_run_from_an_operating_point_goes_on_with_what_its_bridges_measured(found):
    # a vector that turns by 1.1 degrees a step of 50 us, beside a resonance of some 2 kHz: 1.1e-3 of second order
    assert found["operating_point_meters"]["stays"] < 2e-3


def test_a_blocked_drive_carries_no_current_and_has_its_emf_at_its_terminals(found):
    below = found["blocked_drive"]["below"]
    assert below["line"] < 750.0
    assert below["currents"] == pytest.approx([0.0] * 4, abs=1e-9)
    assert below["emf"][0] == pytest.approx(below["emf"][1], rel=1e-9)
    assert below["v_dc"] == pytest.approx(750.0, rel=1e-9)
    assert below["stays"] < 1e-9
    assert below["modes"] == 1  # the bus: no current is left to swing


@pytest.mark.parametrize("name", ["within", "low grid"])
def test_blocked_gates_at_a_choke_or_filter_let_no_current_through(found, name):
    assert found["blocked_chokes_and_filters"][name] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("above", "the diodes of 'leg' conduct: its pole is at 800 V, its bus at 750 V"),
        ("below", "the diodes of 'leg' conduct: its pole is at -5 V, its bus at 750 V"),
        ("high grid", "the diodes of 'bridge' conduct: the peak of its line voltage is 850.5 V, its bus 750 V"),
    ],
)
def test_blocked_gates_whose_diodes_conduct_behind_a_choke_or_filter_are_refused(found, name, why):
    assert why in found["blocked_chokes_and_filters"][name]


def test_a_leg_of_which_one_switch_is_driven_has_a_point_only_for_currents_of_its_sign(found):
    case = found["one_switch_driven"]
    assert case["both"] == pytest.approx(5.0 / (0.1 + 0.25e-3), rel=1e-9) and case["upper"] == case["both"]
    assert "49.88 A would flow out of 'leg', of which only the lower switch is driven" in case["lower"]


def test_a_blocked_drive_whose_diodes_would_conduct_has_no_operating_point(found):
    above = found["blocked_drive"]["above"]
    assert above["line"] > 750.0
    assert "the diodes of 'bridge' conduct: the peak of its line voltage is 809 V, its bus 750 V" in above["refused"]
