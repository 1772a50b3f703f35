"""The time-stamped modulators: every edge of the carrier at its place inside a step.

Oracles are the triangle itself, cut into straight pieces, and a clockwork of fine ticks for what has memory (dead time,
least pulse); spectra are those of the double Fourier series.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.special import jv

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.model import kernel
from shipgrid.model.component import type_of
from shipgrid.model.frames import abc_to_alpha_beta
from shipgrid.model.network import Network
from shipgrid.model.placed import Sampled
from shipgrid.model.records import initial_of, parameter_record, record_dtype
from shipgrid.modulators.averaged import AveragedBridge
from shipgrid.modulators.time_stamped import (
    Carrier,
    TimeStampedBridge,
    TimeStampedLeg,
    bridge_modulate,
    drive,
    leg_modulate,
    pulse,
    undriven,
)
from verification.circuits import Hold

H = 30e-6
F_CARRIER = 1620.0
NEVER = -1.0


def triangle(phase):
    """The carrier: 1 at phase 0, 0 at half a period."""
    return abs(1.0 - 2.0 * (phase - math.floor(phase)))


def pieces(start, stop, duty):
    """Time the carrier lies below `duty` between two phases, vertex to vertex, and the edges found on the way."""
    corners = [start, *(k / 2 for k in range(math.floor(2 * start) + 1, math.ceil(2 * stop))), stop]
    on, edges = 0.0, 0
    for a, b in pairwise(corners):
        c_a, c_b = triangle(a), triangle(b)
        low, high = min(c_a, c_b), max(c_a, c_b)
        on += (b - a) * (min(max((duty - low) / (high - low), 0.0), 1.0) if high > low else float(duty > low))
        edges += low < duty < high
    return on, edges


def ratio(hertz, h=H):
    """A clock as whole numbers: what a step adds, and what makes a period."""
    exact = Fraction(hertz).limit_denominator(10**6) * Fraction(h).limit_denominator(10**12)
    return exact.numerator, exact.denominator


@kernel
def tick(clock, inc, den):
    """One step of a clock, as in `bookkeeping.tick_clocks`: phase before and after, and the fraction or -1."""
    before = clock[0]
    clock[0] += inc
    fraction = -1.0
    if clock[0] >= den:
        clock[0] -= den
        fraction = 1.0 - clock[0] / inc
    return before / den, clock[0] / den, fraction


@kernel
def run_bridge(n, dt, clock, sampling, carrier, alpha, beta, x, u, p, y, s, lead, at):
    """`n` steps of a bridge whose controller gives `alpha[k]`, `beta[k]` at its k-th instant."""
    sample = 0
    for k in range(n):
        u[0].phase, u[0].phase_next, turned = tick(clock[0], carrier[0], carrier[1])
        u[0].turns = 1.0 if turned >= 0.0 else 0.0
        fraction = tick(clock[1], sampling[0], sampling[1])[2]
        u[0].s_alpha_ref = alpha[sample]
        u[0].s_beta_ref = beta[sample]
        if fraction >= 0.0 and sample + 1 < alpha.shape[0]:
            sample += 1
        bridge_modulate(dt, fraction, x[0], u[0], p[0], y[0])
        s[k, 0], s[k, 1], s[k, 2] = y[0].lo_a, y[0].lo_b, y[0].lo_c
        s[k, 3], s[k, 4], s[k, 5] = y[0].hi_a, y[0].hi_b, y[0].hi_c
        lead[k, 0], lead[k, 1], lead[k, 2] = y[0].lead_a, y[0].lead_b, y[0].lead_c
        at[k] = fraction


class Bench:
    """A modulator with its records, its carrier and its clock."""

    def __init__(self, item=None, *, h=H, sampling=2.0 * F_CARRIER, carrier=F_CARRIER, **state):
        self.item = item or TimeStampedBridge()
        self.kind = type_of(self.item)
        self.h, self.sampling, self.carrier = h, ratio(sampling, h), ratio(carrier, h)
        self.x, self.u, self.y = (self._records(r) for r in (self.kind.state, self.kind.input, self.kind.output))
        for name, value in state.items():
            self.x[0][name] = value
        p = parameter_record(self.item)[0]
        self.p = np.asarray(p).reshape(1).view(p.dtype)
        self.clock = np.zeros((2, 1), dtype=np.int64)

    @staticmethod
    def _records(record):
        return initial_of(record).view(record_dtype(record))

    def run(self, n, alpha=(0.0,), beta=(0.0,)):
        """Switching functions lo and hi of the legs a, b, c (n, 6), leads (n, 3), sampling fractions (n,)."""
        s, lead, at = np.zeros((n, 6)), np.zeros((n, 3)), np.zeros(n)
        alpha, beta = np.atleast_1d(np.asarray(alpha, float)), np.atleast_1d(np.asarray(beta, float))
        pair = (np.array(c, dtype=np.int64) for c in (self.sampling, self.carrier))
        run_bridge(n, self.h, self.clock, *pair, alpha, beta, self.x, self.u, self.p, self.y, s, lead, at)
        return s, lead, at


def vector(amplitude, count, period, f=60.0):
    """Modulation vector of a cosine in phase a, sampled every `period` seconds."""
    angle = 2.0 * math.pi * f * period * np.arange(count)
    return amplitude * np.cos(angle), amplitude * np.sin(angle)


def harmonic(s, f, h=H):
    """Complex amplitude at `f` of a signal given by its means over steps that hold a whole number of periods."""
    t = h * (np.arange(len(s)) + 0.5)
    return 2.0 * np.mean(s * np.exp(-2j * math.pi * f * t)) / np.sinc(f * h)


# --- one step ------------------------------------------------------------------------------------------------------

phases = st.floats(0.0, 1.0, exclude_max=True)
duties = st.floats(-0.2, 1.2)


@settings(max_examples=400, deadline=None)
@given(start=phases, advance=st.floats(1e-3, 4.0), fraction=st.floats(0.0, 1.0), before=duties, after=duties)
def test_a_step_has_mean_lead_and_edges_of_the_triangle_cut_into_pieces(start, advance, fraction, before, after):
    before, after = min(max(before, 0.0), 1.0), min(max(after, 0.0), 1.0)
    stop, at = start + advance, start + fraction * advance
    end = stop - math.floor(stop)
    advance = end - start + math.floor(stop)  # as the modulator sees it
    first, edges = pieces(start, at, before)
    second, more = pieces(at, stop, after)
    s, lead, n = pulse(start, end, math.floor(stop), fraction, before, after)
    rounding = 1e-14 / advance
    assert s == pytest.approx((first + second) / advance, abs=rounding)
    assert lead == pytest.approx(first / advance - fraction * s, abs=rounding)
    for phase in (start, at, stop):  # which of two steps an edge at their common end belongs to is not looked at
        for duty in (before, after):
            assume(abs(triangle(phase) - duty) > 1e-12)
    jump = (before > triangle(at)) != (after > triangle(at))
    assert n == edges + more + jump


@settings(max_examples=200, deadline=None)
@given(start=phases, advance=st.floats(1e-3, 4.0), duty=st.floats(0.0, 1.0))
def test_a_step_without_a_new_reference_has_the_mean_of_its_duty_ratio(start, advance, duty):
    stop = start + advance
    end = stop - math.floor(stop)
    s, lead, _ = pulse(start, end, math.floor(stop), NEVER, duty, duty)
    assert s == pytest.approx(pieces(start, stop, duty)[0] / advance, abs=1e-14 / advance + 1e-12)
    assert lead == 0.0


def test_ten_and_more_edges_in_a_step_are_all_there():
    s, _, edges = pulse(0.0, 0.0, 7.0, NEVER, 0.3, 0.3)
    assert (s, edges) == (pytest.approx(0.3, abs=1e-15), 14.0)


def test_the_sampled_current_of_a_choke_is_the_chord_and_the_lead():
    """L di/dt = v_dc s - e with everything else still: the current at the instant, by the area under the pulses."""
    start, advance, fraction, v_dc, e, L = 0.1, 0.21, 0.6, 750.0, 460.0, 0.8e-3
    s, lead, _ = pulse(start, start + advance, 0.0, fraction, 0.62, 0.55)
    at = H * (v_dc * pieces(start, start + fraction * advance, 0.62)[0] / advance - fraction * e) / L
    chord = fraction * H * (v_dc * s - e) / L
    assert abs(at - chord) > 1.0  # A: what a sample of the chord would be off by
    assert chord + H / L * v_dc * lead == pytest.approx(at, abs=1e-10)


# --- mean over time ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("h", [0.37e-6, 1e-6, 7.3e-6, 30e-6, 90e-6, 300e-6])
def test_the_integral_of_s_does_not_depend_on_the_step(h):
    """Duty ratios change at every sampling instant; at instants common to all steps the integral is the same."""
    alpha, beta = vector(0.45, 400, 1.0 / (2.0 * F_CARRIER))
    steps = round(0.0999 / h)
    s, _, _ = Bench(h=h).run(steps, alpha, beta)
    found = h * F_CARRIER * np.sum(s[:, :3], axis=0)  # in carrier periods
    total = Fraction(*ratio(F_CARRIER, h)) * steps
    whole = int(2 * total)
    a, b = np.concatenate([[0.0], alpha]), np.concatenate([[0.0], beta])
    phases_abc = (a, -0.5 * a + math.sqrt(0.75) * b, -0.5 * a - math.sqrt(0.75) * b)
    middle = 0.5 - 0.5 * (np.max(phases_abc, axis=0) + np.min(phases_abc, axis=0))
    for leg, phase in enumerate(phases_abc):
        # at the k-th instant the reference of the one before comes into force: a[k], with the start's in front
        duty = (phase + middle)[: whole + 1]
        exact = 0.5 * math.fsum(duty[:whole])  # each half period of a triangle holds half its duty ratio
        exact += pieces(whole / 2, float(total), duty[whole])[0]
        assert found[leg] == pytest.approx(exact, abs=1e-12 * steps * h * F_CARRIER + 1e-12)


@pytest.mark.parametrize("duty", [0.0, 1e-3, 0.25, 0.62, 0.999, 1.0])
def test_a_carrier_period_holds_its_duty_ratio_whatever_the_step(duty):
    for inc, den in ((1, 1), (1, 7), (3, 20), (243, 5000), (997, 1000), (1, 10000)):
        clock, found = 0, []
        for _ in range(den):
            before, clock = clock, clock + inc
            turns, clock = divmod(clock, den)
            found.append(pulse(before / den, clock / den, float(turns), NEVER, duty, duty)[0] / den)
        assert math.fsum(found) == pytest.approx(duty, abs=1e-12)


@kernel
def many_steps(n, inc, den, duty):
    """Sum of s over `n` steps, compensated, and the number of edges."""
    clock, total, rest, edges = 0, 0.0, 0.0, 0.0
    for _ in range(n):
        before = clock
        clock += inc
        turns = 0.0
        if clock >= den:
            clock -= den
            turns = 1.0
        s, _, more = pulse(before / den, clock / den, turns, -1.0, duty, duty)
        term = s - rest
        following = total + term
        rest = (following - total) - term
        total = following
        edges += more
    return total, edges, clock


def test_ten_million_steps_do_not_drift():
    n, (inc, den) = 10_000_000, ratio(F_CARRIER)
    total, edges, clock = many_steps(n, inc, den, 0.37)
    turns, rest = divmod(n * inc, den)
    assert clock == rest
    exact = (turns * 0.37 + pieces(0.0, rest / den, 0.37)[0]) * den / inc
    assert total == pytest.approx(exact, abs=1e-7)  # 1e-14 of a step each, the rounding of s itself
    assert edges == 2 * turns + pieces(0.0, rest / den, 0.37)[1]


@settings(max_examples=40, deadline=None)
@given(
    duty=st.lists(st.floats(0.0, 1.0), min_size=12, max_size=12),
    sampling=st.floats(500.0, 30e3),
    carrier=st.floats(500.0, 30e3),
    shift=st.floats(0.0, 1.0),
)
def test_an_asynchronous_carrier_is_cut_at_the_instants_of_the_clock(duty, sampling, carrier, shift):
    """Legs for any ratio of carrier and clock: the integral up to any step's end by pieces between the instants."""
    bench = Bench(TimeStampedLeg(shift=shift), sampling=sampling, carrier=carrier)
    references = iter(duty)
    integral, phase, exact, force, reference = 0.0, 0.0, 0.0, 0.5, next(references)
    advance = bench.carrier[0] / bench.carrier[1]
    for _ in range(60):
        u = bench.u[0]
        u.phase, u.phase_next, turned = tick(bench.clock[0], *bench.carrier)
        u.turns = float(turned >= 0.0)
        fraction = tick(bench.clock[1], *bench.sampling)[2]
        u.s_ref = reference
        leg_modulate(H, fraction, bench.x[0], u, bench.p[0], bench.y[0])
        integral += bench.y[0].lo * advance
        if fraction >= 0.0:
            at = phase + fraction * advance
            exact += pieces(phase + shift, at + shift, force)[0]
            exact += pieces(at + shift, phase + advance + shift, reference)[0]
            force, reference = reference, next(references, reference)
        else:
            exact += pieces(phase + shift, phase + advance + shift, force)[0]
        phase += advance
        assert integral == pytest.approx(exact, abs=1e-12)


