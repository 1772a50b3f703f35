"""A voltage step on a series R-L-C circuit, beside its closed form.

python examples/plot_rlc_step.py [--out FIGURE.png]
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

E, R, L, C = 100.0, 0.5, 1e-3, 100e-6  # V, ohm, H, F
CLOSED = 1e-3  # s
R_SOURCE = 0.1  # ohm, of R


# %% The circuit as its diagram has it: a source, a choke with a contact, a capacitor across the far bus.
def simulate(step: float = 30e-6) -> sg.CircuitRun:
    """Close the contact after a millisecond, and look at 20.

    Parameters
    ----------
    step : float
        Step length [s].
    """
    net = sg.Network("R-L-C step")
    feed, far = net.dc_bus("feed", v_n=E), net.dc_bus("far", v_n=E)
    net.add("source", sg.DcSource(v_0=E, R=R_SOURCE), a=feed)
    net.add("choke", sg.RlBranch(R=R - R_SOURCE, L=L), a=feed, b=far, contact="open")
    net.capacitance(far, C)
    plan = sg.assemble(net, step=step)
    return plan.run(events=[sg.At(CLOSED, sg.Close("choke"))], until=21e-3)


# %% A damped oscillation.
def closed_form(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Capacitor voltage [V] and current [A] at the times `t` [s] after closing."""
    a = R / (2.0 * L)
    w = np.sqrt(1.0 / (L * C) - a**2)
    decay, t = np.exp(-a * np.maximum(t, 0.0)), np.maximum(t, 0.0)
    return E * (1.0 - decay * (np.cos(w * t) + a / w * np.sin(w * t))), E / (w * L) * decay * np.sin(w * t)


# %% One figure.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw voltage and current, and their closed form, into a file."""
    figure, axes = plt.subplots(2, 1, sharex=True, figsize=(7.0, 5.0), constrained_layout=True)
    t = np.linspace(0.0, 21e-3, 141)
    for axis, name, label, exact in zip(
        axes, ("far.v_dc", "choke.i"), ("capacitor, V", "current, A"), closed_form(t - CLOSED), strict=True
    ):
        axis.plot(1e3 * run[name]["time"], run[name], lw=1.2, label="30 us steps")
        axis.plot(1e3 * t, exact, "k.", ms=3, label="closed form")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[0].legend(loc="lower right", fontsize=8)
    axes[1].set_xlabel("time, ms")
    axes[0].set_title("100 V on 0.5 ohm, 1 mH, 100 uF", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("rlc_step.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
