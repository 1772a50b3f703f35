"""The steps of `shipgrid bench` beside those of a run, in turn: `python benchmarks/bench_and_run.py`.

The mission before its first command, at 30 us. A run records, looks at the clock and writes snapshots and rows besides,
so that it takes a little longer. Also what it takes to enter a crew, which every return to Python pays for. Figures in
docs/benchmarks.md.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import shipgrid as sg
from shipgrid.assembly.crew import Crew
from shipgrid.cli.bench_case import spell_times
from shipgrid.scenarios import simulate as simulation

STEP = 30e-6
SAILED = 9.0
"""Simulated time [s] of a run; the first command comes at 10 s."""


def entering(plan, work, times: int = 20) -> float:
    """Median time [ms] to enter a crew and leave it."""
    took = []
    for _ in range(times):
        began = time.perf_counter()
        with Crew(plan, work):
            pass
        took.append(1e3 * (time.perf_counter() - began))
    return statistics.median(took)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    ship, scenario, find_start = sg.load_ship("ferry"), sg.load_scenario("mission"), simulation.start
    print(f"us a step, medians of {rounds} rounds: bench, run, and the median of each round's ratio; entering in ms")
    for fidelity in ("averaged", "switching"):
        plan = simulation.build(ship, STEP, fidelity, scenario.rules)
        begun, drift = find_start(plan, ship, scenario)
        simulation.start = lambda *_, begun=begun, drift=drift: (begun.snapshot(), drift)  # searched for once
        benched, ran = [], []
        for _ in range(rounds):
            benched.append(spell_times(plan, begun.snapshot())["median_us"])
            with tempfile.TemporaryDirectory() as folder:
                how = {"fidelity": fidelity, "step": STEP, "until": SAILED, "report": False}
                with sg.simulate(ship, scenario, out=Path(folder) / "run", **how) as results:
                    ran.append(results.summary["us_per_step"])
        ratio = statistics.median(run / bench for bench, run in zip(benched, ran, strict=True))
        medians = f"{statistics.median(benched):6.2f} {statistics.median(ran):6.2f} {ratio:6.3f}"
        print(f"{fidelity:10s} {medians}   {entering(plan, begun.snapshot()):6.3f}")


if __name__ == "__main__":
    main()
