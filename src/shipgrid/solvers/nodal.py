"""State-space nodal step: every element shows a Norton equivalent at its terminals, one solve couples them all.

One stage is an implicit Euler step of length gh from the stage's start: history of each element, assembly of the nodal
equations, factorisation without pivoting over a fixed pattern, back-substitution. Nothing is delayed: a bridge
stands in the matrix as its element's admittance transformed by this step's switching function,

    Y[j, k] += w_j c_j W_jk c_k,     rhs[j] -= w_j c_j h_j           (nodal-1)

with c = 1 for a plain terminal, c = s for a pole and w the 3/2 of the amplitude-invariant transform.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shipgrid.model import kernel
from shipgrid.model.kernel import inlined
from shipgrid.solvers.companion import GAMMA, KAPPA

PATHLESS = 1e-9
"""Share of the largest current into any node below which what is left over at an island's last node is rounding."""


class NetworkPlan(NamedTuple):
    """Everything of the network that stays constant during a run; built by `assembly.assemble`.

    States, inputs and ports of all linear elements are numbered through; machines' ports follow theirs. The matrices of
    (companion-1) and (companion-2) are sparse rows over that numbering; their patterns hold for every position of
    the contacts, their values are those of the positions in force (`NetworkWork`).
    """

    gh: float
    linear_values: np.ndarray  # M, N, sources' N, C, sources' D and W with all contacts closed
    part_start: np.ndarray  # (6,) where each of these parts starts
    n_nodes: int
    node_signal: np.ndarray  # (nodes,) where each node's voltage lies in the flat vector
    node_c_gh: np.ndarray  # (nodes,) capacitance / gh
    node_g: np.ndarray  # (nodes,) shunt conductance
    node_limit: np.ndarray  # (nodes,) |v| beyond which the run has diverged
    state_signal: np.ndarray  # (states,) place in the flat vector
    m_row: np.ndarray  # (states + 1,) rows of M
    m_col: np.ndarray
    n_row: np.ndarray  # (states + 1,) rows of N, the columns of terminals
    n_col: np.ndarray
    b_row: np.ndarray  # rows of N, the columns of sources: (entries,) state, and place of the source in the flat vector
    b_source: np.ndarray
    c_row: np.ndarray  # (linear ports + 1,) rows of C
    c_col: np.ndarray
    d_row: np.ndarray  # entries of D in the columns of sources: port, and place of the source
    d_source: np.ndarray
    # contacts
    element_variant: np.ndarray  # (switched elements,) place of the signal that selects the position
    element_positions: np.ndarray  # (switched elements,) number of positions
    slot_start: np.ndarray  # (switched elements + 1,) which entries of `values` belong to each
    slot: np.ndarray
    position_start: np.ndarray  # (switched elements,) its values, position after position
    position_values: np.ndarray
    # ports of all elements
    n_linear_ports: int
    port_plus: np.ndarray
    port_minus: np.ndarray
    port_c: np.ndarray  # place of the coefficient in the flat vector
    port_v: np.ndarray  # places of voltage and current
    port_i: np.ndarray
    port_w: np.ndarray  # first entry of the port's row of W
    port_first: np.ndarray  # first port of the element the port belongs to
    port_count: np.ndarray  # number of ports of that element
    port_weight: np.ndarray  # 3/2 for one axis of a bridge's poles
    mean_port: np.ndarray  # ports whose voltage and current are published as means of the step, see `assembly/stiff.py`
    mean_node: np.ndarray  # nodes whose voltage is
    # scatter lists of (nodal-1): linear elements' terms first, then machines'
    n_linear_terms: int
    term_w: np.ndarray
    term_j: np.ndarray
    term_k: np.ndarray
    term_y: np.ndarray
    term_factor: np.ndarray
    inject_port: np.ndarray
    inject_node: np.ndarray
    inject_factor: np.ndarray
    # elimination pattern
    later: np.ndarray  # (nodes + 1,) first later neighbour of each pivot
    neighbour: np.ndarray
    used: np.ndarray  # places in the matrix that anything reads or writes; the others stay zero
    machine_w: np.ndarray  # (machines,) where each machine's W starts
    machine_port: np.ndarray  # (machines,) its first port
    # bridges and legs; see `solvers/conduction.py`
    leg_first: np.ndarray  # (bridges + 1,) first leg of each bridge
    leg_lo: np.ndarray  # (legs,) places of the bounds and of the lead that its modulator gives
    leg_hi: np.ndarray
    leg_lead: np.ndarray
    leg_wait: np.ndarray  # places of the share of the step before its first driven part, or of a zero
    leg_sampled: np.ndarray  # places of the share of the step before the sampling instant, of such a leg, or of a zero
    leg_rate: np.ndarray  # of a leg by itself: rate of its current per volt of its pole [A/(V s)], else 0
    bridge_port: np.ndarray  # (bridges, 2) ports of its poles: alpha and beta, or the one twice
    bridge_node: np.ndarray  # (bridges,) its DC node
    bridge_weight: np.ndarray  # (bridges,) 3/2 or 1
    bridge_s: np.ndarray  # (bridges, 2) places of its switching functions
    bridge_meter: np.ndarray  # (bridges,) place of the first of its meters
    related_first: np.ndarray  # (bridges + 1,) ports of the elements at its poles
    related: np.ndarray
    touched_first: np.ndarray  # (bridges + 1,) nodes of those ports
    touched: np.ndarray
    clamp_node: np.ndarray  # (DC buses with bridges,)
    bridge_clamp: np.ndarray  # (bridges,) which of those buses
    bridge_r: np.ndarray  # (bridges,) resistance of each of its diodes while the bus is reversed [ohm]
    lead_state: np.ndarray  # (states that a pole drives directly,) place, bridge, axis, d(dx/dt)/d(pole voltage)
    lead_bridge: np.ndarray
    lead_axis: np.ndarray
    lead_rate: np.ndarray
    # ends of stub lines; see `solvers/stub_lines.py`
    line_in: np.ndarray  # (2, ends) places of the waves that arrive, in each stage, and of those that leave
    line_out: np.ndarray
    line_wave: np.ndarray  # (ends,) place of the wave of the stage under way
    line_port: np.ndarray  # port that stands for the line
    line_select: np.ndarray  # place of the position of its contacts, or of a zero; and of that in the step before
    line_before: np.ndarray
    line_sent: np.ndarray  # place of the wave that left in the first stage of the step before
    line_closed: np.ndarray  # (ends, positions) 1 where the contact is closed
    line_state: np.ndarray  # (ends,) places of the state and of the output that are the current, and their sense
    line_current: np.ndarray
    line_sense: np.ndarray  # (ends, 2)


