"""The whole ferry for seconds: it starts at rest and stays there, runs alike twice, and converges with the step."""

from __future__ import annotations

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.analysis.settling import advance, advancing, run_to_rest
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.plan import Plan
from shipgrid.assembly.tables import arguments, type_views
from shipgrid.assembly.workspace import Workspace, new_workspace
from shipgrid.components.mechanical.diesel_engine import DieselEngine
from shipgrid.controllers.ship_speed import ShipSpeed, demand
from shipgrid.model.network import Network
from shipgrid.scenarios.case import build

KNOT = 1852.0 / 3600.0
NOMINAL = {"V": 750.0, "A": 128.0, "W": 50e3, "var": 50e3, "Hz": 60.0, "rad/s": 47.0, "N m": 5730.0, "N": 2e4, "1": 1.0}


@pytest.fixture(scope="module")
def ship():
    return sg.load_ship("ferry")


@pytest.fixture(scope="module")
def commands(ship):
    return sg.load_scenario("mission").start_commands(ship)


def public(plan: Plan, work: Workspace) -> dict[str, float]:
    return {name: float(work.sig[plan.layout.index[p.source]]) for name, p in plan.network.published.items()}


def means(plan: Plan, work: Workspace, seconds: float) -> dict[str, float]:
    """Mean of every public signal over an interval, from one sample each 1.1 ms (no multiple of any clock)."""
    on, samples = advancing(plan, work), []
    for _ in range(round(seconds / 1.1e-3)):
        on(1.1e-3)
        samples.append(list(public(plan, work).values()))
    return dict(zip(public(plan, work), np.mean(samples, axis=0), strict=True))


def scale(plan: Plan, name: str) -> float:
    if name.startswith(("genset", "rectifier")) and plan.network.published[name].unit in ("W", "var"):
        return 596e3
    return NOMINAL.get(plan.network.published[name].unit, 1.0)


def test_a_run_started_at_the_operating_point_stays_there(ship, commands):
    plan = build(ship, 30e-6)
    work, drift = run_to_rest(plan, commands)
    assert drift < 2e-4
    first = means(plan, work, 0.5)
    advance(plan, work, 4.0)
    last = means(plan, work, 0.5)
    for name, value in first.items():
        # the batteries give 2 x 21 A: their voltage falls by 1e-5 of itself in 5 s, and their current follows
        assert last[name] == pytest.approx(value, abs=3e-4 * scale(plan, name)), name


def test_moored_plant_gives_what_the_hotel_load_takes(ship, commands):
    plan = build(ship, 30e-6)
    work, _ = run_to_rest(plan, commands)
    now = means(plan, work, 0.5)
    for side in ("for", "aft"):
        # droop in both: 3.413 A/V
        assert now[f"bess_{side}.i_b"] == pytest.approx(
            128.0 / 0.05 / 750.0 * (750.0 - now[f"dc_{side}.v_dc"]), abs=0.05
        )
        # 10 kW at 1 pu, constant impedance; P-f droop of 2 %
        load = 10e3 * now[f"ac_{side}.v_pu"] ** 2
        assert now[f"hotel_{side}.p_ac"] == pytest.approx(load, rel=2e-3)
        assert now[f"inverter_{side}.f"] == pytest.approx(
            60.0 * (1.0 - 0.02 * now[f"inverter_{side}.p_ac"] / 50e3), abs=0.02
        )
        assert now[f"propulsion_{side}.omega_m"] == 0.0
        assert now[f"genset_{side}.on"] == 0.0


def with_a_genset(ship, commands, step: float) -> tuple[Plan, Workspace, dict[str, float]]:
    """Genset fore started from moored and loaded by the droop; its reactive loop (0.13 1/s) has a minute."""
    plan = build(ship, step)
    work, _ = run_to_rest(plan, commands)
    work.sig[plan.layout.index["command:genset_for.on"]] = 1.0
    advance(plan, work, 65.0)
    return plan, work, means(plan, work, 1.0)


@pytest.fixture(scope="module")
def at_30_us(ship, commands):
    return with_a_genset(ship, commands, 30e-6)


@pytest.mark.parametrize("step", [pytest.param(15e-6, marks=pytest.mark.full), 90e-6])
def test_settled_means_do_not_depend_on_the_step(ship, commands, at_30_us, step):
    plan, _, at_30 = at_30_us
    _, _, other = with_a_genset(ship, commands, step)
    assert at_30["rectifier_for.p_dc"] > 15e3
    for name, value in at_30.items():
        assert other[name] == pytest.approx(value, abs=1e-3 * scale(plan, name)), name


WINDOW = 5.0
"""Length [s] of the interval whose mean is compared, from every step of it."""
COUNTERS = ("hull.distance", "bess_for.soc", "bess_aft.soc")


def plan_of(ship, step: float) -> Plan:
    """The ferry at a step, its recorder set to rows of one window."""
    network = Network("ferry")
    ship.build(network)
    return assemble(network, step, record=WINDOW, record_slow=WINDOW)


def carried_over(plan: Plan, other: Plan, settled: Workspace) -> Workspace:
    """A workspace at the state that another plan, of another step, has settled in.

    Delay lines have another length; in a settled state all cells of a line hold what goes into it.
    """
    work = new_workspace(plan)
    work.sig[:] = settled.sig
    engines = next(t for t in plan.layout.types if t.kind.cls is DieselEngine)
    views = type_views(plan, work, engines)
    views["x"]["position"] = 0.0
    starts = views["p"]["line"].astype(int)
    for k, start in enumerate(starts):
        end = min((s for s in starts if s > start), default=len(work.step.delays))
        work.step.delays[start:end] = views["u"]["throttle"][k]
    work.step.previous[:] = work.sig
    work.step.watched_was[:] = work.sig[plan.step.watched]
    return work


