"""Short circuit of a DC bus: the capacitor first, then the diodes, and the motor that feeds them.

    python examples/circuits/plot_short_circuit.py [--out FIGURE.png]

A motor turns behind a bridge with blocked gates while the bus is short-circuited through a cable. The capacitor is
empty after 0.76 ms; then the cable's current goes on through the diodes of the bridge, and the motor's own
short-circuit current is left. The same circuit is solved by ngspice in tests/verification/test_gallery.py.
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
    "e": 3.0 * 2.0 * math.pi * 7.5 * 2.595,  # V, peak of a phase: the motor's at 450 rpm
    "f": 22.5,  # Hz
    "L": 1.83e-3,  # H
    "R": 8e-3,  # ohm, winding and diode
    "C_dc": 10e-3,  # F
    "v_dc_0": 750.0,  # V
    "R_f": 10e-3,  # ohm, of the fault's path
    "L_f": 20e-6,  # H
    "t_fault": 1e-3,  # s
    "t_end": 61e-3,  # s
    "R_on": 2e-3,  # ohm, of a diode
}


# %% The fault is a branch with a contact.
def circuit() -> sg.Network:
    """Motor at constant speed, blocked bridge, capacitor, fault."""
    p = CASE
    net = sg.Network("short circuit")
    dc = net.dc_bus("dc", v_n=p["v_dc_0"])
    net.capacitance(dc, p["C_dc"])
    net.add("gates", sg.DirectBridge(), inputs={"s_alpha": 0.0, "s_beta": 0.0, "gates": 0.0})
    bridge = net.bridge("bridge", sg.TwoLevelBridge(R_d=p["R_on"]), dc, modulator="gates")
    pairs = 3.0
    speed = 2.0 * math.pi * p["f"] / pairs
    machine = sg.Pmsm(n_p=pairs, psi_f=p["e"] / (speed * pairs), R_s=p["R"], L_d=p["L"], L_q=p["L"])
    crest = {"theta_e": -0.5 * math.pi}  # phase a's emf has its crest at time zero
    net.add("motor", machine, a=bridge, inputs={"omega_m": speed}, initial=crest)
    net.add("fault", sg.RlBranch(R=p["R_f"], L=p["L_f"]), a=dc, contact="open")
    return net


# %% Close it after a millisecond, at the start of the nearest step.
def simulate(step: float = 30e-6) -> sg.CircuitRun:
    """Run to the end.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    plan = sg.assemble(circuit(), step=step)
    fault = sg.At(CASE["t_fault"], sg.Close("fault"))
    names = ["fault.i", "motor.i_alpha", "motor.i_beta", "dc.v_dc"]
    return plan.run({"dc.v_dc": CASE["v_dc_0"]}, events=[fault], until=CASE["t_end"], record=names)


# %% What is looked at.
def waves(run: sg.CircuitRun) -> dict[str, np.ndarray]:
    """Times since the start as if the fault had come when it should, and values, straight in between."""
    late = run.events[0].time - CASE["t_fault"]
    straight = {"i_f": run["fault.i"], "i_a": -run["motor.i_alpha"], "v_dc": run["dc.v_dc"]}
    found = {"time": run["dc.v_dc"]["time"].values - late}
    return found | {name: y.values for name, y in straight.items()}


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw fault current, bus voltage and the motor's currents into a file."""
    found = waves(run)
    time = 1e3 * (found["time"] - CASE["t_fault"])
    figure, axes = plt.subplots(3, 1, figsize=(7.5, 7.5), constrained_layout=True)
    axes[0].plot(time, 1e-3 * found["i_f"], lw=1.2)
    axes[1].plot(time, found["v_dc"], lw=1.2)
    currents = run.phases("motor.i")
    for k, name in enumerate("abc"):
        axes[2].plot(time, -currents[k], lw=1.0, label=f"phase {name}")
    axes[2].legend(loc="upper right", fontsize=8, ncols=3)
    for axis in axes[:2]:
        axis.set_xlim(-0.5, 6.0)
    for axis, label in zip(axes, ("fault, kA", "bus, V", "out of the motor, A"), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[2].set_xlabel("time since the fault, ms")
    axes[0].set_title("750 V, 10 mF, 10 mohm and 20 uH; a motor at 450 rpm behind its diodes", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("short_circuit.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
