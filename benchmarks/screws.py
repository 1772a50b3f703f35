"""A screw in four quadrants: mirrored, and as tested facing astern and facing ahead.

    python benchmarks/screws.py [--out docs/figures/screws.png]

Prints the table of docs/theory/propulsion.md and draws its figure, CT* and CQ* over the hydrodynamic angle beta, for
the ferry's screw. Against the flow, beta from 90 to 180 degrees, a ship that goes ahead is braked.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from shipgrid.components.marine.propeller import Propeller, characteristic

SORTS = {0.0: "mirrored", 1.0: "facing astern", -1.0: "facing ahead"}


def coefficient(which: str, beta, ends: float) -> np.ndarray:
    """CT* ("T") or CQ* ("Q") of the ferry's screw at the angles `beta` [degrees]."""
    screw = Propeller()
    return characteristic(which, np.radians(np.asarray(beta, dtype=float)), ends, screw.P_D, screw.A_E, screw.Z)


def main() -> None:
    """Print the table, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("screws.png"))
    path = parser.parse_args().out
    print("| beta |", " | ".join(f"CT* {name} | 10 CQ*" for name in SORTS.values()), "|")
    print("|" + " --- |" * (1 + 2 * len(SORTS)))
    for beta in (0, 10, 20, 30, 60, 80, 90, 100, 110, 120, 130, 140, 150, 160, 168, 175, 180):
        pairs = [(coefficient("T", [beta], e)[0], 10.0 * coefficient("Q", [beta], e)[0]) for e in SORTS]
        print(f"| {beta} |", " | ".join(f"{c_t:.3f} | {c_q:.3f}" for c_t, c_q in pairs), "|")

    beta = np.arange(-180.0, 180.5, 0.5)
    figure, axes = plt.subplots(2, 1, sharex=True, figsize=(8.0, 7.0), constrained_layout=True)
    for axis, which in zip(axes, "TQ", strict=True):
        for (ends, name), style in zip(SORTS.items(), ("-", "--", ":"), strict=True):
            axis.plot(beta, coefficient(which, beta, ends), style, lw=1.8 if ends == 0.0 else 1.2, label=name)
        axis.axvspan(90.0, 180.0, color="tab:orange", alpha=0.10)
        axis.axvspan(-90.0, 0.0, color="tab:orange", alpha=0.10)
        axis.set_ylabel(f"C{which}*")
        axis.grid(alpha=0.3)
    axes[0].legend(title="shaded: against the flow")
    axes[1].set_xlabel("beta, degrees")
    axes[1].set_xticks(range(-180, 181, 30))
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
