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

Where a bus voltage reverses, the diodes of every leg on it conduct, whatever the gates do, each with its resistance
R_d. Both of a leg share its current: with i out of the leg and S = -v_dc / R_d,

    i_lower = (S + i) / 2,   i_upper = (S - i) / 2,   v = v_dc / 2 - R_d i / 2       while |i| <= S       (conduction-7)

and beyond that one of them carries i alone. So a leg is a pole of s = 1/2 (or 0, 1) behind a conductance g = 2 / R_d
(or 1 / R_d), and while both conduct it stands as 1 / (2 R_d) across the bus. In the alpha-beta plane the conductances
of the legs are a matrix Gamma, with d_k the axes of the phases,

    i = -Gamma w,   Gamma = 2/3 (sum g_k d_k d_k' - (sum g_k d_k) (sum g_k d_k)' / sum g_k)               (conduction-8)

for w = v - c v_dc, and (conduction-3) eliminates w with P = 1, G = W + Gamma and t = -h. Every step is tried without
this first, and if the bus ends below zero, taken with it: which of the two holds is asked once.

docs/theory/conduction.md.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import kernel
from shipgrid.model.frames import PHASES, abc_to_alpha_beta
from shipgrid.model.kernel import inlined
from shipgrid.solvers.companion import GAMMA
from shipgrid.solvers.nodal import current as nodal_current

