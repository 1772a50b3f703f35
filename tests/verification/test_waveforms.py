"""Waveform windows: every step of a window and nothing else, phase quantities, results on disk."""

from __future__ import annotations

import math

import numpy as np
import pytest

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import WAVE_ROWS, new_workspace
from shipgrid.errors import InputErrors, TopologyError
from shipgrid.io.plot import plot
from shipgrid.model.network import Network
from shipgrid.model.public_signals import Waveform
from shipgrid.scenarios.recorder import ResultsWriter
from shipgrid.scenarios.results import open_results
from shipgrid.scenarios.session import Run, run_until
from shipgrid.scenarios.waveforms import Window, merged, window_columns
from verification.circuits import SourceBranch, Wave

H, F, PEAK, G, R, L = 30e-6, 60.0, 326.6, 2.0, 0.05, 0.2e-3


def grid():
    """A balanced source behind R-L feeds a resistive bar."""
    net = Network("bar on a source")
    bar = net.ac_bus("bar", 400.0, F)
    net.conductance(bar, G)
    net.add("source", Wave(peak=PEAK, omega=2.0 * math.pi * F))
    net.add_three_phase(
        "line", SourceBranch(R=R, L=L), ports={"ends": bar}, inputs={"e": ("source.e_alpha", "source.e_beta")}
    )
    net.publish("bar.e", source="source.e_alpha", unit="V", description="voltage of the source")
    net.publish_phases("bar.v", alpha="bar.v_alpha", beta="bar.v_beta", unit="V", description="voltage of the bar")
    net.publish_phases(
        "bar.v", alpha="bar.v_alpha", beta="bar.v_beta", unit="V", description="line voltage", lines=True
    )
    net.publish_phases(
        "line.i", alpha="line.alpha.i", beta="line.beta.i", unit="A", description="current", sign=-1.0, carrier=1620.0
    )
    net.publish_waveform(Waveform("line.e", (("source.e_beta", 2.0),), "V", "twice the other axis", mean=True))
    return net


@pytest.fixture(scope="module")
def plan():
    return assemble(grid(), H)


class Kept:
    """Rows by group, as the runner hands them over."""

    def __init__(self):
        self.rows = {}

    def append(self, group, time, value, *others):
        self.rows.setdefault(group, []).append((time.copy(), value.copy()))

    def __getitem__(self, group):
        times, values = zip(*self.rows[group], strict=True)
        return np.concatenate(times), np.concatenate(values)


def run(plan, end, windows=(), writer=None):
    run = Run(plan, new_workspace(plan))
    run_until(run, None, end, writer, windows=merged(windows, plan.h, end))
    return run


def stepped(plan, steps):
    """Every signal after each step, one call a step."""
    work = new_workspace(plan)
    entry, values = core(), arguments(plan, work)
    rows = [work.sig.copy()]
    for k in range(steps):
        assert entry(1, k, *values) == 1
        rows.append(work.sig.copy())
    return np.array(rows)


def test_a_window_has_every_step_of_it_and_none_beside_it(plan):
    kept = Kept()
    long = (WAVE_ROWS + 500) * H
    run(plan, 0.1, [(0.0, 3.0 * H), (0.02, 0.02 + long), (0.0999, 0.1)], kept)
    true = stepped(plan, round(0.1 / H))
    names = [column[0] for column in window_columns(plan)]
    for group, first, last in (("waveforms/0", 0, 3), ("waveforms/1", 667, 667 + 1523), ("waveforms/2", 3330, 3333)):
        time, value = kept[group]
        np.testing.assert_allclose(time, np.arange(first, last + 1) * H, rtol=1e-12)
        v = true[first : last + 1, [plan.layout.index[f"bar.v_{axis}"] for axis in ("alpha", "beta")]]
        np.testing.assert_array_equal(value[:, names.index("bar.v_a")], v[:, 0])
        e = true[first : last + 1, plan.layout.index["source.e_beta"]]
        np.testing.assert_array_equal(value[:, names.index("line.e")], 2.0 * e)


def test_recording_changes_nothing_in_the_run(plan):
    assert np.array_equal(run(plan, 0.05).work.sig, run(plan, 0.05, [(0.01, 0.03)], Kept()).work.sig)


