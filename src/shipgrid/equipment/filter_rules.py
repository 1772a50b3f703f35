"""Rules by which an LCL filter is designed: ripple, reactive power, where its resonance may lie.

    L_1 = V_dc / (6 f_sw dI)                     dI: largest ripple of the converter's current, peak to peak    (1)
    C   = 0.05 S_n / (omega_1 V_n^2)             its reactive power is a twentieth of the rating                (2)
    10 f_1 < f_res < f_sw / 2                                                                                   (3)
    f_res = sqrt((L_1 + L) / (L_1 L C)) / 2 pi,  L = L_2 + L_source                                             (4)

L_2 is what is there: the transformer's leakage. L_source is that of the AC side, for a generator its subtransient
inductance, the mean of both axes. (1) is exact for two levels with min-max injection at full voltage; at a modulation
of M of it, down to a half, the ripple is M dI.

Source: [Reznik2014] for (1) to (3) and the damping resistor; [Liserre2005]; docs/theory/converters.md, eqs.
(converters-2) to (converters-4).
"""

from __future__ import annotations

import math

RIPPLE = 0.2
"""Ripple of the preset over the rated peak current; docs/theory/converters.md says why a fifth."""
REACTIVE_POWER = 0.05
"""Reactive power of the capacitors over the rating: the usual upper bound."""


def inductance_for_ripple(ripple: float, v_dc: float, f_sw: float, rating: float, v_n: float) -> float:
    """Converter-side inductance [H] that keeps the ripple of its current: (1).

    Parameters
    ----------
    ripple : float
        Largest ripple, peak to peak, over the peak of the rated current.
    v_dc : float
        DC voltage [V].
    f_sw : float
        Frequency of the carrier [Hz].
    rating : float
        Rated apparent power [VA].
    v_n : float
        Rated AC voltage, line to line, rms [V].
    """
    peak = rating * math.sqrt(2.0 / 3.0) / v_n
    return v_dc / (6.0 * f_sw * ripple * peak)


def ripple_of(L_1: float, v_dc: float, f_sw: float, modulation: float = 1.0) -> float:
    """Largest ripple [A], peak to peak, of the current in a converter-side choke: (1).

    Parameters
    ----------
    L_1 : float
        Its inductance [H].
    v_dc : float
        DC voltage [V].
    f_sw : float
        Frequency of the carrier [Hz].
    modulation : float
        Voltage of the bridge over v_dc / sqrt 3, from 0.5 to 1.
    """
    return modulation * v_dc / (6.0 * f_sw * L_1)


def resonance_band(f_n: float, f_sw: float) -> tuple[float, float]:
    """Lowest and highest resonance frequency [Hz] of a filter that is wanted: (3).

    Parameters
    ----------
    f_n : float
        Nominal frequency of the AC side [Hz].
    f_sw : float
        Frequency of the carrier [Hz].
    """
    return 10.0 * f_n, 0.5 * f_sw
