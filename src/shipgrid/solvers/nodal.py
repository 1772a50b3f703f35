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
from shipgrid.solvers.companion import KAPPA


class NetworkPlan(NamedTuple):
    """Everything of the network that stays constant during a run; built by `assembly.assemble`."""

    gh: float
    n_nodes: int
    node_signal: np.ndarray  # (nodes,) where each node's voltage lies in the flat vector
    node_c_gh: np.ndarray  # (nodes,) capacitance / gh
    node_g: np.ndarray  # (nodes,) shunt conductance
    node_limit: np.ndarray  # (nodes,) |v| beyond which the run has diverged
    # linear elements
    n_linear: int
    states: np.ndarray  # (linear + 1,) first state of each in the concatenated state list
    state_signal: np.ndarray  # (states,) place in the flat vector
    inputs: np.ndarray  # (linear + 1,) first input of each; terminals first
    input_signal: np.ndarray  # (inputs,) place in the flat vector
    ports: np.ndarray  # (linear + 1,) first port of each in the list of ports
    matrices: np.ndarray  # M, N, C, D, W of every element and variant, row-major
    matrix_start: np.ndarray  # (linear,)
    matrix_stride: np.ndarray  # (linear,) from one variant to the next
    n_variants: np.ndarray  # (linear,)
    variant_signal: np.ndarray  # (linear,) what selects the variant
    # ports of all elements: linear ones first, then machines' (alpha, beta)
    port_plus: np.ndarray
    port_minus: np.ndarray
    port_c: np.ndarray  # place of the coefficient in the flat vector
    port_v: np.ndarray  # places of voltage and current
    port_i: np.ndarray
    port_w: np.ndarray  # first entry of the port's row of W
    port_first: np.ndarray  # first port of the element the port belongs to
    port_count: np.ndarray  # number of ports of that element
    # scatter lists of (nodal-1)
    term_w: np.ndarray
    term_cj: np.ndarray
    term_ck: np.ndarray
    term_y: np.ndarray
    term_factor: np.ndarray
    inject_port: np.ndarray
    inject_c: np.ndarray
    inject_node: np.ndarray
    inject_factor: np.ndarray
    # elimination pattern
    later: np.ndarray  # (nodes + 1,) first later neighbour of each pivot
    neighbour: np.ndarray
    machine_w: np.ndarray  # (machines,) where each machine's W starts
    machine_port: np.ndarray  # (machines,) its first port


class NetworkWork(NamedTuple):
    """Everything of the network that moves."""

    x_start: np.ndarray  # (states,) at the step's start
    z: np.ndarray  # (states,) M x + N_s u_s of the running stage
    W: np.ndarray
    history: np.ndarray  # (ports,) current that flows at zero voltage
    Y: np.ndarray  # (nodes + 1) x (nodes + 1), row-major; the last row and column stand for the reference
    # after a solve the diagonal holds inverse pivots
    rhs: np.ndarray
    v: np.ndarray
    v_start: np.ndarray  # at the step's start
    v_stage: np.ndarray  # where the stage starts
    norton: np.ndarray  # (machines, 6)


@kernel
def begin_step(sig, state_signal, x_start, n_nodes, v_start, node_signal, v_stage):
    """Remember where the step starts."""
    for k in range(state_signal.shape[0]):
        x_start[k] = sig[state_signal[k]]
    for k in range(n_nodes):
        v_start[k] = sig[node_signal[k]]
        v_stage[k] = v_start[k]


@kernel
def second_stage(sig, state_signal, x_start, n_nodes, v_stage, v_start, v):
    """Start of the second stage: x0 + kappa (x1 - x0), for states and node voltages."""
    for k in range(state_signal.shape[0]):
        j = state_signal[k]
        sig[j] = x_start[k] + KAPPA * (sig[j] - x_start[k])
    for k in range(n_nodes):
        v_stage[k] = v_start[k] + KAPPA * (v[k] - v_start[k])


