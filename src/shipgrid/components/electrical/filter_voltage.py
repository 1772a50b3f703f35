"""Voltage transducer of an LCL filter: what stands across the capacitor and the damping resistor in series with it.

    v = v_c + R_d (i_1 - i_2)                                (1)

This is the node where the two chokes meet. The capacitor's own voltage lies behind R_d and cannot be measured at the
terminals of a damped capacitor: it lags (1) by arctan(omega C R_d), 1.4 degrees with 0.06 pu and 0.41 pu.
Per axis (alpha, beta); symbols and signs as in `lcl_filter.py`.
"""

from __future__ import annotations

from shipgrid.model import component, kernel, param, signal
from shipgrid.units import Ampere, Ohm, Volt


class Input:
    """Input of the transducer."""

    v_c_alpha: Volt = signal("voltage of the capacitor itself, alpha axis")
    v_c_beta: Volt = signal("voltage of the capacitor itself, beta axis")
    i_1_alpha: Ampere = signal("converter-side current, from converter to grid, alpha axis")
    i_1_beta: Ampere = signal("converter-side current, from converter to grid, beta axis")
    i_2_alpha: Ampere = signal("grid-side current, from converter to grid, alpha axis")
    i_2_beta: Ampere = signal("grid-side current, from converter to grid, beta axis")


class Output:
    """Output of the transducer."""

    v_alpha: Volt = signal("voltage across capacitor and damping resistor, alpha axis")
    v_beta: Volt = signal("voltage across capacitor and damping resistor, beta axis")


@kernel
def outputs(t, u: Input, p: FilterVoltage, y: Output):
    y.v_alpha = u.v_c_alpha + p.R_d * (u.i_1_alpha - u.i_2_alpha)  # (1)
    y.v_beta = u.v_c_beta + p.R_d * (u.i_1_beta - u.i_2_beta)


@component(input=Input, output=Output, outputs=outputs, stage="measure")
class FilterVoltage:
    """Voltage transducer across the capacitor branch of an LCL filter, both axes."""

    R_d: Ohm = param("damping resistance in series with the capacitor, that of the filter", at_least=0.0)