class NetworkWork(NamedTuple):
    """Everything of the network that moves.

    `values` holds M, N, sources' N, C, sources' D and W of all linear elements, one after the other, then the machines'
    W.
    """

    values: np.ndarray
    position: np.ndarray  # (switched elements,) position of the contacts in force
    x_start: np.ndarray  # (states,) at the step's start
    x_stage: np.ndarray  # where the stage starts
    x: np.ndarray  # at the stage's end
    z: np.ndarray  # M x + N_s u_s of the running stage
    history: np.ndarray  # (ports,) current that flows at zero voltage
    coefficient: np.ndarray  # (ports,) switching function of the step, 1 for a plain terminal
    port_voltage: np.ndarray  # (ports,)
    first_port: np.ndarray  # (2, ports of `mean_port`) voltage and current at the end of the first stage
    first_node: np.ndarray  # (nodes of `mean_node`,)
    Y_linear: np.ndarray
    Y: np.ndarray  # (nodes + 1) x (nodes + 1), row-major; the last row and column stand for the reference
    rhs: np.ndarray  # after a solve the diagonal of Y holds inverse pivots
    v: np.ndarray
    v_start: np.ndarray  # at the step's start
    v_stage: np.ndarray  # where the stage starts
    stranded_first: np.ndarray  # (nodes,) number of the step in which a current first had no path there, 0: in none
    stranded_last: np.ndarray  # (nodes,) and of the last one in which it still had none
    norton: np.ndarray  # (machines, 10) `unit_text.NORTON`
    # bridges and legs
    leg_state: np.ndarray  # (legs,) driven, at its lower or upper bound, floating
    leg_s: np.ndarray  # (legs,) switching function in force
    bridge_i0: np.ndarray  # (bridges, 2) currents of the poles at the step's start
    bridge_mean: np.ndarray  # (bridges, 7) see `conduction.release`
    constraint: np.ndarray  # (bridges, 3) number of constrained directions, and the direction if it is one
    gamma: np.ndarray  # (bridges, 3) Gamma of (conduction-8): aa, ab, bb; of bridges on a reversed bus
    inverse: np.ndarray  # (bridges, 4) G^-1 of (conduction-3)
    target: np.ndarray  # (bridges, 2) t
    left: np.ndarray  # (2, nodes + 1) L
    right: np.ndarray  # (bridges, 2, nodes + 1) R
    clamp: np.ndarray  # (DC buses with bridges,) 1 while their voltage is reversed
    stage_share: np.ndarray  # (2,) see `conduction.begin_round`
    conduct: np.ndarray  # (4,) see `conduction.set_legs`
    rested: np.ndarray  # (bridges, 3) pulses of one switch from rest; step of the tenth; 1 if the last had none
    moved: np.ndarray  # (1,) 1 once a contact has moved, until the books have it


