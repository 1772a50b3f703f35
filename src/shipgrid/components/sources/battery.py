"""Li-ion battery: open-circuit voltage and polarisation of the generic Shepherd-Tremblay model.

With the charge `q` drawn so far, `soc = 1 - q/Q`, and the current `i`, positive discharging,

    dq/dt = i,   T_r di_star/dt = i - i_star                                          (1)
    v_oc  = E_0 - K Q/(Q - q) q + A exp(-B q)                                         (2)
    v_pol = R_p Q/(Q - q) i_star        discharging (i_star > 0)                      (3)
          = R_p Q/(q + 0.1 Q) i_star    charging
    e     = v_oc - v_pol                                                              (4)

`e` is the source behind the internal resistance `R_b`, which is in the network (`BuckBoost`), so the terminal
voltage is `e - R_b i`. The model's authors write one number K for volts an ampere hour and for ohms: `R_p` is K
times one hour. The 0.1 moves the pole of the charging branch; Li-ion has no hysteresis term.

E_0, K, A and B follow from three points of the discharge curve at the nominal current I_n, where i_star = I_n
except at the first point, and from B = 3/q_exp:

    V_full = E_0 + A - R_b I_n                                                        (5)
    V      = E_0 - K Q/(Q - q) (q + 3600 s I_n) + A exp(-B q) - R_b I_n   at (q_exp, V_exp), (q_nom, V_n)

The points are given as ratios; the defaults are those of the SimPowerSystems block, and rebuild its default battery
of 7.2 V and 5.4 Ah. Outside 0 <= q <= 0.98 Q the curve means nothing: there the charge is held, and `outside` shows it.

Chemical power is `v_oc i`, the polarisation term is a loss; while i_star still has the sign of an earlier current,
that loss is negative: the part of the voltage recovers that had been lost.

Source: [Tremblay2009]; [DAgostino2020] sec. 3.1 and table A1; docs/theory/battery.md.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.kernel import uncompiled
from shipgrid.model.ops import clip
from shipgrid.model.records import parameter_record
from shipgrid.units import Ampere, Coulomb, Ohm, PerCoulomb, PerUnit, Ratio, Second, Volt, VoltPerCoulomb, ampere_hours

HOUR = 3600.0
CHARGE_SHIFT = 0.1  # of the capacity: where the charging branch has its pole, for Li-ion [Tremblay2009]
DEPTH = 0.98  # of the capacity: with default ratios the open-circuit voltage is 0.81 V_n there, and falls steeply


class State:
    q: Coulomb = signal("charge drawn since full", counts=True)
    i_star: Ampere = signal("current behind the polarisation, filtered")


class Input:
    i: Ampere = signal("terminal current, positive discharging")


class Output:
    e: Volt = signal("voltage behind the internal resistance")
    v_oc: Volt = signal("open-circuit voltage")
    soc: Ratio = signal("state of charge")
    outside: Ratio = signal("1 while the charge is held at an end of the curve", limiter=True)


class Derived:
    R_b: Ohm = signal("internal resistance")
    i_n: Ampere = signal("current of the nominal discharge curve")
    B: PerCoulomb = signal("inverse charge of the exponential zone")
    E_0: Volt = signal("constant voltage")
    K: VoltPerCoulomb = signal("polarisation constant")
    A: Volt = signal("height of the exponential zone")
    R_p: Ohm = signal("polarisation resistance of the full battery")


def derive(p: Battery) -> dict[str, float]:
    """Constants of (2) and (3) from the three points of the discharge curve."""
    Q, R_b, i_n = p.capacity, internal_resistance(p), p.capacity / p.t_n
    q_exp, q_nom = p.q_exp * Q, p.q_nom * Q
    B = 3.0 / q_exp

    def row(q: float, i_star: float) -> list[float]:
        return [1.0, -Q / (Q - q) * (q + HOUR * i_star), np.exp(-B * q)]

    points = np.array([row(0.0, 0.0), row(q_exp, i_n), row(q_nom, i_n)])
    volts = np.array([p.v_full, p.v_exp, 1.0]) * p.v_n + R_b * i_n
    E_0, K, A = np.linalg.solve(points, volts)  # (5)
    return {"R_b": R_b, "i_n": i_n, "B": B, "E_0": E_0, "K": K, "A": A, "R_p": HOUR * K}


def internal_resistance(p: Battery) -> float:
    """Internal resistance [ohm]; the network element at the battery's terminals needs it too."""
    return p.r * p.v_n / (p.capacity / HOUR)


