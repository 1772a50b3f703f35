"""A battery feeds a DC bus through a half-bridge, switch by switch; the load is doubled.

    python examples/circuits/plot_buck_boost.py [--out FIGURE.png]

The choke's current is drawn with its edges: a step of 3 us has the mean of the switch, and where in the step it opened
or closed is known (`shipgrid.analysis.edges`). The same circuit is solved by ngspice in
tests/verification/test_gallery.py.
"""

# %% One import for the simulator, one for the figure.
from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import shipgrid as sg
from shipgrid.analysis import edges

CASE = {
    "e": 474.0,  # V, battery at half charge
    "R_b": 34.375e-3,  # ohm
    "C": 12e-6,  # F, beside the battery
    "R": 0.25,  # ohm, choke and switch
    "L": 0.8e-3,  # H
    "f_sw": 5e3,  # Hz
    "s": 0.62,  # duty ratio of the upper switch, constant
    "C_dc": 10e-3,  # F
    "R_load": 18.75,  # ohm, 30 kW at 750 V
    "R_step": 18.75,  # ohm, as much again
    "t_step": 40e-3,  # s
    "t_end": 100e-3,  # s
    "v_dc_0": 735.5,  # V, steady state of the mean before the step
}


# %% The battery and its choke stand at a leg; the leg has a modulator, and the modulator a carrier.
def circuit() -> sg.Network:
    """Battery, choke, half-bridge with its modulator, bus with two loads."""
    p = CASE
    net = sg.Network("buck-boost")
    battery, dc = net.dc_bus("battery", v_n=p["e"]), net.dc_bus("dc", v_n=750.0)
    net.capacitance(battery, p["C"])
    net.capacitance(dc, p["C_dc"])
    net.add("cells", sg.DcSource(v_0=p["e"], R=p["R_b"]), a=battery)
    net.add("carrier", sg.Carrier(), clock=sg.Sampled(p["f_sw"]))
    net.add(
        "modulator",
        sg.TimeStampedLeg(),
        inputs={"s_ref": p["s"], **{name: f"carrier.{name}" for name in ("phase", "phase_next", "turns")}},
        initial={"active": p["s"]},
        clock=sg.Sampled(p["f_sw"]),
    )
    pole = net.half_bridge("leg", sg.HalfBridge(), dc, modulator="modulator")
    net.add("choke", sg.Choke(R=p["R"], L=p["L"]), a=battery, b=pole)
    net.add("load", sg.Resistor(R=p["R_load"]), a=dc)
    net.add("more_load", sg.Resistor(R=p["R_step"]), a=dc, contact="open")
    return net


# %% Start where the mean stands still, and double the load.
def simulate(step: float = 3e-6) -> sg.CircuitRun:
    """Run to the end.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    i_l = CASE["v_dc_0"] / CASE["R_load"] / CASE["s"]
    start = {"dc.v_dc": CASE["v_dc_0"], "battery.v_dc": CASE["e"] - CASE["R_b"] * i_l, "choke.i": i_l}
    names = ["choke.i", "dc.v_dc", "leg.s"]
    plan = sg.assemble(circuit(), step=step)
    return plan.run(start, events=[sg.At(CASE["t_step"], sg.Close("more_load"))], until=CASE["t_end"], record=names)


# %% What is looked at: the current with its edges, and the bus.
def waves(run: sg.CircuitRun) -> dict[str, np.ndarray]:
    """Times, and values of the choke's current and the bus voltage: ends of steps and edges, straight in between."""
    t, v_dc = run["choke.i"]["time"].values, run["dc.v_dc"].values
    leg = edges.of_carrier([0.0], [CASE["s"]], CASE["f_sw"], t[-1])
    time, i_l = edges.between_steps(t, run["choke.i"].values, leg, -1.0 / CASE["L"], v_dc)
    return {"time": time, "i_l": i_l, "v_dc": np.interp(time, t, v_dc)}


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw bus voltage, current and a few periods of it into a file."""
    found = waves(run)
    figure, axes = plt.subplots(3, 1, figsize=(7.0, 7.0), constrained_layout=True)
    for axis, name, label in zip(axes, ("v_dc", "i_l", "i_l"), ("bus, V", "choke, A", "choke, A"), strict=True):
        axis.plot(1e3 * found["time"], found[name], lw=1.0)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[2].plot(1e3 * run["choke.i"]["time"], run["choke.i"], "k.", ms=3, label="ends of steps")
    axes[2].set_xlim(1e3 * CASE["t_step"] - 0.6, 1e3 * CASE["t_step"] + 1.2)
    axes[2].set_ylim(25.0, 125.0)
    axes[2].legend(loc="upper left", fontsize=8)
    axes[2].set_xlabel("time, ms")
    axes[0].set_title("474 V battery, 5 kHz half-bridge, 30 kW and then 60 kW", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("buck_boost.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
