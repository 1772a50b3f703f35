"""What a run does when something goes wrong: it diverges, is interrupted, or has no place for its results."""

from __future__ import annotations

import json
import os
import shutil
import signal as signals
from collections import namedtuple

import numpy as np
import pytest
from typer.testing import CliRunner

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.cli.main import app
from shipgrid.components.mechanical.shaft import Shaft
from shipgrid.controllers.blocks.pi import PiState, pi
from shipgrid.controllers.governor_degov1 import Degov1
from shipgrid.errors import ParameterError, SolverError
from shipgrid.io.scenario_file import load_scenario
from shipgrid.io.ship_file import load_ship
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.network import Network
from shipgrid.model.placed import Every, Sampled
from shipgrid.scenarios import conclude
from shipgrid.scenarios import simulate as simulation
from shipgrid.scenarios.results import open_results
from shipgrid.scenarios.session import Run, run_until
from shipgrid.units import NewtonMetre, PerSecond, Ratio, Volt
from verification.circuits import Hold, SourceBranch

STEP, V_N = 30e-6, 200.0
SCENARIO = """\
schema: 1
scenario: short
description: nothing is asked for
duration: 2 s
start: {state: moored}
"""


class RegulatorState:
    loop: PiState


class RegulatorInput:
    v: Volt = signal("measured voltage")


class RegulatorOutput:
    e: Volt = signal("source voltage")


@kernel
def regulate(dt, x, u, p, x_next, y):
    y.e = -pi(p.v_ref - u.v, 0.0, p.K_p, p.K_i, -1e300, 1e300, dt, x.loop, x_next.loop)


@component(state=RegulatorState, input=RegulatorInput, output=RegulatorOutput, update=regulate, stage="inner")
class Regulator:
    """Voltage control without the limits that would hold an absurd gain."""

    v_ref: Volt = param("reference", default=V_N, above=0.0)
    K_p: Ratio = param("proportional gain", at_least=0.0)
    K_i: PerSecond = param("integral gain", at_least=0.0)


def feeder(K_p: float = 0.1, K_i: float = 20.0):
    """A regulated source behind R and L on a capacitive bus."""
    net = Network("feeder")
    bus = net.dc_bus("bus", V_N)
    net.capacitance(bus, 1e-3)
    net.conductance(bus, 0.05)
    net.add("regulator", Regulator(K_p=K_p, K_i=K_i), inputs={"v": "bus.v_dc"}, clock=Sampled(5e3))
    net.add("source", SourceBranch(R=0.1, L=1e-3), ports={"ends": bus}, inputs={"e": "regulator.e"})
    net.publish("bus.v_dc", source="bus.v_dc", unit="V", description="bus voltage")
    net.publish("source.i", source="source.i", unit="A", description="source current", group="slow")
    return assemble(net, STEP, record=1e-3, record_slow=1e-2)


ABSURD = {"K_p": 1e3, "K_i": 20.0}


@pytest.fixture
def ferry(monkeypatch):
    """The runner, given the feeder in place of the ferry's network; returns what to change its gains with."""
    gains: dict[str, float] = {}
    monkeypatch.setattr(simulation, "build", lambda ship, step, fidelity, rules, parts: feeder(**gains))
    monkeypatch.setattr(simulation, "start", lambda plan, ship, scenario: (new_workspace(plan), 0.0))
    monkeypatch.setattr(
        simulation, "Interlocks", lambda ship, plan: None
    )  # they know the ferry's items, not the feeder
    return gains


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(SCENARIO)
    return path


def simulate(scenario, out, **options):
    ship = load_ship("ferry")
    return simulation.simulate(ship, load_scenario(scenario, ship), out=out, report=False, **options)


def left_over(folder, *known: str) -> list[str]:
    """Everything in a folder but what is known to be there; hidden files count."""
    return sorted(p.name for p in folder.iterdir() if p.name not in known)


def test_with_a_sane_gain_the_bus_is_regulated():
    plan = feeder()
    run = Run(plan, new_workspace(plan))
    run_until(run, None, 2.0)
    assert not run.failure
    assert run.work.sig[plan.layout.index["bus.v_dc"]] == pytest.approx(V_N, rel=1e-3)


@pytest.mark.parametrize("gain", [1e3, 1e8, 1e200])
def test_a_diverging_run_stops_at_the_first_absurd_value_and_says_where(gain):
    plan = feeder(K_p=gain)
    run = Run(plan, new_workspace(plan))
    run_until(run, None, 2.0)
    watched = new_workspace(plan)
    entry, place = core(), plan.layout.index["bus.v_dc"]
    while np.isfinite(watched.sig).all() and abs(watched.sig[place]) < 3.0 * V_N:  # step by step, to the first absurd
        entry(1, watched.n, *arguments(plan, watched))
        watched.n += 1
        assert watched.n < 10_000
    assert abs(run.work.n - watched.n) <= 3
    assert run.failure.startswith(f"diverged at {run.t:.6f} s")
    assert "bus.v_dc" in run.failure and ("regulator" in run.failure or "source" in run.failure)
    assert run.events[-1] == (run.t, "feeder", run.failure)


