"""Tie breakers with their cables, between two DC buses or two AC bars, and the rules of closing.

A breaker obeys 'open' at once, under load too: its current is set to zero (an AC breaker would wait for the current's
zero, half a period at most). It closes when its rule allows, and says why as long as it does not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from shipgrid.components.electrical.cable import ac_cable, dc_cable
from shipgrid.equipment.declaration import Published, equipment, reference, switch
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.network import Across, Every, Network
from shipgrid.model.ops import absolute, arctan2, hypot, minimum, wrap
from shipgrid.units import Hertz, Metre, Ohm, PerUnit, Radian, Ratio, Second, Volt

STATES = {0: "open", 1: "closed"}


class SequenceOutput:
    """Output of a breaker's control."""

    closed: Ratio = signal("1: closed")
    position: Ratio = signal("contact position of the branch: 0 closed, 1 open")
    refused: Ratio = signal("reason why it does not close, 0: none")


class DcState:
    """State of the DC breaker's control."""

    closed: Ratio = signal("1: closed")


class DcInput:
    """Input of the DC breaker's control."""

    close: Ratio = signal("command")
    v_from: Volt = signal("voltage on one side")
    v_to: Volt = signal("voltage on the other side")


@kernel
def dc_update(t, dt, x: DcState, u: DcInput, p: DcBreakerControl, x_next: DcState, y: SequenceOutput):
    y.refused = 0.0
    if u.close.real < 0.5:
        x_next.closed = 0.0
    elif x.closed.real < 0.5:
        if absolute(u.v_from - u.v_to).real < p.dv_max.real:
            x_next.closed = 1.0
        else:
            y.refused = 1.0
    y.closed = x_next.closed
    y.position = 1.0 - x_next.closed


@component(state=DcState, input=DcInput, output=SequenceOutput, update=dc_update, stage="supervise")
class DcBreakerControl:
    """Closes when both sides have nearly the same voltage."""

    dv_max: Volt = param(
        "largest difference at closing", default=10.0, above=0.0, source="closing rule, else precharge"
    )


class AcState:
    """State of the AC breaker's control."""

    closed: Ratio = signal("1: closed")
    angle: Radian = signal("angle between the sides at the last instant")
    in_step: Second = signal("for how long the sides have been in step")


class AcInput:
    """Input of the AC breaker's control."""

    close: Ratio = signal("command")
    from_alpha: Volt = signal("voltage of one side, alpha axis")
    from_beta: Volt = signal("voltage of one side, beta axis")
    to_alpha: Volt = signal("voltage of the other side, alpha axis")
    to_beta: Volt = signal("voltage of the other side, beta axis")


@kernel
def ac_update(t, dt, x: AcState, u: AcInput, p: AcBreakerControl, x_next: AcState, y: SequenceOutput):
    v_from = hypot(u.from_alpha, u.from_beta) / p.v_b
    v_to = hypot(u.to_alpha, u.to_beta) / p.v_b
    cross = u.from_alpha * u.to_beta - u.from_beta * u.to_alpha
    dot = u.from_alpha * u.to_alpha + u.from_beta * u.to_beta
    angle = arctan2(cross, dot)
    df = wrap(angle - x.angle) / (2.0 * math.pi * dt)
    alike = absolute(v_from - v_to).real < p.dv_max.real and absolute(df).real < p.df_max.real
    alike = alike and absolute(angle).real < p.dtheta_max.real
    x_next.angle = angle
    x_next.in_step = x.in_step + dt if alike else 0.0
    dead = minimum(v_from, v_to).real < p.v_dead.real

    y.refused = 0.0
    if u.close.real < 0.5:
        x_next.closed = 0.0
    elif x.closed.real < 0.5:
        if dead or x_next.in_step.real > p.hold.real:
            x_next.closed = 1.0
        else:
            y.refused = 1.0
    y.closed = x_next.closed
    y.position = 1.0 - x_next.closed


class AcDerived:
    """Base."""

    v_b: Volt = signal("base voltage, peak of a phase")


def ac_derive(p: AcBreakerControl) -> dict[str, float]:
    """Base voltage."""
    return {"v_b": math.sqrt(2.0 / 3.0) * p.v_n}


