"""DC load whose power follows its voltage: constant power, as a tightly controlled converter draws it.

    i = g (v_a - v_b),   g = P_0 F(r) / v_n^2,   F = z + i / r + (1 - z - i) r^(alpha - 2)    (1)
    T_v dw/dt = ((v_a - v_b) / v_n)^2 - w,   r = max(sqrt(w), r_min)                            (2)

The DC twin of `components/electrical/voltage_dependent_load.py`. Seen from the bus around a rest at the voltage V it is

    Y(s) = (P / V^2) (1 - (2 - alpha') / (1 + s T_v)),   alpha' = d ln P / d ln V               (3)

which is the classical negative conductance -P/V^2 of a constant power (alpha' = 0) for whatever is slower than 1/T_v.
`a` and `b` are its ends; without `b` it lies between the poles of the bus.

Source: docs/theory/loads.md.
"""

from __future__ import annotations

from shipgrid.components.electrical.voltage_dependent_load import dependence
from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, PerUnit, Ratio, Second, Siemens, Volt, Watt


class State:
    """State of the load."""

    w: PerUnit = signal("square of the voltage over its nominal value, through the filter", initial=1.0)


class Input:
    """Input of the load."""

    v_a: Volt = signal("voltage of one end")
    v_b: Volt = signal("voltage of the other end")
    demand: PerUnit = signal("what is switched on, over its nominal value", initial=1.0)


class Output:
    """Output of the load."""

    i_a: Ampere = signal("current into the load at `a`")
    i_b: Ampere = signal("current into the load at `b`")
    p_dc: Watt = signal("power taken")


class Derived:
    """Its conductance at nominal voltage."""

    G_0: Siemens = signal("conductance at nominal voltage")


def derive(p: DcLoad) -> dict[str, float]:
    """Conductance at nominal voltage."""
    return {"G_0": p.p_0 / p.v_n**2}


@kernel
def derivatives(x: State, u: Input, p: DcLoad, dx: State):
    dx.w = (((u.v_a - u.v_b) / p.v_n) ** 2 - x.w) / p.T_v  # (2)


@kernel
def outputs(x: State, u: Input, p: DcLoad, y: Output):
    f, _ = dependence(x.w, p.z, p.i, p.alpha, p.r_min)
    y.i_a = u.demand * p.G_0 * f * (u.v_a - u.v_b)  # (1)
    y.i_b = -y.i_a
    y.p_dc = y.i_a * (u.v_a - u.v_b)


@kernel
def stamp(gh, x: State, u: Input, p: DcLoad, n):
    k, v = gh / p.T_v, u.v_a - u.v_b
    f, slope = dependence((x.w + k * (v / p.v_n) ** 2) / (1.0 + k), p.z, p.i, p.alpha, p.r_min)
    by_v = 2.0 * k / (1.0 + k) * (v / p.v_n) ** 2  # v dw/dv
    g = u.demand * p.G_0 * (f + slope * by_v)
    h = -u.demand * p.G_0 * slope * by_v * v
    n.g_aa = g
    n.g_ab = -g
    n.g_ba = -g
    n.g_bb = g
    n.h_a = h
    n.h_b = -h


@kernel
def advance(gh, x: State, u: Input, p: DcLoad, x_next: State):
    k = gh / p.T_v
    x_next.w = (x.w + k * ((u.v_a - u.v_b) / p.v_n) ** 2) / (1.0 + k)


@kernel
def consumed(x: State, u: Input, p: DcLoad):
    f, _ = dependence(x.w, p.z, p.i, p.alpha, p.r_min)
    return u.demand * p.G_0 * f * (u.v_a - u.v_b) ** 2


@component(
    state=State,
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    derivatives=derivatives,
    outputs=outputs,
    stamp=stamp,
    advance=advance,
    consumed=consumed,
    terminals=(Terminal("a", v="v_a", i="i_a"), Terminal("b", v="v_b", i="i_b")),
)
class DcLoad(Derived):
    """DC load by its power's dependence on the voltage; constant power unless told otherwise."""

    p_0: Watt = param("power at nominal voltage", above=0.0)
    v_n: Volt = param("nominal voltage", default=750.0, above=0.0, source="[DAgostino2020] table A1")
    z: Ratio = param("share of constant impedance", default=0.0, source="constant power")
    i: Ratio = param("share of constant current", default=0.0, source="constant power")
    alpha: Ratio = param("exponent of the rest of the power", default=0.0, source="constant power")
    T_v: Second = param(
        "response of the converter's control", default=1e-4, above=0.0, source="typical: a bandwidth of 1.6 kHz"
    )
    r_min: PerUnit = param(
        "voltage below which it is a constant impedance", default=0.7, above=0.0, source="as the three-phase load's"
    )
