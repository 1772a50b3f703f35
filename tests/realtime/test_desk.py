"""The desk: what is obeyed, what is refused, and what becomes of the commands of a controller that fell silent."""

from __future__ import annotations

import math

import numpy as np
import pytest

from realtime.plants import Plant
from scenarios.killed_runs import case
from shipgrid.equipment import bess
from shipgrid.realtime import desk as desks
from shipgrid.realtime.desk import (
    BUSY,
    GATEWAY,
    MODBUS,
    OBEYED,
    OUT_OF_RANGE,
    RAMP,
    REFUSED,
    UDP,
    UNKNOWN,
    Desk,
)
from shipgrid.scenarios.case import build


@pytest.fixture(scope="module")
def ferry():
    ship, scenario = case()
    plan = build(ship, scenario.step)
    sig = plan.layout.initial.copy()
    for side in ("for", "aft"):  # both batteries on in droop, 20 kW a drive
        sig[plan.layout.index[f"command:bess_{side}.on"]] = 1.0
        sig[plan.layout.index[f"bess_{side}.sequence.state"]] = bess.ON
        sig[plan.layout.index[f"bess_{side}.converter.v_c"]] = 440.0
        sig[plan.layout.index[plan.network.published[f"propulsion_{side}.omega_m"].source]] = 20.0
        sig[plan.layout.index[plan.network.published[f"propulsion_{side}.tau_e"].source]] = 1e3
    sig[plan.layout.index["command:dc_tie.close"]] = sig[plan.layout.index["dc_tie.sequence.closed"]] = 1.0
    return ship, plan, sig


class Hand:
    """A desk, the plant behind it, and a clock that goes when it is told to."""

    def __init__(self, ferry, lost="hold"):
        ship, plan, sig = ferry
        self.now = 100.0
        self.plant = Plant(plan, sig)
        self.desk = Desk(ship, plan, self.plant.shared, lost, 0.5, lambda: self.now)
        self.desk.look()

    def give(self, path, value, origin=UDP):
        return self.desk.command([(path, value)], origin)[0]

    def wait(self, seconds, *heard):
        for _ in range(round(seconds / 5e-3)):
            self.now += 5e-3
            for origin in heard:
                self.desk.heard(origin)
            self.desk.look()
            self.desk.watch()
            self.plant.take()


@pytest.fixture
def hand(ferry):
    return Hand(ferry)


def test_a_command_is_obeyed_by_the_plant_and_shown_on_its_way(hand):
    assert hand.give("bess_for.i_ref", 30.0) == OBEYED
    hand.desk.look()
    assert dict(zip(hand.desk.commands, hand.desk.commanded(), strict=True))["bess_for.i_ref"] == 30.0
    ((place, value, origin, _),) = hand.plant.take()
    assert (hand.plant.index["command:bess_for.i_ref"], 30.0, UDP) == (place, value, origin)
    hand.desk.look()
    hand.plant.publish()
    hand.desk.look()
    assert not hand.desk.given


def test_ends_of_a_range_are_in_it_and_what_lies_beyond_is_not(hand):
    for path, command in hand.desk.commands.items():
        for value in (
            np.nextafter(command.low, -np.inf),
            np.nextafter(command.high, np.inf),
            math.nan,
            math.inf,
            -math.inf,
        ):
            assert hand.give(path, value) == OUT_OF_RANGE, path
        if command.words is not None:
            assert hand.give(path, 0.5 * (command.low + command.high) + 0.25) == OUT_OF_RANGE, path
        assert hand.desk._checked(path, command.low) == hand.desk._checked(path, command.high) == OBEYED, path
    assert hand.give("bess_for.soc", 0.5) == hand.give("", 0.0) == UNKNOWN
    assert hand.plant.take() == []


def test_what_the_interlocks_refuse_is_refused_and_two_sources_can_change_places(hand):
    assert hand.give("bess_for.mode", 2.0) == OBEYED
    assert hand.give("bess_aft.mode", 2.0) == REFUSED  # both would form the voltage
    swap = [("bess_aft.mode", 2.0), ("bess_for.mode", 1.0)]
    assert hand.desk.command(swap, UDP) == [OBEYED, OBEYED]
    hand.plant.take()
    assert (hand.plant.command("bess_for.mode"), hand.plant.command("bess_aft.mode")) == (1.0, 2.0)


