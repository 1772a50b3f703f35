"""The ferry's mission at its long step, run once: every test here reads the same results."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

import shipgrid as sg

KNOT = 1852.0 / 3600.0
AT_10_KN = (600.0, 1385.0)
WAY_BACK = (2400.0, 3065.0)
RECHARGE_BACK, CHARGED = (2400.0, 2460.0), (2600.0, 3065.0)
"""On the way back the recharge ends at 60 %, at about 2475 s."""


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    out = tmp_path_factory.mktemp("results") / "mission-averaged"
    return sg.simulate(sg.load_ship("ferry"), sg.load_scenario("mission"), out=out)


def window(run, name, start, end):
    series = run[name]
    return series.sel(time=slice(start, end))


def mean(run, name, start, end):
    return float(window(run, f"{name}_mean", start, end).mean())


def test_every_requirement_of_the_scenario_is_met(mission):
    missed = [v for v in mission.requirements if v.verdict != "met"]
    assert not missed
    assert mission.ok


def test_all_files_of_the_contract_are_there_and_agree(mission):
    summary = json.loads((mission.folder / "summary.json").read_text())
    promised = {"scenario", "ship", "fidelity", "step_s", "simulated_s", "steps", "wall_s", "startup_s", "us_per_step"}
    promised |= {"energy_balance_error", "requirements", "version", "commit"}
    assert promised <= set(summary)
    assert summary["simulated_s"] == pytest.approx(3400.0, abs=summary["step_s"])
    assert summary["steps"] == round(3400.0 / summary["step_s"])
    for name in ("results.nc", "report.html", "run.yaml"):
        assert (mission.folder / name).stat().st_size > 0
    assert (mission.folder / "report.html").stat().st_size < 3e6


def test_energy_balance_of_the_whole_run_closes_to_a_thousandth(mission):
    assert abs(mission.summary["energy_balance_error"]) < 1e-3


def test_battery_takes_what_the_droop_arithmetic_says(mission):
    """models page 5.3: i = -128 A + 3.413 A/V (750 V - v_dc), on both sides."""
    for side in ("for", "aft"):
        v_dc = mean(mission, f"dc_{side}.v_dc", *AT_10_KN)
        i_b = mean(mission, f"bess_{side}.i_b", *AT_10_KN)
        assert i_b == pytest.approx(-128.0 + 128.0 / 0.05 / 750.0 * (750.0 - v_dc), abs=0.5)


def test_rectifier_stands_on_its_droop_line(mission):
    """Reading B: v = 750 V - 0.05 pu of current; the battery's droop line meets it."""
    v_dc = mean(mission, "dc_for.v_dc", *AT_10_KN)
    i_dc = mean(mission, "rectifier_for.i_dc", *AT_10_KN)
    base = 596e3 / 750.0
    assert v_dc == pytest.approx(750.0 * (1.0 - 0.05 * i_dc / base), abs=0.3)


def test_rectifiers_are_at_the_bound_of_their_voltage_through_both_legs_at_10_kn(mission):
    """Screws are beyond their diagram while the ship stops; nothing else is at a limit for 1 % of the time.

    The closed form says what reactive power the bound takes.
    """
    shares = {limiter.signal: limiter.share for limiter in mission.at_limit}
    legs = {"rectifier_for.control.q_bound": 0.311, "rectifier_aft.control.q_bound": 0.275}
    legs |= {f"propulsion_{side}.propeller.beyond": 0.028 for side in ("for", "aft")}
    assert shares == pytest.approx(legs, abs=0.001)  # 3.4 s, the digits of docs/reproducing.md
    written = {row["signal"]: row["share"] for row in mission.summary["limiters"]}
    assert written == pytest.approx({limiter.signal: limiter.share for limiter in mission.limiters})
    v_dc, p_dc, e = (
        mean(mission, name, *AT_10_KN) for name in ("dc_for.v_dc", "rectifier_for.p_dc", "genset_for.v_pu")
    )
    limits = sg.load_ship("ferry").item("rectifier_for").limits(v_dc, 480.0, 60.0, 750.0, e)
    point = next(p for p in map(limits.at, np.linspace(0.0, 0.6, 6001)) if p.p_dc * 596e3 >= p_dc)
    # at the genset's 58.6 Hz the choke takes 2.4 % less and the capacitors give 2.4 % less
    assert mean(mission, "genset_for.q_ac", *AT_10_KN) == pytest.approx(point.q_ac * 596e3, abs=2e3)
    assert mean(mission, "rectifier_for.modulation", *AT_10_KN) == pytest.approx(
        abs(point.v_node - 0.976 * limits.lcl.Z_1 * point.i) / (v_dc / 480.0 / 2.0**0.5), abs=2e-3
    )
    assert limits.end.p_dc * 596e3 == pytest.approx(369e3, abs=1.5e3)  # what it could at that voltage


