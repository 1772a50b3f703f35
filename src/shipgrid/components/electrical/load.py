"""Three-phase load of constant impedance, series R-L in star, one axis.

    L di/dt = v - R i                                                          (1)
    R = v_n^2 pf / S,   omega_n L = v_n^2 sqrt(1 - pf^2) / S,   S = p_0 / pf   (2)

It takes `p_0` at the power factor `pf`, lagging, at nominal voltage and frequency, and power as the square of the
voltage elsewhere. The power in R is what the consumer uses.
"""

from __future__ import annotations

import math

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Henry, Hertz, Ohm, Ratio, Volt, Watt


class State:
    """State of the load."""

    i: Ampere = signal("current into the load")


class Input:
    """Input of the load."""

    v: Volt = signal("bar voltage")


class Output:
    """Output of the load."""

    i_in: Ampere = signal("current into the load")


class Derived:
    """Its impedance."""

    R: Ohm = signal("series resistance of a phase")
    L: Henry = signal("series inductance of a phase")


def derive(p: Load) -> dict[str, float]:
    """Impedance from power, power factor and nominal values: (2)."""
    z = p.v_n**2 * p.power_factor / p.p_0
    x = z * math.sqrt(1.0 - p.power_factor**2)
    return {"R": z * p.power_factor, "L": x / (2.0 * math.pi * p.f_n)}


@kernel
def derivatives(t, x: State, u: Input, p: Load, dx: State):
    dx.i = (u.v - p.R * x.i) / p.L  # (1)


@kernel
def outputs(t, x: State, u: Input, p: Load, y: Output):
    y.i_in = x.i


@kernel
def stored_energy(x: State, p: Load):
    return 0.5 * p.L * x.i**2


@kernel
def consumed(x: State, u: Input, p: Load):
    return p.R * x.i**2


@component(
    state=State,
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    consumed=consumed,
    terminals=(Terminal("supply", v="v", i="i_in"),),
    variants={"open": ("i",)},
    passive=True,
)
class Load(Derived):
    """Constant-impedance load, series R-L."""

    p_0: Watt = param("active power of the three phases at nominal voltage", default=10e3, above=0.0, source="typical")
    power_factor: Ratio = param(
        "cos phi, lagging; the branch needs some inductance", default=0.9, above=0.0, at_most=0.999, source="typical"
    )
    v_n: Volt = param("nominal voltage, line to line, rms", default=400.0, above=0.0, source="[DAgostino2020] table A1")
    f_n: Hertz = param("nominal frequency", default=60.0, above=0.0, source="[DAgostino2020] table A1")
