"""The gallery's circuits in ngspice, by themselves: do the netlists say what is meant?

What our own simulator is compared with has to be right first. Each circuit has a closed form for something; powers
balance; the step of 0.2 us is short enough.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from verification import ngspice, waves
from verification.gallery import GALLERY, reference, solution


def test_a_capacitor_charges_as_its_closed_form_says():
    netlist = "* RC\nV1 a 0 10\nR1 a b 1k\nC1 b 0 1u ic=0\n.tran 1e-6 5e-3 0 1e-6 uic\n.save v(b)\n.end\n"
    found = ngspice.run(netlist)
    t = found["time"]
    assert t[-1] == pytest.approx(5e-3, rel=1e-12)
    assert np.allclose(found["v(b)"], 10.0 * (1.0 - np.exp(-t / 1e-3)), atol=2e-3)
    assert ngspice.version().startswith("ngspice-")


@pytest.mark.parametrize(
    "netlist",
    [
        "* no such model\nV1 a 0 1\nS1 a 0 a 0 nothing\n.tran 1e-6 1e-3 0 1e-6\n.end\n",
        "* two sources in parallel\nV1 a 0 1\nV2 a 0 2\n.tran 1e-6 1e-3 0 1e-6\n.end\n",
    ],
)
def test_what_ngspice_complains_of_is_an_error(netlist):
    with pytest.raises(RuntimeError, match="ngspice"):
        ngspice.run(netlist)


def test_a_missing_ngspice_says_how_to_get_it(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(RuntimeError, match="apt-get install ngspice"):
        ngspice.run("* nothing\n.end\n")


def test_figures_of_a_waveform_with_jumps_and_uneven_times_are_exact():
    """A square wave by its corners, and a triangle: closed forms of mean, rms and Fourier series."""
    square = (np.array([0, 0.3, 0.3, 0.5, 0.5, 1.3, 1.3, 1.5, 1.5, 2.0]), np.array([0, 0, 1, 1, 0, 0, 1, 1, 0, 0.0]))
    assert waves.mean(*square, 0.0, 2.0) == pytest.approx(0.2, rel=1e-12)
    assert waves.rms(*square, 0.0, 2.0) == pytest.approx(math.sqrt(0.2), rel=1e-12)
    found = waves.harmonics(*square, 1.0, 0.0, 2.0, 5)
    n = np.arange(1, 6)
    exact = 2.0 * np.sin(0.2 * math.pi * n) / (math.pi * n) * np.exp(-2j * math.pi * n * 0.4)
    assert np.allclose(found, exact, atol=1e-12)
    triangle = (np.array([0.0, 0.25, 1.0]), np.array([0.0, 2.0, 0.0]))
    assert waves.rms(*triangle, 0.0, 1.0) == pytest.approx(2.0 / math.sqrt(3.0), rel=1e-12)
    assert waves.peak(*triangle, 0.1, 0.9) == (2.0, 0.25)
    assert waves.ripple(*triangle, 0.5, 0.0, 1.0) == pytest.approx((2.0 + 4.0 / 3.0) / 2.0, rel=1e-12)


def test_buck_boost_has_the_means_of_its_averaged_circuit_and_the_ripple_of_its_choke():
    p, found = GALLERY["buck-boost"].parameters, reference("buck-boost")
    R, s, T = p["R"] + p["R_b"], p["s"], 1.0 / p["f_sw"]
    for when, load in (("before", p["R_load"]), ("after", p["R_load"] * p["R_step"] / (p["R_load"] + p["R_step"]))):
        v_dc = p["e"] / (s + R / (s * load))
        rise = (v_dc - p["e"] + R * v_dc / load / s) * s * T / p["L"]
        # The bus gets the mean of the current while s = 1, which the curve of its fall leaves below the mean of all.
        i_l = v_dc / load / s + (1.0 - s) * R * rise * T / (12.0 * p["L"])
        assert found[f"v_dc mean {when}"] == pytest.approx(v_dc, rel=3e-4)
        assert found[f"i_l mean {when}"] == pytest.approx(i_l, rel=3e-4)
        assert found[f"i_l ripple {when}"] == pytest.approx(rise, rel=2e-3)  # straight lines: R T / L is 0.07


def test_boost_rests_at_zero_current_for_the_time_its_charge_balance_leaves():
    p, found = GALLERY["boost"].parameters, reference("boost")
    T, d = 1.0 / p["f_sw"], 1.0 - p["s"]
    peak = p["e"] * d * T / p["L"]
    # energy of a pulse: e i_mean = v^2 / R_load, without the choke's resistance (0.3 % of the power)
    v = 0.5 * p["e"] * (1.0 + math.sqrt(1.0 + 2.0 * d * d * p["R_load"] * T / p["L"]))
    fall = peak * p["L"] / (v - p["e"]) / T
    assert found["v_dc mean"] == pytest.approx(v, rel=5e-3)
    assert found["i_l peak"] == pytest.approx(peak, rel=5e-3)
    assert found["share at rest"] == pytest.approx(1.0 - d - fall, abs=0.01)


def test_inverter_has_the_fundamental_of_its_phasor_circuit():
    p, found = GALLERY["inverter"].parameters, reference("inverter")
    w = 2.0 * math.pi * p["f"]
    z_2 = p["R_2"] + p["R_load"] + 1j * w * p["L_2"]
    z_c = p["R_d"] + 1.0 / (1j * w * p["C"])
    z = p["R_1"] + 1j * w * p["L_1"] + z_2 * z_c / (z_2 + z_c)
    hold = cmath.exp(-0.5j * w / p["f_sample"]) * np.sinc(p["f"] / p["f_sample"])
    i_1 = p["m"] * found["v_dc mean"] * hold / z
    i_2 = i_1 * z_c / (z_2 + z_c)
    for name, phasor in (("i_1", i_1), ("i_2", i_2)):
        assert found[f"{name} fundamental"] == pytest.approx(abs(phasor), rel=2e-3)
        assert found[f"{name} angle"] == pytest.approx(math.degrees(cmath.phase(phasor)), abs=0.1)
    assert found["v_dc mean"] == pytest.approx(p["e"] - p["R_s"] * found["i_s mean"], abs=0.05)


def test_inverter_delivers_what_it_draws():
    p, w = GALLERY["inverter"].parameters, solution("inverter")
    t, last = w["time"], (p["t_end"] - 2.0 / p["f"], p["t_end"])
    drawn = p["e"] * waves.mean(t, w["i_s"], *last)
    i_1, i_2 = waves.rms(t, w["i_1"], *last), waves.rms(t, w["i_2"], *last)
    i_c = waves.rms(t, w["i_1"] - w["i_2"], *last)
    spent = 3.0 * (p["R_1"] * i_1**2 + (p["R_2"] + p["R_load"]) * i_2**2 + p["R_d"] * i_c**2)
    spent += p["R_s"] * waves.rms(t, w["i_s"], *last) ** 2
    assert drawn == pytest.approx(spent, rel=2e-3)  # edges found to within 0.2 us of 617


def test_rectifier_has_the_mean_of_the_diode_bridge_with_overlap_and_its_powers_balance():
    p, found, w = GALLERY["diode-rectifier"].parameters, reference("diode-rectifier"), solution("diode-rectifier")
    i_dc = found["v_dc mean"] / p["R_load"]
    omega = 2.0 * math.pi * p["f"]
    mean = 3.0 * math.sqrt(3.0) / math.pi * p["e"] - (3.0 / math.pi * omega * p["L"] + 2.0 * p["R"]) * i_dc
    # of a smooth DC current; this one pulsates behind 0.5 mH
    assert found["v_dc mean"] == pytest.approx(mean, rel=0.01)
    assert 3.0 * math.sqrt(3.0) / math.pi * p["e"] == pytest.approx(648.2, abs=0.1)
    drawn = 1.5 * p["e"] * found["i_a fundamental"] * math.cos(math.radians(found["i_a angle"]))
    t, last = w["time"], (p["t_end"] - 2.0 / p["f"], p["t_end"])
    spent = waves.rms(t, w["v_dc"], *last) ** 2 / p["R_load"] + 3.0 * p["R"] * waves.rms(t, w["i_a"], *last) ** 2
    assert drawn == pytest.approx(spent, rel=1e-3)  # the diodes' 25 mV and the open switches beside: 5e-4


def test_short_circuit_has_the_peak_the_zero_and_the_decay_of_its_stages():
    """Stage I: R, L and C alone, the motor adds next to nothing in 0.8 ms. Stage II: the diodes carry it on."""
    p, found = GALLERY["short-circuit"].parameters, reference("short-circuit")
    R, L, C, V = p["R_f"], p["L_f"], p["C_dc"], p["v_dc_0"]
    damping, omega_0 = R / (2.0 * L), 1.0 / math.sqrt(L * C)
    omega_d = math.sqrt(omega_0**2 - damping**2)
    beta = math.atan(omega_d / damping)

    def current(t):
        return V / (omega_d * L) * math.exp(-damping * t) * math.sin(omega_d * t)

    t_peak, t_zero = beta / omega_d, (math.pi - beta) / omega_d
    assert current(t_peak) == pytest.approx(14.23e3, rel=1e-3)
    assert found["i_f peak"] == pytest.approx(current(t_peak), rel=1e-3)
    assert found["i_f peak at"] == pytest.approx(t_peak, abs=2e-6)
    assert found["v_dc zero at"] == pytest.approx(t_zero, abs=2e-6)
    six = 2.0 / 3.0 * p["R_on"]  # three legs side by side, each of two diodes in series
    freewheeling = current(t_zero) * math.exp(-(R + six) / L * (2e-3 - t_zero))
    assert found["i_f at 2 ms"] == pytest.approx(freewheeling, rel=2e-3)  # the diodes' 50 mV beside 78 V
    # the capacitor takes 13 us to what the diodes carry, and that falls in 1.8 ms
    fast, slow = six * C, L / (R + six)
    at = math.log(slow / fast) / (1.0 / fast - 1.0 / slow)
    lowest = -six * current(t_zero) * (math.exp(-at / slow) - math.exp(-at / fast)) / (1.0 - fast / slow)
    assert found["v_dc lowest"] == pytest.approx(lowest, rel=0.01)
    # stage III: the motor's short-circuit current, with its DC component, from about when the bus is empty
    Z, w = complex(p["R"], 2.0 * math.pi * p["f"] * p["L"]), 2.0 * math.pi * p["f"]
    start = p["t_fault"] + t_zero
    t = np.linspace(start, p["t_end"], 5001)
    at_once = p["e"] / abs(Z) * np.cos(w * start - cmath.phase(Z))
    i_a = p["e"] / abs(Z) * np.cos(w * t - cmath.phase(Z)) - at_once * np.exp(-p["R"] / p["L"] * (t - start))
    assert found["i_a peak"] == pytest.approx(np.max(i_a), rel=0.05)  # it begins 0.2 ms before; the fault has 13 V
    assert found["i_a peak at"] + p["t_fault"] == pytest.approx(t[np.argmax(i_a)], abs=1e-3)


def test_motor_is_kept_in_its_band_but_for_the_insulated_star_point():
    p, found = GALLERY["motor"].parameters, reference("motor")
    assert 1.2 * p["band"] < found["error peak"] < 2.0 * p["band"]
    assert found["i fundamental"] == pytest.approx(p["i_ref"], rel=0.02)
    assert found["i angle"] == pytest.approx(0.0, abs=1.0)
    # of a single phase with its star point held: v_dc / (8 L h) at most, where its emf is zero
    assert 0.1 < found["edges up and down a second"] / (p["v_dc"] / (8.0 * p["L"] * p["band"])) < 0.5
