"""Phase-locked loop in the synchronous reference frame, sampled.

    e = v_q / max(|v|, 0.1)                                           (1)
    omega = omega_n + clip(K_p e + x, +-band),   dx = K_i e dt        (2)
    theta <- theta + omega dt                                         (3)

`theta` is the angle of the d axis at the sampling instant, `v_q` the voltage across it in per unit: zero when locked.
With K_p = 2 zeta omega_0 and K_i = omega_0^2 the loop is of second order. The integrator stands still while the
voltage is too low to tell its angle (below 0.2 pu).
"""

from __future__ import annotations

from shipgrid.model import kernel, signal
from shipgrid.model.ops import clip, maximum, wrap
from shipgrid.units import Radian, RadianPerSecond

V_FLOOR = 0.1  # pu, keeps (1) finite on a dead grid
V_HOLD = 0.2  # pu


class PllState:
    """State of one loop."""

    omega: RadianPerSecond = signal("integrator: speed of the voltage vector less the nominal one", initial=0.0)
    theta: Radian = signal("angle of the d axis from the alpha axis", initial=0.0, rotates=True)


@kernel
def pll(v_q, v, omega_n, k_p, k_i, band, dt, x, x_next):
    """Speed of the voltage vector [rad/s], for its q component and its length [pu]; turns the angle."""
    e = v_q / maximum(v, V_FLOOR)  # (1)
    omega = omega_n + clip(k_p * e + x.omega, -band, band)  # (2)
    if v.real >= V_HOLD:
        x_next.omega = clip(x.omega + k_i * e * dt, -band, band)
    x_next.theta = wrap(x.theta + omega * dt)  # (3)
    return omega