def test_both_screws_share_and_work_at_the_published_point(mission):
    """P/D 0.9, resistance table, 10 kn: 307 rpm, 2.23 kN m on the shaft, 71.8 kW each (models page 8)."""
    for side in ("for", "aft"):
        omega = mean(mission, f"propulsion_{side}.omega_m", *AT_10_KN)
        torque = mean(mission, f"propulsion_{side}.tau_e", *AT_10_KN)
        assert omega * 30.0 / np.pi == pytest.approx(307.0, abs=6.0)
        assert torque == pytest.approx(2230.0, abs=100.0)
        assert omega * torque == pytest.approx(71.8e3, abs=3e3)


def test_settled_intervals_are_settled(mission):
    """No slope beyond what the batteries' state of charge explains, and no swing beyond 1 % of nominal."""
    for name, nominal in (
        ("dc_for.v_dc", 750.0),
        ("genset_for.p_pu", 1.0),
        ("genset_for.omega_pu", 1.0),
        ("propulsion_for.omega_m", 47.1),
        ("hull.u_ship", 10.0 * KNOT),
    ):
        series = window(mission, name, 1000.0, 1385.0)
        t, y = series["time"].values, series.values.astype(float)
        slope = np.polyfit(t, y, 1)[0]
        assert abs(slope) * 60.0 < 1e-3 * nominal, name
        assert np.ptp(y) < 1e-2 * nominal, name


@pytest.mark.parametrize(
    "signal", ["propeller_for.thrust", "propeller_aft.thrust", "propulsion_for.tau_e", "propulsion_aft.i_q"]
)
@pytest.mark.parametrize("start, end", [(10.0, 300.0), (310.0, 600.0)], ids=["6 kn", "10 kn"])
def test_thrust_torque_and_current_rise_without_ringing(mission, signal, start, end):
    """They rise with the ramp; after its end they fall to their steady values, and cross them at most once."""
    for ending in ("", "_min", "_max"):
        values = window(mission, signal + ending, start, end).values.astype(float)
        rising = values[: np.argmax(values) + 1]
        assert (np.maximum.accumulate(rising) - rising).max() < 0.05 * values.max(), ending
        final = values[-50:].mean()
        after_peak = values[np.argmax(values) :] - final
        crossings = np.count_nonzero(np.diff(np.sign(after_peak[np.abs(after_peak) > 5e-3 * final])))
        assert crossings <= 1, ending


def test_acceleration_peak_is_that_of_the_ramp(mission):
    """0.05 kn/s: m a is 58 % of the resistance at 10 kn (system page); the control catches up with a little more."""
    # the upper bound was set after the first run had shown 0.63: it guards against growth, it does not confirm the 0.58
    peak = float(mission["hull.acceleration_max"].sel(time=slice(310.0, 600.0)).max())
    assert 0.58 <= peak * 407.16e3 / 18.06e3 < 1.15 * 0.58


def test_speed_overshoots_by_less_than_two_percent_and_the_ship_stops(mission):
    u = mission["hull.u_ship"]
    assert float(u.max()) < 1.02 * 10.0 * KNOT
    assert float(u.min()) > -1.02 * 10.0 * KNOT
    assert abs(float(u.sel(time=1799.0, method="nearest"))) < 0.1 * KNOT
    assert abs(float(u[-1])) < 0.1 * KNOT
    assert float(mission["hull.distance"].max()) == pytest.approx(3.8 * 1852.0, rel=0.1)  # 3.8 nmi a leg, system page


def test_the_way_back_mirrors_the_way_out(mission):
    for out, back in (
        ("propulsion_for.omega_m", "propulsion_for.omega_m"),
        ("propulsion_aft.tau_e", "propulsion_aft.tau_e"),
    ):
        assert mean(mission, out, *AT_10_KN) == pytest.approx(-mean(mission, back, *WAY_BACK), rel=1e-3)
    for out, back in (("genset_for.p_pu", "genset_aft.p_pu"), ("dc_for.v_dc", "dc_aft.v_dc")):
        assert mean(mission, out, *AT_10_KN) == pytest.approx(mean(mission, back, *RECHARGE_BACK), rel=2e-3)


def test_the_second_recharge_ends_at_the_makers_sixty_per_cent(mission):
    ends = {outcome.name: outcome.last_s for outcome in mission.timeline}
    for side in ("for", "aft"):
        at = ends["battery fore charged" if side == "for" else "battery aft charged"]
        soc = mission[f"bess_{side}.soc"]
        assert float(soc.sel(time=at, method="nearest")) == pytest.approx(0.6, abs=2e-4)  # of a second's charge
        assert float(mission[f"bess_{side}.soc_max"].sel(time=slice(2000.0, None)).max()) < 0.601
        assert mean(mission, f"bess_{side}.i_b", *CHARGED) == pytest.approx(0.0, abs=1.5)
        given = [e.text for e in mission.events if e.source == f"bess_{side}.i_ref" and " by " in e.text]
        assert len(given) == 1 and given[0].endswith(f"bess_{side}.soc above 60 %, after recharge on the way back")