@inlined
def begin_step(
    sig,
    state_signal,
    x_start,
    n_nodes,
    node_signal,
    v_start,
    element_variant,
    element_positions,
    position,
    slot_start,
    slot,
    position_start,
    position_values,
    values,
    moved,
):
    """Where the step starts, and the positions of the contacts."""
    for k in range(state_signal.shape[0]):
        x_start[k] = sig[state_signal[k]]
    for k in range(n_nodes):
        v_start[k] = sig[node_signal[k]]
    for e in range(element_variant.shape[0]):
        wanted = int(sig[element_variant[e]])
        if wanted != position[e]:
            position[e] = wanted
            moved[0] = 1
            first = slot_start[e]
            n = slot_start[e + 1] - first
            if wanted < 0 or wanted >= element_positions[e]:
                wanted = 0
            for k in range(n):
                values[slot[first + k]] = position_values[position_start[e] + wanted * n + k]


@inlined
def linear_admittance(
    sig,
    n_nodes,
    node_c_gh,
    node_g,
    port_c,
    coefficient,
    values,
    part_start,
    used,
    n_linear_terms,
    term_w,
    term_j,
    term_k,
    term_y,
    term_factor,
    Y_linear,
):
    """What both stages share: switching functions and the admittances of the linear elements."""
    for k in range(port_c.shape[0]):
        coefficient[k] = sig[port_c[k]]
    width = n_nodes + 1
    for k in range(used.shape[0]):
        Y_linear[used[k]] = 0.0
    for k in range(n_nodes):
        Y_linear[k * width + k] = node_c_gh[k] + node_g[k]
    w = part_start[5]
    for k in range(n_linear_terms):
        Y_linear[term_y[k]] += term_factor[k] * coefficient[term_j[k]] * values[w + term_w[k]] * coefficient[term_k[k]]


