"""When a reference acts: the table in docs/theory/modulation.md, measured."""

from __future__ import annotations

import pytest

import shipgrid as sg

H, HERTZ = 50e-6, 2000.0  # ten steps a period


def first_step(modulator, clock, inputs, output):
    """Number of steps after a change of the reference, between two instants of the clock, until an output moves."""
    net = sg.Network("bench")
    dc = net.dc_bus("dc", 750.0)
    net.capacitance(dc, 1e-3)
    net.conductance(dc, 1e-3)
    needs = {"phase", "phase_next", "turns"} & set(inputs)
    if needs:
        net.add("carrier", sg.Carrier(), clock=sg.Sampled(HERTZ))
    fed = {name: f"carrier.{name}" for name in needs}
    net.add("modulator", modulator, inputs=dict.fromkeys(set(inputs) - needs, 0.2) | fed, clock=clock)
    session = sg.Session(sg.assemble(net, H), {"dc.v_dc": 750.0})
    session.advance(by=33 * H)  # three steps after an instant of the clock
    for name in set(inputs) - needs:
        session.command(f"modulator.{name}", 0.3)
    before = session.read(f"modulator.{output}")
    for step in range(1, 40):
        session.advance()
        if session.read(f"modulator.{output}") != before:
            return step
    return None


LEG, BRIDGE, VECTOR = ("s_ref",), ("s_alpha_ref", "s_beta_ref"), ("s_alpha", "s_beta")


@pytest.mark.parametrize(
    ("modulator", "clock", "inputs", "steps"),
    [
        (sg.DirectBridge(), None, VECTOR, 1),  # in the step under way
        (sg.AveragedLeg(), None, LEG, 2),  # a step late
        (sg.AveragedBridge(), None, BRIDGE, 2),
        (sg.AveragedLeg(), sg.Sampled(HERTZ), LEG, 8),  # at the next instant: seven steps on, seen in the step after it
        (sg.AveragedBridge(), sg.Sampled(HERTZ), BRIDGE, 8),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_reference_acts_when_the_table_says(modulator, clock, inputs, steps):
    output = "lo" if inputs == LEG else "lo_a"
    assert first_step(modulator, clock, inputs, output) == steps
