"""Rectifier control, part by part: PLL, limits, DC voltage, reactive power, current, and the sequence."""

import math

import numpy as np
import pytest

from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.controllers import dc_voltage, reactive_power, rectifier_control
from shipgrid.controllers.blocks.limiter import limit_length, room_beside
from shipgrid.controllers.blocks.pll import PllState, pll
from shipgrid.controllers.current_dq import CurrentDqState, current_dq
from shipgrid.controllers.rectifier_control import RectifierControl, d_headroom, q_headroom
from shipgrid.equipment import rectifier
from shipgrid.equipment.rectifier import Rectifier, RectifierSequence
from shipgrid.errors import ParameterError
from shipgrid.model.records import make_record, parameter_record

T_S = 1.0 / 3240.0
P, _ = parameter_record(RectifierControl())
V_LIM = 750.0 / math.sqrt(3.0) / (480.0 * math.sqrt(2.0 / 3.0))


class Rectified:
    """The whole controller on a constant vector, sample after sample, at standstill of the grid in its own frame."""

    def __init__(self, **inputs):
        self.x, self.x_next = make_record(rectifier_control.State), make_record(rectifier_control.State)
        self.y = make_record(rectifier_control.Output)
        self.u = make_record(rectifier_control.Input, {"v_dc": 750.0, "v_dc_ref": 750.0} | inputs)
        self.k = 0

    def run(self, seconds, v=1.0, i_d=0.0, i_q=0.0, f=60.0):
        for _ in range(round(seconds / T_S)):
            turn = np.exp(2j * math.pi * f * self.k * T_S)
            v_c, i_1 = v * P.V_b * turn, -(i_d + 1j * i_q) * P.I_b * turn
            self.u.v_c_alpha, self.u.v_c_beta = v_c.real, v_c.imag
            self.u.i_1_alpha, self.u.i_1_beta = i_1.real, i_1.imag
            rectifier_control.update(self.k * T_S, T_S, self.x, self.u, P, self.x_next, self.y)
            self.x, self.x_next = self.x_next, self.x_next.copy()
            self.k += 1
        return self.y


def test_base_values_are_those_of_the_rating():
    assert pytest.approx(391.9, abs=0.05) == P.V_b
    assert pytest.approx(1013.8, abs=0.05) == P.I_b
    assert pytest.approx(794.67, abs=0.005) == P.I_dc_b
    assert pytest.approx(1.29, rel=1e-4) == P.X_1
    assert pytest.approx(177.7, abs=0.05) == P.pll_k_p
    assert pytest.approx(15791.0, abs=1.0) == P.pll_k_i


@pytest.mark.parametrize("f", [57.0, 60.0, 63.0])
@pytest.mark.parametrize("angle", [-2.5, 0.0, 3.0])
def test_pll_finds_any_angle_and_a_frequency_that_is_off(angle, f):
    x, x_next = make_record(PllState), make_record(PllState)
    for k in range(round(0.3 / T_S)):
        phi = angle + 2.0 * math.pi * f * k * T_S
        omega = pll(math.sin(phi - x.theta), 1.0, 2.0 * math.pi * 60.0, P.pll_k_p, P.pll_k_i, 63.0, T_S, x, x_next)
        x.theta, x.omega = x_next.theta, x_next.omega
    assert omega == pytest.approx(2.0 * math.pi * f, rel=1e-4)
    assert math.sin(phi - x.theta + 2.0 * math.pi * f * T_S) == pytest.approx(0.0, abs=1e-3)


def test_pll_holds_its_speed_on_a_dead_grid():
    x, x_next = make_record(PllState, {"omega": 12.0}), make_record(PllState, {"omega": 12.0})
    pll(0.15, 0.15, 377.0, P.pll_k_p, P.pll_k_i, 63.0, T_S, x, x_next)
    assert x_next.omega == 12.0


def test_a_limited_vector_keeps_its_angle():
    d, q, limited = limit_length(3.0, -4.0, 2.5)
    assert (d, q, limited) == (1.5, -2.0, 1.0)
    assert limit_length(0.3, 0.4, 2.5) == (0.3, 0.4, 0.0)
    assert room_beside(0.6, 1.0) == pytest.approx(0.8)
    assert room_beside(1.1, 1.0) == 0.0


def test_droop_rests_where_its_statics_say():
    # 0.2 pu at 742.5 V: the integrator stands still, models of two gensets sharing 0.4 pu
    x, x_next = make_record(dc_voltage.DcVoltageState), make_record(dc_voltage.DcVoltageState)
    dc_voltage.dc_voltage(1.0, 742.5 / 750.0, 0.2, 0.0, 1.0, 0.65, P, T_S, x, x_next)
    assert x_next.pi.i == pytest.approx(0.0, abs=1e-12)


