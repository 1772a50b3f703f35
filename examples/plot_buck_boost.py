"""A battery's half-bridge on a DC bus in open loop: duty step, load step.

    python examples/plot_buck_boost.py [--out FIGURE.png]

At averaged fidelity the leg is a transformer of ratio s for direct current: the bus goes to e / s, and its capacitance
swings with the choke. Open loop, a load step is left to that oscillation.
"""

# %% One import for the simulator, one for the figure.
from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import shipgrid as sg

E, R, L, C = 474.0, 0.25, 0.8e-3, 5e-3  # V, ohm, H, F: the ferry's battery converter and a drive's capacitor
LOAD, MORE_LOAD = 20.0, 20.0  # ohm
S_BEFORE, S_AFTER = 0.66, 0.62
DUTY_STEP, LOAD_STEP, END = 0.10, 0.25, 0.4  # s


# %% The battery with its choke stands behind a leg on the bus; the duty ratio is a command.
def simulate(step: float = 30e-6) -> sg.CircuitRun:
    """Start where the duty ratio holds the bus, step the duty ratio, then the load.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    net = sg.Network("buck-boost")
    bus = net.dc_bus("bus", v_n=750.0)
    net.capacitance(bus, C)
    duty = net.command("converter.duty", S_BEFORE)
    net.add("battery", sg.InductiveDcSource(v_0=E, R=R, L=L), a=sg.Pole(bus, s=duty))
    net.add("load", sg.Resistor(R=LOAD), a=bus)
    net.add("more_load", sg.Resistor(R=MORE_LOAD), a=bus, contact="open")
    plan = sg.assemble(net, step=step)
    v_dc = S_BEFORE * E / (S_BEFORE**2 + R / LOAD)
    start = {"bus.v_dc": v_dc, "battery.i": -v_dc / (LOAD * S_BEFORE)}
    steps = [
        sg.At(DUTY_STEP, sg.Set("converter.duty", S_AFTER)),
        sg.At(LOAD_STEP, sg.Close("more_load")),
    ]
    return plan.run(start, events=steps, until=END)


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw bus voltage and battery current into a file."""
    figure, axes = plt.subplots(2, 1, sharex=True, figsize=(7.0, 5.0), constrained_layout=True)
    axes[0].plot(1e3 * run["bus.v_dc"]["time"], run["bus.v_dc"], lw=1.2)
    axes[0].set_ylabel("bus, V")
    axes[1].plot(1e3 * run["battery.i"]["time"], -run["battery.i"], lw=1.2)
    axes[1].set_ylabel("battery, A")
    axes[1].set_xlabel("time, ms")
    for at, text in ((DUTY_STEP, f"s = {S_AFTER}"), (LOAD_STEP, "second load")):
        for axis in axes:
            axis.axvline(1e3 * at, color="0.6", lw=0.8)
            axis.grid(alpha=0.3)
        axes[0].annotate(text, (1e3 * at, axes[0].get_ylim()[0]), (4, 4), textcoords="offset points", fontsize=8)
    axes[0].set_title("474 V battery on a DC bus through a half-bridge, open loop, averaged", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("buck_boost.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
