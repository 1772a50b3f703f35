"""AC side of the active rectifier: the q-axis current reference, per unit, sampled.

    q* = (E* - E) / K_e,   |q*| <= q_max                          (1)
    i_q* = K_p (q* - q) + x,   held between `low` and `high`      (2)
    dx = (K_i (q* - q) + (i_q* - unlimited) / T_t) dt,   T_t = K_p / K_i      (3)

q = v_d i_q is the reactive power *delivered* to the AC bus (currents in the rectifier's sign): with the opposite sign
in (2) the loop runs away. The integrator back-calculates (3), so that it follows a limit that moves.

Source: [DAgostino2020] sec. 3.2 and table A1, the sign from the power balance.
"""

from __future__ import annotations

from shipgrid.model import kernel, signal
from shipgrid.model.ops import clip
from shipgrid.units import PerUnit


class ReactivePowerState:
    """State of the loop."""

    i: PerUnit = signal("integrator", initial=0.0)


@kernel
def reactive_power(v, q, enable, low, high, p, dt, x, x_next):
    """Reference of the q-axis current [pu] for the filtered voltage and reactive power [pu]."""
    e = clip((p.E_ref - v) / p.K_e, -p.q_max, p.q_max) - q  # (1)
    if enable.real < 0.5:
        x_next.i = -p.K_p_q * e
        return 0.0 * e
    wanted = p.K_p_q * e + x.i
    i_q_ref = clip(wanted, low, high)  # (2)
    x_next.i = x.i + p.K_i_q * (e + (i_q_ref - wanted) / p.K_p_q) * dt  # (3)
    return i_q_ref
