"""LCL filter of a two-level converter, one axis: converter-side choke, damped star capacitor, grid-side choke.

    L_1 di_1/dt = v_conv - R_1 i_1 - v_c - R_d (i_1 - i_2)       (1)
    C   dv_c/dt = i_1 - i_2                                      (2)
    L_2 di_2/dt = v_c + R_d (i_1 - i_2) - R_2 i_2 - v_g          (3)

`i_1` and `i_2` are positive from the converter towards the grid, so that the current into the grid terminal is
-i_2. `L_2` is the leakage of the transformer where there is one, its ratio already referred. `R_d` stands in series
with C. Written per axis (alpha, beta): the star point is insulated and carries no zero sequence.

Three contact positions beside the closed one: `open`, the contactor towards the grid is open and the capacitors are
discharged; `precharge`, the contactor is closed through the resistor `R_p`, which stands in (3) beside R_2; `idle`, the
contactor is open while the converter runs on the capacitors.

Source: [DAgostino2020] table A1 and fig. 5; docs/theory/converters.md.
"""

from __future__ import annotations

import math

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Farad, Henry, Ohm, Ratio, Volt


class State:
    i_1: Ampere = signal("converter-side current, from converter to grid")
    v_c: Volt = signal("capacitor voltage")
    i_2: Ampere = signal("grid-side current, from converter to grid")


class Input:
    v_conv: Volt = signal("voltage of the converter poles")
    v_g: Volt = signal("grid voltage")
    position: Ratio = signal("contactor: 0 closed, 1 open, 2 through the resistor, 3 open and running", initial=0.0)


class Output:
    i_conv: Ampere = signal("current into the converter terminal")
    i_g: Ampere = signal("current into the grid terminal")


@kernel
def grid_resistance(u: Input, p: LclFilter):
    return p.R_2 + p.R_p if u.position.real > 1.5 else p.R_2 + 0.0


@kernel
def derivatives(t, x: State, u: Input, p: LclFilter, dx: State):
    v_node = x.v_c + p.R_d * (x.i_1 - x.i_2)
    dx.i_1 = (u.v_conv - p.R_1 * x.i_1 - v_node) / p.L_1  # (1)
    dx.v_c = (x.i_1 - x.i_2) / p.C  # (2)
    dx.i_2 = (v_node - grid_resistance(u, p) * x.i_2 - u.v_g) / p.L_2  # (3)


@kernel
def outputs(t, x: State, u: Input, p: LclFilter, y: Output):
    y.i_conv = x.i_1
    y.i_g = -x.i_2


@kernel
def stored_energy(x: State, p: LclFilter):
    return 0.5 * (p.L_1 * x.i_1**2 + p.C * x.v_c**2 + p.L_2 * x.i_2**2)


@kernel
def losses(x: State, u: Input, p: LclFilter):
    return p.R_1 * x.i_1**2 + p.R_d * (x.i_1 - x.i_2) ** 2 + grid_resistance(u, p) * x.i_2**2


@component(
    state=State,
    input=Input,
    output=Output,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(Terminal("converter", v="v_conv", i="i_conv"), Terminal("grid", v="v_g", i="i_g")),
    variants={"open": ("i_1", "v_c", "i_2"), "precharge": (), "idle": ("i_2",)},
    passive=True,
)
class LclFilter:
    """LCL filter between converter poles and a three-phase grid, one axis."""

    L_1: Henry = param("converter-side inductance", above=0.0)
    R_1: Ohm = param("resistance of the converter-side choke and of the closed switch", at_least=0.0)
    C: Farad = param("capacitance per phase, star", above=0.0)
    R_d: Ohm = param("damping resistance in series with the capacitor", at_least=0.0)
    L_2: Henry = param("grid-side inductance, transformer leakage included", above=0.0)
    R_2: Ohm = param("resistance of the grid-side choke or transformer", at_least=0.0)
    R_p: Ohm = param(
        "pre-charge resistance per phase",
        default=1.5,
        at_least=0.0,
        source="chosen: a quarter of 596 kW's current at first; more would divide with the capacitors' 5.5 ohm",
    )

    @classmethod
    def per_unit(
        cls,
        rating: float,
        v_n: float,
        f_n: float,
        L_1: float,
        C: float,
        L_2: float,
        R_1: float = 0.005,
        R_2: float = 0.005,
        damping: float = 1.0 / 3.0,
        R_p: float = 0.0,
    ) -> LclFilter:
        """Filter from per-unit values on its own rating.

        Parameters
        ----------
        rating : float
            Base power [VA].
        v_n : float
            Base voltage, line to line, rms [V].
        f_n : float
            Base frequency [Hz].
        L_1, C, L_2, R_1, R_2 : float
            Per-unit values; the default resistances are typical of air-cooled chokes of this size.
        damping : float
            Damping resistance over the capacitor's reactance at resonance: R_d = damping / (omega_res C).
        R_p : float
            Pre-charge resistance [ohm].

        Returns
        -------
        LclFilter
            The same filter in SI.
        """
        omega = 2.0 * math.pi * f_n
        z = v_n**2 / rating
        R_d = damping * math.sqrt(L_1 * L_2 / ((L_1 + L_2) * C))
        return cls(
            L_1=L_1 * z / omega,
            R_1=R_1 * z,
            C=C / (omega * z),
            R_d=R_d * z,
            L_2=L_2 * z / omega,
            R_2=R_2 * z,
            R_p=R_p,
        )

    @property
    def f_res(self) -> float:
        """Resonance frequency of the undamped filter between two stiff voltages [Hz]."""
        return self.resonance()

    def resonance(self, L_source: float = 0.0) -> float:
        """Resonance frequency of the undamped filter [Hz], on an AC side that is not stiff.

        Parameters
        ----------
        L_source : float
            Inductance of the AC side [H].
        """
        L_2 = self.L_2 + L_source
        return math.sqrt((self.L_1 + L_2) / (self.L_1 * L_2 * self.C)) / (2.0 * math.pi)
