"""Results: written while the run goes on, read afterwards."""

import json
import math

import numpy as np
import pytest

from shipgrid.analysis.requirements import Requirement, evaluate
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.scenarios.recorder import CHUNK_ROWS, ResultsWriter
from shipgrid.scenarios.results import Limiter, bibliography, citation_keys, open_results

GROUPS = {
    "plant": [("dc_for.v_dc", "V", "main bus voltage"), ("bess_for.i_b", "A", "battery current")],
    "slow": [("hull.u_ship", "m/s", "speed through water")],
    "waveforms/0": [("rectifier_for.i_a", "A", "phase current"), ("dc_for.v_dc", "V", "main bus voltage")],
}


def ramp(n, offset=0.0):
    time = 0.01 * np.arange(n)
    return time, np.stack([750.0 + time, offset + 2.0 * time], axis=1)


@pytest.fixture
def written(tmp_path):
    time, value = ramp(CHUNK_ROWS + 100)
    with ResultsWriter(tmp_path, GROUPS, {"plant": 0.01}, {"version": "0.1.0", "references": "Alexander1977"}) as w:
        for part in np.array_split(np.arange(len(time)), 7):
            w.append("plant", time[part], value[part], value[part] - 1.0, value[part] + 3.0)
        w.append("slow", np.array([0.0, 1.0]), np.array([[0.0], [3.0]]))
        w.append("waveforms/0", time[:5], value[:5])
        w.events([(2.0, "genset_for", "running")])
        w.events([(1.0, "propulsion_for.speed_ref", "6 kn")])
        w.limiters([("rectifier_for.modulation", 3.0, 0.5, 2)])
    return tmp_path


def test_rows_appended_in_parts_come_back_in_order_with_unit_and_description(written):
    run = open_results(written)
    signal = run["bess_for.i_b"]
    time, value = ramp(CHUNK_ROWS + 100)
    assert signal.attrs == {"units": "A", "long_name": "battery current"}
    np.testing.assert_array_equal(signal.time, time)
    np.testing.assert_allclose(signal, value[:, 1], rtol=1e-6)  # single precision
    np.testing.assert_allclose(run["bess_for.i_b_max"], value[:, 1] + 3.0, rtol=1e-6)


def test_a_signal_is_not_read_before_it_is_used(written):
    assert not open_results(written)["dc_for.v_dc"].variable._in_memory


def test_extremes_and_waveforms_are_no_signals_of_their_own(written):
    run = open_results(written)
    assert run.signals == ["bess_for.i_b", "dc_for.v_dc", "hull.u_ship", "rectifier_for.i_a"]
    assert len(run["dc_for.v_dc"]) == CHUNK_ROWS + 100, "the whole run, not the waveform window"


def test_events_are_in_order_of_time_and_limiters_are_kept(written):
    run = open_results(written)
    assert [(e.time, e.source, e.text) for e in run.events] == [
        (1.0, "propulsion_for.speed_ref", "6 kn"),
        (2.0, "genset_for", "running"),
    ]
    share = 0.5 / float(run["dc_for.v_dc"].time[-1])  # of what is recorded, while there is no summary
    assert run.limiters == [("rectifier_for.modulation", 3.0, 0.5, 2, pytest.approx(share), "")]


def test_a_limiter_s_share_is_that_of_the_simulated_time_and_a_long_one_is_named(written):
    rows = [{"signal": "rectifier_for.modulation", "meaning": "the converter voltage is at its limit"}]
    for simulated, share, named in ((40.0, 0.0125, 1), (60.0, 0.5 / 60.0, 0)):
        (written / "summary.json").write_text(json.dumps({"simulated_s": simulated, "limiters": rows}))
        run = open_results(written)
        (limiter,) = run.limiters
        assert limiter.share == pytest.approx(share)
        assert limiter.meaning == "the converter voltage is at its limit"
        assert len(run.at_limit) == named  # from 1 % of the time


