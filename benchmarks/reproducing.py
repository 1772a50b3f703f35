"""The figures of docs/reproducing.md, measured again from finished runs.

    shipgrid run mission
    python benchmarks/reproducing.py results/mission-averaged

Prints a line for each row of the page's tables, by the row's name there. Takes any number of folders of results, of the
scenarios mission, dc-regulation, ac-regulation and round-trips; what a run did not reach is a dash.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import shipgrid as sg
from shipgrid.units import KNOT

NMI = 1852.0
Rows = Iterator[tuple[str, str]]


class Look:
    """Values of a run's signals: at a time, and mean, lowest and highest of a span of time [s]."""

    def __init__(self, run: sg.Results):
        self.run = run

    def at(self, name: str, t: float) -> float:
        """Value recorded nearest to a time."""
        return float(self.run[name].sel(time=t, method="nearest"))

    def _span(self, name: str, ending: str, start: float, end: float) -> np.ndarray:
        return self.run[name + ending].sel(time=slice(start, end)).values.astype(float)

    def mean(self, name: str, start: float, end: float) -> float:
        """Mean of a span."""
        means = self._span(name, "_mean", start, end)
        return float(means.mean()) if len(means) else np.nan

    def low(self, name: str, start: float = 0.0, end: float = np.inf) -> float:
        """Lowest value of a span, of every step in it."""
        return float(self._span(name, "_min", start, end).min(initial=np.inf))

    def high(self, name: str, start: float = 0.0, end: float = np.inf) -> float:
        """Highest value of a span, of every step in it."""
        return float(self._span(name, "_max", start, end).max(initial=-np.inf))

    def when_highest(self, name: str, start: float = 0.0, end: float = np.inf) -> float:
        """Time of the highest value [s]."""
        series = self.run[name + "_max"].sel(time=slice(start, end))
        return float(series["time"].values[int(np.argmax(series.values))]) if series.size else np.nan

    def both(self, symbol: str, of: str) -> str:
        """Lowest and highest of both sides' signals over the whole run, `dc_{}.v_dc`."""
        names = [symbol.format(side) for side in ("for", "aft")]
        return f"{min(map(self.low, names)):{of}} to {max(map(self.high, names)):{of}}"

    def event(self, source: str, text: str, after: float = 0.0) -> float:
        """Time of the first event of a source that has a text [s]."""
        times = (e.time for e in self.run.events if e.source == source and text in e.text and e.time >= after)
        return next(times, np.nan)


def dc_regulation(r: Look) -> Rows:
    """Section 6.1, figure 10a."""
    yield "droop, tie opened", f"{r.at('dc_tie.i', 19.9):.1f} A interrupted, buses {r.both('dc_{}.v_dc', '.1f')} V"
    speed, power = r.mean("hull.u_ship", 470, 500) / KNOT, r.mean("propulsion_for.p_dc", 470, 500) / 1e3
    yield "6 kn on one unit", f"{speed:.2f} kn, {power:.1f} kW; highest {r.high('hull.u_ship') / KNOT:.2f} kn at "
    yield "", f"{r.when_highest('hull.u_ship'):.0f} s"
    yield "gensets connect", f"lowest bus {min(r.low('dc_for.v_dc', 43, 60), r.low('dc_aft.v_dc', 84, 100)):.1f} V"
    yield "joined", f"{1e3 * (r.event('dc_tie', 'closed', 179.0) - 180.0):.0f} ms after 180 s"
    for text, at in (("100 A, 50 A", 245), ("-20 A", 295), ("40 A", 345), ("again", 520), ("no genset", 545)):
        fore, aft = (r.mean(f"bess_{side}.i_b", at, at + 4) for side in ("for", "aft"))
        yield f"difference in droop, {text}", f"{fore - aft:.1f} A"
    for text, name, at in (
        ("for 0", "for", 395),
        ("for -20", "for", 490),
        ("aft 0", "aft", 445),
        ("aft 40", "aft", 490),
    ):
        yield f"current mode, {text} A", f"{r.mean(f'bess_{name}.i_b', at, at + 4):.3f} A"
    yield "bus in current mode", f"{r.low('dc_for.v_dc', 352, 499):.1f} to {r.high('dc_for.v_dc', 352, 499):.1f} V"
    yield "gensets off", f"{r.low('dc_for.v_dc', 530, 549):.1f} V"
    forming = r.mean("dc_for.v_dc", 580, 600), r.mean("dc_aft.v_dc", 580, 600)
    yield (
        "one battery forms",
        f"{forming[0]:.2f} and {forming[1]:.2f} V, lowest from 550 s {r.low('dc_for.v_dc', 550.2):.1f}",
    )
    yield "axis: battery current", f"{r.both('bess_{}.i_b', '.1f')} A"
    yield "axis: state of charge", ", ".join(f"{100 * r.low(f'bess_{side}.soc'):.1f} %" for side in ("for", "aft"))
    speeds = r.low("genset_for.omega_pu", 60, 525), r.high("genset_for.omega_pu", 60, 525)
    yield "axis: genset speed", f"{speeds[0]:.3f} to {speeds[1]:.3f} pu, running up {r.high('genset_for.omega_pu'):.3f}"
    yield "axis: genset voltage", f"{r.mean('genset_for.v_pu', 60, 180):.3f} pu, extremes "
    yield "", f"{r.low('genset_for.v_pu', 43, 60):.2f} and {r.high('genset_for.v_pu'):.2f} pu"
    power = r.low("genset_for.p_pu", 180.5, 525), r.high("genset_for.p_pu", 180.5, 525)
    yield (
        "axis: genset power",
        f"{power[0]:.2f} to {power[1]:.2f} pu from 180 s, peak {r.high('genset_for.p_pu'):.2f} pu",
    )
    yield "energy", f"{100 * r.run.summary['energy_balance_error']:.3f} %"