def test_means_over_a_sampling_period_are_those_of_the_averaged_modulator():
    """Sampled once or twice a period at the carrier's vertices: same delay, same hold, so the same mean exactly."""
    for per_period in (1, 2):
        h = 1.0 / (F_CARRIER * per_period) / 25  # a sampling period is 25 steps
        bench = Bench(h=h, sampling=per_period * F_CARRIER)
        bench.sampling, bench.carrier = (1, 25), (1, 25 * per_period)
        alpha, beta = vector(0.5, 60, 25 * h)
        s, _, _ = bench.run(25 * 50, alpha, beta)
        found = np.array(abc_to_alpha_beta.py_func(*s[:, :3].T)).reshape(2, 50, 25).mean(axis=2)
        averaged = AveragedBridge.__component__.kernels["modulate"].py_func
        x, u, y = (Bench._records(getattr(type_of(AveragedBridge), part)) for part in ("state", "input", "output"))
        expected = []
        for k in range(50):
            u[0].s_alpha_ref, u[0].s_beta_ref, u[0].gates = alpha[k], beta[k], 1.0
            averaged(-1.0, x[0], u[0], y[0])
            expected.append(abc_to_alpha_beta.py_func(y[0].lo_a, y[0].lo_b, y[0].lo_c))
            averaged(1.0, x[0], u[0], y[0])
        assert np.allclose(found.T, expected, atol=1e-13)


