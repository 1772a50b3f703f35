"""Control of an AC tie on two bars as simple as can be: when it closes, refuses, moves the bars, and unloads."""

import math

import numpy as np
import pytest

from shipgrid.automation import ac_tie
from shipgrid.automation.ac_tie import AcTie
from shipgrid.model.records import make_record, parameter_record

DT = 1e-3
V = math.sqrt(2.0 / 3.0) * 400.0
I_N = 2.0 / 3.0 * 50e3 / V
OPEN, CLOSED, SYNCHRONISING, UNLOADING = range(4)


class Bars:
    """Two voltage vectors; the moved one follows the trims, and once tied power follows theirs by halves."""

    def __init__(self, *, f=(60.0, 60.0), v=(1.0, 1.0), angle=0.0, p=0.0, q=0.0, fed=True, **parameters):
        self.p, _ = parameter_record(AcTie(**parameters))
        self.x = make_record(ac_tie.State)
        self.u = make_record(ac_tie.Input)
        self.y = make_record(ac_tie.Output)
        self.f, self.v, self.turn, self.power, self.fed = f, v, [0.0, -angle], (p, q), fed
        self.t, self.trims, self.apart = 0.0, [], 0.0

    def see(self, close):
        y, moved = self.y, 1 if self.p.sign > 0.0 else 0
        f, v = list(self.f), list(self.v)
        f[moved] += 60.0 * y.dw_sync
        v[moved] += y.dV_sync
        for k in range(2):
            self.turn[k] += 2.0 * math.pi * f[k] * DT
        a, b = (v[k] * V * np.exp(1j * self.turn[k]) for k in range(2))
        p = self.power[0] - (0.5 * self.p.sign * y.dp_sync if self.fed else 0.0)
        q = self.power[1] - (4.0 * self.p.sign * y.dV_sync if self.fed else 0.0)
        current = np.conj((p + 1j * q) * I_N * V / b) if y.closed and abs(b) > 0.0 else 0.0
        u = self.u
        u.close = close
        u.from_alpha, u.from_beta, u.to_alpha, u.to_beta = a.real, a.imag, b.real, b.imag
        u.i_alpha, u.i_beta = np.real(current), np.imag(current)
        x_next = self.x.copy()
        ac_tie.update(self.t, DT, self.x, u, self.p, x_next, self.y)
        self.x = x_next
        self.t += DT
        self.trims.append(abs(self.y.dw_sync))
        self.apart = np.angle(a * np.conj(b))
        return self.y

    def run(self, seconds, close=True):
        for _ in range(round(seconds / DT)):
            self.see(close)
        return self

    def until(self, code, seconds=25.0, close=True):
        """Time from now on until the control is in that state."""
        for k in range(round(seconds / DT)):
            if self.see(close).code == code:
                return k * DT
        raise AssertionError(f"state {code} not reached but {self.y.code}")


@pytest.mark.parametrize("v", [(1.0, 0.0), (0.04, 1.0), (0.0, 0.0)])
def test_closes_on_a_bar_that_has_been_dead_for_a_tenth_of_a_second(v):
    bars = Bars(v=v)
    assert bars.until(CLOSED) == pytest.approx(0.1, abs=2e-3)
    assert bars.y.dw_sync == bars.y.dV_sync == 0.0


def test_a_bar_on_its_ramp_is_not_taken_for_dead():
    bars = Bars(v=(1.0, 0.0))
    for k in range(150):  # a black start: V* rises by 1/1.5 pu/s
        bars.v = (1.0, k * DT / 1.5)
        assert bars.see(True).closed == 0.0


def test_closes_after_a_fifth_of_a_second_in_step():
    assert Bars().until(CLOSED) == pytest.approx(0.2, abs=0.02)  # the low-pass of the slip


