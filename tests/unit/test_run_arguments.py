"""Times given to a run: numbers of seconds, inside the run, or a clear refusal before anything is computed."""

from __future__ import annotations

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.scenarios.events import seconds, timeline


@pytest.fixture(scope="module")
def plan():
    net = sg.Network("one bus")
    bus = net.dc_bus("bus", 100.0)
    net.add("source", sg.DcSource(v_0=100.0, R=1.0), a=bus)
    net.add("breaker", sg.Breaker(), a=bus)
    return sg.assemble(net, step=30e-6)


@pytest.mark.parametrize("until", ["1", "0.1 s", None, [1.0, 2.0]])
def test_an_end_that_is_no_number_is_refused(plan, until):
    with pytest.raises(ParameterError, match=r"until = .* is not a number, expected a time in seconds"):
        plan.run(until=until)


@pytest.mark.parametrize(("option", "value"), [("until", "1"), ("until", "0.1 s"), ("step", "30 us")])
def test_a_scenario_is_not_run_to_an_end_or_in_steps_that_are_no_numbers(tmp_path, option, value):
    ship = sg.load_ship("ferry")
    scenario = sg.load_scenario("mission", ship)
    with pytest.raises(ParameterError, match=f"{option} = '{value}' is not a number, expected a time in seconds"):
        sg.simulate(ship, scenario, out=tmp_path / "out", **{option: value})
    assert list(tmp_path.iterdir()) == []


def test_numbers_of_every_sort_are_times():
    assert [seconds("until", t) for t in (2, 0.5, np.float32(0.25), np.array(1.5))] == [2.0, 0.5, 0.25, 1.5]


def test_an_event_after_the_end_is_refused_with_all_other_mistakes(plan):
    events = [
        sg.At(0.1, sg.Open("breaker")),
        sg.At(0.2, sg.Close("breaker")),
        sg.At(0.3, sg.Open("breaker")),
        sg.At("0.1 s", sg.Open("breaker")),
        sg.At(0.1, sg.Set("source.v_pu", "1")),
        sg.At(-0.1, sg.Open("breaker")),
    ]
    with pytest.raises(InputErrors) as caught:
        plan.run(events=events, until=0.2)
    late, text, value, early = caught.value.problems
    assert "time=0.3" in late and late.endswith("is after the end, expected at most 0.2 s (until)")
    assert "'0.1 s'" in text and "expected time and value in SI units" in text
    assert "source.v_pu" in value and "expected time and value in SI units" in value
    assert "the run starts at 0 s" in early
    assert [at for at, *_ in timeline(plan, events[:2], 0.0, 0.2)] == [0.1, 0.2]
