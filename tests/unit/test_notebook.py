"""What notebooks show: one short line for every object, tables and a drawing where there is more to see."""

from __future__ import annotations

import pytest

import shipgrid as sg
from shipgrid.html_table import MOST_ROWS, table
from shipgrid.scenarios.notebook import ledgers


@pytest.fixture(scope="module")
def run():
    net = sg.Network("bench <b>")
    dc = net.dc_bus("dc", v_n=100.0)
    net.capacitance(dc, 1e-3)
    net.add("source", sg.DcSource(v_0=100.0, R=1.0), a=dc)
    net.add("load", sg.Resistor(R=10.0), a=dc, contact="open")
    return sg.assemble(net, step=100e-6).run({"dc.v_dc": 100.0}, events=[sg.At(0.01, sg.Close("load"))], until=0.02)


def test_a_ship_is_its_one_line_diagram():
    shown = sg.load_ship("ferry")._repr_html_()
    assert shown.count("<svg") == 1 and "propulsion_for" in shown
    assert "--ink: currentColor" in shown  # on a dark page too


def test_a_run_is_what_happened_and_where_the_energy_went(run):
    shown = run._repr_html_()
    assert "closed" in shown and "load.close" in shown and "sources" in shown
    assert "bench &lt;b&gt;" in shown and "<b>" not in shown
    assert run._ipython_key_completions_() == run.signals


def test_a_long_table_says_how_much_it_leaves_out():
    shown = table("many", ("n",), [[k] for k in range(MOST_ROWS + 3)])
    assert "and 3 more" in shown and shown.count("<tr>") == MOST_ROWS + 2
    assert ledgers("none", {"losses": {"a": 0.0}}).count("<td>") == 0


def test_public_objects_are_one_short_line(run):
    ship = sg.load_ship("ferry")
    for thing in (ship, sg.load_scenario("mission"), sg.Case(), run):
        shown = repr(thing)
        assert len(shown) < 120 and "\n" not in shown and shown.startswith("<")


@pytest.fixture(scope="module")
def point():
    return sg.steady_state(sg.load_ship("ferry"), {"bess_for.mode": 2.0})


def test_an_operating_point_of_a_ship_is_a_table(point):
    assert point["bess_for.mode"] == 2.0 and point["bess_aft.mode"] == 1.0
    assert point["dc_for.v_dc"] == pytest.approx(750.0, abs=0.1)  # one battery forms it
    shown = point._repr_html_()
    assert "bess_for.i_b" in shown and "and" in shown
    assert "dc_for.v_dc" in point._ipython_key_completions_()


def test_objects_of_analyses_are_one_short_line(point):
    model = sg.linearise(point.plan, point)
    things = (point, point.plan, point.workspace(), point.plan.network, model, model.modes())
    for thing in things:
        assert len(repr(thing)) < 160 and "\n" not in repr(thing) and repr(thing).startswith("<")
