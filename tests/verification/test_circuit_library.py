"""The circuit level: elements and examples against closed forms and SciPy, bad connections, runs that go on."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import shipgrid as sg
from shipgrid.cli.explain_tables import tie_rows
from shipgrid.components.mechanical.diesel_engine import DieselEngine
from shipgrid.errors import InputErrors, ParameterError, SolverError, TopologyError
from shipgrid.model.component import REGISTRY, type_of
from shipgrid.model.kernel import call_uncompiled
from shipgrid.model.records import flat_of, make_record, names_of, parameter_record
from shipgrid.solvers.reference import reference_run
from shipgrid.units import Ampere, Ratio, Volt

EXAMPLES = Path(__file__).parents[2] / "examples"
TIGHT = {"rtol": 1e-9, "atol": 1e-9}


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def drawn(module, run, folder):
    module.draw(run, folder / "figure.png")
    return (folder / "figure.png").stat().st_size


def orders(errors):
    return np.log2([coarse / fine for coarse, fine in pairwise(errors)])


# --- examples ---------------------------------------------------------------------------------------------------------


def test_the_rlc_step_is_its_closed_form_with_order_two(tmp_path):
    rlc = example("plot_rlc_step")
    errors, books = [], []
    for step in (25e-6, 12.5e-6, 6.25e-6):
        run = rlc.simulate(step)
        voltage, current = rlc.closed_form(run["choke.i"]["time"].values - rlc.CLOSED)
        errors.append(float(np.abs(run["far.v_dc"] - voltage).max()))
        assert float(np.abs(run["choke.i"] - current).max()) < errors[-1] / math.sqrt(rlc.L / rlc.C) * 1.1
        books.append(abs(run.energy_balance_error))
    assert orders(errors) == pytest.approx(2.0, abs=0.1)  # the next term is of third order
    assert errors[0] < 5e-3 * rlc.E
    assert orders(books) == pytest.approx(2.0, abs=0.2)
    assert books[0] < 1e-3
    assert [(e.time, e.source, e.text) for e in run.events] == [(pytest.approx(1e-3), "choke.close", "closed")]
    assert run["far.v_dc"].attrs["units"] == "V" and run["choke.i"].attrs["units"] == "A"
    assert drawn(rlc, run, tmp_path) > 20_000


def test_the_buck_boost_is_its_averaged_equations(tmp_path):
    circuit = example("plot_buck_boost")

    def part(t_0, t_1, start, s, g, at):
        def rates(t, x):
            i, v = x
            return [(circuit.E - circuit.R * i - s * v) / circuit.L, (s * i - g * v) / circuit.C]

        return solve_ivp(rates, (t_0, t_1), start, t_eval=at, **TIGHT).y

    errors = []
    for step in (50e-6, 25e-6):
        run = circuit.simulate(step)
        t = run["bus.v_dc"]["time"].values
        got = np.array([-run["battery.i"], run["bus.v_dc"]])
        start = got[:, 0]
        expected = []
        for t_0, t_1, s, ohms in (
            (0.0, circuit.DUTY_STEP, circuit.S_BEFORE, [circuit.LOAD]),
            (circuit.DUTY_STEP, circuit.LOAD_STEP, circuit.S_AFTER, [circuit.LOAD]),
            (circuit.LOAD_STEP, circuit.END, circuit.S_AFTER, [circuit.LOAD, circuit.MORE_LOAD]),
        ):
            at = np.append(t[(t >= t_0 - 1e-9) & (t < t_1 - 1e-9)], t_1)
            found = part(t_0, t_1, start, s, sum(1.0 / r for r in ohms), at)
            start = found[:, -1]
            expected.append(found[:, :-1])
        expected = np.concatenate([*expected, start[:, None]], axis=1)
        errors.append(np.abs(got - expected).max(axis=1))
    assert orders(errors) == pytest.approx(2.0, abs=0.2)
    assert errors[1][0] < 1e-3 * 120.0 and errors[1][1] < 1e-4 * 750.0
    assert np.ptp(got[1][t < circuit.DUTY_STEP]) < 1e-6  # the start given is the rest at that duty ratio
    assert abs(run.energy_balance_error) < 2e-4  # half a step of the power that each of two events changes
    assert drawn(circuit, run, tmp_path) > 15_000


def test_the_lcl_inverter_is_its_averaged_equations_with_order_two(tmp_path):
    circuit = example("plot_lcl_inverter")
    f, omega = circuit.FILTER, 2.0 * math.pi * circuit.F

    def rates(t, x, load):
        i_1, v_c, i_2 = (x[k] + 1j * x[k + 1] for k in (0, 2, 4))
        s = 0.5 * circuit.M * np.exp(1j * omega * t)
        node = v_c + f.R_d * (i_1 - i_2)
        d_1 = (s * x[6] - f.R_1 * i_1 - node) / f.L_1
        d_2 = (node - (f.R_2 + load) * i_2) / f.L_2
        d_c = (i_1 - i_2) / f.C
        d_dc = ((circuit.V_DC - x[6]) / 0.05 - 1.5 * (s.conjugate() * i_1).real) / 2e-3
        return [d_1.real, d_1.imag, d_c.real, d_c.imag, d_2.real, d_2.imag, d_dc]

    errors = []
    for step in (40e-6, 20e-6, 10e-6):
        run = circuit.simulate(step)
        t = run["dc.v_dc"]["time"].values
        names = ["filter.alpha.i_1", "filter.beta.i_1", "filter.alpha.v_c", "filter.beta.v_c"]
        names += ["filter.alpha.i_2", "filter.beta.i_2", "dc.v_dc"]
        got = np.array([run[name] for name in names])
        start, expected = np.array([0.0] * 6 + [circuit.V_DC]), []
        both = 1.0 / (1.0 / circuit.LOAD + 1.0 / circuit.MORE_LOAD)
        for t_0, t_1, load in ((0.0, circuit.LOAD_STEP, circuit.LOAD), (circuit.LOAD_STEP, circuit.END, both)):
            at = np.append(t[(t >= t_0 - 1e-9) & (t < t_1 - 1e-9)], t_1)
            found = solve_ivp(rates, (t_0, t_1), start, t_eval=at, args=(load,), **TIGHT).y
            start = found[:, -1]
            expected.append(found[:, :-1])
        expected = np.concatenate([*expected, start[:, None]], axis=1)
        errors.append(np.abs(got - expected).max(axis=1) / np.abs(expected).max(axis=1))
    assert orders(errors) == pytest.approx(2.0, abs=0.25)
    assert errors[1].max() < 5e-3  # at the start, where the filter rings at 600 Hz
    assert abs(run.energy_balance_error) < 1e-3
    assert drawn(circuit, run, tmp_path) > 30_000


def test_the_page_on_circuits_runs():
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "circuits.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 3
    scope = {}
    for block in blocks:
        exec(block, scope)
    assert [e.text for e in scope["run"].events] == ["closed, asked for at 0.05 s", "set to 0.8"]
    assert scope["more"]["dc.v_dc"]["time"].values[[0, -1]] == pytest.approx([0.25, 0.3], abs=30e-6)
    table = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    assert all(hasattr(sg, name) for row in table for name in re.findall(r"`(\w+)`", row))


@pytest.fixture(scope="module")
def energising():
    return example("plot_transformer_energising")


def test_an_energised_transformer_is_an_r_l_circuit_a_phase_with_its_flux_offset(energising, tmp_path):
    """No load: the phases are independent, and the secondary shows the magnetising branch turned by 30 degrees."""
    t, grid = energising.TRANSFORMER, energising.GRID
    omega, E = 2.0 * math.pi * grid.f_n, math.sqrt(2.0 / 3.0) * grid.v_n
    R, L = grid.R + sg.Breaker().R_on + t.R_1, grid.L + t.L_1
    run = energising.simulate(10e-6)
    times = run["transformer.i_1_alpha"]["time"].values
    after = times >= energising.CLOSED
    began = times[after][0]
    current, magnetising = run.phases("transformer.i_1"), run.phases("transformer.i_m")

    for k in range(3):
        angle = grid.phase - 2.0 * math.pi * k / 3.0

        def rates(at, x, angle=angle):
            e = t.R_m * (x[0] - x[1])
            return [(E * math.cos(omega * at + angle) - R * x[0] - e) / L, e / t.L_m]

        # stiff: L / R_m is 0.4 us
        found = solve_ivp(
            rates, (began, times[-1]), [0.0, 0.0], t_eval=times[after], method="Radau", rtol=1e-8, atol=1e-8
        )
        size = np.abs(found.y[1]).max()
        assert np.abs(magnetising[k][after] - found.y[1]).max() < 1e-4 * size
        settled = times[after] > began + 1e-4  # the current into R_m rises within a tenth of a step
        assert np.abs(current[k][after] - found.y[0])[settled].max() < 1e-3 * size
    flux = t.L_m * magnetising / (E / omega)
    assert float(np.abs(flux[0]).max()) == pytest.approx(2.0, abs=0.03)  # less what R, R_m and the leakage take
    assert abs(run.energy_balance_error) < 1e-3
    assert drawn(energising, run, tmp_path) > 40_000


def test_iron_makes_an_inrush_of_the_flux_offset_and_ends_it_sooner(energising):
    """More than the rated peak, of one sign a phase; after half a second the linear core still has its offset."""
    iron, linear = energising.simulate(item=energising.IRON), energising.simulate()
    current = iron.phases("transformer.primary.i") / (math.sqrt(2.0 / 3.0) * energising.RATING / energising.V_1)
    assert 1.0 < float(current.max()) < 3.0
    extremes = np.array([current.max("time"), -current.min("time")])
    assert np.all(extremes.max(axis=0) > 2.0 * extremes.min(axis=0))
    end = {"time": slice(0.5 - 2.0 / energising.F, 0.5)}
    offset = {
        "iron": np.hypot(*(float(iron[f"transformer.core.psi_{axis}"].sel(end).mean()) for axis in ("alpha", "beta"))),
        "linear": energising.TRANSFORMER.L_m
        * np.hypot(*(float(linear[f"transformer.i_m_{axis}"].sel(end).mean()) for axis in ("alpha", "beta"))),
    }
    assert offset["iron"] < 0.7 * offset["linear"]


def transformer_circuit(item, *, short=None, grid=None, v_2n=400.0):
    """Grid, breaker, transformer; its secondary open, or shorted through a breaker of `short` ohm."""
    net = sg.Network("transformer")
    feed, primary = net.ac_bus("feed", 400.0, 60.0), net.ac_bus("primary", 400.0, 60.0)
    secondary = net.ac_bus("secondary", v_2n, 60.0)
    net.add("grid", grid or sg.ThreePhaseSource(R=1e-5, L=1e-9), a=feed)
    net.add("breaker", sg.Breaker(R_on=1e-5), a=feed, b=primary)
    net.add("transformer", item, primary=primary, secondary=secondary)
    if short:
        net.add("short", sg.Breaker(R_on=short), a=secondary)
    return sg.assemble(net, step=10e-6)


def phasor(run, stem, f=60.0):
    """Fundamental of phase a over the last period, as a complex peak."""
    series = run.phases(stem)[0]
    n = round(1.0 / f / 10e-6)  # a whole number of steps but for a third of one
    t, x = series["time"].values[-n:], series.values[-n:]
    basis = np.column_stack([np.cos(2 * np.pi * f * t), -np.sin(2 * np.pi * f * t)])
    return complex(*np.linalg.lstsq(basis, x, rcond=None)[0])


def test_the_short_circuit_current_of_a_transformer_is_one_over_its_impedance():
    """5 % resistance, so that the direct component is gone after 0.2 s."""
    item = sg.Transformer.per_unit(50e3, 400.0, 230.0, 60.0, group="Dyn11", X=0.10, R=0.05)
    run = transformer_circuit(item, short=1e-5, v_2n=230.0).run(until=0.2, record=SHORTED)
    V, omega, a = math.sqrt(2.0 / 3.0) * 400.0, 2.0 * math.pi * 60.0, 400.0 / 230.0
    z_2 = a**2 * (item.R_2 + 1e-5 + 1j * omega * item.L_2)
    z_m = 1.0 / (1.0 / item.R_m + 1.0 / (1j * omega * item.L_m))
    z = 1e-5 + 1e-5 + 1j * omega * 1e-9 + item.R_1 + 1j * omega * item.L_1 + z_m * z_2 / (z_m + z_2)
    assert phasor(run, "transformer.i_1") == pytest.approx(V / z, rel=1e-4)
    # |I| = 1/|Z| in per unit, the magnetising branch and the contacts apart
    base = math.sqrt(2.0 / 3.0) * 50e3 / 400.0
    assert abs(phasor(run, "transformer.i_1")) / base == pytest.approx(1.0 / abs(0.05 + 0.10j), rel=1e-3)
    # the secondary's current, a times the primary's, leads it by 30 degrees on its way out
    ratio = -phasor(run, "transformer.i_2") / phasor(run, "transformer.i_1")
    assert abs(ratio) == pytest.approx(a, rel=1e-3)
    assert math.degrees(np.angle(ratio)) == pytest.approx(30.0, abs=0.05)


SHORTED = ["transformer.i_1_alpha", "transformer.i_1_beta", "transformer.i_2_alpha", "transformer.i_2_beta"]


@pytest.mark.parametrize(
    ("group", "degrees"), [("Dyn11", 30.0), ("Dy1", -30.0), ("Yy0", 0.0), ("Yd5", -150.0), ("Yy6", 180.0)]
)
def test_the_secondary_leads_by_what_the_vector_group_says(group, degrees):
    item = sg.Transformer.per_unit(50e3, 400.0, 230.0, 60.0, group=group, R=0.05)
    run = transformer_circuit(item, v_2n=230.0).run(until=0.1)
    ratio = phasor(run, "secondary.v") / phasor(run, "primary.v")
    drop = item.R_1 + 2j * math.pi * 60.0 * item.L_1
    z_m = 1.0 / (1.0 / item.R_m + 1.0 / (2j * math.pi * 60.0 * item.L_m))
    expected = 230.0 / 400.0 * z_m / (z_m + drop) * np.exp(1j * math.radians(degrees))
    assert abs(ratio - expected) < 2e-4 * abs(expected)


@pytest.mark.parametrize("group", ["Yy1", "Dy0", "Dyn12", "Zy11", "yd11"])
def test_what_is_no_vector_group_is_refused(group):
    with pytest.raises(ParameterError, match=f"'{group}' is no vector group"):
        sg.Transformer.per_unit(50e3, 400.0, 230.0, 60.0, group=group)


def test_an_unloaded_source_shows_its_harmonics_and_its_unbalance():
    grid = sg.ThreePhaseSource(
        R=0.01, L=1e-4, phase=0.3, r_2=0.04, phi_2=0.5, r_5=0.06, phi_5=-0.2, r_7=0.03, r_11=0.02, r_13=0.01
    )
    item = sg.Transformer.per_unit(50e3, 400.0, 400.0, 60.0)
    net_run = transformer_circuit(item, grid=grid)
    run = net_run.run({"breaker.close": 0.0}, events=[sg.At(0.1, sg.Set("grid.v_pu", 0.5))], until=0.2)
    v = run["feed.v_alpha"].values + 1j * run["feed.v_beta"].values
    for k, factor in ((slice(1, 10001), 1.0), (slice(10001, 20001), 0.5)):  # six periods each
        t = run["feed.v_alpha"]["time"].values[k]
        E = factor * math.sqrt(2.0 / 3.0) * 400.0
        for order, size, angle in (
            (1, 1.0, 0.0),
            (-1, 0.04, 0.5),
            (-5, 0.06, -0.2),
            (7, 0.03, 0.0),
            (-11, 0.02, 0.0),
            (13, 0.01, 0.0),
        ):
            found = np.mean(v[k] * np.exp(-2j * np.pi * 60.0 * order * t)) / E
            expected = size * np.exp(1j * (order * 0.3 + math.copysign(angle, order * angle)))
            assert found == pytest.approx(expected, abs=1e-6), order
    assert np.abs(run["grid.i_alpha"]).max() < 1e-9


def test_a_three_pole_breaker_clears_one_pole_then_the_other_two():
    """A star of R-L on a stiff grid: the first pole at its zero, the others, in series on a line voltage, at theirs."""
    R, L, E, step, told = 1.0, 5e-3, math.sqrt(2.0 / 3.0) * 400.0, 10e-6, 0.1
    omega = 2.0 * math.pi * 60.0
    net = sg.Network("breaker")
    grid, load = net.ac_bus("grid", 400.0, 60.0), net.ac_bus("load", 400.0, 60.0)
    net.add("source", sg.ThreePhaseSource(R=1e-3, L=1e-7), a=grid)
    net.add("breaker", sg.ThreePoleBreaker(R_on=1e-4), a=grid, b=load, contact="closed")
    net.add("load", sg.RlBranch(R=R, L=L), a=load)
    plan = sg.assemble(net, step=step)
    run = plan.run(events=[sg.At(told, sg.Open("breaker"))], until=0.13)
    t = run["breaker.open_a"]["time"].values
    opened = {k: float(t[np.argmax(run[f"breaker.open_{k}"].values > 0.5)]) for k in "abc"}
    first, *others = sorted(opened, key=opened.get)

    total_R, total_L = R + 1e-3 + 1e-4, L + 1e-7
    z = total_R + 1j * omega * total_L
    zeros = {}
    for n, k in enumerate("abc"):  # steady before: the next zero of phase k
        angle = np.angle(1.0 / z) - 2.0 * math.pi * n / 3.0
        zeros[k] = (
            math.ceil((omega * told + angle - math.pi / 2.0) / math.pi) * math.pi + math.pi / 2.0 - angle
        ) / omega
    assert first == min(zeros, key=zeros.get)
    assert opened[first] == pytest.approx(zeros[first], abs=1.5 * step)

    # from then on one loop: the line voltage on twice the impedance
    begun, (k, m) = zeros[first], others
    currents = run.phases("breaker.i")
    place = {name: 2.0 * math.pi * "abc".index(name) / 3.0 for name in "abc"}
    i_0 = E / abs(z) * math.cos(omega * begun + np.angle(1.0 / z) - place[k])
    v_line = E * (np.exp(-1j * place[k]) - np.exp(-1j * place[m]))
    forced = v_line / (2.0 * z)

    def current(at):
        decay = np.exp(-total_R / total_L * (at - begun))
        return (forced * np.exp(1j * omega * at)).real + (i_0 - (forced * np.exp(1j * omega * begun)).real) * decay

    at = begun + np.arange(1, 2000) * 1e-6 * 5.0
    crossing = at[np.argmax(np.sign(current(at)) != np.sign(current(at[0])))]
    assert opened[k] == opened[m] == pytest.approx(crossing, abs=2.0 * step)
    assert opened[k] - opened[first] == pytest.approx(0.25 / 60.0, rel=0.1)  # a quarter of a period
    between = (t > opened[first] + 2.0 * step) & (t < opened[k])
    got = currents[["abc".index(k), "abc".index(m), "abc".index(first)]].values[:, between]
    assert got[0] == pytest.approx(current(t[between]), abs=2e-3 * E / abs(z))  # the zero was found up to a step late
    assert got[1] == pytest.approx(-got[0], abs=1e-9)
    assert np.abs(got[2]).max() < 1e-9
    assert np.abs(currents.values[:, t > opened[k] + step]).max() < 1e-9
    # hardly anything is chopped: what was stored has been given back
    assert abs(run.energy_balance_error) < 1e-3


def test_a_three_pole_breaker_starts_open_and_closes_at_once():
    net = sg.Network("breaker")
    grid, load = net.ac_bus("grid", 400.0, 60.0), net.ac_bus("load", 400.0, 60.0)
    net.add("source", sg.ThreePhaseSource(R=1e-3, L=1e-7), a=grid)
    net.add("breaker", sg.ThreePoleBreaker(), a=grid, b=load, contact="open")
    net.add("load", sg.RlBranch(R=1.0, L=5e-3), a=load)
    run = sg.assemble(net, step=10e-6).run(events=[sg.At(5e-3, sg.Close("breaker"))], until=10e-3)
    size = np.hypot(run["breaker.i_alpha_in"], run["breaker.i_beta_in"])
    t = run["breaker.i_alpha_in"]["time"]
    assert float(size[t <= 5e-3].max()) == 0.0
    assert float(size.sel(time=5.5e-3, method="nearest")) > 20.0


class TimedInput:
    v: Volt = sg.signal("voltage")


class TimedOutput:
    i: Ampere = sg.signal("current")


@sg.kernel
def timed_outputs(t, u, p, y):
    y.i = u.v * p.g * (1.0 + t)


def test_a_linear_element_that_reads_the_time_is_refused():
    """Its matrices are read off once; before, it stood for ever as it is at time zero."""

    @sg.component(
        input=TimedInput, output=TimedOutput, outputs=timed_outputs, terminals=(sg.Terminal("end", v="v", i="i"),)
    )
    class Timed:
        """A conductance that grows."""

        g: Ratio = sg.param("at the start", default=1.0, above=0.0)

    REGISTRY.pop("Timed")
    net = sg.Network("timed")
    net.add("growing", Timed(), end=net.dc_bus("bus", 10.0))
    with pytest.raises(ParameterError, match="Timed: `outputs` reads the time"):
        sg.assemble(net)


# --- the library, one circuit after another, in one compiled module ---------------------------------------------------


def assembled(net, step):
    """The plan of a circuit, one of every element of the library standing aside: so all circuits share their code."""
    aside, other = net.dc_bus("aside", 1e3), net.dc_bus("aside_other", 1e3)
    for bus in (aside, other):
        net.capacitance(bus, 1e-3)
        net.conductance(bus, 1.0)
    for name, item in LIBRARY.items():
        net.add(f"aside_{name}", item, a=aside, b=other)
    net.add("aside_coupled", sg.CoupledInductors(L_1=1e-3, L_2=1e-3), first=aside, second=other)
    return sg.assemble(net, step=step)


LIBRARY = {
    "breaker": sg.Breaker(), "capacitor": sg.Capacitor(C=1e-3, R=0.1), "choke": sg.Choke(R=0.1, L=1e-3),
    "current": sg.CurrentSource(i_0=0.0), "inductive": sg.InductiveDcSource(v_0=0.0, R=0.1, L=1e-3),
    "resistor": sg.Resistor(R=1.0), "rl": sg.RlBranch(R=0.1, L=1e-3), "rlc": sg.RlcBranch(R=0.1, L=1e-3, C=1e-3),
    "source": sg.DcSource(v_0=0.0, R=1.0),
}  # fmt: skip


def test_a_coupled_winding_with_a_small_load_leaves_the_leakage_at_first():
    """The matrix exponential of both windings; at first the primary shows L_1 (1 - k^2), the leakage."""
    L_1, L_2, k, R, R_2, E, T = 4e-3, 1e-3, 0.8, 0.5, 0.01, 100.0, 5e-3
    M = k * math.sqrt(L_1 * L_2)
    A = np.linalg.solve([[L_1, M], [M, L_2]], -np.diag([R, R_2]))
    rest = np.array([E / R, 0.0])
    errors = []
    for step in (40e-6, 20e-6, 10e-6):
        net = sg.Network("coupled")
        a, b = net.dc_bus("a", 100.0), net.dc_bus("b", 100.0)
        net.add("source", sg.DcSource(v_0=E, R=0.1), a=a)
        net.add("windings", sg.CoupledInductors(L_1=L_1, L_2=L_2, k=k, R_1=R - 0.1), first=a, second=b)
        net.add("short", sg.Resistor(R=R_2), a=b)
        run = assembled(net, step).run(until=T)
        expected = np.array([rest - expm(A * t) @ rest for t in run["windings.i_1"]["time"].values])
        got = np.array([run["windings.i_1"], run["windings.i_2"]]).T
        errors.append(np.abs(got - expected).max())
        slope = float(run["windings.i_1"][1]) / step
        assert slope == pytest.approx(E / (L_1 * (1.0 - k**2)), rel=0.6 * step * R / (L_1 * (1.0 - k**2)))
    assert errors[-1] < 1e-5 * E / R
    assert orders(errors) == pytest.approx(2.0, abs=0.1)


def test_coupled_windings_between_buses_take_and_give_the_same_power():
    net = sg.Network("floating winding")
    a, b, c = (net.dc_bus(name, 100.0) for name in "abc")
    for bus in (b, c):
        net.capacitance(bus, 200e-6)
    net.add("source", sg.DcSource(v_0=100.0, R=0.2), a=a)
    net.add("windings", sg.CoupledInductors(L_1=2e-3, L_2=1e-3, k=-0.6), first=sg.Across(a, b), second=c)
    net.add("load", sg.Resistor(R=10.0), a=b, b=c)
    run = assembled(net, 5e-6).run(until=10e-3)
    moved = sum(run.energy["losses"].values()) + sum(run.energy["stored"].values())
    assert run.energy["sources"]["source"] == pytest.approx(moved, rel=1e-4)
    assert float(np.abs(run["c.v_dc"]).max()) > 5.0


def test_a_series_rlc_branch_with_a_contact_is_the_closed_form():
    R, L, C, E, T = 0.5, 1e-3, 100e-6, 100.0, 8e-3
    a, w = R / (2 * L), math.sqrt(1 / (L * C) - (R / (2 * L)) ** 2)
    errors = []
    for step in (20e-6, 10e-6):
        net = sg.Network("branch")
        bus = net.dc_bus("bus", 100.0)
        net.add("source", sg.DcSource(v_0=E, R=0.1), a=bus)
        net.add("branch", sg.RlcBranch(R=R - 0.1, L=L, C=C), a=bus, contact="open")
        run = assembled(net, step).run(events=[sg.At(1e-3, sg.Close("branch"))], until=1e-3 + T)
        t = np.maximum(run["branch.i"]["time"].values - 1e-3, 0.0)
        errors.append(float(np.abs(run["branch.i"] - E / (w * L) * np.exp(-a * t) * np.sin(w * t)).max()))
    assert orders(errors) == pytest.approx(2.0, abs=0.15)
    assert errors[-1] < 2e-3 * E / (w * L)


def test_a_constant_current_charges_a_capacitor_between_buses_in_a_straight_line():
    net = sg.Network("charging")
    a, b = net.dc_bus("a", 1e3), net.dc_bus("b", 1e3)
    net.add("source", sg.CurrentSource(i_0=2.0), a=a)
    net.add("capacitor", sg.Capacitor(C=1e-3, R=0.5), a=a, b=b)
    net.add("return", sg.Resistor(R=3.0), a=b)
    run = assembled(net, 30e-6).run({"capacitor.v_c": -4.0}, until=9e-3)
    t = run["a.v_dc"]["time"].values
    # exact, at time zero too: voltages of buses without capacitance belong to the states there
    assert run["capacitor.v_c"].values == pytest.approx(-4.0 + 2.0 * t / 1e-3, abs=1e-9)
    assert run["a.v_dc"].values == pytest.approx(
        2.0 * 3.5 - 4.0 + 2.0 * t / 1e-3, abs=1e-4
    )  # settled by 1e-6 of a step
    assert abs(run.energy_balance_error) < 1e-6


@pytest.mark.parametrize("R_on", [1e-1, 1e-3, 1e-4, 1e-6])
def test_a_breaker_between_two_capacitors_leaves_their_common_charge(R_on):
    """From 6 times the step down to a 1e-5th of it; the charge is kept, and the rule does not ring."""
    C_1, C_2, v_1, v_2 = 3e-3, 6e-3, 700.0, 730.0
    net = sg.Network("tie")
    a, b = net.dc_bus("a", 750.0), net.dc_bus("b", 750.0)
    net.capacitance(a, C_1)
    net.capacitance(b, C_2)
    net.add("tie", sg.Breaker(R_on=R_on), a=a, b=b, contact="open")
    run = assembled(net, 30e-6).run({"a.v_dc": v_1, "b.v_dc": v_2}, events=[sg.At(3e-4, sg.Close("tie"))], until=3e-3)
    charge = C_1 * run["a.v_dc"] + C_2 * run["b.v_dc"]
    assert charge.values == pytest.approx(C_1 * v_1 + C_2 * v_2, rel=1e-9)
    between = (run["a.v_dc"] - run["b.v_dc"]).values
    closed = round(3e-4 / 30e-6)
    assert between[closed] == pytest.approx(v_1 - v_2, abs=1e-9)
    tau = R_on * C_1 * C_2 / (C_1 + C_2)
    if tau > 30e-6:
        t = run["a.v_dc"]["time"].values[closed:] - 3e-4
        assert between[closed:] == pytest.approx((v_1 - v_2) * np.exp(-t / tau), abs=2e-3 * abs(v_1 - v_2))
    else:  # each step leaves R(-h / tau) of it, at most 0.21 in magnitude
        assert np.all(np.abs(between[closed + 1 :]) <= 0.21 * np.abs(between[closed:-1]) + 1e-9)
    # what flows afterwards is right whatever R_on: nothing
    assert abs(float(run["tie.i"][-1])) < 1e-3


def test_an_opened_breaker_carries_nothing_and_loses_nothing():
    net = sg.Network("opened")
    a, b = net.dc_bus("a", 100.0), net.dc_bus("b", 100.0)
    net.capacitance(b, 1e-3)
    net.add("source", sg.DcSource(v_0=100.0, R=1.0), a=a)
    net.add("breaker", sg.Breaker(R_on=1e-3), a=a, b=b)
    net.add("load", sg.Resistor(R=10.0), a=b)
    plan = assembled(net, 10e-6)
    run = plan.run(events=[sg.At(5e-3, sg.Open("breaker"))], until=10e-3)
    after = run["breaker.i"]["time"] > 5.005e-3
    assert float(np.abs(run["breaker.i"][after]).max()) == 0.0
    lost = run.energy["losses"]["breaker"]
    # no more than while it was closed, with 100 V across the open contact ever since
    assert lost == pytest.approx(float((1e-3 * run["breaker.i"] ** 2).integrate("time")), rel=1e-2)
    t = run["b.v_dc"]["time"].values
    v_0 = float(run["b.v_dc"][t <= 5e-3 + 1e-9][-1])
    expected = v_0 * np.exp(-(t[t > 5e-3] - 5e-3) / 10e-3)
    assert run["b.v_dc"].values[t > 5e-3] == pytest.approx(expected, rel=1e-5)
    again = reference_run(
        plan, plan.run({"breaker.close": 0.0, "b.v_dc": 60.0}, until=10e-6).end, 2e-3, ["b.v_dc", "breaker.i"]
    )
    assert again["breaker.i"][-1] == 0.0
    assert again["b.v_dc"][-1] == pytest.approx(60.0 * math.exp(-0.2), rel=1e-6)


def test_a_run_goes_on_where_another_ended_and_leaves_it_as_it_was():
    def circuit():
        net = sg.Network("ladder")
        a, b = net.dc_bus("a", 100.0), net.dc_bus("b", 100.0)
        net.capacitance(a, 1e-3)
        net.capacitance(b, 1e-4)
        net.add("source", sg.InductiveDcSource(v_0=100.0, R=0.1, L=1e-3), a=a)
        net.add("choke", sg.Choke(R=0.1, L=1e-3), a=a, b=b)
        net.add("load", sg.Resistor(R=10.0), a=b)
        return assembled(net, 20e-6)

    plan = circuit()
    events = [sg.At(4e-3, sg.Set("source.v_pu", 0.5)), sg.At(7e-3, sg.Set("source.v_pu", 0.8))]
    whole = plan.run(events=events, until=10e-3)
    first = plan.run(events=events[:1], until=6e-3)
    kept = first.end.sig.copy()
    second = plan.run(first.end, events=events[1:], until=10e-3)
    assert np.array_equal(first.end.sig, kept)
    assert float(second["b.v_dc"]["time"][0]) == pytest.approx(6e-3)
    assert np.array_equal(second["b.v_dc"], whole["b.v_dc"][300:])
    assert abs(second.energy_balance_error) < 1e-3
    thin = plan.run(events=events, until=10e-3, record=["b.v_dc"], every=50)
    assert thin.signals == ["b.v_dc"]
    assert np.array_equal(thin["b.v_dc"], whole["b.v_dc"][::50])
    assert float(thin["b.v_dc_max"].max()) == float(whole["b.v_dc"].max())


def test_a_signal_may_move_a_contact_and_a_command_the_duty_of_a_leg():
    net = sg.Network("buck")
    high, low = net.dc_bus("high", 100.0), net.dc_bus("low", 100.0)
    net.add("source", sg.DcSource(v_0=100.0, R=1e-3), a=high)
    net.capacitance(low, 1e-4)
    net.add("choke", sg.Choke(R=0.1, L=1e-3), a=sg.Pole(high, s=net.command("leg.duty", 0.4)), b=low)
    relay = net.command("relay.open", 0.0)
    net.add("load", sg.Resistor(R=10.0), a=low)
    net.add("second", sg.Resistor(R=10.0), a=low, variant=relay)
    run = assembled(net, 20e-6).run(
        events=[sg.At(0.1, sg.Set("relay.open", 1.0)), sg.At(0.2, sg.Set("leg.duty", 0.6))], until=0.3
    )
    v = run["low.v_dc"]
    for at, s, load in ((0.0999, 0.4, 5.0), (0.1999, 0.4, 10.0), (0.2999, 0.6, 10.0)):
        expected = s * 100.0 / (1.0 + (0.1 + s**2 * 1e-3) / load)
        assert float(v.sel(time=at, method="nearest")) == pytest.approx(expected, rel=1e-5)


def test_explain_says_which_ties_settle_within_a_step():
    net = sg.Network("ties")
    a, b, c = (net.dc_bus(name, 750.0) for name in "abc")
    for bus in (a, b, c):
        net.capacitance(bus, 10e-3)
    net.add("bar", sg.Breaker(R_on=1e-4), a=a, b=b)
    net.add("cable", sg.RlBranch(R=2e-3, L=9e-6), a=b, b=c)
    net.add("load", sg.Resistor(R=1.0), a=c)
    bar, cable = tie_rows(net, 30e-6)
    assert bar == ("bar", "a and b", "0.5 us", "60", "solved; settles within a step, not merged")
    assert cable[:2] == ("cable", "b and c") and cable[4] == "solved, step by step"
    assert float(cable[2].removesuffix(" us")) == pytest.approx(1e6 * math.sqrt(9e-6 * 5e-3), rel=0.01)


def test_a_run_that_diverges_says_so_and_keeps_what_it_has():
    net = sg.Network("runaway")
    bus = net.dc_bus("bus", 10.0)
    net.capacitance(bus, 1e-4)
    net.add("source", sg.CurrentSource(i_0=100.0), a=bus)
    with pytest.raises(SolverError, match=r"bus\.v_dc = 3. V, beyond 30 V; source\.i_in = -100 A") as caught:
        assembled(net, 1e-6).run(until=1e-3)
    run = caught.value.run  # beyond at both ends of a step: an impulse is no divergence
    assert run.failure and run["bus.v_dc"].values == pytest.approx(np.arange(len(run["bus.v_dc"])))
    assert run["bus.v_dc"][-1] > 30.0 and len(run["bus.v_dc"]) < 35


# --- genset -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def genset():
    return example("plot_genset_load_bank")


def test_the_genset_settles_on_its_droop_line_and_the_bank_takes_its_power(genset, tmp_path):
    run = genset.simulate()
    for at, banks in ((0.9, 1), (4.9, 2), (8.9, 3), (12.9, 2)):
        now = {name: float(run[name].sel(time=genset.SETTLING + at, method="nearest")) for name in run.signals}
        assert now["machine.omega"] == pytest.approx(1.02 - 0.05 * now["governor.throttle"], abs=2e-4)
        assert now["machine.p_pu"] == pytest.approx(sum(genset.STEPS[:banks]) * now["machine.v_t"] ** 2, rel=1e-6)
        assert now["machine.v_t"] == pytest.approx(1.0, abs=0.006)  # K_A = 600: 1/600 of the field voltage's steps
    assert drawn(genset, run, tmp_path) > 20_000


@pytest.mark.parametrize(("T_E", "T_d01", "step"), [(0.8, 3.5, 30e-6), (0.1, 2.0, 15e-6)])
def test_a_load_step_on_the_genset_is_its_differential_equations(genset, T_E, T_d01, step):
    """Machine, governor, exciter as one system for SciPy: no dead time, no sampling."""
    net = genset.circuit(DieselEngine(T_D=0.0), clock=None)
    for path, changed in (("exciter", {"T_E": T_E}), ("machine", {"T_d01": T_d01})):
        net.placed[path].item = dataclasses.replace(net.placed[path].item, **changed)
    plan = sg.assemble(net, step=step)
    rest = plan.run(until=4.0, record=["machine.omega"], every=1000)
    run = plan.run(rest.end, events=[sg.At(4.0, sg.Close("bank_1"))], until=5.0)
    parts = {name: plan.network.placed[name].item for name in ("machine", "governor", "exciter")}
    records, places = {}, {}
    for name, item in parts.items():
        kind = type_of(item)
        p, tables = parameter_record(item)
        made = {
            k: make_record(r) for k, r in (("x", kind.state), ("u", kind.input), ("y", kind.output), ("dx", kind.state))
        }
        records[name] = made | {"p": p, "tables": tables, "t": 0.0}
        places[name] = [plan.layout.slots["x", f"{name}.{x}"] for x in names_of(kind.state)]
    m, g, e = (records[name] for name in ("machine", "governor", "exciter"))
    u = m["u"]
    g["u"].omega_ref, g["u"].fuel = 1.02, 1.0
    e["u"].v_ref, e["u"].on = 1.0, 1.0
    ohms = genset.V**2 / (sum(genset.STEPS[:2]) * genset.RATING)

    def rates(t, z):
        at = 0
        for name in parts:
            flat_of(records[name]["x"])[:] = z[at : at + len(places[name])]
            at += len(places[name])
        for _ in range(2):  # currents follow from the flux linkages, the voltage from the currents
            call_uncompiled(type_of(parts["machine"]).kernels["outputs"], m)
            u.v_alpha, u.v_beta = -ohms * m["y"].i_alpha, -ohms * m["y"].i_beta
        g["u"].omega = m["x"].omega
        e["u"].v_t, e["u"].i_fd = m["y"].v_t, m["y"].i_fd
        call_uncompiled(type_of(parts["exciter"]).kernels["outputs"], e)
        u.E_fd, u.T_m = e["y"].E_fd, g["x"].throttle
        for name, item in parts.items():
            call_uncompiled(type_of(item).kernels["derivatives"], records[name])
        assert 0.0 < g["x"].throttle < 1.0 and abs(e["x"].v_a) < 14.5  # inside all limits
        return np.concatenate([flat_of(records[name]["dx"]) for name in parts])

    start = rest.end.sig[np.concatenate(list(places.values()))]
    at = np.linspace(4.0, 5.0, 201)[:-1]
    found = solve_ivp(rates, (4.0, 5.0), start, t_eval=at, method="LSODA", rtol=1e-7, atol=1e-9)
    for k, name in enumerate(names_of(type_of(parts["machine"]).state)[:6]):
        got = run[f"machine.{name}"].sel(time=at, method="nearest").values
        # governor and exciter act on the last step's speed and voltage: 30 us of a swing of some 10 rad/s. An exciter
        # of 0.1 s answers it within 10 ms; the difference goes with the step, and is 4.6e-3 at 30 us with it.
        assert np.abs(got - found.y[k]).max() < 2e-3 * max(np.ptp(found.y[k]), 0.05), name


# --- what cannot be connected -----------------------------------------------------------------------------------------


def buses():
    net = sg.Network("yard")
    return net, net.dc_bus("dc", 750.0), net.ac_bus("ac", 400.0, 60.0)


R = sg.Resistor(R=1.0)
LEG_AND_BUS = r"end 'a' .* a half-bridge leg on DC bus 'dc', expected a bus"
ELSEWHERE = r"'a' is connected to DC bus 'dc', which is no bus of yard"
HALF = r"has the three-phase terminals \['primary', 'secondary'\], connected are \['primary'\]"


@pytest.mark.parametrize(
    ("connect", "message"),
    [
        (lambda n, d, a: n.add("r", R, a=d, b=a), r"r \(Resistor\): end 'a' is at DC bus 'dc', end 'b' at AC bus 'ac'"),
        (lambda n, d, a: n.add("r", R, ports={"branch": sg.Across(d, a)}), r"'branch' .* DC bus 'dc' and AC bus 'ac'"),
        (lambda n, d, a: n.add("r", R, ports={"branch": sg.Across(a, d)}), r"'branch' .* AC bus 'ac' and DC bus 'dc'"),
        (lambda n, d, a: n.add("r", R, a=d, b=d), r"r \(Resistor\): both ends are at DC bus 'dc'"),
        (lambda n, d, a: n.add("r", R, b=d), r"branch with the ends a and b, connected are \['b'\]"),
        (lambda n, d, a: n.add("r", R, a=d, bb=d), r"branch with the ends a and b, connected are \['a', 'bb'\]"),
        (lambda n, d, a: n.add("r", R, a=sg.Pole(d, s="x"), b=d), LEG_AND_BUS),
        (lambda n, d, a: n.add("r", R, a=sg.Network("other").dc_bus("dc", 1.0)), ELSEWHERE),
        (lambda n, d, a: n.add("t", TRANSFORMER, primary=a), HALF),
        (lambda n, d, a: n.add("t", TRANSFORMER, primary=a, secondary=d), r"'secondary' is three-phase .* DC bus 'dc'"),
        (lambda n, d, a: n.add("t", TRANSFORMER, primary=d, secondary=d), r"'primary' is three-phase .* DC bus 'dc'"),
        (lambda n, d, a: n.add("s", sg.ThreePhaseSource(R=0.1, L=1e-3), a=d), r"s .* three-phase .* DC bus 'dc'"),
        (lambda n, d, a: n.add("c", sg.Choke(R=0.1, L=1e-3), a=d, b=a), r"'a' is three-phase here .* DC bus 'dc'"),
        (lambda n, d, a: n.add("x", sg.Capacitor(C=1e-3, R=1.0), a=d, contact="open"), r"x .* has no contact"),
        (lambda n, d, a: n.add("b", sg.Breaker(), a=d, contact="ajar"), r"'ajar', expected 'closed' or 'open'"),
        (lambda n, d, a: n.add("b", sg.Breaker(), a=d, contact="open", variant="z"), r"'z' moves its contact already"),
    ],
)  # fmt: skip
def test_a_connection_that_cannot_be_names_both_ends(connect, message):
    with pytest.raises(TopologyError, match=message):
        connect(*buses())


TRANSFORMER = sg.Transformer.per_unit(50e3, 400.0, 230.0, 60.0)


def test_everything_wrong_with_events_is_said_at_once():
    net = sg.Network("events")
    bus = net.dc_bus("bus", 100.0)
    net.add("source", sg.DcSource(v_0=100.0, R=1.0), a=bus)
    net.add("breaker", sg.Breaker(), a=bus)
    plan = sg.assemble(net)
    wrong = [
        sg.At(1.0, sg.Open("braker")),
        sg.At(-1.0, sg.Open("breaker")),
        sg.At(1.0, sg.Set("source.v", 2.0)),
        sg.At(1.0, sg.Set("source.v_pu", math.nan)),
    ]
    with pytest.raises(InputErrors) as caught:
        plan.run(events=wrong, until=2.0)
    lines = caught.value.problems
    assert "no contact to operate (nearest: 'breaker')" in lines[0]
    assert "time=-1.0" in lines[1] and "the run starts at 0 s" in lines[1]
    assert "nothing can be set there (nearest: 'source.v_pu')" in lines[2]
    assert "no number" in lines[3]
    with pytest.raises(InputErrors, match=r"start: 'bus\.v_cd' = 1\.0 .*nearest: 'bus\.v_dc'"):
        plan.run({"bus.v_cd": 1.0}, until=1.0)
    with pytest.raises(InputErrors, match=r"no signal 'bus\.v_cd' \(nearest: 'bus\.v_dc'\)"):
        plan.run(until=1.0, record=["bus.v_cd"])
    with pytest.raises(ParameterError, match="do not fit in memory"):
        plan.run(until=1e3)
    with pytest.raises(ParameterError, match="until"):
        plan.run(until=0.0)


@pytest.mark.parametrize("step", ["30 us", 0.0, float("nan"), None])
def test_a_step_that_is_no_time_and_a_fidelity_that_is_none_are_refused(step):
    with pytest.raises(ParameterError, match="is not a positive number of seconds"):
        sg.assemble(sg.Network("circuit"), step=step)
    with pytest.raises(ParameterError, match="no fidelity 'mean', expected one of averaged, switching"):
        sg.Network("circuit", "mean")
