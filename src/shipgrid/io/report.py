"""The report of a run: one HTML file that needs nothing else, for the screen (light or dark) and for paper.

One-line diagram, events above the plots on their common time axis, verdicts, energy, limiters, event log, provenance.
Plots are drawn by uPlot, which is put into the file; what they show is reduced first (`io/panels.py`), and the page
says so.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2

from shipgrid.analysis.requirements import Verdict
from shipgrid.io.one_line import one_line
from shipgrid.io.panels import POINTS, bars_of, panels_of
from shipgrid.io.waves import windows_of
from shipgrid.scenarios.results import AT_LIMIT, Results

JOULE_PER_KWH = 3.6e6
ENERGY = {
    "sources": "Sources",
    "consumers": "Consumers",
    "losses": "Losses",
    "stored": "Change of stored energy",
}
UNSEEN = 5e-4
"""A row of the energy table smaller than this part of the largest is put with the others."""
EVENTS_SHOWN = 15
"""More events than this start folded away."""


def write_report(run: Results, path: Path | str) -> Path:
    """Write the report of a run.

    Parameters
    ----------
    run : Results
        The run; also one that was interrupted.
    path : Path or str
        Where to. The file appears complete, or not at all.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    path = Path(path)
    page = render(run)
    part = path.with_name(f".{path.name}.part")
    part.write_text(page, encoding="utf-8")
    os.replace(part, path)
    return path


def render(run: Results) -> str:
    """The report's HTML.

    Parameters
    ----------
    run : Results
        The run.
    """
    package = files("shipgrid.io")
    static = package.joinpath("static")
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters.update(si=si, seconds=seconds, instant=instant, clock=clock, limits=limits, percent=percent)
    template = environment.from_string(package.joinpath("templates/report.html.j2").read_text(encoding="utf-8"))
    panels = panels_of(run)
    end = max((p["time"][-1] for p in panels), default=0.0)
    start = min((p["time"][0] for p in panels), default=0.0)
    data = {
        "panels": panels,
        "bars": bars_of(run, end),
        "events": [[e.time, f"{e.source}: {e.text}"] for e in run.events],
        "range": [start, end],
    }
    ship = run.settings.get("ship") or {}
    return template.render(
        run=run,
        summary=run.summary,
        ship_name=run.summary.get("ship") or ship.get("ship", ""),
        verdict=verdict(run),
        facts=facts(run.summary),
        diagram=one_line(ship),
        data=json.dumps(data, separators=(",", ":"), allow_nan=False).replace("</", "<\\/"),
        reduced=reduction(panels),
        windows=windows_of(run),
        clock_table=clock_table(run.summary.get("realtime") or {}),
        energy=energy_table(run.summary.get("energy") or {}),
        events_shown=EVENTS_SHOWN,
        by_source=by_source(run.requirements),
        at_limit=percent(AT_LIMIT),
        provenance=provenance(run),
        settings=settings_text(run),
        uplot=static.joinpath("uPlot.iife.min.js").read_text(encoding="utf-8"),
        uplot_style=static.joinpath("uPlot.min.css").read_text(encoding="utf-8"),
        script=static.joinpath("report.js").read_text(encoding="utf-8"),
        style=static.joinpath("report.css").read_text(encoding="utf-8"),
    )


def verdict(run: Results) -> tuple[str, str]:
    """Class and sentence of the badge beside the title."""
    rows = run.requirements
    violated = sum(r.verdict == "violated" for r in rows)
    if not run.summary:
        return "open", "no summary: the run was not finished"
    if run.summary.get("failure"):
        return "bad", "the simulation failed"
    missing = sum(outcome.missing for outcome in run.timeline)
    parts = [f"{violated} of {len(rows)} requirements violated"] if violated else []
    parts += [f"{missing} of {len(run.timeline)} entries of the time-line missing"] if missing else []
    if parts:
        return "bad", ", ".join(parts)
    if not rows:
        return "open", "no requirements"
    met = sum(r.ok for r in rows)
    if met < len(rows):
        return "open", f"{met} of {len(rows)} requirements met, others not evaluated"
    return "good", f"all {len(rows)} requirements met"


