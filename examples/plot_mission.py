"""What the ferry does in an hour: speed, power and charge of the whole mission in one figure.

    python examples/plot_mission.py [RESULTS] [--out FIGURE.png]

Reads the output folder of `shipgrid run` (default `results/mission-averaged`), or sails the mission if there is none.
"""

# %% One import for the simulator, one for the figure.
from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import shipgrid as sg

KNOT = 1852.0 / 3600.0


# %% Every signal is an xarray with its unit; a figure is a choice of them.
def draw(run: sg.Results, path: Path) -> None:
    """Draw the mission's figure into a file.

    Parameters
    ----------
    run : Results
        Results of the mission.
    path : Path
        Image file to write.
    """
    panels = (
        ("ship speed, kn", 1 / KNOT, {"hull.u_ship": "ship"}),
        ("DC bus, V", 1.0, {"dc_for.v_dc": "fore", "dc_aft.v_dc": "aft"}),
        ("battery current, A", 1.0, {"bess_for.i_b": "fore", "bess_aft.i_b": "aft"}),
        ("state of charge, %", 100.0, {"bess_for.soc": "fore", "bess_aft.soc": "aft"}),
        ("genset power, kW", 1e-3, {"genset_for.p_ac": "fore", "genset_aft.p_ac": "aft"}),
        ("thrust a screw, kN", 1e-3, {"propeller_for.thrust": "fore", "propeller_aft.thrust": "aft"}),
    )
    figure, axes = plt.subplots(len(panels), 1, sharex=True, figsize=(8.0, 9.0), constrained_layout=True)
    for axis, (label, factor, signals) in zip(axes, panels, strict=True):
        for k, (name, side) in enumerate(signals.items()):
            series = run[name]
            axis.plot(series["time"] / 60.0, series * factor, lw=1.1, ls=("-", "--")[k], label=side)
        axis.set_ylabel(label, fontsize=8)
        axis.grid(alpha=0.3)
        if "genset" in label:
            axis.legend(loc="upper center", fontsize=8, ncols=2)  # the same for all panels
    axes[-1].set_xlabel("time, min")
    axes[0].set_title("Intra - Laveno and back: 6 kn on batteries, 10 kn on one genset with recharge", fontsize=9)
    figure.savefig(path, dpi=130)
    plt.close(figure)


# %% Sail it, or read what was sailed.
def main() -> None:
    """Read or run, and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", nargs="?", default="results/mission-averaged", type=Path)
    parser.add_argument("--out", default=Path("mission.png"), type=Path)
    chosen = parser.parse_args()
    if chosen.results.exists():
        run = sg.open_results(chosen.results)
    else:
        run = sg.simulate(sg.load_ship("ferry"), sg.load_scenario("mission"), out=chosen.results)
    draw(run, chosen.out)


if __name__ == "__main__":
    main()
