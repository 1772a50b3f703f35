"""A three-phase inverter with an LCL filter feeds a resistive load in open loop: start, load step.

    python examples/plot_lcl_inverter.py [--out FIGURE.png]

At averaged fidelity the bridge gives the sine it is asked for. What is seen is the filter: its resonance at the start,
the voltage it loses in its chokes, and what its capacitors add.
"""

# %% One import for the simulator, one for the figure.
from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import shipgrid as sg

V_DC, V, F, RATING = 750.0, 400.0, 60.0, 50e3  # V, V, Hz, VA
M = 0.9
LOAD, MORE_LOAD = 6.4, 6.4  # ohm a phase: half the rating each
LOAD_STEP, END = 50e-3, 100e-3  # s
FILTER = sg.LclFilter.per_unit(RATING, V, F, L_1=0.10, C=0.06, L_2=0.05)


# %% DC source, bridge, filter, load; the modulation is a component of its own, and its index an input.
def simulate(step: float = 30e-6) -> sg.CircuitRun:
    """Start from rest and double the load after 50 ms.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    net = sg.Network("LCL inverter")
    dc, ac = net.dc_bus("dc", v_n=V_DC), net.ac_bus("ac", v_n=V, f_n=F)
    net.capacitance(dc, 2e-3)
    net.add("source", sg.DcSource(v_0=V_DC, R=0.05), a=dc)
    net.add("modulation", sg.SineModulation(f_n=F), inputs={"m": M})
    bridge = sg.Pole3(dc, s_alpha="modulation.s_alpha", s_beta="modulation.s_beta")
    net.add("filter", FILTER, converter=bridge, grid=ac)
    net.add("load", sg.Resistor(R=LOAD), a=ac)
    net.add("more_load", sg.Resistor(R=MORE_LOAD), a=ac, contact="open")
    plan = sg.assemble(net, step=step)
    return plan.run({"dc.v_dc": V_DC}, events=[sg.At(LOAD_STEP, sg.Close("more_load"))], until=END)


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw load voltage, converter current and DC voltage into a file."""
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(7.5, 7.0), constrained_layout=True)
    voltage, current = run.phases("ac.v"), run.phases("filter.i_1")
    for k, name in enumerate("abc"):
        axes[0].plot(1e3 * voltage["time"], voltage[k], lw=1.0, label=f"phase {name}")
        axes[1].plot(1e3 * current["time"], current[k], lw=1.0)
    axes[2].plot(1e3 * run["dc.v_dc"]["time"], run["dc.v_dc"], lw=1.0)
    axes[0].legend(loc="upper right", fontsize=8, ncols=3)
    for axis, label in zip(axes, ("load voltage, V", "converter current, A", "DC bus, V"), strict=True):
        axis.set_ylabel(label)
        axis.axvline(1e3 * LOAD_STEP, color="0.6", lw=0.8)
        axis.grid(alpha=0.3)
    axes[2].set_xlabel("time, ms")
    axes[0].set_title("Inverter with LCL filter, 25 kW, then 50 kW; averaged, open loop", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("lcl_inverter.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
