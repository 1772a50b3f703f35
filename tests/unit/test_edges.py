"""Edges inside steps: switching functions from carriers and from means, and currents between steps."""

import numpy as np
import pytest

from shipgrid.analysis.edges import (
    SwitchingFunction,
    alpha_beta,
    between_steps,
    combination,
    corners,
    of_bridge,
    of_carrier,
    of_means,
    of_steps,
    pulses,
)
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


def bridge_of_a_carrier(h=30e-6, n=1300):
    """Legs of a 1620 Hz bridge that follows 60 Hz, and their means over steps."""
    instants = np.arange(int(n * h * 3240.0) + 1) / 3240.0
    angle = 2.0 * np.pi * 60.0 * instants
    t = h * np.arange(n + 1)
    legs = of_bridge(instants, 0.45 * np.cos(angle), 0.45 * np.sin(angle), 1620.0, t[-1])
    return t, legs, np.array([np.diff(leg.integral(t)) / h for leg in legs])


def test_edges_are_found_from_the_means_of_steps_alone():
    t, legs, means = bridge_of_a_carrier()
    for leg, mean in zip(legs, means, strict=True):
        found = of_steps(t, mean)
        assert np.diff(found.integral(t)) / 30e-6 == pytest.approx(mean, abs=1e-9)
        edges = leg.edges[leg.edges < t[-1]]
        assert len(found.edges) == len(edges) > 120
        alone = np.bincount(np.searchsorted(t, edges), minlength=len(t))[np.searchsorted(t, edges)] == 1
        assert np.mean(alone) > 0.9
        assert found.edges[alone] == pytest.approx(edges[alone], abs=1e-12)
        assert found.edges == pytest.approx(edges, abs=15e-6)  # two in one step: around its middle


def test_what_has_no_known_edge_keeps_its_means():
    t = np.arange(5.0)
    for means in ([0.4, 0.4, 0.5, 0.5], [0.5] * 4):
        found = of_steps(t, means)
        assert list(found(t[:-1])) == means
    found = of_steps(t, [0.0, 0.3, 0.4, 0.4], still=[False, False, True, True])  # rises, and then rests
    assert list(found.time) == pytest.approx([0.0, 1.7, 2.0])
    assert list(found.value) == [0.0, 1.0, 0.4]


def test_currents_and_voltages_of_a_bridge_are_drawn_with_their_edges():
    """A choke of 1 mH between 750 V and a sine: its corners, and the very pulses of the voltage."""
    t, legs, means = bridge_of_a_carrier()
    weights = (2.0 / 3.0, -1.0 / 3.0, -1.0 / 3.0)
    phase = combination(weights, legs)
    omega = 2.0 * np.pi * 60.0

    def current(at):
        return (750.0 * phase.integral(at) - 0.45 * 750.0 * np.sin(omega * np.asarray(at)) / omega) / 1e-3

    s = np.column_stack([np.full(3, np.nan), means])
    found_t, found_i = corners(t, current(t), s, weights)
    assert len(found_t) > len(t) + 300
    sharp = current(found_t)
    assert np.abs(found_i - sharp).max() < 0.25  # the sine's own bend in a step, and two edges in one
    assert np.abs(np.interp(found_t, t, current(t)) - sharp).max() > 1.0  # what the ends of steps miss
    line = combination((1.0, -1.0, 0.0), legs)
    mean = np.concatenate([[0.0], 750.0 * (means[0] - means[1])])
    at, v = pulses(t, mean, s, (1.0, -1.0, 0.0))
    middle = 0.5 * (at[::2] + at[1::2])
    right = np.abs(v[::2] - 750.0 * line(middle)) < 1e-6
    assert np.sum((at[1::2] - at[::2])[~right]) < 0.01 * t[-1]  # but for steps with two edges of one leg
    assert np.all(at[1::2] > at[::2]) and np.array_equal(v[::2], v[1::2])


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
