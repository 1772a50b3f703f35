"""What every registered component and controller promises: found in the registry, with parameters near their defaults.

Parameters are drawn within 20 % of their defaults and inside their bounds; what a component cannot be built with
(`ParameterError` from `derive`) is drawn again. Records are drawn by unit, from a plant of this size.
"""

from __future__ import annotations

import dataclasses
import math
import re
import types
import typing
import zlib
from functools import cache

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from numba.core.errors import TypingError

from scenarios.story import RING
from shipgrid.analysis.settling import run_to_rest
from shipgrid.analysis.steady_state import steady_state
from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.unit_text import NORTON
from shipgrid.automation.power_management import BlackoutPrevention, equip
from shipgrid.components.converters.two_level_bridge import TwoLevelBridge
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.equipment.declaration import EQUIPMENT, is_quantity
from shipgrid.errors import InputErrors, ParameterError
from shipgrid.io.ship_file import load_ship, read_ship
from shipgrid.io.yaml_lines import read_text
from shipgrid.model import kernel as compiled_kernel
from shipgrid.model.component import Empty, fields_of, load_all, parameters_of, type_of, unit_of
from shipgrid.model.connections import Across
from shipgrid.model.network import Network
from shipgrid.model.records import flat_of, make_record, names_of, parameter_record
from shipgrid.modulators.averaged import DirectBridge
from shipgrid.scenarios.case import build

KINDS = {name: kind for name, kind in load_all().items() if kind.cls.__module__.startswith("shipgrid.")}
NAMES = sorted(KINDS)
DIFFERENTIABLE = ("derivatives", "outputs", "stored_energy", "losses", "supplied", "consumed")
"""Kernels that analyses call with complex records; a sampled `update` is never differentiated."""

REQUIRED = {"ohm": 0.05, "H": 1e-3, "F": 1e-4, "W": 10e3, "pu": 1.0, "s": 0.05, "1": 1.0}
"""Values of parameters without a default: a choke, a capacitor, a load, a source and a drive of this plant's size."""

SIZES = {
    "1": (0.0, 1.0), "pu": (-1.2, 1.2), "V": (-800.0, 800.0), "A": (-400.0, 400.0), "W": (-3e5, 3e5),
    "var": (-3e5, 3e5), "Hz": (-2.0, 2.0), "rad": (-3.0, 3.0), "rad/s": (-50.0, 50.0), "rad/s2": (-1.0, 1.0),
    "N": (-2e4, 2e4), "N m": (-5e3, 5e3), "m": (0.0, 1e3), "m/s": (-6.0, 6.0), "s": (0.0, 5.0), "C": (3e4, 3e5),
    "Wb": (-2.0, 2.0),
}  # fmt: skip
"""Range of a signal by its unit; the charge lies inside the smallest battery drawn."""

GH = 30e-6 * (1.0 - 1.0 / math.sqrt(2.0))


def drawn(name: str, count: int = 3) -> list:
    """Instances of a component: its default first, where it has one, then drawn ones."""
    kind, found, refused = KINDS[name], [], 0
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    parameters = parameters_of(kind.cls)
    while len(found) < count:
        values = {}
        for field, unit, bounds, default in parameters:
            value = REQUIRED[unit] if default is None else default
            if found:
                near = value * rng.uniform(0.8, 1.2)
                value = near if bounds.contains(near) else value
            values[field] = value
        try:
            item = kind.cls(**values)
            parameter_record(item)
        except ParameterError:
            refused += 1
            assert refused < 50, f"{name}: of {refused + len(found)} drawn, only {len(found)} could be built"
            continue
        found.append(item)
    return found


