"""DC side of the active rectifier: the d-axis current reference, per unit, sampled.

Shared bus, droop (reading B of the paper's text, a PI on the DC *current*):

    i_dc* = (v_dc* - v_dc) / K_v,   i_d* = PI(i_dc* - i_dc)       (1)

Single source, forming the bus (a PI on the voltage):

    i_d* = PI(v_dc* - v_dc)                                       (2)

Statics of (1): v_dc = v_dc* - K_v i_dc. The reference lies between 0 (no reverse power into the diesel) and `high`.
While disabled, and at a change of mode, the integrator is set so that the reference does not move.

Source: [DAgostino2020] sec. 3.2 and table A1; gains of (2): docs/theory/converters.md.
"""

from __future__ import annotations

from shipgrid.controllers.blocks.pi import PiState, pi
from shipgrid.model import kernel, signal
from shipgrid.units import PerUnit, Ratio

DROOP, VOLTAGE = 0.0, 1.0


class DcVoltageState:
    """State of the loop."""

    pi: PiState
    i_d_ref: PerUnit = signal("d-axis current reference of the last sample", initial=0.0)
    mode: Ratio = signal("mode of the last sample: 0 droop, 1 voltage", initial=0.0)


@kernel
def dc_voltage(v_ref, v_dc, i_dc, mode, enable, high, p, dt, x, x_next):
    """Reference of the d-axis current [pu] for voltages and DC current [pu]."""
    if mode.real > 0.5:
        e, k_p, k_i = v_ref - v_dc, p.K_p_form, p.K_i_form  # (2)
    else:
        e, k_p, k_i = (v_ref - v_dc) / p.K_v - i_dc, p.K_p_dc, p.K_i_dc  # (1)
    if enable.real < 0.5:
        x_next.pi.i = -k_p * e
        x_next.i_d_ref = 0.0
    else:
        if mode.real != x.mode.real:
            x_next.pi.i = x.i_d_ref - k_p * e
        x_next.i_d_ref = pi(e, 0.0, k_p, k_i, 0.0, high, dt, x_next.pi, x_next.pi)
    x_next.mode = mode
    return x_next.i_d_ref
