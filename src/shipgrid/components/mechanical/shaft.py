"""Shaft line: one inertia between motor and screw.

    J domega_m/dt = tau_e - tau - tau_f                                              (1)
    tau_f = (1 - eta_s) |tau| omega_m / sqrt(omega_m^2 + omega_0^2)                  (2)

The friction of stern tube and bearings is a share of the screw's torque, (1 - eta_s) tau when the motor drives the
screw. When the water drives the screw, tau and omega_m have opposite signs and friction still
takes power: hence the magnitude. omega_0 = 0.05 rad/s (half a revolution a minute) makes (2) smooth through
standstill, so that a shaft at rest in a stream neither chatters nor sticks; there is no static friction.

It steps with the network, not slower: the motor's torque has the ripple of its current control in it, and sampling that
every millisecond would alias it into the energy balance. One step costs a few nanoseconds.

Source: docs/theory/propulsion.md.
"""

from __future__ import annotations

import numpy as np

from shipgrid.model import component, kernel, param, signal
from shipgrid.model.ops import absolute
from shipgrid.units import KilogramMetre2, NewtonMetre, PerUnit, RadianPerSecond, Ratio

OMEGA_0 = 0.05


class State:
    omega_m: RadianPerSecond = signal("shaft speed, positive ahead", absurd=1e3)


class Input:
    tau_e: NewtonMetre = signal("air-gap torque of the motor")
    tau: NewtonMetre = signal("torque the screw takes", initial=0.0)


class Output:
    omega_pu: PerUnit = signal("shaft speed over rated speed")


@kernel
def friction(omega_m, tau, p):
    """Friction torque [N m]: (2)."""
    return (1.0 - p.eta_s) * absolute(tau) * omega_m / np.sqrt(omega_m * omega_m + OMEGA_0 * OMEGA_0)


@kernel
def derivatives(x: State, u: Input, p: Shaft, dx: State):
    dx.omega_m = (u.tau_e - u.tau - friction(x.omega_m, u.tau, p)) / p.J  # (1)


@kernel
def outputs(x: State, p: Shaft, y: Output):
    y.omega_pu = x.omega_m / p.omega_n


@kernel
def stored_energy(x: State, p: Shaft):
    return 0.5 * p.J * x.omega_m**2


@kernel
def losses(x: State, u: Input, p: Shaft):
    return friction(x.omega_m, u.tau, p) * x.omega_m


@component(
    state=State,
    input=Input,
    output=Output,
    derivatives=derivatives,
    outputs=outputs,
    stored_energy=stored_energy,
    losses=losses,
    passive=True,
)
class Shaft:
    """Motor rotor, shaft and screw with its entrained water, as one rigid body."""

    J: KilogramMetre2 = param("inertia of the whole line", default=383.4, above=0.0, source="[DAgostino2020] table A1")
    eta_s: Ratio = param("shaft efficiency", default=0.98, above=0.0, at_most=1.0, source="[DAgostino2020] table A1")
    omega_n: RadianPerSecond = param(
        "rated speed", default=47.12389, above=0.0, source="450 rpm, [DAgostino2020] table A1"
    )
