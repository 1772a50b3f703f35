"""The bundled scenarios: each begins well in every run of the tests; whole ones are sailed in `make full`."""

from __future__ import annotations

import pytest

import shipgrid as sg
from shipgrid.io.ship_file import bundled

SCENARIOS = sorted(bundled("scenario"))
FIRST = 4.0
"""Length of the beginning that is sailed [s]."""


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_first_seconds_of_a_bundled_scenario_break_no_requirement(name, tmp_path):
    run = sg.simulate(sg.load_ship("ferry"), sg.load_scenario(name), until=FIRST, out=tmp_path / name, report=False)
    assert run.ok, [v for v in run.requirements if v.verdict == "violated"]
    assert run.summary["simulated_s"] == pytest.approx(FIRST, abs=run.summary["step_s"])
    assert abs(run.summary["start_drift_per_s"]) < 1e-3
    judged = [v for v in run.requirements if v.value is not None]
    assert judged, "nothing is asked of its first seconds"


@pytest.mark.full
@pytest.mark.parametrize("name", [name for name in SCENARIOS if name != "mission"])
def test_a_bundled_scenario_meets_every_requirement(name, tmp_path):
    run = sg.simulate(sg.load_ship("ferry"), sg.load_scenario(name), out=tmp_path / name)
    assert all(v.ok for v in run.requirements), [v for v in run.requirements if not v.ok]
    assert not [e for e in run.events if "refused" in e.text]
    assert (run.folder / "report.html").stat().st_size < 3e6
