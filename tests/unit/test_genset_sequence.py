"""Genset: its sequence step by step, and how it is wired."""

import dataclasses
from types import SimpleNamespace

import pytest

from shipgrid.components.sources.synchronous_generator import SynchronousGenerator
from shipgrid.equipment import genset
from shipgrid.equipment.genset import Genset, Input, Output, State, update
from shipgrid.errors import ParameterError, TopologyError
from shipgrid.model.component import fields_of, type_of
from shipgrid.model.network import Network
from shipgrid.model.records import make_record, parameter_record

DT = 10e-3


class Sequence:
    """A sequence with signals set by hand."""

    def __init__(self, state=genset.OFF, **inputs):
        self.p, _ = parameter_record(genset.GensetSequence())
        self.x, self.x_next = make_record(State, {"state": state}), make_record(State)
        self.u = make_record(Input, {"speed_ref": 1.0, "v_ref": 1.0, **inputs})
        self.y = make_record(Output)
        if state >= genset.RUNNING_UP:
            self.x.omega_ref, self.x.v_t_ref = self.u.omega, self.u.v_t

    def run(self, seconds=DT, **inputs):
        for name, value in inputs.items():
            setattr(self.u, name, value)
        for _ in range(round(seconds / DT)):
            for name in ("state", "refused", "timer", "steady", "omega_ref", "v_t_ref"):
                setattr(self.x_next, name, getattr(self.x, name))
            update(0.0, DT, self.x, self.u, self.p, self.x_next, self.y)
            for name in ("state", "refused", "timer", "steady", "omega_ref", "v_t_ref"):
                setattr(self.x, name, getattr(self.x_next, name))
        return genset.STATES[int(self.x.state)]


def test_started_it_goes_from_cranking_to_on():
    s = Sequence()
    assert s.run(1.0) == "off"
    assert s.run(on=1.0) == "cranking" and s.y.crank == 1.0 and s.y.fuel == 0.0
    assert s.run(omega=0.199) == "cranking"
    assert s.run(omega=0.2) == "running up" and s.y.crank == 0.0 and s.y.fuel == 1.0
    assert s.x.omega_ref == pytest.approx(0.199 + 0.25 * DT)  # the ramp begins at the speed
    assert s.run(1.0) == "running up" and s.x.omega_ref == pytest.approx(0.45, abs=0.003)
    s.run(2.5)
    assert s.run(0.6, omega=1.0) == "building up voltage" and s.y.excite == 1.0 and s.y.ready == 0.0
    assert s.run(2.1) == "building up voltage" and s.x.v_t_ref == 1.0
    assert s.run(0.6, v_t=0.997) == "on"
    assert (s.y.ready, s.y.on, s.y.stop) == (1.0, 1.0, 0.0)


def test_told_to_stop_it_waits_until_the_rectifier_has_opened():
    s = Sequence(genset.ON, on=1.0, omega=1.0, v_t=1.0, rectifier_connected=1.0)
    assert s.run() == "on"
    assert s.run(30.0, on=0.0) == "unloading"
    assert (s.y.stop, s.y.ready, s.y.fuel) == (1.0, 1.0, 1.0)
    assert s.run(rectifier_connected=0.0) == "cooling down"
    assert s.y.ready == 0.0 and s.y.fuel == 1.0
    assert s.run(30.1) == "running down" and (s.y.fuel, s.y.excite) == (0.0, 0.0)
    assert s.run(omega=0.5) == "running down"
    assert s.run(omega=0.004) == "off"


def test_a_start_command_takes_it_back_from_every_state_of_the_stop():
    assert Sequence(genset.UNLOADING, on=1.0, omega=1.0, v_t=1.0, rectifier_connected=1.0).run() == "on"
    assert Sequence(genset.COOLING, on=1.0, omega=1.0, v_t=1.0).run() == "building up voltage"
    assert Sequence(genset.RUNNING_DOWN, on=1.0, omega=0.6).run() == "running up"
    s = Sequence(genset.RUNNING_DOWN, on=1.0, omega=0.1)
    assert s.run() == "running down"
    assert s.run(2 * DT, omega=0.0) == "cranking"


def test_a_rectifier_that_closes_as_ready_falls_is_unloaded_again():
    assert Sequence(genset.COOLING, omega=1.0, v_t=1.0, rectifier_connected=1.0).run() == "unloading"


