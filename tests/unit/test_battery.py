"""Battery: discharge curve, identification from three points, polarisation, energy."""

import numpy as np
import pytest
from scipy.integrate import quad

from shipgrid.components.sources import battery as kernels
from shipgrid.components.sources.battery import Battery, Input, Output, State, derive, voltage_at_rest
from shipgrid.model.records import make_record, parameter_record
from shipgrid.units import ampere_hours

FERRY = Battery()
AH = 3600.0


def signals(battery=FERRY, *, soc=0.5, i=0.0, i_star=None):
    """Outputs and records of a battery with current `i`, polarised by it unless `i_star` is given."""
    p, _ = parameter_record(battery)
    x = make_record(State, {"q": (1.0 - soc) * battery.capacity, "i_star": i if i_star is None else i_star})
    u, y = make_record(Input, {"i": i}), make_record(Output)
    kernels.outputs(0.0, x, u, p, y)
    return y, x, u, p


def terminal_voltage(battery=FERRY, **state):
    y, _, u, p = signals(battery, **state)
    return y.e - p.R_b * u.i


@pytest.mark.parametrize(
    ("soc", "volts"),
    [(1.0, 514.06), (0.9, 476.50), (0.8, 476.07), (0.6, 475.03), (0.5, 474.20), (0.4, 472.96), (0.2, 466.75)],
)
def test_open_circuit_voltage_follows_the_table(soc, volts):
    y, *_ = signals(soc=soc)
    assert y.v_oc == pytest.approx(volts, abs=0.006)  # the table has two decimals
    assert y.e == y.v_oc
    assert y.soc == pytest.approx(soc)
    assert voltage_at_rest(FERRY, soc) == y.v_oc


@pytest.mark.parametrize(("i", "volts"), [(128.0, 464.84), (100.0, 466.88), (-128.0, 482.74)])
def test_terminal_voltage_at_half_charge(i, volts):
    assert terminal_voltage(i=i) == pytest.approx(volts, abs=0.006)  # two decimals


def test_parameters_of_the_ferry():
    p, _ = parameter_record(FERRY)
    assert pytest.approx(0.034375, rel=1e-12) == p.R_b
    assert p.i_n == pytest.approx(55.65, abs=0.005)
    assert pytest.approx(476.688, abs=6e-4) == p.E_0
    assert pytest.approx(0.0194074, abs=6e-8) == p.K * AH
    assert pytest.approx(0.0194074, abs=6e-8) == p.R_p  # one number for both in the model
    assert pytest.approx(37.3762, abs=6e-5) == p.A
    assert pytest.approx(0.477051, abs=6e-7) == p.B * AH


@pytest.mark.parametrize(
    ("battery", "points"),
    [
        # charge in Ah drawn, voltage there: the default of the block whose ratios these are
        (Battery(v_n=7.2, capacity=ampere_hours(5.4)), [(0.0, 8.3807), (0.26531, 7.7788), (4.8835, 7.2)]),
        (FERRY, [(0.0, 512.15), (6.289, 475.37), (115.76, 440.0)]),
        (
            Battery(v_full=1.2, v_exp=1.05, q_exp=0.1, q_nom=0.8, r=0.02, t_n=2 * AH),
            [(0, 528.0), (12.8, 462.0), (102.4, 440.0)],
        ),
    ],
)
def test_discharge_curve_passes_through_its_three_points(battery, points):
    i_n = derive(battery)["i_n"]
    for (charge, volts), polarised in zip(points, (False, True, True), strict=True):
        v = terminal_voltage(
            battery, soc=1.0 - charge * AH / battery.capacity, i=i_n, i_star=None if polarised else 0.0
        )
        assert v == pytest.approx(volts, rel=5e-5)  # charges have five digits, the curve falls by 3 V an Ah at the last


def test_small_default_of_the_block_has_its_resistance_and_current():
    constants = derive(Battery(v_n=7.2, capacity=ampere_hours(5.4)))
    assert constants["R_b"] == pytest.approx(13.33e-3, abs=5e-6)
    assert constants["i_n"] == pytest.approx(2.3478, abs=5e-5)


def test_energy_between_full_and_five_percent_is_57_kwh():
    p, _ = parameter_record(FERRY)
    joule, _ = quad(lambda q: kernels.open_circuit_voltage(q, p), 0.0, 0.95 * FERRY.capacity, epsrel=1e-9)
    assert joule / 3.6e6 == pytest.approx(57.4, abs=0.05)  # stated with one decimal


def test_drawing_the_energy_takes_what_is_supplied():
    y, x, u, p = signals(i=100.0, i_star=60.0)
    supplied, lost = kernels.supplied(x, u, p), kernels.losses(x, u, p)
    assert supplied == pytest.approx(y.v_oc * 100.0)
    assert supplied - lost == pytest.approx(y.e * 100.0)
    assert lost > 0.0


@pytest.mark.parametrize("i", [80.0, -80.0])
def test_polarisation_opposes_the_current_and_passes_through_zero_without_a_step(i):
    _, x, u, p = signals(i=i)
    assert kernels.losses(x, u, p) > 0.0
    _, x_small, u_small, _ = signals(i=1e-9 * i)
    assert abs(kernels.losses(x_small, u_small, p)) < 1e-12


def test_polarisation_follows_the_current_with_its_time_constant():
    _, x, u, p = signals(i=100.0, i_star=0.0)
    dx = make_record(State)
    kernels.derivatives(0.0, x, u, p, dx)
    assert dx.q == 100.0
    assert dx.i_star == pytest.approx(100.0 / 30.0)


@pytest.mark.parametrize(("soc", "i", "held"), [(1.02, -50.0, 1.0), (0.0, 50.0, 0.02), (1.02, 50.0, 1.0)])
def test_charge_is_held_at_the_ends_of_the_curve_and_says_so(soc, i, held):
    _, x, u, p = signals(soc=soc, i=i)
    kernels.limit(x, u, p)
    y = make_record(Output)
    kernels.outputs(0.0, x, u, p, y)
    assert y.soc == pytest.approx(held)
    assert y.outside == (0.0 if soc > 1.0 and i > 0.0 else 1.0)  # leaving the end is not being held there
    assert np.isfinite(y.e)