class Bench:
    """One component on the bench: records drawn, kernels called with them."""

    def __init__(self, item, seed: int):
        self.item, self.kind = item, type_of(item)
        rng = np.random.default_rng([seed, zlib.crc32(self.kind.name.encode())])
        self.values = {}
        for letter, record in (("x", self.kind.state), ("u", self.kind.input)):
            fields = [] if record is Empty else fields_of(record)
            self.values[letter] = {f.name: self._value(f.unit, rng) for f in fields}
        self.values["x"] = {k: min(v, 0.8 * getattr(item, "capacity", v)) for k, v in self.values["x"].items()}

    @staticmethod
    def _value(unit: str, rng) -> float:
        low, high = SIZES[unit]
        if unit == "1" and rng.random() < 0.7:  # a switch, or the code of a state
            return float(rng.integers(0, 4))
        return float(rng.uniform(low, high))

    def records(self, scalar: str = "f8") -> dict:
        """Arguments of any kernel, by name."""
        kind = self.kind
        p, tables = parameter_record(self.item, scalar)
        position = {"position": 1.0} if kind.name == "DieselEngine" else {}  # a cell of the line, a whole number
        return {
            "t": 0.1, "dt": 1e-3, "gh": GH, "fraction": 0.4, "phase": 0.9, "phase_next": 0.3,
            "p": p, "tables": tables, "delays": np.linspace(0.0, 1.0, 64),
            "x": make_record(kind.state, self.values["x"] | position, scalar),
            "x_next": make_record(kind.state, self.values["x"] | position, scalar),
            "u": make_record(kind.input, self.values["u"], scalar),
            "dx": make_record(kind.state, None, scalar), "y": make_record(kind.output, None, scalar),
            "n": np.zeros(1, NORTON).view(np.recarray)[0],
        }  # fmt: skip

    def call(self, name: str, given: dict, *, compiled: bool = False) -> np.ndarray:
        """Everything the kernel gives: its result and the records it may write, flat."""
        kernel = self.kind.kernels[name]
        function = kernel if compiled else plain(kernel)
        with np.errstate(all="ignore"):
            result = function(*[given[k] for k in arguments_of(kernel)])
        written = [given[k] for k in ("dx", "y", "x_next", "x", "n") if k in arguments_of(kernel)]
        flat = [np.atleast_1d(result)] if result is not None else []
        return np.concatenate([*flat, *(flat_of(r) for r in written if r is not None)] or [np.zeros(0)])

    def jacobian(self, name: str, target: str, letter: str) -> np.ndarray:
        """Derivative of a kernel's record `target` by each field of the record `letter`, by complex step."""
        columns = []
        for k in range(len(self.values[letter])):
            given = self.records("c16")
            flat_of(given[letter])[k] += 1e-40j
            self.call(name, given)
            columns.append(flat_of(given[target]).imag / 1e-40)
        return np.array(columns).T


def arguments_of(kernel) -> tuple[str, ...]:
    code = kernel.py_func.__code__
    return code.co_varnames[: code.co_argcount]


@cache
def plain(kernel):
    """The kernel as ordinary Python, and the kernels it calls likewise."""
    function = kernel.py_func
    own = function.__globals__
    called = {n: plain(own[n]) for n in function.__code__.co_names if isinstance(own.get(n), Dispatcher)}
    return types.FunctionType(function.__code__, {**own, **called}, function.__name__, function.__defaults__)


def benches(name: str, records: int = 4) -> list[Bench]:
    return [Bench(item, seed) for item in drawn(name) for seed in range(records)]


def close(a, b, tolerance: float) -> bool:
    """Equal to `tolerance` of the largest value, where a number is one at all."""
    a, b = np.asarray(a), np.asarray(b)
    size = np.max(np.abs(b[np.isfinite(b)]), initial=1e-30)
    return bool(np.allclose(a, b, rtol=tolerance, atol=tolerance * size, equal_nan=True))


@pytest.mark.parametrize("name", NAMES)
def test_every_field_has_a_unit_and_a_sentence_and_every_number_a_bound_or_a_source(name):
    kind = KINDS[name]
    for record in (kind.state, kind.input, kind.output, kind.derived):
        for field in [] if record is Empty else fields_of(record):
            assert field.unit and len(field.signal.description) > 2, f"{name}.{field.name}"
    hints = typing.get_type_hints(kind.cls, include_extras=True)
    for field, _, bounds, default in parameters_of(kind.cls):
        assert unit_of(hints[field]), f"{name}.{field} has no unit"
        assert len(bounds.description) > 2, f"{name}.{field}"
        assert bounds.source or default is None or str(bounds) != "any finite number", (
            f"{name}.{field}: neither a bound nor a source"
        )
    assert kind.cls.__doc__ and not kind.cls.__doc__.startswith(f"{kind.cls.__name__}("), "what is it?"


