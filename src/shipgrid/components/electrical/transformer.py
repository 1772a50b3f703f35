"""Three-phase two-winding transformer of any vector group: leakages, magnetising branch, ratio and phase shift.

Space vectors, x = x_alpha + j x_beta; side 1 is the primary, side 2 the secondary, a = v_1n / v_2n:

    L_1 di_1/dt = v_1 - R_1 i_1 - e                                   (1)
    L_2 di_2/dt = v_2 - R_2 i_2 - e exp(j phi) / a                    (2)
    L_m di_m/dt = e                                                   (3)
    e = R_m (i_1 + exp(-j phi) i_2 / a - i_m)                         (4)
    phi = -30 deg clock                                               (5)

Both currents are positive into the transformer. The clock number is that of the vector group: 0 for Yy0, 11 for Dy11
and Yd11, whose secondary leads by 30 degrees. Without a neutral a delta winding is a star one of a third of its
impedance, turned: `R` and `L` are those of the equivalent star, of each side in its own ohms. The phase shift couples
the axes, so that one component holds both. No saturation: switched on at a bad instant the flux L_m i_m has its
offset, the current not the peaks that come of it.

R_m carries what the leakages and L_m do not allow: L_1 / R_m is a time constant far below any step, and more than
some 500 pu only loses digits.

Source: [Krause2013] ch. 2; docs/theory/network.md.
"""

from __future__ import annotations

import math
import re

from shipgrid.errors import ParameterError
from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Henry, Ohm, Ratio, Volt


class State:
    """State of the transformer."""

    i_1_alpha: Ampere = signal("primary current, alpha axis")
    i_1_beta: Ampere = signal("primary current, beta axis")
    i_2_alpha: Ampere = signal("secondary current into the transformer, alpha axis")
    i_2_beta: Ampere = signal("secondary current into the transformer, beta axis")
    i_m_alpha: Ampere = signal("magnetising current, on the primary side, alpha axis")
    i_m_beta: Ampere = signal("magnetising current, on the primary side, beta axis")


class Input:
    """Input of the transformer."""

    v_1_alpha: Volt = signal("primary voltage, alpha axis")
    v_1_beta: Volt = signal("primary voltage, beta axis")
    v_2_alpha: Volt = signal("secondary voltage, alpha axis")
    v_2_beta: Volt = signal("secondary voltage, beta axis")


class Output:
    """Output of the transformer."""

    i_1_alpha_in: Ampere = signal("current into the primary terminal, alpha axis")
    i_1_beta_in: Ampere = signal("current into the primary terminal, beta axis")
    i_2_alpha_in: Ampere = signal("current into the secondary terminal, alpha axis")
    i_2_beta_in: Ampere = signal("current into the secondary terminal, beta axis")


class Derived:
    """What follows from the vector group."""

    c: Ratio = signal("cos(phi) / a")
    s: Ratio = signal("sin(phi) / a")


def derive(p: Transformer) -> dict[str, float]:
    """Ratio and rotation, exact for whole quarters of a turn: (5).

    Raises
    ------
    ParameterError
        If the clock number is not whole.
    """
    if p.clock != round(p.clock):
        raise ParameterError(f"Transformer.clock = {p.clock:g} is no clock number, expected a whole one from 0 to 11")
    cos, sin = (round(f(-math.pi / 6.0 * p.clock), 15) for f in (math.cos, math.sin))
    return {"c": cos * p.v_2n / p.v_1n, "s": sin * p.v_2n / p.v_1n}


@kernel
def magnetising_voltage(x, p):
    """Voltage of the magnetising branch, alpha and beta: (4)."""
    return (
        p.R_m * (x.i_1_alpha + p.c * x.i_2_alpha + p.s * x.i_2_beta - x.i_m_alpha),
        p.R_m * (x.i_1_beta + p.c * x.i_2_beta - p.s * x.i_2_alpha - x.i_m_beta),
    )


@kernel
def derivatives(t, x: State, u: Input, p: Transformer, dx: State):
    e_alpha, e_beta = magnetising_voltage(x, p)
    dx.i_1_alpha = (u.v_1_alpha - p.R_1 * x.i_1_alpha - e_alpha) / p.L_1  # (1)
    dx.i_1_beta = (u.v_1_beta - p.R_1 * x.i_1_beta - e_beta) / p.L_1
    dx.i_2_alpha = (u.v_2_alpha - p.R_2 * x.i_2_alpha - p.c * e_alpha + p.s * e_beta) / p.L_2  # (2)
    dx.i_2_beta = (u.v_2_beta - p.R_2 * x.i_2_beta - p.c * e_beta - p.s * e_alpha) / p.L_2
    dx.i_m_alpha = e_alpha / p.L_m  # (3)
    dx.i_m_beta = e_beta / p.L_m