@component(
    state=AcState,
    input=AcInput,
    output=SequenceOutput,
    derived=AcDerived,
    derive=ac_derive,
    update=ac_update,
    stage="supervise",
)
class AcBreakerControl(AcDerived):
    """Closes on a dead bar, or when both sides have been in step for a while."""

    v_n: Volt = param("nominal voltage, line to line, rms", default=400.0, above=0.0, source="[DAgostino2020] table A1")
    dtheta_max: Radian = param(
        "largest angle", default=math.radians(2.0), above=0.0, source="synchronising rule, 2 deg"
    )
    df_max: Hertz = param("largest difference of frequency", default=0.05, above=0.0, source="synchronising rule")
    dv_max: PerUnit = param("largest difference of voltage", default=0.01, above=0.0, source="synchronising rule")
    hold: Second = param("time in step before closing", default=0.2, at_least=0.0, source="synchronising rule")
    v_dead: PerUnit = param("below this a bar is dead", default=0.05, above=0.0, source="dead-bus rule")


def publish_position(net: Network, name: str, refusals: Mapping[int, str]) -> None:
    """Make the position public, and log its changes and refusals."""
    net.publish(f"{name}.closed", source=f"{name}.sequence.closed", unit="1", description="1: closed")
    net.watch_state(name, f"{name}.sequence.closed", STATES)
    net.watch_refusal(name, f"{name}.sequence.refused", refusals)


DC_REFUSALS = {1: "the voltages of the buses differ too much"}
AC_REFUSALS = {1: "both bars are live and not in step"}


@equipment(
    "dc_breaker",
    commands=(switch("close", "close the tie", refusals=DC_REFUSALS),),
    signals=(
        Published("i", "A", "tie current, from the first bus to the second"),
        Published("closed", "1", "1: closed"),
    ),
    states=STATES,
)
class DcBreaker:
    """Breaker and cable between two DC buses."""

    from_: str = reference("bus the current is counted from", "dc")
    to: str = reference("bus the current is counted to", "dc")
    length: Metre = param("length of the cable", default=30.0, above=0.0, source="typical")
    R_on: Ohm = param("resistance of the closed contacts", default=1e-4, at_least=0.0, source="typical")
    dv_max: Volt = param("largest difference at closing", default=10.0, above=0.0, source="else precharge")

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Place cable and control, and publish."""
        a, b = ship.bus(self.from_), ship.bus(self.to)
        cable = dc_cable(self.length, self.R_on)
        net.add(f"{name}.branch", cable, ports={"branch": Across(a, b)}, variant=f"{name}.sequence.position")
        inputs = {"close": net.command(f"{name}.close"), "v_from": a.nodes[0], "v_to": b.nodes[0]}
        net.add(f"{name}.sequence", DcBreakerControl(dv_max=self.dv_max), inputs=inputs, clock=Every(10e-3))
        description = "tie current, from the first bus to the second"
        net.publish(f"{name}.i", source=f"{name}.branch.i", unit="A", description=description)
        publish_position(net, name, DC_REFUSALS)


@equipment(
    "ac_breaker",
    commands=(switch("close", "close the tie", refusals=AC_REFUSALS),),
    signals=(Published("closed", "1", "1: closed"),),
    states=STATES,
)
class AcBreaker:
    """Breaker and cable between two AC bars."""

    from_: str = reference("one bar", "ac")
    to: str = reference("the other bar", "ac")
    length: Metre = param("length of the cable", default=10.0, above=0.0, source="typical")
    R_on: Ohm = param("resistance of a closed contact", default=1e-4, at_least=0.0, source="typical")

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Place cable and control, and publish."""
        a, b = ship.bus(self.from_), ship.bus(self.to)
        cable = ac_cable(self.length, self.R_on)
        net.add_three_phase(
            f"{name}.branch", cable, ports={"branch": Across(a, b)}, variant=f"{name}.sequence.position"
        )
        names = ("from_alpha", "from_beta", "to_alpha", "to_beta")
        inputs = {"close": net.command(f"{name}.close")} | dict(zip(names, a.nodes + b.nodes, strict=True))
        net.add(f"{name}.sequence", AcBreakerControl(v_n=a.v_n), inputs=inputs, clock=Every(10e-3))
        publish_position(net, name, AC_REFUSALS)