def ac_regulation(r: Look) -> Rows:
    """Section 6.2, figure 10b."""
    alone = r.mean("ac_for.v_rms_pu", 120, 155), r.mean("ac_for.f", 120, 155)
    yield "bars energised", f"{alone[0]:.3f} pu, {alone[1]:.2f} Hz"
    yield "6 kn", f"highest {r.high('hull.u_ship') / KNOT:.2f} kn at {r.when_highest('hull.u_ship'):.0f} s"
    yield "batteries on the way", f"at most {max(r.high('bess_for.i_b'), r.high('bess_aft.i_b')):.1f} A"
    closed = r.event("ac_tie", "closed", 160.0)
    f = (fn(f"ac_{side}.f", 160, 167) for side in ("for", "aft") for fn in (r.low, r.high))
    f = sorted(f)
    yield "AC tie closed", f"{closed - 160.0:.2f} s after its command, {f[0]:.2f} to {f[-1]:.2f} Hz"
    yield "", f"lowest {min(r.low(f'ac_{side}.v_pu', 160, 167) for side in ('for', 'aft')):.3f} pu"
    power = r.mean("inverter_for.p_ac", 200, 280) - r.mean("inverter_aft.p_ac", 200, 280)
    yield "power shared", f"within {abs(power):.0f} W"
    yield "meshed, AC tie opened", f"lowest {min(r.low(f'ac_{s}.v_pu', 185, 329) for s in ('for', 'aft')):.3f} pu"
    yield (
        "inverter off",
        f"{r.high('ac_aft.v_pu', 335, 389):.3f} pu; overvoltage at most {r.high('ac_aft.v_pu'):.2f} pu",
    )
    dip = r.low("ac_for.v_rms_pu", 389.9), r.low("ac_for.v_pu", 389.9)
    yield "onto the dead bar", f"{dip[0]:.3f} pu rms, {dip[1]:.2f} pu at its instant"
    one = r.mean("ac_for.v_rms_pu", 400, 450), r.mean("ac_for.f", 400, 450), r.mean("inverter_for.p_ac", 400, 450)
    yield "one inverter for both", f"{one[0]:.3f} pu, {one[1]:.2f} Hz, {one[2] / 1e3:.1f} kW"
    yield "axis: DC buses", f"{r.both('dc_{}.v_dc', '.1f')} V"
    yield "energy", f"{100 * r.run.summary['energy_balance_error']:.3f} %"