@kernel
def outputs(t, x: State, u: Input, p: Transformer, y: Output):
    y.i_1_alpha_in = x.i_1_alpha
    y.i_1_beta_in = x.i_1_beta
    y.i_2_alpha_in = x.i_2_alpha
    y.i_2_beta_in = x.i_2_beta


@kernel
def stored_energy(x: State, p: Transformer):
    leakage = p.L_1 * (x.i_1_alpha**2 + x.i_1_beta**2) + p.L_2 * (x.i_2_alpha**2 + x.i_2_beta**2)
    return 0.5 * (leakage + p.L_m * (x.i_m_alpha**2 + x.i_m_beta**2))


@kernel
def losses(x: State, p: Transformer):
    e_alpha, e_beta = magnetising_voltage(x, p)
    copper = p.R_1 * (x.i_1_alpha**2 + x.i_1_beta**2) + p.R_2 * (x.i_2_alpha**2 + x.i_2_beta**2)
    return copper + (e_alpha**2 + e_beta**2) / p.R_m


VECTOR_GROUP = re.compile(r"([YD])N?([yd])n?(\d{1,2})")


@component(
    state=State,
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(
        Terminal("primary_alpha", v="v_1_alpha", i="i_1_alpha_in"),
        Terminal("primary_beta", v="v_1_beta", i="i_1_beta_in"),
        Terminal("secondary_alpha", v="v_2_alpha", i="i_2_alpha_in"),
        Terminal("secondary_beta", v="v_2_beta", i="i_2_beta_in"),
    ),
    passive=True,
)
class Transformer(Derived):
    """Three-phase transformer between two AC buses, `primary` and `secondary`."""

    v_1n: Volt = param("rated primary voltage, line to line, rms", default=400.0, above=0.0, source="typical")
    v_2n: Volt = param("rated secondary voltage, line to line, rms", default=400.0, above=0.0, source="typical")
    R_1: Ohm = param("primary resistance, equivalent star", at_least=0.0)
    L_1: Henry = param("primary leakage inductance, equivalent star", above=0.0)
    R_2: Ohm = param("secondary resistance, equivalent star", at_least=0.0)
    L_2: Henry = param("secondary leakage inductance, equivalent star", above=0.0)
    R_m: Ohm = param(
        "resistance of the core's losses, on the primary side",
        default=1600.0,
        above=0.0,
        source="500 pu of 50 kVA at 400 V, default of the SPS block",
    )
    L_m: Henry = param(
        "magnetising inductance, on the primary side",
        default=4.24,
        above=0.0,
        source="500 pu of 50 kVA at 400 V and 60 Hz, default of the SPS block",
    )
    clock: Ratio = param("clock number of the vector group", default=0.0, at_least=0.0, at_most=11.0, source="Yy0")

    @classmethod
    def per_unit(
        cls,
        rating: float,
        v_1n: float,
        v_2n: float,
        f_n: float,
        *,
        group: str = "Yy0",
        X: float = 0.10,
        R: float = 0.005,
        X_m: float = 500.0,
        R_m: float = 500.0,
    ) -> Transformer:
        """Transformer from its vector group and per-unit values, the series impedance split in halves.

        Parameters
        ----------
        rating : float
            Base power [VA].
        v_1n, v_2n : float
            Rated voltages of primary and secondary, line to line, rms [V].
        f_n : float
            Base frequency [Hz].
        group : str
            Vector group, such as `Yy0`, `Dyn11`, `Yd5`.
        X, R : float
            Short-circuit reactance and resistance [pu].
        X_m, R_m : float
            Magnetising reactance and core resistance [pu].

        Returns
        -------
        Transformer
            The same in SI.

        Raises
        ------
        ParameterError
            If there is no such vector group.
        """
        read = VECTOR_GROUP.fullmatch(group)
        # Two windings of one kind turn by whole sixths of a revolution, a star and a delta by odd twelfths.
        if read is None or int(read[3]) > 11 or (int(read[3]) % 2 == 1) != (read[1].lower() != read[2]):
            what = "expected Yy or Dd with an even clock number, or Yd or Dy with an odd one, such as Dyn11"
            raise ParameterError(f"Transformer: '{group}' is no vector group, {what}")
        omega, z_1, z_2 = 2.0 * math.pi * f_n, v_1n**2 / rating, v_2n**2 / rating
        return cls(
            v_1n=v_1n,
            v_2n=v_2n,
            R_1=0.5 * R * z_1,
            L_1=0.5 * X * z_1 / omega,
            R_2=0.5 * R * z_2,
            L_2=0.5 * X * z_2 / omega,
            R_m=R_m * z_1,
            L_m=X_m * z_1 / omega,
            clock=float(read[3]),
        )