def test_a_number_that_is_none_stops_the_run_within_a_few_steps():
    plan = feeder()
    work = new_workspace(plan)
    work.sig[plan.layout.index["regulator.loop.i"]] = np.nan
    run = Run(plan, work)
    run_until(run, None, 2.0)
    assert run.work.n <= 2 * round(1 / 5e3 / STEP) + 3  # a sampling period, until it is in force
    assert "nan" in run.failure


class TorqueOutput:
    tau: NewtonMetre = signal("torque")


@kernel
def constant_torque(p, y):
    y.tau = p.tau_0


@component(output=TorqueOutput, outputs=constant_torque, stage="outer")
class Torque:
    """Gives a torque, whatever it is."""

    tau_0: NewtonMetre = param("torque")


def beside_a_bus(T_3: float = 0.2, K: float = 8.0, tau: float = 2e3, K_p: float = 0.1) -> Network:
    """A bus at rest, and a governor, a shaft and a regulator that cannot disturb it."""
    net = Network("quiet")
    bus = net.dc_bus("bus", V_N)
    net.capacitance(bus, 1e-3)
    net.conductance(bus, 0.05)
    net.add("speed", Hold(), inputs={"wanted": net.command("speed", 0.95)})
    net.add("governor", Degov1(T_3=T_3, K=K), inputs={"omega": "speed.value", "omega_ref": 1.0}, clock=Every(0.5e-3))
    net.add("motor", Torque(tau_0=tau))
    net.add("shaft", Shaft(), inputs={"tau_e": "motor.tau"})
    net.add("regulator", Regulator(K_p=K_p, K_i=20.0), inputs={"v": "bus.v_dc"}, clock=Sampled(5e3))
    return net


@pytest.mark.parametrize(
    ("parameter", "absurd", "named", "limit"),
    [
        ("T_3", 8e9, "governor.a_1", 1e6),
        ("tau", 5e7, "shaft.omega_m", 1e3),
        ("tau", 1e12, "motor.tau", 1e9),
        ("K_p", 1e9, "regulator.e", 1e6),
    ],
)
def test_an_absurd_value_away_from_the_network_stops_the_run_within_a_millisecond(parameter, absurd, named, limit):
    plan = assemble(beside_a_bus(), STEP)
    run = Run(plan, new_workspace(plan))
    run_until(run, None, 0.5)
    assert not run.failure

    plan = assemble(beside_a_bus(**{parameter: absurd}), STEP)
    run = Run(plan, new_workspace(plan))
    run_until(run, None, 0.5)
    assert run.failure.startswith(f"diverged at {run.t:.6f} s: {named}"), run.failure
    assert run.work.sig[plan.layout.index["bus.v_dc"]] == 0.0  # no bus could have told
    watched = new_workspace(plan)
    entry = core()
    while np.abs(watched.sig[plan.layout.index[named]]) <= limit:  # step by step, to the first absurd one
        entry(1, watched.n, *arguments(plan, watched))
        watched.n += 1
        assert watched.n < 20_000
    assert 0.0 <= run.t - watched.n * STEP <= 1e-3 + 1e-9


def test_an_absurd_gain_of_an_integrator_keeps_it_between_its_stops():
    plan = assemble(beside_a_bus(K=8e9), STEP)
    run = Run(plan, new_workspace(plan))
    run_until(run, None, 0.5)
    assert not run.failure
    throttle, z_1 = (run.work.sig[plan.layout.index[f"governor.{name}"]] for name in ("throttle", "z_1"))
    assert -0.05 <= throttle <= 1.1
    assert abs(z_1) < 0.05 + 0.05 * 1.1  # the error it follows: speed and droop


def test_a_control_signal_that_is_no_number_is_seen_although_every_bus_is_well():
    plan = assemble(beside_a_bus(), STEP)
    work = new_workspace(plan)
    work.sig[plan.layout.index["governor.a_1"]] = np.nan
    run = Run(plan, work)
    run_until(run, None, 0.5)
    assert run.t <= 1e-3 + STEP
    assert "governor." in run.failure and "nan" in run.failure


def test_results_up_to_the_failure_are_kept(ferry, scenario, tmp_path):
    ferry |= {"K_p": 5.0}
    with pytest.raises(SolverError, match=r"diverged at .* results up to then are in .*out"):
        simulate(scenario, tmp_path / "out")
    assert left_over(tmp_path, "short.yaml") == ["out"]
    results = open_results(tmp_path / "out")
    assert results.summary["failure"].startswith("diverged") and not results.summary["interrupted"]
    kept = results["bus.v_dc"]
    assert len(kept) >= 2 and np.all(np.isfinite(kept))
    assert 0.0 < results.summary["simulated_s"] < 2.0
    assert any("diverged" in text for *_, text in map(tuple, events_of(results)))


