"""A component type is compiled once, whatever ship it is in; again when anything that it depends on changes, and alone.

Each case of an edit runs in a process of its own on a copy of the package, with a cache folder of its own.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

import shipgrid
from shipgrid.assembly import code_store, object_code
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core, source_of
from shipgrid.assembly.fingerprint import reached
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.errors import ShipgridError
from shipgrid.io.ship_file import bundled, load_ship
from shipgrid.model import component, kernel, signal
from shipgrid.model.component import load_all, type_of
from shipgrid.model.network import Network
from shipgrid.scenarios.case import build
from shipgrid.scenarios.snapshot import differences
from shipgrid.units import Ratio

SCRIPT = """
import json, sys
from shipgrid.assembly import code_store
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.workspace import new_workspace
from shipgrid.assembly.tables import arguments
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.components.marine.propeller import Propeller
from shipgrid.controllers.drive_current import DriveCurrent
from shipgrid.controllers.motor_speed import MotorSpeed
from shipgrid.model.connections import Across
from shipgrid.model.network import Network
from shipgrid.scenarios.snapshot import identity

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
net.add("screw", Propeller(), inputs={"v_a": 2.0, "omega_m": 30.0})
plan = assemble(net, case["step"])
work = new_workspace(plan)
for node in ("a.v_dc", "b.v_dc"):
    work.sig[plan.layout.index[node]] = 750.0
