"""The screw in four quadrants: coefficients against published tables, and no kink anywhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from shipgrid.components.marine import propeller
from shipgrid.components.marine.propeller import (
    PITCH_SERIES,
    Propeller,
    characteristic,
    first_quadrant,
    four_quadrants,
    fourier,
    mismatch,
    open_water,
    stand_in,
    table,
    zero_thrust,
)
from shipgrid.model.records import make_record, parameter_record

FERRY = {"P_D": 0.9, "A_E": 0.75, "Z": 5.0}


def forces(screw: Propeller, omega_m: float, v_a: float) -> tuple[float, float]:
    """Thrust and open-water torque (before the relative rotative efficiency) from the kernel."""
    p, tables = parameter_record(screw)
    thrust, tau = propeller.forces(omega_m, v_a, p, tables)
    return thrust, tau * screw.eta_r


@pytest.mark.parametrize("row", table("wageningen_b_series_check.csv"), ids=lambda row: "-".join(row.values()))
def test_polynomials_meet_the_published_values(row):
    K = open_water(row["coefficient_of"], float(row["J"]), float(row["P_D"]), float(row["AE_A0"]), float(row["Z"]))
    assert pytest.approx(float(row["value"]), abs=1e-5) == K


# data note: B5-75, P/D 0.9
OPEN_WATER = np.array(
    [
        [0.0, 0.4192, 0.5620],
        [0.1, 0.3906, 0.5294],
        [0.2, 0.3572, 0.4914],
        [0.3, 0.3195, 0.4483],
        [0.4, 0.2780, 0.4002],
        [0.5, 0.2331, 0.3475],
        [0.6, 0.1854, 0.2904],
        [0.7, 0.1353, 0.2293],
        [0.8, 0.0833, 0.1644],
        [0.9, 0.0300, 0.0959],
    ]
)


@pytest.mark.parametrize(("J", "K_T", "ten_K_Q"), OPEN_WATER)
@pytest.mark.parametrize("ahead", [1.0, -1.0])
def test_kernel_gives_the_open_water_diagram_in_both_directions(J, K_T, ten_K_Q, ahead):
    screw = Propeller(**FERRY)
    n = 5.0
    thrust, torque = forces(screw, ahead * 2.0 * math.pi * n, ahead * J * n * screw.D)
    # half a digit of the printed table, and the table's interpolation
    assert ahead * thrust / (screw.rho * n**2 * screw.D**4) == pytest.approx(K_T, abs=1e-4)
    assert ahead * 10.0 * torque / (screw.rho * n**2 * screw.D**5) == pytest.approx(ten_K_Q, abs=1e-4)


@pytest.mark.parametrize(("J", "K_T", "ten_K_Q"), [(0.0, 0.3671, 0.4467), (0.4, 0.2241, 0.3007), (0.6, 0.1307, 0.2014)])
def test_open_water_coefficients_at_pitch_0_8(J, K_T, ten_K_Q):
    assert open_water("KT", J, 0.8, 0.75, 5.0) == pytest.approx(K_T, abs=1e-4)
    assert 10.0 * open_water("KQ", J, 0.8, 0.75, 5.0) == pytest.approx(ten_K_Q, abs=1e-4)


@pytest.mark.parametrize(("J", "eta_o"), [(0.4, 0.4744), (0.6, 0.6197)])
def test_open_water_efficiency_at_pitch_0_8(J, eta_o):
    K_T, K_Q = (open_water(c, J, 0.8, 0.75, 5.0) for c in ("KT", "KQ"))
    assert J * K_T / (2.0 * math.pi * K_Q) == pytest.approx(eta_o, abs=2e-4)


def test_bollard_coefficients_at_pitch_1():
    assert open_water("KT", 0.0, 1.0, 0.75, 5.0) == pytest.approx(0.469, abs=5e-4)
    assert 10.0 * open_water("KQ", 0.0, 1.0, 0.75, 5.0) == pytest.approx(0.690, abs=5e-4)


def test_quadratic_fits_of_the_models_page_hold_within_their_stated_error():
    J = np.linspace(0.0, 0.85, 86)
    K_T = 0.36956 - 0.30068 * J - 0.15913 * J**2
    K_Q = 0.044804 - 0.028627 * J - 0.020618 * J**2
    assert np.abs(open_water("KT", J, 0.8, 0.75, 5.0) - K_T).max() < 0.00245
    assert np.abs(open_water("KQ", J, 0.8, 0.75, 5.0) - K_Q).max() < 0.000135


def test_cubic_table_is_within_its_stated_error_of_the_curve():
    screw = Propeller(**FERRY)
    p, tables = parameter_record(screw)
    beta = np.radians(np.linspace(-180.0, 180.0, 7201))
    got = np.array([propeller.forces(math.cos(b) / (0.35 * screw.D), math.sin(b), p, tables) for b in beta])
    q = 0.5 * screw.rho * 0.25 * math.pi * screw.D**2
    assert np.abs(got[:, 0] / q - characteristic("T", beta, 0.0, **FERRY)).max() < 1e-5
    assert np.abs(got[:, 1] * screw.eta_r / (q * screw.D) - characteristic("Q", beta, 0.0, **FERRY)).max() < 1e-5


@pytest.mark.parametrize("ends", [0.0, 1.0, -1.0])
@pytest.mark.parametrize("part", [0, 1])
def test_no_jump_and_no_kink_all_round_the_circle(ends, part):
    screw = Propeller(**FERRY, ends=ends)
    p, tables = parameter_record(screw)
    step = math.radians(0.05)
    beta = np.arange(-math.pi, math.pi, step)
    c = np.array([propeller.forces(math.cos(b) / (0.35 * screw.D), math.sin(b), p, tables)[part] for b in beta])
    c = c / np.abs(c).max()
    slope = (np.roll(c, -1) - c) / step
    # the tested curve itself bends by 30 /rad2 at most (harmonic 30 of the Fourier fit); a kink in the slope of 5 % of
    # the steepest slope would show as 100 /rad2 between two of these points, a jump of 1 % as 10000
    assert np.abs(slope).max() < 3.0
    assert (np.abs(np.roll(slope, -1) - slope) / step).max() < 60.0


def test_mirrored_screw_turns_round_with_speed_and_flow():
    screw = Propeller(**FERRY)
    rng = np.random.default_rng(1)
    for omega_m, v_a in rng.uniform(-40.0, 40.0, (50, 2)) * [1.0, 0.15]:
        ahead, astern = forces(screw, omega_m, v_a), forces(screw, -omega_m, -v_a)
        assert ahead == pytest.approx([-f for f in astern], rel=1e-9, abs=1e-9)


def test_screw_in_its_own_axes_facing_ahead_is_the_one_facing_astern_turned_round():
    for omega_m, v_a in [(30.0, 3.0), (-30.0, 3.0), (20.0, -2.0), (-10.0, -5.0)]:
        aft = forces(Propeller(**FERRY, ends=1.0), omega_m, v_a)
        fore = forces(Propeller(**FERRY, ends=-1.0), -omega_m, -v_a)
        assert aft == pytest.approx([-f for f in fore], rel=1e-9)


def test_beyond_the_blend_the_tested_propeller_serves():
    beta = np.radians([-60.0, -20.0, 40.0, 60.0])
    assert characteristic("T", beta, 1.0, **FERRY) == pytest.approx(four_quadrants("T", beta, **FERRY))
    # data note: at P/D 1.0 the B5-75 series differs from the polynomials by at most 0.012 in KT, 0.018 in 10 KQ
    J = np.linspace(0.0, 1.0, 11)
    beta, to_K = np.arctan(J / (0.7 * math.pi)), math.pi / 8.0 * (J**2 + (0.7 * math.pi) ** 2)
    K_T, K_Q = (four_quadrants(c, beta, 1.0, 0.75, 5.0) * to_K for c in "TQ")
    assert np.abs(K_T - open_water("KT", J, 1.0, 0.75, 5.0)).max() < 0.0125
    assert 10.0 * np.abs(K_Q - open_water("KQ", J, 1.0, 0.75, 5.0)).max() < 0.0185


# Z, A_E/A_0, P/D of the tested propellers; how far polynomials and series are apart in CT* at the joins, at most
TESTED = [
    (3.0, 0.65, 1.0, 0.015), (4.0, 0.55, 1.0, 0.004), (4.0, 0.70, 0.5, 0.006), (4.0, 0.70, 0.8, 0.005),
    (4.0, 0.70, 1.0, 0.009), (4.0, 0.70, 1.2, 0.014), (4.0, 0.70, 1.4, 0.017), (4.0, 0.85, 1.0, 0.008),
    (5.0, 0.75, 1.0, 0.004), (6.0, 0.80, 1.0, 0.005), (7.0, 0.85, 1.0, 0.007),
]  # fmt: skip


@pytest.mark.parametrize(("Z", "A_E", "P_D", "C_T"), TESTED)
def test_tested_propellers_join_the_polynomials_within_a_stated_distance(Z, A_E, P_D, C_T):
    assert stand_in(P_D, A_E, Z) == ((Z, A_E), P_D)
    beta = np.radians([-150.0, -20.0, 70.0])
    for k, coefficient in enumerate("TQ"):  # the series of the very propeller, to the rounding of the pitch correction
        a, b = fourier()[Z, A_E][P_D].T[2 * k : 2 * k + 2]
        series = [np.sum(a * np.cos(np.arange(31) * x) + b * np.sin(np.arange(31) * x)) for x in beta]
        assert four_quadrants(coefficient, beta, P_D, A_E, Z) == pytest.approx(series, abs=1e-12)
    apart = mismatch(P_D, A_E, Z)
    assert apart[0] < C_T
    assert apart[1] < 0.0015


def test_pitch_correction_brings_series_and_polynomials_together():
    assert {shape for shape, pitches in fourier().items() if len(pitches) > 1} == {PITCH_SERIES}
    for P_D, apart in [(0.7, 0.0121), (0.8, 0.0095), (0.9, 0.0046), (1.1, 0.0039), (1.2, 0.0070), (1.4, 0.0088)]:
        ends = np.array([0.0, zero_thrust(P_D, 0.75, 5.0)])
        uncorrected = first_quadrant("T", ends, P_D, 0.75, 5.0) - four_quadrants("T", ends, 1.0, 0.75, 5.0)
        found = mismatch(P_D, 0.75, 5.0)[0]
        assert found < min(apart, np.abs(uncorrected).max() / 6.0)


def test_mirrored_screw_is_the_one_facing_astern_with_the_flow_and_half_of_each_against_it():
    with_the_flow = np.radians(np.linspace(0.0, 90.0, 181))
    against_it = np.radians(np.linspace(110.0, 170.0, 121))
    for c in "TQ":
        astern, ahead = (characteristic(c, against_it, facing, **FERRY) for facing in (1.0, -1.0))
        assert characteristic(c, against_it, 0.0, **FERRY) == pytest.approx(0.5 * (astern + ahead), abs=1e-12)
        assert characteristic(c, with_the_flow, 0.0, **FERRY) == pytest.approx(
            characteristic(c, with_the_flow, 1.0, **FERRY), abs=1e-12
        )
    # docs/theory/propulsion.md, to the digits there
    found = [characteristic("T", np.radians([150.0]), ends, **FERRY)[0] for ends in (0.0, 1.0, -1.0)]
    assert found == pytest.approx([-0.432, -0.372, -0.492], abs=5e-4)


def test_two_mirrored_screws_brake_as_two_tested_ones_that_face_outwards():
    # ship going ahead, screws reversed, as on the way to a stop: from a fifth of the tip speed down to nearly at rest
    screws = {ends: Propeller(**FERRY, ends=ends) for ends in (0.0, 1.0, -1.0)}
    for v_a, omega_m in [(3.9, -5.0), (2.0, -10.0), (1.5, -16.0), (0.9, -8.0)]:
        mirrored, astern, ahead = (np.array(forces(screw, omega_m, v_a)) for screw in screws.values())
        assert 2.0 * mirrored == pytest.approx(astern + ahead, rel=1e-4)  # twice the error of the table


@pytest.mark.parametrize("ends", [0.0, 1.0, -1.0])
def test_run_is_told_where_the_open_water_diagram_does_not_reach(ends):
    p, tables = parameter_record(Propeller(**FERRY, ends=ends))
    at_zero = math.degrees(zero_thrust(0.9, 0.75, 5.0))
    blends = {1.0: [(-10.0, at_zero + 10.0)], -1.0: [(170.0, at_zero + 190.0)]}
    blends[0.0] = blends[1.0] + blends[-1.0]
    y = make_record(propeller.Output)
    for beta in np.arange(-179.5, 180.0):
        inside = any(low < angle < high for low, high in blends[ends] for angle in (beta, beta + 360.0))
        v_tip, v_a = math.cos(math.radians(beta)), math.sin(math.radians(beta))
        u = make_record(propeller.Input, {"omega_m": v_tip / 0.4375, "v_a": v_a})
        propeller.outputs(u, p, y, tables)
        assert y.beyond == (0.0 if inside else 1.0), beta
    propeller.outputs(make_record(propeller.Input, {"omega_m": 0.0, "v_a": 0.0}), p, y, tables)
    assert y.beyond == 0.0


@pytest.mark.parametrize(("Z", "A_E", "P_D"), [row[:3] for row in TESTED])
def test_every_tested_propeller_brakes_less_reversed_than_turned_round(Z, A_E, P_D):
    # the trailing edge leads in the second quadrant, the leading edge in the fourth: a fifth to two fifths more there
    reversed_, turned_round = (characteristic("T", np.radians([150.0]), ends, P_D, A_E, Z)[0] for ends in (1.0, -1.0))
    assert 1.2 < turned_round / reversed_ < 1.45
    # in both, braking falls before v_a = 0: water thrown against the stream comes back as a ring. It is no ripple of
    # one fit: every propeller has it, at the same angle
    beta = np.radians(np.arange(150.0, 180.5, 0.5))
    for ends in (1.0, -1.0):
        braking = -characteristic("T", beta, ends, P_D, A_E, Z)
        least = int(np.argmin(braking))
        assert 166.0 < math.degrees(beta[least]) < 175.0
        assert braking[least] < 0.96 * braking[-1]  # 0.71 to 0.954


def idling(screw: Propeller, v_a: float) -> float:
    """Shaft speed [rad/s] at which the stream turns a screw without torque."""
    return brentq(lambda omega_m: forces(screw, omega_m, v_a)[1], 0.3 * v_a / screw.D, 12.0 * v_a / screw.D)


def test_idle_screw_turns_a_little_faster_than_its_pitch_and_drags_little():
    for ends in (0.0, 1.0):
        screw = Propeller(**FERRY, ends=ends)
        for v_a in (0.5, 2.36, 5.0):
            omega_m = idling(screw, v_a)
            J_adv = v_a * 2.0 * math.pi / (omega_m * screw.D)
            # KT is zero at 0.955, KQ beyond: half the blend beyond the diagram, so the polynomials still say most of it
            assert J_adv == pytest.approx(1.03, abs=0.02)
            more, less = (forces(screw, k * omega_m, v_a)[1] for k in (1.05, 0.95))
            assert more > 0.0 > less  # the water holds it there
            drag, locked = -forces(screw, omega_m, v_a)[0], -forces(screw, 0.0, v_a)[0]
            assert 0.05 < drag / locked < 0.15  # a tenth or so of that of a locked screw
            # locked, blades of 0.75 of the disc lie nearly across the stream: a plate there has 1.1 to 1.2
            plate = locked / (0.5 * screw.rho * v_a**2 * 0.25 * math.pi * screw.D**2 * screw.A_E)
            assert 1.05 < plate < 1.25


def test_standstill_gives_no_force_and_a_stopped_screw_is_a_brake():
    screw = Propeller(**FERRY)
    assert forces(screw, 0.0, 0.0) == (0.0, 0.0)
    thrust, torque = forces(screw, 0.0, 3.0)
    assert thrust < 0.0
    assert torque < 0.0  # the stream would turn it ahead
    assert forces(screw, 0.0, -3.0) == pytest.approx((-thrust, -torque))
    # the limits from both sides agree: no jump as the shaft passes through standstill
    assert forces(screw, 1e-6, 3.0) == pytest.approx(forces(screw, -1e-6, 3.0), rel=1e-5)


def test_advance_ratio_is_shown_bounded_and_zero_at_standstill():
    p, tables = parameter_record(Propeller())
    y = make_record(propeller.Output)
    for omega_m, v_a, J in [(2.0 * math.pi * 4.0, 2.5, 0.5), (0.0, 2.0, 0.0), (1e-9, 2.0, 2.0), (0.0, 0.0, 0.0)]:
        u = make_record(propeller.Input, {"omega_m": omega_m, "v_a": v_a})
        propeller.outputs(u, p, y, tables)
        assert y.J_adv == pytest.approx(J)


def test_exact_derivatives_by_complex_step_agree_with_differences():
    p, tables = parameter_record(Propeller())
    pc, _ = parameter_record(Propeller(), scalar="c16")
    for omega_m, v_a in [(30.0, 3.0), (-5.0, 3.0), (20.0, -2.0), (1.0, 4.0)]:
        exact = [f.imag / 1e-30 for f in propeller.forces(omega_m + 1e-30j, v_a + 0j, pc, tables)]
        above, below = (propeller.forces(omega_m + d, v_a, p, tables) for d in (1e-5, -1e-5))
        central = [(a - b) / 2e-5 for a, b in zip(above, below, strict=True)]
        assert exact == pytest.approx(central, rel=1e-5)


def test_screw_never_gives_power_to_both_sides():
    p, tables = parameter_record(Propeller())
    w_f, t_f = 0.235, 0.205
    for beta in np.radians(np.arange(-180.0, 180.0, 2.0)):
        v_a, omega_m = 3.0 * math.sin(beta), 3.0 * math.cos(beta) / (0.35 * 1.25)
        u = make_record(propeller.Input, {"omega_m": omega_m, "v_a": v_a, "u_thrust": (1.0 - t_f) * v_a / (1.0 - w_f)})
        assert propeller.losses(u, p, tables) > 0.0
