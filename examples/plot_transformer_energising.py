"""Switching on an unloaded Dyn11 transformer at a bad instant: flux offset, and the inrush that iron makes of it.

    python examples/plot_transformer_energising.py [--out FIGURE.png]

The flux of a phase is the integral of its voltage. Switched on where the voltage of phase a passes through zero, its
flux runs from zero to twice the rated peak: without saturation the magnetising current shows just that, and the
offset decays with the time constant of magnetising inductance and resistance. In iron with a knee at 1.2 times the
rated flux the same offset calls for an inrush current above the rated one, in pulses of one sign; and since those
pulses lose voltage in the resistances, the offset is gone sooner.
"""

# %% One import for the simulator, one for the figure.
from __future__ import annotations

import argparse
import math
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import shipgrid as sg

V_1, V_2, F, RATING = 400.0, 230.0, 60.0, 50e3  # V, V, Hz, VA
CLOSED = 0.02 + 0.25 / F  # s: phase a, a cosine, passes through zero
GRID = sg.ThreePhaseSource(v_n=V_1, f_n=F, R=0.01, L=50e-6, phase=-2.0 * math.pi * F * 0.02)
TRANSFORMER = sg.Transformer.per_unit(RATING, V_1, V_2, F, group="Dyn11", X=0.04, R=0.02, X_m=20.0, R_m=100.0)
IRON = sg.SaturableTransformer.per_unit(
    RATING, V_1, V_2, F, group="Dyn11", X=0.04, R=0.02, X_m=20.0, R_m=100.0, knee=1.2, X_sat=0.32
)


# %% Grid, breaker, transformer: three lines of a one-line diagram.
def simulate(step: float = 30e-6, item: sg.Transformer | sg.SaturableTransformer = TRANSFORMER) -> sg.CircuitRun:
    """Close the breaker, and look at half a second.

    Parameters
    ----------
    step : float
        Step length [s].
    item : Transformer or SaturableTransformer
        What is switched on.
    """
    net = sg.Network("transformer energising")
    grid = net.ac_bus("grid", v_n=V_1, f_n=F)
    primary, secondary = net.ac_bus("primary", v_n=V_1, f_n=F), net.ac_bus("secondary", v_n=V_2, f_n=F)
    net.add("supply", GRID, a=grid)
    net.add("breaker", sg.Breaker(), a=grid, b=primary, contact="open")
    net.add("transformer", item, primary=primary, secondary=secondary)
    plan = sg.assemble(net, step=step)
    return plan.run(events=[sg.At(CLOSED, sg.Close("breaker"))], until=0.5)


# %% One figure: voltage, flux, the inrush of a core that saturates, and the 30 degrees of the vector group.
def draw(run: sg.CircuitRun, path: Path) -> None:
    """Draw primary voltage, flux, inrush current and secondary voltage into a file."""
    figure, axes = plt.subplots(4, 1, figsize=(7.5, 9.5), constrained_layout=True)
    peak_1, peak_2 = (math.sqrt(2.0 / 3.0) * v for v in (V_1, V_2))
    rated_flux = peak_1 / (2.0 * math.pi * F)
    voltage, flux = run.phases("primary.v"), TRANSFORMER.L_m * run.phases("transformer.i_m")
    for k, name in enumerate("abc"):
        axes[0].plot(1e3 * voltage["time"], voltage[k] / peak_1, lw=1.0, label=f"phase {name}")
        axes[1].plot(1e3 * flux["time"], flux[k] / rated_flux, lw=1.0)
    axes[0].set_xlim(15.0, 75.0)
    axes[0].set_ylabel("primary voltage, pu")
    axes[0].legend(loc="upper right", fontsize=8, ncols=3)
    axes[1].set_ylabel("flux, pu of rated peak")
    axes[1].set_xlim(0.0, 500.0)
    inrush, rated = simulate(item=IRON).phases("transformer.primary.i"), math.sqrt(2.0 / 3.0) * RATING / V_1
    for k in range(3):
        axes[2].plot(1e3 * inrush["time"], inrush[k] / rated, lw=1.0)
    axes[2].set_ylabel("current with a knee\nat 1.2 pu, pu of rated peak")
    axes[2].set_xlim(0.0, 500.0)
    late = voltage["time"] > 0.48
    for stem, peak, label in (("primary.v", peak_1, "primary"), ("secondary.v", peak_2, "secondary, open")):
        series = run.phases(stem)[0][late]
        axes[3].plot(1e3 * series["time"], series / peak, lw=1.2, label=label)
    axes[3].set_ylabel("phase a, pu")
    axes[3].legend(loc="upper right", fontsize=8)
    axes[0].set_title("Dyn11, 50 kVA, closed where phase a passes through zero", fontsize=10)
    for axis, top in zip(axes, (1.7, 1.8, None, 1.6), strict=True):
        axis.set_ylim(top=top)
        axis.set_xlabel("time, ms")
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("transformer_energising.png"), type=Path)
    draw(simulate(), parser.parse_args().out)
