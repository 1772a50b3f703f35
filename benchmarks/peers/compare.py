"""The same circuits in DPsim, Pulsim and ngspice and here: do they agree, and how long do they take?

    pip install -e ".[peers]"        and ngspice from the system's packages
    python benchmarks/peers/compare.py [--rounds N]

Two circuits: an LCL filter between a sine source and a resistive load (DPsim), and the gallery's two-level inverter in
open loop, 1620 Hz, with LCL filter and load (Pulsim, ngspice; `examples/circuits/plot_inverter.py`). Each program is
first asked for its waves, and everything stops if they are not the same. Then all are timed in turn, round after round,
so that whatever else the machine does falls on all alike; the table has medians, of times and of each round's ratios.
Neither start-up nor what is compiled or factorised before the first step counts, but for ngspice, a process of its own.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np

import shipgrid as sg
from shipgrid.assembly.code_store import core
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
from verification.gallery import GALLERY, duty_ratios, example  # the circuit, and its netlist for ngspice

CYCLE = 1.0 / 60.0
STEP = 30e-6
OURS = "shipgrid"
LCL = {"R": 3e-3, "L_s": 0.2e-3, "L_1": 0.561e-3, "R_d": 0.141, "C": 480e-6, "L_2": 92.3e-6, "R_load": 1.15}
INVERTER = GALLERY["inverter"].parameters
T_INVERTER = INVERTER["t_end"]
Wave = tuple[np.ndarray, np.ndarray]


@dataclass
class Entrant:
    """One program on one circuit.

    `wave` gives the times and values that are compared, `timed` the seconds it took, the steps it made and the seconds
    it simulated. `band` is how far its wave may lie from the reference.
    """

    name: str
    how: str
    wave: Callable[[], Wave]
    timed: Callable[[], tuple[float, int, float]]
    band: float
    seconds: list[tuple[float, float]] = field(default_factory=list)  # per step, per simulated second
    error: float = 0.0


def distance(wave: Wave, reference: Wave, end: float) -> float:
    """Root mean square of the difference over that of the reference, in the two cycles before `end`."""
    t = np.linspace(end - 2.0 * CYCLE, end - 1e-9, 4000)
    there, expected = np.interp(t, *wave), np.interp(t, *reference)
    return math.sqrt(np.mean((there - expected) ** 2) / np.mean(expected**2))


# --- shipgrid --------------------------------------------------------------------------------------------------------


def lcl_here() -> sg.Network:
    """Source behind part of the converter-side choke, filter, load."""
    net = sg.Network("lcl")
    source, out = (net.ac_bus(name, v_n=480.0, f_n=60.0) for name in ("source", "out"))
    net.add("grid", sg.ThreePhaseSource(v_n=480.0, R=LCL["R"], L=LCL["L_s"]), a=source)
    values = {name: LCL[name] for name in ("L_1", "R_d", "C", "L_2")}
    net.add("filter", sg.LclFilter(**values, R_1=0.0, R_2=0.0), converter=source, grid=out)
    net.add("load", sg.Resistor(R=LCL["R_load"]), a=out)
    return net


def here(net: sg.Network, record: str, end: float, start: dict[str, float], band: float, steps: int = 60000) -> Entrant:
    """A circuit of ours: every step as in any run, audit and limiter log included."""
    plan = sg.assemble(net, STEP)
    work = new_workspace(plan)
    for name, value in start.items():
        work.sig[plan.layout.index[name]] = value
    settle_outputs(plan, work)
    entry, values = core(), arguments(plan, work)
    work.n += entry(1, work.n, *values)

    def wave() -> Wave:
        found = plan.run(start, until=end, record=[record])[record]
        return found["time"].values, found.values

    def timed() -> tuple[float, int, float]:
        began = time.perf_counter()
        done = entry(steps, work.n, *values)
        took = time.perf_counter() - began
        assert done == steps
        work.n += done
        work.step.rows[:] = 0
        return took, steps, steps * STEP

    return Entrant(OURS, "30 us", wave, timed, band)


# --- DPsim -----------------------------------------------------------------------------------------------------------


def dpsim_lcl(steps: int = 50000) -> Entrant:
    """Three-phase EMT nodal analysis with the trapezoidal rule, sparse factorisation once."""
    import dpsimpy

    emt, three = dpsimpy.emt, dpsimpy.Math.single_phase_parameter_to_three_phase

    def simulation(n: int, log: str | None = None):
        nodes = [emt.SimNode(f"n{k}", dpsimpy.PhaseType.ABC) for k in range(5)]
        ground = emt.SimNode.gnd
        source = emt.ph3.VoltageSource("source")
        source.set_parameters(V_ref=dpsimpy.Math.single_phase_variable_to_three_phase(480.0 + 0j), f_src=60.0)
        source.connect([ground, nodes[0]])
        parts = [source]
        # in series there and here alike: of the two chokes it makes one, which is fewer nodes
        for name, kind, letter, value, a, b in (
            ("r", emt.ph3.Resistor, "R", LCL["R"], nodes[0], nodes[1]),
            ("l_1", emt.ph3.Inductor, "L", LCL["L_s"] + LCL["L_1"], nodes[1], nodes[2]),
            ("r_d", emt.ph3.Resistor, "R", LCL["R_d"], nodes[2], nodes[3]),
            ("c", emt.ph3.Capacitor, "C", LCL["C"], nodes[3], ground),
            ("l_2", emt.ph3.Inductor, "L", LCL["L_2"], nodes[2], nodes[4]),
            ("load", emt.ph3.Resistor, "R", LCL["R_load"], nodes[4], ground),
        ):
            part = kind(name)
            part.set_parameters(**{letter: three(value)})
            part.connect([a, b])
            parts.append(part)
        made = dpsimpy.Simulation("lcl", dpsimpy.LogLevel.off)
        made.set_system(dpsimpy.SystemTopology(60.0, nodes, parts))
        made.set_domain(dpsimpy.Domain.EMT)
        made.set_time_step(STEP)
        made.set_final_time(n * STEP)
        if log is not None:
            logger = dpsimpy.Logger(log)
            logger.log_attribute("v", "v", nodes[4])
            made.add_logger(logger)
        return made

    def wave() -> Wave:
        simulation(round(0.1 / STEP), "waves").run()
        table = np.genfromtxt("logs/waves.csv", delimiter=",", skip_header=1)
        return table[:, 0], table[:, 1]

    def timed() -> tuple[float, int, float]:
        took = []
        for n in (100, 100 + steps):  # `run` begins with the factorisation
            made = simulation(n)
            began = time.perf_counter()
            made.run()
            took.append(time.perf_counter() - began)
        return took[1] - took[0], steps, steps * STEP

    return Entrant("DPsim", "30 us, trapezoidal", wave, timed, 1e-3)


# --- Pulsim ----------------------------------------------------------------------------------------------------------


def pulsim_inverter(step: float | None, seconds: float, band: float) -> Entrant:
    """Fixed steps, the gates of each as they are in its middle; without a step its variable-step rule, edges found."""
    import pulsim

    p = INVERTER
    b = pulsim.CircuitBuilder()
    b.add_voltage_source("e", "e", "gnd", p["e"])
    b.add_resistor("r_s", "e", "e1", p["R_s"])
    b.add_inductor("l_s", "e1", "dc", p["L_s"])
    b.add_capacitor("c_dc", "dc", "gnd", p["C_dc"], p["e"])
    for k in "abc":
        b.add_switch(f"up_{k}", "dc", f"p{k}", 1.0 / p["R_on"], 1e-9)
        b.add_switch(f"lo_{k}", f"p{k}", "gnd", 1.0 / p["R_on"], 1e-9)
        b.add_resistor(f"r_1{k}", f"p{k}", f"x{k}", p["R_1"] - p["R_on"])
        b.add_inductor(f"l_1{k}", f"x{k}", f"y{k}", p["L_1"])
        b.add_resistor(f"r_d{k}", f"y{k}", f"z{k}", p["R_d"])
        b.add_capacitor(f"c_{k}", f"z{k}", "star", p["C"])
        b.add_resistor(f"r_2{k}", f"y{k}", f"w{k}", p["R_2"])
        b.add_inductor(f"l_2{k}", f"w{k}", f"o{k}", p["L_2"])
        b.add_resistor(f"load_{k}", f"o{k}", "neutral", p["R_load"])
    b.add_resistor("star", "star", "gnd", 1e6)
    b.add_resistor("neutral", "neutral", "gnd", 1e6)

    masks = []
    for bits in range(8):
        mask = pulsim.SwitchStateMask(6)
        for j, k in enumerate("abc"):
            mask.set(b.switch_index_of(f"up_{k}"), bool(bits >> j & 1))
            mask.set(b.switch_index_of(f"lo_{k}"), not bits >> j & 1)
        masks.append(mask)
    instants = np.arange(round(max(seconds, T_INVERTER) * p["f_sample"]) + 2) / p["f_sample"]
    angle = 2.0 * math.pi * p["f"] * instants
    duty = duty_ratios(p["m"] * np.cos(angle), p["m"] * np.sin(angle))
    rows = duty.T.tolist()

    def gates(t: float):
        """Gates at a time: regular sampling against the triangle, as in the netlist."""
        a, b, c = rows[int(t * p["f_sample"] + 1e-9)]
        turn = t * p["f_sw"]
        carrier = abs(2.0 * (turn - int(turn)) - 1.0)
        return masks[(a > carrier) | (b > carrier) << 1 | (c > carrier) << 2]

    began = [0.0]

    def simulate(end: float, store: int):
        if step is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # slivers between two edges that lie closer than its least step
                return pulsim.simulate(b, t_end=end, engine="trbdf2", rtol=1e-3, switch_fn=gates)
        schedule = [gates((k + 0.5) * step) for k in range(round(end / step) + 1)]
        per_second = 1.0 / step
        began[0] = time.perf_counter()  # its own modulators do not sample regularly: a table is the cheapest for it
        return pulsim.simulate(
            b,
            t_end=end,
            dt=step,
            engine="pwl",
            store_every=store,
            switch_fn=lambda t: schedule[int(t * per_second + 0.5)],
        )

    def wave() -> Wave:
        found = simulate(T_INVERTER, 1)
        return np.asarray(found.times), np.asarray(found.i("l_2a"))

    def timed() -> tuple[float, int, float]:
        began[0] = time.perf_counter()
        found = simulate(seconds, 1000)
        took = time.perf_counter() - began[0]
        return took, len(found.times) - 1 if step is None else round(seconds / step), seconds

    how = "variable step, TR-BDF2" if step is None else f"{1e6 * step:.0f} us, edges at ends of steps"
    return Entrant("Pulsim", how, wave, timed, band)


# --- ngspice ---------------------------------------------------------------------------------------------------------


def ngspice_inverter() -> Entrant:
    """The netlist of the gallery: steps of 0.2 us at most, and edges found."""
    last: dict[str, np.ndarray] = {}

    def solve() -> None:
        last.update(GALLERY["inverter"].solve())

    def timed() -> tuple[float, int, float]:
        began = time.perf_counter()
        solve()
        return time.perf_counter() - began, len(last["time"]) - 1, T_INVERTER

    def wave() -> Wave:
        solve()
        return last["time"], last["i_2"]

    return Entrant("ngspice", "0.2 us at most", wave, timed, 0.0)


# --- the comparison --------------------------------------------------------------------------------------------------


def agree(title: str, entrants: list[Entrant], reference: Entrant, end: float) -> None:
    """Stop if two programs do not give the same wave."""
    expected = reference.wave()
    for one in entrants:
        one.error = distance(expected if one is reference else one.wave(), expected, end)
        if one.error > one.band:
            sys.exit(
                f"{title}: {one.name} ({one.how}) lies {one.error:.2%} from {reference.name}: not the same circuit"
            )


def table(title: str, entrants: list[Entrant], reference: Entrant) -> None:
    """Print medians, and ratios to ours."""
    print(f"\n{title}\n")
    print(f"| program | how | us a step | ratio | s per simulated second | ratio | from {reference.name} |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    ours = entrants[0]
    for one in entrants:
        step, second = (median(row[k] for row in one.seconds) for k in range(2))
        by_step, by_second = (
            median(a[k] / b[k] for a, b in zip(one.seconds, ours.seconds, strict=True)) for k in range(2)
        )
        print(
            f"| {one.name} | {one.how} | {1e6 * step:.2f} | {by_step:.2g} | {second:.3g} | {by_second:.2g} "
            f"| {one.error:.1e} |"
        )


def main() -> None:
    """Compare, then time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", default=7, type=int)
    rounds = parser.parse_args().rounds
    inverter = here(example("inverter").circuit(), "filter.alpha.i_2", T_INVERTER, {"dc.v_dc": INVERTER["e"]}, 1e-3)
    lcl = [here(lcl_here(), "out.v_alpha", 0.1, {}, 0.0), dpsim_lcl()]
    spice = ngspice_inverter()
    bridges = [
        inverter,
        pulsim_inverter(STEP, 1.8, 0.05),
        pulsim_inverter(1e-6, 0.1, 2e-3),
        pulsim_inverter(None, T_INVERTER, 2e-3),
        spice,
    ]
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # DPsim writes its logs here
        agree("LCL filter", lcl, lcl[0], 0.1)
        agree("inverter", bridges, spice, T_INVERTER)
        for k in range(rounds):
            for one in (*lcl, *bridges):
                if one is spice and k % 3:
                    one.seconds.append(one.seconds[-1])  # seconds a run: every third round
                    continue
                took, steps, simulated = one.timed()
                one.seconds.append((took / steps, took / simulated))
        os.chdir("/")
    table("LCL filter on a sine source", lcl, lcl[0])
    table("1620 Hz inverter, LCL filter, load", bridges, spice)
    busy = os.getloadavg()[0]
    print(f"\n{rounds} rounds in turn; load of the machine {busy:.1f} on {os.cpu_count()} cores.")


if __name__ == "__main__":
    main()
