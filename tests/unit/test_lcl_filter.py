"""LCL filter: sizes, resonance, transfer, contacts and energy."""

import math

import numpy as np
import pytest

from shipgrid.components.electrical.lcl_filter import (
    Input,
    LclFilter,
    Output,
    State,
    derivatives,
    losses,
    outputs,
    stored_energy,
)
from shipgrid.controllers.grid_forming import PRESETS
from shipgrid.equipment.rectifier import L_1_PRESETS
from shipgrid.model.component import type_of
from shipgrid.model.records import make_record, names_of, parameter_record

STATES = names_of(State)


def rectifier_filter(preset="paper", **more):
    return LclFilter.per_unit(596e3, 480.0, 60.0, **{"L_1": L_1_PRESETS[preset], "C": 0.07, "L_2": 0.09} | more)


def rates(lcl, state, v_conv=0.0, v_g=0.0):
    p, _ = parameter_record(lcl)
    x, dx = make_record(State, dict(zip(STATES, state, strict=True))), make_record(State)
    derivatives(0.0, x, make_record(Input, {"v_conv": v_conv, "v_g": v_g}), p, dx)
    return np.array([dx[name] for name in STATES])


def matrices(lcl):
    A = np.column_stack([rates(lcl, column) for column in np.eye(3)])
    return A, rates(lcl, np.zeros(3), v_conv=1.0), rates(lcl, np.zeros(3), v_g=1.0)


def test_per_unit_values_on_its_own_rating_are_the_printed_ones():
    lcl = rectifier_filter()
    assert pytest.approx(1.3228e-3, rel=1e-4) == lcl.L_1
    assert pytest.approx(92.29e-6, rel=1e-4) == lcl.L_2
    assert pytest.approx(480.3e-6, rel=1e-4) == lcl.C
    assert pytest.approx(0.1413, rel=1e-3) == lcl.R_d  # 0.365 pu


@pytest.mark.parametrize(("preset", "f_res"), [("paper", 782.0), ("compact", 985.0)])
def test_resonance_of_a_preset(preset, f_res):
    lcl = rectifier_filter(preset, damping=0.0, R_1=0.0, R_2=0.0)
    assert lcl.f_res == pytest.approx(f_res, abs=0.5)  # printed to 1 Hz
    ringing = np.abs(np.linalg.eigvals(matrices(lcl)[0]).imag).max()
    assert ringing / (2.0 * math.pi) == pytest.approx(lcl.f_res, rel=1e-9)


def test_paper_resonance_lies_between_ten_times_the_grid_and_half_the_carrier():
    assert 600.0 < rectifier_filter("paper").f_res < 810.0
    assert not 600.0 < rectifier_filter("compact").f_res < 810.0


def test_carrier_current_of_the_grid_is_0_28_of_the_converter_s():
    A, b, _ = matrices(rectifier_filter(damping=0.0))
    x = np.linalg.solve(2j * math.pi * 1620.0 * np.eye(3) - A, b)
    assert abs(x[2] / x[0]) == pytest.approx(0.28, abs=0.005)  # printed to two digits


def test_carrier_current_of_the_inverter_s_filter_is_0_30_of_the_converter_s():
    lcl = LclFilter.per_unit(50e3, 400.0, 60.0, L_1=PRESETS["paper"]["L_1"], C=0.06, L_2=0.10, damping=0.0)
    A, b, _ = matrices(lcl)
    x = np.linalg.solve(2j * math.pi * 1620.0 * np.eye(3) - A, b)
    assert abs(x[2] / x[0]) == pytest.approx(0.30, abs=0.005)


@pytest.mark.parametrize(
    ("S_n", "V_n", "paper", "by_rule"), [(596e3, 480.0, 1.2856, 0.742), (50e3, 400.0, 1.5427, 0.891)]
)
def test_presets_follow_from_the_sizing_rule_with_either_voltage(S_n, V_n, paper, by_rule):
    """L_1 = V_dc / (6 f_sw dI), dI = 10 % of the peak current: printed are the values with the line voltage in dI."""

    def of(voltage):
        ripple = 0.1 * S_n * math.sqrt(2.0) / (3.0 * voltage)
        return 750.0 / (6.0 * 1620.0 * ripple) / (V_n**2 / S_n / (2.0 * math.pi * 60.0))

    assert of(V_n) == pytest.approx(paper, rel=1e-4)
    assert of(V_n / math.sqrt(3.0)) == pytest.approx(by_rule, abs=6e-4)
    printed, chosen = (
        (L_1_PRESETS["paper"], L_1_PRESETS["phase_voltage_rule"])
        if S_n == 596e3
        else (PRESETS["paper"]["L_1"], PRESETS["default"]["L_1"])
    )
    assert (printed, chosen) == pytest.approx((paper, by_rule), abs=5e-3)


def test_power_into_the_terminals_is_stored_or_lost():
    lcl = rectifier_filter()
    p, _ = parameter_record(lcl)
    x, u, y = make_record(State), make_record(Input), make_record(Output)
    x.i_1, x.v_c, x.i_2, u.v_conv, u.v_g = 310.0, -205.0, -120.0, 260.0, 390.0
    outputs(0.0, x, u, p, y)
    dx = rates(lcl, (x.i_1, x.v_c, x.i_2), u.v_conv, u.v_g)
    h = 1e-9
    ends = []
    for side in (-0.5, 0.5):
        moved = make_record(State, {n: x[n] + side * h * dx[k] for k, n in enumerate(STATES)})
        ends.append(stored_energy(moved, p))
    into = u.v_conv * y.i_conv + u.v_g * y.i_g
    assert into == pytest.approx((ends[1] - ends[0]) / h + losses(x, u, p), rel=1e-5)  # difference quotient


def test_open_holds_everything_precharge_nothing_and_idle_the_grid_side_alone():
    assert type_of(LclFilter).variants == {"open": ("i_1", "v_c", "i_2"), "precharge": (), "idle": ("i_2",)}