# --- spectra -------------------------------------------------------------------------------------------------------


def natural_leg(h, clock, n, m=0.8, f=60.0):
    """Leg a under a sinusoidal reference taken anew at every step, at its middle (natural sampling)."""
    inc, den = clock
    s, phase = np.zeros(n), 0
    for k in range(n):
        before, phase = phase, phase + inc
        turns, phase = divmod(phase, den)
        duty = 0.5 + 0.5 * m * math.cos(2.0 * math.pi * f * h * (k + 0.5))
        s[k] = pulse(before / den, phase / den, float(turns), NEVER, duty, duty)[0]
    return s


def test_the_fundamental_over_25_cycles_is_that_of_the_reference():
    """m = 0.8, 60 Hz, 1620 Hz, 30 us. 25 cycles are 13 888.9 steps: 1e-4 of the window is half the mean's leakage."""
    s = natural_leg(H, ratio(F_CARRIER), round(25 / 60.0 / H))
    found = abs(harmonic(s, 60.0))
    assert found == pytest.approx(0.4, rel=2e-5)
    assert found == pytest.approx(0.40005, abs=6e-5)  # the value computed once with its own rounding of the window


def test_single_cycles_spread_far_less_than_with_gates_sampled_at_the_step():
    s = natural_leg(H, ratio(F_CARRIER), round(25 / 60.0 / H))
    t = H * (np.arange(len(s)) + 0.5)
    sampled = np.array([0.5 + 0.4 * math.cos(2.0 * math.pi * 60.0 * at) > triangle(F_CARRIER * at) for at in t])
    spread = []
    for signal in (s, sampled.astype(float)):
        cycles = np.array_split(signal - 0.5, 25)
        times = np.array_split(t, 25)
        found = [2.0 * abs(np.mean(c * np.exp(-2j * math.pi * 60.0 * at))) for c, at in zip(cycles, times, strict=True)]
        spread.append(np.std(found) / 0.4)
    assert spread[0] < 0.0037
    assert spread[1] > 4.0 * spread[0]


