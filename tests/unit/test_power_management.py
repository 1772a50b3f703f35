"""Rules of power management: how a scenario file says them, what is refused, and what the operator among them does."""

from types import SimpleNamespace

import numpy as np
import pytest

from scenarios.story import RING
from shipgrid.automation.power_management import BlackoutPrevention, LowSocOperator, StartGensetOnLowSoc
from shipgrid.equipment import bess, rectifier
from shipgrid.io.scenario_file import read_scenario
from shipgrid.io.ship_file import bundled, load_ship, read_ship
from shipgrid.io.yaml_lines import read_document, read_text
from shipgrid.model.network import Network

HEAD = "schema: 1\nscenario: short\nduration: 60 s\nstart: {state: moored, closed: [dc_tie], soc: {bess_for: 40 %}}\n"
FULL = (
    HEAD
    + """\
rules:
  blackout_prevention: {battery: 0.9 pu, genset: 90 pu}
  start_genset_on_low_soc: {below: 35 %, until: 45 %, recharge: 100 A, genset: genset_aft}
"""
)


@pytest.fixture(scope="module")
def ship():
    return load_ship("ferry")


def reading(text, ship):
    return read_scenario(read_text(text, "my.yaml"), ship.catalogue)


def test_no_rule_is_in_force_unless_a_scenario_says_so(ship):
    assert reading(HEAD, ship).checked().rules == ()
    silent = [name for name, path in bundled("scenario").items() if "\nrules:" not in path.read_text()]
    assert {"mission", "dc-regulation", "ac-regulation"} <= set(silent)


def test_rules_are_read_with_units_and_defaults(ship):
    scenario = reading(FULL.replace("genset: 90 pu", "response: 100 ms"), ship).checked()
    assert scenario.rules == (
        BlackoutPrevention(battery=0.9, response=0.1),
        StartGensetOnLowSoc(below=0.35, until=0.45, recharge=100.0, genset="genset_aft"),
    )
    assert reading(HEAD + "rules: {blackout_prevention: }\n", ship).checked().rules == (BlackoutPrevention(),)


def test_the_charge_at_the_start_is_the_scenarios_where_it_says_one(ship):
    scenario = reading(HEAD, ship).checked()
    charged = scenario.ship_at_start(ship)
    assert (charged.item("bess_for").soc_0, charged.item("bess_aft").soc_0) == (0.4, 0.5)
    assert scenario.ship_at_start(charged).text == charged.text  # so that run.yaml repeats the run


@pytest.mark.parametrize(
    ("old", "new", "line", "what"),
    [
        ("blackout_prevention:", "blackout_preventing:", 6, "no such rule (nearest: 'blackout_prevention')"),
        ("0.9 pu", "0.9", 6, "rules.blackout_prevention.battery: '0.9' has no unit"),
        ("0.9 pu", "0 pu", 6, "is out of range, expected > 0 (largest current of a battery"),
        ("0.9 pu", "1.5 pu", 6, "1.5 pu is not below the 1.5 pu at which the control of bess_for limits its current"),
        ("genset: 90 pu", "gensets: 90 pu", 6, "no such key"),
        ("{battery: 0.9 pu, genset: 90 pu}", "on", 6, "is not a mapping"),
        (
            "until: 45 %",
            "until: 35 %",
            7,
            "start_genset_on_low_soc.until: 0.35 is not above the 0.35 at which it starts",
        ),
        ("below: 35 %", "below: 22 %", 7, "0.22 is where bess_for gives no full current any more (its soc_min 0.2"),
        ("until: 45 %", "until: 0.89", 7, "0.89 is where bess_for takes no full current any more (its soc_max 0.9"),
        ("100 A", "200 A", 7, "200 A is more than bess_for can be told (192 A)"),
        ("genset_aft", "genset_after", 7, "there is no genset 'genset_after', expected one of genset_for, genset_aft"),
        ("40 %", "1 %", 4, "start.soc.bess_for: 0.01 is out of range"),
        ("soc: {bess_for", "soc: {bess_fore", 4, "no battery 'bess_fore' (nearest: 'bess_for')"),
    ],
)
def test_a_mistake_is_named_with_its_line_and_what_is_expected(ship, old, new, line, what):
    assert old in FULL
    lines = reading(FULL.replace(old, new, 1), ship).problems.lines()
    assert any(problem.startswith(f"my.yaml:{line}: ") and what in problem for problem in lines), lines


def test_a_rule_that_the_ship_has_nothing_for_is_refused():
    text = """
schema: 1
ship: barge
buses:
  dc: {kind: dc, v_n: 750 V}
equipment:
  bess_one: {kind: bess, bus: dc}
"""
    barge = read_ship(read_text(text, "barge.yaml")).checked()
    head = HEAD.replace("closed: [dc_tie], soc: {bess_for: 40 %}", "closed: []")
    lines = reading(head + "rules: {blackout_prevention: {}, start_genset_on_low_soc: {}}\n", barge).problems.lines()
    assert lines[0].partition("prevention: ")[2] == "there is no propulsion to cut back"
    assert lines[1].endswith("start_genset_on_low_soc: the ship has no genset, expected both")


def test_a_source_counts_over_every_way_that_ties_can_make():
    net, ring = Network("ring"), read_ship(read_text(RING, "ring.yaml")).checked()
    ring.build(net)
    BlackoutPrevention().build(net, ring)
    joined = {
        placed.inputs["joined"] for path, placed in net.placed.items() if path.startswith("drive.load_limit.bess")
    }
    assert joined == {"tie_ca.sequence.closed", "drive.load_limit.way_tie_ab_tie_bc.joined"}
    way = net.placed["drive.load_limit.way_tie_ab_tie_bc"]
    assert way.inputs == {"before": "tie_ab.sequence.closed", "closed": "tie_bc.sequence.closed"}