@pytest.mark.parametrize("name", NAMES)
def test_kernels_give_the_same_compiled_and_uncompiled(name):
    kind = KINDS[name]
    for label in kind.kernels:
        for bench in benches(name):
            compiled = bench.call(label, bench.records(), compiled=True)
            assert close(compiled, bench.call(label, bench.records()), 1e-12), f"{name}.{label}: {bench.values}"


@pytest.mark.parametrize("name", [n for n in NAMES if set(KINDS[n].kernels) & set(DIFFERENTIABLE)])
def test_kernels_compile_for_complex_numbers_and_their_real_part_is_the_real_kernel(name):
    for label in [k for k in KINDS[name].kernels if k in DIFFERENTIABLE]:
        for bench in benches(name, records=2):
            pair = []
            for compiled in (True, False):
                given = bench.records("c16")
                for letter in "xu":
                    if given[letter] is not None:
                        flat_of(given[letter])[:] += 1e-6j  # larger than any rounding, far too small to matter squared
                pair.append(bench.call(label, given, compiled=compiled))
            assert close(pair[0].real, pair[1].real, 1e-12), f"{name}.{label}"
            assert close(pair[0].imag, pair[1].imag, 1e-12), f"{name}.{label}"
            real = bench.call(label, bench.records())
            assert close(pair[0].real, real, 1e-9), f"{name}.{label}"  # (1e-6)^2 of curvature, and rounding


@pytest.mark.parametrize("name", NAMES)
def test_one_call_allocates_nothing(name):
    """No path of the machine code calls the run-time's allocator: better than counting on one path."""
    bench = benches(name, records=1)[0]
    for label, compiled in KINDS[name].kernels.items():
        bench.call(label, bench.records(), compiled=True)
        for signature in compiled.signatures:
            code = compiled.inspect_llvm(signature)
            assert "call" in code
            assert "NRT_MemInfo_alloc" not in code and "NRT_Allocate" not in code, f"{name}.{label}"


@pytest.mark.parametrize("name", NAMES)
def test_a_value_that_is_no_number_reaches_no_index(name):
    """Compiled, it would read anywhere; uncompiled, it raises here. Counters and codes are whole by construction."""
    for letter, fields in benches(name, records=1)[0].values.items():
        for field in set(fields) - {"state", "refused"}:
            bench = benches(name, records=1)[0]
            bench.values[letter][field] = math.nan
            for kernel in bench.kind.kernels:
                bench.call(kernel, bench.records())


CONTINUOUS = [n for n in NAMES if set(KINDS[n].kernels) & {"derivatives", "outputs"}]


@pytest.mark.parametrize("name", CONTINUOUS)
def test_derivatives_by_complex_step_are_those_of_central_differences(name):
    """Central differences over 1e-5 of a signal's range and over half of it tell their own error."""
    for bench in benches(name, records=2):
        for label, target in (("derivatives", "dx"), ("outputs", "y")):
            for letter, record in (("x", bench.kind.state), ("u", bench.kind.input)):
                if label not in bench.kind.kernels or not bench.values[letter]:
                    continue
                exact = bench.jacobian(label, target, letter)
                for k, field in enumerate(fields_of(record)):
                    low, high = SIZES[field.unit]
                    step = 1e-5 * (high - low)
                    coarse, _ = central(bench, label, target, letter, k, step)
                    fine, size = central(bench, label, target, letter, k, 0.5 * step)
                    error = np.abs(coarse - fine) + 1e-14 * size / step  # of the next order; rounding of the function
                    assert np.all(np.abs(fine - exact[:, k]) <= error + 1e-9 * np.abs(exact[:, k])), (
                        f"{name}.{label} by {letter}.{field.name}: {fine} and {exact[:, k]} at {bench.values}"
                    )