FINE = 16667
"""Steps a cycle of 60 Hz, 1 us each: 27 carrier periods of 617.3 steps."""


@pytest.mark.parametrize(
    ("m", "n"), [(0, 1), (1, 0), (1, 2), (1, -2), (1, 4), (2, 1), (2, -1), (2, 3), (3, 0), (3, 2), (3, -2)]
)
def test_harmonics_are_those_of_the_double_fourier_series(m, n):
    """Naturally sampled: (2/pi m) J_n(m pi M/2) sin((m + n) pi/2) at m f_c + n f_1; the fundamental is M/2."""
    h, M = 1.0 / (60.0 * FINE), 0.8
    found = abs(harmonic(natural(), m * F_CARRIER + n * 60.0, h))
    expected = abs(2.0 / (math.pi * m) * jv(n, m * math.pi * M / 2) * math.sin((m + n) * math.pi / 2)) if m else M / 2
    # a reference held for a step is moved by up to h / 2 at an edge: 2 pi 60 Hz h / 2 of the amplitude
    assert found == pytest.approx(expected, abs=2e-4)
    assert expected > 1e-3


@cache
def natural():
    return natural_leg(1.0 / (60.0 * FINE), (27, FINE), FINE)


@pytest.mark.parametrize(("m", "n"), [(0, 1), (0, 3), (1, 0), (1, 2), (1, -2), (1, 4), (2, 1), (2, -1), (3, 2)])
@pytest.mark.parametrize("per_period", [1, 2])
def test_harmonics_of_regular_sampling_are_those_of_the_double_fourier_series(m, n, per_period):
    """With q = m + n f_1/f_c in place of m in the Bessel function; once a period the sine has another argument."""
    h, M = 1.0 / (60.0 * FINE), 0.8
    found = abs(harmonic(regular(per_period), m * F_CARRIER + n * 60.0, h))
    q = m + n / 27.0
    phase = m + n if per_period == 2 else q + n
    expected = abs(2.0 / (math.pi * q) * jv(n, q * math.pi * M / 2) * math.sin(phase * math.pi / 2))
    assert found == pytest.approx(expected, abs=2e-6)  # exact edges: what is left is folded from beyond 1 MHz


