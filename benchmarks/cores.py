"""Time of a step of a plant in parts, by the number of threads, beside the uncut plant: `python benchmarks/cores.py`.

The ferry in two and three parts, and two DC buses with more and more inverters, cut between them. Medians over spells,
all cases in turn, so that a noisy spell of the machine meets all of them; figures in docs/benchmarks.md.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time

import shipgrid as sg
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.crew import Crew, cores
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.workspace import Workspace, new_workspace
from shipgrid.components.electrical.cable import dc_cable
from shipgrid.scenarios.case import build
from shipgrid.scenarios.start import start

STEP = 30e-6
SPELL = 2000
UNDER_WAY = {"genset_for.on": 1, "genset_aft.on": 1, "propulsion_for.speed_ref": 3.0, "propulsion_aft.speed_ref": 3.0}
FERRY = {
    "2 parts": {"for": ["dc_for"], "aft": ["dc_aft", "ac_for", "ac_aft"]},
    "3 parts": {"for": ["dc_for"], "aft": ["dc_aft"], "grid": ["ac_for", "ac_aft"]},
}


def ferry(fidelity: str) -> dict[str, tuple[Plan, Workspace]]:
    """The ferry under way, uncut and in parts."""
    ship, scenario = sg.load_ship("ferry"), sg.load_scenario("mission")
    found = {}
    for name, parts in {"uncut": None, **FERRY}.items():
        plan = build(ship, STEP, fidelity, parts=parts)
        work, _ = start(plan, ship, scenario)
        for command, value in UNDER_WAY.items():
            work.sig[plan.layout.index[f"command:{command}"]] = value
        found[f"ferry, {name}"] = plan, work
    return found


def row(inverters: int) -> dict[str, tuple[Plan, Workspace]]:
    """Two DC buses with half of the inverters each, filters and loads behind them, and a cable between the buses."""
    net = sg.Network(f"{inverters} inverters")
    lcl = sg.LclFilter.per_unit(50e3, 400.0, 60.0, L_1=0.10, C=0.06, L_2=0.05)
    sampling = sg.Sampled(3240.0)
    buses = [net.dc_bus(f"dc_{side}", v_n=750.0) for side in range(2)]
    for side, dc in enumerate(buses):
        net.capacitance(dc, 1e-3 * inverters)
        net.add(f"source_{side}", sg.InductiveDcSource(v_0=750.0, R=0.2 / inverters, L=200e-6 / inverters), a=dc)
        net.add(f"carrier_{side}", sg.Carrier(), clock=sg.Sampled(1620.0))
        for k in range(side, inverters, 2):
            ac = net.ac_bus(f"ac_{k}", v_n=400.0, f_n=60.0)
            wave = sg.SineModulation(f_n=60.0, phase=2.0 * math.pi * k / inverters)
            net.add(f"modulation_{k}", wave, inputs={"m": 0.9}, clock=sampling)
            reference = {f"s_{axis}_ref": f"modulation_{k}.s_{axis}" for axis in ("alpha", "beta")}
            carrier = {name: f"carrier_{side}.{name}" for name in ("phase", "phase_next", "turns")}
            net.add(f"modulator_{k}", sg.TimeStampedBridge(), inputs=reference | carrier, clock=sampling)
            bridge = net.bridge(f"bridge_{k}", sg.TwoLevelBridge(), dc, modulator=f"modulator_{k}")
            net.add(f"filter_{k}", lcl, converter=bridge, grid=ac)
            net.add(f"load_{k}", sg.Resistor(R=6.4), a=ac)
    net.add("cable", dc_cable(30.0), a=buses[0], b=buses[1])
    found = {}
    for name, parts in {"uncut": None, "2 parts": {"one": ["dc_0"], "other": ["dc_1"]}}.items():
        plan = assemble(net, STEP, parts=parts)
        work = new_workspace(plan)
        work.sig[[plan.layout.index[f"dc_{side}.v_dc"] for side in range(2)]] = 750.0
        settle_outputs(plan, work)
        found[f"{inverters} inverters, {name}"] = plan, work
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fidelity", default="switching", help="of the ferry")
    parser.add_argument("--rounds", type=int, default=15)
    chosen = parser.parse_args()
    cases = ferry(chosen.fidelity)
    for inverters in (8, 16, 32, 64):
        cases |= row(inverters)
    found: dict[tuple[str, int], list[float]] = {}
    for _ in range(chosen.rounds):
        for name, (plan, work) in cases.items():
            for workers in range(1, min(len(plan.parts), len(cores())) + 1) if plan.parts else [1]:
                with Crew(plan, work, workers) as crew:
                    crew(100, work.n)
                    began = time.perf_counter()
                    done = crew(SPELL, work.n + 100)
                    took = time.perf_counter() - began
                assert done == SPELL, f"{name} failed"
                work.n += SPELL + 100
                work.step.rows[:], work.step.event_count[0] = 0, 0
                found.setdefault((name, workers), []).append(1e6 * took / SPELL)
    print(f"{len(cores())} cores; us a step: median, least of {chosen.rounds}; over the uncut plant's median")
    for (name, workers), times in found.items():
        uncut = statistics.median(found[name.split(",")[0] + ", uncut", 1])
        median = statistics.median(times)
        threads = "1 thread" if workers == 1 else f"{workers} threads"
        print(f"{name:24s} {threads:10s} {median:7.2f} {min(times):7.2f}   {median / uncut:5.2f}")


if __name__ == "__main__":
    main()
