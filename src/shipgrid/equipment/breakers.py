"""Tie breakers with their cables, between two DC buses or two AC bars, and the rules of closing.

A DC breaker obeys 'open' at once, under load too; it closes when its rule allows, and says why as long as it does not.
An AC breaker synchronises before it closes and unloads before it opens (`automation/ac_tie.py`). Either way its current
is set to zero when it opens (an AC breaker would wait for the current's zero, half a period at most).
"""

from __future__ import annotations

import dataclasses
from typing import Any

from shipgrid.automation.ac_tie import REFUSALS as AC_REFUSALS
from shipgrid.automation.ac_tie import STATES as AC_STATES
from shipgrid.automation.ac_tie import AcTie
from shipgrid.components.electrical.cable import ac_cable, dc_cable
from shipgrid.equipment.declaration import Published, block, equipment, reference, switch
from shipgrid.errors import TopologyError
from shipgrid.model import component, kernel, param, signal
from shipgrid.model.connections import Across
from shipgrid.model.network import Network
from shipgrid.model.ops import absolute
from shipgrid.model.placed import Every
from shipgrid.units import Metre, Ohm, Ratio, Volt

STATES = {0: "open", 1: "closed"}
AC_CONTROL_PERIOD = 1e-3
"""Clock of an AC tie's control [s]: a sixteenth of a cycle."""


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


DC_REFUSALS = {1: "the voltages of the buses differ too much"}


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
        net.publish(f"{name}.closed", source=f"{name}.sequence.closed", unit="1", description="1: closed")
        net.watch_state(name, f"{name}.sequence.closed", STATES)
        net.watch_refusal(name, f"{name}.sequence.refused", DC_REFUSALS)


@equipment(
    "ac_breaker",
    commands=(switch("close", "close the tie, after synchronising the bars", refusals=AC_REFUSALS),),
    signals=(Published("closed", "1", "1: closed"),),
    states=AC_STATES,
)
class AcBreaker:
    """Breaker and cable between two AC bars, with its synchroniser.

    The inverters on the bar `to` are moved for it, those on `from_` where `to` has none.
    """

    from_: str = reference("one bar", "ac")
    to: str = reference("the other bar, whose inverters are moved when the tie closes or opens", "ac")
    length: Metre = param("length of the cable", default=10.0, above=0.0, source="typical")
    R_on: Ohm = param("resistance of a closed contact", default=1e-4, at_least=0.0, source="typical")
    control: AcTie = block(AcTie)

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Place cable and control, and publish."""
        a, b = ship.bus(self.from_), ship.bus(self.to)
        cable = ac_cable(self.length, self.R_on)
        net.add_three_phase(
            f"{name}.branch", cable, ports={"branch": Across(a, b)}, variant=f"{name}.sequence.position"
        )
        bar, sign = moved_bar(self, ship)
        rating = sum(item.rating for item in ship.items("inverter").values() if item.grid == bar)
        names = ("from_alpha", "from_beta", "to_alpha", "to_beta")
        net.add(
            f"{name}.sequence",
            dataclasses.replace(self.control, v_n=a.v_n, sign=sign, **({"S_n": rating} if rating else {})),
            inputs={"close": net.command(f"{name}.close")}
            | dict(zip(names, a.nodes + b.nodes, strict=True))
            | {f"i_{axis}": f"{name}.branch.{axis}.i" for axis in ("alpha", "beta")},
            clock=Every(AC_CONTROL_PERIOD),
        )
        net.publish(f"{name}.closed", source=f"{name}.sequence.closed", unit="1", description="1: closed")
        net.watch_state(name, f"{name}.sequence.code", AC_STATES)
        net.watch_refusal(name, f"{name}.sequence.refused", AC_REFUSALS)


def moved_bar(tie: AcBreaker, ship: Any) -> tuple[str, float]:
    """Bar whose inverters a tie moves, and the sense in which its trims act there."""
    fed = {item.grid for item in ship.items("inverter").values()}
    return (tie.to, 1.0) if tie.to in fed or tie.from_ not in fed else (tie.from_, -1.0)


def trims_of(bar: str, ship: Any) -> dict[str, str]:
    """Trims for the inverters of a bar, by the control's input, from the tie or shore connection that moves it.

    Raises
    ------
    TopologyError
        If two move it.
    """
    ties = [name for name, tie in ship.items("ac_breaker").items() if moved_bar(tie, ship)[0] == bar]
    ties += [name for name, shore in ship.items("shore_connection").items() if shore.bus == bar]
    if len(ties) > 1:
        raise TopologyError(
            f"{' and '.join(ties)} both move {bar}, expected one: exchange 'from' and 'to' of a tie, or move a shore "
            "connection to another bar"
        )
    return {trim: f"{ties[0]}.sequence.{trim}" for trim in ("dw_sync", "dV_sync", "dp_sync")} if ties else {}
