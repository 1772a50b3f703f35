"""The report as a person sees it: drawn by Chromium, light and dark, wide and narrow, and on paper."""

import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import browser
import synthetic_run

from shipgrid.io.report import render
from shipgrid.scenarios.results import open_results


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return render(open_results(synthetic_run.write(tmp_path_factory.mktemp("mission-averaged"))))


@pytest.fixture(scope="module")
def seen(page):
    return browser.look(page)


def test_every_panel_is_drawn_from_end_to_end_and_no_script_complains(seen):
    assert seen["wrong"] == []
    assert [p["title"].split(" ")[0] for p in seen["panels"]][:3] == ["Ship", "DC", "Battery"]
    assert len(seen["panels"]) == 9
    for panel in seen["panels"]:
        assert panel["columns"] > 0.8, panel  # all but the margin of the axis
        assert panel["colours"] > 5, panel


def test_commands_and_states_stand_as_bars_above_the_panels(seen):
    assert seen["bars"] >= 10
    assert {"10 kn", "-128 A", "droop", "on", "events"} <= set(seen["words"])


def test_a_script_that_fails_would_be_noticed(page):
    broken = page.replace("function zoom(", "function zooom(", 1)
    assert browser.look(broken)["wrong"]
    empty = re.sub(r'"panels":\[.*?\],"bars"', '"panels":[],"bars"', page, count=1, flags=re.DOTALL)
    assert empty != page and browser.look(empty)["panels"] == []


def test_it_is_dark_where_the_user_wants_it_dark(page, seen):
    dark = browser.look(page, dark=True)
    assert (seen["paper"], dark["paper"]) == ("rgb(255, 255, 255)", "rgb(18, 23, 29)")
    assert dark["wrong"] == []
    assert all(panel["columns"] > 0.8 for panel in dark["panels"])


def test_nothing_sticks_out_of_the_page(seen):
    assert seen["width"] <= 1200
    assert seen["cut"] == 0


def test_on_paper_its_figures_are_lines_and_no_pictures(page):
    paper = browser.printed(page)
    assert paper.startswith(b"%PDF")
    assert b"/Subtype /Image" not in paper and b"/Subtype/Image" not in paper
    assert len(paper) > 100_000  # the curves
    assert 3 <= len(re.findall(rb"/Type ?/Page\b", paper)) <= 15
