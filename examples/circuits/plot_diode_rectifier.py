"""Six diodes between a grid and a capacitor: currents in pulses, and what they cost in harmonics.

    python examples/circuits/plot_diode_rectifier.py [--out FIGURE.png]

A bridge whose gates are blocked is a diode rectifier. Which diode conducts is found with the solve of each step, and
the end of a pulse lies inside a step. The same circuit is solved by ngspice in tests/verification/test_gallery.py.
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

CASE = {
    "e": 480.0 * math.sqrt(2.0 / 3.0),  # V, peak of a phase
    "f": 60.0,  # Hz
    "L": 0.5e-3,  # H
    "R": 10e-3,  # ohm, line and diode
    "C_dc": 5e-3,  # F
    "R_load": 6.0,  # ohm
    "v_dc_0": 620.0,  # V
    "t_end": 0.1,  # s
}


# %% A bridge with a modulator that drives nothing.
def circuit() -> sg.Network:
    """Grid behind its impedance, blocked bridge, capacitor, resistor."""
    p = CASE
    net = sg.Network("diode rectifier")
    dc = net.dc_bus("dc", v_n=650.0)
    net.capacitance(dc, p["C_dc"])
    net.add("gates", sg.DirectBridge(), inputs={"s_alpha": 0.0, "s_beta": 0.0, "gates": 0.0})
    bridge = net.bridge("bridge", sg.TwoLevelBridge(), dc, modulator="gates")
    v_n = p["e"] * math.sqrt(1.5)
    net.add("grid", sg.ThreePhaseSource(v_n=v_n, f_n=p["f"], R=p["R"], L=p["L"]), a=bridge)
    net.add("load", sg.Resistor(R=p["R_load"]), a=dc)
    return net


# %% From a capacitor at 620 V.
def simulate(step: float = 30e-6) -> sg.CircuitRun:
    """Run to the end.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    plan = sg.assemble(circuit(), step=step)
    names = ["grid.i_alpha", "grid.i_beta", "dc.v_dc"]
    return plan.run({"dc.v_dc": CASE["v_dc_0"]}, until=CASE["t_end"], record=names)


# %% What is looked at: the current out of the grid, and the capacitor.
def waves(run: sg.CircuitRun) -> dict[str, np.ndarray]:
    """Times, and values at ends of steps, straight in between."""
    t = run["dc.v_dc"]["time"].values
    return {"time": t, "i_a": -run["grid.i_alpha"].values, "v_dc": run["dc.v_dc"].values}


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw the currents out of the grid and the capacitor's voltage into a file."""
    figure, axes = plt.subplots(2, 1, sharex=True, figsize=(7.5, 5.5), constrained_layout=True)
    currents = run.phases("grid.i")
    for k, name in enumerate("abc"):
        axes[0].plot(1e3 * currents["time"], -currents[k], lw=1.0, label=f"phase {name}")
    axes[0].legend(loc="upper right", fontsize=8, ncols=3)
    axes[1].plot(1e3 * run["dc.v_dc"]["time"], run["dc.v_dc"], lw=1.0)
    for axis, label in zip(axes, ("out of the grid, A", "capacitor, V"), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[1].set_xlabel("time, ms")
    axes[0].set_title("Six-pulse diode rectifier on 480 V, 60 Hz", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("diode_rectifier.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