def central(bench: Bench, kernel: str, target: str, letter: str, k: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Central difference of the record `target` by field `k` of the record `letter`, and the size of what it is of."""
    ends = []
    for change in (step, -step):
        given = bench.records()
        flat_of(given[letter])[k] += change
        bench.call(kernel, given)
        ends.append(flat_of(given[target]).copy())
    return (ends[0] - ends[1]) / (2.0 * step), np.max(np.abs(ends), axis=0)


SPEED_ALONE = {"InductionMotor": "omega"}
"""Stamped kinds with a predicted speed and no angle."""

STAMPED = [n for n in NAMES if KINDS[n].stamped]


@pytest.mark.parametrize("name", STAMPED)
def test_a_stamp_is_the_derivative_of_one_implicit_euler_step(name):
    """Angle and speed at the step's end are predicted; everything else obeys x1 = x0 + gh f(x1), and i = G v + h."""
    for bench in benches(name, records=3):
        kind, names = bench.kind, names_of(bench.kind.state)
        volts = [terminal.v for terminal in kind.terminals]
        ports = [names_of(kind.output).index(terminal.i) for terminal in kind.terminals]
        columns = [names_of(kind.input).index(v) for v in volts]
        before = bench.records()
        bench.call("stamp", before)
        norton = np.array([before["n"][k] for k in ("g_aa", "g_ab", "g_ba", "g_bb", "h_a", "h_b")])
        G, h = norton[:4].reshape(2, 2), norton[4:]
        after = bench.records() | {"n": before["n"]}
        bench.call("advance", after)
        end = flat_of(after["x_next"]).copy()

        # The angle advances with the predicted speed, which follows from it by the angle's own equation.
        start, at = flat_of(before["x"]).copy(), end.copy()
        angles = [k for k, f in enumerate(fields_of(kind.state)) if f.signal.rotates]
        drives = []
        for angle in angles:
            drives = np.flatnonzero(bench.jacobian("derivatives", "dx", "x")[angle])
            bench.call("derivatives", before)
            rate = flat_of(before["dx"])[angle]
            for k in drives:
                slope = bench.jacobian("derivatives", "dx", "x")[angle, k]
                at[k] = start[k] + ((end[angle] - start[angle]) / GH - rate) / slope
                assert at[k] == pytest.approx(end[k], abs=0.02)  # second order in 9 us; a wrong sign would be seen
        if name in SPEED_ALONE:  # no angle to read the predicted speed off: the fluxes, linear in it, have it
            k = names.index(SPEED_ALONE[name])
            bench.values["x"] = dict(zip(names, at, strict=True))
            there, by_speed = bench.records(), bench.jacobian("derivatives", "dx", "x")[:, k]
            bench.call("derivatives", there)
            missing, others = end - start - GH * flat_of(there["dx"]), np.arange(len(names)) != k
            at[k] += by_speed[others] @ missing[others] / (GH * by_speed[others] @ by_speed[others])
            assert at[k] == pytest.approx(end[k], abs=0.02)
            drives = [k]
        bench.values["x"] = dict(zip(names, at, strict=True))
        there = bench.records()
        bench.call("derivatives", there)
        bench.call("outputs", there)
        residual = end - start - GH * flat_of(there["dx"])
        assert close(end - residual, end, 1e-10), f"{name}: {dict(zip(names, residual, strict=True))}"
        v = np.array([bench.values["u"][k] for k in volts])
        assert close(flat_of(there["y"])[ports], G @ v + h, 1e-9), name

        electrical = [k for k in range(len(names)) if k not in angles and k not in drives]
        A = bench.jacobian("derivatives", "dx", "x")[np.ix_(electrical, electrical)]
        B = bench.jacobian("derivatives", "dx", "u")[np.ix_(electrical, columns)]
        C = bench.jacobian("outputs", "y", "x")[np.ix_(ports, electrical)]
        D = bench.jacobian("outputs", "y", "u")[np.ix_(ports, columns)]
        assert close(G, D + C @ np.linalg.solve(np.eye(len(A)) - GH * A, GH * B), 1e-9), name


POWER_BESIDE_TERMINALS = {
    "BuckBoost": lambda x, u, p, y: u.e * (u.e - x.v_c) / p.R_b,
    "Pmsm": lambda x, u, p, y: -y.tau_e * u.omega_m,
    "Shaft": lambda x, u, p, y: (u.tau_e - u.tau) * x.omega_m,
    "Propeller": lambda x, u, p, y: y.tau * u.omega_m - y.thrust * u.u_thrust,
    "Hull": lambda x, u, p, y: u.thrust * y.u_thrust,
    "Battery": lambda x, u, p, y: -y.e * u.i,
}
"""Power [W] into a component through what is not a terminal: a shaft, a screw's water, a battery's source."""

BOOKED = [
    n
    for n in NAMES
    if set(KINDS[n].kernels) & {"stored_energy", "losses", "supplied", "consumed"}
    and set(KINDS[n].kernels) & {"derivatives", "outputs", "update"}  # a bridge is what the network makes of it
]


@pytest.mark.parametrize("name", BOOKED)
def test_terminal_power_is_the_change_of_stored_energy_and_losses(name):
    for bench in benches(name, records=4):
        given, taken, size, losses = balance(bench)
        assert given == pytest.approx(taken, abs=1e-9 * size), f"{name}: {bench.values}"
        if bench.kind.passive:
            assert losses >= 0.0, name


def test_a_loss_that_is_not_booked_is_seen():
    (bench, *_) = benches("RlBranch")
    kernels = {k: v for k, v in bench.kind.kernels.items() if k != "losses"}
    bench.kind = dataclasses.replace(bench.kind, kernels=kernels)
    given, taken, size, _ = balance(bench)
    assert abs(given - taken) > 1e-3 * size


def balance(bench: Bench) -> tuple[float, float, float, float]:
    """Power into a component; what became of it by its books; the largest entry; its losses [W]."""
    kind, given = bench.kind, bench.records()
    bench.call("outputs", given)
    x, u, p, y = (given[k] for k in "xupy")
    # Two terminals of one device stand for three phases (totals); an element written per axis is booked per axis.
    weight = 1.5 if kind.stamped and kind.two_axis_ends else 1.0
    power = [weight * u[terminal.v] * y[terminal.i] for terminal in kind.terminals]
    if kind.name in POWER_BESIDE_TERMINALS:
        power.append(POWER_BESIDE_TERMINALS[kind.name](x, u, p, y))
    books = [k for k in ("losses", "supplied", "consumed") if k in kind.kernels]
    book = {k: bench.call(k, bench.records() | {"y": y})[0] for k in books}
    stored = 0.0
    if "stored_energy" in kind.kernels:
        bench.call("derivatives", given)
        moved = bench.records("c16")
        flat_of(moved["x"])[:] += 1e-40j * flat_of(given["dx"])
        stored = bench.call("stored_energy", moved)[0].imag / 1e-40
    losses = book.get("losses", 0.0)
    taken = stored + losses + book.get("consumed", 0.0) - book.get("supplied", 0.0)
    return sum(power), taken, float(np.max(np.abs([*power, stored, *book.values(), 1.0]))), losses


@pytest.mark.parametrize("name", NAMES)
def test_parameters_survive_replacement_and_being_written_out(name):
    for item in drawn(name):
        values = {f.name: getattr(item, f.name) for f in dataclasses.fields(item)}
        assert dataclasses.replace(item, **values) == item
        assert eval(repr(item), {type(item).__name__: type(item)}) == item


def test_parameters_that_a_ship_file_sets_arrive_as_they_were_written():
    rng = np.random.default_rng(2)
    ship = load_ship("ferry")
    owners = dict(ship.equipment) | {"hull": ship.hull}
    wanted = {}

    def draw(item, path, read):
        hints = typing.get_type_hints(type(item), include_extras=True)
        bounds = {n: b for n, _, b, _ in parameters_of(type(item))}
        for field in dataclasses.fields(item):
            value = getattr(item, field.name)
            if "block" in field.metadata:
                draw(value, f"{path}.{field.name}", (*read, field.name))
            elif is_quantity(hints[field.name]):
                near = value * float(rng.uniform(0.97, 1.03))
                if bounds[field.name].contains(near):
                    unit = unit_of(hints[field.name])
                    text = repr(near) if unit == "1" else f"{near!r} {unit}"
                    wanted[f"{path}.{field.name}"] = (text, near, (*read, field.name))

    for name, item in owners.items():
        draw(item, name if name == "hull" else f"equipment.{name}", (name,))
    changed, refused = None, 0
    while changed is None:
        try:
            changed = load_ship("ferry", [(path, text) for path, (text, _, _) in wanted.items()])
        except (
            InputErrors
        ) as wrong:  # a few numbers of an item's block follow from its own or need another: the first is named
            follows = re.findall(r"equipment\.(\w+): \w+\.(\S+) = \S+ is (?:set by|read only)", str(wrong))
            assert follows, str(wrong)
            refused += len(follows)
            for item, field in follows:
                del wanted[f"equipment.{item}.{field}"]
    assert refused < 0.2 * len(wanted)
    assert len(wanted) > 8 * len(EQUIPMENT)
    for path, (_, value, read) in wanted.items():
        found = changed.hull if read[0] == "hull" else changed.equipment[read[0]]
        for field in read[1:]:
            found = getattr(found, field)
        assert found == pytest.approx(value, rel=1e-15), path


def test_the_ferry_started_at_rest_stays_there():
    ship = load_ship("ferry")
    plan = build(ship, 30e-6)
    moored = {path: c.default if c.moored is None else c.moored for path, c in ship.commands.items()}
    work, _ = run_to_rest(plan, moored)
    slow = [n for n in plan.network.published if n.endswith((".v_dc", ".soc", ".f", ".u_ship"))]
    places = [plan.layout.index[plan.network.published[n].source] for n in slow]
    before = work.sig[places].copy()
    steps = round(3.0 / plan.h)
    assert core()(steps, 0, *arguments(plan, work)) == steps
    # the batteries feed 20 kW of hotel load, which is 3e-4 of their charge in this time
    moved = dict(zip(slow, work.sig[places] - before, strict=True))
    assert work.sig[places] == pytest.approx(before, rel=5e-4, abs=1e-4), moved


PLANT = ("capacity", "L", "R", "C", "C_dc", "R_1", "R_2", "R_t", "inertia", "inertia_H", "p", "length", "power_factor")
"""What a plant is built of, as keys of its items; gains and ratings are not drawn: those belong to one another."""


@pytest.mark.parametrize("seed", [3, 4])
def test_a_ferry_built_within_20_percent_of_the_bundled_one_comes_to_rest_and_stays_there(seed):
    rng, changes = np.random.default_rng(seed), []
    for name, item in load_ship("ferry").equipment.items():
        hints = typing.get_type_hints(type(item), include_extras=True)
        for field in dataclasses.fields(item):
            if field.name in PLANT:
                low, high = (0.8, 0.95) if field.name == "power_factor" else (0.8, 1.2)
                value, unit = getattr(item, field.name), unit_of(hints[field.name])
                value = float(rng.uniform(low, high)) * (1.0 if field.name == "power_factor" else value)
                changes.append((f"equipment.{name}.{field.name}", f"{value!r} {unit}" if unit != "1" else repr(value)))
    assert len(changes) > 20
    ship = load_ship("ferry", changes)
    plan = build(ship, 60e-6)
    moored = {path: c.default if c.moored is None else c.moored for path, c in ship.commands.items()}
    work, drift = run_to_rest(plan, moored)
    assert drift < 2e-4
    places = [plan.layout.index[plan.network.published[n].source] for n in ("dc_for.v_dc", "ac_for.f", "ac_aft.f")]
    before = work.sig[places].copy()
    steps = round(2.0 / plan.h)
    assert core()(steps, 0, *arguments(plan, work)) == steps
    assert work.sig[places] == pytest.approx(before, rel=5e-4)


def circuit(seed: int) -> Network:
    """One plant with every kind that no ship has, each drawn: sources, a tapped DC bus, a transformer, an inverter."""

    def of(name):
        return drawn(name, 4)[1 + seed]

    net = Network("circuit")
    dc, near, far, low = (net.dc_bus(name, 750.0) for name in ("dc", "near", "far", "low"))
    ac, tied, load = (net.ac_bus(name, 400.0, 60.0) for name in ("ac", "tied", "load"))
    net.capacitance(dc, 5e-3)  # the bridge's current stands for a step, while its modulation turns
    net.add("battery", of("DcSource"), a=dc)
    net.add("feeder", of("InductiveDcSource"), a=far)
    net.add("drawn", dataclasses.replace(of("CurrentSource"), i_0=-20.0), a=near)
    net.add("breaker", of("Breaker"), a=dc, b=near)
    net.add("choke", of("Choke"), ports={"a": near, "b": low})
    net.add("resistor", dataclasses.replace(of("Resistor"), R=30.0), a=low)
    net.add("capacitor", of("Capacitor"), a=near, b=low)
    net.add("filter", of("RlcBranch"), a=far)
    net.add("bank", of("Supercapacitor"), a=far)
    net.add("coupled", of("CoupledInductors"), ports={"first": Across(dc, far), "second": Across(near, low)})
    net.add("grid", of("ThreePhaseSource"), a=ac)
    net.add("switch", of("ThreePoleBreaker"), a=ac, b=tied)
    net.add("transformer", of("Transformer"), primary=tied, secondary=load)
    inner = net.ac_bus("inner", 400.0, 60.0)
    net.add("core", dataclasses.replace(of("SaturableCore"), psi_knee=1.5), a=inner)  # beyond it nothing turns evenly
    net.add("winding", of("SecondaryWinding"), core=inner, line=load)
    net.add("consumer", of("Load"), a=load)
    net.add("controlled", of("VoltageDependentLoad"), a=load)
    net.add("pump", of("InductionMotor"), a=load, initial={"omega": 0.97})
    net.add("converter", of("DcLoad"), a=near)
    net.add("sine", of("SineModulation"), inputs={"m": 0.8})
    modulation = {s: f"sine.{s}" for s in ("s_alpha", "s_beta")} | {"gates": 1.0}
    net.add("modulator", DirectBridge(), inputs=modulation)
    bridge = net.bridge("bridge", TwoLevelBridge(), dc, modulator="modulator")
    net.add_three_phase("wound", RlBranch(R=2.0, L=5e-3), ports={"branch": bridge})
    return net


@pytest.mark.full  # half a minute to compile
@pytest.mark.parametrize("seed", [0, 1])
def test_every_kind_that_no_ship_has_comes_to_rest_and_stays_there(seed):
    plan = assemble(circuit(seed), 30e-6)
    point = steady_state(plan)
    work = point.workspace()
    entry, values, steps = core(), arguments(plan, work), round(0.05 / plan.h)
    before = work.sig.copy()
    assert entry(steps, 0, *values) == steps
    for bus in plan.network.buses.values():
        places = [plan.layout.index[node] for node in bus.nodes]
        assert np.linalg.norm(work.sig[places]) == pytest.approx(np.linalg.norm(before[places]), rel=1e-4), bus.name
    for path in ("choke.i", "breaker.i", "filter.v_c", "coupled.i_1", "coupled.i_2"):
        if path in plan.layout.index:
            place = plan.layout.index[path]
            assert work.sig[place] == pytest.approx(before[place], rel=1e-4, abs=1e-3), path


def guarded_ring() -> Network:
    """Three DC buses in a ring, with the rule of power management that has components of its own."""
    net = Network("ring")
    ring = read_ship(read_text(RING, "ring.yaml")).checked()
    ring.build(net)
    equip(net, ring, [BlackoutPrevention()])
    return net


def test_every_registered_kind_is_in_a_plant_that_comes_to_rest():
    ships = [Network("ferry", fidelity) for fidelity in ("averaged", "switching")]
    for net in ships:
        load_ship("ferry").build(net)
    plants = [*ships, circuit(0), guarded_ring()]  # the last is at rest in tests/scenarios/test_rules.py
    assert {type_of(placed.item).name for net in plants for placed in net.placed.values()} == set(NAMES)


def test_a_kernel_that_would_allocate_does_not_compile():
    @compiled_kernel
    def greedy(n):
        return np.zeros(n).sum()

    with pytest.raises(TypingError):
        greedy(3)
