"""A transformer whose core saturates: the inrush of its energising against closed form and SciPy, star and delta."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import shipgrid as sg
from shipgrid.errors import TopologyError

V, F, RATING = 400.0, 60.0, 50e3
OMEGA, PEAK, Z_B = 2.0 * math.pi * F, math.sqrt(2.0 / 3.0) * V, V**2 / RATING
I_B = 2.0 / 3.0 * RATING / PEAK
GRID = {"R": 0.02, "L": 100e-6}


def energised(core: sg.SaturableCore, step: float, angle: float, until: float, windings: sg.Transformer | None = None):
    """Switched on, at time zero, where phase a of the source has the angle; an open secondary."""
    net = sg.Network("inrush")
    bar, far = net.ac_bus("bar", V, F), net.ac_bus("far", 230.0, F)
    net.add("grid", sg.ThreePhaseSource(v_n=V, f_n=F, phase=angle, **GRID), a=bar)
    windings = windings or sg.Transformer.per_unit(RATING, V, 230.0, F, group="Dyn11", X=0.04, R=0.01)
    net.add("transformer", sg.SaturableTransformer(windings=windings, core=core), primary=bar, secondary=far)
    return sg.assemble(net, step=step).run(until=until), windings


CORE = sg.SaturableTransformer.per_unit(RATING, V, 230.0, F, group="Yd1", R_m=100.0).core


def test_the_first_peak_of_the_inrush_is_what_the_flux_beyond_the_knee_calls_for():
    """Without resistance the flux of the whole loop runs to 2 pu; all beyond 1.2 is in L_sat and 2/3 of the loop's L.

    The current of the one saturated limb returns in halves through the others: 2/3 of it in its own line.
    """
    core = dataclasses.replace(CORE, R_m=1e5, L_m=10.0)
    windings = sg.Transformer.per_unit(RATING, V, 230.0, F, group="Yd1", X=0.04, R=1e-6)
    net = sg.Network("inrush")
    bar, far = net.ac_bus("bar", V, F), net.ac_bus("far", 230.0, F)
    net.add("grid", sg.ThreePhaseSource(v_n=V, f_n=F, phase=-0.5 * math.pi, R=1e-6, L=GRID["L"]), a=bar)
    net.add("transformer", sg.SaturableTransformer(windings=windings, core=core), primary=bar, secondary=far)
    run = sg.assemble(net, step=10e-6).run(until=12e-3)
    line = run.phases("transformer.primary.i")[0]
    loop = OMEGA * (GRID["L"] + windings.L_1) / Z_B
    beyond = (2.0 - 1.2) / (OMEGA * core.L_sat / Z_B + 2.0 / 3.0 * loop)
    assert float(line.max()) / I_B == pytest.approx(2.0 / 3.0 * beyond, rel=5e-3)
    flux = run["transformer.core.psi_alpha"] / (PEAK / OMEGA)
    assert float(flux.max()) == pytest.approx(2.0 - 2.0 / 3.0 * loop * beyond, rel=5e-3)


def test_the_inrush_is_scipys_and_converges_with_the_step():
    """Equations in phases, written down anew; windings in delta."""
    core = dataclasses.replace(CORE, turn=math.pi / 6.0)
    axes = [np.exp(1j * (2.0 * math.pi * k / 3.0 - core.turn)) for k in range(3)]
    end, angle = 0.05, -0.5 * math.pi
    runs = [energised(core, step, angle, end) for step in (100e-6, 50e-6, 25e-6)]
    windings = runs[0][1]
    L, R = GRID["L"] + windings.L_1, GRID["R"] + windings.R_1

    def magnetising(psi):
        total = 0.0
        for axis in axes:
            along = (psi * np.conj(axis)).real
            beyond = max(abs(along) - core.psi_knee, 0.0) * math.copysign(1.0, along)
            total += 2.0 / 3.0 * axis * (along / core.L_m + (1.0 / core.L_sat - 1.0 / core.L_m) * beyond)
        return total

    def rates(t, x):
        i, psi = x[0] + 1j * x[1], x[2] + 1j * x[3]
        e = core.R_m * (i - magnetising(psi))
        d = (PEAK * np.exp(1j * (OMEGA * t + angle)) - R * i - e) / L
        return [d.real, d.imag, e.real, e.imag]

    errors = []
    for run, _ in runs:
        t = run["bar.v_alpha"]["time"].values
        found = solve_ivp(rates, (0.0, end + 1e-4), [0.0] * 4, t_eval=t, method="Radau", rtol=1e-9, atol=1e-10).y
        flux = run["transformer.core.psi_alpha"].values + 1j * run["transformer.core.psi_beta"].values
        current = run["transformer.primary.alpha.i"].values + 1j * run["transformer.primary.beta.i"].values
        size, settled = np.abs(found[0] + 1j * found[1]).max(), t > 1e-3  # L / R_m is far below any of these steps
        off = [
            np.abs(flux - found[2] - 1j * found[3]) / (PEAK / OMEGA),
            np.abs(current - found[0] - 1j * found[1]) / size,
        ]
        # where a limb passes its knee its voltage jumps, within L / R_m again: those few steps apart the order is two
        errors.append([float(np.quantile(part[settled], 0.95)) for part in off])
        assert off[0][settled].max() < 1e-4 and off[1][settled].max() < 1e-3
        assert abs(run.energy_balance_error) < 5e-3
    assert size > I_B  # more than the rated peak, where the core below its knee takes a five-hundredth
    order = np.log2(np.divide(errors[0], errors[2])) / 2.0
    assert np.all(order > 1.7), errors
    assert errors[2][0] < 1e-5 and errors[2][1] < 1e-4, errors


def test_a_core_in_delta_is_one_in_star_switched_on_thirty_degrees_later():
    star, _ = energised(CORE, 20e-6, -0.5 * math.pi, 0.05)
    delta, _ = energised(dataclasses.replace(CORE, turn=math.pi / 6.0), 20e-6, -0.5 * math.pi - math.pi / 6.0, 0.05)
    turned = [
        run["transformer.primary.alpha.i"].values + 1j * run["transformer.primary.beta.i"].values
        for run in (star, delta)
    ]
    assert np.abs(turned[1] - turned[0] * np.exp(-1j * math.pi / 6.0)).max() < 1e-6 * np.abs(turned[0]).max()


@pytest.mark.full  # two compiled modules of its own
def test_below_the_knee_it_is_the_linear_transformer():
    """Loaded, at nominal voltage: the T of three parts against the component that has it whole."""
    found = {}
    windings = sg.Transformer.per_unit(RATING, V, 230.0, F, group="Dyn11", X_m=50.0, R_m=100.0)
    core = dataclasses.replace(CORE, L_m=windings.L_m, R_m=windings.R_m, psi_knee=10.0)
    for item in (windings, sg.SaturableTransformer(windings=windings, core=core)):
        net = sg.Network("loaded")
        bar, far = net.ac_bus("bar", V, F), net.ac_bus("far", 230.0, F)
        net.add("grid", sg.ThreePhaseSource(v_n=V, f_n=F, **GRID), a=bar)
        net.add("transformer", item, primary=bar, secondary=far)
        net.add("load", sg.RlBranch(R=1.0, L=1e-3), a=far)
        run = sg.assemble(net, step=20e-6).run(until=0.02, record=["far.v_alpha", "far.v_beta", "grid.i_alpha"])
        found[type(item)] = [run[name].values[1:] for name in ("far.v_alpha", "far.v_beta", "grid.i_alpha")]
    for whole, parts in zip(*found.values(), strict=True):
        assert np.abs(whole - parts).max() < 1e-7 * np.abs(whole).max()


def test_a_terminal_that_is_missing_is_named():
    net = sg.Network("half")
    with pytest.raises(TopologyError, match=r"t \(SaturableTransformer\) has the three-phase terminals"):
        net.add("t", sg.SaturableTransformer.per_unit(RATING, V, V, F), primary=net.ac_bus("bar", V, F))
