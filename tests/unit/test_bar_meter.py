"""Voltage and frequency of an AC bar."""

import math

import pytest

from shipgrid.components.electrical import bar_meter
from shipgrid.components.electrical.bar_meter import BarMeter
from shipgrid.model.records import make_record, parameter_record

DT = 1e-3


def read(voltages, symbols=("v_pu", "f")):
    """Readings for a sequence of (v_alpha, v_beta)."""
    p, _ = parameter_record(BarMeter())
    x, readings = make_record(bar_meter.State), []
    for k, (a, b) in enumerate(voltages):
        x_next, y = x.copy(), make_record(bar_meter.Output)
        u = make_record(bar_meter.Input, {"v_alpha": a, "v_beta": b})
        bar_meter.update(k * DT, DT, x, u, p, x_next, y)
        x = x_next
        readings.append(tuple(y[symbol] for symbol in symbols))
    return readings


def turning(f, v_pu, seconds):
    v = v_pu * math.sqrt(2.0 / 3.0) * 400.0
    angles = [2.0 * math.pi * f * k * DT + 0.3 for k in range(round(seconds / DT))]
    return [(v * math.cos(a), v * math.sin(a)) for a in angles]


@pytest.mark.parametrize("f", [58.8, 60.0, 61.0])
def test_steady_voltage_reads_its_length_and_frequency(f):
    v_pu, found = read(turning(f, 0.95, 0.3))[-1]
    assert v_pu == pytest.approx(0.95, rel=1e-12)
    assert found == pytest.approx(f, abs=1e-6)  # the low-pass has had 19 time constants


def test_dead_bar_reads_no_frequency():
    readings = read([(0.0, 0.0)] * 5)
    assert all(r == (0.0, 0.0) for r in readings)


def test_bar_coming_to_life_does_not_read_a_wild_frequency():
    readings = read([(0.0, 0.0)] * 5 + turning(59.8, 1.0, 0.2))
    assert all(59.7 < f < 60.1 for _, f in readings[5:])
    assert readings[-1][1] == pytest.approx(59.8, abs=1e-3)


def test_frequency_step_is_followed_as_by_two_low_passes():
    v = turning(60.0, 1.0, 0.2)
    angle = 2.0 * math.pi * 60.0 * (len(v) - 1) * DT + 0.3
    amplitude = math.hypot(*v[0])
    for k in range(1, 200):
        a = angle + 2.0 * math.pi * 59.5 * k * DT
        v.append((amplitude * math.cos(a), amplitude * math.sin(a)))
    readings = read(v)
    n = 16
    k = 1.0 - math.exp(-DT * 2.0 * math.pi * 20.0)  # each low-pass, sampled: a pole at 1 - k
    rest = (1.0 - k) ** n * (1.0 + k * n)  # step response of two equal ones in a row
    assert readings[200 - 1 + n][1] == pytest.approx(60.0 - 0.5 * (1.0 - rest), abs=1e-6)


def test_rms_reading_overlooks_a_millisecond_and_follows_a_step_within_two_cycles():
    ups, dip = turning(60.0, 1.0, 0.2), (0.7 * v for v in turning(60.0, 1.0, 1e-3)[0])
    steady = read(ups, ["v_rms_pu"])[-1][0]
    assert steady == pytest.approx(1.0, abs=1e-9)
    (short,) = read([*ups, tuple(dip)], ["v_rms_pu"])[-1]
    assert short == pytest.approx(1.0 - 0.3 * (1.0 - math.exp(-DT * 120.0)), abs=1e-6)  # 0.034 of it, by (3)
    after = [v for (v,) in read([*ups, *turning(60.0, 0.8, 0.05)], ["v_rms_pu"])][len(ups) :]
    assert after[round(2.0 / 60.0 / DT)] == pytest.approx(0.8 + 0.2 * math.exp(-4.0), abs=1e-3)
