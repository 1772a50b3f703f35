"""Governor and exciter against what others publish: a run of PSS/E, and the block diagrams by SciPy's own means."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from shipgrid.controllers import exciter_ac1a, governor_degov1
from shipgrid.controllers.exciter_ac1a import Ac1a
from shipgrid.controllers.governor_degov1 import Degov1
from shipgrid.model.records import flat_of, make_record, parameter_record

CLOCK = 5e-4
"""What both are stepped with."""


def stepped(module, item, inputs, until, x, output=None):
    """States (or an output) over time, by Heun at their clock and with their limits, as the solver steps them."""
    p, _ = parameter_record(item)
    state, u = make_record(module.State, x), make_record(module.Input)
    dx, y = make_record(module.State), make_record(module.Output)
    flat, found, times = flat_of(state), [], np.arange(0.0, until + 0.5 * CLOCK, CLOCK)
    for t in times:
        for name, value in inputs(t).items():
            setattr(u, name, value)
        module.outputs(t, state, u, p, y)
        found.append(flat.copy() if output is None else getattr(y, output))
        start = flat.copy()
        module.derivatives(t, state, u, p, dx)
        first = flat_of(dx).copy()
        flat[:] = start + CLOCK * first
        module.derivatives(t + CLOCK, state, u, p, dx)
        flat[:] = start + 0.5 * CLOCK * (first + flat_of(dx))
        module.limit(state, u, p)
    return times, np.array(found)


# --- DEGOV1 -----------------------------------------------------------------------------------------------------------

PSSE = [
    (1.229167, 0.99966419), (1.6875, 1.00034416), (2.145833, 0.99963713), (2.604167, 1.00037801),
    (3.060417, 0.99960566), (3.520833, 1.00041151), (3.975, 0.99957055),
]  # fmt: skip
"""Turning points of the speed of a classical generator (H 8 s, D 0.03 pu) with DEGOV (K 18, T4 12 s, T5 5 s, T6 0.2 s,
no droop, no delay) on a three-bus grid after the trip of a line at 1 s, as PSS/E computed it: the file
`test/benchmarks/psse/DEGOV/degov_nodelay_speed_final.csv` of PowerSimulationsDynamics.jl (NREL, BSD licence)."""
FIRST_SLOPE = (0.99999046 - 1.0) / 0.004167
"""Rate of the speed over the first interval of that file [1/s]."""


def test_the_governor_drives_a_generator_as_psse_says_it_does():
    """Its lag is more than half a turn at the swing, so that it undamps it.

    Of the grid only two numbers are wanted, the step of power (the first slope) and the synchronising torque (the
    period of the swing); what the governor makes of it, growth and drift, is then determined. T1 and T2 are at their
    least here, 2 ms, and zero there: 0.8 degrees at the swing's 1.1 Hz.
    """
    H, D, omega_b = 8.0, 0.03, 2.0 * math.pi * 60.0
    p, _ = parameter_record(
        Degov1(K=18.0, droop=0.0, T_1=2e-3, T_2=2e-3, T_3=0.0, T_4=12.0, T_5=5.0, T_6=0.2, T_max=2.0, T_min=-0.1)
    )
    step = -FIRST_SLOPE * 2.0 * H
    x, u, dx = (make_record(kind) for kind in (governor_degov1.State, governor_degov1.Input, governor_degov1.State))
    flat = flat_of(x)

    def swing(K_s):
        def rates(t, z):
            flat[:], u.omega, u.omega_ref = z[2:], 1.0 + z[1], 1.0
            governor_degov1.derivatives(t, x, u, p, dx)
            return np.concatenate(
                [[omega_b * z[1], (x.throttle - step - K_s * z[0] - D * z[1]) / (2.0 * H)], flat_of(dx)]
            )

        found = solve_ivp(rates, (0.0, 4.0), np.zeros(2 + len(flat)), max_step=0.01, rtol=1e-8, atol=1e-10)
        t = np.arange(0.0, 4.0, 1e-3)
        omega = np.interp(t, found.t, found.y[1])
        turns = np.flatnonzero(np.diff(np.sign(np.diff(omega)))) + 1
        return 1.0 + t[turns], 1.0 + omega[turns]

    def lateness(K_s):
        return swing(K_s)[0][6] - PSSE[6][0]

    K_s = brentq(lateness, 1.9, 2.05, xtol=2e-3)
    times, speeds = swing(K_s)
    assert times[:7] == pytest.approx([t for t, _ in PSSE], abs=0.012)  # their interval is 4 ms, and a crest is flat
    # the swing grows by a tenth a period; 2 % of the first one for the 2 ms, and for what is not linear there
    assert speeds[:7] == pytest.approx([s for _, s in PSSE], abs=7e-6)


@pytest.mark.parametrize(
    "item",
    [Degov1(), Degov1(T_1=0.1905, T_2=0.0476, T_3=0.018, K=1.0, T_4=5.1, T_5=0.322, T_6=2e-3, droop=0.07)],
    ids=["defaults", "public data set"],
)
def test_the_governor_follows_a_small_step_as_its_block_diagram_does(item):
    """SciPy's transfer function, closed over the droop; it ends at the step over the droop."""
    step, until = -0.002, 6.0
    p = item
    lead = np.polymul([p.T_3, 1.0], [p.T_4, 1.0])
    lags = np.polymul([p.T_1 * p.T_2, p.T_1, 1.0], np.polymul([p.T_5, 1.0], [p.T_6, 1.0]))
    forward, integral = p.K * lead, np.polymul(lags, [1.0, 0.0])
    closed = signal.TransferFunction(forward, np.polyadd(integral, p.droop * forward))
    inputs = {"omega": 1.0 + step, "omega_ref": 1.0 + 0.05 * 0.0 + p.droop * 0.3}
    start = {"throttle": 0.3}
    times, states = stepped(governor_degov1, item, lambda t: inputs, until, start)
    _, expected = signal.step(closed, T=times)
    names = list(governor_degov1.State.__annotations__)
    throttle = states[:, names.index("throttle")] - 0.3
    assert throttle == pytest.approx(-step * expected, abs=1e-3 * abs(step / p.droop))
    assert np.real(signal.TransferFunction(closed).poles).max() < 0.0
    assert closed.num[-1] / closed.den[-1] == pytest.approx(1.0 / p.droop)