def by_source(verdicts: Sequence[Verdict]) -> list[tuple[str, int, int]]:
    """Source of requirements, how many are met and how many there are; empty where none has a source.

    Parameters
    ----------
    verdicts : sequence of Verdict
    """
    met_by_source: dict[str, list[bool]] = {}
    for verdict in verdicts:
        met_by_source.setdefault(verdict.source or "without a source", []).append(verdict.ok)
    if set(met_by_source) == {"without a source"}:
        return []
    return [(source, sum(met), len(met)) for source, met in met_by_source.items()]


def limits(verdict: Verdict) -> str:
    """What a requirement allows: `715 V … 785 V`, `≤ 1.5 s outside 675 V … 825 V`.

    Parameters
    ----------
    verdict : Verdict
    """
    allowed = _range(verdict.limit, verdict.unit)
    words = {"recovery": "outside", "settles": "until inside"}.get(verdict.rule)
    return f"{allowed} {words} {_range(verdict.inside, verdict.inside_unit)}" if words else allowed


def _range(limit: list[float | None] | None, unit: str) -> str:
    if not limit:
        return ""
    low, high = (None if x is None else si(x, unit or "1") for x in limit)
    if low is None:
        return f"≤ {high}"
    return f"≥ {low}" if high is None else f"{low} … {high}"


