"""Which switch or diode of each leg conducts: found with the solve of the network.

A modulator gives every leg bounds lo <= s <= hi of its mean switching function over the step; a driven leg has lo = hi.
Between them the leg's current i, counted out of the leg, decides:

    s = lo and i >= 0,   or   s = hi and i <= 0,   or   lo <= s <= hi and i = 0           (conduction-1)

The state of every leg (at lo, at hi, floating) holds for a whole step. The step is taken, each leg's condition is
looked at, those that fail change state, and the step is taken again.

A floating leg's current has to be what it was at the step's start, falling linearly to zero at the step's end:

    n.i = (1 - gamma) n.i_0  at the first stage,   n.i = 0  at the second                 (conduction-2)

which is what a constant leg voltage would give, so that a current that crosses zero inside the step lands on zero by
the volt-seconds it takes. `n` is the leg's axis in the alpha-beta plane; with two legs floating there is no
current at all, and both axes are constrained. The unknown is the pole voltage v = c v_dc + P w, P the constrained
directions; it is eliminated (Schur complement) from the elements' admittances before the nodal equations are solved:

    w = G^-1 (t - R v),   G = P' W P,   R = P' W c,   t = n.i - P' h                      (conduction-3)
    Y -= L G^-1 R,   rhs -= L G^-1 t,   L = c W P + P' n.i / v_dc                         (conduction-4)

The last term of L is the bus's share in the power w n.i of a current that is being landed.

A leg of which one switch is driven (boost, buck) may wait for it: nothing is driven in the first part of a step, `wait`
of its length. What the leg takes of the bus in that part is what lands its current there and then keeps it at zero,

    x = wait s_0 - i_0 / (r h v_dc),    0 <= x <= wait,       s_0 = s' - (i_0 - i_0') / (r h v_dc)      (conduction-5)

with r the rate of its current per volt and s_0 the switching function at which it stands still, taken from the step
before ('). The rest of the step has the bounds lo + x and hi - wait + x.

Where a bus voltage reverses, both diodes of every leg on it conduct: a conductance across the bus. Every step is tried
without it first, and if the bus ends below zero, taken with it: which of the two holds is asked once.

docs/theory/conduction.md.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import kernel
from shipgrid.model.frames import PHASES, abc_to_alpha_beta
from shipgrid.model.kernel import inlined
from shipgrid.solvers.companion import GAMMA

DRIVEN, AT_LO, AT_HI, FLOATING = 0, 1, 2, 3
ALL_AT_ONCE = 8
"""Rounds in which all legs that fail change state; afterwards only the first one that fails, so that none cycle."""
ROUNDS = 48
"""Most rounds of a step. A step that is not settled then stops the run."""
SMALL_A = 1e-9
"""Current [A] that counts as none: far above rounding, far below anything that acts."""
SMALL = 1e-9
"""Share of the voltages by which a floating leg may pass its bounds."""
SINGULAR = 1e-12
"""Share of an element's own admittances below which nothing conducts along a direction: an open contact, rounding."""
DEAD_V = 1.0
"""Bus voltage [V] below which a bridge's power is not told from its current: no share of a landing is booked there."""
AXIS = tuple(PHASES.values())
"""Axes of the phases a, b, c in the alpha-beta plane."""