# --- AC1A -------------------------------------------------------------------------------------------------------------

PUBLIC = Ac1a(
    T_R=0.01, T_B=0.1, T_C=0.0, K_A=200.0, T_A=0.05, V_Amax=7.0, V_Amin=-7.0, T_E=1.333, K_F=0.02, T_F=0.8, K_C=0.0,
    K_D=0.0, K_E=1.0, E_1=4.0, S_1=1e-9, E_2=3.0, S_2=1e-9, V_Rmax=10.0, V_Rmin=-10.0,
)  # fmt: skip
"""Data of a public PSS/E case of ESAC1A (PowerSimulationsDynamics.jl), which has no rectifier loading or saturation."""


def loop(item: Ac1a) -> signal.TransferFunction:
    """v_ref to E_fd of a linear exciter, by its block diagram: regulator, exciter, rate feedback."""
    forward_n = item.K_A * np.array([item.T_C, 1.0])
    forward_d = np.polymul([item.T_B, 1.0], np.polymul([item.T_A, 1.0], [item.T_E, item.K_E]))
    rate_n, rate_d = item.K_E * item.K_F * np.array([1.0, 0.0]), np.array([item.T_F, 1.0])
    return signal.TransferFunction(
        np.polymul(forward_n, rate_d), np.polyadd(np.polymul(forward_d, rate_d), np.polymul(forward_n, rate_n))
    )


def test_the_exciter_follows_a_small_step_of_its_reference_as_its_block_diagram_does():
    times, field = stepped(
        exciter_ac1a, PUBLIC, lambda t: {"v_t": 1.0, "v_ref": 1.005, "i_fd": 0.0}, 3.0, {"v_m": 1.0}, "E_fd"
    )
    _, expected = signal.step(loop(PUBLIC), T=times)
    assert field == pytest.approx(0.005 * expected, abs=2e-3 * 0.005 * expected.max())
    assert 0.005 * expected.max() < 5.0  # within its limits all the way


def test_the_sample_exciter_around_rated_field_is_its_block_diagram_with_the_slopes_of_that_point():
    """Saturation and the loaded rectifier enter by their slopes, from the formulas and not from the kernels."""
    item, i_fd = Ac1a(), 3.085
    A, B = 7.915e-4, 1.15767
    i_n = brentq(lambda n: item.K_C * i_fd / n * (1.0 - 0.577 * n) - i_fd, 0.05, 0.43)
    v_e = item.K_C * i_fd / i_n
    slope_fe = item.K_E + A * math.exp(B * v_e) * (1.0 + B * v_e)  # of v_fe by v_e; E_fd has the slope 1 in this mode
    v_fe = v_e * (item.K_E + A * math.exp(B * v_e)) + item.K_D * i_fd
    forward_d = np.polymul([item.T_A, 1.0], [item.T_E, slope_fe])
    rate_n, rate_d = slope_fe * item.K_F * np.array([1.0, 0.0]), np.array([item.T_F, 1.0])
    closed = signal.TransferFunction(item.K_A * rate_d, np.polyadd(np.polymul(forward_d, rate_d), item.K_A * rate_n))
    step, u = 1e-4, {"v_t": 1.0, "i_fd": i_fd}
    start = {"v_m": 1.0, "v_a": v_fe, "v_e": v_e, "x_f": v_fe}
    inputs = u | {"v_ref": 1.0 + v_fe / item.K_A + step}
    times, field = stepped(exciter_ac1a, item, lambda t: inputs, 3.0, start, "E_fd")
    _, expected = signal.step(closed, T=times)
    assert field[0] == pytest.approx(i_fd, rel=2e-4)
    assert field - field[0] == pytest.approx(step * expected, abs=5e-3 * step * expected.max())


def test_a_large_step_is_driven_by_the_regulators_limit():
    """While v_a stands at its limit of 7 the exciter is one lag towards 7, from wherever it has come."""
    inputs = {"v_t": 0.8, "v_ref": 1.2, "i_fd": 0.0}
    times, field = stepped(exciter_ac1a, PUBLIC, lambda t: inputs, 1.0, {"v_m": 0.8}, "E_fd")
    at = round(0.1 / CLOCK)  # the regulator's own lags are over
    held = 7.0 + (field[at] - 7.0) * np.exp(-(times[at:] - times[at]) / PUBLIC.T_E)
    assert field[at:] == pytest.approx(held, abs=1e-5)
    assert field[-1] > 3.0
