"""A session steps what a run steps: whatever the pieces, whoever commands, and from every state it was in."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shipgrid as sg
from shipgrid.errors import InputErrors, ParameterError, SolverError, TopologyError
from shipgrid.scenarios.session import Run, run_until

H = 30e-6
STEP = 90e-6


@pytest.fixture(scope="module")
def plan():
    net = sg.Network("bench")
    a, b = net.dc_bus("a", 400.0), net.dc_bus("b", 400.0)
    net.capacitance(a, 1e-3)
    net.capacitance(b, 2e-3)
    net.conductance(a, 1e-3)
    net.add("source", sg.DcSource(v_0=400.0, R=0.1), branch=a)
    net.add("cable", sg.RlBranch(R=0.05, L=1e-4), branch=sg.Across(a, b))
    net.add("breaker", sg.Breaker(R_on=1e-3), branch=sg.Across(a, b), contact="closed")
    return sg.assemble(net, H)


@pytest.fixture(scope="module")
def case():
    return sg.Case("ferry", "mission", step=STEP)


@pytest.fixture(scope="module")
def moored(case):
    """A session of the ferry, and its state at the start: the search for it is made once."""
    session = sg.Session(case)
    return session, session.snapshot()


@pytest.fixture
def ferry(moored):
    session, state = moored
    session.restore(state)
    return session


def same(one, other):
    return np.array_equal(one.work.sig, other.work.sig) and np.array_equal(one.work.energy, other.work.energy)


STORY = ((0.5, "propulsion_for.speed_ref", 2.0), (1.3, "genset_for.on", True), (2.0, "dc_tie.close", False))


def told(session, cuts, until):
    """Step to an end in pieces, giving the commands of the story at their times."""
    times = sorted({*cuts, *(t for t, *_ in STORY), until})
    for t in times:
        session.advance(to=t)
        for at, path, value in STORY:
            if at == t:
                session.command(path, value)
    return session.work.sig.copy(), session.work.energy.copy()


@settings(max_examples=5, deadline=None)
@given(st.lists(st.floats(0.0, 3.0), max_size=12))
def test_pieces_do_not_matter(moored, cuts):
    session, state = moored
    session.restore(state)
    whole = told(session, [], 3.0)
    session.restore(state)
    pieces = told(session, cuts, 3.0)
    assert np.array_equal(whole[0], pieces[0]) and np.array_equal(whole[1], pieces[1])


def test_commands_of_a_session_do_what_those_of_a_time_line_do(ferry):
    mine = told(ferry, [], 3.0)
    shown = {path: f"{value} m/s" if path.endswith("speed_ref") else value for _, path, value in STORY}
    scenario = {
        "scenario": "story",
        "duration": "10 s",
        "start": {"state": "moored", "closed": ["dc_tie"]},
        "timeline": [{"at": f"{t} s", "set": {path: shown[path]}} for t, path, _ in STORY],
    }
    story = sg.Case("ferry", scenario, step=STEP)
    plan = story.plan()
    run = Run(plan, story.start(plan)[0], ship=story.ship)
    run_until(run, story.timeline(run), 3.0)
    assert np.array_equal(run.work.sig, mine[0]) and np.array_equal(run.work.energy, mine[1])


def test_a_restored_session_goes_on_as_it_did(ferry):
    ferry.advance(to=0.7)
    ferry.command("propulsion_for.speed_ref", 3.0)
    ferry.advance(by=0.31)
    state = ferry.snapshot()
    events = ferry.events
    ferry.advance(by=1.0)
    first = ferry.work.sig.copy(), ferry.work.energy.copy(), ferry.events
    ferry.command("bess_for.mode", "current")
    ferry.advance(by=0.5)
    ferry.restore(state)
    assert ferry.events == events and ferry.time == pytest.approx(1.01, abs=STEP)
    ferry.advance(by=1.0)
    assert np.array_equal(ferry.work.sig, first[0]) and np.array_equal(ferry.work.energy, first[1])
    assert ferry.events == first[2]


def test_energies_of_pieces_add_up_and_balance(ferry):
    ferry.command("propulsion_for.speed_ref", 3.0)
    ferry.advance(by=2.0)
    half = ferry.energy
    ferry.advance(by=2.0)
    whole = ferry.energy
    assert abs(ferry.energy_balance_error) < 2e-3  # that of the averaged ferry at 90 us, in its first seconds
    for ledger in ("losses", "consumers"):
        for path, joule in half[ledger].items():
            assert whole[ledger][path] >= joule - 1e-9, path  # neither comes back
    assert sum(whole["consumers"].values()) > 1.5 * sum(half["consumers"].values()) > 0.0


def test_the_time_line_of_the_scenario_goes_on(ferry, case):
    first = min(t for t, *_ in case.scenario.events)
    ferry.advance(to=first - 1.0)
    assert not any("set to" in event.text for event in ferry.events)
    ferry.advance(to=first + 0.01)
    assert any("set to" in event.text for event in ferry.events)


def test_what_the_interlocks_hold_back_is_said_and_does_not_happen(ferry):
    assert ferry.command("bess_for.on", False) == ""  # the other one holds both buses, over the tie
    assert ferry.command("bess_aft.on", False) != ""  # nobody would
    assert ferry.read("bess_aft.on") == 1.0
    assert any(event.text.startswith("refused:") and "by Python" in event.text for event in ferry.events)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("genset_for.onn", True, "has no command 'genset_for.onn' (nearest: 'genset_for.on')"),
        ("bess_for.mode", "drop", "'drop' is no value of it, expected"),
        ("bess_for.i_ref", 1e6, "out of range, expected"),
        ("bess_for.i_ref", float("nan"), "out of range, expected"),
        ("dc_tie.close", 0.5, "out of range, expected"),
    ],
)
def test_a_command_that_cannot_be_is_refused_with_what_can(ferry, path, value, said):
    before = ferry.work.sig.copy()
    with pytest.raises(ParameterError) as wrong:
        ferry.command(path, value)
    assert said in str(wrong.value)
    assert np.array_equal(ferry.work.sig, before)


def test_a_signal_that_does_not_exist_is_named_with_the_nearest(ferry):
    with pytest.raises(ParameterError, match=r"nearest: 'dc_for\.v_dc'"):
        ferry.read("dc_for.vdc")
    assert ferry.read("dc_for.v_dc") == pytest.approx(750.0, rel=0.05)
    assert {"dc_for.v_dc", "bess_for.i_ref"} <= set(ferry.signals)


def test_times_that_have_passed_or_are_none_are_refused(ferry):
    ferry.advance(by=0.1)
    for wrong in ({"to": 0.05}, {"by": -1.0}, {"by": float("nan")}, {"by": "1 s"}, {"by": 1.0, "to": 2.0}):
        with pytest.raises(ParameterError):
            ferry.advance(**wrong)
    ferry.advance()
    assert ferry.steps == round(0.1 / STEP) + 1


def test_a_circuit_is_stepped_like_a_run_of_it(plan):
    start = {"a.v_dc": 400.0, "b.v_dc": 400.0}
    run = plan.run(start, events=[sg.At(0.01, sg.Open("breaker"))], until=0.02, record=["b.v_dc"])
    with sg.Session(plan, start) as session:
        session.advance(to=0.004)
        session.advance(to=0.01)
        session.command("breaker.close", False)
        session.advance(to=0.02)
    assert np.array_equal(session.work.sig, run.end.sig)
    assert session.read("b.v_dc") == run["b.v_dc"].values[-1]
    again = sg.Session(plan, run.end)
    assert again.time == run.end.n * H
    assert np.array_equal(again.work.sig, run.end.sig)


def test_a_parameter_is_no_command_and_that_is_said(plan):
    with pytest.raises(ParameterError, match=r"R is a parameter, which stands during a run: assemble a new plan"):
        sg.Session(plan).command("cable.R", 1.0)
    with pytest.raises(InputErrors, match=r"v_0 is a parameter, which stands during a run: assemble a new plan"):
        plan.run(events=[sg.At(0.01, sg.Set("source.v_0", 1.0))], until=0.02)


def test_an_event_between_two_steps_is_given_at_the_nearest_and_says_so(plan):
    start = {"a.v_dc": 400.0, "b.v_dc": 400.0}
    events = [sg.At(0.0100133, sg.Open("breaker")), sg.At(0.015, sg.Close("breaker"))]
    run = plan.run(start, events=events, until=0.02, record=["b.v_dc"])
    assert [(event.source, event.text) for event in run.events] == [
        ("breaker.close", "opened, asked for at 0.0100133 s"),
        ("breaker.close", "closed"),
    ]
    assert run.events[0].time == pytest.approx(0.01002, abs=1e-9)


def test_a_run_that_diverges_says_so_and_can_be_taken_back(plan):
    session = sg.Session(plan, {"a.v_dc": 400.0, "b.v_dc": 400.0})
    state = session.snapshot()
    session.work.sig[plan.layout.index["cable.i"]] = np.nan
    with pytest.raises(SolverError, match="diverged"):
        session.advance(by=0.01)
    with pytest.raises(SolverError, match="restored"):
        session.advance(by=0.01)
    session.restore(state)
    session.advance(by=0.01)
    assert np.all(np.isfinite(session.work.sig))


def test_a_plant_in_parts_is_stepped_by_several_threads_to_the_same_bits():
    case = sg.Case("ferry", "mission", fidelity="switching", parts="ship")
    assert set(case.parts) == {"for", "aft", "grid"}
    plan = case.plan()
    start = case.start(plan)[0]
    found = []
    for workers in (1, 2):
        with sg.Session(plan, start, workers=workers) as session:
            session.advance(by=0.005)
            session.command("bess_for.i_ref", 10.0)
            session.advance(by=0.005)
            found.append((session.work.sig.copy(), session.work.energy.copy()))
    assert np.array_equal(found[0][0], found[1][0]) and np.array_equal(found[0][1], found[1][1])


def test_a_state_of_another_plan_is_refused(plan, moored):
    _, state = moored
    with pytest.raises(TopologyError, match="another plan"):
        sg.Session(plan).restore(state)


def test_a_case_is_checked_and_travels(case):
    again = pickle.loads(pickle.dumps(case))
    assert again.ship.text == case.ship.text and again.scenario.text == case.scenario.text
    assert again.step == STEP and again.plan().layout.size == case.plan().layout.size
    changed = sg.Case("ferry", "mission", overrides={"equipment.bess_for.capacity": "160 Ah"})
    assert changed.ship.item("bess_for").capacity == pytest.approx(160.0 * 3600.0)
    with pytest.raises(InputErrors, match="nowhere"):
        sg.Case("nowhere", "mission")
    with pytest.raises(ParameterError, match="fidelity"):
        sg.Case("ferry", "mission", fidelity="exact")
    with pytest.raises(ParameterError, match="step"):
        sg.Case("ferry", "mission", step=1.0)
    with pytest.raises(ParameterError, match="begins where its scenario says"):
        sg.Session(case, {"a": 1.0})