@inlined
def second_stage(
    x_start,
    x_stage,
    x,
    n_nodes,
    v_stage,
    v_start,
    v,
    stage_share,
    mean_port,
    mean_node,
    first_port,
    first_node,
    history,
    values,
    part_start,
    port_w,
    port_first,
    port_count,
    port_voltage,
):
    """Start of the second stage: x0 + kappa (x1 - x0), for states and node voltages."""
    stage_share[0] = 0.0
    stage_share[1] = GAMMA
    for k in range(mean_port.shape[0]):
        j = mean_port[k]
        first_port[0, k] = port_voltage[j]
        first_port[1, k] = current(j, history, values, part_start, port_w, port_first, port_count, port_voltage)
    for k in range(mean_node.shape[0]):
        first_node[k] = v[mean_node[k]]
    for k in range(x_start.shape[0]):
        x_stage[k] = x_start[k] + KAPPA * (x[k] - x_start[k])
    for k in range(n_nodes):
        v_stage[k] = v_start[k] + KAPPA * (v[k] - v_start[k])


@inlined
def element_history(
    sig,
    x_stage,
    z,
    history,
    values,
    part_start,
    m_row,
    m_col,
    b_row,
    b_source,
    c_row,
    c_col,
    d_row,
    d_source,
    n_linear_ports,
):
    """Norton history of every linear element, (companion-1) and (companion-2)."""
    first = part_start[0]
    for k in range(z.shape[0]):
        total = 0.0
        for a in range(m_row[k], m_row[k + 1]):
            total += values[first + a] * x_stage[m_col[a]]
        z[k] = total
    first = part_start[2]
    for a in range(b_row.shape[0]):
        z[b_row[a]] += values[first + a] * sig[b_source[a]]
    first = part_start[3]
    for k in range(n_linear_ports):
        total = 0.0
        for a in range(c_row[k], c_row[k + 1]):
            total += values[first + a] * z[c_col[a]]
        history[k] = total
    first = part_start[4]
    for a in range(d_row.shape[0]):
        history[d_row[a]] += values[first + a] * sig[d_source[a]]


@inlined
def machine_history(machine_w, values, part_start, norton, history, machine_port):
    """Copy the machines' Norton equivalents beside the linear elements'."""
    for k in range(machine_w.shape[0]):
        w = part_start[5] + machine_w[k]
        for c in range(4):
            values[w + c] = norton[k, c]
        history[machine_port[k]] = norton[k, 4]
        history[machine_port[k] + 1] = norton[k, 5]


@inlined
def nodal_equations(
    n_nodes,
    node_c_gh,
    v_stage,
    n_linear_terms,
    term_w,
    term_j,
    term_k,
    term_y,
    term_factor,
    coefficient,
    values,
    part_start,
    used,
    inject_port,
    inject_node,
    inject_factor,
    history,
    Y_linear,
    Y,
    rhs,
):
    """Assemble (nodal-1)."""
    n = n_nodes
    for k in range(used.shape[0]):
        Y[used[k]] = Y_linear[used[k]]
    w = part_start[5]
    for k in range(n_linear_terms, term_w.shape[0]):
        Y[term_y[k]] += term_factor[k] * coefficient[term_j[k]] * values[w + term_w[k]] * coefficient[term_k[k]]
    for k in range(n):
        rhs[k] = node_c_gh[k] * v_stage[k]
    for k in range(inject_port.shape[0]):
        j = inject_port[k]
        rhs[inject_node[k]] -= inject_factor[k] * coefficient[j] * history[j]


@inlined
def current(j, history, values, part_start, port_w, port_first, port_count, port_voltage):
    """Current into the element at port `j`: (companion-2)."""
    total = history[j]
    row = part_start[5] + port_w[j]
    for c in range(port_count[j]):
        total += values[row + c] * port_voltage[port_first[j] + c]
    return total