def test_phases_are_a_third_of_a_cycle_apart_and_lines_their_differences(plan):
    kept = Kept()
    run(plan, 0.2, [(0.15, 0.2)], kept)
    time, value = kept["waveforms/0"]
    of = {column[0]: value[:, k] for k, column in enumerate(window_columns(plan))}
    z = complex(R, 2.0 * math.pi * F * L)
    v = PEAK / (1.0 + z * G)  # phasor of the bar on the source's cosine: current G v into the bar
    for phase, turn in (("a", 0.0), ("b", -2.0 * math.pi / 3.0), ("c", 2.0 * math.pi / 3.0)):
        # the source is held over a step: half a step late, and smaller by (w h)^2 / 24
        angle = 2.0 * math.pi * F * (time - 0.5 * H) + turn
        expected = np.real(v * np.exp(1j * angle))
        # the source drives a current into the branch, so the bar has its opposite; (w h)^2 is 1e-4
        assert np.abs(of[f"bar.v_{phase}"] + expected).max() < 2e-4 * PEAK
        assert np.abs(of[f"line.i_{phase}"] - G * of[f"bar.v_{phase}"]).max() < 1e-9 * PEAK
    assert np.abs(of["bar.v_ab"] - (of["bar.v_a"] - of["bar.v_b"])).max() < 1e-9
    assert np.abs(of["bar.v_ab"] + of["bar.v_bc"] + of["bar.v_ca"]).max() < 1e-9
    assert np.ptp(of["bar.v_ab"]) / np.ptp(of["bar.v_a"]) == pytest.approx(math.sqrt(3.0), rel=1e-3)


@pytest.fixture(scope="module")
def written(plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("waves")
    spans = [(0.05, 0.1), (0.15, 0.2)]
    windows = merged(spans, H, 0.25)
    public = [(p.name, p.unit, p.description) for p in plan.network.published.values()]
    columns = {"plant": public, "slow": [], **{w.group: window_columns(plan) for w in windows}}
    with ResultsWriter(folder, columns, {w.group: H for w in windows}) as writer:
        run(plan, 0.25, spans, writer)
    return folder


def test_waveforms_are_read_by_name_and_public_signals_keep_their_own_rate(written):
    results = open_results(written)
    assert results.windows == ["waveforms/0", "waveforms/1"]
    assert "line.i_a" in results and {"bar.e", "bar.v_c", "bar.v_ab"} <= set(results.signals)
    i = results["line.i_a"]
    assert i.attrs["units"] == "A" and i.attrs["long_name"] == "current, phase a" and i.attrs["carrier_hz"] == 1620.0
    assert len(i) == 2 * (round(0.05 / H)) and float(i.time[0]) >= 0.05 and float(i.time[-1]) <= 0.2
    assert len(results["bar.e"]) == 3, "0.1 s apart, and the end"
    assert results.group("waveforms/1")["line.e"].attrs["cell_methods"] == "time: mean"
    within = results.series("bar.e", (0.16, 0.19))
    assert within is not None and len(within.time) == round(0.05 / H)
    assert results.series("bar.e", (0.0, 0.2)).low is not None, "what no window covers comes from the whole run"


def test_a_plot_within_a_window_shows_every_step_of_a_public_signal(written, tmp_path):
    results = open_results(written)
    drawn = plot(results, ["bar.e", "bar.v_a"], tmp_path / "wave.svg", 0.16, 0.18).read_text()
    whole = plot(results, ["bar.e"], tmp_path / "all.svg").read_text()
    assert drawn.count("\nL ") > whole.count("\nL ") + 50, "a curve, not a straight line"


@pytest.mark.parametrize(
    ("window", "says"),
    [((0.2, 0.1), "ends before it begins"), ((0.5, 2.0), "expected an end up to 1 s"), ((0.1, 0.10001), "shorter")],
)
def test_a_window_that_is_none_is_refused(window, says):
    with pytest.raises(InputErrors, match=says):
        merged([(0.0, 0.1), window], H, 1.0)


def test_windows_that_overlap_become_one():
    assert merged([(0.3, 0.4), (0.0, 0.2), (0.1, 0.25)], 1e-3, 1.0) == [
        Window(0, 250, "waveforms/0"),
        Window(300, 400, "waveforms/1"),
    ]


def test_two_waveforms_of_one_name_are_refused():
    net = grid()
    for name in ("line.e", "bar.e"):
        with pytest.raises(TopologyError, match=f"two public signals of the name '{name}'"):
            net.publish_waveform(Waveform(name, (), "V", ""))
