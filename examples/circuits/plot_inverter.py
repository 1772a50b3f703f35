"""A two-level inverter with an LCL filter on a resistive load, every edge of its 1620 Hz carrier.

    python examples/circuits/plot_inverter.py [--out FIGURE.png]

At a step of 30 us a carrier period has 20.6 steps, and none of the edges lies at the end of one. The choke's current is
drawn between steps from the edges (`shipgrid.analysis.edges`). The same circuit is solved by ngspice in
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
    "e": 750.0,  # V
    "R_s": 50e-3,  # ohm
    "L_s": 100e-6,  # H
    "C_dc": 5e-3,  # F
    "f": 60.0,  # Hz
    "f_sw": 1620.0,  # Hz, carrier at 1 at time zero
    "f_sample": 3240.0,  # Hz
    "m": 0.5,  # modulation vector over v_dc, in force from each sampling instant on, m exp(j 2 pi f t)
    "L_1": 0.761e-3,  # H, 0.742 pu of 596 kVA, 480 V
    "R_1": 3e-3,  # ohm
    "R_d": 0.141,  # ohm
    "C": 480e-6,  # F
    "L_2": 92.3e-6,  # H
    "R_2": 2e-3,  # ohm
    "R_load": 1.15,  # ohm, 200 kW
    "t_end": 4.0 / 60.0,  # s
}


# %% Source, bridge with modulator and carrier, filter, load.
def circuit() -> sg.Network:
    """Inverter in open loop; what is sampled at an instant is in force from the next one on."""
    p = CASE
    net = sg.Network("inverter")
    dc, ac = net.dc_bus("dc", v_n=p["e"]), net.ac_bus("ac", v_n=480.0, f_n=p["f"])
    net.capacitance(dc, p["C_dc"])
    net.add("source", sg.InductiveDcSource(v_0=p["e"], R=p["R_s"], L=p["L_s"]), a=dc)
    sampling = sg.Sampled(p["f_sample"])
    half = math.pi * p["f"] / p["f_sample"]  # the modulation gives the middle of a sampling period, wanted is its end
    net.add("modulation", sg.SineModulation(f_n=p["f"], phase=half), inputs={"m": 2.0 * p["m"]}, clock=sampling)
    net.add("carrier", sg.Carrier(), clock=sg.Sampled(p["f_sw"]))
    reference = {"s_alpha_ref": "modulation.s_alpha", "s_beta_ref": "modulation.s_beta"}
    phase = {name: f"carrier.{name}" for name in ("phase", "phase_next", "turns")}
    net.add("modulator", sg.TimeStampedBridge(), inputs=reference | phase, initial={"alpha": p["m"]}, clock=sampling)
    bridge = net.bridge("bridge", sg.TwoLevelBridge(), dc, modulator="modulator")
    values = {name: p[name] for name in ("L_1", "R_1", "C", "R_d", "L_2", "R_2")}
    net.add("filter", sg.LclFilter(**values), converter=bridge, grid=ac)
    net.add("load", sg.Resistor(R=p["R_load"]), a=ac)
    return net


# %% Four periods from rest.
def simulate(step: float = 30e-6) -> sg.CircuitRun:
    """Run to the end.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    currents = [f"filter.{axis}.{i}" for axis in ("alpha", "beta") for i in ("i_1", "i_2")]
    names = [*currents, "dc.v_dc", "source.i", "modulator.alpha", "modulator.beta"]
    plan = sg.assemble(circuit(), step=step)
    return plan.run({"dc.v_dc": CASE["e"]}, until=CASE["t_end"], record=names)


# %% Phase a of the filter's currents, and the DC side.
def waves(run: sg.CircuitRun) -> dict[str, np.ndarray]:
    """Times, and values at ends of steps and edges, straight in between."""
    t, v_dc = run["dc.v_dc"]["time"].values, run["dc.v_dc"].values
    instants = np.arange(math.ceil(t[-1] * CASE["f_sample"])) / CASE["f_sample"]
    last = np.searchsorted(t, instants + 1e-9 * t[1])  # the first step's end after each has what came into force
    in_force = [run[f"modulator.{axis}"].values[last] for axis in ("alpha", "beta")]
    legs = edges.of_bridge(instants, *in_force, CASE["f_sw"], t[-1])
    alpha, _ = edges.alpha_beta(legs)
    time, i_1 = edges.between_steps(t, run["filter.alpha.i_1"].values, alpha, 1.0 / CASE["L_1"], v_dc)
    straight = {"i_2": run["filter.alpha.i_2"], "v_dc": run["dc.v_dc"], "i_s": -run["source.i"]}
    return {"time": time, "i_1": i_1} | {name: np.interp(time, t, y.values) for name, y in straight.items()}


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw the filter's currents and the DC side into a file."""
    found = waves(run)
    time = 1e3 * found["time"]
    figure, axes = plt.subplots(3, 1, figsize=(7.5, 7.5), constrained_layout=True)
    axes[0].plot(time, found["i_1"], lw=0.9, label="converter side")
    axes[0].plot(time, found["i_2"], lw=1.2, label="grid side")
    axes[1].plot(time, found["i_1"], lw=1.0, label="with edges")
    axes[1].plot(1e3 * run["dc.v_dc"]["time"], run["filter.alpha.i_1"], "k.", ms=3, label="ends of steps")
    axes[1].set_xlim(57.0, 61.0)
    axes[1].set_ylim(-370.0, -200.0)
    axes[2].plot(time, found["v_dc"], lw=1.0)
    for axis, label in zip(axes, ("phase a, A", "converter side, A", "DC bus, V"), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    for axis in axes[:2]:
        axis.legend(loc="upper right", fontsize=8, ncols=2)
    axes[2].set_xlabel("time, ms")
    axes[0].set_title("1620 Hz inverter, LCL filter, 200 kW; steps of 30 us", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("inverter.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
