"""How long may the step of the mission be? Settled means at several steps, against those at 30 us.

    python benchmarks/step_length.py [--until 700] [STEP_US ...]

Runs the ferry's mission up to 700 s (moored, 6 kn on batteries, 10 kn on one genset) once a step length and prints,
for each, the largest difference of the mean of every public signal in three settled windows from the run at 30 us,
relative to the signal's nominal size, and the wall-clock time. The table in docs/decisions/0005-mission-step.md was
made by it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import shipgrid as sg

WINDOWS = {"moored": (2.0, 9.0), "6 kn": (250.0, 305.0), "10 kn": (600.0, 699.0)}
SCALE = {
    "V": 750.0,
    "A": 128.0,
    "W": 596e3,
    "var": 596e3,
    "Hz": 60.0,
    "rad/s": 47.12,
    "N m": 5730.0,
    "N": 20e3,
    "m": 7e3,
}
SCALE |= {"m/s": 5.144, "m/s2": 0.0257, "1": 1.0}


def nominal(name: str, unit: str) -> float:
    """Size that a difference is relative to: the hotel grid's powers against 50 kVA, all others against the table."""
    return 50e3 if unit in ("W", "var") and name.startswith(("inverter", "hotel", "bess")) else SCALE[unit]


def means(run: sg.Results) -> dict[tuple[str, str], float]:
    """Mean of every public signal in every window."""
    found = {}
    for window, (start, end) in WINDOWS.items():
        for name in run.signals:
            if name.endswith((".mode", "distance", "soc")):
                continue
            series = run[f"{name}_mean"].sel(time=slice(start, end))
            if len(series):
                found[window, name] = float(series.mean())
    return found


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", nargs="*", type=float, default=[30.0, 60.0, 100.0, 120.0, 150.0], metavar="STEP_US")
    parser.add_argument("--until", type=float, default=700.0)
    chosen = parser.parse_args()
    ship = sg.load_ship("ferry")
    scenario = sg.load_scenario("mission")
    reference = None
    with tempfile.TemporaryDirectory() as folder:
        for step_us in chosen.steps:
            out = Path(folder) / f"{step_us:g}"
            run = sg.simulate(ship, scenario, step=step_us * 1e-6, until=chosen.until, out=out, report=False)
            now = means(run)
            reference = reference or now
            wall = run.summary["wall_s"]
            sys.stdout.write(f"{step_us:6g} us  wall {wall:7.1f} s  {run.summary['us_per_step']:.2f} us a step\n")
            for window in WINDOWS:
                differences = {
                    name: abs(now[w, name] - reference[w, name]) / nominal(name, run[name].attrs["units"])
                    for w, name in now
                    if w == window
                }
                worst = sorted(differences.items(), key=lambda item: -item[1])[:3]
                text = ", ".join(f"{name} {100 * value:.4f} %" for name, value in worst)
                sys.stdout.write(f"          {window:7s} {text}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