@kernel
def place_legs(b, sig, leg_first, leg_lo, leg_hi, leg_state, leg_s, bridge_s, constraint):
    """Put the states of bridge b's legs into its switching functions and its constraint.

    `constraint[b]`: number of constrained directions (-1: nothing conducts behind the poles), the direction if one.
    """
    first, last = leg_first[b], leg_first[b + 1]
    floating = 0
    for k in range(first, last):
        state = leg_state[k]
        if state == FLOATING:
            floating += 1
            leg_s[k] = 0.5 * (sig[leg_lo[k]] + sig[leg_hi[k]])
        elif state == AT_HI:
            leg_s[k] = sig[leg_hi[k]]
        else:
            leg_s[k] = sig[leg_lo[k]]
    if last - first == 1:
        constraint[b, 0] = floating
        constraint[b, 1] = 1.0
        constraint[b, 2] = 0.0
        sig[bridge_s[b, 0]] = leg_s[first]
        return
    if floating >= 2:
        floating = 2
        for k in range(first, last):
            if leg_state[k] != DRIVEN:
                leg_state[k] = FLOATING
                leg_s[k] = 0.5 * (sig[leg_lo[k]] + sig[leg_hi[k]])
    elif floating == 1:
        for k in range(3):
            if leg_state[first + k] == FLOATING:
                constraint[b, 1] = AXIS[k][0]
                constraint[b, 2] = AXIS[k][1]
    constraint[b, 0] = floating
    alpha, beta = abc_to_alpha_beta(leg_s[first], leg_s[first + 1], leg_s[first + 2])
    sig[bridge_s[b, 0]] = alpha
    sig[bridge_s[b, 1]] = beta


@kernel
def stands_still(per_ampere, s, i, i_next):
    """Switching function at which a leg's current would have stood still in a step: s_0 of (conduction-5).

    Parameters
    ----------
    per_ampere : float
        Switching function that moves the current by 1 A in a step, 1/(r h v_dc) [1/A].
    s : float
        Mean switching function of the step.
    i, i_next : float
        Current [A] at its start and at its end.
    """
    return s - (i_next - i) * per_ampere


@kernel
def wait_for_gates(share, at_rest, per_ampere, i):
    """Volt-seconds, over h v_dc, that a leg takes by itself in the first `share` of a step: x of (conduction-5).

    Parameters
    ----------
    share : float
        Part of the step in which nothing is driven.
    at_rest, per_ampere : float
        As for `stands_still`, and what it gives.
    i : float
        Current [A] at the step's start.
    """
    return min(max(share * at_rest - i * per_ampere, 0.0), share)


@inlined
def set_legs(
    sig,
    h,
    node_signal,
    leg_first,
    leg_lo,
    leg_hi,
    leg_wait,
    leg_rate,
    leg_state,
    leg_s,
    bridge_port,
    bridge_node,
    port_i,
    bridge_i0,
    bridge_s,
    constraint,
    clamp,
    conduct,
):
    """Start a step: bounds from the modulators, states from the last step, currents at the start.

    The bounds of a leg that waits for its gates are narrowed to what its current leaves of them.

    `conduct` holds, of this step: free legs, rounds, what changed in the last round, and the last bridge that did.
    """
    for k in range(clamp.shape[0]):
        clamp[k] = 0
    free = 0
    for b in range(bridge_port.shape[0]):
        first, last = leg_first[b], leg_first[b + 1]
        alpha = sig[port_i[bridge_port[b, 0]]]
        beta = sig[port_i[bridge_port[b, 1]]] if last - first > 1 else 0.0
        wait = sig[leg_wait[first]]
        v_dc = sig[node_signal[bridge_node[b]]]
        if 0.0 < wait < 1.0 and leg_rate[first] > 0.0 and v_dc > DEAD_V and np.isfinite(bridge_i0[b, 0]):
            per_ampere = 1.0 / (leg_rate[first] * h * v_dc)
            taken = wait_for_gates(
                wait, stands_still(per_ampere, leg_s[first], bridge_i0[b, 0], alpha), per_ampere, alpha
            )
            sig[leg_lo[first]] += taken
            sig[leg_hi[first]] += taken - wait
            if sig[leg_hi[first]] - sig[leg_lo[first]] < SMALL:  # driven to the end
                sig[leg_hi[first]] = sig[leg_lo[first]]
        bridge_i0[b, 0] = alpha
        bridge_i0[b, 1] = beta
        for k in range(first, last):
            if sig[leg_lo[k]] == sig[leg_hi[k]]:
                leg_state[k] = DRIVEN
            else:
                free += 1
                if leg_state[k] == DRIVEN:
                    axis = AXIS[k - first]
                    i = axis[0] * alpha + axis[1] * beta
                    leg_state[k] = AT_LO if i > SMALL_A else (AT_HI if i < -SMALL_A else FLOATING)
        place_legs(b, sig, leg_first, leg_lo, leg_hi, leg_state, leg_s, bridge_s, constraint)
    conduct[0] = free
    conduct[1] = 0