def test_without_the_rule_nothing_is_added_to_the_plant(ship):
    net = Network("ferry")
    ship.build(net)
    assert net.placed["propulsion_for.speed"].inputs["share"] == "propulsion_for.sequence.share"
    assert net.placed["propulsion_for.cruise"].inputs["speed_ref"] == "command:propulsion_for.speed_ref"
    assert not [path for path in net.placed if "load_limit" in path]


class Plant:
    """The ferry's signals as the operator sees them, set by hand: at berth, batteries in droop."""

    def __init__(self, ship, **rule):
        paths = [f"command:{path}" for path in ship.commands]
        for side in ("for", "aft"):
            paths += [f"bess_{side}.battery.soc", f"bess_{side}.sequence.state", f"genset_{side}.sequence.refused"]
            paths += [f"rectifier_{side}.sequence.state", f"rectifier_{side}.sequence.refused"]
        self.index = {path: k for k, path in enumerate(paths)}
        self.sig = np.zeros(len(paths))
        rule = StartGensetOnLowSoc(**{"below": 0.3, "until": 0.4, "recharge": 64.0, **rule})
        self.operator = LowSocOperator(rule, ship, SimpleNamespace(layout=SimpleNamespace(index=self.index)))
        for side in ("for", "aft"):
            self.put(f"command:bess_{side}.mode", 1.0)
            self.put(f"bess_{side}.sequence.state", bess.ON)
        self.charge(0.5)

    def put(self, path, value):
        self.sig[self.index[path]] = value

    def charge(self, fore, aft=0.5):
        self.put("bess_for.battery.soc", fore)
        self.put("bess_aft.battery.soc", aft)

    def look(self, obeyed=True):
        order = self.operator.look(self.sig)
        for path, value in order.commands.items() if order is not None and obeyed else ():
            self.put(f"command:{path}", value)
        return None if order is None else order.commands

    def low(self):
        self.charge(0.29)
        return self.look()

    def connected(self, side="for"):
        self.put(f"rectifier_{side}.sequence.state", rectifier.CONNECTED)
        return self.look()


def test_one_low_battery_starts_the_genset_and_when_it_is_connected_all_are_recharged(ship):
    plant = Plant(ship)
    assert plant.look() is None
    assert plant.low() == {"genset_for.on": 1.0}
    assert plant.look() is None
    assert plant.connected() == {"bess_for.i_ref": -64.0, "bess_aft.i_ref": -64.0}
    assert plant.look() is None


def test_when_all_are_charged_the_set_points_are_what_they_were_and_the_genset_goes(ship):
    plant = Plant(ship)
    plant.put("command:bess_aft.i_ref", 25.0)
    plant.low()
    plant.connected()
    plant.charge(0.41, 0.39)
    assert plant.look() is None
    plant.charge(0.41, 0.40)
    assert plant.look() == {"bess_for.i_ref": 0.0, "bess_aft.i_ref": 25.0, "genset_for.on": 0.0}
    assert plant.low() == {"genset_for.on": 1.0}  # and again


def test_a_battery_that_is_off_or_not_in_droop_is_left_alone(ship):
    plant = Plant(ship)
    plant.put("bess_aft.sequence.state", bess.OFF)
    plant.low()
    assert plant.connected() == {"bess_for.i_ref": -64.0}
    plant = Plant(ship)
    plant.put("command:bess_for.mode", 3.0)
    plant.low()
    assert plant.connected() == {"bess_aft.i_ref": -64.0}


def test_where_an_operator_has_a_genset_on_the_rule_does_nothing(ship):
    plant = Plant(ship)
    plant.put("command:genset_aft.on", 1.0)
    assert plant.low() is None


@pytest.mark.parametrize(("path", "value"), [("genset_for.on", 0.0), ("bess_aft.i_ref", -20.0)])
def test_who_changes_one_of_its_commands_has_taken_over_until_the_batteries_are_charged(ship, path, value):
    plant = Plant(ship)
    plant.low()
    plant.connected()
    plant.put(f"command:{path}", value)
    assert [plant.look() for _ in range(3)] == [None] * 3
    plant.put("command:genset_for.on", 0.0)
    assert plant.look() is None and plant.operator.state["doing"] == "let go"
    plant.charge(0.5)
    plant.look()
    assert plant.low() == {"genset_for.on": 1.0}


def test_a_command_that_the_interlocks_hold_back_is_not_taken_for_somebody_elses(ship):
    plant = Plant(ship)
    plant.low()
    plant.put("rectifier_for.sequence.state", rectifier.CONNECTED)
    assert plant.look(obeyed=False)
    assert plant.look() is None and plant.operator.state["doing"] == "charging"


@pytest.mark.parametrize("who", ["genset", "rectifier"])
def test_a_genset_that_refuses_is_given_up_for_the_next_and_then_it_lets_go(ship, who):
    plant = Plant(ship, genset="genset_aft")
    assert plant.low() == {"genset_aft.on": 1.0}
    plant.put(f"{who}_aft.sequence.refused", 2.0)
    assert plant.look() == {"genset_aft.on": 0.0, "genset_for.on": 1.0}
    plant.put(f"{who}_for.sequence.refused", 2.0)
    assert plant.look() == {"genset_for.on": 0.0}
    assert plant.look() is None and plant.operator.state["doing"] == "let go"


@pytest.mark.parametrize("name", ["overload", "low-charge"])
def test_the_bundled_scenarios_of_the_rules_fit_the_ferry(ship, name):
    assert read_scenario(read_document(bundled("scenario")[name]), ship.catalogue).checked().rules
