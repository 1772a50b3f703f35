"""Diesel engine: dead time, friction, starter."""

import numpy as np
import pytest

from shipgrid.components.mechanical.diesel_engine import DieselEngine, Input, Output, State, update
from shipgrid.model.records import make_record, parameter_record


def torque(engine, dt, throttle, **inputs):
    """Torque at each sampling instant for the throttle at each."""
    p, _ = parameter_record(engine)
    x, x_next, y = make_record(State), make_record(State), make_record(Output)
    delays = np.zeros(engine.delay_length(dt))
    found = []
    for k, value in enumerate(throttle):
        u = make_record(Input, {"omega": 1.0, **inputs, "throttle": value})
        update(k * dt, dt, x, u, p, x_next, y, delays)
        x.position = x_next.position
        found.append(y.T_m)
    return np.array(found)


@pytest.mark.parametrize("T_D", [0.0243, 0.024, 0.0011, 0.5e-3])
@pytest.mark.parametrize("dt", [0.5e-3, 0.51e-3, 1e-3])
def test_a_ramp_of_the_throttle_comes_out_the_dead_time_later(T_D, dt):
    """On average over the sampling period in which it is held: half a period after its instant."""
    t = dt * np.arange(120)
    found = torque(DieselEngine(T_D=T_D), dt, t)
    late = t >= T_D + 2 * dt
    np.testing.assert_allclose(found[late], t[late] + dt / 2 - T_D, atol=1e-14)


def test_no_torque_before_the_dead_time_is_over():
    found = torque(DieselEngine(), 0.5e-3, np.ones(100))
    first = np.flatnonzero(found)[0]
    # 24 ms are 48 samples; between the samples before and at the step the line sees a ramp, whose middle comes first
    assert first == 47
    assert found[first - 1 : first + 2] == pytest.approx([0.0, 0.5, 1.0])


def test_without_dead_time_the_torque_is_the_throttle():
    throttle = np.sin(np.arange(50))
    assert torque(DieselEngine(T_D=0.0), 0.5e-3, throttle) == pytest.approx(throttle, abs=1e-15)


@pytest.mark.parametrize(("omega", "expected"), [(1.0, -0.05), (0.02, -0.05), (0.01, -0.025), (0.0, 0.0)])
def test_without_fuel_friction_brakes_and_vanishes_at_standstill(omega, expected):
    assert torque(DieselEngine(), 0.5e-3, [0.0], omega=omega, fuel=0.0)[0] == pytest.approx(expected)


def test_the_starter_turns_a_cold_engine_and_lets_go_at_its_own_speed():
    assert torque(DieselEngine(), 0.5e-3, [0.0], omega=0.0, fuel=0.0, crank=1.0)[0] == pytest.approx(0.15)
    assert torque(DieselEngine(), 0.5e-3, [0.0], omega=0.2, fuel=0.0, crank=1.0)[0] == pytest.approx(0.075 - 0.05)
    assert torque(DieselEngine(), 0.5e-3, [0.0], omega=0.6, fuel=0.0, crank=1.0)[0] == pytest.approx(-0.05)


def test_the_line_is_as_long_as_its_reader_needs():
    for dt in (0.51e-3, 1e-3, 0.03):
        engine = DieselEngine()
        assert (engine.delay_length(dt) - 2) * dt >= engine.T_D