@inlined
def begin_round(
    state_signal,
    x_start,
    x_stage,
    n_nodes,
    v_start,
    v_stage,
    stage_share,
    bridge_mean,
):
    """Take the step (again) from its start."""
    for k in range(state_signal.shape[0]):
        x_stage[k] = x_start[k]
    for k in range(n_nodes):
        v_stage[k] = v_start[k]
    stage_share[0] = 1.0 - GAMMA  # of the current at the step's start that is left at the stage's end
    stage_share[1] = 1.0 - GAMMA  # weight of the stage in means of the step
    for b in range(bridge_mean.shape[0]):
        for k in range(6):
            bridge_mean[b, k] = 0.0


@inlined
def constrain(
    n_nodes,
    values,
    part_start,
    port_plus,
    port_minus,
    port_w,
    port_first,
    port_weight,
    coefficient,
    history,
    bridge_port,
    bridge_node,
    bridge_weight,
    related_first,
    related,
    touched_first,
    touched,
    bridge_i0,
    constraint,
    inverse,
    target,
    left,
    right,
    stage_share,
    v_stage,
    clamp,
    clamp_node,
    clamp_g,
    Y,
    rhs,
):
    """Eliminate the pole voltages of floating legs, (conduction-3) and (conduction-4), and stamp reversed buses."""
    n = n_nodes
    width = n + 1
    w0 = part_start[5]
    for k in range(clamp.shape[0]):
        if clamp[k] != 0:
            Y[clamp_node[k] * width + clamp_node[k]] += clamp_g[k]
    for b in range(bridge_port.shape[0]):
        if constraint[b, 0] < 0.5:
            continue
        A, B = bridge_port[b, 0], bridge_port[b, 1]
        two = constraint[b, 0] > 1.5
        p_a, p_b = (1.0, 0.0) if two else (constraint[b, 1], constraint[b, 2])
        W_aa = values[w0 + port_w[A] + A - port_first[A]]
        W_ab = W_ba = W_bb = 0.0
        h_b = 0.0
        if B != A:
            W_bb = values[w0 + port_w[B] + B - port_first[B]]
            h_b = history[B]
            if port_first[A] == port_first[B]:
                W_ab = values[w0 + port_w[A] + B - port_first[B]]
                W_ba = values[w0 + port_w[B] + A - port_first[A]]
        i_a, i_b = stage_share[0] * bridge_i0[b, 0], stage_share[0] * bridge_i0[b, 1]
        if W_aa == 0.0 and W_bb == 0.0:  # an open contact behind the poles: there is no current to constrain
            constraint[b, 0] = -1.0
            continue
        if two:
            determinant = W_aa * W_bb - W_ab * W_ba
            small = SINGULAR * (np.abs(W_aa * W_bb) + np.abs(W_ab * W_ba))
            scale = 1.0 / determinant if np.abs(determinant) > small else 0.0
            inverse[b, 0] = W_bb * scale
            inverse[b, 1] = -W_ab * scale
            inverse[b, 2] = -W_ba * scale
            inverse[b, 3] = W_aa * scale
            target[b, 0] = i_a - history[A]
            target[b, 1] = i_b - h_b
        else:
            G = p_a * (p_a * W_aa + p_b * W_ab) + p_b * (p_a * W_ba + p_b * W_bb)
            small = SINGULAR * (np.abs(W_aa) + np.abs(W_ab) + np.abs(W_ba) + np.abs(W_bb))
            inverse[b, 0] = 1.0 / G if np.abs(G) > small else 0.0
            inverse[b, 1] = inverse[b, 2] = inverse[b, 3] = 0.0
            target[b, 0] = p_a * (i_a - history[A]) + p_b * (i_b - h_b)
            target[b, 1] = 0.0
            i_a, i_b = p_a * i_a + p_b * i_b, 0.0
        for m in range(touched_first[b], touched_first[b + 1]):
            for d in range(2):
                left[d, touched[m]] = 0.0
                right[b, d, touched[m]] = 0.0
        for m in range(related_first[b], related_first[b + 1]):
            j = related[m]
            ja = jb = aj = bj = 0.0
            if port_first[j] == port_first[A]:
                ja = values[w0 + port_w[j] + A - port_first[A]]
                aj = values[w0 + port_w[A] + j - port_first[A]]
            if B != A and port_first[j] == port_first[B]:
                jb = values[w0 + port_w[j] + B - port_first[B]]
                bj = values[w0 + port_w[B] + j - port_first[B]]
            c = coefficient[j]
            column = c * port_weight[j] * (p_a * ja + p_b * jb)
            row = c * (p_a * aj + p_b * bj)
            plus, minus = port_plus[j], port_minus[j]
            left[0, plus] += column
            left[0, minus] -= column
            right[b, 0, plus] += row
            right[b, 0, minus] -= row
            if two:
                left[1, plus] += c * port_weight[j] * jb
                left[1, minus] -= c * port_weight[j] * jb
                right[b, 1, plus] += c * bj
                right[b, 1, minus] -= c * bj
        dc = bridge_node[b]
        v_dc = v_stage[dc]
        if stage_share[0] != 0.0 and np.abs(v_dc) > DEAD_V:
            left[0, dc] += bridge_weight[b] * i_a / v_dc
            left[1, dc] += bridge_weight[b] * i_b / v_dc
        for m in range(touched_first[b], touched_first[b + 1]):
            r = touched[m]
            if r == n:
                continue
            l_0 = left[0, r] * inverse[b, 0] + left[1, r] * inverse[b, 2]
            l_1 = left[0, r] * inverse[b, 1] + left[1, r] * inverse[b, 3]
            rhs[r] -= l_0 * target[b, 0] + l_1 * target[b, 1]
            for o in range(touched_first[b], touched_first[b + 1]):
                c_ = touched[o]
                if c_ < n:
                    Y[r * width + c_] -= l_0 * right[b, 0, c_] + l_1 * right[b, 1, c_]


