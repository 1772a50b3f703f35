"""A state of a circuit in a file: taken back to the last bit by the same plan, refused to another with what differs."""

from __future__ import annotations

import numpy as np
import pytest

import shipgrid as sg
from shipgrid.errors import InputErrors
from shipgrid.scenarios import snapshot

EVENTS = [sg.At(1e-3, sg.Close("choke"))]


def plan(L=1e-3, C=100e-6, step=30e-6):
    """R, L and C behind a contact."""
    net = sg.Network("R-L-C step")
    feed, far = net.dc_bus("feed", v_n=100.0), net.dc_bus("far", v_n=100.0)
    net.add("source", sg.DcSource(v_0=100.0, R=0.1), a=feed)
    net.add("choke", sg.RlBranch(R=0.4, L=L), a=feed, b=far, contact="open")
    net.add("load", sg.Resistor(R=20.0), a=far)
    net.capacitance(far, C)
    return sg.assemble(net, step=step)


@pytest.fixture(scope="module")
def circuit():
    return plan()


def test_a_run_from_a_file_goes_on_to_the_same_bits(circuit, tmp_path):
    at_once = circuit.run(events=EVENTS, until=20e-3)
    first = circuit.run(events=EVENTS, until=7e-3)
    circuit.save(first.end, tmp_path / "end.npz")
    second = circuit.run(plan().load(tmp_path / "end.npz"), until=20e-3)
    assert len(second["choke.i"]) > 400 and float(np.ptp(second["choke.i"].values)) > 1.0
    for name in at_once.signals:
        whole, rest = at_once[name].values, second[name].values
        assert whole[-len(rest) :].tobytes() == rest.tobytes(), name


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"L": 2e-3}, "choke.L: '0.001' in the snapshot, '0.002' now"),
        ({"step": 20e-6}, "step: '3e-05 s' in the snapshot, '2e-05 s' now"),
        ({"C": 90e-6}, "node_c_gh of the plan differs"),
    ],
)
def test_another_circuit_refuses_it_and_says_what_differs(circuit, tmp_path, changed, said):
    circuit.save(circuit.run(until=1e-3).end, tmp_path / "end.npz")
    with pytest.raises(InputErrors) as caught:
        plan(**changed).load(tmp_path / "end.npz")
    assert caught.value.problems[1:] == [f"  {said}"]
    with pytest.raises(InputErrors, match="there is no snapshot"):
        circuit.load(tmp_path / "other.npz")


def test_a_full_disk_leaves_the_older_snapshot(circuit, tmp_path, monkeypatch):
    path = tmp_path / "end.npz"
    circuit.save(circuit.run(until=1e-3).end, path)
    older = path.read_bytes()

    def full(number):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space"):
        patch.setattr(snapshot.os, "fsync", full)
        circuit.save(circuit.run(until=2e-3).end, path)
    assert path.read_bytes() == older
    assert circuit.load(path).n == round(1e-3 / 30e-6)
