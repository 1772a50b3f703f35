"""Diesel governor: limits, droop, and what it does while the fuel is cut."""

import pytest

from shipgrid.controllers.governor_degov1 import Degov1, Input, Output, State, derivatives, limit, outputs
from shipgrid.model.records import make_record, names_of, parameter_record

P, _ = parameter_record(Degov1())


def slopes(x, u, p=P):
    dx = make_record(State)
    derivatives(0.0, make_record(State, x), make_record(Input, u), p, dx)
    return {name: getattr(dx, name) for name in names_of(State)}


def test_it_rests_where_the_speed_is_the_reference_less_the_droop_of_the_throttle():
    rest = slopes({"throttle": 0.6}, {"omega": 0.99, "omega_ref": 0.99 + 0.05 * 0.6})
    assert all(abs(rate) < 1e-12 for rate in rest.values())  # rounding over T_1 T_2 = 2e-4 s2


def test_droop_may_act_on_the_filtered_electrical_power():
    p, _ = parameter_record(Degov1(M=1.0))
    rest = slopes({"throttle": 0.6, "p_f": 0.4}, {"omega": 1.0, "omega_ref": 1.0 + 0.05 * 0.4, "p_e": 0.4}, p)
    assert all(abs(rate) < 1e-12 for rate in rest.values())


def test_a_low_speed_opens_the_rack():
    assert slopes({}, {"omega": 0.9, "omega_ref": 1.0})["z_2"] > 0.0


@pytest.mark.parametrize(("throttle", "expected", "limited"), [(1.3, 1.1, 1.0), (-0.1, -0.05, 0.0), (0.5, 0.5, 0.0)])
def test_the_rack_moves_between_its_stops(throttle, expected, limited):
    x, u, y = make_record(State, {"throttle": throttle}), make_record(Input), make_record(Output)
    limit(x, u, P)
    outputs(0.0, x, u, P, y)
    assert (x.throttle, y.limited) == (expected, limited)


def test_with_the_fuel_cut_the_rack_is_closed_and_nothing_winds_up():
    u = {"omega": 0.0, "omega_ref": 1.0, "fuel": 0.0}
    x = make_record(State, {"throttle": 0.7})
    limit(x, make_record(Input, u), P)
    assert x.throttle == 0.0
    assert not any(slopes({}, u).values())