@inlined
def release(
    sig,
    v,
    values,
    part_start,
    port_v,
    port_w,
    port_first,
    port_count,
    port_voltage,
    history,
    n_linear_ports,
    bridge_port,
    bridge_node,
    bridge_weight,
    touched_first,
    touched,
    constraint,
    inverse,
    target,
    right,
    stage_share,
    bridge_mean,
    bridge_clamp,
    bridge_g,
    clamp,
):
    """Add what was eliminated to the poles' voltages; means of the step of each bridge.

    `bridge_mean[b]`: constrained part of the pole voltage (alpha, beta), v_dc, power out of the bus, current out of it,
    current up through the diodes of a reversed bus.
    """
    share = stage_share[1]
    for b in range(bridge_port.shape[0]):
        A, B = bridge_port[b, 0], bridge_port[b, 1]
        if constraint[b, 0] > 0.5:
            t_0, t_1 = target[b, 0], target[b, 1]
            for m in range(touched_first[b], touched_first[b + 1]):
                node = touched[m]
                t_0 -= right[b, 0, node] * v[node]
                t_1 -= right[b, 1, node] * v[node]
            w_0 = inverse[b, 0] * t_0 + inverse[b, 1] * t_1
            w_1 = inverse[b, 2] * t_0 + inverse[b, 3] * t_1
            if constraint[b, 0] < 1.5:
                w_0, w_1 = constraint[b, 1] * w_0, constraint[b, 2] * w_0
            port_voltage[A] += w_0
            bridge_mean[b, 0] += share * w_0
            if B != A:
                port_voltage[B] += w_1
                bridge_mean[b, 1] += share * w_1
            if n_linear_ports <= A:  # a machine takes its voltages from the flat vector
                sig[port_v[A]] = port_voltage[A]
                sig[port_v[B]] = port_voltage[B]
        power = 0.0
        for axis in range(1 if A == B else 2):
            j = bridge_port[b, axis]
            i = history[j]
            row = part_start[5] + port_w[j]
            for c in range(port_count[j]):
                i += values[row + c] * port_voltage[port_first[j] + c]
            power += port_voltage[j] * i
        v_dc = v[bridge_node[b]]
        power *= bridge_weight[b]
        bridge_mean[b, 2] += share * v_dc
        bridge_mean[b, 3] += share * power
        if np.abs(v_dc) > DEAD_V:
            bridge_mean[b, 4] += share * power / v_dc
        if clamp[bridge_clamp[b]] != 0:
            bridge_mean[b, 3] += share * bridge_g[b] * v_dc * v_dc
            bridge_mean[b, 4] += share * bridge_g[b] * v_dc
            bridge_mean[b, 5] -= share * bridge_g[b] * v_dc