@kernel
def element_history(
    sig, n_linear, states, inputs, ports, variant_signal, n_variants, matrix_start, matrix_stride, state_signal,
    input_signal, z, history, port_w, W, matrices,
):
    """Norton history of every linear element, (companion-1) and (companion-2)."""
    for e in range(n_linear):
        x0 = states[e]
        n = states[e + 1] - x0
        u0 = inputs[e]
        q = inputs[e + 1] - u0
        k0 = ports[e]
        m = ports[e + 1] - k0
        variant = int(sig[variant_signal[e]])
        if variant < 0 or variant >= n_variants[e]:
            variant = 0
        start_m = matrix_start[e] + variant * matrix_stride[e]
        start_n = start_m + n * n
        start_c = start_n + n * q
        start_d = start_c + m * n
        start_w = start_d + m * q
        for r in range(n):
            total = 0.0
            for c in range(n):
                total += matrices[start_m + r * n + c] * sig[state_signal[x0 + c]]
            for c in range(m, q):
                total += matrices[start_n + r * q + c] * sig[input_signal[u0 + c]]
            z[x0 + r] = total
        for r in range(m):
            total = 0.0
            for c in range(n):
                total += matrices[start_c + r * n + c] * z[x0 + c]
            for c in range(m, q):
                total += matrices[start_d + r * q + c] * sig[input_signal[u0 + c]]
            history[k0 + r] = total
            row = port_w[k0 + r]
            for c in range(m):
                W[row + c] = matrices[start_w + r * m + c]


@kernel
def machine_history(machine_w, W, norton, history, machine_port):
    """Copy the machines' Norton equivalents beside the linear elements'."""
    for k in range(machine_w.shape[0]):
        w = machine_w[k]
        for c in range(4):
            W[w + c] = norton[k, c]
        history[machine_port[k]] = norton[k, 4]
        history[machine_port[k] + 1] = norton[k, 5]


@kernel
def solve(
    sig, n_nodes, node_c_gh, node_g, v_stage, term_w, term_y, term_factor, term_cj, W, term_ck, inject_port,
    inject_node, inject_factor, inject_c, history, later, neighbour, port_plus, port_v, port_c, port_minus, port_w,
    port_first, port_count, port_i, Y, rhs, v,
):
    """Assemble (nodal-1), factorise, solve, and hand each port its voltage and current.

    A node that nothing but open contacts touches has no equation of its own; it goes to zero, and so does one node of
    an island that floats as a whole.
    """
    n = n_nodes
    width = n + 1
    for k in range(width * width):
        Y[k] = 0.0
    for k in range(n):
        Y[k * width + k] = node_c_gh[k] + node_g[k]
        rhs[k] = node_c_gh[k] * v_stage[k]
    for k in range(term_w.shape[0]):
        Y[term_y[k]] += term_factor[k] * sig[term_cj[k]] * W[term_w[k]] * sig[term_ck[k]]
    for k in range(inject_port.shape[0]):
        rhs[inject_node[k]] -= inject_factor[k] * sig[inject_c[k]] * history[inject_port[k]]
    for k in range(n):
        v[k] = Y[k * width + k]  # kept to tell a vanishing pivot from a small one
    for k in range(n):
        pivot = Y[k * width + k]
        if not (np.abs(pivot) > 1e-12 * np.abs(v[k])):
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
        sig[port_v[k]] = sig[port_c[k]] * (v[port_plus[k]] - v[port_minus[k]])
    for k in range(port_plus.shape[0]):
        total = history[k]
        row = port_w[k]
        first = port_first[k]
        for c in range(port_count[k]):
            total += W[row + c] * sig[port_v[first + c]]
        sig[port_i[k]] = total


@kernel
def element_advance(
    sig, n_linear, states, inputs, ports, variant_signal, n_variants, matrix_start, matrix_stride, z, input_signal,
    state_signal, matrices,
):
    """State of every linear element at the stage's end."""
    for e in range(n_linear):
        x0 = states[e]
        n = states[e + 1] - x0
        u0 = inputs[e]
        q = inputs[e + 1] - u0
        m = ports[e + 1] - ports[e]
        variant = int(sig[variant_signal[e]])
        if variant < 0 or variant >= n_variants[e]:
            variant = 0
        start_n = matrix_start[e] + variant * matrix_stride[e] + n * n
        for r in range(n):
            total = z[x0 + r]
            for c in range(m):
                total += matrices[start_n + r * q + c] * sig[input_signal[u0 + c]]
            sig[state_signal[x0 + r]] = total


@kernel
def finish_step(sig, n_nodes, v, node_signal, node_limit):
    """Publish the node voltages; returns the first node whose voltage is absurd or not a number, or -1."""
    bad = -1
    for k in range(n_nodes - 1, -1, -1):
        sig[node_signal[k]] = v[k]
        if not (np.abs(v[k]) < node_limit[k]):
            bad = k
    return bad