@kernel
def open_circuit_voltage(q, p: Battery):
    return p.E_0 - p.K * p.capacity / (p.capacity - q) * q + p.A * np.exp(-p.B * q)  # (2)


def voltage_at_rest(battery: Battery, soc: float) -> float:
    """Open-circuit voltage [V] of a battery at the state of charge `soc`."""
    p, _ = parameter_record(battery)
    return uncompiled(open_circuit_voltage)((1.0 - soc) * battery.capacity, p)


@kernel
def polarisation(x: State, p: Battery):
    if x.i_star.real > 0.0:
        return p.R_p * p.capacity / (p.capacity - x.q) * x.i_star  # (3)
    return p.R_p * p.capacity / (x.q + CHARGE_SHIFT * p.capacity) * x.i_star


@kernel
def derivatives(t, x: State, u: Input, p: Battery, dx: State):
    dx.q = u.i  # (1)
    dx.i_star = (u.i - x.i_star) / p.T_r


@kernel
def limit(x: State, u: Input, p: Battery):
    x.q = clip(x.q, 0.0, DEPTH * p.capacity)


@kernel
def outputs(t, x: State, u: Input, p: Battery, y: Output):
    y.v_oc = open_circuit_voltage(x.q, p)
    y.e = y.v_oc - polarisation(x, p)  # (4)
    y.soc = 1.0 - x.q / p.capacity
    full = x.q.real <= 0.0 and u.i.real < 0.0
    empty = x.q.real >= DEPTH * p.capacity.real and u.i.real > 0.0
    y.outside = 1.0 if full or empty else 0.0


@kernel
def supplied(x: State, u: Input, p: Battery):
    return open_circuit_voltage(x.q, p) * u.i


@kernel
def losses(x: State, u: Input, p: Battery):
    return polarisation(x, p) * u.i


@component(
    state=State,
    input=Input,
    output=Output,
    derived=Derived,
    derive=derive,
    stage="advance",
    derivatives=derivatives,
    limit=limit,
    outputs=outputs,
    supplied=supplied,
    losses=losses,
)
class Battery(Derived):
    """Cells of one battery, up to their internal resistance."""

    v_n: Volt = param("nominal voltage", default=440.0, above=0.0, source="[DAgostino2020] table A1")
    capacity: Coulomb = param(
        "rated capacity", default=ampere_hours(128.0), above=0.0, source="[DAgostino2020] table A1"
    )
    r: PerUnit = param(
        "internal resistance, on v_n over the one-hour current", default=0.01, above=0.0, below=0.1, source="SPS ratio"
    )
    t_n: Second = param(
        "time in which the current of the nominal discharge curve draws the capacity",
        default=2.3 * HOUR,
        above=0.1 * HOUR,
        source="SPS ratio: I_n = 0.43478 Q",
    )
    v_full: PerUnit = param(
        "full battery's voltage at I_n, on v_n", default=1.16398, above=1.0, below=2.0, source="SPS ratio"
    )
    v_exp: PerUnit = param(
        "voltage at the end of the exponential zone, on v_n", default=1.08039, above=1.0, below=2.0, source="SPS ratio"
    )
    q_exp: PerUnit = param(
        "charge drawn at the end of the exponential zone, on the capacity",
        default=0.04913,
        above=0.001,
        below=0.5,
        source="SPS ratio",
    )
    q_nom: PerUnit = param(
        "charge drawn when the voltage has come down to v_n, on the capacity",
        default=0.90434,
        above=0.5,
        below=0.98,
        source="SPS ratio",
    )
    T_r: Second = param("time constant of the polarisation", default=30.0, above=0.0, source="SPS default")