@inlined
def settle_legs(
    sig,
    v,
    values,
    part_start,
    port_w,
    port_first,
    port_count,
    port_voltage,
    history,
    coefficient,
    leg_first,
    leg_lo,
    leg_hi,
    leg_state,
    leg_s,
    bridge_port,
    bridge_s,
    bridge_mean,
    constraint,
    clamp,
    clamp_node,
    conduct,
):
    """After a step: change the state of every leg that breaks (conduction-1); true if the step stands."""
    changed = 0
    for k in range(clamp.shape[0]):
        if clamp[k] == 0 and v[clamp_node[k]] < -SMALL:
            clamp[k] = 1
            changed += 1
            conduct[3] = -1 - k
    if conduct[0] == 0 and changed == 0:
        return True
    one_by_one = conduct[1] >= ALL_AT_ONCE
    for b in range(bridge_port.shape[0]):
        first, last = leg_first[b], leg_first[b + 1]
        n_legs = last - first
        any_free = False
        for k in range(first, last):
            if leg_state[k] != DRIVEN:
                any_free = True
        if not any_free or (one_by_one and changed > 0):
            continue
        A, B = bridge_port[b, 0], bridge_port[b, 1]
        row = part_start[5] + port_w[A]
        i_a, i_b = history[A], 0.0
        for c in range(port_count[A]):
            i_a += values[row + c] * port_voltage[port_first[A] + c]
        if B != A:
            i_b = history[B]
            row = part_start[5] + port_w[B]
            for c in range(port_count[B]):
                i_b += values[row + c] * port_voltage[port_first[B] + c]
        v_dc = bridge_mean[b, 2]
        pole_a = coefficient[A] * v_dc + bridge_mean[b, 0]
        pole_b = (coefficient[B] * v_dc + bridge_mean[b, 1]) if B != A else 0.0
        v_dc = max(v_dc, 0.0)
        tolerance = SMALL * (v_dc + np.abs(pole_a) + np.abs(pole_b)) + SMALL
        before = changed
        # the negative rail's potential against the star point: from a leg that conducts, or from what all allow
        rail, reference = 0.0, -1
        if n_legs == 3:
            for k in range(3):
                if leg_state[first + k] != FLOATING:
                    reference = k
            if reference >= 0:
                axis = AXIS[reference]
                rail = leg_s[first + reference] * v_dc - (axis[0] * pole_a + axis[1] * pole_b)
            else:
                low, high, lowest, highest = -np.inf, np.inf, 0, 0
                for k in range(3):
                    phase = AXIS[k][0] * pole_a + AXIS[k][1] * pole_b
                    if sig[leg_lo[first + k]] * v_dc - phase > low:
                        low, lowest = sig[leg_lo[first + k]] * v_dc - phase, k
                    if sig[leg_hi[first + k]] * v_dc - phase < high:
                        high, highest = sig[leg_hi[first + k]] * v_dc - phase, k
                rail = 0.5 * (low + high)
                if low > high + tolerance:  # the bus is below the line voltage: two diodes conduct
                    leg_state[first + lowest] = AT_LO
                    leg_state[first + highest] = AT_HI
                    changed += 1
        if changed == before:
            for k in range(n_legs):
                leg = first + k
                state = leg_state[leg]
                if state == DRIVEN or (one_by_one and changed > before):
                    continue
                axis = AXIS[k]
                lo, hi = sig[leg_lo[leg]], sig[leg_hi[leg]]
                wanted = state
                if state == FLOATING:
                    potential = axis[0] * pole_a + axis[1] * pole_b + rail
                    if potential > hi * v_dc + tolerance:
                        wanted = AT_HI
                    elif potential < lo * v_dc - tolerance:
                        wanted = AT_LO
                    elif v_dc > DEAD_V:
                        leg_s[leg] = potential / v_dc
                else:
                    i = axis[0] * i_a + axis[1] * i_b
                    if (state == AT_LO and i < -SMALL_A) or (state == AT_HI and i > SMALL_A):
                        wanted = FLOATING
                if wanted != state:
                    leg_state[leg] = wanted
                    changed += 1
        if changed > before:
            conduct[3] = b
            place_legs(b, sig, leg_first, leg_lo, leg_hi, leg_state, leg_s, bridge_s, constraint)
    conduct[1] += 1
    conduct[2] = changed
    return changed == 0 or conduct[1] >= ROUNDS