def test_change_of_mode_does_not_move_the_current_reference():
    x, x_next = make_record(dc_voltage.DcVoltageState), make_record(dc_voltage.DcVoltageState)
    for state in (x, x_next):
        state.pi.i, state.i_d_ref, state.mode = 0.3, 0.3, 0.0
    moved = dc_voltage.dc_voltage(1.0, 0.985, 0.3, 1.0, 1.0, 0.65, P, T_S, x, x_next)
    assert moved == pytest.approx(0.3, abs=1e-12)


def test_power_never_flows_back_into_the_diesel():
    x, x_next = make_record(dc_voltage.DcVoltageState), make_record(dc_voltage.DcVoltageState)
    assert dc_voltage.dc_voltage(1.0, 1.05, 0.0, 0.0, 1.0, 0.65, P, T_S, x, x_next) == 0.0


def test_low_voltage_asks_for_delivered_reactive_power():
    # E = 0.99: q* = +0.2; the d axis on the voltage, i_q > 0 delivers
    x, x_next = make_record(reactive_power.ReactivePowerState), make_record(reactive_power.ReactivePowerState)
    assert reactive_power.reactive_power(0.99, 0.0, 1.0, -1.0, 1.0, P, T_S, x, x_next) == pytest.approx(0.02 * 0.2)
    assert x_next.i > 0.0
    reactive_power.reactive_power(0.99, 0.2, 1.0, -1.0, 1.0, P, T_S, x, x_next)
    assert x_next.i == pytest.approx(0.0, abs=1e-12)


def test_reactive_integrator_follows_a_bound_instead_of_winding_up():
    x, x_next = make_record(reactive_power.ReactivePowerState), make_record(reactive_power.ReactivePowerState)
    for _ in range(round(10.0 / T_S)):
        reactive_power.reactive_power(0.97, 0.0, 1.0, -1.0, -0.1, P, T_S, x, x_next)
        x.i = x_next.i
    assert x.i == pytest.approx(-0.1, abs=1e-6)  # 25 time constants K_p / K_i of 0.4 s
    assert reactive_power.reactive_power(1.0, 0.0, 1.0, -1.0, 1.0, P, T_S, x, x_next) == pytest.approx(-0.1, abs=1e-6)


def test_clamped_voltage_stops_the_integrators_unless_they_shorten_it():
    x, x_next = make_record(CurrentDqState), make_record(CurrentDqState)
    v_d, v_q, limited = current_dq(-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.29, V_LIM, 1.0, 7.0, T_S, x, x_next)
    assert limited == 1.0
    assert math.hypot(v_d, v_q) == pytest.approx(V_LIM)
    assert x_next.d == 0.0
    x.d = x_next.d = -1.0  # v_d = 1 - (0.1 - 1) = 1.9, too long; the error would shorten it
    assert current_dq(0.1, 0.0, 0.0, 0.0, 1.0, 0.0, 1.29, V_LIM, 1.0, 7.0, T_S, x, x_next)[2] == 1.0
    assert x_next.d > -1.0


def test_bound_leaves_five_percent_of_the_voltage_across_the_choke():
    i_d, v_c = 0.5, 0.99
    i_q = q_headroom(i_d, v_c, V_LIM, P)
    assert abs(v_c - 1j * P.X_1 * (i_d + 1j * i_q)) == pytest.approx(0.95 * V_LIM)


def test_d_axis_leaves_room_for_the_reactive_current_it_needs_where_voltage_and_current_meet():
    for X_1, v_lim, by in ((1.29, V_LIM, "share"), (0.37, 1.05, "both"), (0.129, V_LIM, "current")):
        p, _ = parameter_record(RectifierControl(L_1=X_1 / 1.29 * RectifierControl().L_1))
        i_d = d_headroom(0.98, v_lim, p)
        i_q = min(q_headroom(i_d, 0.98, v_lim, p), 0.0)
        assert math.hypot(i_d, i_q) <= 1.2 + 1e-12
        assert {"share": i_d == pytest.approx(0.8 * 0.95 * v_lim / X_1, rel=1e-4), "current": i_d == 1.2}.get(
            by, math.hypot(i_d, i_q) == pytest.approx(1.2)
        )
    assert d_headroom(0.98, 0.3, p) == 0.0  # no current at all inside so little voltage


