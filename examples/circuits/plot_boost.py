"""A half-bridge of which only the lower switch is driven: at light load the choke's current comes to rest.

    python examples/circuits/plot_boost.py [--out FIGURE.png]

A pulse of 20 us charges the choke, the upper diode discharges it, and for more than half of the period nothing flows.
The steps of 30 us are longer than the pulse. ngspice solves the same circuit in tests/verification/test_gallery.py.
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
    "e": 474.0,  # V
    "R": 0.25,  # ohm, choke and switch
    "L": 0.8e-3,  # H
    "f_sw": 5e3,  # Hz
    "s": 0.9,  # duty ratio: the lower switch is on for 0.1 of a period
    "C_dc": 0.1e-3,  # F
    "R_load": 300.0,  # ohm
    "t_end": 60e-3,  # s
    "v_dc_0": 609.6,  # V
}
LOWER = 2.0  # value of `gates`: the lower switch alone


# %% A source behind a choke at a leg.
def circuit() -> sg.Network:
    """Source, choke, half-bridge with its modulator, bus with a load."""
    p = CASE
    net = sg.Network("boost")
    dc = net.dc_bus("dc", v_n=750.0)
    net.capacitance(dc, p["C_dc"])
    net.add("carrier", sg.Carrier(), clock=sg.Sampled(p["f_sw"]))
    phase = {name: f"carrier.{name}" for name in ("phase", "phase_next", "turns")}
    net.add(
        "modulator",
        sg.TimeStampedLeg(),
        inputs={"s_ref": p["s"], "gates": LOWER, **phase},
        initial={"active": p["s"]},
        clock=sg.Sampled(p["f_sw"]),
    )
    pole = net.half_bridge("leg", sg.HalfBridge(), dc, modulator="modulator")
    net.add("choke", sg.InductiveDcSource(v_0=p["e"], R=p["R"], L=p["L"]), a=pole)
    net.add("load", sg.Resistor(R=p["R_load"]), a=dc)
    return net


# %% Start where the mean stands still.
def simulate(step: float = 30e-6) -> sg.CircuitRun:
    """Run to the end.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    plan = sg.assemble(circuit(), step=step)
    names = ["choke.i", "dc.v_dc", "leg.s", "modulator.lo"]
    return plan.run({"dc.v_dc": CASE["v_dc_0"]}, until=CASE["t_end"], record=names)


# %% What is looked at: the current with its edges, and the bus.
def waves(run: sg.CircuitRun) -> dict[str, np.ndarray]:
    """Times, and values at ends of steps and edges, straight in between."""
    t, v_dc = run["dc.v_dc"]["time"].values, run["dc.v_dc"].values
    command = edges.of_carrier([0.0], [CASE["s"]], CASE["f_sw"], t[-1])
    mean, low, i = run["leg.s"].values[1:], run["modulator.lo"].values[1:], run["choke.i"].values
    rest = edges.at_rest(t, i, mean, 1.0 / CASE["L"], v_dc)
    leg = edges.of_one_switch(t, mean, low, rest, command, lower=True)
    time, i = edges.between_steps(t, i, leg, 1.0 / CASE["L"], v_dc)
    return {"time": time, "i_l": -i, "v_dc": np.interp(time, t, v_dc)}


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw current and bus voltage of the last periods into a file."""
    found = waves(run)
    time = 1e3 * found["time"]
    figure, axes = plt.subplots(2, 1, sharex=True, figsize=(7.5, 5.5), constrained_layout=True)
    axes[0].plot(time, found["i_l"], lw=1.0, label="with edges")
    axes[0].plot(1e3 * run["choke.i"]["time"], -run["choke.i"], "k.", ms=3, label="ends of steps")
    axes[0].legend(loc="upper right", fontsize=8, ncols=2)
    axes[1].plot(time, found["v_dc"], lw=1.0)
    axes[0].set_xlim(1e3 * CASE["t_end"] - 1.5, 1e3 * CASE["t_end"])
    for axis, label in zip(axes, ("choke, A", "bus, V"), strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[1].set_xlabel("time, ms")
    axes[0].set_title("Boost leg in discontinuous conduction, 5 kHz; steps of 30 us", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("boost.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
