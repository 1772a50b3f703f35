"""How the ferry swings: its eigenvalues with one genset loaded, the dominant modes with their names.

    python examples/plot_modes.py [--out FIGURE.png]

Brings the ferry to rest at its mooring, starts a genset, finds the operating point and linearises the plant there.
"""

# %% One import for the simulator, one for the figure.
from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import shipgrid as sg
from shipgrid.analysis.settling import advance, run_to_rest
from shipgrid.scenarios.case import build


# %% A plant at rest: run until the genset has taken its share, then Newton's method.
def loaded_ferry() -> sg.OperatingPoint:
    """Operating point of the ferry at its mooring, genset fore on the bus."""
    ship = sg.load_ship("ferry")
    plan = build(ship, 90e-6)
    work, _ = run_to_rest(plan, sg.load_scenario("mission").start_commands(ship))
    work.sig[plan.layout.index["command:genset_for.on"]] = 1.0
    advance(plan, work, 25.0)
    return sg.steady_state(plan, start=work)


# %% Modes of what is on: an exciter that is switched off decays by itself and says nothing about the plant.
def main() -> None:
    """Linearise, print the modes, draw them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=Path("modes.png"), type=Path)
    chosen = parser.parse_args()
    point = loaded_ferry()
    modes = sg.linearise(point.plan, point).modes().without("genset_aft", "rectifier_aft")
    print(modes)
    axes = modes.plot(label=12, window=(-2e3, 6e3))
    axes.set_title("Ferry at its mooring, genset fore on the bus", fontsize=10)
    axes.figure.savefig(chosen.out, dpi=130)
    plt.close(axes.figure)


if __name__ == "__main__":
    main()
