"""DC tie breakers: when they close, when they refuse, that they open."""

from shipgrid.equipment import breakers
from shipgrid.equipment.breakers import DcBreakerControl
from shipgrid.model.records import make_record, parameter_record

DT = 10e-3


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
