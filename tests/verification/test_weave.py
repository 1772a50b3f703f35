"""A woven module is compiled again when any source it depends on changes, and never for anything else.

Each case runs in a process of its own on a copy of the package, with a cache folder of its own.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import shipgrid
from shipgrid.assembly.plan import assemble, new_workspace
from shipgrid.assembly.weave import arguments, woven_entry
from shipgrid.model import component, kernel, signal
from shipgrid.model.network import Network
from shipgrid.units import Ratio

SCRIPT = """
import json, sys
from shipgrid.assembly.plan import assemble, new_workspace
from shipgrid.assembly.weave import arguments, woven_entry
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.controllers.drive_current import DriveCurrent
from shipgrid.controllers.motor_speed import MotorSpeed
from shipgrid.model.network import Across, Network

case = {"drives": 1, "K_p": 10.0, "n_ref": 0.05, "measures": "a.v_dc", "step": 50e-6} | json.loads(sys.argv[1])
net = Network("copy")
a, b = net.dc_bus("a", 750.0), net.dc_bus("b", 750.0)
net.capacitance(a, 1e-3)
net.capacitance(b, 1e-3)
net.add("branch", RlBranch(R=1.0, L=1e-3), ports={"branch": Across(a, b)})
for k in range(case["drives"]):
    net.add(f"speed_{k}", MotorSpeed(K_p=case["K_p"], K_i=0.0),
            inputs={"n_ref": case["n_ref"], "omega_pu": 0.0, "v_dc": case["measures"]})
    currents = {"i_d": 0.0, "i_q": 0.0, "theta_e": 0.3, "omega_m": 0.0, "v_dc": case["measures"]}
    net.add(f"current_{k}", DriveCurrent(), inputs=currents | {"tau_ref": f"speed_{k}.tau_ref"})
plan = assemble(net, case["step"])
work = new_workspace(plan)
for node in ("a.v_dc", "b.v_dc"):
    work.sig[plan.layout.index[node]] = 750.0
run = woven_entry(plan)
assert run(4, 0, *arguments(plan, work)) == 4
signals = {n: work.sig[plan.layout.index[n]] for n in ("speed_0.tau_ref", "current_0.s_alpha", "current_0.s_beta")}
misses = sum(run.stats.cache_misses.values()) if hasattr(run, "stats") else 0
print(json.dumps(signals | {"module": run.__module__, "compiled": misses}))
"""

EDITS = {
    "a component": (
        "controllers/motor_speed.py",
        "pi(u.n_ref - u.omega_pu, 0.0,",
        "pi(u.n_ref - u.omega_pu, 0.125,",
        "speed_0.tau_ref",
        lambda old: old + 0.125,
    ),
    "a block it nests": (
        "controllers/blocks/pi.py",
        "wanted = k_p * e + x.i + ff",
        "wanted = 2.0 * k_p * e + x.i + ff",
        "speed_0.tau_ref",
        lambda old: 2.0 * old,
    ),
    "ops": (
        "model/ops.py",
        "return minimum(maximum(a, low), high)",
        "return minimum(maximum(a, low), high) + 0.25",
        "speed_0.tau_ref",
        lambda old: old + 0.25,
    ),
    "frames": (
        "model/frames.py",
        "return cos * d - sin * q, sin * d + cos * q",
        "return 3.0 * (cos * d - sin * q), sin * d + cos * q",
        "current_0.s_alpha",
        lambda old: 3.0 * old,
    ),
}


class Copy:
    """A copy of the package that may be edited."""

    def __init__(self, folder: Path):
        self.folder, self.cache = folder, folder / "cache"
        shutil.copytree(
            Path(shipgrid.__file__).parent, folder / "shipgrid", ignore=shutil.ignore_patterns("__pycache__")
        )

    def run(self, compiler: bool = True, **case) -> dict:
        """Signals of the small plant, run in a new process; the module's name, and how many functions it compiled."""
        surroundings = os.environ | {
            "NUMBA_DISABLE_JIT": "0" if compiler else "1",
            "PYTHONPATH": str(self.folder),
            "SHIPGRID_CACHE": str(self.cache),
            # a source changed twice within a second must not be taken from byte code of the first change
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT, json.dumps(case)],
            env=surroundings,
            cwd=self.folder,
            capture_output=True,
            text=True,
            timeout=100,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def files(self) -> dict[str, int]:
        """Every file of the cache, with the time it was written."""
        found = (path for path in self.cache.rglob("*") if path.is_file())
        return {str(path.relative_to(self.cache)): path.stat().st_mtime_ns for path in found}


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    made = Copy(tmp_path_factory.mktemp("copy"))
    made.first = {compiler: made.run(compiler) for compiler in (False, True)}
    return made


