"""Passive elements of the AC and DC grid: load, series branch, cable."""

import math

import pytest

from shipgrid.components.electrical import load, rl_branch
from shipgrid.components.electrical.cable import ac_cable, dc_cable
from shipgrid.components.electrical.lcl_filter import LclFilter
from shipgrid.components.electrical.load import Load
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.errors import ParameterError
from shipgrid.model.records import make_record, parameter_record

OMEGA = 2.0 * math.pi * 60.0


def test_load_takes_its_power_at_its_power_factor_at_nominal_voltage():
    item = Load(p_0=10e3, power_factor=0.9, v_n=400.0, f_n=60.0)
    p, _ = parameter_record(item)
    v = math.sqrt(2.0 / 3.0) * 400.0
    i = v / complex(p.R, OMEGA * p.L)
    s = 1.5 * v * i.conjugate()
    assert s.real == pytest.approx(10e3, rel=1e-12)
    assert s.imag == pytest.approx(10e3 * math.tan(math.acos(0.9)), rel=1e-12)
    # what the two axes use, at any instant: 3/2 R (i_alpha^2 + i_beta^2)
    used = sum(load.consumed(make_record(load.State, {"i": part}), None, p) for part in (i.real, i.imag))
    assert 1.5 * used == pytest.approx(10e3, rel=1e-12)


def test_load_current_follows_a_phasor():
    """Put the steady current's derivative against j omega i."""
    p, _ = parameter_record(Load(p_0=6e3, power_factor=0.8))
    v, i = 300.0, 300.0 / complex(p.R, OMEGA * p.L)
    dx = make_record(load.State)
    load.derivatives(0.0, make_record(load.State, {"i": i.real}), make_record(load.Input, {"v": v}), p, dx)
    assert dx.i == pytest.approx((1j * OMEGA * i).real, rel=1e-12)


def test_load_without_inductance_is_refused():
    with pytest.raises(ParameterError, match="power_factor"):
        Load(power_factor=1.0)


def test_branch_power_is_losses_and_change_of_stored_energy():
    item = RlBranch(R=0.3, L=2e-3)
    p, _ = parameter_record(item)
    x, u, dx = make_record(rl_branch.State, {"i": 7.0}), make_record(rl_branch.Input, {"v": -4.0}), None
    dx, y = make_record(rl_branch.State), make_record(rl_branch.Output)
    rl_branch.derivatives(0.0, x, u, p, dx)
    rl_branch.outputs(0.0, x, u, p, y)
    power = u.v * y.i_in
    assert power == pytest.approx(p.L * x.i * dx.i + rl_branch.losses(x, u, p), rel=1e-12)


def test_branch_without_resistance_is_allowed_and_without_inductance_is_not():
    assert RlBranch(R=0.0, L=1e-6).R == 0.0
    with pytest.raises(ParameterError, match=r"RlBranch\.L"):
        RlBranch(R=1.0, L=0.0)


def test_dc_tie_of_30_m_has_both_poles_resistance_and_the_loops_inductance():
    tie = dc_cable(30.0, contact=1e-4)
    assert pytest.approx(2 * 30 * 0.035e-3 + 1e-4) == tie.R
    assert pytest.approx(9e-6) == tie.L


def test_ac_cable_of_10_m():
    tie = ac_cable(10.0)
    assert pytest.approx(1.9e-3) == tie.R
    assert pytest.approx(2.8e-6) == tie.L


def test_transformer_short_circuit_current_is_one_over_its_impedance():
    """The inverter's transformer is the filter's second choke: 1 pu of voltage drives 1/|Z| = 9.99 pu."""
    lcl = LclFilter.per_unit(50e3, 400.0, 60.0, L_1=0.891, C=0.06, L_2=0.10)
    v = math.sqrt(2.0 / 3.0) * 400.0
    rated = 2.0 / 3.0 * 50e3 / v
    assert v / abs(complex(lcl.R_2, OMEGA * lcl.L_2)) / rated == pytest.approx(1.0 / abs(0.005 + 0.10j), rel=1e-9)


@pytest.mark.parametrize(("L_1", "f_res"), [(0.891, 817.0), (1.54, 799.0)])
def test_inverter_filter_resonates_where_it_should(L_1, f_res):
    lcl = LclFilter.per_unit(50e3, 400.0, 60.0, L_1=L_1, C=0.06, L_2=0.10)
    assert lcl.f_res == pytest.approx(f_res, abs=1.0)
