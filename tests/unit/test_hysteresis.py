"""Hysteresis current control: crossings located inside the step, against the motor itself in fine ticks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shipgrid.components.machines import pmsm
from shipgrid.components.machines.pmsm import Pmsm
from shipgrid.model import kernel
from shipgrid.model.component import type_of
from shipgrid.model.frames import abc_to_alpha_beta, alpha_beta_to_abc, unrotate
from shipgrid.model.records import initial_of, parameter_record, record_dtype
from shipgrid.modulators.hysteresis import MOST, HysteresisBridge, hysteresis_modulate

H = 30e-6
BAND = 24.5
V_DC = 750.0
RATED = 490.7  # A, peak: 5.73 kN m with i_d = 0
OMEGA = 2.0 * math.pi * 7.5  # rad/s: 450 rpm

pmsm_derivatives = pmsm.derivatives


def records(record):
    return initial_of(record).view(record_dtype(record))


def parameters(item):
    p = parameter_record(item)[0]
    return np.asarray(p).reshape(1).view(p.dtype)


@kernel
def march(h, motor, u, p, dx, mid, s_a, s_b, s_c, v_dc):
    """One midpoint step of the motor at constant switching functions."""
    s_alpha, s_beta = abc_to_alpha_beta(s_a, s_b, s_c)
    u.v_alpha, u.v_beta = s_alpha * v_dc, s_beta * v_dc
    pmsm_derivatives(motor, u, p, dx)
    mid.i_d = motor.i_d + 0.5 * h * dx.i_d
    mid.i_q = motor.i_q + 0.5 * h * dx.i_q
    mid.theta_e = motor.theta_e + 0.5 * h * dx.theta_e
    pmsm_derivatives(mid, u, p, dx)
    motor.i_d += h * dx.i_d
    motor.i_q += h * dx.i_q
    motor.theta_e += h * dx.theta_e


@kernel
def errors(motor, i_d_ref, i_q_ref):
    alpha, beta = unrotate(motor.i_d - i_d_ref, motor.i_q - i_q_ref, np.cos(motor.theta_e), np.sin(motor.theta_e))
    return alpha_beta_to_abc(alpha, beta)


@kernel
def comparators(n, ticks, h, band, dead, i_d_ref, i_q_ref, motor, u, p, dx, mid, s, wait, at, mean, current):
    """The drive itself: comparators that look `ticks` times a step. Mean s, currents and crossings of each step.

    For `dead` ticks after a crossing both switches of a leg are open, and the diode that its current asks for conducts.
    """
    crossings = 0
    for k in range(n):
        mean[k, 0] = mean[k, 1] = mean[k, 2] = 0.0
        for _ in range(ticks):
            e = errors(motor[0], i_d_ref, i_q_ref)
            for j in range(3):
                now = 0.0 if e[j] >= band else (1.0 if e[j] <= -band else s[j])
                if now != s[j]:
                    crossings += 1
                    wait[j] = dead
                s[j] = now
                at[j] = now
            if dead > 0:
                i = errors(motor[0], 0.0, 0.0)
                for j in range(3):
                    if wait[j] > 0:
                        wait[j] -= 1
                        at[j] = 0.0 if i[j] > 0.0 else 1.0
            for j in range(3):
                mean[k, j] += at[j] / ticks
            march(h / ticks, motor[0], u[0], p[0], dx[0], mid[0], at[0], at[1], at[2], 750.0)
        current[k, 0], current[k, 1], current[k, 2] = errors(motor[0], i_d_ref, i_q_ref)
    return crossings


@kernel
def modulated(n, parts, h, i_d_ref, i_q_ref, motor, u, p, dx, mid, x, v, b, y, mean, current):
    """The same motor with the modulator: mean switching functions, held for a step of `parts` parts."""
    for k in range(n):
        v[0].i_d, v[0].i_q, v[0].theta_e, v[0].omega_m = motor[0].i_d, motor[0].i_q, motor[0].theta_e, u[0].omega_m
        v[0].v_dc, v[0].i_d_ref, v[0].i_q_ref = 750.0, i_d_ref, i_q_ref
        hysteresis_modulate(h, 1.0, x[0], v[0], b[0], y[0])
        i = errors(motor[0], 0.0, 0.0)  # between the bounds the current's sign decides, as in the network
        mean[k, 0] = y[0].lo_a if i[0] > 0.0 else y[0].hi_a
        mean[k, 1] = y[0].lo_b if i[1] > 0.0 else y[0].hi_b
        mean[k, 2] = y[0].lo_c if i[2] > 0.0 else y[0].hi_c
        for _ in range(parts):
            march(h / parts, motor[0], u[0], p[0], dx[0], mid[0], mean[k, 0], mean[k, 1], mean[k, 2], 750.0)
        current[k, 0], current[k, 1], current[k, 2] = errors(motor[0], i_d_ref, i_q_ref)


class Drive:
    """Motor at constant speed and its hysteresis control."""

    def __init__(
        self,
        *,
        band=BAND,
        i_q_ref=RATED,
        i_d_ref=0.0,
        omega=OMEGA,
        h=H,
        L_d=1.83e-3,
        L_q=1.83e-3,
        dead_time=0.0,
        **start,
    ):
        self.h, self.band, self.refs = h, band, (i_d_ref, i_q_ref)
        kind = type_of(Pmsm)
        self.motor, self.dx, self.mid = (records(kind.state) for _ in range(3))
        self.u = records(kind.input)
        self.u[0].omega_m = omega
        self.p = parameters(Pmsm(L_d=L_d, L_q=L_q))
        kind = type_of(HysteresisBridge)
        self.x, self.v, self.y = records(kind.state), records(kind.input), records(kind.output)
        self.dead_time = dead_time
        self.b = parameters(HysteresisBridge(band=band, L_d=L_d, L_q=L_q, R=8e-3, dead_time=dead_time))
        self.motor[0].i_d, self.motor[0].i_q = i_d_ref, i_q_ref
        for name, value in start.items():
            self.motor[0][name] = value
        self.wait = np.zeros(3)
        self.s = np.zeros(3)  # of the comparators; the modulator's are its own states

    def put(self, s):
        self.x[0].s_a, self.x[0].s_b, self.x[0].s_c = s
        self.s[:] = s

    @property
    def machine(self):
        return self.motor, self.u, self.p, self.dx, self.mid

    def exact(self, n, ticks=600):
        mean, current = np.zeros((n, 3)), np.zeros((n, 3))
        dead = round(self.dead_time / self.h * ticks)
        of_legs = self.s, self.wait, np.zeros(3), mean, current
        count = comparators(n, ticks, self.h, self.band, dead, *self.refs, *self.machine, *of_legs)
        return mean, current, count

    def run(self, n, parts=10):
        mean, current = np.zeros((n, 3)), np.zeros((n, 3))
        modulated(n, parts, self.h, *self.refs, *self.machine, self.x, self.v, self.b, self.y, mean, current)
        return mean, current, self.x[0].crossings


def starts(count, band, **made):
    """Pairs of one drive, somewhere in its band."""
    rng = np.random.default_rng(5)
    for _ in range(count):
        start = {
            "i_d": rng.uniform(-band, band),
            "i_q": RATED + rng.uniform(-band, band),
            "theta_e": rng.uniform(-math.pi, math.pi),
        }
        s = rng.integers(0, 2, 3)
        pair = [Drive(band=band, **made, **start) for _ in range(2)]
        for drive in pair:
            drive.put(s)
        yield pair


@pytest.mark.parametrize(
    ("band", "made", "most", "typical"),
    [
        (24.5, {}, 1, 1e-3),
        (2.0, {}, 4, 1e-3),
        (8.0, {"L_d": 1.2e-3, "L_q": 2.4e-3}, 2, 2e-3),
        (1.0, {"h": 90e-6}, 8, 5e-3),
        (24.5, {"dead_time": 4e-6}, 1, 2e-3),
        (4.0, {"dead_time": 4e-6}, 2, 5e-3),
    ],
)
def test_one_step_has_the_crossings_of_comparators_that_look_all_the_time(band, made, most, typical):
    """From states all over the band; with 1 A at 90 us a leg switches again and again within the step."""
    off, counts, other = [], [], 0
    for clock, drive in starts(100, band, **made):
        expected, _, count = clock.exact(1, ticks=6000)
        found, _, crossings = drive.run(1)
        off.append(np.max(np.abs(found - expected)))
        counts.append(count)
        other += crossings != count
    assert max(counts) >= most
    assert np.quantile(off, 0.9) < typical  # a tick is 1.7e-4 of a step
    assert max(off) < 0.15
    assert other <= 0.01 * sum(counts) + 1  # two crossings in the same tick may come in either order


def test_closed_loop_switches_as_often_and_ripples_as_much_as_the_comparators():
    """0.4 s at rated torque and speed, from eight angles. The band gives 0.55 kHz a leg; nothing repeats exactly."""
    rate, ripple, peak = [], [], []
    for angle in 0.7 * np.arange(8):
        n = round(0.4 / H)
        clock, drive = Drive(theta_e=angle), Drive(theta_e=angle)
        for _, error, count in (clock.exact(n, ticks=150), drive.run(n)):
            rate.append(count / 6.0 / 0.4)
            ripple.append(math.sqrt(np.mean(error**2)))
            peak.append(np.max(np.abs(error)))
    rates, ripples, peaks = (np.reshape(value, (8, 2)).T for value in (rate, ripple, peak))
    # standard errors of the means of eight: 1.2 %, 0.4 %
    assert np.mean(rates[1]) == pytest.approx(np.mean(rates[0]), rel=0.04)
    assert np.mean(ripples[1]) == pytest.approx(np.mean(ripples[0]), rel=0.015)
    assert 1.5 * BAND < np.max(peaks[0]) < 2.0 * BAND  # the insulated star point: more than the band, at most twice it
    assert 1.5 * BAND < np.max(peaks[1]) < 2.0 * BAND


def test_dead_time_lets_the_error_go_on_over_the_band():
    """4 us at up to 0.4 A/us: peaks of the error rise by so much, and bounds of s part by the dead time an edge."""
    peaks = []
    for dead_time in (0.0, 4e-6):
        drive = Drive(band=BAND, dead_time=dead_time)
        _, error, crossings = drive.run(round(0.4 / H))
        assert crossings > 500
        peaks.append(np.quantile(np.abs(error), 0.999))
    assert 0.2 < peaks[1] - peaks[0] < 4.0
    drive = Drive(dead_time=4e-6)
    apart, before = 0.0, 0.0
    for _ in range(2000):
        drive.run(1)
        y = drive.y[0]
        apart += (y.hi_a - y.lo_a + y.hi_b - y.lo_b + y.hi_c - y.lo_c) * H
    before = drive.x[0].dead_a + drive.x[0].dead_b + drive.x[0].dead_c  # of the last edges, still to come
    assert apart + before == pytest.approx(drive.x[0].crossings * 4e-6, rel=1e-9)


def test_the_torque_is_that_of_the_reference_in_the_mean():
    drive = Drive(theta_e=0.3)
    found = []
    for _ in range(round(0.4 / H)):
        drive.run(1)
        found.append(drive.motor[0].i_q)
    assert np.mean(found) == pytest.approx(RATED, rel=0.01)  # the ripple is not symmetric: a tenth of the band
    assert np.std(found) > 5.0


def test_an_error_never_builds_up_from_crossings_that_were_predicted():
    """After each step the error is that of the motor: a reference that steps far away is followed at full voltage."""
    drive = Drive(i_q_ref=0.0)
    drive.run(500)
    drive.refs = (0.0, 300.0)
    n = 0
    while drive.motor[0].i_q < 300.0 - BAND:
        drive.run(1)
        n += 1
        assert n < 300
    # L di/dt = at most 2/3 v_dc less the emf, at least v_dc / sqrt 3 less the emf
    emf = 3.0 * OMEGA * 2.595
    slowest, fastest = ((300.0 - BAND) * 1.83e-3 / (v - emf) for v in (V_DC / math.sqrt(3.0), 2.0 / 3.0 * V_DC))
    assert 0.9 * fastest < n * H < 1.1 * slowest + 2 * H


def test_more_crossings_than_are_followed_are_counted_and_logged():
    drive = Drive(band=0.01, h=90e-6)
    mean, _, crossings = drive.run(50)
    assert drive.x[0].capped > 0.0
    assert crossings <= 50 * MOST
    assert np.all((mean >= 0.0) & (mean <= 1.0))
    drive = Drive(band=0.5, h=90e-6)
    drive.run(500)
    assert drive.x[0].capped == 0.0 and drive.y[0].limited == 0.0


def test_lead_is_the_area_before_the_sampling_instant():
    fraction, seen = 0.37, 0
    for clock, drive in starts(40, 2.0):
        first, _, _ = clock.exact(1, ticks=6000)  # to be told apart from
        part = Drive(band=2.0, h=fraction * H)
        part.motor[:], part.s[:] = drive.motor, (drive.x[0].s_a, drive.x[0].s_b, drive.x[0].s_c)
        early, _, _ = part.exact(1, ticks=3000)
        v, m = drive.v[0], drive.motor[0]
        v.i_d, v.i_q, v.theta_e, v.omega_m, v.v_dc, v.i_q_ref = m.i_d, m.i_q, m.theta_e, OMEGA, V_DC, RATED
        hysteresis_modulate(H, fraction, drive.x[0], v, drive.b[0], drive.y[0])
        found = [drive.y[0].lead_a, drive.y[0].lead_b, drive.y[0].lead_c]
        assert found == pytest.approx(fraction * (early - first)[0], abs=2e-3)
        seen += np.max(np.abs(found)) > 0.05
    assert seen > 10


def test_without_gates_the_comparators_go_on_and_the_legs_are_open():
    drive = Drive(i_q=0.0)
    drive.put((0, 0, 0))
    drive.v[0].gates = 0.0
    drive.run(1)
    y = drive.y[0]
    assert (y.lo_a, y.lo_b, y.lo_c, y.hi_a, y.hi_b, y.hi_c) == (0.0, 0.0, 0.0, 1.0, 1.0, 1.0)
    # at theta_e = 0 the q axis is the beta axis: phase b wants current, c wants it out, a wants none
    assert (drive.x[0].s_a, drive.x[0].s_b, drive.x[0].s_c) == (0.0, 1.0, 0.0)
    assert drive.x[0].crossings == 0.0
    drive.v[0].gates = 1.0
    mean, _, _ = drive.run(1)
    assert list(mean[0]) == [0.0, 1.0, 0.0]
