"""How much hangs on what the reference paper leaves open? The mission's bands over one assumption at a time.

    python benchmarks/sensitivity.py [--until 620] [--out docs/figures/sensitivity.png]

Sails the mission's first 620 s (moored, 6 kn on batteries, a genset comes on, 10 kn with recharge) once a reading of an
open parameter, both halves of the ship alike, and prints a table in Markdown. Table and figure of
docs/sensitivity.md were made by it.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import shipgrid as sg
from shipgrid.errors import SolverError, SteadyStateError

AT_6_KN, AT_10_KN, GENSET_ON = (250.0, 305.0), (560.0, 620.0), (320.0, 620.0)
RPM = 30.0 / math.pi

CASES: dict[str, dict[str, str]] = {
    "as bundled": {},
    "capacitance of all DC sides halved": {
        "rectifier.C_dc": "5 mF",
        "propulsion.C_dc": "2.5 mF",
        "inverter.C_dc": "1 mF",
    },
    "capacitance doubled": {"rectifier.C_dc": "20 mF", "propulsion.C_dc": "10 mF", "inverter.C_dc": "4 mF"},
    "pitch P/D 0.8": {"propulsion.screw.P_D": "0.8"},
    "pitch P/D 1.0": {"propulsion.screw.P_D": "1.0"},
    "resistance as the paper's figure fits": {"hull.resistance": "paper_fit"},
    "rectifier filter: rule on phase voltage": {"rectifier.lcl_preset": "phase_voltage_rule"},
    "rectifier filter: compact": {"rectifier.lcl_preset": "compact"},
    "rectifier filter: by design rules": {"rectifier.lcl_preset": "design_rules"},
    "inverter filter of the paper": {"inverter.filter": "paper"},
    "inertia 0.17 s read as 2H": {"genset.inertia_H": "0.085 s"},
    "inertia doubled": {"genset.inertia_H": "0.34 s"},
    "T'd0 1.5 s": {"genset.machine.T_d01": "1.5 s"},
    "T'd0 3.5 s": {"genset.machine.T_d01": "3.5 s"},
    "exciter 0.17 s": {"genset.exciter.T_E": "0.17 s"},
    "DC droop by reading A": {"rectifier.dc_pi": "voltage"},
}
"""What is changed in each: keys of the items of both halves."""

# signal, factor to the unit shown, window, which figure of it, and the band of the reference
FIGURES: dict[str, tuple[str, float, tuple[float, float], str, tuple[float, float]]] = {
    "drive at 6 kn, kW": ("propulsion_for.p_dc", 1e-3, AT_6_KN, "mean", (14.5, 16.5)),
    "drive at 10 kn, kW": ("propulsion_for.p_dc", 1e-3, AT_10_KN, "mean", (68.8, 74.8)),
    "shaft at 10 kn, rpm": ("propulsion_for.omega_m", RPM, AT_10_KN, "mean", (301.0, 313.0)),
    "genset at 10 kn, pu": ("genset_for.p_pu", 1.0, AT_10_KN, "mean", (0.46, 0.56)),
    "DC bus at 10 kn, V": ("dc_for.v_dc", 1.0, AT_10_KN, "mean", (730.0, 737.0)),
    "recharge, A": ("bess_for.i_b", 1.0, AT_10_KN, "mean", (-80.0, -65.0)),
    "lowest DC bus, V": ("dc_for.v_dc", 1.0, (0.0, 620.0), "min", (715.0, 785.0)),
    "highest DC bus, V": ("dc_for.v_dc", 1.0, (0.0, 620.0), "max", (715.0, 785.0)),
    "lowest genset speed, pu": ("genset_for.omega_pu", 1.0, GENSET_ON, "min", (0.875, 1.0)),
    "swing of DC bus at 10 kn, V": ("dc_for.v_dc", 1.0, AT_10_KN, "swing", (0.0, 7.5)),
}


def sail(changes: dict[str, str], until: float) -> list[float] | str:
    """The figures of one run, or why there are none."""
    both = [
        (key if kind == "hull" else f"equipment.{kind}_{side}{key[len(kind) :]}", text)
        for key, text in changes.items()
        for kind in [key.partition(".")[0]]
        for side in (("for", "aft") if kind != "hull" else ("",))
    ]
    with tempfile.TemporaryDirectory() as folder:
        try:
            run = sg.simulate(
                sg.load_ship("ferry", both), sg.load_scenario("mission"), out=f"{folder}/run", until=until, report=False
            )
        except (SolverError, SteadyStateError) as wrong:
            return str(wrong)
        for event in run.events:
            if "refused" in event.text:
                return f"{event.source}: {event.text}"
        found = []
        for name, factor, (start, end), what, _ in FIGURES.values():
            part = {s: run[f"{name}_{s}"].sel(time=slice(start, end)) for s in ("min", "max", "mean")}
            value = {
                "mean": lambda p=part: p["mean"].mean(),
                "min": lambda p=part: p["min"].min(),
                "max": lambda p=part: p["max"].max(),
                "swing": lambda p=part: p["max"].max() - p["min"].min(),
            }[what]()
            found.append(factor * float(value))
        return found


def draw(rows: dict[str, list[float] | str], path: Path) -> None:
    """One panel a figure: every case as a point, the band as a bar behind them."""
    figure, axes = plt.subplots(2, 5, sharey=True, figsize=(15.0, 8.0), constrained_layout=True)
    names = list(rows)[::-1]
    for k, (axis, (label, (*_, band))) in enumerate(zip(axes.flat, FIGURES.items(), strict=True)):
        axis.axvspan(*band, color="tab:green", alpha=0.12)
        points = [(row[k], y) for y, name in enumerate(names) if not isinstance(row := rows[name], str)]
        axis.plot(*zip(*points, strict=True), "o", ms=5)
        axis.axvline(rows["as bundled"][k], color="0.5", lw=0.8)
        axis.set_xlabel(label, fontsize=9)
        axis.set_yticks(range(len(names)), names, fontsize=8)
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Sail every case, print the table, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--until", type=float, default=620.0)
    parser.add_argument("--out", type=Path, default=Path("sensitivity.png"))
    chosen = parser.parse_args()
    print("| reading |", " | ".join(FIGURES), "|")
    print("|" + " --- |" * (1 + len(FIGURES)))
    print("| *band* |", " | ".join(f"*{low:g} to {high:g}*" for *_, (low, high) in FIGURES.values()), "|")
    rows = {}
    for name, changes in CASES.items():
        rows[name] = sail(changes, chosen.until)
        cells = [rows[name]] if isinstance(rows[name], str) else [f"{value:.4g}" for value in rows[name]]
        print(f"| {name} |", " | ".join(cells), "|", flush=True)
    draw(rows, chosen.out)


if __name__ == "__main__":
    main()