def events_of(results):
    return [tuple(event.values()) if isinstance(event, dict) else event for event in results.events]


def test_the_command_line_reports_a_failed_run_with_exit_status_3(ferry, scenario, tmp_path):
    ferry |= {"K_p": 5.0}
    said = CliRunner().invoke(app, ["run", str(scenario), "--out", str(tmp_path / "out"), "--no-report"])
    assert said.exit_code == 3, said.output
    assert "the simulation failed: diverged at" in said.output and "bus.v_dc" in said.output
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["failure"]


def test_an_interrupt_keeps_what_was_computed(ferry, scenario, tmp_path):
    calls = []

    def progress(now, end):
        calls.append(now)
        if len(calls) == 3:
            raise KeyboardInterrupt

    results = simulate(scenario, tmp_path / "out", progress=progress)
    assert results.summary["interrupted"] and not results.summary["failure"]
    assert 0.0 < results.summary["simulated_s"] < 2.0
    assert results.summary["simulated_s"] == pytest.approx(calls[-1])
    rows = -(-results.summary["steps"] // 33)  # recorded every 33 steps, and at the last instant
    assert len(results["bus.v_dc"]) == 1 + rows
    assert left_over(tmp_path, "short.yaml") == ["out"]


def test_an_interrupt_signal_ends_the_run_between_two_chunks(ferry, scenario, tmp_path):
    results = simulate(scenario, tmp_path / "out", progress=lambda now, end: os.kill(os.getpid(), signals.SIGINT))
    assert results.summary["interrupted"]
    assert 0.0 < results.summary["simulated_s"] < 2.0
    assert float(results["bus.v_dc"]["time"][-1]) == pytest.approx(results.summary["simulated_s"])
    assert results.events[-1].text == "interrupted"


def test_the_command_line_ends_an_interrupted_run_with_exit_status_130(ferry, scenario, tmp_path, monkeypatch):
    import rich.progress

    def interrupted(self, *args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(rich.progress.Progress, "update", interrupted)
    said = CliRunner().invoke(app, ["run", str(scenario), "--out", str(tmp_path / "out"), "--no-report"])
    assert said.exit_code == 130, said.output
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["interrupted"]


def test_an_interrupt_before_the_first_step_leaves_nothing(ferry, scenario, tmp_path, monkeypatch):
    def interrupted(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        simulate(scenario, tmp_path / "out")
    assert left_over(tmp_path, "short.yaml") == []


def never(*args):
    raise AssertionError("the run was started")


def test_a_full_disk_is_reported_before_the_run_starts(ferry, scenario, tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**9, 10**9 - 1000, 1000))
    monkeypatch.setattr(simulation, "start", never)
    with pytest.raises(ParameterError, match=r"--out: .*out has 1 kB free, expected at least \d.* for this run"):
        simulate(scenario, tmp_path / "deep" / "out")
    assert left_over(tmp_path, "short.yaml") == []
    said = CliRunner().invoke(app, ["run", str(scenario), "--out", str(tmp_path / "out")])
    assert said.exit_code == 2 and "free" in said.output


def test_a_place_that_cannot_be_written_is_reported_before_the_run_starts(ferry, scenario, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setattr(simulation, "start", never)
    with pytest.raises(ParameterError, match="cannot be written: a file is in the way, expected another folder"):
        simulate(scenario, tmp_path / "file" / "out")
    with pytest.raises(ParameterError, match="is a file, expected a folder"):
        simulate(scenario, tmp_path / "file")
    said = CliRunner().invoke(app, ["run", str(scenario), "--out", str(tmp_path / "file" / "out")])
    assert said.exit_code == 2 and "cannot be written" in said.output
    assert left_over(tmp_path, "short.yaml") == ["file"]
    assert (tmp_path / "file").read_text() == "in the way"


def test_older_results_stay_if_the_new_run_cannot_start(ferry, scenario, tmp_path, monkeypatch):
    simulate(scenario, tmp_path / "out", until=0.01)
    before = (tmp_path / "out" / "summary.json").read_text()

    def failed(*args):
        raise SolverError("no start")

    monkeypatch.setattr(simulation, "start", failed)
    with pytest.raises(SolverError):
        simulate(scenario, tmp_path / "out")
    assert (tmp_path / "out" / "summary.json").read_text() == before
    assert left_over(tmp_path, "short.yaml") == ["out"]


def test_a_disk_that_fills_up_during_the_run_keeps_what_was_written(ferry, scenario, tmp_path, monkeypatch):
    def full(*args):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(SolverError, match="No space left"):
        patch.setattr(conclude, "make_results", full)
        simulate(scenario, tmp_path / "out", until=0.01)
    (left,) = left_over(tmp_path, "short.yaml")
    assert left.startswith(".out-")
    simulate(scenario, tmp_path / "out", until=0.01, resume=True).close()
    assert left_over(tmp_path, "short.yaml") == ["out"]