def facts(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The run in numbers: label and value, of what the summary has."""
    simulated, wall = summary.get("simulated_s"), summary.get("wall_s")
    balance = summary.get("energy_balance_error")
    rows = [
        ("simulated", clock(simulated) if simulated is not None else None),
        ("step", si(summary["step_s"], "s") if "step_s" in summary else None),
        ("steps", f"{summary['steps'] / 1e6:.3g} M" if "steps" in summary else None),
        ("computed in", seconds(wall) if wall is not None else None),
        ("per step", f"{summary['us_per_step']:.3g} µs" if "us_per_step" in summary else None),
        ("times real time", f"{simulated / wall:.3g}" if simulated and wall else None),
        ("start-up", seconds(summary["startup_s"]) if "startup_s" in summary else None),
        ("energy balance error", f"{100.0 * balance:.2g} %" if balance is not None else None),
    ]
    return [(label, value) for label, value in rows if value is not None]


def reduction(panels: list[dict[str, Any]]) -> str:
    """A sentence on what was left out of the plots."""
    rows = max((p["rows"] for p in panels), default=0)
    if rows <= POINTS:
        return "Curves are means over recording intervals, all of them; shaded bands are the extremes."
    shown = f"{rows:,}".replace(",", "\u202f")
    return (
        f"Curves are means over recording intervals, about {POINTS} of up to {shown}, chosen by MinMaxLTTB; shaded "
        "bands are the extremes between them. Zooming in does not show more; results.nc has every recorded value."
    )


def clock_table(found: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table about a live run's clock: what, and its percentiles in microseconds.

    Parameters
    ----------
    found : mapping
        The summary's `realtime`; no rows without one.
    """
    from shipgrid.realtime.monitor import LONGEST, NAMES, PERCENTILES

    def micro(label: str, value: float | None) -> str:
        beyond = label in PERCENTILES and value is not None and value >= LONGEST
        return "" if value is None else f"{'≥ ' if beyond else ''}{1e6 * value:.2f}"

    labels = ("mean", *PERCENTILES, "worst")
    rows = [(name, found[name]) for name in NAMES if name in found]
    crew = zip(found.get("crew", ()), found.get("cores", ()), strict=False)
    rows += [
        (f"core {k}: {', '.join(who['parts'])} ({100 * core['duty']:.0f} %)", core)
        for k, (who, core) in enumerate(crew, start=1)
    ]
    return [(name, *(micro(label, times.get(label)) for label in labels)) for name, times in rows]


def energy_table(energy: Mapping[str, Mapping[str, float]]) -> list[dict[str, Any]]:
    """Groups of the energy table, each row with kWh, its share of what was supplied, and the length of its bar [%].

    Parameters
    ----------
    energy : mapping
        The summary's `energy`: for each of `ENERGY` the joules by component. Components of one item are added up,
        and what is too small to see is one row, `others`.
    """
    energy = {key: _by_item(energy.get(key) or {}) for key in ENERGY}
    supplied = sum(v for v in energy["sources"].values() if v > 0.0)
    largest = max((abs(v) for rows in energy.values() for v in rows.values()), default=0.0)

    def row(name: str, value: float, share: bool = True) -> dict[str, Any]:
        kwh = round(value / JOULE_PER_KWH, 2) + 0.0  # no minus before a zero
        part = f"{round(100.0 * value / supplied, 1) + 0.0:.1f} %" if share and supplied > 0.0 else ""
        bar = 100.0 * abs(value) / largest if largest > 0.0 else 0.0
        return {"name": name, "kwh": f"{kwh:.2f}", "share": part, "bar": bar, "negative": kwh < 0.0}

    groups = []
    for key, title in ENERGY.items():
        values = energy[key]
        seen = sorted((i for i in values.items() if abs(i[1]) > UNSEEN * largest), key=lambda i: -abs(i[1]))
        rows = [row(name, value) for name, value in seen]
        if len(seen) < len(values):
            rest = sum(values.values()) - sum(v for _, v in seen)
            rows.append(row(f"others ({len(values) - len(seen)})", rest))
        if rows:
            groups.append({"key": key, "total": row(title, sum(values.values()), key != "sources"), "rows": rows})
    return groups


def _by_item(components: Mapping[str, float]) -> dict[str, float]:
    """Sums over the components of each item: `bess_for` of `bess_for.battery` and `bess_for.converter`."""
    items: dict[str, float] = {}
    for path, joule in components.items():
        item = path.partition(".")[0]
        items[item] = items.get(item, 0.0) + joule
    return items


def provenance(run: Results) -> list[tuple[str, str]]:
    """Where the result comes from: the summary's plain entries and the file's attributes."""
    shown = {"step_s", "simulated_s", "steps", "wall_s", "startup_s", "us_per_step", "energy_balance_error"}
    rows = {k: v for k, v in run.summary.items() if k not in shown and isinstance(v, str | int | float | bool)}
    rows.update({k: v for k, v in run.attributes.items() if k not in rows and k != "Conventions"})
    return [
        (key.replace("_", " "), f"{value:.6g}" if isinstance(value, float) else str(value))
        for key, value in rows.items()
    ]


def settings_text(run: Results) -> str:
    """The text of `run.yaml`, or nothing."""
    path = run.folder / "run.yaml"
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def si(value: float | None, unit: str) -> str:
    """A number with its unit and a prefix where the unit takes one: `732 V`, `30 µs`, `12.5 kW`.

    Parameters
    ----------
    value : float or None
        In SI; None gives a dash.
    unit : str
        Its symbol; `1` and `pu` take no prefix.
    """
    if value is None or not math.isfinite(value):
        return "–"
    if unit in ("1", "", "pu", "Hz", "V", "A", "rad/s", "m/s"):
        return f"{value:.4g}" + (f" {unit}" if unit not in ("1", "") else "")
    for prefix, size in (("M", 1e6), ("k", 1e3), ("", 1.0), ("m", 1e-3), ("µ", 1e-6)):
        if abs(value) >= size:
            return f"{value / size:.4g} {prefix}{unit}"
    return f"{value:.4g} {unit}"


def percent(value: float) -> str:
    """A share as people say it: `44.1 %`, `0.024 %`, `< 0.01 %`.

    Parameters
    ----------
    value : float
        0 to 1; a dash where it is not a number.
    """
    if not math.isfinite(value):
        return "–"
    if value < 1e-4:
        return "< 0.01 %"
    return f"{100.0 * value:.3g} %" if value >= 0.01 else f"{100.0 * value:.2g} %"


def seconds(value: float | None) -> str:
    """A duration as people say it: `0.42 s`, `75 s`, `12 min 5 s`.

    Parameters
    ----------
    value : float or None
        In seconds.
    """
    if value is None:
        return "–"
    if value < 120.0:
        return f"{value:.3g} s"
    minutes, rest = divmod(round(value), 60)
    return f"{minutes} min {rest} s"


def instant(value: float) -> str:
    """An instant to four digits, to the second beyond ten thousand: `130.4 s`, `12345 s`.

    Parameters
    ----------
    value : float
        In seconds.
    """
    return f"{value:.4g} s" if abs(value) < 9999.5 else f"{value:.0f} s"


def clock(value: float | None) -> str:
    """An instant or duration as minutes and seconds: `310 s` is `5:10`.

    Parameters
    ----------
    value : float or None
        In seconds.
    """
    if value is None:
        return "–"
    whole = round(value)
    hours, rest = divmod(whole, 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d} h" if hours else f"{rest // 60}:{rest % 60:02d} min"