def test_whole_means_all_or_none(hand):
    asked = [("propulsion_for.speed_ref", 2.0), ("propulsion_aft.speed_ref", 99.0)]
    assert hand.desk.command(asked, MODBUS, whole=True) == [OUT_OF_RANGE, OUT_OF_RANGE]
    refused = [("propulsion_for.speed_ref", 2.0), ("bess_for.mode", 2.0), ("bess_aft.mode", 2.0)]
    assert hand.desk.command(refused, MODBUS, whole=True) == [REFUSED] * 3
    assert hand.plant.take() == []
    assert hand.desk.command(asked, UDP) == [OBEYED, OUT_OF_RANGE]


def test_commands_that_have_not_been_logged_keep_their_place(hand):
    for k in range(64):
        assert hand.give("bess_for.i_ref", float(k)) == OBEYED
        hand.plant.arrays["inbox_count"][1] += 1  # taken, and not in the log yet
    assert hand.give("bess_for.i_ref", 99.0) == BUSY
    assert hand.desk.command([("bess_for.i_ref", 99.0)], UDP, whole=True) == [BUSY]
    hand.plant.arrays["inbox_count"][2] = 1
    assert hand.give("bess_for.i_ref", 99.0) == OBEYED


def test_the_interlocks_are_asked_only_about_what_they_judge(hand, monkeypatch):
    asked = []
    monkeypatch.setattr(hand.desk.interlocks, "refusals", lambda *given: asked.append(given[2]) or {})
    for path, command in hand.desk.commands.items():
        hand.give(path, command.high)
    judged = {path for commands in asked for path in commands}
    rest = set(hand.desk.commands) - judged
    assert all(path.rpartition(".")[2] in desks.NOT_JUDGED for path in rest)
    assert {"bess_for.i_ref", "bess_for.mode", "genset_for.on", "dc_tie.close"} <= judged


def test_no_command_that_is_not_judged_can_be_refused_by_the_interlocks(ferry):
    ship, plan, sig = ferry
    interlocks = desks.Interlocks(ship, plan)
    present = {path: float(sig[plan.layout.index[f"command:{path}"]]) for path in ship.commands}
    for path, command in ship.commands.items():
        if path.rpartition(".")[2] in desks.NOT_JUDGED:
            for value in (command.low, command.high):
                assert interlocks.refusal(sig, present, {path: value}) == "", path


@pytest.mark.parametrize("lost", desks.LOST)
def test_a_controller_that_is_heard_is_not_lost(ferry, lost):
    hand = Hand(ferry, lost)
    hand.give("bess_for.i_ref", 50.0)
    hand.wait(5.0, UDP)
    assert hand.plant.command("bess_for.i_ref") == 50.0
    assert not hand.desk.counted["controllers lost, UDP"]


def test_hold_leaves_everything_as_it_was_commanded(ferry):
    hand = Hand(ferry, "hold")
    hand.give("bess_for.i_ref", 50.0)
    hand.wait(2.0 * RAMP)
    assert hand.plant.command("bess_for.i_ref") == 50.0
    assert hand.desk.counted["controllers lost, UDP"] == 1


def test_safe_goes_to_standstill_over_a_ramp_and_leaves_the_speed_of_a_genset_alone(ferry):
    hand = Hand(ferry, "safe")
    asked = {"bess_for.i_ref": 50.0, "propulsion_for.speed_ref": -4.0, "genset_for.speed_ref": 1.03}
    asked |= {"bess_aft.v_dc_ref": 760.0}
    hand.desk.command(list(asked.items()), UDP)
    hand.wait(0.5 + 0.5 * RAMP)
    for path in ("bess_for.i_ref", "propulsion_for.speed_ref"):
        assert hand.plant.command(path) == pytest.approx(0.5 * asked[path], rel=0.02)
    hand.wait(RAMP)
    assert {path: hand.plant.command(path) for path in asked} == {
        "bess_for.i_ref": 0.0,
        "propulsion_for.speed_ref": 0.0,
        "genset_for.speed_ref": 1.03,
        "bess_aft.v_dc_ref": 760.0,
    }
    count = int(hand.plant.arrays["inbox_count"][0])
    hand.wait(1.0)
    assert hand.plant.arrays["inbox_count"][0] == count  # it has come to its end


