"""Fundamental, harmonics, distortion and ripple of waveforms whose content is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shipgrid.analysis.edges import corners
from shipgrid.analysis.harmonics import fundamental, ripple, spectrum

H = 30e-6


def wave(f, content, seconds=0.25, mean=0.0, step=H):
    """Samples of a sum of cosines: peak and phase by order."""
    t = 3.0 + step * np.arange(round(seconds / step) + 1)
    return t, mean + sum(a * np.cos(2 * math.pi * f * n * t + phi) for n, (a, phi) in content.items())


CONTENT = {1: (325.0, 0.4), 5: (20.0, 1.0), 7: (12.0, -2.0), 11: (6.0, 0.3), 39: (3.0, 2.0)}
THD = math.sqrt(20.0**2 + 12.0**2 + 6.0**2 + 3.0**2) / 325.0


@pytest.mark.parametrize("f", [60.0, 58.9, 61.37, 50.0, 15.35])
def test_the_fundamental_is_found_whatever_number_of_samples_a_cycle_has(f):
    # what the harmonics' samples between two steps leave: 1e-7 for the 39th order's 0.43 rad a step
    assert fundamental(*wave(f, CONTENT)) == pytest.approx(f, rel=2e-6)


def test_a_constant_and_a_ramp_have_no_fundamental():
    t = H * np.arange(5000)
    assert fundamental(t, np.full(5000, 750.0)) is None
    assert fundamental(t, 750.0 + 5.0 * t) is None


@pytest.mark.parametrize("f", [60.0, 58.9, 50.0])
def test_harmonics_of_known_size_are_found(f):
    t, y = wave(f, CONTENT, mean=4.0)
    found = spectrum(t, y, f)
    assert found.cycles == math.floor(0.2 * f)
    assert found.mean == pytest.approx(4.0, abs=1e-3)
    for order in range(1, 41):
        # a sum of trapezoids with an end within a step: 1e-4 of what turns by up to 0.4 rad a step
        assert found.harmonic(order) == pytest.approx(CONTENT.get(order, (0.0, 0.0))[0], abs=3e-3)
    assert found.thd == pytest.approx(THD, rel=1e-4)
    assert found.distortion == pytest.approx(THD, rel=2e-3)
    assert found.rms == pytest.approx(math.sqrt(4.0**2 + 0.5 * sum(a**2 for a, _ in CONTENT.values())), rel=1e-5)


def test_phases_are_those_of_the_cosines():
    t, y = wave(58.9, CONTENT)
    found = spectrum(t, y, 58.9)
    for order in (1, 5, 11):
        turned = 2 * math.pi * 58.9 * order * found.start + CONTENT[order][1]
        got = np.angle(found.lines[order * found.cycles])
        assert math.remainder(got - turned, 2 * math.pi) == pytest.approx(0.0, abs=1e-3)


def test_lines_between_the_harmonics_are_distortion_but_not_thd():
    """A carrier of 1620 Hz with its side lines at 58.9 Hz: orders 27.5 and 27.5 +- 2."""
    f = 60.0
    t, y = wave(f, {1: (100.0, 0.0), 25.5: (4.0, 0.1), 27.5: (1.0, 0.0), 29.5: (3.0, 0.2), 60: (2.0, 0.0)})
    found = spectrum(t, y, f)
    assert found.thd < 1e-3
    assert found.distortion == pytest.approx(math.sqrt(16.0 + 1.0 + 9.0 + 4.0) / 100.0, rel=1e-3)
    lines = found.around(27.5 * f, count=3)
    assert [x for x, _ in lines] == pytest.approx([25.5 * f, 29.5 * f, 27.5 * f])
    assert [x for _, x in lines] == pytest.approx([4.0, 3.0, 1.0], abs=3e-3)


def test_a_line_beside_a_harmonic_counts_with_it():
    """A slow swing of a harmonic has lines 5 Hz beside it; the subgroup keeps their power."""
    t, y = wave(60.0, {1: (100.0, 0.0), 7 - 1 / 12: (3.0, 0.0), 7: (4.0, 0.0)})
    assert spectrum(t, y, 60.0).harmonic(7) == pytest.approx(5.0, abs=3e-3)


def test_what_the_mean_of_a_step_takes_from_a_line_is_given_back():
    f, order = 60.0, 27
    t = H * np.arange(8335)
    w = 2 * math.pi * f * order
    y = (np.sin(w * t) - np.sin(w * (t - H))) / (w * H) + 50.0 * (
        (np.sin(w / 27 * t) - np.sin(w / 27 * (t - H))) / (w / 27 * H)
    )
    plain, exact = spectrum(t, y, f), spectrum(t, y, f, mean_of_step=True)
    assert plain.harmonic(order) == pytest.approx(np.sinc(f * order * H), rel=1e-4)  # 0.4 % less
    assert exact.harmonic(order) == pytest.approx(1.0, rel=1e-4)
    assert exact.distortion == pytest.approx(1.0 / 50.0, rel=1e-2)


def triangle(d, f, seconds, step, L=0.8e-3, v_dc=750.0):
    """Step ends of a choke's current at duty ratio d, and the mean switching function of each step."""
    t = step * np.arange(round(seconds / step) + 1)

    def on(t):
        """Time that the switch has been on since zero: pulses in the middle of each period."""
        whole = np.floor(t * f)
        return d * whole / f + np.clip(t - whole / f - 0.5 * (1.0 - d) / f, 0.0, d / f)

    s = np.diff(on(t)) / step
    return t, v_dc / L * (d * t - on(t)), np.concatenate([[0.0], s])


@pytest.mark.parametrize("d", [0.25, 0.5, 0.632])
def test_the_ripple_of_a_choke_is_found_between_the_steps(d):
    t, i, s = triangle(d, 5e3, 0.02, H)
    pp = 750.0 * d * (1.0 - d) / (0.8e-3 * 5e3)
    assert ripple(t, i, 5e3)[0] < 0.95 * pp, "the ends of the steps miss the tips"
    mean, largest = ripple(*corners(t, i, s), 5e3)
    assert mean == pytest.approx(pp, rel=5e-3)  # the first and the last period may lack a corner
    assert largest == pytest.approx(pp, rel=1e-6)


def test_a_current_without_edges_stays_as_it_is():
    t, i, _ = triangle(0.6, 5e3, 0.01, H)
    for s in (np.full(len(t), 0.6), np.ones(len(t))):
        same = corners(t, i, s)
        assert same[0] is t and same[1] is i


def test_the_carrier_of_a_slow_motor_is_not_its_fundamental():
    """Two turns in the window, and a larger line at 1.8 kHz."""
    t, y = wave(8.0, {1: (100.0, 0.0), 225: (150.0, 0.0)})
    assert fundamental(t, y) is None
    t, y = wave(15.0, {1: (100.0, 0.0), 120: (150.0, 0.0)})
    assert fundamental(t, y) == pytest.approx(15.0, rel=1e-3)