@pytest.fixture(scope="module")
def at_10_kn(ship, commands):
    """10 kn on one genset with recharge, settled at 90 us; the ship is put near its speed, not sailed there."""
    plan = plan_of(ship, 90e-6)
    work, _ = run_to_rest(plan, commands)
    index = plan.layout.index
    work.sig[index["command:genset_for.on"]] = 1.0
    advance(plan, work, 15.0)
    for path, value in (("bess", -128.0), ("propulsion", 10.0 * KNOT)):
        for side in ("for", "aft"):
            work.sig[index[f"command:{path}_{side}.{'i_ref' if path == 'bess' else 'speed_ref'}"]] = value
    work.sig[index["hull.surge.u_ship"]] = 10.0 * KNOT
    for side in ("for", "aft"):
        work.sig[index[f"propulsion_{side}.shaft.omega_m"]] = 307.0 * np.pi / 30.0
        work.sig[index[f"propulsion_{side}.cruise.u_ramp"]] = 10.0 * KNOT
        work.sig[index[f"propulsion_{side}.cruise.u_lag"]] = 10.0 * KNOT
        work.sig[index[f"propulsion_{side}.cruise.speed.i"]] = demand.py_func(307.0 / 450.0, ShipSpeed().y_0)
    advance(plan, work, 90.0)
    return plan, work


def window_means(plan: Plan, work: Workspace) -> dict[str, float]:
    """Mean of every public signal over the next window."""
    assert work.n % plan.step.record_every == 0
    advance(plan, work, WINDOW)
    names = plan.groups["plant"], plan.groups["slow"]
    rows = work.step.plant_rows[3, 0], work.step.slow_rows[3, 0]
    found = {n: float(v) for group, row in zip(names, rows, strict=True) for n, v in zip(group, row, strict=True)}
    return {name: value for name, value in found.items() if name not in COUNTERS}


def test_settled_means_at_10_kn_do_not_depend_on_the_step(ship, at_10_kn):
    coarse, settled = at_10_kn
    found = {}
    for step in (90e-6, 30e-6, 15e-6):
        plan = plan_of(ship, step)
        work = carried_over(plan, coarse, settled)
        advance(plan, work, WINDOW)  # what the change of step moved settles again
        before, found[step] = (window_means(plan, work) for _ in range(2))
        for name, value in found[step].items():  # settled: nothing drifts by a tenth of what is asked for
            assert value == pytest.approx(before[name], abs=1e-4 * scale(plan, name)), (step, name)
    at_30 = found[30e-6]
    assert at_30["hull.u_ship"] == pytest.approx(10.0 * KNOT, rel=1e-3)
    assert 0.46 < at_30["genset_for.p_pu"] < 0.56 and -80.0 < at_30["bess_for.i_b"] < -65.0
    for step in (90e-6, 15e-6):
        for name, value in at_30.items():
            assert found[step][name] == pytest.approx(value, abs=1e-3 * scale(coarse, name)), (step, name)


def test_hard_transients_stay_far_from_what_counts_as_absurd(ship, commands):
    """So that the check for absurd values gives no false alarm: everything that can be done to the plant at once."""
    plan = build(ship, 90e-6)
    work, _ = run_to_rest(plan, commands)
    entry, values = core(), arguments(plan, work)
    largest = np.zeros(len(work.sig))
    full_ahead = {"propulsion_for.speed_ref": 5.1, "propulsion_aft.speed_ref": 5.1}
    full_astern = {path: -value for path, value in full_ahead.items()}
    for seconds, given in (
        (12.0, {"genset_for.on": 1.0, "genset_aft.on": 1.0, **full_ahead}),
        (1.0, {"dc_tie.close": 0.0, "ac_tie.close": 1.0}),
        (2.0, {"dc_tie.close": 1.0, **full_astern}),
        (2.0, {"inverter_for.on": 0.0, "genset_for.on": 0.0}),
        (4.0, {"bess_for.on": 0.0, "bess_aft.on": 0.0}),
    ):
        for path, value in given.items():
            work.sig[plan.layout.index[f"command:{path}"]] = value
        for _ in range(round(seconds / plan.h / 10)):
            assert entry(10, work.n, *values) == 10
            work.n += 10
            work.step.rows[:] = 0
            np.maximum(largest, np.abs(work.sig), out=largest)
    assert work.sig[plan.layout.index["genset_aft.sequence.state"]] != 0.0  # something was going on
    closest = int(np.argmax(largest / plan.step.absurd))
    named = {place: name for name, place in plan.layout.index.items()}
    assert largest[closest] < 0.2 * plan.step.absurd[closest], named[closest]  # the nearest is a genset's speed


def test_two_runs_are_bit_identical(ship, commands):
    found = []
    for _ in range(2):
        plan = build(ship, 100e-6)
        work, _ = run_to_rest(plan, commands)
        work.sig[plan.layout.index["command:propulsion_for.speed_ref"]] = 1.0
        advance(plan, work, 2.0)
        found.append(work.sig.copy())
    assert np.array_equal(found[0], found[1], equal_nan=True)