@pytest.mark.parametrize(
    ("injection", "per_period", "second", "fourth"), [(1.0, 1, 0.16, 0.45), (0.0, 1, 0.27, 0.0), (1.0, 2, 0.0, 0.0)]
)
def test_even_harmonics_come_from_one_update_a_carrier_and_the_fourth_from_injection(
    injection, per_period, second, fourth
):
    """Per cent of the fundamental at M = 0.8; twice a period the pulses' halves take both signs of an even harmonic."""
    h = 1.0 / (60.0 * FINE)
    one, two, four = (abs(harmonic(regular(per_period, injection), n * 60.0, h)) for n in (1, 2, 4))
    assert 100.0 * two / one == pytest.approx(second, abs=0.01)
    assert 100.0 * four / one == pytest.approx(fourth, abs=0.01)


@cache
def regular(per_period, injection=0.0):
    """Leg a over a cycle under a sine sampled once or twice a carrier period."""
    bench = Bench(TimeStampedBridge(injection=injection), h=1.0 / (60.0 * FINE))
    bench.carrier, bench.sampling = (27, FINE), (27 * per_period, FINE)
    alpha, beta = vector(0.4, 200, 1.0 / (F_CARRIER * per_period))
    return bench.run(2 * FINE, alpha, beta)[0][FINE:, 0]


# --- modulation vector ---------------------------------------------------------------------------------------------


def test_injection_leaves_the_vector_and_reaches_its_limit_at_one_over_root_three():
    for injection, limit in ((1.0, 1.0 / math.sqrt(3.0)), (0.0, 0.5)):
        for amplitude, expected in ((limit, 0.0), (1.001 * limit, 1.0)):
            bench = Bench(TimeStampedBridge(injection=injection))
            alpha, beta = vector(amplitude, 120, 1.0 / (120 * 60.0))  # the largest phase value among them
            bench.run(2, alpha, beta)
            seen = 0.0
            for _ in range(1300):
                bench.run(1, alpha, beta)
                seen = max(seen, bench.y[0].limited)
                alpha, beta = np.roll(alpha, -1), np.roll(beta, -1)
            assert seen == expected, (injection, amplitude)


def test_far_over_modulation_is_six_step():
    """Each leg is on for half a cycle: its fundamental is 2/pi of the bus."""
    bench = Bench(TimeStampedBridge(), h=1.0 / (60.0 * FINE))
    bench.carrier, bench.sampling = (27, FINE), (54, FINE)
    angle = 2.0 * math.pi * (np.arange(200) + 0.25) / 54.0  # no sample on a zero crossing
    bench.run(FINE, 50.0 * np.cos(angle), 50.0 * np.sin(angle))
    before = bench.x[0].edges
    s, _, _ = bench.run(FINE, 50.0 * np.cos(angle), 50.0 * np.sin(angle))  # 54 samples later: the same again
    assert abs(harmonic(s[:, 0], 60.0, bench.h)) == pytest.approx(2.0 / math.pi, rel=1e-6)
    assert bench.x[0].edges - before == 6.0
    assert bench.y[0].limited == 1.0
    assert np.all((s >= 0.0) & (s <= 1.0))


