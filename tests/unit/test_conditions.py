"""Entries of a time-line that wait: when they happen, how often, and what is remembered of them."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import pytest

from shipgrid.errors import ParameterError
from shipgrid.scenarios.conditions import Condition, ConditionalEntry, Conditions
from shipgrid.scenarios.timeline import Timeline

H, EVERY = 0.01, 10
"""Step [s], and steps between two instants: 0.1 s as in a run."""
SIGNALS = ("x", "y")


@pytest.fixture
def plan():
    """Two public signals and two commands, and nothing that moves them."""
    commands = {"a.on": 0.0, "b.on": 0.0}
    places = {**{f"item.{s}": k for k, s in enumerate(SIGNALS)}, "command:a.on": 2, "command:b.on": 3}
    published = {s: SimpleNamespace(source=f"item.{s}") for s in SIGNALS}
    network = SimpleNamespace(name="plant", published=published, commands=commands)
    return SimpleNamespace(h=H, network=network, layout=SimpleNamespace(index=places))


def above(limit, signal="x", **more):
    return Condition(signal, above=limit, text=f"{signal} above {limit:g}", **more)


def happenings(plan, entries, values, *, end=10.0, named_times=None, cut=None):
    """Times and names of what happens while `values(t)` gives x and y; `cut`: steps of pieces that it is run in."""
    work, events = SimpleNamespace(n=0, sig=[0.0] * 4), []
    how = {"entries": entries, "named_times": named_times}
    due, found, pieces = Timeline(plan, work, events, (), **how), [], iter(cut or ())
    while work.n <= round(end / H):
        work.sig[:2] = values(work.n * H)
        due.give()
        found += [(round(t, 6), who if who != "timeline" else text.partition(":")[0]) for t, who, text in events]
        events.clear()
        if next(pieces, 0):  # a snapshot, and another program that goes on
            kept = json.loads(json.dumps(due.remembered()))
            due = Timeline(plan, work, events, (), **how, continued=True)
            due.remember(kept)
        stop = min(due.until(), math.inf if cut is None else work.n + 7)
        work.n = int(min(stop, round(end / H) + 1))
    return found


def rising(t):
    return t, 0.0


def waves(t):
    """Above 0.5 for the first half of every two seconds, with a dip to 0.45 in the middle of it."""
    phase = t % 2.0
    return (0.45 if 0.45 < phase < 0.55 else 1.0) if phase < 0.95 else 0.0, 0.0


def marker(name, *conditions, **more):
    return ConditionalEntry(name, conditions=conditions, **more)


@pytest.mark.parametrize(
    ("entry", "times"),
    [
        (marker("e", above(0.55)), [0.6]),
        (marker("e", above(0.5)), [0.6]),  # at the limit is not above it
        (marker("e", above(0.55, hold=0.25)), [0.9]),  # seen to hold from 0.6 s
        (marker("e", above(0.55), start=2.03), [2.1]),
        (marker("e", above(0.55), start=2.0), [2.0]),
        (marker("e", above(0.55, hold=0.5), start=2.0), [2.5]),  # what was before does not count
        (marker("e", above(5.0), end=4.9), []),
        (marker("e", above(5.0), end=5.1), [5.1]),
        (marker("e", Condition("x", below=0.25, above=0.15)), [0.2]),
        (marker("e", above(0.55), Condition("y", below=-1.0)), []),  # both have to hold
        (marker("e", above(0.55), Condition("y", below=1.0)), [0.6]),
        (marker("e", above(-1.0)), [0.0]),  # holds at the start
        (marker("e", above(0.55), times=None), [0.6]),  # has never been false again
    ],
)
def test_an_entry_happens_at_the_first_instant_at_which_its_conditions_hold(plan, entry, times):
    assert happenings(plan, [entry], rising) == [(t, "e") for t in times]


@pytest.mark.parametrize(
    ("entry", "times"),
    [
        (marker("e", above(0.5)), [0.0]),
        (marker("e", above(0.5), times=3), [0.0, 0.6, 2.0]),
        (marker("e", above(0.5), times=None), [0.0, 0.6, 2.0, 2.6, 4.0, 4.6]),
        (marker("e", above(0.5, hysteresis=0.1), times=None), [0.0, 2.0, 4.0]),  # the dip is not far enough
        (marker("e", above(0.5, hold=0.3), times=None), [0.3, 0.9, 2.3, 2.9, 4.3, 4.9]),
        (marker("e", above(0.5, hold=0.4), times=None), [0.4, 2.4, 4.4]),  # the dip is what makes it wait again
        (marker("e", above(0.5), times=None, start=1.0, end=3.0), [2.0, 2.6]),
    ],
)
def test_one_that_may_happen_again_waits_until_its_condition_has_been_false(plan, entry, times):
    assert happenings(plan, [entry], waves, end=5.0) == [(t, "e") for t in times]


def test_an_entry_follows_another_after_a_delay_each_time(plan):
    entries = [
        marker("up", above(0.5, hysteresis=0.1), times=None),
        marker("later", after=("up",), delay=1.25, times=None),
        marker("once", after=("up",), delay=0.5),
    ]
    found = happenings(plan, entries, waves, end=4.0)
    assert found == [(0.0, "up"), (0.5, "once"), (1.3, "later"), (2.0, "up"), (3.3, "later"), (4.0, "up")]


def test_a_delay_begins_anew_when_what_it_follows_happens_again(plan):
    entries = [marker("up", above(0.5), times=2), marker("later", after=("up",), delay=0.7, times=None)]
    assert happenings(plan, entries, waves, end=4.0) == [(0.0, "up"), (0.6, "up"), (1.3, "later")]


def test_an_entry_with_a_condition_waits_for_its_predecessor_first(plan):
    entries = [marker("late", above(0.5), after=("named",)), marker("after both", after=("late", "named"), delay=0.2)]
    found = happenings(plan, entries, rising, named_times={"named": 3.14})
    # a command at 3.14 s would have stopped the run there; the instants stay whole multiples of 0.1 s
    assert found == [(3.2, "late"), (3.4, "after both")]


def test_a_circle_of_entries_goes_round(plan):
    """Out and back, as a ferry does, and no further than it is told to."""
    entries = [
        marker("go", Condition("x", below=0.5)),
        marker("go again", after=("back",), delay=0.4, times=2),
        marker("out", above(0.5), after=("go", "go again"), times=None),
        marker("back", Condition("x", below=0.5), after=("out",), times=None),
    ]
    names = [name for _, name in happenings(plan, entries, lambda t: (float(t % 1.0 > 0.55), 0.0), end=9.0)]
    assert names == ["go", "out", "back", "go again", "out", "back", "go again", "out", "back"]


ENTRIES = [
    marker("up", above(0.5, hysteresis=0.1, hold=0.2), times=None),
    marker("low", Condition("x", below=0.5), times=3),
    marker("later", after=("up",), delay=1.0, times=None),
    marker("named later", above(0.5), after=("named",), delay=1.0),
]


def test_neither_the_pieces_of_a_run_nor_where_it_is_continued_change_when_things_happen(plan):
    whole = happenings(plan, ENTRIES, waves, named_times={"named": 0.33})
    assert len(whole) > 10
    for cut in ([0] * 1000, [1] * 1000, [0, 0, 1] * 400):
        assert happenings(plan, ENTRIES, waves, named_times={"named": 0.33}, cut=cut) == whole


def test_a_run_is_stopped_only_where_something_may_happen(plan):
    """A live run is late after each visit, so that waiting for a time, or for another entry, takes none."""
    entries = [marker("delayed", above(9.0), after=("named",), delay=3.0), marker("late", above(9.0), start=5.02)]
    work = SimpleNamespace(n=0, sig=[0.0] * 4)
    due = Timeline(plan, work, [], (), entries=entries, named_times={"named": 1.0})
    assert due.give() is False and due.until() == 100
    work.n = 100
    due.give()
    assert due.until() == 400
    work.n = 510
    assert due.give() is True and due.until() == 520
    due = Timeline(plan, work, [], (), entries=[marker("over", above(9.0), end=5.0)])
    assert due.until() == math.inf


def test_commands_of_an_entry_are_given_and_logged_with_what_it_waited_for(plan):
    entry = ConditionalEntry("start", (("a.on", 1.0), ("b.on", 2.0)), (above(0.25),))
    work, events = SimpleNamespace(n=30, sig=[0.3, 0.0, 0.0, 0.0]), []
    due = Timeline(plan, work, events, [(0.3, "b.on", 5.0)], entries=[entry])
    assert due.give()
    assert work.sig[2:] == [1.0, 2.0]
    assert [(who, what) for _, who, what in events] == [
        ("b.on", "set to 5"),  # the later of two commands of one step counts
        ("b.on", "set to 2 by start: x above 0.25"),
        ("a.on", "set to 1 by start: x above 0.25"),
    ]


@pytest.mark.parametrize(
    ("entry", "complete", "verdict", "count"),
    [
        (marker("e", above(0.5)), True, "happened", "once"),
        (marker("e", above(50.0)), True, "never happened", "never"),
        (marker("e", above(50.0)), False, "not evaluated", "never"),
        (marker("e", above(50.0), optional=True), True, "not needed", "never"),
        (marker("e", above(0.5), times=4), True, "too few times", "1 of 4 times"),
        (marker("e", above(0.5), times=4), False, "not evaluated", "1 of 4 times"),
        (marker("e", above(0.5), times=4, optional=True), True, "happened", "1 of 4 times"),
        (marker("e", above(0.5), times=None), True, "happened", "once"),
    ],
)
def test_what_became_of_an_entry(plan, entry, complete, verdict, count):
    found = Conditions(plan, [entry], EVERY)
    for n in range(0, 100, EVERY):
        found.evaluate([n * H, 0.0], n)
    (outcome,) = found.outcomes(complete=complete)
    assert (outcome.verdict, outcome.count) == (verdict, count)
    assert outcome.missing == (verdict in ("never happened", "too few times"))
    assert outcome.first_s == (pytest.approx(0.6) if outcome.happened else None)
    json.dumps(outcome.as_dict(), allow_nan=False)


def test_what_an_entry_waits_for_is_said_in_words():
    assert marker("e", above(0.5), above(1.0, "y")).text == "x above 0.5 and y above 1"
    assert marker("e", after=("a", "b"), delay=30.0).text == "30 s after a or b"
    assert marker("e", above(0.5), after=("a",)).text == "x above 0.5, after a"


def test_a_condition_on_what_the_plant_does_not_have_is_refused(plan):
    with pytest.raises(ParameterError, match="signals that plant does not have: z"):
        Conditions(plan, [marker("e", above(0.5, "z"))], EVERY)
