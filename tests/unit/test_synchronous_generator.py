"""Synchronous generator: data, conservation, and the Norton equivalent of a step."""

import numpy as np
import pytest

from shipgrid.assembly.unit_text import NORTON
from shipgrid.components.sources import synchronous_generator as machine
from shipgrid.components.sources.synchronous_generator import Derived, Input, Output, State, SynchronousGenerator
from shipgrid.errors import ParameterError
from shipgrid.model.records import make_record, names_of, parameter_record

FLUXES = ("psi_d", "psi_f", "psi_kd", "psi_q", "psi_kq")
LOADED = {"psi_d": 0.86, "psi_f": 1.06, "psi_kd": 0.93, "psi_q": -0.53, "psi_kq": -0.5, "omega": 0.97, "theta": 2.3}
FED = {"v_alpha": -310.0, "v_beta": 230.0, "E_fd": 2.1, "T_m": 0.4}


@pytest.fixture(scope="module")
def p():
    return parameter_record(SynchronousGenerator(T_d01=3.5))[0]  # that of the hand-made conversion


def values(record, names):
    return np.array([getattr(record, name) for name in names])


def slopes(x, u, p, scalar="f8"):
    dx = make_record(State, scalar=scalar)
    machine.derivatives(0.0, make_record(State, x, scalar), make_record(Input, u, scalar), p, dx)
    return dx


def test_the_default_data_give_the_fundamental_values_of_the_classical_conversion(p):
    """Closed forms evaluated once by hand (design data of the reference ship)."""
    expected = {
        "X_ad": 2.33, "X_aq": 1.33, "X_f": 0.104484, "R_f": 0.001845, "X_kd": 0.1000, "R_kd": 0.031207,
        "X_kq": 0.08512, "R_kq": 0.062562,
    }  # fmt: skip
    for name, value in expected.items():
        assert getattr(p, name) == pytest.approx(value, abs=6e-7 if value < 0.01 else 6e-6), name


def test_bases_are_peak_phase_values(p):
    assert p.V_b == pytest.approx(391.918, abs=1e-3)
    assert p.I_b == pytest.approx(1013.8, abs=0.05)
    assert 1.5 * p.V_b * p.I_b == pytest.approx(p.S_n, rel=1e-14)


def test_transient_and_subtransient_reactances_come_back_from_the_fundamental_values(p):
    """X' from stator and field alone, X'' with the damper: parallel reactances behind the leakage."""
    X_l = SynchronousGenerator().X_l
    assert X_l + 1 / (1 / p.X_ad + 1 / p.X_f) == pytest.approx(0.17, rel=1e-12)
    assert X_l + 1 / (1 / p.X_ad + 1 / p.X_f + 1 / p.X_kd) == pytest.approx(0.12, rel=1e-12)
    assert X_l + 1 / (1 / p.X_aq + 1 / p.X_kq) == pytest.approx(0.15, rel=1e-12)


@pytest.mark.parametrize("wrong", [{"X_d1": 0.11}, {"X_l": 0.13}, {"X_d": 0.1}, {"X_q2": 1.5}, {"X_q2": 0.07}])
def test_reactances_out_of_order_are_refused_with_their_names(wrong):
    with pytest.raises(ParameterError, match=r"expected X_l < X_[dq]2 <"):
        machine.derive(SynchronousGenerator(**wrong))


def test_power_in_is_change_of_stored_energy_losses_and_power_delivered(p):
    x, u = make_record(State, LOADED), make_record(Input, FED)
    rate = slopes(LOADED, FED, p)
    along = {name: LOADED[name] + 1e-40j * getattr(rate, name) for name in LOADED}
    stored = machine.stored_energy(make_record(State, along, "c16"), p).imag / 1e-40
    y = make_record(Output)
    machine.outputs(0.0, x, u, p, y)
    # 1e-9: rounding of terms that cancel to a part in a thousand
    assert stored + machine.losses(x, p) + y.p_ac == pytest.approx(machine.supplied(x, u, p), rel=1e-9)