assert code_store.core()(4, 0, *arguments(plan, work)) == 4
names = "speed_0.tau_ref", "current_0.s_alpha", "current_0.s_beta", "screw.thrust"
signals = {name: work.sig[plan.layout.index[name]] for name in names}
print(json.dumps(signals | {"code": code_store.code_names(plan.kinds), "identity": identity(plan)}))
"""

SPEED, CURRENT = "motor_speed_MotorSpeed", "drive_current_DriveCurrent"
EDITS = {
    "a component": (
        "controllers/motor_speed.py",
        "pi(u.n_ref - u.omega_pu, 0.0,",
        "pi(u.n_ref - u.omega_pu, 0.125,",
        {SPEED},
        "speed_0.tau_ref",
        lambda old: old + 0.125,
    ),
    "a block it nests": (
        "controllers/blocks/pi.py",
        "wanted = k_p * e + x.i + ff",
        "wanted = 2.0 * k_p * e + x.i + ff",
        {SPEED},
        "speed_0.tau_ref",
        lambda old: 2.0 * old,
    ),
    "ops": (
        "model/ops.py",
        "return minimum(maximum(a, low), high)",
        "return minimum(maximum(a, low), high) + 0.25",
        {SPEED, "propeller_Propeller"},
        "speed_0.tau_ref",
        lambda old: old + 0.25,
    ),
    "a constant": (
        "controllers/drive_current.py",
        "V_DC_LEAST = 1.0",
        "V_DC_LEAST = 2.0",
        {CURRENT},
        "current_0.s_alpha",
        lambda old: old,
    ),
    "frames": (
        "model/frames.py",
        "return cos * d - sin * q, sin * d + cos * q",
        "return 3.0 * (cos * d - sin * q), sin * d + cos * q",
        {CURRENT},
        "current_0.s_alpha",
        lambda old: 3.0 * old,
    ),
}


class Copy:
    """A copy of the package that may be edited."""

    def __init__(self, folder: Path):
        self.folder, self.cache = folder, folder / "cache"
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(Path(shipgrid.__file__).parent, folder / "shipgrid", ignore=ignored)

    def run(self, compiler: bool = True, **case) -> dict:
        """Signals of the small plant, run in a new process, and the names of its code."""
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
            timeout=200,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def objects(self) -> dict[str, int]:
        """Every object that is kept, with the time it was written."""
        return {path.stem: path.stat().st_mtime_ns for path in self.cache.glob("objects/*.o")}


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    made = Copy(tmp_path_factory.mktemp("copy"))
    made.first = {compiler: made.run(compiler) for compiler in (False, True)}
    return made


def test_the_first_run_compiles_the_core_and_each_type(copy):
    first = copy.first[True]
    assert set(first["code"]) <= copy.objects().keys()
    assert first["speed_0.tau_ref"] == pytest.approx(0.5)


@pytest.mark.parametrize(("what", "compiler"), [("ops", False), *((what, True) for what in EDITS)])
def test_an_edit_is_seen_by_those_who_use_it_alone_and_its_reversal_too(copy, what, compiler):
    name, old, new, users, signal_, expected = EDITS[what]
    path, first = copy.folder / "shipgrid" / name, copy.first[compiler]
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    before = copy.objects()
    try:
        edited = copy.run(compiler)
    finally:
        path.write_text(text)
    assert edited[signal_] == pytest.approx(expected(first[signal_]), rel=1e-9)
    anew = set(edited["code"]) - set(first["code"])
    assert {name.rpartition("_")[0] for name in anew} == users
    assert copy.objects().keys() - before.keys() == (anew if compiler else set())
    refused = differences(first["identity"], edited["identity"])  # to resume a run
    assert refused == [f"{name}: its code has been changed" for name in sorted(users)]
    now = copy.objects()
    assert copy.run(compiler) == first
    assert copy.objects() == now


def test_a_comment_or_a_docstring_changes_nothing(copy):
    path = copy.folder / "shipgrid" / "controllers" / "motor_speed.py"
    text, before = path.read_text(), copy.objects()
    path.write_text(text.replace("@kernel\n", "# what a comment says\n\n\n@kernel\n"))
    try:
        assert copy.run() == copy.first[True]
    finally:
        path.write_text(text)
    assert copy.objects() == before


def test_a_data_table_compiles_nothing_and_is_another_run_all_the_same(copy):
    path, first = copy.folder / "shipgrid" / "data" / "wageningen_four_quadrant.csv", copy.first[True]
    text, before = path.read_text(), copy.objects()
    assert text.count("-0.77904") == 1
    path.write_text(text.replace("-0.77904", "-0.77804"))
    try:
        edited = copy.run()
    finally:
        path.write_text(text)
    assert edited["code"] == first["code"] and copy.objects() == before
    assert differences(first["identity"], edited["identity"]) == ["tables of the plan differs"]


def test_an_edit_of_what_acts_between_the_steps_is_another_run(copy):
    path, first = copy.folder / "shipgrid" / "automation" / "interlocks.py", copy.first[True]
    text = path.read_text()
    path.write_text(text + "\n# another\n")
    try:
        edited = copy.run()
    finally:
        path.write_text(text)
    line = "shipgrid.automation.interlocks: this source file of the program has been changed"
    assert differences(first["identity"], edited["identity"]) == [line]


def test_values_connections_numbers_of_instances_and_the_step_compile_nothing(copy):
    before = copy.objects()
    case = {"K_p": 5.0, "n_ref": 0.08, "drives": 3, "measures": "b.v_dc", "step": 20e-6}
    changed = copy.run(**case)
    assert changed["code"] == copy.first[True]["code"]
    assert changed["speed_0.tau_ref"] == pytest.approx(5.0 * 0.08)
    assert copy.objects() == before


@pytest.mark.parametrize("damage", [lambda b: b[:-7], lambda b: b"", lambda b: b[:100] + b"x" + b[101:]])
def test_a_damaged_object_is_made_again(copy, damage):
    name = next(name for name in copy.first[True]["code"] if name.startswith(SPEED))
    path = copy.cache / "objects" / f"{name}.o"
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    assert copy.run() == copy.first[True]
    assert len(path.read_bytes()) == len(whole)


def test_a_plant_runs_without_the_compiler_to_the_last_bit(copy):
    """So that a debugger can step through it."""
    plain, compiled = copy.run(compiler=False, drives=2), copy.run(drives=2)
    for name in ("speed_0.tau_ref", "current_0.s_alpha", "current_0.s_beta"):
        assert plain[name] == compiled[name] != 0.0


@pytest.mark.parametrize("fidelity", ["averaged", "switching"])
def test_a_plant_of_a_structure_never_seen_needs_no_compiler(monkeypatch, tmp_path, fidelity):
    """Every type of the package is there after `shipgrid warm`; what is new is which of them a plant has."""

    def refuse(*_):
        raise AssertionError("the compiler was asked")

    code_store.compile_missing(kind for kind in load_all().values() if kind.cls.__module__.startswith("shipgrid."))
    monkeypatch.setattr(object_code, "compile_object", refuse)
    monkeypatch.setattr(code_store, "compile_in_parallel", refuse)
    source = YAML(typ="safe").load(bundled("ship")["ferry"])
    del source["parts"]
    for name in [name for name in source["equipment"] if name.startswith(("genset", "rectifier"))]:
        del source["equipment"][name]
    path = tmp_path / "electric.yaml"
    with path.open("w") as file:
        YAML().dump(source, file)
    plan = build(load_ship(path), 30e-6, fidelity)
    assert core()(3, 0, *arguments(plan, new_workspace(plan))) == 3


def test_constants_enter_with_their_value():
    def of(value):
        scope = {"LIMIT": value}
        exec("def kernel(x):\n    return x + LIMIT\n", scope)
        scope["kernel"].__module__ = "somewhere"
        return reached(scope["kernel"])

    assert of(1.0) == of(1.0) != of(2.0)
    assert of((1.0, 2.0)) != of((1.0, 3.0))
    assert of(np.arange(3)) != of(np.arange(4))


def test_every_type_of_the_package_has_a_source_of_its_own():
    kinds = [kind for kind in load_all().values() if kind.cls.__module__.startswith("shipgrid.")]
    names = [source.name for source in map(source_of, kinds) if source.text]
    assert len(set(names)) == len(names) > 40


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


@kernel
def forgetful_outputs(u, y):
    if u.given < 0.0:
        raise ValueError("below zero")
    y.value = u.given


@component(input=LinkInput, output=LinkOutput, outputs=forgetful_outputs, stage="outer")
class Raising:
    """Raises, which a kernel may not."""


@pytest.mark.parametrize(("before", "after"), [(FirstLink, SecondLink), (SecondLink, FirstLink)])
def test_components_of_one_stage_run_in_the_order_of_their_connections_whichever_that_is(before, after):
    """The order is contents of an array: two plants with the same types and the opposite order share their code."""
    net = Network("links")
    bus = net.dc_bus("bus", 100.0)
    net.capacitance(bus, 1e-3)
    net.add("before", before(), inputs={"given": 1.5})
    net.add("after", after(), inputs={"given": "before.value"})
    plan = assemble(net, 30e-6)
    work = new_workspace(plan)
    assert core()(1, 0, *arguments(plan, work)) == 1
    assert work.sig[plan.layout.index["after.value"]] == 6.0


def test_a_kernel_that_may_raise_is_refused():
    with pytest.raises(ShipgridError, match=r"Raising.* may raise an exception"):
        code_store.load([type_of(Raising)])
