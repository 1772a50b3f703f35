"""Stub lines: what joins the parts of a plant that is cut, so that each can be stepped on a core of its own.

An inductance L between two parts is replaced by a lossless line of the same L whose delay is one step: nothing that
happens in one part is felt in the other within a step, and neither waits for the other's equations. With
Z = L / h and a series resistance R, which stands at the near end,

    i = (v - Z a) / (Z + R),     b = 2 i + a = v' / Z + i           (stub-1)

at each end: `v` is the voltage that drives the end and v' = v - R i that of the line, `i` the current into it, `a` the
wave that arrives and `b` the one that leaves, to arrive at the other end a step later. What the line has and the cable
has not is the capacitance C = h^2 / L (`assembly/partition.py` reports it); its error falls with h^2.

Each of the two stages of the integration rule has waves of its own: what leaves in the first stage of one step arrives
in the first stage of the next. So the delay is a step exactly wherever the equations are solved, and the energy of the
line,

    E = h Z / 4 sum_s b_s (a_s,near^2 + a_s,far^2),   b_s = 1 - gamma, gamma         (stub-2)

changes in a step by what its ends take in, summed as the rule sums. With one wave for both stages a cut between small
capacitances is unstable (tests/verification/test_stub_lines.py).

A contact in series is at both ends, which move in the same step: an end that moved a step before the other would draw
a charge that the other does not give, and ring. While it is open no current flows and each end sends b = v / Z, as if
the line had taken on the voltage behind the contact: it closes onto a line at rest. The first stage of the step in
which it closes is gamma of that step long; a whole one would leave its line with a current of its own, for good:

    a_1 <- gamma a_1 + (1 - gamma) b_1           (stub-3)

Source: lossless line of one step [Dommel1969]; in the place of an element, to decouple [Hui1994]; docs/theory/cores.md.
"""

from __future__ import annotations

from shipgrid.model import kernel
from shipgrid.model.kernel import inlined
from shipgrid.solvers.companion import GAMMA


@inlined
def first_waves(sig, line_in, line_sent, line_wave, line_select, line_before, line_closed):
    """Hand each end's element the wave that arrives in the first stage, (stub-3) where its contact closes.

    A step that is solved again, since a blocked leg changed its state, begins from the same waves.
    """
    for k in range(line_wave.shape[0]):
        a = sig[line_in[0, k]]
        if stands_closed(sig, k, line_select, line_closed) and not stands_closed(sig, k, line_before, line_closed):
            a = GAMMA * a + (1.0 - GAMMA) * sig[line_sent[k]]
        sig[line_wave[k]] = a


@inlined
def second_waves(sig, line_in, line_wave):
    """Hand each end's element the wave that arrives in the second stage."""
    for k in range(line_wave.shape[0]):
        sig[line_wave[k]] = sig[line_in[1, k]]


@inlined
def send(
    stage,
    sig,
    line_wave,
    line_out,
    line_port,
    line_select,
    line_closed,
    line_state,
    line_current,
    line_sense,
    history,
    values,
    part_start,
    port_w,
    port_first,
    port_count,
    port_voltage,
):
    """The wave that leaves each end in a stage, (stub-1), and the current of the element that is cut."""
    for k in range(line_wave.shape[0]):
        found = element_says(k, line_port, history, values, part_start, port_w, port_first, port_count, port_voltage)
        i = 0.0
        if stands_closed(sig, k, line_select, line_closed):
            i = found
            found = 2.0 * i + sig[line_wave[k]]
        sig[line_out[stage, k]] = found
        sig[line_state[k]] = line_sense[k, 0] * i
        sig[line_current[k]] = line_sense[k, 1] * i


@inlined
def first_sent(
    sig,
    line_wave,
    line_out,
    line_port,
    line_select,
    line_closed,
    line_state,
    line_current,
    line_sense,
    history,
    values,
    part_start,
    port_w,
    port_first,
    port_count,
    port_voltage,
):
    """What leaves the ends in the first stage."""
    send(
        0,
        sig,
        line_wave,
        line_out,
        line_port,
        line_select,
        line_closed,
        line_state,
        line_current,
        line_sense,
        history,
        values,
        part_start,
        port_w,
        port_first,
        port_count,
        port_voltage,
    )


@inlined
def second_sent(
    sig,
    line_wave,
    line_out,
    line_port,
    line_select,
    line_closed,
    line_state,
    line_current,
    line_sense,
    history,
    values,
    part_start,
    port_w,
    port_first,
    port_count,
    port_voltage,
):
    """What leaves the ends in the second stage."""
    send(
        1,
        sig,
        line_wave,
        line_out,
        line_port,
        line_select,
        line_closed,
        line_state,
        line_current,
        line_sense,
        history,
        values,
        part_start,
        port_w,
        port_first,
        port_count,
        port_voltage,
    )


@kernel
def element_says(k, line_port, history, values, part_start, port_w, port_first, port_count, port_voltage):
    """What the port of an end that stands for the line has: its current, or while a contact is open v / Z."""
    j = line_port[k]
    total = history[j]
    row = part_start[5] + port_w[j]
    first = port_first[j]
    for c in range(port_count[j]):
        total += values[row + c] * port_voltage[first + c]
    return total


@kernel
def stands_closed(sig, k, line_select, line_closed):
    """Whether the contact of an end is closed; a position that there is not is the first."""
    position = int(sig[line_select[k]])
    if position < 0 or position >= line_closed.shape[1]:
        position = 0
    return line_closed[k, position] != 0


@inlined
def exchange(sig, links):
    """Between two steps: each part takes over what it reads of the others, `to = plus - minus`."""
    for k in range(links.shape[0]):
        sig[links[k, 0]] = sig[links[k, 1]] - sig[links[k, 2]]
