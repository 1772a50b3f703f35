"""Blackout prevention: which source decides, and how fast and how far a drive is cut back."""

import pytest

from shipgrid.automation.load_limit import (
    NOBODY,
    Input,
    LoadInput,
    LoadLimit,
    LoadOutput,
    LoadState,
    Output,
    SourceLoad,
    State,
    load_update,
    update,
)
from shipgrid.model.records import make_record, parameter_record

DT = 1e-3
BATTERY = SourceLoad(number=1.0, capacity=56e3, i_most=128.0)
GENSET = SourceLoad(number=2.0, capacity=566e3, p_most=0.95)
DRIVE = LoadLimit(rating=270e3, tau_max=1.25, T_cut=0.05)


def link(item, before=(NOBODY, 0.0, 0.0), p_f=0.0, **inputs):
    """Loading, capacity and number after one link of the chain."""
    p, _ = parameter_record(item)
    x, x_next, y = make_record(LoadState, {"p_f": p_f}), make_record(LoadState), make_record(LoadOutput)
    u = make_record(LoadInput, {**dict(zip(("loading", "capacity", "which"), before, strict=True)), **inputs})
    load_update(0.0, DT, x, u, p, x_next, y)
    return y.loading, y.capacity, y.which


def test_a_battery_in_droop_is_loaded_by_its_current_over_what_the_rule_allows():
    assert link(BATTERY, i_star=96.0, mode=1.0, joined=1.0) == (0.75, 56e3, 1.0)
    assert link(BATTERY, i_star=96.0, mode=2.0, joined=1.0) == (0.75, 56e3, 1.0)


@pytest.mark.parametrize(
    "inputs", [{"mode": 0.0, "joined": 1.0}, {"mode": 3.0, "joined": 1.0}, {"mode": 1.0, "joined": 0.0}]
)
def test_off_in_current_mode_and_behind_an_open_tie_it_does_not_count(inputs):
    assert link(BATTERY, i_star=190.0, **inputs) == (NOBODY, 0.0, 0.0)


def test_a_genset_is_loaded_by_its_power_while_its_rectifier_is_connected():
    assert link(GENSET, p=0.475, p_f=0.475, connected=1.0, joined=1.0) == (pytest.approx(0.5), 566e3, 2.0)
    assert link(GENSET, p=0.475, p_f=0.475, connected=0.0, joined=1.0) == (NOBODY, 0.0, 0.0)


def test_the_heaviest_loaded_source_decides_wherever_it_stands_in_the_chain():
    light, heavy = (0.3, 566e3, 2.0), (0.9, 566e3, 2.0)
    assert link(BATTERY, light, i_star=96.0, mode=1.0, joined=1.0) == (0.75, 56e3, 1.0)
    assert link(BATTERY, heavy, i_star=96.0, mode=1.0, joined=1.0) == heavy


class Drive:
    """One drive at half its speed, and the limiter before it."""

    def __init__(self, **start):
        self.p, _ = parameter_record(DRIVE)
        self.x = make_record(State, {"p_max": 2.0, "held": 15.0, **start})
        self.y = make_record(Output)

    def see(self, loading, tau, limited=False, omega=0.5, steps=1, **others):
        said = {"loading": loading, "capacity": 56e3, "which": 1.0, "granted": 1.0, "speed_ref": 5.0, "u_ship": 4.0}
        said |= {"tau_ref": tau, "torque_limited": float(limited), "omega_pu": omega, **others}
        for _ in range(steps):
            x_next = make_record(State, {name: getattr(self.x, name) for name in ("p_max", "held", "cause")})
            update(0.0, DT, self.x, make_record(Input, said), self.p, x_next, self.y)
            self.x = x_next
        return self


def test_far_from_any_limit_it_changes_nothing():
    drive = Drive().see(0.4, tau=0.3, capacity=566e3)
    assert (drive.y.share, drive.y.speed_ref, drive.y.limited, drive.x.cause) == (1.0, 5.0, 0.0, 0.0)


def test_no_more_is_allowed_than_the_source_has_left_so_that_nothing_has_to_be_unwound():
    drive = Drive().see(0.9, tau=0.3)
    assert drive.x.p_max == pytest.approx(0.15 + 0.1 * 56e3 / 270e3)
    drive.see(1.0, tau=0.3)
    assert drive.x.p_max == pytest.approx(0.15)
    assert drive.y.share * 1.25 == pytest.approx(0.3)  # the torque that it has


def test_an_overload_is_taken_away_at_a_rate_of_itself_over_the_response():
    drive = Drive(p_max=0.15).see(1.2, tau=0.3, limited=True, steps=10)
    assert drive.x.p_max == pytest.approx(0.15 - 0.2 * 56e3 / 270e3 * 10e-3 / 0.05)
    assert drive.y.limited == 1.0
    assert drive.see(1.2, tau=0.0, limited=True, steps=1000).x.p_max == 0.0  # and never below nothing


def test_where_no_source_counts_it_lets_go():
    assert Drive(p_max=0.1).see(NOBODY, tau=0.3, steps=2000).y.share == 1.0


def test_a_drive_that_is_ramped_by_its_own_sequence_is_not_said_to_be_cut_back():
    drive = Drive().see(0.5, tau=0.06, limited=True, granted=0.05)
    assert (drive.y.share, drive.y.limited) == (0.05, 0.0)


@pytest.mark.parametrize(
    ("order", "u_ship", "reference"),
    [(5.0, 4.0, 3.8), (2.0, 4.0, 2.0), (0.0, 4.0, 0.0), (-5.0, 4.0, 0.0), (-5.0, -4.0, -3.8), (-2.0, -4.0, -2.0)],
)
def test_while_it_acts_the_cruise_control_is_asked_for_less_than_the_ship_does_or_for_the_order_if_that_is_less(
    order, u_ship, reference
):
    drive = Drive(p_max=0.1).see(1.1, tau=0.2, limited=True, speed_ref=order, u_ship=u_ship)
    assert drive.y.speed_ref == pytest.approx(reference)
    assert drive.see(0.5, tau=0.1, speed_ref=order, u_ship=u_ship).y.speed_ref == order


def test_the_cause_is_the_source_for_which_it_began_and_stands_until_it_has_been_free_for_a_while():
    drive = Drive(p_max=0.1).see(1.1, tau=0.2, limited=True, which=2.0)
    assert drive.see(1.1, tau=0.2, limited=True, which=1.0).x.cause == 2.0
    assert drive.see(0.5, tau=0.1, steps=14990).x.cause == 2.0
    assert drive.see(0.5, tau=0.1, steps=20).x.cause == 0.0


@pytest.mark.parametrize("omega", [0.5, -0.5])
def test_the_allowed_power_is_torque_times_speed_in_both_directions(omega):
    drive = Drive(p_max=0.1).see(1.0, tau=0.3 if omega > 0.0 else -0.3, omega=omega)
    assert drive.y.share * 1.25 * 0.5 == pytest.approx(0.1)
    assert drive.y.p_limit == pytest.approx(0.1 * 270e3)


@pytest.mark.parametrize("omega", [0.5, -0.5])
def test_a_drive_that_brakes_is_not_cut_back_for_an_overload_of_others(omega):
    drive = Drive(p_max=0.1).see(1.2, tau=-0.3 if omega > 0.0 else 0.3, omega=omega, limited=True)
    assert (drive.y.share, drive.y.limited) == (1.0, 0.0)
