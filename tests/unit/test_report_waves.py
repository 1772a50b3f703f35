"""The waveform part of a report, made from waves of known content."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
import xarray

from shipgrid.analysis.edges import combination, of_bridge
from shipgrid.io.report import render
from shipgrid.io.waves import windows_of, with_edges
from shipgrid.scenarios.recorder import ResultsWriter
from shipgrid.scenarios.results import open_results

H, F, CARRIER = 30e-6, 59.3, 1620.0


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    columns, values = [("dc_for.v_dc", "V", "main bus voltage"), ("bess_for.i_b", "A", "battery current")], []
    t = 12.0 + H * np.arange(8001)
    duty = 0.625

    def closed(time):
        whole = np.floor(time * 5e3)
        return duty * whole / 5e3 + np.clip(time - whole / 5e3 - 0.5 * (1 - duty) / 5e3, 0.0, duty / 5e3)

    s = (closed(t) - closed(t - H)) / H
    values += [750.0 + 0.8 * np.sin(2 * math.pi * 300.0 * t), 20.0 + 750.0 / 0.8e-3 * (duty * t - closed(t))]
    columns.append(("bess_for.s", "1", "switching function", {"cell_methods": "time: mean", "carrier_hz": 5e3}))
    values.append(s)
    for stem, unit, peak, harmonic in (("i", "A", 80.0, 0.05), ("v_c", "V", 390.0, 0.001)):
        for k, phase in enumerate("abc"):
            angle = 2 * math.pi * F * t - 2 * math.pi * k / 3
            side = 2 * math.pi * (CARRIER - 2 * F) * t
            columns.append((f"rectifier_for.{stem}_{phase}", unit, f"a {stem}, phase {phase}", {"carrier_hz": CARRIER}))
            values.append(peak * (np.cos(angle) + harmonic * np.cos(5 * angle) + 2 * harmonic * np.cos(side)))
    for phase in "abc":
        columns.append((f"rectifier_aft.i_{phase}", "A", f"an i, phase {phase}"))
        values.append(np.zeros(len(t)))
    with ResultsWriter(folder, {"plant": columns[:1], "waveforms/0": columns}) as writer:
        writer.append("plant", t[:2], np.full((2, 1), 750.0))
        writer.append("waveforms/0", t, np.stack(values, axis=1))
    return open_results(folder)


def test_the_report_has_the_harmonics_of_each_three_phase_set(run):
    (window,) = windows_of(run)
    assert window["names"] == ["rectifier_for.i_a", "rectifier_for.v_c_a"], "what is dead has none"
    facts = dict(window["sets"][0]["facts"])
    assert facts["fundamental"] == "59.300 Hz"
    assert float(facts["peak"].split()[0]) == pytest.approx(80.0, abs=0.02)  # a leak as well
    # what the side line, 0.3 orders from the 25th, leaks into that one's subgroup comes to the 5 %
    assert 5.0 <= float(facts["THD"].split()[0]) < 5.5
    assert facts["all distortion"] == f"{100 * math.hypot(0.05, 0.1):.2f} %"
    orders = dict(window["orders"])
    assert orders[1] == ["100.00", "100.00"]
    assert [float(share) for share in orders[5]] == pytest.approx([5.0, 0.1], abs=0.02)
    (row,) = (r for r in window["carriers"] if (r["name"], r["carrier"]) == ("rectifier_for.i_a", "1 x 1620 Hz"))
    # 1501.4 Hz falls between two lines, 5.4 Hz apart, which share it
    strongest = max(re.findall(r"(\d+) Hz (\d+\.\d+) %", row["lines"]), key=lambda pair: float(pair[1]))
    assert abs(float(strongest[0]) - (CARRIER - 2 * F)) < 5.4 and 6.3 < float(strongest[1]) <= 10.0


def test_the_ripple_of_the_battery_is_that_between_the_steps(run):
    (window,) = windows_of(run)
    rows = {row["name"]: row for row in window["ripple"]}
    pp = 750.0 * 0.625 * 0.375 / (0.8e-3 * 5e3)
    assert float(rows["bess_for.i_b"]["pp"].split()[0]) == pytest.approx(pp, rel=5e-3)  # single precision, end periods
    assert float(rows["dc_for.v_dc"]["pp"].split()[0]) == pytest.approx(1.6, rel=1e-2)


def test_the_drawings_are_well_formed_and_small(run):
    (window,) = windows_of(run)
    for drawn in window["sets"]:
        for picture in (drawn["wave"], drawn["bars"]):
            ElementTree.fromstring(picture)
            assert len(picture) < 60_000
    page = render(run)
    assert "Waveforms from 12 s to 12.24 s" in page and "rectifier_for.i_a" in page


def test_waves_of_a_bridge_are_drawn_with_the_edges_inside_steps():
    n = 1300
    t, instants = H * np.arange(n + 1), np.arange(int(n * H * 2 * CARRIER) + 1) / (2 * CARRIER)
    angle = 2.0 * math.pi * F * instants
    legs = of_bridge(instants, 0.45 * np.cos(angle), 0.45 * np.sin(angle), CARRIER, t[-1])
    means = {k: np.append(0.0, np.diff(leg.integral(t)) / H) for k, leg in zip("abc", legs, strict=True)}
    phase = combination((2.0 / 3.0, -1.0 / 3.0, -1.0 / 3.0), legs)
    columns = {f"inverter_for.s_{k}": mean for k, mean in means.items()} | {
        "inverter_for.v_ab": 750.0 * (means["a"] - means["b"]),
        "inverter_for.i_a": 750.0
        / 1e-3
        * (phase.integral(t) - 0.45 * np.sin(2.0 * math.pi * F * t) / (2 * math.pi * F)),
        "inverter_for.i_g_a": np.cos(t),
        "rectifier_for.i_a": np.sin(t),
    }
    data = xarray.Dataset({name: ("time", values.astype(np.float32)) for name, values in columns.items()}, {"time": t})
    _, v = with_edges(data, "inverter_for.v_ab")
    assert len(v) > 2 * n
    assert np.mean(np.min(np.abs(v[:, None] - [-750.0, 0.0, 750.0]), axis=1) < 0.1) > 0.99  # single precision
    time, i = with_edges(data, "inverter_for.i_a", slice(100, None))
    assert time[0] == t[100] and len(time) > n - 100 + 300
    assert i.max() > columns["inverter_for.i_a"].max() + 0.5  # a tip that no step's end has
    for name in ("inverter_for.i_g_a", "rectifier_for.i_a"):  # not driven by legs, or by legs that are not there
        assert np.array_equal(with_edges(data, name)[1], data[name].values)
