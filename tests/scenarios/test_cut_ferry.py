"""The ferry cut into parts beside the ferry whole: what the cut changes is what its lines have too much."""

from __future__ import annotations

import math

import pytest
from typer.testing import CliRunner

import shipgrid as sg
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import code_names
from shipgrid.cli.main import app
from shipgrid.scenarios.against_uncut import against_uncut
from shipgrid.scenarios.case import build
from shipgrid.scenarios.parts import partition_of

UNTIL = 0.1


@pytest.fixture(scope="module")
def deviations():
    """Of the moored ferry with its own cut, by step and signal."""
    ship, scenario = sg.load_ship(), sg.load_scenario("mission")
    return {h: {d.signal: d for d in against_uncut(ship, scenario, ship.parts, UNTIL, step=h)} for h in (30e-6, 15e-6)}


def test_reactive_power_differs_by_that_of_the_surplus_capacitance(deviations):
    ship = sg.load_ship()
    for h, found in deviations.items():
        (C,) = (line.C for line in partition_of(ship, ship.parts, h).lines if line.path == "inverter_for.filter")
        expected = 2.0 * math.pi * 59.8 * C * (0.9875 * 400.0) ** 2  # frequency and voltage under the inverter's droop
        assert found["inverter_for.q_ac"].rms == pytest.approx(expected, rel=0.1)  # its ripple is in the rms, too


def test_what_differs_falls_with_the_square_of_the_step(deviations):
    coarse, fine = deviations.values()
    for signal in ("inverter_for.q_ac", "ac_for.v_rms_pu", "dc_for.v_dc", "bess_for.i_b"):
        assert coarse[signal].rms / fine[signal].rms == pytest.approx(4.0, rel=0.2), signal


def test_the_cut_hardly_shows_on_the_buses(deviations):
    found = deviations[30e-6]
    assert found["dc_for.v_dc"].relative < 1e-5 and found["ac_for.v_rms_pu"].largest < 5e-4
    assert found["dc_for.v_dc"].size == pytest.approx(744.0, abs=1.0)


def test_at_switching_fidelity_the_cut_moves_edges_and_hardly_shows_on_the_buses():
    ship, scenario = sg.load_ship(), sg.load_scenario("mission")
    found = {d.signal: d for d in against_uncut(ship, scenario, ship.parts, 0.05, fidelity="switching")}
    # a modulation that differs in the fifth digit moves edges: powers, means of a step, differ by part of their ripple
    assert found["inverter_for.p_dc"].rms < 100.0 and found["inverter_for.q_ac"].rms < 150.0
    assert found["dc_for.v_dc"].relative < 2e-5 and found["ac_for.v_rms_pu"].largest < 5e-4


def test_the_ferry_in_parts_runs_what_was_compiled_for_the_whole():
    whole = build(sg.load_ship(), 30e-6)
    cut = assemble(whole.network, 30e-6, parts=sg.load_ship().parts)
    assert code_names(cut.kinds) == code_names(whole.kinds)


def test_the_error_of_a_cut_is_printed():
    said = CliRunner().invoke(app, ["parts", "--step", "30us", "--until", "0.05 s", "--parts", "2"])
    assert said.exit_code == 0, said.output
    rows = {line.split()[0]: line.split() for line in said.stdout.partition("Cut minus whole, 0.05 s")[2].splitlines()}
    assert {"dc_for.v_dc", "dc_aft.v_dc", "ac_for.v_pu", "ac_aft.v_pu", "inverter_for.q_ac"} <= set(rows)
    assert rows["dc_for.v_dc"][1] == "V" and 0.0 < float(rows["dc_for.v_dc"][-1]) < 1e-5
    assert len(rows) == 4 + 10 + 2  # buses, the worst, title and heads