def test_a_reference_acts_one_sampling_period_after_it_was_computed_at_its_very_instant():
    bench = Bench(TimeStampedBridge(injection=0.0))
    s, _, at = bench.run(50, [0.0, 0.4], [0.0, 0.0])
    instants = np.flatnonzero(at >= 0.0)
    first, second = instants[0], instants[1]
    assert (first + at[first]) * H == pytest.approx(1.0 / 3240.0, rel=1e-12)
    plain, _, _ = Bench(TimeStampedBridge(injection=0.0)).run(50, [0.0], [0.0])
    assert np.array_equal(s[:second], plain[:second])
    changed = Bench(TimeStampedBridge(injection=0.0), alpha=0.4)
    after, _, _ = changed.run(50, [0.4], [0.0])
    assert np.allclose(s[second + 1 :], after[second + 1 :], atol=1e-14)
    assert not np.allclose(s[second + 1 :], plain[second + 1 :], atol=0.05)


def test_legs_with_shifted_carriers_have_their_pulses_one_after_the_other():
    bench = Bench(TimeStampedBridge(injection=0.0, shift_b=1.0 / 3.0, shift_c=2.0 / 3.0), h=1.0 / (F_CARRIER * 999))
    bench.carrier, bench.sampling = (1, 999), (1, 999)
    s, _, _ = bench.run(2 * 999)
    a, b, c = s[999:, :3].T
    assert np.allclose(np.roll(b, 333), a, atol=1e-9)
    assert np.allclose(np.roll(c, 666), a, atol=1e-9)
    assert not np.allclose(a, b, atol=0.1)


# --- gates, dead time, least pulse ---------------------------------------------------------------------------------


def test_blocked_gates_leave_everything_open_and_are_obeyed_at_once():
    bench = Bench(TimeStampedBridge(dead_time=3e-6))
    bench.u[0].gates = 0.0
    s, lead, _ = bench.run(40, [0.3], [0.1])
    assert np.all(s[:, :3] == 0.0) and np.all(s[:, 3:] == 1.0) and np.all(lead == 0.0)
    assert bench.x[0].edges == 0.0
    bench.u[0].gates = 1.0
    s, _, _ = bench.run(1, [0.3], [0.1])
    assert np.all(s[:, 3:] - s[:, :3] <= 0.1 + 1e-12)


@pytest.mark.parametrize(("gates", "wait", "driven"), [(2.0, 2.0 / 3.0 - 0.1, 0.0), (3.0, 0.0, 2.0 / 3.0 - 0.1)])
def test_one_driven_switch_gives_the_integral_of_its_driven_part_up_to_the_sample(gates, wait, driven):
    """A duty of 0.97 and 6.667 steps a period: the lower switch's pulse, 0.2 steps long, around the sample at 2/3."""
    bench = Bench(TimeStampedLeg(), carrier=5e3, sampling=5e3, active=0.97)
    u, y = bench.u[0], bench.y[0]
    u.gates, u.s_ref = gates, 0.97
    u.phase, u.phase_next, u.turns = 0.9, 0.05, 1.0
    leg_modulate(H, 2.0 / 3.0, bench.x[0], u, bench.p[0], y)
    assert (y.wait, y.lead, y.sampled) == pytest.approx((wait, driven, 2.0 / 3.0), abs=1e-12)


@pytest.mark.parametrize(("gates", "lo", "hi"), [(1.0, None, None), (2.0, 0.0, None), (3.0, None, 1.0)])
def test_a_leg_with_one_switch_driven_leaves_the_rest_to_the_diodes(gates, lo, hi):
    bench = Bench(TimeStampedLeg(), carrier=5e3, sampling=5e3, active=0.62)
    u, y = bench.u[0], bench.y[0]
    u.gates, u.s_ref, mean, low, high = gates, 0.62, 0.0, 0.0, 0.0
    for _ in range(200):  # 30 carrier periods of 6.667 steps
        u.phase, u.phase_next, turned = tick(bench.clock[0], *bench.carrier)
        u.turns = float(turned >= 0.0)
        fraction = tick(bench.clock[1], *bench.sampling)[2]
        leg_modulate(H, fraction, bench.x[0], u, bench.p[0], y)
        expected, lead, _ = pulse(u.phase, u.phase_next, u.turns, fraction, 0.62, 0.62)
        assert y.lo == (expected if lo is None else lo)
        assert y.hi == (expected if hi is None else hi)
        assert y.sampled == (max(fraction, 0.0) if gates != 1.0 else 0.0)
        assert y.lead == lead or gates != 1.0
        mean, low, high = mean + expected / 200, low + y.lo / 200, high + y.hi / 200
    assert mean == pytest.approx(0.62, abs=1e-12)
    assert bench.x[0].edges == 60.0


