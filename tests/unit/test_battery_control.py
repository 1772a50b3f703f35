"""Battery control: references of each mode, limits and their flags, bumpless transfer, sample by sample."""

import numpy as np
import pytest
from numba import njit

from shipgrid.controllers.battery_control import BatteryControl, Input, Output, State, update
from shipgrid.model.records import initial_of, make_record, parameter_record, record_dtype

loop = njit(error_model="numpy")  # around kernels; unlike them it may allocate


DROOP, VOLTAGE, CURRENT = 1.0, 2.0, 3.0
T_S = 1.0 / 5000.0
K_DR = 20.0 * 128.0 / 750.0


@loop
def samples(count, flat, flat_next, x, x_next, u, p, y):
    """Call the controller `count` times, as its clock does."""
    for _ in range(count):
        flat_next[:] = flat
        update(0.0, T_S, x, u, p, x_next, y)
        flat[:] = flat_next


def record_over(flat, declared):
    return flat.view(record_dtype(declared)).view(np.recarray)[0]


class Controller:
    """The compiled controller with constant inputs, sample after sample."""

    def __init__(self, **parameters):
        self.p, _ = parameter_record(BatteryControl(**parameters))
        self.flat, self.flat_next = initial_of(State), initial_of(State)
        self.x, self.x_next = record_over(self.flat, State), record_over(self.flat_next, State)
        self.y = make_record(Output)
        self.u = make_record(
            Input,
            {"v_b": 474.0, "v_dc": 750.0, "soc": 0.5, "enable": 1.0, "mode_ref": DROOP, "v_dc_ref": 750.0},
        )

    def set(self, **values):
        for name, value in values.items():
            setattr(self.u, name, value)
        return self

    def sample(self, count=1):
        samples(count, self.flat, self.flat_next, self.x, self.x_next, self.u, self.p, self.y)
        return self

    def settle(self, seconds=1.0):
        """Long enough for filter and ramps, the measured current following the reference."""
        for _ in range(round(seconds / 2e-3)):
            self.u.i_l = self.x.i_star
            self.sample(10)
        return self


def test_gains_come_from_the_choke_and_from_per_unit():
    p, _ = parameter_record(BatteryControl())
    assert p.k_p == pytest.approx(1.51, abs=0.005)
    assert p.k_i == pytest.approx(471.0, abs=0.5)
    assert pytest.approx(3.413, abs=5e-4) == p.K_dr
    assert pytest.approx(3.41, abs=5e-3) == p.K_p_v
    assert pytest.approx(17.1, abs=0.05) == p.K_i_v
    assert p.i_max == 192.0


def test_off_gives_the_duty_ratio_that_draws_no_current():
    c = Controller().set(enable=0.0).sample()
    assert c.y.s == pytest.approx(474.0 / 750.0)
    assert c.x.mode == 0.0
    assert c.x.i_star == 0.0


def test_five_percent_of_voltage_is_rated_current_in_droop():
    c = Controller().set(v_dc=0.95 * 750.0).settle()
    assert c.x.i_star == pytest.approx(128.0, rel=1e-6)


def test_droop_adds_to_the_set_point():
    c = Controller().set(v_dc=740.0, i_ref=-20.0).settle(4.0)
    assert c.x.i_star == pytest.approx(-20.0 + K_DR * 10.0, rel=1e-6)


def test_current_mode_does_not_see_the_voltage():
    c = Controller().set(mode_ref=CURRENT, v_dc=720.0, i_ref=40.0).settle(1.0)
    assert c.x.i_star == pytest.approx(40.0)


def test_set_point_moves_at_fifty_ampere_a_second():
    c = Controller().set(mode_ref=CURRENT, i_ref=100.0).sample(round(0.5 / T_S))
    assert c.x.i_star == pytest.approx(25.0, rel=1e-9)
    assert c.y.ramping == 1.0
    c.sample(round(1.6 / T_S))
    assert c.x.i_star == pytest.approx(100.0)
    assert c.y.ramping == 0.0


def test_starting_begins_at_zero_current_whatever_the_bus_voltage():
    c = Controller().set(enable=0.0, v_dc=735.0, v_b=470.0).sample(500).set(enable=1.0).sample()
    assert abs(c.x.i_star) < K_DR * 50.0 * T_S * 1.01  # one sample of the voltage reference's ramp
    assert c.y.s == pytest.approx(470.0 / 735.0, rel=1e-3)
    c.settle()
    assert c.x.i_star == pytest.approx(K_DR * 15.0, rel=1e-6)


@pytest.mark.parametrize("before", [DROOP, VOLTAGE, CURRENT])
@pytest.mark.parametrize("after", [DROOP, VOLTAGE, CURRENT])
@pytest.mark.parametrize("v_dc", [735.0, 765.0])
def test_a_change_of_mode_moves_the_reference_by_no_more_than_its_ramps(before, after, v_dc):
    c = Controller().set(mode_ref=before, v_dc=v_dc, i_ref=30.0).settle(0.4)
    was, duty = c.x.i_star, c.y.s
    assert abs(was) > 10.0  # there is something to bump
    c.set(mode_ref=after, i_ref=-60.0, i_l=was).sample()
    limit = 50.0 * T_S + 3.42 * 15.0 * T_S * 10.0  # set-point ramp; integrator of voltage forming (K_i/K_p = 5 1/s)
    assert abs(c.x.i_star - was) <= limit
    assert c.y.s == pytest.approx(duty, abs=1.5e-3)  # `settle` lets i_l trail i_star by up to 0.5 A


