"""A motor with hysteresis control: each leg switches where its phase current leaves the band.

    python examples/circuits/plot_motor.py [--out FIGURE.png]

The crossings lie inside the steps of 30 us, and are found there. The star point is insulated, so that a phase may leave
its band for a while, by as much again at most. The same circuit is solved by ngspice in
tests/verification/test_gallery.py.
"""

# %% One import for the simulator, one for the figure.
from __future__ import annotations

import argparse
import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import shipgrid as sg
from shipgrid.analysis import edges

CASE = {
    "v_dc": 750.0,  # V
    "e": 3.0 * 2.0 * math.pi * 7.5 * 2.595,  # V, peak of a phase: at 450 rpm
    "f": 22.5,  # Hz
    "L": 1.83e-3,  # H
    "R": 10e-3,  # ohm, winding and switch
    "i_ref": 490.7,  # A, peak, in phase with the emf
    "band": 24.5,  # A, half its width
    "cycles": 4,
    "t_end": 5.0 / 22.5,  # s
}


# %% The comparators take the place of a modulator.
def circuit() -> sg.Network:
    """Stiff bus, bridge with hysteresis control, motor at constant speed."""
    p = CASE
    net = sg.Network("hysteresis control")
    dc = net.dc_bus("dc", v_n=p["v_dc"])
    net.add("source", sg.DcSource(v_0=p["v_dc"], R=1e-5), a=dc)
    pairs = 3.0
    speed = 2.0 * math.pi * p["f"] / pairs
    psi_f = p["e"] / (speed * pairs)
    start = {"theta_e": -0.5 * math.pi, "i_q": p["i_ref"]}  # phase a's emf has its crest at time zero
    seen = {name: f"motor.{name}" for name in ("i_d", "i_q", "theta_e")}
    net.add(
        "comparators",
        sg.HysteresisBridge(band=p["band"], n_p=pairs, psi_f=psi_f, R=p["R"], L_d=p["L"], L_q=p["L"]),
        inputs={**seen, "omega_m": speed, "v_dc": "dc.v_dc", "i_q_ref": p["i_ref"]},
    )
    bridge = net.bridge("bridge", sg.TwoLevelBridge(), dc, modulator="comparators")
    machine = sg.Pmsm(n_p=pairs, psi_f=psi_f, R_s=p["R"], L_d=p["L"], L_q=p["L"])
    net.add("motor", machine, a=bridge, inputs={"omega_m": speed}, initial=start)
    return net


# %% Five periods from the reference.
def simulate(step: float = 30e-6) -> sg.CircuitRun:
    """Run to the end.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    legs = [f"comparators.{name}_{leg}" for leg in "abc" for name in ("s", "lo")]
    plan = sg.assemble(circuit(), step=step)
    return plan.run(until=CASE["t_end"], record=["motor.i_alpha", "motor.i_beta", "dc.v_dc", *legs])


# %% Phase currents with their edges; where in a step one lies follows from the mean.
def waves(run: sg.CircuitRun) -> dict[str, np.ndarray]:
    """Times, and values at ends of steps and edges: straight currents, and potentials that jump."""
    t, v_dc = run["dc.v_dc"]["time"].values, run["dc.v_dc"].values
    legs = [
        edges.of_means(t, run[f"comparators.lo_{leg}"].values[1:], run[f"comparators.s_{leg}"].values) for leg in "abc"
    ]
    s_alpha, s_beta = edges.alpha_beta(legs)
    time, alpha = edges.between_steps(t, run["motor.i_alpha"].values, s_alpha, 1.0 / CASE["L"], v_dc)
    other, beta = edges.between_steps(t, run["motor.i_beta"].values, s_beta, 1.0 / CASE["L"], v_dc)
    every = np.union1d(time, other)
    alpha, beta = np.interp(every, time, alpha), np.interp(every, other, beta)
    half_root = 0.5 * math.sqrt(3.0)
    currents = {"i_a": alpha, "i_b": -0.5 * alpha + half_root * beta, "i_c": -0.5 * alpha - half_root * beta}
    potentials = {f"v_{name}": leg(every) * CASE["v_dc"] for name, leg in zip("abc", legs, strict=True)}
    return {"time": every} | currents | potentials


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw the phase currents, the error of one in its band, and its leg into a file."""
    found = waves(run)
    time = found["time"]
    error = found["i_a"] - CASE["i_ref"] * np.cos(2.0 * math.pi * CASE["f"] * time)
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(7.5, 7.0), constrained_layout=True)
    for name in "abc":
        axes[0].plot(1e3 * time, found[f"i_{name}"], lw=0.9, label=f"phase {name}")
    axes[0].legend(loc="upper right", fontsize=8, ncols=3)
    axes[1].plot(1e3 * time, error, lw=0.9)
    for side in (-CASE["band"], CASE["band"]):
        axes[1].axhline(side, color="0.4", lw=0.8, ls="--")
    axes[2].step(1e3 * time, found["v_a"], where="post", lw=0.8)
    axes[2].set_xlim(0.0, 1e3 / CASE["f"])
    for axis, label in zip(axes, ("currents, A", "error of phase a, A", "leg a, V"), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[2].set_xlabel("time, ms")
    axes[0].set_title("PMSM at 450 rpm and rated torque, hysteresis band of 24.5 A; steps of 30 us", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("motor.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
