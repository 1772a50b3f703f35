"""A supercapacitor against closed forms: redistribution between its branches, and its answer to a constant current."""

from __future__ import annotations

import numpy as np
import pytest

import shipgrid as sg

BANK = {"C_1": 63.0, "R_1": 0.018, "C_2": 6.0, "R_2": 15.0, "R_leak": 1e9}


def bench(step, **more):
    net = sg.Network("bench")
    dc = net.dc_bus("dc", v_n=100.0)
    net.add("bank", sg.Supercapacitor(**BANK | more), a=dc)
    return net, dc, step


def test_after_a_fast_charge_the_branches_share_it():
    """Two capacitances over two resistances: one time constant, and the voltage of the shared charge at its end."""
    net, _, step = bench(1e-3)
    run = sg.assemble(net, step).run({"bank.v_1": 100.0}, until=200.0, every=1000)
    t = run["bank.v_1"].time.values
    tau = (BANK["R_1"] + BANK["R_2"]) * BANK["C_1"] * BANK["C_2"] / (BANK["C_1"] + BANK["C_2"])
    end = 100.0 * BANK["C_1"] / (BANK["C_1"] + BANK["C_2"])
    gap, both = 100.0 * np.exp(-t / tau), BANK["C_1"] + BANK["C_2"]
    v_1, v_2 = end + gap * BANK["C_2"] / both, end - gap * BANK["C_1"] / both
    # the leakage of 1e9 ohm takes 3e-7 of the charge; the rule is of second order in 1e-3 s against a tau of 82 s
    assert run["bank.v_1"].values == pytest.approx(v_1, rel=1e-6)
    assert run["bank.v_2"].values == pytest.approx(v_2, rel=1e-6, abs=1e-4)
    lost = 0.5 * BANK["C_1"] * 100.0**2 - 0.5 * (BANK["C_1"] + BANK["C_2"]) * end**2
    left = 0.5 * (BANK["C_1"] * BANK["C_2"]) / (BANK["C_1"] + BANK["C_2"]) * (100.0 * np.exp(-200.0 / tau)) ** 2
    assert run.energy["losses"]["bank"] == pytest.approx(lost - left, rel=1e-4)


def test_a_constant_current_meets_first_the_resistance_and_then_the_immediate_capacitance():
    net, dc, step = bench(1e-4, R_2=1e9)  # the delayed branch apart
    net.add("charger", sg.CurrentSource(i_0=50.0), a=dc)
    run = sg.assemble(net, step).run({}, until=2.0, every=100)
    t, v = run["dc.v_dc"].time.values[1:], np.abs(run["dc.v_dc"].values[1:])
    assert v == pytest.approx(50.0 * BANK["R_1"] + 50.0 * t / BANK["C_1"], rel=1e-6)


def test_the_page_on_devices_has_the_contract_as_it_is_checked():
    from pathlib import Path

    from shipgrid.model.kernel_contract import contract_table

    page = Path(__file__).parents[2] / "docs" / "how-to" / "add_a_device.md"
    assert contract_table() in page.read_text()