def test_current_limit_holds_and_shows():
    c = Controller().set(v_dc=680.0).settle()
    assert c.x.i_star == 192.0
    assert (c.y.current_limit, c.y.soc_low, c.y.soc_high) == (1.0, 0.0, 0.0)
    c.set(v_dc=745.0).settle()
    assert c.y.current_limit == 0.0


def test_current_limit_holds_in_voltage_forming_without_winding_up():
    c = Controller().set(mode_ref=VOLTAGE, v_dc=680.0).settle(2.0)
    assert c.x.i_star == 192.0
    assert c.y.current_limit == 1.0
    assert c.x.voltage_boost.i < 192.0  # stood still while limited
    c.set(v_dc=751.0).settle(0.2)
    assert c.x.i_star < 192.0


@pytest.mark.parametrize(
    ("soc", "v_dc", "i_star", "flags"),
    [
        (0.20, 720.0, 0.0, (1.0, 0.0)),  # empty: no discharge
        (0.20, 770.0, -K_DR * 20.0, (0.0, 0.0)),  # but it takes charge
        (0.90, 770.0, 0.0, (0.0, 1.0)),  # full: no charge
        (0.90, 720.0, K_DR * 30.0, (0.0, 0.0)),  # but it delivers
        (0.205, 720.0, 48.0, (1.0, 0.0)),  # fading: a quarter of 192 A
    ],
)
@pytest.mark.parametrize("mode", [DROOP, VOLTAGE])
def test_state_of_charge_limits_one_direction_only_and_shows(mode, soc, v_dc, i_star, flags):
    c = Controller().set(mode_ref=DROOP, soc=soc, v_dc=v_dc).settle().set(mode_ref=mode).sample(2)
    # voltage forming takes over the reference and moves on by its integrator: 0.1 A a millisecond at 20 V
    assert c.x.i_star == pytest.approx(i_star, abs=1e-6 if mode == DROOP else 0.5)
    if mode == DROOP:
        assert (c.y.soc_low, c.y.soc_high) == flags


def test_duty_limit_shows_and_the_current_integrator_stands_still():
    # a bus below the battery's voltage: the upper switch is closed as long as it may, and the current still too large
    c = Controller().set(mode_ref=CURRENT, v_dc=470.0, i_l=20.0).sample(5000)
    assert c.y.s == pytest.approx(0.98)
    assert c.y.duty_limit == 1.0
    held = c.x.current.i
    c.sample(5000)
    assert c.x.current.i == held
    assert Controller().sample().y.duty_limit == 0.0


def test_each_branch_of_voltage_forming_keeps_one_sign():
    c = Controller().set(mode_ref=VOLTAGE, v_dc=745.0).settle(0.1)
    assert c.x.boost == 1.0
    assert c.x.i_star > 0.0
    c.set(v_dc=751.5).settle(5.0)  # above the reference, inside the band: no current, no change of branch
    assert (c.x.boost, c.x.i_star) == (1.0, 0.0)
    c.set(v_dc=756.0).settle(0.1)
    assert c.x.boost == 0.0
    assert c.x.i_star < 0.0
    c.set(v_dc=748.5).settle(5.0)
    assert (c.x.boost, c.x.i_star) == (0.0, 0.0)


def test_set_point_moves_faster_after_a_change_of_mode_and_only_then():
    c = Controller().set(mode_ref=DROOP, v_dc=720.0, i_ref=0.0).settle(3.0)
    was = c.x.i_star  # 102 A
    c.set(mode_ref=CURRENT).sample(round(0.2 / T_S))
    assert c.x.i_star == pytest.approx(was - 50.0, abs=0.06)
    c.settle(1.0)
    assert c.x.i_star == pytest.approx(0.0, abs=1e-6)
    c.set(i_ref=40.0).sample(round(0.2 / T_S))
    assert c.x.i_star == pytest.approx(10.0, abs=0.02)


@pytest.mark.parametrize("mode", [DROOP, VOLTAGE, CURRENT])
def test_unloading_brings_the_reference_to_zero_at_its_rate(mode):
    c = Controller().set(mode_ref=mode, v_dc=740.0, i_ref=40.0).settle(0.3)
    was = c.x.i_star
    c.set(unload=1.0).sample(round(0.1 / T_S))
    assert c.x.i_star == pytest.approx(was - 5.0, abs=0.02)  # one sample of the ramp
    c.settle(4.0)
    assert c.x.i_star == pytest.approx(0.0, abs=1e-6)
    c.set(v_dc=730.0).sample()
    assert c.x.i_star > 0.5  # meanwhile it still holds the bus