def mission(r: Look) -> Rows:
    """Section 6.3, figure 11."""
    distance = r.run["hull.distance"].values.astype(float)
    yield "miles", f"{distance.max() / NMI:.2f} out, {np.abs(np.diff(distance)).sum() / NMI:.2f} in all"
    yield "moored", f"{r.mean('bess_for.i_b', 2, 9):.1f} A each, {r.mean('dc_for.v_dc', 2, 9):.1f} V"
    at_6 = (r.mean(name, 250, 305) for name in ("dc_for.v_dc", "bess_for.i_b", "propulsion_for.p_dc"))
    yield "6 kn", "{:.1f} V, {:.1f} A, {:.2f} kW".format(*(x * k for x, k in zip(at_6, (1, 1, 1e-3), strict=True)))
    yield "", f"lowest bus {r.low('dc_for.v_dc', 10, 305):.1f} V"
    at_10 = (r.mean(name, 600, 1385) for name in ("dc_for.v_dc", "propulsion_for.p_dc", "genset_for.p_pu"))
    yield (
        "10 kn",
        "{:.2f} V, {:.2f} kW a drive, genset {:.4f} pu".format(
            *(x * k for x, k in zip(at_10, (1, 1e-3, 1), strict=True))
        ),
    )
    currents = [r.mean(f"bess_{side}.i_b", 600, 1385) for side in ("for", "aft")]
    yield "recharge", f"{currents[0]:.1f} and {currents[1]:.1f} A"
    for text, t in (("Laveno", 1389.5), ("leaving Laveno", 1799.5), ("the end", 3399.5)):
        yield f"SOC at {text}", ", ".join(f"{100 * r.at(f'bess_{side}.soc', t):.2f} %" for side in ("for", "aft"))
    yield "SOC, extremes", " and ".join(f"{100 * x:.1f} %" for x in (r.low("bess_for.soc"), r.high("bess_for.soc")))
    yield "second recharge", f"highest SOC {100 * max(r.high(f'bess_{s}.soc', 1900) for s in ('for', 'aft')):.2f} %"
    for outcome in r.run.timeline:
        yield outcome.name, f"{outcome.count}" + (f", at {outcome.last_s:.1f} s" if outcome.last_s is not None else "")
    yield (
        "genset after it",
        f"{r.mean('genset_aft.p_pu', 2600, 3065):.4f} pu, {r.mean('dc_for.v_dc', 2600, 3065):.2f} V",
    )
    for knots, start, end, settled in ((6, 10, 305, (250, 305)), (10, 310, 600, (600, 1385))):
        peak, steady = r.high("propeller_for.thrust", start, end), r.mean("propeller_for.thrust", *settled)
        over = 100 * (r.high("hull.u_ship", start, end) / (knots * KNOT) - 1)
        yield (
            f"thrust to {knots} kn",
            f"peak {peak / 1e3:.2f} kN, settled {steady / 1e3:.2f} kN; overshoot {over:.1f} %",
        )
    yield "genset speed", f"lowest {r.low('genset_for.omega_pu', 320, 1419):.4f} pu"
    yield "energy", f"{100 * r.run.summary['energy_balance_error']:.3f} %"


def round_trips(r: Look) -> Rows:
    """Four round trips by conditions."""
    for outcome in r.run.timeline:
        first, last = (f"{t:.1f}" if t is not None else "-" for t in (outcome.first_s, outcome.last_s))
        yield outcome.name, f"{outcome.count}, from {first} s to {last} s"
    end = r.run.summary["simulated_s"]
    yield "place at the end", f"{r.at('hull.distance', end):.2f} m"
    yield "SOC at the end", ", ".join(f"{100 * r.at(f'bess_{side}.soc', end):.2f} %" for side in ("for", "aft"))
    for name in ("moored at Laveno", "moored at Intra"):
        for event in r.run.events:
            if event.source == "timeline" and event.text.startswith(name):
                soc = ", ".join(f"{100 * r.at(f'bess_{side}.soc', event.time):.2f} %" for side in ("for", "aft"))
                yield f"{name}, {event.time:.1f} s", f"{r.at('hull.distance', event.time):.2f} m, {soc}"
    yield "SOC, extremes", f"{r.both('bess_{}.soc', '.4f')}"
    yield "buses", f"{r.both('dc_{}.v_dc', '.1f')} V"
    yield "energy", f"{100 * r.run.summary['energy_balance_error']:.3f} %"


TABLES: dict[str, Callable[[Look], Rows]] = {
    "dc-regulation": dc_regulation,
    "ac-regulation": ac_regulation,
    "mission": mission,
    "round-trips": round_trips,
}


def main() -> None:
    """Print the figures of every folder that is named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="+", type=Path)
    for folder in parser.parse_args().results:
        with sg.open_results(folder) as run:
            violated = [v.name for v in run.requirements if v.verdict == "violated"]
            print(
                f"{run.name}, {folder}: {len(run.requirements)} requirements, violated: {', '.join(violated) or 'none'}"
            )
            for source in dict.fromkeys(v.source for v in run.requirements):
                of_it = [v for v in run.requirements if v.source == source]
                print(f"  {source or 'without a source'}: {sum(v.ok for v in of_it)} of {len(of_it)} met")
            for name, text in TABLES[run.summary["scenario"]](Look(run)):
                print(f"  {name:32} {text}")


if __name__ == "__main__":
    main()