def test_disabled_it_asks_for_the_measured_voltage():
    rectified = Rectified(enable=0.0)
    y = rectified.run(0.3)
    theta_in_force = 2.0 * math.pi * 60.0 * (rectified.k - 1 + 1.5) * T_S  # middle of the period in which it acts
    s = (y.s_alpha + 1j * y.s_beta) * np.exp(-1j * theta_in_force)
    assert s == pytest.approx(P.V_b / 750.0, abs=1e-4)
    assert (y.modulation, y.current_limit, y.modulation_limit, y.q_bound, y.reverse_limit) == (0, 0, 0, 0, 0)


def test_limits_raise_their_flags():
    rectified = Rectified(enable=0.0)
    rectified.run(0.3)
    rectified.u.enable, rectified.u.v_dc_ref = 1.0, 900.0
    y = rectified.run(2.0)
    assert y.i_d_ref == pytest.approx(0.8 * 0.95 * V_LIM / 1.29, rel=1e-4)
    assert y.current_limit == 1.0
    assert y.q_bound == 1.0
    assert y.modulation_limit == 1.0  # the current stays zero here, the integrator drives the voltage to its limit
    assert y.modulation == pytest.approx(1.0)


def test_dc_power_is_the_poles_power_over_a_held_period():
    # s stands for a period while the current turns: the mean of 3/2 s . i v_dc, not its value at a sample
    rectified = Rectified(enable=0.0)
    y = rectified.run(0.5, i_d=0.5, i_q=-0.1)
    turning = np.exp(2j * math.pi * 60.0 * (rectified.k - 1 + np.linspace(1.0, 2.0, 1001)) * T_S)
    i = (0.5 - 0.1j) * P.I_b * turning
    poles = 1.5 * ((y.s_alpha + 1j * y.s_beta) * 750.0 * i.conj()).real
    assert y.p_dc == pytest.approx(poles.mean(), rel=1e-3)
    assert abs(poles[-1] - poles.mean()) > 5e3
    assert y.i_dc == pytest.approx(y.p_dc / 750.0)


class Sequence:
    """The sequence with inputs held, tick after tick."""

    def __init__(self, **inputs):
        self.p, _ = parameter_record(RectifierSequence())
        self.x, self.x_next = make_record(rectifier.State), make_record(rectifier.State)
        self.y = make_record(rectifier.Output)
        steady = {"v_dc": 745.0, "v_dc_ref": 750.0, "v_d": 1.0}
        self.u = make_record(rectifier.Input, steady | inputs)
        self.visited = []

    def run(self, seconds):
        for _ in range(round(seconds / rectifier.SEQUENCE_PERIOD)):
            rectifier.update(0.0, rectifier.SEQUENCE_PERIOD, self.x, self.u, self.p, self.x_next, self.y)
            self.x, self.x_next = self.x_next, self.x_next.copy()
            self.visited += [self.x.state] if self.x.state not in self.visited[-1:] else []
        return int(self.x.state)


def connected():
    sequence = Sequence(ready=1.0)
    assert sequence.run(20.0) == rectifier.CONNECTED
    return sequence


def test_without_a_ready_genset_nothing_is_connected():
    sequence = Sequence(ready=0.0)
    assert sequence.run(5.0) == rectifier.OFF
    assert (sequence.y.contacts, sequence.y.connected, sequence.y.enable) == (rectifier.OPEN, 0.0, 0.0)


def test_gates_stay_blocked_until_the_pll_has_been_locked():
    sequence = Sequence(ready=1.0, v_q=0.3)
    assert sequence.run(1.0) == rectifier.SYNCHRONISING
    assert (sequence.y.contacts, sequence.y.connected, sequence.y.enable) == (rectifier.CLOSED, 1.0, 0.0)
    sequence.u.v_q = 0.0
    assert sequence.run(0.15) == rectifier.SYNCHRONISING
    assert sequence.run(0.1) == rectifier.CONNECTED


def test_load_is_taken_along_a_ramp_from_the_measured_voltage():
    sequence = Sequence(ready=1.0, v_dc=735.0)
    sequence.run(0.33)
    assert sequence.x.state == rectifier.CONNECTED
    assert sequence.y.v_dc_ref == pytest.approx(735.0, abs=1.0)  # one tick of 50 V/s
    sequence.run(0.2)
    assert sequence.y.v_dc_ref == pytest.approx(745.0, abs=1.0)
    assert sequence.y.limit == pytest.approx(0.02, abs=3e-3)  # two ticks of 0.1 pu/s
    sequence.run(15.0)
    assert (sequence.y.v_dc_ref, sequence.y.limit) == (750.0, 1.2)


