"""What the DC bus of the ferry looks like to a small current: its impedance, with and without a genset.

    python examples/plot_bus_impedance.py [--out FIGURE.png]

At low frequency it is the droops in parallel, at high frequency the capacitors; between them the controls.
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
from shipgrid.analysis.settling import advance, run_to_rest
from shipgrid.scenarios.case import build


# %% Two operating points of one plan.
def main() -> None:
    """Linearise at both, draw the impedance of the fore bus."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("bus_impedance.png"), type=Path)
    chosen = parser.parse_args()
    ship = sg.load_ship("ferry")
    plan = build(ship, 90e-6)
    work, _ = run_to_rest(plan, sg.load_scenario("mission").start_commands(ship))
    points = {"batteries": sg.steady_state(plan, start=work)}
    work.sig[plan.layout.index["command:genset_for.on"]] = 1.0
    advance(plan, work, 25.0)
    points["batteries and genset fore"] = sg.steady_state(plan, start=work)

    frequency = np.geomspace(0.05, 1000.0, 400)
    axes = None
    for name, point in points.items():
        response = sg.impedance(sg.linearise(plan, point), "dc_for", frequency)
        axes = response.plot(axes, lw=1.3, label=name)
    capacitance = 2.0 * plan.network.capacitances["dc_for.v_dc"]
    magnitude, _ = axes
    fast = frequency > 20.0
    magnitude.loglog(frequency[fast], 1.0 / (2.0 * np.pi * frequency[fast] * capacitance), "k:", lw=0.8,
                     label="capacitors of both sides")  # fmt: skip
    magnitude.legend(fontsize=8)
    magnitude.set_title("DC bus fore", fontsize=10)
    magnitude.figure.savefig(chosen.out, dpi=130)
    plt.close(magnitude.figure)


if __name__ == "__main__":
    main()
