"""Buck-boost converter and its pre-charge path: equations as a network element."""

import numpy as np
import pytest

from shipgrid.components.converters import buck_boost as kernels
from shipgrid.components.converters.buck_boost import BuckBoost, Input, Output, State
from shipgrid.model.component import type_of
from shipgrid.model.records import make_record, parameter_record

P, _ = parameter_record(BuckBoost())


def rates(v_c, i_l, e, v_leg, p=P):
    x, u = make_record(State, {"v_c": v_c, "i_l": i_l}), make_record(Input, {"e": e, "v_leg": v_leg})
    dx, y = make_record(State), make_record(Output)
    kernels.derivatives(0.0, x, u, p, dx)
    kernels.outputs(0.0, x, u, p, y)
    return dx, y, x, u


def system_matrix():
    columns = []
    for name in ("v_c", "i_l"):
        dx, *_ = rates(**{"v_c": 0.0, "i_l": 0.0, name: 1.0}, e=0.0, v_leg=0.0)
        columns.append([dx.v_c, dx.i_l])
    return np.array(columns).T


def test_poles_are_those_of_the_capacitor_behind_the_battery_and_of_the_choke():
    slow, fast = sorted(np.linalg.eigvals(system_matrix()), key=abs)
    assert fast == pytest.approx(-2.42e6, rel=0.01)  # three digits
    assert slow == pytest.approx(-(0.25 + 34.375e-3) / 0.8e-3, rel=1e-3)  # the other pole is 7000 times faster


def test_at_rest_the_leg_stands_at_the_battery_voltage_less_the_drops():
    i = 128.0
    dx, y, *_ = rates(474.2 - 34.375e-3 * i, i, 474.2, 474.2 - (34.375e-3 + 0.25) * i)
    assert dx.v_c == pytest.approx(0.0, abs=1e-12 * 1e9)  # rounding of 474 V over 34 mohm and 12 uF
    assert dx.i_l == pytest.approx(0.0, abs=1e-9)
    assert y.i_leg == -i  # into the element at the leg: minus what the battery delivers


def test_losses_at_rated_current_are_four_kilowatt_in_the_choke():
    i = 128.0
    *_, x, u = rates(474.2 - 34.375e-3 * i, i, 474.2, 0.0)
    assert kernels.losses(x, u, P) == pytest.approx((0.25 + 34.375e-3) * i**2)
    assert 0.25 * i**2 == pytest.approx(4.1e3, rel=0.01)


def test_power_into_the_terminals_is_stored_or_lost():
    e, v_leg, v_c, i_l = 474.2, 460.0, 470.0, 55.0
    dx, y, x, u = rates(v_c, i_l, e, v_leg)
    stored = P.C * v_c * dx.v_c + P.L * i_l * dx.i_l
    from_battery = e * (e - v_c) / P.R_b
    assert from_battery + v_leg * y.i_leg == pytest.approx(stored + kernels.losses(x, u, P), rel=1e-12)
    tiny = 1e-6
    ahead = make_record(State, {"v_c": v_c + tiny * dx.v_c, "i_l": i_l + tiny * dx.i_l})
    behind = make_record(State, {"v_c": v_c - tiny * dx.v_c, "i_l": i_l - tiny * dx.i_l})
    slope = (kernels.stored_energy(ahead, P) - kernels.stored_energy(behind, P)) / (2.0 * tiny)
    assert slope == pytest.approx(stored, rel=1e-6)  # a quadratic form: central difference but for rounding


def test_ripple_of_the_choke_is_45_ampere_peak_to_peak():
    v_b, v_dc, i, period = 466.9, 750.0, 100.0, 1.0 / 5000.0  # terminal voltage at half charge and 100 A
    duty = (v_b - P.R * i) / v_dc
    up, *_ = rates(v_b, i, v_b, 0.0)  # lower switch closed for 1 - s
    down, *_ = rates(v_b, i, v_b, v_dc)
    assert up.i_l * (1.0 - duty) * period == pytest.approx(45.0, abs=0.5)  # the figure holds for currents about this
    assert up.i_l * (1.0 - duty) == pytest.approx(-down.i_l * duty, rel=1e-12)


def test_open_holds_the_choke_current():
    assert type_of(BuckBoost()).variants == {"open": ("i_l",), "precharge": ()}


def test_precharge_current_is_set_by_its_resistor():
    i = 474.2 / (20.0 + 0.25 + 34.375e-3)
    u = make_record(kernels.Input, {"e": 474.2, "v_leg": 0.0, "position": 2.0})
    x = make_record(kernels.State, {"v_c": 474.2 - 34.375e-3 * i, "i_l": i})
    dx = make_record(kernels.State)
    kernels.derivatives(0.0, x, u, P, dx)
    assert dx.i_l == pytest.approx(0.0, abs=1e-8)
    assert kernels.losses(x, u, P) == pytest.approx(474.2 * i)