# 0.48 Hz: a load difference of 0.40 pu at 2 % droop. Against it the trim of 0.6 Hz turns half a turn in 4.2 s at worst;
# then the lag of 0.13 s (1/7.5) and the time in step.
@pytest.mark.parametrize("slip", [-0.48, 0.0, 0.48])
@pytest.mark.parametrize("angle", [-3.0, 0.5, 3.0])
def test_brings_the_bars_into_step_from_any_angle_and_closes(slip, angle):
    bars = Bars(f=(60.0 + slip, 60.0), angle=angle)
    assert bars.until(CLOSED) < 5.0
    assert abs(bars.apart) < math.radians(2.0)
    assert max(bars.trims) <= 0.01 + 1e-12


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_either_bar_can_be_the_one_that_moves(sign):
    bars = Bars(f=(60.3, 60.0), v=(1.0, 0.98), angle=2.0, sign=sign)
    bars.until(CLOSED)
    assert bars.y.dw_sync == pytest.approx(sign * 0.3 / 60.0, rel=0.05)
    assert 0.01 < sign * bars.y.dV_sync < 0.02


def test_trims_are_taken_back_in_five_seconds_after_closing():
    bars = Bars(f=(60.3, 60.0), v=(1.0, 0.98))
    bars.until(CLOSED)
    dw, dV = bars.y.dw_sync, bars.y.dV_sync
    bars.run(2.5)
    assert bars.y.dw_sync == pytest.approx(0.5 * dw, rel=2e-3)
    assert bars.y.dV_sync == pytest.approx(0.5 * dV, rel=2e-3)
    bars.run(2.51)
    assert bars.y.dw_sync == bars.y.dV_sync == 0.0


def test_beyond_the_reach_of_the_trim_it_gives_up_and_says_so_and_the_trims_go():
    bars = Bars(f=(60.7, 60.0))
    bars.run(19.9)
    assert (bars.y.code, bars.y.refused) == (SYNCHRONISING, 0.0)
    bars.run(0.2)
    assert (bars.y.code, bars.y.refused) == (OPEN, 1.0)
    bars.run(5.1)
    assert bars.y.dw_sync == 0.0
    bars.f, bars.turn[1] = (60.0, 60.0), bars.turn[0]  # in step by themselves: the standing command is obeyed
    bars.until(CLOSED)
    assert bars.y.refused == 0.0


def test_refusal_ends_with_the_command():
    bars = Bars(f=(60.7, 60.0)).run(20.1)
    assert bars.y.refused == 1.0
    assert bars.see(False).refused == 0.0
    assert bars.see(True).code == SYNCHRONISING


@pytest.mark.parametrize("apart", [{"f": (60.7, 60.0)}, {"v": (1.0, 0.9)}], ids=["frequency", "voltage"])
def test_bars_that_cannot_agree_are_never_tied(apart):
    bars = Bars(**apart)
    for _ in range(round(30.0 / DT)):
        assert bars.see(True).closed == 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_opens_after_its_power_has_been_moved_away(sign):
    bars = Bars(p=0.2, q=0.08, sign=sign)
    bars.until(CLOSED)
    assert bars.see(False).closed == 1.0
    assert 0.5 < bars.until(OPEN, close=False) < 5.0  # 0.4 pu of set point at 0.25 pu/s
    assert bars.y.dp_sync == pytest.approx(sign * 2.0 * (0.2 - 0.03), abs=0.07)  # down to what may be interrupted
    bars.run(5.1, close=False)
    assert bars.y.dp_sync == bars.y.dV_sync == 0.0


def test_opens_soon_where_nothing_can_be_moved_and_leaves_no_trim():
    bars = Bars(p=0.2, q=0.1, fed=False)
    bars.until(CLOSED)
    assert bars.until(OPEN, close=False) == pytest.approx(0.5, abs=0.01)
    assert bars.y.dp_sync == bars.y.dV_sync == 0.0


def test_an_unloaded_tie_opens_at_once():
    bars = Bars(p=0.01, q=0.02)
    bars.until(CLOSED)
    assert bars.until(OPEN, close=False) <= 3 * DT


def test_close_again_while_unloading_gives_the_power_back():
    bars = Bars(p=0.4)
    bars.until(CLOSED)
    bars.run(0.4, close=False)
    assert bars.y.code == UNLOADING
    assert bars.see(True).code == CLOSED
    bars.run(5.1)
    assert bars.y.dp_sync == 0.0