DRIVEN, AT_LO, AT_HI, FLOATING, SHARED = 0, 1, 2, 3, 4
"""States of a leg. On a reversed bus `SHARED` has both diodes conducting, `AT_LO` and `AT_HI` one of them alone."""
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
PULSES = 10
"""Pulses from rest after which a leg with one switch driven counts as in discontinuous conduction, not as starting."""
DEAD_V = 1.0
"""Bus voltage [V] below which a bridge's power is not told from its current: no share of a landing is booked there."""
MEANS = 7
"""Columns of `bridge_mean`; see `release`."""
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
def place_diodes(b, sig, leg_first, leg_state, leg_s, bridge_s, bridge_r, constraint, gamma):
    """The same for a bridge on a reversed bus, whose legs are poles behind conductances: (conduction-8)."""
    first, last = leg_first[b], leg_first[b + 1]
    total = g_a = g_b = g_aa = g_ab = g_bb = 0.0
    for k in range(first, last):
        state = leg_state[k]
        leg_s[k] = 0.0 if state == AT_LO else (1.0 if state == AT_HI else 0.5)
        g = (2.0 if state == SHARED else 1.0) / bridge_r[b]
        axis = AXIS[k - first]
        total += g
        g_a += g * axis[0]
        g_b += g * axis[1]
        g_aa += g * axis[0] * axis[0]
        g_ab += g * axis[0] * axis[1]
        g_bb += g * axis[1] * axis[1]
    if last - first == 1:
        constraint[b, 0] = 1.0
        constraint[b, 1] = 1.0
        constraint[b, 2] = 0.0
        gamma[b, 0] = total
        gamma[b, 1] = gamma[b, 2] = 0.0
        sig[bridge_s[b, 0]] = leg_s[first]
        return
    constraint[b, 0] = 2.0
    gamma[b, 0] = (g_aa - g_a * g_a / total) / 1.5
    gamma[b, 1] = (g_ab - g_a * g_b / total) / 1.5
    gamma[b, 2] = (g_bb - g_b * g_b / total) / 1.5
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
    done,
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
    rested,
):
    """Start a step: bounds from the modulators, states from the last step, currents at the start.

    The bounds of a leg that waits for its gates are narrowed to what its current leaves of them.

    `conduct` holds, of this step: free legs, rounds, what changed in the last round, and the last bridge that did.
    `rested` counts the pulses of a leg with one switch driven that begin from rest (discontinuous conduction).
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
        if last - first == 1:
            if wait < 1.0 and (wait > 0.0 or rested[b, 2] != 0) and np.abs(alpha) <= SMALL_A:  # a pulse, from rest
                rested[b, 0] += 1
                if rested[b, 0] == PULSES:
                    rested[b, 1] = done
            rested[b, 2] = wait == 1.0
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
                if leg_state[k] == DRIVEN or leg_state[k] == SHARED:
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
        for k in range(MEANS):
            bridge_mean[b, k] = 0.0


@kernel
def across(b, leg_first, leg_state, bridge_r):
    """Conductance [S] across a reversed bus of those legs of bridge b of which both diodes conduct."""
    shared = 0
    for k in range(leg_first[b], leg_first[b + 1]):
        if leg_state[k] == SHARED:
            shared += 1
    return 0.5 * shared / bridge_r[b]


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
    leg_first,
    leg_state,
    bridge_port,
    bridge_node,
    bridge_weight,
    bridge_r,
    bridge_clamp,
    related_first,
    related,
    touched_first,
    touched,
    bridge_i0,
    constraint,
    gamma,
    inverse,
    target,
    left,
    right,
    stage_share,
    v_stage,
    clamp,
    Y,
    rhs,
):
    """Eliminate the pole voltages of floating legs, (conduction-3) and (conduction-4), and of reversed buses."""
    n = n_nodes
    width = n + 1
    w0 = part_start[5]
    for b in range(bridge_port.shape[0]):
        if constraint[b, 0] < 0.5:
            continue
        reversed_ = clamp[bridge_clamp[b]] != 0
        if reversed_:
            Y[bridge_node[b] * width + bridge_node[b]] += across(b, leg_first, leg_state, bridge_r)
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
        landing = 0.0 if reversed_ else stage_share[0]
        i_a, i_b = landing * bridge_i0[b, 0], landing * bridge_i0[b, 1]
        if W_aa == 0.0 and W_bb == 0.0:  # an open contact behind the poles: there is no current to constrain
            constraint[b, 0] = -1.0
            continue
        if two:
            G_aa, G_ab, G_ba, G_bb = W_aa, W_ab, W_ba, W_bb
            if reversed_:
                G_aa += gamma[b, 0]
                G_ab += gamma[b, 1]
                G_ba += gamma[b, 1]
                G_bb += gamma[b, 2]
            determinant = G_aa * G_bb - G_ab * G_ba
            small = SINGULAR * (np.abs(G_aa * G_bb) + np.abs(G_ab * G_ba))
            scale = 1.0 / determinant if np.abs(determinant) > small else 0.0
            inverse[b, 0] = G_bb * scale
            inverse[b, 1] = -G_ab * scale
            inverse[b, 2] = -G_ba * scale
            inverse[b, 3] = G_aa * scale
            target[b, 0] = i_a - history[A]
            target[b, 1] = i_b - h_b
        else:
            G = p_a * (p_a * W_aa + p_b * W_ab) + p_b * (p_a * W_ba + p_b * W_bb)
            if reversed_:
                G += gamma[b, 0]
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
        if landing != 0.0 and np.abs(v_dc) > DEAD_V:
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
    coefficient,
    leg_first,
    leg_state,
    bridge_port,
    bridge_node,
    bridge_weight,
    bridge_r,
    touched_first,
    touched,
    constraint,
    inverse,
    target,
    right,
    stage_share,
    bridge_mean,
    bridge_clamp,
    clamp,
):
    """Add what was eliminated to the poles' voltages; means of the step of each bridge.

    `bridge_mean[b]`: constrained part of the pole voltage (alpha, beta), v_dc, power out of the bus, current out of it,
    and of a reversed bus the current through both diodes of its legs and the power lost in the diodes.
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
        if np.abs(v_dc) > DEAD_V and clamp[bridge_clamp[b]] == 0:
            bridge_mean[b, 3] += share * power
            bridge_mean[b, 4] += share * power / v_dc
            continue
        current = 0.0
        for axis in range(1 if A == B else 2):
            j = bridge_port[b, axis]
            i = nodal_current(j, history, values, part_start, port_w, port_first, port_count, port_voltage)
            current += bridge_weight[b] * coefficient[j] * i
        if clamp[bridge_clamp[b]] != 0:
            both = across(b, leg_first, leg_state, bridge_r) * v_dc
            current += both
            bridge_mean[b, 5] -= share * both
            bridge_mean[b, 6] += share * (current * v_dc - power)
            power = current * v_dc
        bridge_mean[b, 3] += share * power
        bridge_mean[b, 4] += share * current


