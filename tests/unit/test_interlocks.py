"""Interlocks on the ferry: which commands are held back, why, and when they are obeyed after all."""

import pytest

import shipgrid as sg
from shipgrid.automation.interlocks import Interlocks
from shipgrid.equipment import bess, rectifier
from shipgrid.scenarios.case import build

BESS_ON = {"droop": 1.0, "voltage": 2.0, "current": 3.0}


@pytest.fixture(scope="module")
def ship():
    return sg.load_ship("ferry")


@pytest.fixture(scope="module")
def plan(ship):
    return build(ship, 90e-6)


class Plant:
    """The ferry's signals, set by hand: both batteries on in droop, 40 kW, DC tie closed."""

    def __init__(self, ship, plan):
        self.sig, self.index = plan.layout.initial.copy(), plan.layout.index
        self.interlocks = Interlocks(ship, plan)
        self.plan = plan
        for side in ("for", "aft"):
            self.battery(side)
            self.drive(side, 20e3)
        self.tie(True)

    @staticmethod
    def source(plan, name):
        return plan.network.published[name].source

    def put(self, path, value):
        self.sig[self.index[path]] = float(value)

    def drive(self, side, power):
        self.put(self.source(self.plan, f"propulsion_{side}.omega_m"), 20.0)
        self.put(self.source(self.plan, f"propulsion_{side}.tau_e"), power / 20.0)

    def battery(self, side, mode="droop", on=True):
        self.put(f"command:bess_{side}.on", on)
        self.put(f"command:bess_{side}.mode", BESS_ON[mode])
        self.put(f"bess_{side}.sequence.state", bess.ON if on else bess.OFF)

    def genset(self, side, mode=0.0, connected=True):
        self.put(f"command:genset_{side}.on", 1.0)
        self.put(f"command:rectifier_{side}.mode", mode)
        self.put(f"rectifier_{side}.sequence.state", rectifier.CONNECTED if connected else rectifier.OFF)
        self.put(f"rectifier_{side}.sequence.connected", connected)
        self.put(f"rectifier_{side}.sequence.limit", 1.2 * connected)

    def tie(self, closed, commanded=None):
        self.put("dc_tie.sequence.closed", closed)
        self.put("command:dc_tie.close", closed if commanded is None else commanded)

    def ask(self, **commands):
        """Reasons for which commands are refused, by path; those obeyed are left out."""
        verdicts = self.interlocks.give(self.sig, {p.replace("__", "."): float(v) for p, v in commands.items()})
        return {v.path: v.reason for v in verdicts if v.reason}

    def command(self, path):
        return self.sig[self.index[f"command:{path}"]]


@pytest.fixture
def plant(ship, plan):
    return Plant(ship, plan)


def test_what_is_safe_is_obeyed(plant):
    assert plant.ask(bess_for__i_ref=40.0, propulsion_for__speed_ref=3.0, bess_for__on=False) == {}
    assert plant.command("bess_for.i_ref") == 40.0
    assert plant.command("bess_for.on") == 0.0  # the other one holds the bus


def test_two_sources_do_not_form_one_bus(plant):
    assert plant.ask(bess_for__mode=2.0) == {}
    refused = plant.ask(bess_aft__mode=2.0)
    assert list(refused) == ["bess_aft.mode"]
    assert refused["bess_aft.mode"] == "bess_for and bess_aft would both form the voltage of dc_aft and dc_for"
    assert plant.command("bess_aft.mode") == 1.0
    assert plant.ask(bess_aft__mode=3.0) == {}


def test_a_rectifier_counts_as_former_as_soon_as_its_genset_shall_run(plant):
    plant.ask(bess_for__mode=2.0)
    assert plant.ask(rectifier_aft__mode=1.0) == {}  # its genset is off
    assert "would both form" in plant.ask(genset_aft__on=True)["genset_aft.on"]
    assert plant.ask(rectifier_aft__mode=0.0, genset_aft__on=True) == {}


def test_buses_that_are_apart_may_each_have_a_former_and_are_not_tied_then(plant):
    plant.tie(False)
    assert plant.ask(bess_for__mode=2.0, bess_aft__mode=2.0) == {}
    assert "would both form" in plant.ask(dc_tie__close=True)["dc_tie.close"]
    assert plant.command("dc_tie.close") == 0.0


def test_a_tie_that_shall_close_counts_as_closed_for_formers(plant):
    plant.tie(False, commanded=True)  # it waits for 10 V, say
    assert plant.ask(bess_for__mode=2.0) == {}
    assert "would both form" in plant.ask(bess_aft__mode=2.0)["bess_aft.mode"]