def test_on_a_live_bus_the_filter_is_charged_through_the_resistor():
    sequence = Sequence(ready=1.0, v_q=0.3)
    assert sequence.run(0.09) == rectifier.PRECHARGING
    assert (sequence.y.contacts, sequence.y.connected, sequence.y.enable) == (rectifier.RESISTOR, 1.0, 0.0)
    assert sequence.run(0.04) == rectifier.SYNCHRONISING
    assert sequence.y.contacts == rectifier.CLOSED


def test_a_dead_bus_is_charged_through_the_resistor_first():
    sequence = Sequence(ready=1.0, v_dc=580.0)  # 0.9 of 648 V is 583 V
    assert sequence.run(1.0) == rectifier.PRECHARGING
    assert (sequence.y.contacts, sequence.y.connected, sequence.y.enable) == (rectifier.RESISTOR, 1.0, 0.0)
    sequence.u.v_dc = 590.0
    assert sequence.run(0.02) == rectifier.SYNCHRONISING
    assert sequence.y.contacts == rectifier.CLOSED
    assert sequence.run(1.0) == rectifier.CONNECTED
    assert sequence.x.refused == 0.0


def test_a_bus_that_does_not_charge_is_refused_until_the_genset_is_called_again():
    sequence = Sequence(ready=1.0, v_dc=12.0)
    assert sequence.run(11.0) == rectifier.OFF
    assert sequence.x.refused == rectifier.NOT_CHARGED
    sequence.u.v_dc = 590.0
    assert sequence.run(1.0) == rectifier.OFF  # the standing command is not tried again
    sequence.u.ready = 0.0
    sequence.run(0.02)
    assert sequence.x.refused == 0.0
    sequence.u.ready = 1.0
    assert sequence.run(1.0) == rectifier.CONNECTED


def test_it_waits_with_its_load_until_the_others_can_take_it():
    sequence = connected()
    sequence.u.stop, sequence.u.p_dc, sequence.u.i_d_ref = 1.0, 270e3, 0.46
    assert sequence.run(60.0) == rectifier.WAITING
    assert sequence.y.limit == 1.2
    sequence.u.p_dc, sequence.u.i_d_ref = 80e3, 0.14
    assert sequence.run(1.2) == rectifier.UNLOADING
    assert sequence.y.limit < 0.14  # acts at once, whatever the bound was
    assert sequence.run(2.0) == rectifier.OFF  # 1.4 s of ramp, 0.1 s blocked
    assert sequence.visited == [
        rectifier.PRECHARGING,
        rectifier.SYNCHRONISING,
        rectifier.CONNECTED,
        rectifier.WAITING,
        rectifier.UNLOADING,
        rectifier.BLOCKED,
        rectifier.OFF,
    ]
    assert (sequence.y.contacts, sequence.y.connected) == (rectifier.OPEN, 0.0)


def test_unloading_is_broken_off_when_nobody_takes_over():
    sequence = connected()
    sequence.u.stop, sequence.u.p_dc, sequence.u.i_d_ref, sequence.u.v_dc = 1.0, 80e3, 0.14, 710.0
    assert sequence.run(0.02) == rectifier.WAITING
    assert sequence.y.limit == 1.2  # takes back at once
    sequence.u.v_dc = 745.0
    assert sequence.run(29.0) == rectifier.WAITING
    assert sequence.y.limit == 1.2
    assert sequence.run(2.5) == rectifier.UNLOADING


def test_a_start_command_while_unloading_takes_the_load_back():
    sequence = connected()
    sequence.u.stop, sequence.u.p_dc, sequence.u.i_d_ref = 1.0, 80e3, 0.14
    assert sequence.run(0.5) == rectifier.UNLOADING
    sequence.u.stop = 0.0
    assert sequence.run(0.02) == rectifier.CONNECTED
    sequence.run(12.0)
    assert sequence.y.limit == 1.2


@pytest.mark.parametrize("lost", [{"ready": 0.0}, {"v_dc": 500.0}])
def test_it_opens_at_once_when_the_genset_or_the_bus_is_lost(lost):
    sequence = connected()
    for name, value in lost.items():
        sequence.u[name] = value
    assert sequence.run(0.01) == rectifier.OFF
    assert sequence.y.enable == 0.0


def test_a_control_value_that_the_item_sets_is_refused():
    with pytest.raises(ParameterError, match=r"set by rectifier\.dc_droop"):
        Rectifier(source="genset_for", bus="dc_for", control=RectifierControl(K_v=0.03))


def test_a_filter_rated_by_the_item_belongs_to_the_control_s_default():
    lcl = LclFilter.per_unit(596e3, 480.0, 60.0, L_1=1.29, C=0.07, L_2=0.09)
    assert pytest.approx(lcl.L_1, rel=1e-4) == RectifierControl().L_1
