"""Tie breakers: when they close, when they refuse, that they open."""

import math

import pytest

from shipgrid.equipment import breakers
from shipgrid.equipment.breakers import AcBreakerControl, DcBreakerControl
from shipgrid.model.records import make_record, parameter_record

DT = 10e-3
V = math.sqrt(2.0 / 3.0) * 400.0


class DcTie:
    def __init__(self):
        self.p, _ = parameter_record(DcBreakerControl())
        self.x = make_record(breakers.DcState)

    def see(self, close, v_from, v_to):
        x_next, y = self.x.copy(), make_record(breakers.SequenceOutput)
        u = make_record(breakers.DcInput, {"close": close, "v_from": v_from, "v_to": v_to})
        breakers.dc_update(0.0, DT, self.x, u, self.p, x_next, y)
        self.x = x_next
        return y


class AcTie:
    def __init__(self):
        self.p, _ = parameter_record(AcBreakerControl())
        self.x = make_record(breakers.AcState)
        self.t = 0.0

    def see(self, close, v_from=1.0, v_to=1.0, f_from=60.0, f_to=60.0, angle=0.0):
        a, b = 2.0 * math.pi * f_from * self.t, 2.0 * math.pi * f_to * self.t + angle
        values = [V * v_from * math.cos(a), V * v_from * math.sin(a), V * v_to * math.cos(b), V * v_to * math.sin(b)]
        names = ("from_alpha", "from_beta", "to_alpha", "to_beta")
        u = make_record(breakers.AcInput, {"close": close, **dict(zip(names, values, strict=True))})
        x_next, y = self.x.copy(), make_record(breakers.SequenceOutput)
        breakers.ac_update(self.t, DT, self.x, u, self.p, x_next, y)
        self.x = x_next
        self.t += DT
        return y


def test_dc_tie_closes_below_10_v_and_says_why_above():
    tie = DcTie()
    y = tie.see(1.0, 750.0, 739.9)
    assert (y.closed, y.position, y.refused) == (0.0, 1.0, 1.0)
    y = tie.see(1.0, 750.0, 740.1)
    assert (y.closed, y.position, y.refused) == (1.0, 0.0, 0.0)


def test_dc_tie_stays_closed_under_a_voltage_drop_and_opens_on_command():
    tie = DcTie()
    tie.see(1.0, 750.0, 750.0)
    assert tie.see(1.0, 750.0, 730.0).closed == 1.0
    y = tie.see(0.0, 750.0, 730.0)
    assert (y.closed, y.position, y.refused) == (0.0, 1.0, 0.0)


@pytest.mark.parametrize("v", [(1.0, 0.0), (0.04, 1.0), (0.0, 0.0)])
def test_ac_tie_closes_on_a_dead_bar_at_once(v):
    assert AcTie().see(1.0, *v).closed == 1.0


def test_ac_tie_closes_after_a_fifth_of_a_second_in_step():
    tie = AcTie()
    closed = [tie.see(1.0).closed for _ in range(25)]
    assert closed[18] == 0.0
    assert closed[22] == 1.0


@pytest.mark.parametrize(
    "apart",
    [{"angle": math.radians(2.5)}, {"f_to": 60.06}, {"v_to": 0.985}, {"angle": math.pi}],
    ids=["angle", "frequency", "voltage", "opposite"],
)
def test_ac_tie_refuses_bars_that_are_not_in_step(apart):
    tie = AcTie()
    tie.t = -1.0  # a slip of 0.06 Hz passes through zero angle at 0 s
    readings = [tie.see(1.0, **apart) for _ in range(200)]
    assert all(y.closed == 0.0 and y.refused == 1.0 for y in readings)
