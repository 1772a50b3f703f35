"""The inverter's sequence, meter and presets."""

import dataclasses
import math

import pytest

from shipgrid.controllers.grid_forming import PRESETS, GridForming
from shipgrid.equipment import inverter
from shipgrid.equipment.inverter import Inverter, InverterSequence
from shipgrid.model.records import make_record, parameter_record

DT = 10e-3
OFF, STARTING, ON, UNLOADING, SYNCHRONISING = range(5)


class Sequence:
    """The sequence with a controller's ramp and a bar as simple as possible."""

    def __init__(self, powers):
        self.p, _ = parameter_record(InverterSequence())
        self.x = make_record(inverter.SequenceState)
        self.powers = powers  # (p, q) of (v_set, p_ref) while on
        self.v_set = 0.0

    def see(self, on, v_dc=750.0, v_bar=0.0, **step):
        running = self.x.state != OFF
        target = self.x.v_ref if running else 0.0
        self.v_set = min(max(target, self.v_set - DT / 1.5), self.v_set + DT / 1.5) if running else 0.0
        p, q = self.powers(self.v_set, self.x.p_ref) if running else (0.0, 0.0)
        values = {"on": on, "v_dc": v_dc, "v_alpha": v_bar, "v_set": self.v_set, "p": p, "q": q} | step
        u, y = make_record(inverter.SequenceInput, {"v_beta": 0.0, **values}), make_record(inverter.SequenceOutput)
        x_next = self.x.copy()
        inverter.update(0.0, DT, self.x, u, self.p, x_next, y)
        self.x = x_next
        return y

    def until(self, code, on, seconds):
        for k in range(round(seconds / DT)):
            if self.see(on).code == code:
                return k * DT
        raise AssertionError(f"state {code} not reached, but {self.x.state}")


def alone(v, p_ref):
    return 0.2 * v**2, 0.097 * v**2


def beside_another(v, p_ref):
    """Two equal inverters share 0.4 pu; a voltage 2 % lower moves 0.1 pu of reactive power to the other."""
    return 0.2 + 0.5 * p_ref, 0.1 + 5.0 * (v - 1.0)


def test_starts_with_the_contactor_closed_and_is_on_when_the_ramp_ends():
    sequence = Sequence(alone)
    y = sequence.see(1.0)
    assert (y.code, y.enable, y.position, y.on) == (STARTING, 1.0, 0.0, 0.0)
    assert sequence.until(ON, 1.0, 3.0) == pytest.approx(1.5, abs=0.03)  # the ramp of the set point


def test_refuses_a_low_dc_bus_until_it_has_risen():
    sequence = Sequence(alone)
    y = sequence.see(1.0, v_dc=640.0)
    assert (y.code, y.refused, y.position) == (OFF, 1.0, 1.0)
    assert sequence.see(0.0, v_dc=640.0).refused == 0.0
    assert sequence.see(1.0).code == STARTING  # the standing command is obeyed as soon as it can be


def test_joins_a_live_bar_with_its_contactor_open_until_it_is_in_step():
    sequence = Sequence(beside_another)
    y = sequence.see(1.0, v_bar=320.0)
    assert (y.code, y.enable, y.position, sequence.x.join) == (SYNCHRONISING, 1.0, 3.0, 0.0)
    while sequence.v_set < 1.0:  # not before its own voltage is there
        assert sequence.x.join == 0.0
        y = sequence.see(1.0, v_bar=320.0)
    assert (y.code, sequence.x.join, y.on, y.refused) == (SYNCHRONISING, 1.0, 0.0, 0.0)
    y = sequence.see(1.0, v_bar=320.0, in_step=1.0)
    assert (y.code, y.position, sequence.x.join, y.on) == (ON, 0.0, 1.0, 1.0)
    sequence.until(OFF, 0.0, 6.0)
    assert sequence.x.join == 0.0


def test_gives_up_where_it_comes_into_no_step_and_says_so_until_it_is_told_anew():
    sequence = Sequence(beside_another)
    sequence.see(1.0, v_bar=320.0)
    assert sequence.see(1.0, v_bar=320.0, no_step=1.0).code == OFF
    y = sequence.see(1.0, v_bar=320.0)
    assert (y.code, y.position, y.enable, y.refused) == (OFF, 1.0, 0.0, 2.0)
    assert sequence.see(0.0, v_bar=320.0).refused == 0.0
    assert sequence.see(1.0, v_bar=320.0).code == SYNCHRONISING
    assert sequence.see(0.0, v_bar=320.0).code == OFF


def test_off_alone_takes_the_bar_down_before_the_contactor_opens():
    sequence = Sequence(alone)
    sequence.until(ON, 1.0, 3.0)
    assert sequence.see(0.0).enable == 1.0
    sequence.until(OFF, 0.0, 6.0)
    assert sequence.v_set < 0.01  # of the contactor's decision: nothing flows any more


def test_off_in_parallel_hands_the_load_over_and_leaves_the_voltage():
    sequence = Sequence(beside_another)
    sequence.until(ON, 1.0, 3.0)
    sequence.until(OFF, 0.0, 6.0)
    assert sequence.v_set > 0.96


def test_on_while_unloading_returns_to_the_set_points():
    sequence = Sequence(alone)
    sequence.until(ON, 1.0, 3.0)
    for _ in range(80):  # past the half second in which it judges whether it is alone
        sequence.see(0.0)
    assert sequence.x.v_ref < 1.0
    sequence.see(1.0)
    assert (sequence.x.v_ref, sequence.x.p_ref) == (1.0, 0.0)
    sequence.until(ON, 1.0, 2.0)


def test_meter_counts_power_into_the_bar_positive():
    values = {"v_alpha": 300.0, "v_beta": 0.0, "i_2_alpha": 20.0, "i_2_beta": -10.0}  # current lags: q positive
    y = make_record(inverter.MeterOutput)
    inverter.meter_outputs(0.0, make_record(inverter.MeterInput, values), y)
    assert (y.p_ac, y.q_ac) == (1.5 * 6000.0, 1.5 * 3000.0)


def test_paper_preset_brings_its_inductance_and_gains_and_leaves_what_was_set():
    plain = Inverter(bus="dc", grid="ac", filter="paper").resolved()
    assert plain.L_1 == 1.54
    assert all(getattr(plain.control, name) == value for name, value in PRESETS["paper"].items() if name != "L_1")
    own = Inverter(bus="dc", grid="ac", filter="paper", L_1=1.4, control=GridForming(K_pv=0.8, m_p=0.03)).resolved()
    assert (own.L_1, own.control.K_pv, own.control.m_p) == (1.4, 0.8, 0.03)
    assert own.control.K_iv == PRESETS["paper"]["K_iv"]


def test_default_preset_is_what_the_controller_declares():
    assert Inverter(bus="dc", grid="ac").resolved() == Inverter(bus="dc", grid="ac")
    assert math.isclose(dataclasses.replace(GridForming()).L_1, PRESETS["default"]["L_1"])