@kernel
def settle_diodes(b, leg_first, leg_state, bridge_r, i_a, i_b, v_dc, one_by_one):
    """Change the state of the legs of bridge b that break (conduction-7) on a reversed bus; how many have.

    Parameters
    ----------
    b : int
    leg_first, leg_state, bridge_r : ndarray
    i_a, i_b : float
        Current out of the poles at the step's end, alpha and beta [A].
    v_dc : float
        Bus voltage there [V].
    one_by_one : bool
        Whether only the first that fails changes.
    """
    both = max(-v_dc / bridge_r[b], 0.0)  # what the two diodes of a leg carry together
    changed = 0
    for k in range(leg_first[b], leg_first[b + 1]):
        axis = AXIS[k - leg_first[b]]
        i = axis[0] * i_a + axis[1] * i_b
        state = leg_state[k]
        wanted = state
        slack = SMALL_A + SMALL * (both + np.abs(i))
        if state == SHARED:
            if i > both + slack:
                wanted = AT_LO
            elif i < -both - slack:
                wanted = AT_HI
        elif (state == AT_LO and i < both - slack) or (state == AT_HI and i > slack - both):
            wanted = SHARED
        if wanted != state:
            leg_state[k] = wanted
            changed += 1
            if one_by_one:
                break
    return changed


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
    bridge_node,
    bridge_r,
    bridge_clamp,
    bridge_s,
    bridge_mean,
    constraint,
    gamma,
    clamp,
    clamp_node,
    conduct,
):
    """After a step: change the state of every leg that breaks (conduction-1); true if the step stands."""
    changed = 0
    any_reversed = False
    for k in range(clamp.shape[0]):
        if clamp[k] != 0:
            any_reversed = True
        elif v[clamp_node[k]] < -SMALL:
            clamp[k] = 1
            changed += 1
            conduct[3] = -1 - k
    if changed > 0:  # their legs have other laws now: the step is taken with those before anything else is asked
        for b in range(bridge_port.shape[0]):
            if clamp[bridge_clamp[b]] != 0:
                for k in range(leg_first[b], leg_first[b + 1]):
                    leg_state[k] = SHARED
                place_diodes(b, sig, leg_first, leg_state, leg_s, bridge_s, bridge_r, constraint, gamma)
        conduct[1] += 1
        conduct[2] = changed
        return conduct[1] >= ROUNDS
    if conduct[0] == 0 and not any_reversed:
        return True
    one_by_one = conduct[1] >= ALL_AT_ONCE
    for b in range(bridge_port.shape[0]):
        first, last = leg_first[b], leg_first[b + 1]
        n_legs = last - first
        turned = clamp[bridge_clamp[b]] != 0
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
        if turned:
            found = settle_diodes(b, leg_first, leg_state, bridge_r, i_a, i_b, v[bridge_node[b]], one_by_one)
            changed += found
            if found > 0:
                conduct[3] = b
                place_diodes(b, sig, leg_first, leg_state, leg_s, bridge_s, bridge_r, constraint, gamma)
            continue
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
def meter_bridges(sig, leg_first, leg_s, bridge_port, bridge_s, bridge_meter, bridge_mean, constraint, conduct):
    """Publish what each bridge did in the step: switching function in force, currents, power."""
    for b in range(bridge_port.shape[0]):
        if conduct[0] > 0 or constraint[b, 0] > 0.5:
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
        sig[m + 5] = bridge_mean[b, 6]


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