def test_on_and_off_are_sequences_that_say_what_they_do(mission):
    texts = [(e.source, e.text) for e in mission.events]
    order = [text for source, text in texts if source == "genset_for"]
    assert order[:4] == ["cranking", "running up", "building up voltage", "on"]
    assert order[-1] == "off"
    assert any(source == "rectifier_for" and "unloading" in text for source, text in texts)
    assert not any("refused" in text for _, text in texts)


def test_genset_opens_only_when_the_rest_carries_the_load(mission):
    p = mission["rectifier_for.p_dc"].sel(time=slice(1421.0, 1559.0))
    off = [e.time for e in mission.events if e.source == "genset_for" and e.text in ("cooling down", "off")]
    assert off
    assert float(p.sel(time=slice(off[0] + 1.0, None)).max()) < 1e3
    v = mission["dc_for.v_dc"].sel(time=slice(1421.0, 1559.0))
    assert float(v.min()) > 715.0


def program(path):
    """A program of this repository as a module."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, Path(__file__).parents[2] / path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_figures_of_the_page_are_measured_again_by_its_program(mission):
    module = program("benchmarks/reproducing.py")
    rows = dict(module.mission(module.Look(mission)))
    assert rows["SOC at Laveno"].startswith("62.") and rows["battery fore charged"].startswith("once, at 24")
    assert not any("nan" in text or "inf" in text for text in rows.values()), rows


def test_the_example_draws_its_figure(mission, tmp_path):
    module = program("examples/plot_mission.py")
    module.draw(mission, tmp_path / "mission.png")
    assert (tmp_path / "mission.png").stat().st_size > 20_000


NOMINAL = {
    "dc_for.v_dc": 750.0,
    "dc_aft.v_dc": 750.0,
    "dc_tie.i": 795.0,
    "bess_for.i_b": 128.0,
    "bess_aft.i_b": 128.0,
    "bess_for.soc": 1.0,
    "genset_for.p_pu": 1.0,
    "genset_aft.p_pu": 1.0,
    "genset_for.q_ac": 596e3,
    "genset_for.omega_pu": 1.0,
    "genset_for.v_pu": 1.0,
    "rectifier_for.p_dc": 596e3,
    "propulsion_for.p_dc": 270e3,
    "propulsion_aft.omega_m": 47.1,
    "propeller_for.thrust": 37.9e3,
    "ac_for.v_rms_pu": 1.0,
    "ac_aft.f": 60.0,
    "inverter_for.p_ac": 50e3,
    "hull.u_ship": 5.144,
}
BEFORE, IN_PORT, AT_THE_END = ((2.0, 9.0), (250.0, 305.0)), (1780.0, 1799.0), (3385.0, 3400.0)
SETTLED = (*BEFORE, AT_10_KN, IN_PORT, (2040.0, 2095.0), RECHARGE_BACK, CHARGED, AT_THE_END)


@pytest.mark.full
def test_at_switching_fidelity_it_meets_every_requirement_and_agrees_in_every_settled_mean(mission, tmp_path):
    """113 million steps, about ten minutes."""
    switching = sg.simulate(
        sg.load_ship("ferry"), sg.load_scenario("mission"), fidelity="switching", out=tmp_path / "switching"
    )
    assert switching.summary["step_s"] == 30e-6
    assert all(v.ok for v in switching.requirements), [v for v in switching.requirements if not v.ok]
    assert all(v.ok for v in switching.class_limits), [v for v in switching.class_limits if not v.ok]
    for start, end in SETTLED:
        for name, nominal in NOMINAL.items():
            a, b = (mean(run, name, start, end) for run in (mission, switching))
            assert b == pytest.approx(a, abs=5e-3 * nominal), (name, start)
    ours, theirs = switching.events, mission.events
    assert [(e.source, e.text) for e in ours] == [(e.source, e.text) for e in theirs]
    gaps = [(abs(a.time - b.time), " by battery " in a.text) for a, b in zip(ours, theirs, strict=True)]
    assert max(gap for gap, of_charge in gaps if not of_charge) < 0.2  # two looks of a sequence's timer
    # the charges agree within 0.06 points of 100 (above, 0.5 are allowed), which are 3.6 s of recharge
    assert max(gap for gap, of_charge in gaps if of_charge) < 5.0
    assert (switching.folder / "report.html").stat().st_size < 3e6


@pytest.mark.full
def test_settled_means_at_the_long_step_are_those_at_30_us(mission, tmp_path):
    ship = sg.load_ship("ferry")
    fine = sg.simulate(ship, sg.load_scenario("mission"), step=30e-6, until=1390.0, out=tmp_path / "fine", report=False)
    for name, nominal in (
        ("dc_for.v_dc", 750.0),
        ("bess_for.i_b", 128.0),
        ("genset_for.p_pu", 1.0),
        ("hull.u_ship", 5.144),
    ):
        for start, end in ((2.0, 9.0), (250.0, 305.0), AT_10_KN):
            assert mean(mission, name, start, end) == pytest.approx(mean(fine, name, start, end), abs=1e-3 * nominal)
