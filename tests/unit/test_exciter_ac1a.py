"""AC1A exciter: its rectifier, its saturation, its rest, its limits."""

import numpy as np
import pytest
from scipy.optimize import brentq

from shipgrid.controllers import exciter_ac1a
from shipgrid.controllers.exciter_ac1a import Ac1a, Input, Output, State, derivatives, fex, limit, outputs, saturation
from shipgrid.model.records import make_record, names_of, parameter_record

P, _ = parameter_record(Ac1a())


def slopes(x, u, p=P):
    dx = make_record(State)
    derivatives(0.0, make_record(State, x), make_record(Input, u), p, dx)
    return {name: getattr(dx, name) for name in names_of(State)}


def rest(E_fd):
    """Steady state that holds the field voltage (and, the machine at rest, the field current) `E_fd`."""
    v_e = brentq(lambda v: exciter_ac1a.rectified(v, E_fd, P) - E_fd, E_fd, 3.0 * E_fd, xtol=1e-14)
    y = make_record(Output)
    outputs(0.0, make_record(State, {"v_e": v_e}), make_record(Input, {"i_fd": E_fd}), P, y)
    return v_e, y


@pytest.mark.parametrize("corner", [0.0, 0.433, 0.75, 1.0])
def test_the_rectifier_factor_has_no_step(corner):
    below, above = fex(corner - 1e-12), fex(corner + 1e-12)
    # the standard's rounded constants (0.577, 0.433, 1.732) leave a step of 1.7e-4 at 0.433 and of 1.3e-5 at 0.75
    assert above == pytest.approx(below, abs=2e-4)


def test_the_rectifier_factor_falls_from_one_to_nothing():
    found = np.array([fex(i) for i in np.linspace(-0.2, 1.2, 1401)])
    assert found[0] == 1.0 and found[-1] == 0.0
    assert (np.diff(found) <= 0.0).all()


@pytest.mark.parametrize("quadratic", [0.0, 1.0])
def test_saturation_goes_through_its_two_points(quadratic):
    p, _ = parameter_record(Ac1a(quadratic=quadratic))
    assert saturation(4.18, p) == pytest.approx(4.18 * 0.10, rel=1e-12)
    assert saturation(3.14, p) == pytest.approx(3.14 * 0.03, rel=1e-12)
    assert saturation(1.0, p) < 0.005


def test_the_exponential_law_has_the_constants_of_the_sample_data():
    assert pytest.approx(7.915e-4, rel=1e-3) == P.A
    assert pytest.approx(1.15767, rel=1e-5) == P.B


def test_no_load_field_asks_for_the_published_exciter_values():
    v_e, y = rest(1.0)
    assert v_e == pytest.approx(1.1154, abs=1e-4)
    assert saturation(v_e, P) / v_e == pytest.approx(0.0029, abs=5e-5)
    assert y.v_fe == pytest.approx(1.4986, abs=1e-4)
    u = {"v_t": 1.0, "v_ref": 1.0 + y.v_fe / P.K_A, "i_fd": 1.0}
    assert u["v_ref"] - 1.0 == pytest.approx(0.0025, abs=5e-6)
    still = slopes({"v_m": 1.0, "v_a": y.v_fe, "v_e": v_e, "x_f": y.v_fe}, u)
    assert all(abs(rate) < 1e-9 for rate in still.values())


def test_rated_field_asks_for_the_published_exciter_values():
    v_e, y = rest(3.085)
    assert v_e == pytest.approx(3.441, abs=1e-3)
    assert y.v_fe == pytest.approx(4.760, abs=1e-3)


def test_the_steady_ceiling_is_where_the_regulator_ends():
    assert rest(3.75)[1].v_fe == pytest.approx(P.V_Rmax, rel=0.01)  # 3.75 is printed to three figures


def test_its_limits_hold_without_wind_up():
    x, y = make_record(State, {"v_a": 20.0, "v_e": -0.1}), make_record(Output)
    u = make_record(Input)
    limit(x, u, P)
    assert (x.v_a, x.v_e) == (14.5, 0.0)
    outputs(0.0, x, u, P, y)
    assert y.limited == 1.0
    forced = slopes({"v_a": 14.5}, {"v_ref": 1.0})
    assert forced["v_e"] == pytest.approx(6.03 / P.T_E)


def test_a_dead_exciter_lets_the_field_freewheel():
    y = make_record(Output)
    outputs(0.0, make_record(State), make_record(Input, {"i_fd": 1.2}), P, y)
    assert y.E_fd == 0.0


def test_switched_off_it_decays_whatever_the_voltage():
    off = slopes({"v_a": 2.0, "v_e": 1.0}, {"v_ref": 1.0, "on": 0.0})
    assert off["v_a"] == pytest.approx(-2.0 / 0.05)


def test_the_lead_lag_passes_fast_changes_by_its_ratio():
    p, _ = parameter_record(Ac1a(T_B=1.0, T_C=0.25))
    u = {"v_ref": 0.01}
    assert slopes({}, u, p)["v_a"] == pytest.approx(0.25 * slopes({}, u)["v_a"])
    assert slopes({"x_l": 0.01}, u, p)["v_a"] == pytest.approx(slopes({}, u)["v_a"])
