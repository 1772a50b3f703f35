"""Three-phase breaker whose poles open one after another, each at the zero of its own current.

    closed:          i = v / R_on                                 (1)
    pole k open:     i = (1 - d_k d_k^T) v / R_on                 (2)
    two poles open:  i = 0                                        (3)

d_k is the direction of phase k in the alpha-beta plane. Told to open, a pole carries on until its current changes its
sign; with three wires the other two then carry one current, and clear together a quarter of a period later. Told to
close, all poles close at once. The zero is found at the end of the step in which it lies: what is interrupted is
at most the change of the current in one step, and a current that never passes through zero is not interrupted.

The conductance couples the axes and changes with the poles, so that it is stamped anew in each step, like a machine.
`a` and `b` are its ends; `close` is an input: an event may set it, or a signal move it.
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.model.frames import SQRT3_2, alpha_beta_to_abc
from shipgrid.units import Ampere, Ohm, Ratio, Volt


class State:
    """State of the breaker."""

    begun: Ratio = signal("1 once a step has been made; before it the poles stand as the command says")
    open_a: Ratio = signal("1 while pole a is open")
    open_b: Ratio = signal("1 while pole b is open")
    open_c: Ratio = signal("1 while pole c is open")
    i_a: Ampere = signal("current of pole a at the end of the last step")
    i_b: Ampere = signal("current of pole b at the end of the last step")
    i_c: Ampere = signal("current of pole c at the end of the last step")


class Input:
    """Input of the breaker."""

    v_alpha: Volt = signal("voltage across the breaker, alpha axis")
    v_beta: Volt = signal("voltage across the breaker, beta axis")
    close: Ratio = signal("command: 1 closed, 0 open", initial=1.0)


class Output:
    """Output of the breaker."""

    i_alpha_in: Ampere = signal("current from the first bus to the second, alpha axis")
    i_beta_in: Ampere = signal("current from the first bus to the second, beta axis")


@kernel
def conductance(x, u, p):
    """Conductances aa, ab and bb of the poles as they stand: (1), (2), (3)."""
    a, b, c = x.open_a.real > 0.5, x.open_b.real > 0.5, x.open_c.real > 0.5
    if x.begun.real < 0.5:
        a = b = c = u.close.real < 0.5
    n = (1 if a else 0) + (1 if b else 0) + (1 if c else 0)
    g = 1.0 / p.R_on if n < 2 else 0.0 / p.R_on
    if n == 0:
        return g, 0.0 * g, g
    d_alpha = 1.0 if a else -0.5
    d_beta = 0.0 if a else (SQRT3_2 if b else -SQRT3_2)
    return g * (1.0 - d_alpha**2), -g * d_alpha * d_beta, g * (1.0 - d_beta**2)


@kernel
def derivatives(t, x: State, u: Input, p: ThreePoleBreaker, dx: State):
    dx.begun = 0.0 * x.begun
    dx.open_a = 0.0 * x.open_a
    dx.open_b = 0.0 * x.open_b
    dx.open_c = 0.0 * x.open_c
    dx.i_a = 0.0 * x.i_a
    dx.i_b = 0.0 * x.i_b
    dx.i_c = 0.0 * x.i_c


@kernel
def outputs(t, x: State, u: Input, p: ThreePoleBreaker, y: Output):
    g_aa, g_ab, g_bb = conductance(x, u, p)
    y.i_alpha_in = g_aa * u.v_alpha + g_ab * u.v_beta
    y.i_beta_in = g_ab * u.v_alpha + g_bb * u.v_beta


@kernel
def stamp(gh, x: State, u: Input, p: ThreePoleBreaker, n):
    g_aa, g_ab, g_bb = conductance(x, u, p)
    n.g_aa = g_aa
    n.g_ab = g_ab
    n.g_ba = g_ab
    n.g_bb = g_bb
    n.h_a = 0.0
    n.h_b = 0.0


@kernel
def advance(gh, x: State, u: Input, p: ThreePoleBreaker, x_next: State):
    x_next.begun = x.begun
    x_next.open_a = x.open_a
    x_next.open_b = x.open_b
    x_next.open_c = x.open_c
    x_next.i_a = x.i_a
    x_next.i_b = x.i_b
    x_next.i_c = x.i_c


@kernel
def clears(already, before, now):
    """1.0 for a pole that is open, or whose current has passed through zero."""
    return 1.0 if already.real > 0.5 or before.real * now.real <= 0.0 else 0.0


@kernel
def limit(x: State, u: Input, p: ThreePoleBreaker):
    g_aa, g_ab, g_bb = conductance(x, u, p)
    i_alpha = g_aa * u.v_alpha + g_ab * u.v_beta
    i_beta = g_ab * u.v_alpha + g_bb * u.v_beta
    i_a, i_b, i_c = alpha_beta_to_abc(i_alpha, i_beta)
    if u.close.real > 0.5:
        x.open_a = 0.0
        x.open_b = 0.0
        x.open_c = 0.0
    else:
        x.open_a = clears(x.open_a, x.i_a, i_a)
        x.open_b = clears(x.open_b, x.i_b, i_b)
        x.open_c = clears(x.open_c, x.i_c, i_c)
        if x.open_a.real + x.open_b.real + x.open_c.real > 1.5:  # one pole alone carries nothing
            x.open_a = 1.0
            x.open_b = 1.0
            x.open_c = 1.0
    x.i_a = i_a
    x.i_b = i_b
    x.i_c = i_c
    x.begun = 1.0


@kernel
def losses(x: State, u: Input, p: ThreePoleBreaker):
    g_aa, g_ab, g_bb = conductance(x, u, p)
    i_alpha = g_aa * u.v_alpha + g_ab * u.v_beta
    i_beta = g_ab * u.v_alpha + g_bb * u.v_beta
    return 1.5 * p.R_on * (i_alpha**2 + i_beta**2)


@component(
    state=State,
    input=Input,
    output=Output,
    derivatives=derivatives,
    outputs=outputs,
    stamp=stamp,
    advance=advance,
    limit=limit,
    losses=losses,
    terminals=(Terminal("alpha", v="v_alpha", i="i_alpha_in"), Terminal("beta", v="v_beta", i="i_beta_in")),
    passive=True,
)
class ThreePoleBreaker:
    """Three-phase breaker between two AC buses that interrupts each pole at the zero of its current."""

    R_on: Ohm = param(
        "resistance of a closed contact",
        default=1e-4,
        at_least=1e-6,
        source="typical; less drowns the current in the rounding of the voltages beside it",
    )
