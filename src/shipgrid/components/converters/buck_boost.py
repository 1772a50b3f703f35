"""Buck-boost converter of a battery: internal resistance, capacitor, choke and one half-bridge leg.

    C dv_c/dt = (e - v_c)/R_b - i_l                 (1)
    L di_l/dt = v_c - R i_l - v_leg                 (2)
    i_leg = -i_l                                    (3)

`e` is the battery's voltage behind its internal resistance. The leg's terminal meets the DC bus through a half-bridge:
v_leg = s v_dc, and s i_l flows into the bus, with s the switching function of the upper switch: any number from 0
to 1 as the mean over a step. C with R_b has its pole at -1/(R_b C) = -2.4e6 rad/s: the solver's rule must be L-stable.

Two contact positions beside the closed one: `open`, no current; `precharge`, the contactor is closed through the
resistor `R_p`, which stands in (2) beside R. With the gates blocked the leg's upper diode then charges a bus whose
voltage is below the battery's.

Source: [DAgostino2020] sec. 3.1, fig. 5a, table A1; docs/theory/converters.md.
"""

from __future__ import annotations

from shipgrid.model import Terminal, component, kernel, param, signal
from shipgrid.units import Ampere, Farad, Henry, Ohm, Ratio, Volt


class State:
    v_c: Volt = signal("voltage at the battery's terminals", initial=474.0)
    i_l: Ampere = signal("choke current, from battery to bus")


class Input:
    e: Volt = signal("battery voltage behind its internal resistance")
    v_leg: Volt = signal("voltage of the half-bridge leg")
    position: Ratio = signal("position of the contactor: 0 closed, 1 open, 2 through the resistor", initial=0.0)


class Output:
    i_leg: Ampere = signal("current from the leg into the choke")


@kernel
def choke_resistance(u: Input, p: BuckBoost):
    return p.R + p.R_p if u.position.real > 1.5 else p.R + 0.0


@kernel
def derivatives(t, x: State, u: Input, p: BuckBoost, dx: State):
    dx.v_c = ((u.e - x.v_c) / p.R_b - x.i_l) / p.C  # (1)
    dx.i_l = (x.v_c - choke_resistance(u, p) * x.i_l - u.v_leg) / p.L  # (2)


@kernel
def outputs(t, x: State, u: Input, p: BuckBoost, y: Output):
    y.i_leg = -x.i_l  # (3)


@kernel
def stored_energy(x: State, p: BuckBoost):
    return 0.5 * p.C * x.v_c**2 + 0.5 * p.L * x.i_l**2


@kernel
def losses(x: State, u: Input, p: BuckBoost):
    return choke_resistance(u, p) * x.i_l**2 + (u.e - x.v_c) ** 2 / p.R_b


@component(
    state=State,
    input=Input,
    output=Output,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    losses=losses,
    terminals=(Terminal("leg", v="v_leg", i="i_leg"),),
    variants={"open": ("i_l",), "precharge": ()},
    passive=True,
)
class BuckBoost:
    """Half-bridge leg, choke and capacitor between a battery and the DC bus."""

    L: Henry = param("choke inductance", default=0.8e-3, above=0.0, source="[DAgostino2020] table A1")
    R: Ohm = param("resistance of choke and switches", default=0.25, at_least=0.0, source="[DAgostino2020] table A1")
    C: Farad = param("battery-side capacitance", default=12e-6, above=0.0, source="[DAgostino2020] table A1")
    R_b: Ohm = param(
        "internal resistance of the battery", default=34.375e-3, above=0.0, source="SPS ratio, 440 V 128 Ah"
    )
    R_p: Ohm = param(
        "pre-charge resistance",
        default=20.0,
        at_least=0.0,
        source="typical: 24 A at first, and 34 mF are charged in three time constants of 0.7 s",
    )