def test_limiters_stand_in_order_of_their_time(tmp_path):
    with ResultsWriter(tmp_path, GROUPS, {"plant": 1.0}) as w:
        w.append("plant", np.array([0.0, 100.0]), np.zeros((2, 2)))
        w.limiters([("a.short", 1.0, 0.2, 1), ("b.long", 5.0, 40.0, 3), ("c.middle", 2.0, 1.0, 1)])
    run = open_results(tmp_path)
    assert [x.signal for x in run.limiters] == ["b.long", "c.middle", "a.short"]
    assert [x.signal for x in run.at_limit] == ["b.long", "c.middle"]


def test_a_run_without_a_length_has_no_shares():
    assert math.isnan(Limiter.of(("a.limited", 0.0, 0.0, 1), 0.0).share)
    assert not Limiter.of(("a.limited", 0.0, 0.0, 1), 0.0).long


def test_an_unknown_signal_is_refused_with_the_nearest_name(written):
    with pytest.raises(ParameterError, match=r"nearest: 'dc_for.v_dc'"):
        open_results(written)["dc_for.v_cd"]


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(InputErrors, match=r"no results\.nc"):
        open_results(tmp_path)


def test_a_damaged_file_is_refused(tmp_path):
    (tmp_path / "results.nc").write_bytes(b"not a NetCDF file")
    with pytest.raises(InputErrors, match="cannot be read"):
        open_results(tmp_path)


def test_rows_of_the_wrong_shape_are_refused(tmp_path):
    with ResultsWriter(tmp_path, GROUPS) as w, pytest.raises(ValueError, match="shape"):
        w.append("plant", np.zeros(3), np.zeros((3, 1)))


def test_a_file_can_be_opened_any_number_of_times(tmp_path):
    with ResultsWriter(tmp_path, GROUPS) as w:
        w.events([(1.0, "genset_for", "running"), (2.0, "straße", "30 µs at 0.5 Ω")])
    opened = [open_results(tmp_path) for _ in range(30)]  # texts of any length made the library crash here
    assert opened[-1].events == opened[0].events == [(1.0, "genset_for", "running"), (2.0, "straße", "30 µs at 0.5 Ω")]
    assert opened[-1].limiters == []
    for run in opened:
        run.close()


def test_a_requirement_is_judged_on_the_extremes_of_the_file(written):
    run = open_results(written)
    asked = [
        Requirement.from_mapping({"name": "bus", "signal": "dc_for.v_dc", "band": [748.0, 775.0], "until": 20.0}),
        Requirement.from_mapping({"name": "other", "signal": "dc_aft.v_dc", "min": 0.0}),
    ]
    bus, other = evaluate(asked, run)
    # The lowest recorded low is 750 - 1 + 0.01 at 0.01 s, the highest high 770 + 3 at 20 s.
    assert bus.verdict == "met" and bus.margin == pytest.approx(1.01, abs=1e-3) and bus.at == pytest.approx(0.01)
    assert other.verdict == "not evaluated"


def test_cite_prints_what_the_run_used(written):
    text = open_results(written).cite()
    assert text.count("@article") == 2 and "Alexander, Roger" in text and "D'Agostino" in text


def test_citation_keys_are_found_in_module_docstrings_and_an_unknown_one_is_refused():
    assert citation_keys(["shipgrid.components"]) == []
    with pytest.raises(ParameterError, match="Nobody1900"):
        bibliography(["Nobody1900"])


@pytest.mark.parametrize(
    ("summary", "says"),
    [
        (None, "2 events, not finished>"),
        ({"simulated_s": 3.0}, "2 events>"),
        ({"simulated_s": 3.0, "interrupted": False}, "2 events>"),
        ({"simulated_s": 2.5, "interrupted": True}, "2 events, interrupted at 2.5 s>"),
        (
            {
                "simulated_s": 2.5,
                "interrupted": True,
                "requirements": [{"verdict": "met"}, {"verdict": "not evaluated"}],
            },
            "2 events, no requirement violated, 1 of 2 not evaluated, interrupted at 2.5 s>",
        ),
        ({"requirements": [{"verdict": "violated"}]}, "2 events, a requirement is violated>"),
    ],
)
def test_a_run_says_in_a_line_how_it_ended(written, summary, says):
    if summary is not None:
        (written / "summary.json").write_text(json.dumps(summary))
    with open_results(written) as run:
        assert repr(run).endswith(says)
