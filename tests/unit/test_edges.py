"""Edges inside steps: switching functions from carriers and from means, and currents between steps."""

import numpy as np
import pytest

from shipgrid.analysis.edges import SwitchingFunction, alpha_beta, between_steps, of_bridge, of_carrier, of_means
from shipgrid.errors import ParameterError
from shipgrid.model.kernel import uncompiled
from shipgrid.modulators.time_stamped import pulse


def test_a_constant_duty_ratio_has_its_pulses_in_the_middle_of_each_period():
    s = of_carrier([0.0], [0.4], 1000.0, 3e-3)
    assert s.edges == pytest.approx(1e-3 * np.array([0.3, 0.7, 1.3, 1.7, 2.3, 2.7]))
    assert list(s([0.0, 0.5e-3, 0.8e-3, 1.3e-3])) == [0.0, 1.0, 0.0, 1.0]
    assert s.integral(3e-3) == pytest.approx(1.2e-3)


@pytest.mark.parametrize("shift", [0.0, 0.35])
def test_means_of_a_carrier_are_the_modulators(shift):
    """Duty ratios that change in the middle of steps, some beyond 0 or 1."""
    rng = np.random.default_rng(3)
    f, f_sample, h, n = 1620.0, 5000.0, 30e-6, 400
    end = n * h
    instants = np.arange(int(end * f_sample) + 1) / f_sample
    duty = rng.uniform(-0.2, 1.2, len(instants))
    s = of_carrier(instants, duty, f, end, shift)
    m = np.clip(duty, 0.0, 1.0)
    k = 0
    for step in range(n):
        t_0, t_1 = step * h, (step + 1) * h
        inside = k + 1 < len(instants) and instants[k + 1] < t_1 - 1e-15
        fraction = max(0.0, (instants[k + 1] - t_0) / h) if inside else -1.0
        expected, lead, _ = uncompiled(pulse)(f * t_0 + shift, f * t_1 + shift, 0.0, fraction, m[k], m[k + inside])
        assert (s.integral(t_1) - s.integral(t_0)) / h == pytest.approx(expected, abs=1e-9)
        if inside:
            found = (s.integral(instants[k + 1]) - s.integral(t_0)) / h - fraction * expected
            assert found == pytest.approx(lead, abs=1e-9)
        k += inside


def test_one_edge_in_a_step_lies_where_the_mean_puts_it_and_two_around_the_middle():
    t = np.array([0.0, 1.0, 2.0, 3.0])
    s = of_means(t, [0.25, 0.6, 0.0], [1.0, 0.0, 0.0, 0.0])
    assert s.edges == pytest.approx([0.25, 1.2, 1.8])
    assert s.integral(t) == pytest.approx([0.0, 0.25, 0.85, 0.85])
    with pytest.raises(ParameterError):
        of_means(t, [0.25], [1.0, 0.0])


def test_legs_of_a_bridge_become_the_corners_of_a_hexagon():
    legs = of_bridge([0.0], [0.3], [0.1], 1000.0, 1e-3)
    alpha, beta = alpha_beta(legs)
    t = np.linspace(0.0, 0.999e-3, 500)
    length = np.hypot(alpha(t), beta(t))
    assert np.all((np.abs(length) < 1e-12) | (np.abs(length - 2.0 / 3.0) < 1e-12))
    assert alpha.integral(1e-3) / 1e-3 == pytest.approx(0.3)
    assert beta.integral(1e-3) / 1e-3 == pytest.approx(0.1)


def test_a_current_between_steps_is_the_one_that_flows():
    """A choke on a leg, no resistance: straight lines, whose corners lie inside the steps."""
    f, d, h, L, v_dc, e = 5e3, 0.62, 30e-6, 0.8e-3, 750.0, 465.0
    s = of_carrier([0.0], [d], f, 3e-3)
    t = h * np.arange(101)

    def exact(at):
        return (v_dc * s.integral(at) - e * at) / L

    times, values = between_steps(t, exact(t), s, 1.0 / L, np.full(len(t), v_dc))
    assert set(s.edges) <= set(times)
    assert values == pytest.approx(exact(times), abs=1e-9)
    assert np.max(values) - np.max(exact(t)) > 0.5  # A; the ends of steps miss the crest


def test_a_switching_function_does_not_go_back_in_time():
    with pytest.raises(ParameterError):
        SwitchingFunction(np.array([0.0, 2.0, 1.0]), np.array([0.0, 1.0, 0.0]))
