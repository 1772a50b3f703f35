"""Current control of a converter behind a choke, dq frame on the voltage vector, per unit, sampled.

    u = K_p (i_ref - i) + x,   dx = K_i (i_ref - i) dt            (1)
    v_d = v_gd - u_d + X i_q,   v_q = v_gq - u_q - X i_d          (2)
    |v| <= v_max, the angle kept                                  (3)

Currents in the rectifier's sign (positive from the grid into the converter). `v_g` is the measured, filtered voltage
behind the choke, X the choke's reactance at the present frequency. While (3) acts the integrators move only where
that shortens v.

Source: [DAgostino2020] sec. 3.2.
"""

from __future__ import annotations

from shipgrid.controllers.blocks.limiter import limit_length
from shipgrid.model import kernel, signal
from shipgrid.units import PerUnit


class CurrentDqState:
    """Integrators of the two axes."""

    d: PerUnit = signal("integrator of the d axis", initial=0.0)
    q: PerUnit = signal("integrator of the q axis", initial=0.0)


@kernel
def current_dq(i_d_ref, i_q_ref, i_d, i_q, v_gd, v_gq, x_l, v_max, k_p, k_i, dt, x, x_next):
    """Converter voltage (v_d, v_q) [pu], and 1.0 where it is limited."""
    e_d, e_q = i_d_ref - i_d, i_q_ref - i_q
    wanted_d = v_gd - (k_p * e_d + x.d) + x_l * i_q  # (1), (2)
    wanted_q = v_gq - (k_p * e_q + x.q) - x_l * i_d
    v_d, v_q, limited = limit_length(wanted_d, wanted_q, v_max)  # (3)
    if limited == 0.0 or (e_d * wanted_d + e_q * wanted_q).real > 0.0:
        x_next.d = x.d + k_i * e_d * dt
        x_next.q = x.q + k_i * e_q * dt
    return v_d, v_q, limited