def test_a_ramp_ends_where_it_is_when_the_controller_is_back_and_begins_there_again(ferry):
    hand = Hand(ferry, "safe")
    hand.give("propulsion_for.speed_ref", 4.0)
    hand.wait(0.5 + 0.5 * RAMP)
    hand.desk.heard(UDP)
    there = hand.plant.command("propulsion_for.speed_ref")
    hand.wait(1.0, UDP)
    assert hand.plant.command("propulsion_for.speed_ref") == there == pytest.approx(2.0, rel=0.02)
    hand.wait(0.6)
    assert 0.9 * there < hand.plant.command("propulsion_for.speed_ref") < there


def test_local_gives_back_what_there_was_before(ferry):
    hand = Hand(ferry, "local")
    hand.give("bess_for.i_ref", 50.0)
    hand.give("bess_for.i_ref", 60.0)
    hand.wait(0.6)
    assert hand.plant.command("bess_for.i_ref") == 0.0
    origins = [int(entry.origin) for entry in hand.plant.arrays["inbox"][:3]]
    assert origins == [UDP, UDP, GATEWAY]


def test_what_the_interlocks_hold_back_at_a_hand_back_is_given_when_it_is_safe(ferry):
    hand = Hand(ferry, "local")
    for side in ("for", "aft"):
        hand.plant.sig[hand.desk.sources[hand.desk.signals.index(f"propulsion_{side}.tau_e")]] = 1.75e3
    assert hand.give("bess_for.mode", 2.0) == OBEYED
    hand.plant.take()
    hand.plant.sig[hand.plant.index["command:bess_aft.on"]] = 0.0
    state = hand.plant.index["bess_aft.sequence.state"]
    hand.plant.sig[state] = bess.OFF
    # alone, and with 70 kW to carry, droop from a reference of 0 A would not do
    hand.wait(0.6)
    assert hand.plant.command("bess_for.mode") == 2.0
    hand.plant.sig[hand.plant.index["command:bess_aft.on"]] = 1.0
    hand.plant.sig[state] = bess.ON
    hand.wait(0.2)
    assert hand.plant.command("bess_for.mode") == 1.0


def test_what_somebody_else_has_commanded_since_is_left_to_him(ferry):
    hand = Hand(ferry, "safe")
    hand.give("bess_for.i_ref", 50.0, UDP)
    hand.give("bess_for.i_ref", 20.0, MODBUS)
    hand.wait(2.0 * RAMP, MODBUS)
    assert hand.plant.command("bess_for.i_ref") == 20.0
    hand.give("propulsion_for.speed_ref", 4.0, UDP)
    hand.wait(0.1, UDP, MODBUS)
    hand.plant.sig[hand.plant.index["command:propulsion_for.speed_ref"]] = 3.0  # the scenario
    hand.wait(2.0 * RAMP, MODBUS)
    assert hand.plant.command("propulsion_for.speed_ref") == 3.0


def test_a_copy_during_which_the_ring_went_round_is_taken_again(hand, monkeypatch):
    outbox = hand.plant.arrays["outbox"]

    class Slow:
        """Hands out a slot, and lets the plant go round the ring the first time."""

        rounds = 0

        def __getitem__(self, slot):
            values = outbox[slot].copy()
            if not self.rounds:
                self.rounds += 1
                for _ in range(desks.SLOTS):
                    hand.plant.sig[:] += 1.0
                    hand.plant.take()
            return values

    hand.desk.arrays = hand.plant.arrays | {"outbox": Slow()}
    assert hand.desk.look() == hand.plant.steps
    assert np.array_equal(hand.desk.sig, hand.plant.sig)