@kernel
def strand(
    k,
    done,
    n_nodes,
    later,
    neighbour,
    Y,
    left_over,
    inject_port,
    inject_node,
    inject_factor,
    coefficient,
    port_w,
    port_count,
    values,
    part_start,
    history,
    stranded_first,
    stranded_last,
):
    """Whether currents have no path at a pivot that vanishes; of those that no voltage makes, none flows then.

    Parameters
    ----------
    k : int
        The pivot.
    done : int
        Number of the step.
    n_nodes, later, neighbour, Y
        The matrix, eliminated up to there.
    left_over : float
        What elimination has left of the currents into the nodes that it has brought together there [A].
    inject_port, inject_node, inject_factor, coefficient, port_w, port_count, values, part_start
        Where each port's current goes, and its admittances.
    history : ndarray
        Of ports without an admittance, at those nodes, it is put to zero.
    stranded_first, stranded_last : ndarray of int
        Where it is noted.
    """
    largest = 0.0
    for m in range(inject_port.shape[0]):
        j = inject_port[m]
        largest = max(largest, np.abs(inject_factor[m] * coefficient[j] * history[j]))
    if np.abs(left_over) <= PATHLESS * largest:
        return False
    width = n_nodes + 1
    for j in range(k, -1, -1):
        together = j == k
        for a in range(later[j], later[j + 1]):
            c = neighbour[a]
            if c <= k and stranded_last[c] == done and Y[c * width + j] != 0.0:
                together = True
        if together:
            if stranded_last[j] + 1 < done or stranded_first[j] == 0:
                stranded_first[j] = done
            stranded_last[j] = done
    for m in range(inject_port.shape[0]):
        j = inject_port[m]
        if inject_node[m] < n_nodes and stranded_last[inject_node[m]] == done:
            conducts = False
            row = part_start[5] + port_w[j]
            for c in range(port_count[j]):
                if values[row + c] != 0.0:
                    conducts = True
            if not conducts:
                history[j] = 0.0
    return True


@inlined
def solve(
    done,
    sig,
    n_nodes,
    coefficient,
    later,
    neighbour,
    inject_port,
    inject_node,
    inject_factor,
    port_plus,
    port_minus,
    port_v,
    port_w,
    port_count,
    values,
    part_start,
    history,
    n_linear_ports,
    port_voltage,
    Y,
    rhs,
    v,
    stranded_first,
    stranded_last,
):
    """Factorise, solve, and hand each port its voltage.

    A node that nothing but open contacts touches has no equation of its own; it goes to zero, and so does one node of
    an island that floats as a whole. Returns whether every current has a path; those that have none are at zero then,
    and the equations have to be put together again.
    """
    n = n_nodes
    width = n + 1
    for k in range(n):
        v[k] = Y[k * width + k]  # kept to tell a vanishing pivot from a small one
    vanished = False
    for k in range(n):
        pivot = Y[k * width + k]
        if not (np.abs(pivot) > 1e-12 * np.abs(v[k])):
            vanished = True
            pivot = np.inf
        inverse = 1.0 / pivot
        Y[k * width + k] = inverse
        for a in range(later[k], later[k + 1]):
            r = neighbour[a]
            factor = Y[r * width + k] * inverse
            if factor != 0.0:
                for b in range(later[k], later[k + 1]):
                    c = neighbour[b]
                    Y[r * width + c] -= factor * Y[k * width + c]
                rhs[r] -= factor * rhs[k]
    for k in range(n - 1, -1, -1):
        total = rhs[k]
        for a in range(later[k], later[k + 1]):
            c = neighbour[a]
            total -= Y[k * width + c] * v[c]
        v[k] = total * Y[k * width + k]
    v[n] = 0.0
    for k in range(port_plus.shape[0]):
        port_voltage[k] = coefficient[k] * (v[port_plus[k]] - v[port_minus[k]])
    for k in range(n_linear_ports, port_plus.shape[0]):
        sig[port_v[k]] = port_voltage[k]  # machines take theirs from the flat vector
    if not vanished:
        return True
    closed = True
    for k in range(n):
        if Y[k * width + k] == 0.0 and rhs[k] != 0.0 and strand(
            k, done, n_nodes, later, neighbour, Y, rhs[k], inject_port, inject_node, inject_factor, coefficient,
            port_w, port_count, values, part_start, history, stranded_first, stranded_last,
        ):  # fmt: skip
            closed = False
    return closed