@pytest.mark.parametrize("duty", [0.1, 0.5, 0.9])
def test_dead_time_takes_itself_from_the_pulse_of_either_switch(duty):
    """A pulse of m periods leaves the upper switch m - d, and the lower one 1 - m - d: lo and hi of a period."""
    dead, (inc, den) = 3e-6, ratio(F_CARRIER)
    on, stood, lo, hi, phase, edges = 0.0, 1.0, 0.0, 0.0, 0, 0.0
    for _ in range(den):
        before, phase = phase / den, (phase + inc) % den
        step = drive(before, inc / den, NEVER, duty, duty, dead / H, 0.0, on, stood)
        lo, hi, on, stood, edges = lo + step[0], hi + step[1], step[5], step[6], edges + step[3]
    periods = H * F_CARRIER * den
    assert edges == 2 * round(periods)
    assert lo * inc / den / periods == pytest.approx(duty - dead * F_CARRIER, abs=1e-9)
    assert hi * inc / den / periods == pytest.approx(duty + dead * F_CARRIER, abs=1e-9)


def clockwork(start, advance, references, dead, shortest, ticks=3000):
    """Gates of a leg by fine ticks: (lo, hi) of each step, edges, edges postponed, narrowest pulse."""
    on, stood, waiting, edges, postponed, pulses, found, phase = False, 0.0, False, 0, 0, [], [], start
    for fraction, before, after in references:
        lo = hi = 0
        for k in range(ticks):
            tau = (k + 0.5) / ticks
            duty = after if 0.0 <= fraction <= tau else before
            command = duty > triangle(phase + tau * advance)
            released = command == on or stood >= shortest
            postponed += waiting and released
            waiting = not released
            if command != on and released:
                pulses.append(stood)
                on, stood, edges = command, 0.0, edges + 1
            driven = stood >= dead
            lo += on and driven
            hi += on or not driven
            stood += 1.0 / ticks
        phase += advance
        found.append((lo / ticks, hi / ticks))
    return np.array(found), edges, postponed, min(pulses[1:])


@pytest.mark.parametrize("carrier", [1620.0, 5e3, 14e3])
@pytest.mark.parametrize(("dead", "shortest"), [(3e-6, 0.0), (0.0, 9e-6), (4e-6, 11e-6), (8e-6, 3e-6)])
def test_gates_with_memory_are_those_of_a_clockwork_of_fine_ticks(carrier, dead, shortest):
    rng = np.random.default_rng(int(carrier + 1e7 * dead + 1e8 * shortest))
    advance, ticks, n = carrier * H, 3000, 40
    duties = np.clip(rng.uniform(-0.2, 1.2, n + 1), 0.0, 1.0)
    references, force = [], 0.5
    for k in range(n):
        fraction = float(rng.uniform(0.05, 0.95)) if k % 3 == 0 else NEVER
        after = duties[k] if fraction >= 0.0 else force
        references.append((fraction, force, after))
        force = after
    expected, edges, late, narrowest = clockwork(0.2, advance, references, dead / H, shortest / H, ticks)
    on, stood, phase, count, postponed = 0.0, 0.0, 0.2, 0.0, 0.0
    for (fraction, before, after), (lo, hi) in zip(references, expected, strict=True):
        step = drive(phase, advance, fraction, before, after, dead / H, shortest / H, on, stood)
        on, stood, count, postponed = step[5], step[6], count + step[3], postponed + step[4]
        phase += advance
        assert step[0] == pytest.approx(lo, abs=12.0 / ticks)  # two or three ticks an edge
        assert step[1] == pytest.approx(hi, abs=12.0 / ticks)
    assert count == edges
    assert narrowest >= shortest / H - 2.0 / ticks
    assert postponed == late
    assert postponed > 0 or carrier * shortest < 0.05  # the cases are there