def test_the_first_run_compiles(copy):
    first = copy.first[True]
    assert first["compiled"] == 1
    assert any(name.startswith(first["module"]) for name in copy.files())
    assert first["speed_0.tau_ref"] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("what", "compiler"),
    [
        *((what, False) for what in EDITS),  # a module of another name has no machine code on disk
        ("ops", True),
        *(pytest.param(what, True, marks=pytest.mark.full) for what in EDITS if what != "ops"),
    ],
)
def test_an_edit_is_seen_at_the_next_start_and_its_reversal_too(copy, what, compiler):
    name, old, new, signal_, expected = EDITS[what]
    path, first = copy.folder / "shipgrid" / name, copy.first[compiler]
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    try:
        edited = copy.run(compiler)
    finally:
        path.write_text(text)
    assert edited[signal_] == pytest.approx(expected(first[signal_]), rel=1e-9)
    assert edited["module"] != first["module"] and edited["compiled"] == int(compiler)
    assert copy.run(compiler) == first | {"compiled": 0}


def test_values_connections_numbers_of_instances_and_the_step_compile_nothing(copy):
    before = copy.files()
    case = {"K_p": 5.0, "n_ref": 0.08, "drives": 3, "measures": "b.v_dc", "step": 20e-6}
    changed = copy.run(**case)
    assert changed["compiled"] == 0
    assert changed["module"] == copy.first[True]["module"]
    assert changed["speed_0.tau_ref"] == pytest.approx(5.0 * 0.08)
    assert copy.files() == before


def test_a_plant_runs_without_the_compiler_to_the_last_bit(copy):
    """So that a debugger can step through it."""
    plain, compiled = copy.run(compiler=False, drives=2), copy.run(drives=2)
    assert plain["compiled"] == 0
    for name in ("speed_0.tau_ref", "current_0.s_alpha", "current_0.s_beta"):
        assert plain[name] == compiled[name] != 0.0


class LinkInput:
    given: Ratio = signal("what it doubles", initial=0.0)


class LinkOutput:
    value: Ratio = signal("the double")


@kernel
def link_outputs(u, y):
    y.value = 2.0 * u.given


@component(input=LinkInput, output=LinkOutput, outputs=link_outputs, stage="outer")
class FirstLink:
    """Doubles."""


@component(input=LinkInput, output=LinkOutput, outputs=link_outputs, stage="outer")
class SecondLink:
    """Doubles as well."""


@pytest.mark.parametrize(("before", "after"), [(FirstLink, SecondLink), (SecondLink, FirstLink)])
def test_components_of_one_stage_run_in_the_order_of_their_connections_whichever_that_is(before, after):
    """The order is written into the module: two plants with the same types and the opposite order need two."""
    net = Network("links")
    bus = net.dc_bus("bus", 100.0)
    net.capacitance(bus, 1e-3)
    net.add("before", before(), inputs={"given": 1.5})
    net.add("after", after(), inputs={"given": "before.value"})
    plan = assemble(net, 30e-6)
    work = new_workspace(plan)
    assert woven_entry(plan)(1, 0, *arguments(plan, work)) == 1
    assert work.sig[plan.layout.index["after.value"]] == 6.0