@inlined
def element_advance(x, z, values, part_start, n_row, n_col, port_voltage):
    """State of every linear element at the stage's end."""
    first = part_start[1]
    for k in range(x.shape[0]):
        total = z[k]
        for a in range(n_row[k], n_row[k + 1]):
            total += values[first + a] * port_voltage[n_col[a]]
        x[k] = total


@inlined
def publish(
    sig,
    n_nodes,
    v,
    node_signal,
    state_signal,
    x,
    port_voltage,
    port_v,
    port_i,
    port_w,
    port_first,
    port_count,
    history,
    values,
    part_start,
    v_start,
    node_limit,
):
    """Put states, port voltages and currents and node voltages at a stage's end into the flat vector.

    Returns the first node whose voltage is absurd or not a number there and at the step's start, or -1.
    """
    for k in range(state_signal.shape[0]):
        sig[state_signal[k]] = x[k]
    for k in range(port_v.shape[0]):
        sig[port_v[k]] = port_voltage[k]
        sig[port_i[k]] = current(k, history, values, part_start, port_w, port_first, port_count, port_voltage)
    bad = -1
    for k in range(n_nodes - 1, -1, -1):
        sig[node_signal[k]] = v[k]
        if not (np.abs(v[k]) < node_limit[k]) and not (np.abs(v_start[k]) < node_limit[k]):
            bad = k
    return bad


@inlined
def finish_step(
    sig,
    n_nodes,
    v,
    v_start,
    node_signal,
    node_limit,
    state_signal,
    x,
    port_voltage,
    port_v,
    port_i,
    port_w,
    port_first,
    port_count,
    history,
    values,
    part_start,
    mean_port,
    mean_node,
    first_port,
    first_node,
    x_start,
    x_stage,
    v_stage,
    stiff_node,
    stiff_node_s,
    stiff_state,
    stiff_state_s,
    energy,
):
    """Publish the end of the step, or means of the step where those are wanted; book what charging lost within it.

    Of a stored energy s x^2 the rule takes in s h^2 gamma^2 (k_2^2 - k_1^2) more than it stores, with k_1 and k_2 the
    rates of its stages. Where the step resolves how x moves, this is an error of the rule, of second order and nearly
    the same in every step. Where x follows within the step it is what the charging current loses on its way in
    resistances and the stages do not see (`assembly/stiff.py`, docs/theory/network.md).

    Returns the first node whose voltage is absurd or not a number at both ends of the step, or -1: an inductance that a
    contact interrupts gives an impulse of one step, which is no divergence.
    """
    for k in range(stiff_node_s.shape[0]):
        j = stiff_node[0, k]
        first, second = (v_stage[j] - v_start[j]) / KAPPA, v[j] - v_stage[j]
        energy[stiff_node[1, k]] += stiff_node_s[k] * (second * second - first * first)
    for k in range(stiff_state_s.shape[0]):
        j = stiff_state[0, k]
        first, second = (x_stage[j] - x_start[j]) / KAPPA, x[j] - x_stage[j]
        energy[stiff_state[1, k]] += stiff_state_s[k] * (second * second - first * first)
    bad = publish(
        sig,
        n_nodes,
        v,
        node_signal,
        state_signal,
        x,
        port_voltage,
        port_v,
        port_i,
        port_w,
        port_first,
        port_count,
        history,
        values,
        part_start,
        v_start,
        node_limit,
    )
    for k in range(mean_port.shape[0]):
        j = mean_port[k]
        sig[port_v[j]] += (1.0 - GAMMA) * (first_port[0, k] - sig[port_v[j]])
        sig[port_i[j]] += (1.0 - GAMMA) * (first_port[1, k] - sig[port_i[j]])
    for k in range(mean_node.shape[0]):
        place = node_signal[mean_node[k]]
        sig[place] += (1.0 - GAMMA) * (first_node[k] - sig[place])
    return bad
