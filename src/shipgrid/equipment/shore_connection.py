"""Shore supply of an AC bar: grid, isolating transformer, and a breaker that synchronises the ship to the shore.

    Z_shore = v_n^2 / S_sc,   X / R as given;   Z_t = (R_t + j X_t) v_n^2 / rating          (1)

The grid ashore is stiff behind (1), at the bar's nominal voltage and frequency. The transformer is its series
impedance: it is live before the ship comes, so that its magnetising current is the shore's affair.

'Close' picks up a dead bar at once. A live bar is brought into step with the shore by the inverters on it, and then the
trims that did it are taken back along a straight line of 10 s: since the shore holds the nominal frequency, droop takes
the own units' active power to zero along that line, and the shore carries the load. The own units stay, unloaded; told
to go off they find that others feed the bar, and open. 'Open' unloads the connection first: the inverters on the bar
take the load back, and the breaker opens when hardly any power flows. Without an inverter that takes it, it opens at
once, and the bar is dead.

The control is that of an AC tie (`automation/ac_tie.py`). Source of the figures: docs/theory/loads.md.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from shipgrid.automation.ac_tie import REFUSALS, STATES, AcTie
from shipgrid.components.electrical.cable import ac_cable
from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.components.sources.three_phase_source import ThreePhaseSource
from shipgrid.equipment.breakers import AC_CONTROL_PERIOD
from shipgrid.equipment.declaration import Published, block, equipment, reference, switch
from shipgrid.equipment.inverter import InverterMeter
from shipgrid.model import param
from shipgrid.model.connections import Across
from shipgrid.model.network import Network
from shipgrid.model.placed import Every
from shipgrid.units import Metre, Ohm, PerUnit, Ratio, VoltAmpere

T_TRANSFER = 10.0
"""Time [s] in which the own units hand their load over."""

SIGNALS = (
    Published("p_ac", "W", "active power into the bar"),
    Published("q_ac", "var", "reactive power into the bar"),
    Published("closed", "1", "1: closed"),
)


@equipment(
    "shore_connection",
    commands=(switch("close", "connect the bar to the shore, after synchronising it", refusals=REFUSALS),),
    signals=SIGNALS,
    states=STATES,
)
class ShoreConnection:
    """Grid ashore, isolating transformer, cable and breaker, on one AC bar."""

    bus: str = reference("bar that it feeds", "ac")
    S_sc: VoltAmpere = param("short-circuit power ashore", default=5e6, above=0.0, source="typical, low voltage")
    X_R: Ratio = param("reactance over resistance ashore", default=5.0, above=0.0, source="typical")
    rating: VoltAmpere = param("rating of the transformer", default=100e3, above=0.0, source="both hotel inverters")
    X_t: PerUnit = param("leakage of the transformer", default=0.05, above=0.0, source="typical")
    R_t: PerUnit = param("resistance of the transformer", default=0.01, at_least=0.0, source="typical")
    length: Metre = param("length of the cable", default=30.0, above=0.0, source="typical")
    R_on: Ohm = param("resistance of a closed contact", default=1e-4, at_least=0.0, source="typical")
    control: AcTie = block(AcTie, t_decay=T_TRANSFER)

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Place grid, breaker and control, and publish."""
        bar = ship.bus(self.bus)
        omega = 2.0 * math.pi * bar.f_n
        z = bar.v_n**2 / self.S_sc
        r = z / math.hypot(1.0, self.X_R)
        terminals = net.ac_bus(f"{name}.terminals", bar.v_n, bar.f_n)
        supply = ThreePhaseSource(v_n=bar.v_n, f_n=bar.f_n, R=r, L=self.X_R * r / omega)
        net.add(f"{name}.supply", supply, a=terminals)
        cable, z_t = ac_cable(self.length, self.R_on), bar.v_n**2 / self.rating
        branch = RlBranch(R=cable.R + self.R_t * z_t, L=cable.L + self.X_t * z_t / omega)
        net.add_three_phase(
            f"{name}.branch", branch, ports={"branch": Across(terminals, bar)}, variant=f"{name}.sequence.position"
        )
        moved = sum(item.rating for item in ship.items("inverter").values() if item.grid == self.bus)
        names = ("from_alpha", "from_beta", "to_alpha", "to_beta")
        currents = {axis: f"{name}.branch.{axis}.i" for axis in ("alpha", "beta")}
        net.add(
            f"{name}.sequence",
            dataclasses.replace(self.control, v_n=bar.v_n, **({"S_n": moved} if moved else {})),
            inputs={"close": net.command(f"{name}.close")}
            | dict(zip(names, terminals.nodes + bar.nodes, strict=True))
            | {f"i_{axis}": current for axis, current in currents.items()},
            clock=Every(AC_CONTROL_PERIOD),
        )
        meter = dict(zip(("v_alpha", "v_beta"), bar.nodes, strict=True))
        meter |= {f"i_2_{axis}": current for axis, current in currents.items()}
        net.add(f"{name}.meter", InverterMeter(), inputs=meter)
        for signal, part in zip(SIGNALS, ("meter", "meter", "sequence"), strict=True):
            source = f"{name}.{part}.{signal.name}"
            net.publish(f"{name}.{signal.name}", source=source, unit=signal.unit, description=signal.description)
        alpha, beta = currents.values()
        net.publish_phases(f"{name}.i", alpha=alpha, beta=beta, unit="A", description="current from the shore")
        net.watch_state(name, f"{name}.sequence.code", STATES)
        net.watch_refusal(name, f"{name}.sequence.refused", REFUSALS)