def test_two_formers_change_places_in_one_instant(plant):
    plant.ask(bess_for__mode=2.0)
    plant.ask(bess_aft__mode=3.0)
    assert plant.ask(bess_for__mode=3.0, bess_aft__mode=2.0) == {}
    assert (plant.command("bess_for.mode"), plant.command("bess_aft.mode")) == (3.0, 2.0)


@pytest.mark.parametrize("command", [{"bess_aft__on": False}, {"bess_aft__mode": 3.0}], ids=["off", "current"])
def test_the_last_source_stays_under_load(plant, command):
    plant.battery("for", on=False)
    (reason,) = plant.ask(**command).values()
    assert reason == "no running source would hold dc_aft and dc_for under load"


def test_both_batteries_off_at_once_leaves_one(plant):
    refused = plant.ask(bess_for__on=False, bess_aft__on=False)
    assert len(refused) == 1


def test_a_genset_that_is_starting_holds_nothing_yet(plant):
    plant.battery("for", on=False)
    plant.genset("for", connected=False)
    assert plant.ask(bess_aft__on=False) != {}


def test_a_command_held_back_is_obeyed_when_it_is_safe(plant):
    plant.battery("for", on=False)
    plant.genset("for", connected=False)
    assert plant.ask(bess_aft__on=False) != {}
    assert plant.interlocks.again(plant.sig) == []  # nothing new to say
    plant.genset("for")
    ((path, value, reason),) = plant.interlocks.again(plant.sig)
    assert (path, value, reason) == ("bess_aft.on", 0.0, "")
    assert plant.command("bess_aft.on") == 0.0
    assert plant.interlocks.held == {}


def test_a_rectifier_holds_the_bus_when_it_may_carry_its_load(plant):
    plant.battery("for", on=False)
    plant.genset("for")
    plant.put("rectifier_for.sequence.limit", 0.05)  # 30 kW, on its ramp
    assert "would not carry the load" in plant.ask(bess_aft__on=False)["bess_aft.on"]
    plant.put("rectifier_for.sequence.limit", 0.07)
    assert [v.reason for v in plant.interlocks.again(plant.sig)] == [""]


def test_a_battery_is_not_left_with_more_than_its_droop_carries(plant):
    for side in ("for", "aft"):
        plant.drive(side, 30e3)
    assert "would not carry the load" in plant.ask(bess_for__on=False)["bess_for.on"]  # 128 A at 442 V are 57 kW
    assert plant.ask(bess_aft__i_ref=40.0) == {}
    assert [v.reason for v in plant.interlocks.again(plant.sig)] == [""]  # 168 A now


def test_recharging_batteries_do_not_let_the_genset_go(plant):
    plant.genset("for")
    for side in ("for", "aft"):
        plant.put(f"command:bess_{side}.i_ref", -128.0)
    assert "would not carry the load" in plant.ask(genset_for__on=False)["genset_for.on"]
    assert plant.ask(genset_for__on=False, bess_for__i_ref=0.0, bess_aft__i_ref=0.0) == {}


def test_another_command_takes_the_place_of_the_one_held_back(plant):
    plant.battery("for", on=False)
    assert plant.ask(bess_aft__on=False) != {}
    assert plant.ask(bess_aft__on=True) == {}
    plant.battery("for")
    assert plant.interlocks.again(plant.sig) == []
    assert plant.command("bess_aft.on") == 1.0


def test_opening_the_tie_does_not_leave_a_loaded_half_without_source(plant):
    plant.battery("for", on=False)
    assert plant.ask(dc_tie__close=False)["dc_tie.close"] == "no running source would hold dc_for under load"
    plant.battery("for")
    assert plant.ask(dc_tie__close=False) == {}


def test_an_unloaded_bus_may_be_left(ship, plan):
    plant = Plant(ship, plan)
    for side in ("for", "aft"):
        plant.drive(side, 0.0)
    assert plant.ask(bess_for__on=False, bess_aft__on=False) == {}


def test_what_is_unsafe_already_does_not_stop_other_commands(plant):
    plant.battery("for", on=False)
    plant.battery("aft", mode="current")  # nobody holds the bus: a fault, say
    assert plant.ask(genset_for__on=True, bess_aft__i_ref=20.0) == {}


def test_the_last_genset_stays_under_load_with_the_batteries_off(plant):
    plant.battery("for", on=False)
    plant.battery("aft", on=False)
    plant.genset("for")
    assert "genset_for.on" in plant.ask(genset_for__on=False)
    plant.genset("aft")
    assert plant.ask(genset_for__on=True) == {}
    assert plant.ask(genset_for__on=False) == {}
