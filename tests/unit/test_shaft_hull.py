"""Shaft, hull, cruise control, and the on/off sequence of a propulsion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shipgrid.components.marine import hull, thrust_sum, wind_and_waves
from shipgrid.components.marine.hull import Hull
from shipgrid.components.marine.wind_and_waves import WindAndWaves
from shipgrid.components.mechanical import shaft
from shipgrid.components.mechanical.shaft import Shaft
from shipgrid.controllers import ship_speed
from shipgrid.controllers.ship_speed import ShipSpeed
from shipgrid.equipment import propulsion
from shipgrid.equipment.hull import HullForm
from shipgrid.equipment.propulsion import PropulsionSequence
from shipgrid.errors import ParameterError
from shipgrid.io.ship_file import load_ship
from shipgrid.model.network import Network
from shipgrid.model.records import make_record, parameter_record
from shipgrid.units import KNOT, knots


def test_friction_is_two_percent_of_the_screw_torque_when_the_motor_drives():
    p, _ = parameter_record(Shaft())
    dx = make_record(shaft.State)
    x, u = make_record(shaft.State, {"omega_m": 32.15}), make_record(shaft.Input, {"tau_e": 2233.0, "tau": 2189.2})
    shaft.derivatives(x, u, p, dx)
    assert 383.4 * dx.omega_m == pytest.approx(2233.0 - 2189.2 * 1.02, abs=1e-3)


def test_friction_takes_power_whichever_way_it_turns_and_none_at_rest():
    p, _ = parameter_record(Shaft())
    for omega_m in (-30.0, -0.01, 0.0, 0.01, 30.0):
        for tau in (-500.0, 0.0, 500.0):
            x, u = make_record(shaft.State, {"omega_m": omega_m}), make_record(shaft.Input, {"tau": tau})
            loss = shaft.losses(x, u, p)
            assert loss > 0.0 if omega_m and tau else loss == 0.0


def test_friction_is_smooth_through_standstill():
    p, _ = parameter_record(Shaft())
    omega = np.linspace(-0.5, 0.5, 2001)
    tau_f = np.array([shaft.friction(w, 500.0, p) for w in omega])
    assert np.abs(np.diff(tau_f)).max() < 0.2  # of 10 N m, over 0.0005 rad/s


@pytest.mark.parametrize(("choice", "at_10_kn"), [("table", 18.06e3), ("paper_fit", 21.6e3)])
def test_resistance_presets_go_with_the_square_of_speed_and_against_it(choice, at_10_kn):
    p, tables = parameter_record(HullForm(resistance=choice).component())
    for speed in (-10.0, -3.7, 0.0, 0.1, 6.0, 11.0):
        R = hull.resistance(knots(speed), p, tables)
        assert pytest.approx(math.copysign(at_10_kn * (speed / 10.0) ** 2, speed), rel=1e-9) == R


LOOKUP = tuple((knots(v), R) for v, R in [(2.0, 500.0), (4.0, 2.4e3), (10.0, 20e3), (12.0, 35e3)])


def test_resistance_goes_through_its_points_in_both_directions():
    p, tables = parameter_record(HullForm(resistance=LOOKUP).component())
    for u, R in LOOKUP:
        # the table's own interpolation
        assert hull.resistance(u, p, tables) == pytest.approx(R, rel=1e-5)
        assert hull.resistance(-u, p, tables) == pytest.approx(-R, rel=1e-5)
    # by the square of speed beyond half the first and twice the last
    for u, (u_end, R_end) in [(knots(0.3), LOOKUP[0]), (knots(30.0), LOOKUP[-1])]:
        assert hull.resistance(u, p, tables) == pytest.approx(R_end * (u / u_end) ** 2, rel=1e-9)


@pytest.mark.parametrize("exponent", [2.0, 1.7, 2.6])
def test_resistance_between_points_of_a_power_law_is_that_law(exponent):
    points = tuple((u, 300.0 * u**exponent) for u in (1.0, 2.0, 2.5, 4.0, 6.0))
    speed = np.linspace(2.0, 4.0, 50)  # away from the ends, which go over into the square
    assert hull.through(points, speed) == pytest.approx(300.0 * speed**exponent, rel=1e-9)


def test_resistance_rises_throughout_and_has_no_kink():
    hump = tuple((knots(v), R) for v, R in [(2.0, 900.0), (4.0, 1e3), (6.0, 6e3), (9.0, 6.1e3), (12.0, 40e3)])
    for points, off in ((LOOKUP, 1e-5), (hump, 3e-4)):
        p, tables = parameter_record(HullForm(resistance=points).component())
        u = np.linspace(-10.0, 10.0, 8001)
        R = np.array([hull.resistance(v, p, tables) for v in u])
        assert hull.through(points, u[u > 0.1]) == pytest.approx(R[u > 0.1], rel=off)
        assert (np.diff(R)[np.abs(u[1:]) > 0.01] > 0.0).all()
        # a kink stays when the step is halved, curvature's change of slope goes with the step
        turn, finer = (np.abs(np.diff(np.diff(R[::k]) / (u[k] - u[0]))).max() for k in (2, 1))
        assert finer < 0.75 * turn


@pytest.mark.parametrize("points", [(), ((1.0, 2.0), (2.0, 2.0)), ((2.0, 1.0), (1.0, 2.0)), ((0.0, 1.0),), ((1.0,),)])
def test_points_that_do_not_rise_from_above_zero_are_refused(points):
    with pytest.raises(ParameterError, match=r"Hull\.resistance"):
        parameter_record(Hull(resistance=points))


def weather(p=None, **inputs):
    """Outputs of wind and waves."""
    y = make_record(wind_and_waves.Output)
    u = make_record(wind_and_waves.Input, inputs)
    wind_and_waves.outputs(u, parameter_record(p or WindAndWaves())[0], y)
    return y


def test_head_wind_adds_the_drag_of_the_relative_wind_less_that_of_still_air():
    for u_ship, v_w, angle in [(5.0, 10.0, 0.0), (5.0, 10.0, 2.5), (-4.0, 3.0, 0.5), (3.0, 3.0, math.pi)]:
        v_r = u_ship + v_w * math.cos(angle)
        drag, still_air = (0.5 * 1.225 * 0.8 * 60.0 * abs(v) * v for v in (v_r, u_ship))
        y = weather(u_ship=u_ship, wind_speed=v_w, wind_from=angle)
        assert y.T_wind == pytest.approx(drag - still_air, rel=1e-12)
        assert y.T_env == y.T_wind
    assert weather(u_ship=5.0).T_env == 0.0  # no wind, no waves: the resistance is that of the hull
    # models page: 60 m2, C_x 0.8; a moored ship in 10 m/s from ahead is pushed astern with 2.94 kN
    assert weather(wind_speed=10.0).T_env == pytest.approx(2940.0)
    assert weather(wind_speed=10.0, wind_from=math.pi).T_env == pytest.approx(-2940.0)


def test_waves_add_the_stawave_figure_whichever_way_the_ship_goes():
    # models page: 0.54 kN at 0.3 m
    for way in (1.0, -1.0):
        y = weather(u_ship=way * knots(10.0), wave_height=0.3)
        assert y.T_wave == pytest.approx(way * 540.0, rel=5e-3)
    assert weather(u_ship=5.0, wave_height=0.6).T_wave == pytest.approx(
        4.0 * weather(u_ship=5.0, wave_height=0.3).T_wave
    )
    assert weather(wave_height=1.0).T_wave == 0.0
    # models page: holds up to 1.39 m for 38 m between perpendiculars
    assert (weather(wave_height=1.38).beyond, weather(wave_height=1.40).beyond) == (0.0, 1.0)


def test_speed_in_wind_is_where_thrust_meets_the_sum_of_all_resistances():
    ship = load_ship("ferry")
    net = Network("ferry")
    ship.build(net)
    assert net.placed["hull.surge"].inputs["T_env"] == "hull.weather.T_env"
    assert net.placed["hull.weather"].inputs["wind_speed"] == "command:hull.wind_speed"
    p, tables = parameter_record(ship.hull.component())
    x, dx = make_record(hull.State, {"u_ship": 4.0}), make_record(hull.State)
    T_env = weather(ship.hull.weather, u_ship=4.0, wind_speed=12.0, wave_height=0.5).T_env
    R = 18.06e3 * (4.0 / knots(10.0)) ** 2
    u = make_record(hull.Input, {"thrust": (R + T_env) / 0.795, "T_env": T_env})
    hull.derivatives(x, u, p, dx, tables)
    assert dx.u_ship == pytest.approx(0.0, abs=1e-9)
    assert T_env > 5e3


def test_hull_accelerates_by_thrust_less_deduction_resistance_and_environment():
    p, tables = parameter_record(Hull())
    x = make_record(hull.State, {"u_ship": 10.0 * KNOT})
    u, dx = make_record(hull.Input, {"thrust": 30e3, "T_env": 1e3}), make_record(hull.State)
    hull.derivatives(x, u, p, dx, tables)
    assert dx.u_ship == pytest.approx((0.795 * 30e3 - 18.06e3 - 1e3) / 407.16e3)
    assert dx.distance == x.u_ship
    y = make_record(hull.Output)
    hull.outputs(x, u, p, y, tables)
    assert y.acceleration == dx.u_ship
    assert (y.v_a, y.u_thrust) == pytest.approx((0.765 * x.u_ship, 0.795 * x.u_ship))
    # energy: what thrust gives is stored or used up
    given = 30e3 * y.u_thrust
    assert given == pytest.approx((p.m + p.m_add) * x.u_ship * dx.u_ship + hull.consumed(x, u, p, tables))


def test_sum_of_thrusts_adds():
    u, y = make_record(thrust_sum.Input, {"first": 3.0, "second": -1.0}), make_record(thrust_sum.Output)
    thrust_sum.outputs(u, y)
    assert y.total == 2.0


def cruise(seconds: float, state: dict[str, float] | None = None, **inputs: float):
    """State and output of the cruise control after `seconds` of constant inputs."""
    p, _ = parameter_record(ShipSpeed())
    x, u = make_record(ship_speed.State, state), make_record(ship_speed.Input, inputs)
    y = make_record(ship_speed.Output)
    for _ in range(round(seconds / 0.01)):
        x_next = x.copy()
        ship_speed.update(0.01, x, u, p, x_next, y)
        x = x_next
    return x, y


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_reference_ramps_at_0_05_knot_a_second_and_lags_by_10_s(way):
    x, _ = cruise(60.0, speed_ref=way * knots(6.0))
    assert x.u_ramp / KNOT == pytest.approx(way * 3.0)
    # a lag behind a ramp: 3 kn - 0.05 kn/s * 10 s (1 - exp(-6))
    assert x.u_lag / KNOT == pytest.approx(way * (3.0 - 0.5 * (1.0 - math.exp(-6.0))), abs=1e-3)


def test_revolutions_stop_at_rated_and_the_integrator_does_not_wind_up():
    x, y = cruise(100.0, speed_ref=knots(10.0))  # a ship that does not move
    assert (y.n_ref, y.limited) == (1.0, 1.0)
    assert x.speed.i < 1.0
    x, y = cruise(100.0, speed_ref=-knots(10.0))
    assert (y.n_ref, y.limited) == (-1.0, 1.0)


def test_cruise_control_takes_over_from_what_ship_and_shaft_do():
    x, y = cruise(1.0, u_ship=2.0, omega_pu=0.3, enabled=0.0, speed_ref=3.0)
    assert (x.u_lag, y.n_ref) == (2.0, 0.3)
    going = {"u_ramp": 2.0, "u_lag": 2.0, "speed.i": x.speed.i}
    _, y = cruise(0.01, going, u_ship=2.0, omega_pu=0.3, speed_ref=3.0)
    assert y.n_ref == pytest.approx(0.3, abs=1e-4)


@pytest.mark.parametrize("n", [-1.0, -0.4, -1e-3, 0.0, 1e-6, 0.1, 0.68, 1.0])
def test_shaft_speed_follows_the_root_of_the_demand(n):
    y_0 = ShipSpeed().y_0
    y = ship_speed.demand.py_func(np.float64(n), y_0)
    assert y * ((1.0 + y_0**2) / (y**2 + y_0**2)) ** 0.25 == pytest.approx(n, rel=1e-9, abs=1e-15)
    assert abs(y) == pytest.approx(n * n, abs=0.3 * y_0)  # a share of thrust: t - t^2 / sqrt(1 + t^2) is 0.3 at most


def test_shaft_speed_is_in_proportion_to_a_small_demand_and_with_a_large_y_0_to_all():
    y_0 = ShipSpeed().y_0
    slope = ship_speed.demand.py_func(np.float64(1e-6), y_0) / 1e-6
    assert 1.0 / slope == pytest.approx(1.0 / math.sqrt(y_0), rel=2e-3)  # ((1 + y_0^2) / y_0^2)^(1/4)
    assert ship_speed.demand.py_func(np.float64(0.4), 1e9) == pytest.approx(0.4)  # the published controller


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_integrator_is_held_while_the_torque_limit_keeps_the_shaft_from_its_reference(way):
    sailing = {"speed.i": way * 0.2, "u_ramp": way * 3.0, "u_lag": way * 3.0}
    slow = {"speed_ref": way * 3.0, "u_ship": way * 2.0, "omega_pu": way * 0.3, "all_torque": 1.0}
    held, y = cruise(5.0, sailing, **slow)
    assert held.speed.i == way * 0.2
    assert y.n_ref * way > 0.3  # which the proportional part still asks for
    freed, _ = cruise(5.0, sailing, **slow | {"all_torque": 0.0})
    assert freed.speed.i * way > 0.2 + 0.1
    # too fast already, with the shaft still short of its reference: it gives way
    back, _ = cruise(5.0, sailing | {"speed.i": way * 0.5}, **slow | {"u_ship": way * 3.2})
    assert back.speed.i * way < 0.5 - 0.03


def test_integrator_leaks_where_the_ship_is_to_lie_still_and_not_on_the_way_through_rest():
    passing = {"speed.i": -0.2, "u_ramp": 0.0, "u_lag": 0.0}
    still, _ = cruise(1.0, passing, speed_ref=0.0)
    assert still.speed.i == pytest.approx(-0.2 * math.exp(-1.0 / ShipSpeed().T_leak), rel=1e-3)
    going, _ = cruise(1e-3, passing, speed_ref=-knots(6.0))
    assert going.speed.i == pytest.approx(-0.2, abs=1e-5)


def test_two_integrators_are_drawn_together_only_while_both_are_on():
    sailing = {"u_ramp": 3.0, "u_lag": 3.0, "speed.i": 0.5}
    at_speed = {"speed_ref": 3.0, "u_ship": 3.0, "i_neighbour": 0.3}
    x, _ = cruise(20.0, sailing, **at_speed, neighbour_enabled=1.0)
    assert x.speed.i == pytest.approx(0.3 + 0.2 * math.exp(-1.0), abs=1e-3)
    x, _ = cruise(20.0, sailing, **at_speed, neighbour_enabled=0.0)
    assert x.speed.i == pytest.approx(0.5)


def sequence(x, seconds: float, **inputs: float):
    """State and output of the on/off sequence after `seconds` of constant inputs."""
    p, _ = parameter_record(PropulsionSequence())
    u, y = make_record(propulsion.Input, inputs), make_record(propulsion.Output)
    for _ in range(round(seconds / 0.01)):
        x_next = x.copy()
        propulsion.update(0.01, x, u, p, x_next, y)
        x = x_next
    return x, y


def test_sequence_ramps_torque_up_and_unloads_before_it_blocks():
    x, y = sequence(make_record(propulsion.State), 0.5, on=1.0, v_dc=750.0)
    assert (x.state, y.blocked, y.enabled) == (propulsion.RAMP_UP, 0.0, 1.0)
    assert x.share == pytest.approx(0.5)
    x, y = sequence(x, 0.6, on=1.0, v_dc=750.0)
    assert (x.state, x.share) == (propulsion.ON, 1.0)
    x, y = sequence(x, 0.5, on=0.0, v_dc=750.0)
    assert (x.state, y.blocked) == (propulsion.RAMP_DOWN, 0.0)
    x, y = sequence(x, 0.5, on=0.0, v_dc=750.0)
    assert x.share == pytest.approx(0.0, abs=1e-9)
    x, y = sequence(x, 0.03, on=0.0, v_dc=750.0)
    assert (x.state, y.blocked, y.enabled) == (propulsion.OFF, 1.0, 0.0)


def test_sequence_turns_round_in_the_middle_of_a_ramp():
    x, _ = sequence(make_record(propulsion.State), 2.0, on=1.0, v_dc=750.0)
    x, _ = sequence(x, 0.5, on=0.0, v_dc=750.0)
    x, _ = sequence(x, 0.2, on=1.0, v_dc=750.0)
    assert x.state == propulsion.RAMP_UP
    assert x.share == pytest.approx(0.7)


def test_sequence_refuses_a_low_bus_with_its_reason_and_trips_on_a_dead_one():
    x, y = sequence(make_record(propulsion.State), 1.0, on=1.0, v_dc=690.0)
    assert (x.state, y.blocked, y.refused) == (propulsion.OFF, 1.0, 1.0)
    x, y = sequence(x, 2.0, on=1.0, v_dc=750.0)
    assert (x.state, y.refused) == (propulsion.ON, 0.0)
    x, y = sequence(x, 0.01, on=1.0, v_dc=590.0)
    assert (x.state, x.share, y.blocked) == (propulsion.OFF, 0.0, 1.0)
    x, y = sequence(x, 0.01, on=1.0, v_dc=650.0)
    assert y.refused == 1.0
    x, y = sequence(x, 0.01, on=0.0, v_dc=650.0)
    assert y.refused == 0.0