def test_named_power_is_the_power_out_of_the_terminals(p):
    y = make_record(Output)
    machine.outputs(0.0, make_record(State, LOADED), make_record(Input, FED), p, y)
    into = 1.5 * (FED["v_alpha"] * y.i_alpha + FED["v_beta"] * y.i_beta)
    assert y.p_ac == pytest.approx(-into, rel=1e-13)
    assert y.p_pu * p.S_n == pytest.approx(y.p_ac, rel=1e-13)
    assert y.v_rms == pytest.approx(y.v_t * 480.0, rel=1e-13)


def test_an_over_excited_machine_delivers_reactive_power(p):
    """No load but the field raised: the current lags the voltage, and q is positive."""
    x = make_record(State, {"psi_d": 1.0, "psi_f": 1.2, "psi_kd": 1.05, "omega": 1.0})
    y = make_record(Output)
    machine.outputs(0.0, x, make_record(Input, {"v_alpha": 0.0, "v_beta": p.V_b}), p, y)
    assert y.q_ac > 0.1 * p.S_n
    assert y.p_ac == pytest.approx(0.0, abs=1e-9 * p.S_n)


def implicit_euler(gh, p, v):
    """The step the stamp stands for, from the derivatives alone: fluxes implicit, speed and angle predicted."""
    before = slopes(LOADED, FED, p)
    end = dict(LOADED)
    end["omega"] = LOADED["omega"] + gh * before.omega
    end["theta"] = LOADED["theta"] + gh * p.omega_b * end["omega"]
    u = {**FED, "v_alpha": v[0], "v_beta": v[1]}

    def residual(z):
        dx = slopes({**end, **dict(zip(FLUXES, z, strict=True))}, u, p, "c16")
        return z - values(make_record(State, LOADED), FLUXES) - gh * values(dx, FLUXES)

    z = values(make_record(State, LOADED), FLUXES).astype(complex)
    steps = 1e-40j * np.eye(len(z))
    J = np.array([residual(z + step).imag / 1e-40 for step in steps]).T
    z = z - np.linalg.solve(J, residual(z).real)  # linear in the fluxes: one Newton step is exact
    end.update(zip(FLUXES, z.real, strict=True))
    end["omega"] = LOADED["omega"] + gh * slopes(end, u, p).omega
    y = make_record(Output)
    machine.outputs(0.0, make_record(State, end), make_record(Input, u), p, y)
    return end, np.array([y.i_alpha, y.i_beta])


@pytest.mark.parametrize("gh", [1e-6, 8.8e-6, 100e-6])
@pytest.mark.parametrize("v", [(0.0, 0.0), (-310.0, 230.0), (150.0, 0.0)])
def test_the_norton_equivalent_is_the_implicit_euler_step_of_the_derivatives(gh, v, p):
    n, x_next = np.zeros(1, NORTON).view(np.recarray)[0], make_record(State)
    u = make_record(Input, {**FED, "v_alpha": v[0], "v_beta": v[1]})
    machine.stamp(gh, make_record(State, LOADED), u, p, n)
    machine.advance(gh, make_record(State, LOADED), u, p, n, x_next)
    end, i = implicit_euler(gh, p, v)
    G = np.array([[n.g_aa, n.g_ab], [n.g_ba, n.g_bb]])
    # 1e-11: rounding, amplified by the reactance seen in one microsecond
    np.testing.assert_allclose(G @ np.array(v) + np.array([n.h_a, n.h_b]), i, rtol=1e-11, atol=1e-8)
    np.testing.assert_allclose(values(x_next, names_of(State)), [end[k] for k in names_of(State)], rtol=1e-11)


def test_every_derived_constant_is_finite(p):
    assert np.isfinite(values(p, names_of(Derived))).all()


def test_a_machine_at_standstill_without_field_stays_there(p):
    n, x_next = np.zeros(1, NORTON).view(np.recarray)[0], make_record(State)
    u = make_record(Input)
    machine.stamp(8.8e-6, make_record(State), u, p, n)
    machine.advance(8.8e-6, make_record(State), u, p, n, x_next)
    assert (n.h_a, n.h_b) == (0.0, 0.0)
    assert not values(x_next, names_of(State)).any()
    assert n.g_aa > 0.0 and np.linalg.det([[n.g_aa, n.g_ab], [n.g_ba, n.g_bb]]) > 0.0