@pytest.mark.parametrize(
    ("state", "inputs", "reason"),
    [
        (genset.CRANKING, {"omega": 0.1}, "the engine did not fire"),
        (genset.RUNNING_UP, {"omega": 0.8}, "the engine did not reach its speed"),
        (genset.EXCITING, {"omega": 1.0, "v_t": 0.5}, "the voltage did not build up"),
    ],
)
def test_a_start_that_fails_is_refused_until_the_command_is_withdrawn(state, inputs, reason):
    s = Sequence(state, on=1.0, **inputs)
    s.run(20.2)
    assert genset.REFUSALS[int(s.x.refused)] == reason
    assert s.run(1.0, omega=0.0) == "off"
    assert s.x.refused != 0.0
    s.run(on=0.0)
    assert s.x.refused == 0.0
    assert s.run(on=1.0) == "cranking"


def test_an_interrupted_start_runs_down():
    assert Sequence(genset.CRANKING, omega=0.1).run() == "running down"
    assert Sequence(genset.RUNNING_UP, omega=0.5).run() == "running down"


def wired(item=None, rectifiers=()):
    net = Network("test")
    items = {name: SimpleNamespace(source=source) for name, source in rectifiers}
    (item or Genset()).build(net, "genset_for", SimpleNamespace(items=lambda kind: items))
    return net


def test_every_input_reads_a_signal_that_exists():
    net = wired()
    fields = {
        f"{path}.{f.name}"
        for path, placed in net.placed.items()
        for record in (type_of(placed.item).state, type_of(placed.item).input, type_of(placed.item).output)
        for f in fields_of(record)
    }
    commands = {f"command:genset_for.{c.name}" for c in Genset.__equipment__.commands}
    for path, placed in net.placed.items():
        kind = type_of(placed.item)
        terminal_voltages = {t.v for t in kind.terminals}
        for f in fields_of(kind.input):
            source = placed.inputs.get(f.name)
            if source is not None:
                assert source in fields | commands, f"{path}.{f.name}"
            else:
                assert f.name in terminal_voltages or not f.signal.required, f"{path}.{f.name}"
    assert {s.source for s in net.published.values()} <= fields
    assert {w.source for w in net.watched} <= fields


def test_the_public_signals_and_commands_are_those_promised():
    promised = {"p_ac", "q_ac", "v_rms", "omega_pu", "v_pu", "p_pu", "on"}
    assert set(wired().published) == {f"genset_for.{name}" for name in promised}
    assert {c.name for c in Genset.__equipment__.commands} == {"on", "speed_ref", "v_ref"}


def test_the_local_load_takes_its_share_at_rated_voltage():
    net = wired()
    resistance = 1.0 / net.conductances["genset_for.terminals.v_alpha"]
    assert resistance == pytest.approx(4.83, abs=0.005)  # ohm a phase, star
    assert 480.0**2 / resistance == pytest.approx(0.08 * 596e3)


def test_the_rating_reaches_the_machine():
    machine = wired(Genset(rating=300e3, inertia_H=0.4, v_n=690.0)).placed["genset_for.machine"].item
    assert (machine.S_n, machine.H, machine.v_n) == (300e3, 0.4, 690.0)


def test_its_rectifier_is_found_by_its_source():
    net = wired(rectifiers=[("rectifier_aft", "genset_aft"), ("rectifier_for", "genset_for")])
    assert net.placed["genset_for.sequence"].inputs["rectifier_connected"] == "rectifier_for.sequence.connected"
    with pytest.raises(TopologyError, match="rectifier_a and rectifier_b"):
        wired(rectifiers=[("rectifier_a", "genset_for"), ("rectifier_b", "genset_for")])


def test_a_rating_said_twice_is_refused():
    with pytest.raises(ParameterError, match=r"genset\.machine\.S_n = 500000 is set by genset\.rating"):
        Genset(machine=SynchronousGenerator(S_n=500e3))
    assert Genset(rating=500e3, machine=SynchronousGenerator(S_n=500e3)).rating == 500e3
    with pytest.raises(ParameterError, match="X_d2"):
        dataclasses.replace(Genset(), machine=SynchronousGenerator(X_d2=0.3))
