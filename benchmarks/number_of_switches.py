"""How start-up and step time grow with the number of switching inverters on one DC bus, each with its own load.

    python benchmarks/number_of_switches.py [--out FIGURE.png] [NUMBER ...]

Every number of inverters (two-level, 1620 Hz carrier, LCL filter, resistive load; six switches each) is built and
stepped in a process of its own. Start-up is the time from the import to the end of the first step, the machine code
of earlier runs at hand: what is compiled depends on the kinds of components, not on how many there are. Steps are
30 us; their time is the median of several thousands, on one core. Of three processes each, in turn, the median counts.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

STEP, STEPS, ROUNDS, PROCESSES = 30e-6, 2000, 7, 3


def measure(number: int) -> dict[str, float]:
    """Build and step one circuit in this process."""
    began = time.perf_counter()
    import math

    import shipgrid as sg
    from shipgrid.assembly.assemble import assemble
    from shipgrid.assembly.code_store import core
    from shipgrid.assembly.start import settle_outputs
    from shipgrid.assembly.tables import arguments
    from shipgrid.assembly.workspace import new_workspace

    net = sg.Network(f"{number} inverters")
    dc = net.dc_bus("dc", v_n=750.0)
    net.capacitance(dc, 2e-3 * number)
    net.add("source", sg.InductiveDcSource(v_0=750.0, R=0.1 / number, L=100e-6 / number), a=dc)
    sampling = sg.Sampled(3240.0)
    net.add("carrier", sg.Carrier(), clock=sg.Sampled(1620.0))
    carrier = {name: f"carrier.{name}" for name in ("phase", "phase_next", "turns")}
    lcl = sg.LclFilter.per_unit(50e3, 400.0, 60.0, L_1=0.10, C=0.06, L_2=0.05)
    for k in range(number):
        ac = net.ac_bus(f"ac_{k}", v_n=400.0, f_n=60.0)
        wave = sg.SineModulation(f_n=60.0, phase=2.0 * math.pi * k / number)
        net.add(f"modulation_{k}", wave, inputs={"m": 0.9}, clock=sampling)
        reference = {f"s_{axis}_ref": f"modulation_{k}.s_{axis}" for axis in ("alpha", "beta")}
        net.add(f"modulator_{k}", sg.TimeStampedBridge(), inputs=reference | carrier, clock=sampling)
        bridge = net.bridge(f"bridge_{k}", sg.TwoLevelBridge(), dc, modulator=f"modulator_{k}")
        net.add(f"filter_{k}", lcl, converter=bridge, grid=ac)
        net.add(f"load_{k}", sg.Resistor(R=6.4), a=ac)
    plan = assemble(net, STEP)
    work = new_workspace(plan)
    work.sig[plan.layout.index["dc.v_dc"]] = 750.0
    settle_outputs(plan, work)
    entry, values = core(), arguments(plan, work)
    entry(1, 0, *values)
    started = time.perf_counter() - began
    done, found = 1, []
    for _ in range(ROUNDS):
        at = time.perf_counter()
        assert entry(STEPS, done, *values) == STEPS
        found.append((time.perf_counter() - at) / STEPS)
        work.step.rows[:] = 0
        done += STEPS
    return {"number": number, "start_s": started, "step_us": 1e6 * median(found)}


def in_process(number: int) -> dict[str, float]:
    """The same in a process of its own."""
    command = [sys.executable, __file__, "--one", str(number)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def draw(rows: list[dict[str, float]], path: Path) -> None:
    """Draw both times over the number of inverters into a file."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(8.5, 3.6), constrained_layout=True)
    for axis, key, label in zip(axes, ("step_us", "start_s"), ("step, us", "start-up, s"), strict=True):
        axis.plot([row["number"] for row in rows], [row[key] for row in rows], "o-")
        axis.set_xlabel("inverters of six switches")
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0.0)
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measure every number, print the table, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("numbers", nargs="*", type=int, default=[2, 4, 8, 16, 32, 64], metavar="NUMBER")
    parser.add_argument("--out", default=Path("number_of_switches.png"), type=Path)
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.one is not None:
        print(json.dumps(measure(chosen.one)))
        return
    in_process(chosen.numbers[0])  # it may have to compile
    rounds = [[in_process(number) for number in chosen.numbers] for _ in range(PROCESSES)]
    rows = [{key: median(row[key] for row in same) for key in same[0]} for same in zip(*rounds, strict=True)]
    print("inverters   start-up, s   step, us   step per inverter, us")
    for row in rows:
        print(
            f"{row['number']:9.0f} {row['start_s']:13.2f} {row['step_us']:10.2f} {row['step_us'] / row['number']:23.3f}"
        )
    draw(rows, chosen.out)


if __name__ == "__main__":
    main()