@inlined
def unsettled(conduct):
    """Whether the legs of the last step found no state that stands."""
    return conduct[1] >= ROUNDS and conduct[2] > 0


@inlined
def meter_bridges(sig, leg_first, leg_s, bridge_port, bridge_s, bridge_meter, bridge_mean, conduct):
    """Publish what each bridge did in the step: switching function in force, currents, power."""
    for b in range(bridge_port.shape[0]):
        if conduct[0] > 0:
            first = leg_first[b]
            if bridge_port[b, 0] == bridge_port[b, 1]:
                sig[bridge_s[b, 0]] = leg_s[first]
            else:
                alpha, beta = abc_to_alpha_beta(leg_s[first], leg_s[first + 1], leg_s[first + 2])
                sig[bridge_s[b, 0]] = alpha
                sig[bridge_s[b, 1]] = beta
        m = bridge_meter[b]
        sig[m] = bridge_mean[b, 4]
        sig[m + 1] = bridge_mean[b, 3]
        sig[m + 2] = -bridge_mean[b, 4]
        sig[m + 3] = -bridge_mean[b, 3]
        sig[m + 4] = bridge_mean[b, 5]


@inlined
def lead_samples(
    sig,
    h,
    node_signal,
    lead_state,
    lead_bridge,
    lead_axis,
    lead_rate,
    leg_first,
    leg_lead,
    leg_wait,
    leg_sampled,
    leg_rate,
    leg_s,
    bridge_i0,
    bridge_port,
    bridge_node,
    port_i,
    lead,
):
    """What the currents sampled inside the step lie beside their chord, since the poles' voltages are not constant.

    Of a leg with one switch driven the modulator has the part from its first pulse on: what the leg has taken by itself
    before, and the mean over the step, are the solution's.
    """
    for k in range(lead_state.shape[0]):
        b = lead_bridge[k]
        first = leg_first[b]
        if leg_first[b + 1] - first == 1:
            ahead, sampled = sig[leg_lead[first]], sig[leg_sampled[first]]
            v_dc = sig[node_signal[bridge_node[b]]]
            if sampled > 0.0 and v_dc > DEAD_V and leg_rate[first] > 0.0:
                i, per_ampere = bridge_i0[b, 0], 1.0 / (leg_rate[first] * h * v_dc)
                at_rest = stands_still(per_ampere, leg_s[first], i, sig[port_i[bridge_port[b, 0]]])
                alone = wait_for_gates(min(sig[leg_wait[first]], sampled), at_rest, per_ampere, i)
                ahead += alone - sampled * leg_s[first]
        else:
            alpha, beta = abc_to_alpha_beta(sig[leg_lead[first]], sig[leg_lead[first + 1]], sig[leg_lead[first + 2]])
            ahead = alpha if lead_axis[k] == 0 else beta
        lead[lead_state[k]] = h * lead_rate[k] * ahead * sig[node_signal[bridge_node[b]]]