@settings(max_examples=200, deadline=None)
@given(
    start=phases,
    advance=st.floats(1e-3, 3.0),
    fraction=st.floats(0.0, 1.0),
    before=st.floats(0.0, 1.0),
    after=st.floats(0.0, 1.0),
)
def test_walking_edge_by_edge_without_dead_time_is_the_closed_form(start, advance, fraction, before, after):
    stop = start + advance
    assume(all(duty in (0.0, 1.0) or 1e-9 < duty < 1.0 - 1e-9 for duty in (before, after)))
    for phase in (start, start + fraction * advance):
        assume(all(abs(triangle(phase) - duty) > 1e-9 for duty in (before, after)))
    s, lead, edges = pulse(start, stop - math.floor(stop), math.floor(stop), fraction, before, after)
    on = float(before > triangle(start))
    step = drive(start, advance, fraction, before, after, 0.0, 0.0, on, 0.0)
    assert step[:3] == pytest.approx((s, s, lead), abs=1e-10 + 1e-14 / advance)
    assume(abs(triangle(stop) - after) > 1e-9)
    assert step[3:6] == (edges, 0.0, float(after > triangle(stop)))


def test_an_edge_at_the_very_end_of_a_step_is_carried_out_once():
    """Edges at 1/4 and 3/4 of a period of 20 steps: each at a step's end."""
    on, stood, edges = 0.0, 1.0, 0.0
    for k in range(2000):
        step = drive((k % 20) / 20, 1.0 / 20, NEVER, 0.5, 0.5, 0.1, 0.05, on, stood)
        on, stood, edges = step[5], step[6], edges + step[3]
        assert step[4] == 0.0
    assert edges == 200.0


# --- in a network --------------------------------------------------------------------------------------------------


def test_in_a_network_the_bridge_switches_as_on_the_bench():
    """Carrier, clock and kernel arguments as its unit hands them."""
    net = Network("bench")
    bus = net.dc_bus("dc", 750.0)
    net.capacitance(bus, 1e-3)
    net.conductance(bus, 1e-3)
    net.add("carrier", Carrier(), clock=Sampled(F_CARRIER))
    net.add("reference", Hold(), inputs={"wanted": 0.31})
    fields = ("phase", "phase_next", "turns")
    net.add(
        "bridge",
        TimeStampedBridge(dead_time=2e-6, shift_b=0.25),
        inputs={f: f"carrier.{f}" for f in fields} | {"s_alpha_ref": "reference.value", "s_beta_ref": 0.2},
        clock=Sampled(2.0 * F_CARRIER),
    )
    plan = assemble(net, H)
    work = new_workspace(plan)
    entry = core()
    names = [f"{end}_{leg}" for end in ("lo", "hi") for leg in "abc"] + [f"lead_{leg}" for leg in "abc"]
    places = [plan.layout.index[f"bridge.{name}"] for name in names]
    bench = Bench(TimeStampedBridge(dead_time=2e-6, shift_b=0.25))
    for k in range(300):
        assert entry(1, k, *arguments(plan, work)) == 1
        s, lead, _ = bench.run(1, [0.31], [0.2])
        assert np.array_equal(work.sig[places], np.concatenate([s[0], lead[0]])), k
    assert bench.x[0].edges == pytest.approx(300 * H * F_CARRIER * 6, abs=6)


@pytest.mark.parametrize("position", [0.0, 1.0])
def test_the_wait_for_a_switch_is_the_first_time_the_command_is_its(position):
    """Against the triangle, looked at in fine ticks; the sampling instant anywhere in the step or nowhere."""
    rng = np.random.default_rng(7)
    ticks = (np.arange(20000) + 0.5) / 20000
    waits = []
    for _ in range(200):
        phase, advance, before, after = rng.uniform([0.0, 0.05, -0.1, -0.1], [1.0, 1.6, 1.1, 1.1])
        before, after = np.clip([before, after], 0.0, 1.0)
        fraction = rng.uniform() if rng.uniform() < 0.5 else -1.0
        at = phase + ticks * advance
        duty = np.where((fraction >= 0.0) & (ticks >= fraction), after, before)
        command = np.abs(1.0 - 2.0 * (at - np.floor(at))) < duty
        other = np.flatnonzero(command != (position > 0.5))
        expected = ticks[other[0]] if len(other) else 1.0
        waits.append(undriven(phase, advance, fraction, before, after, position))
        assert waits[-1] == pytest.approx(expected, abs=1e-4)
    assert min(waits) == 0.0 and max(waits) == 1.0 and np.any((np.array(waits) > 0.1) & (np.array(waits) < 0.9))
