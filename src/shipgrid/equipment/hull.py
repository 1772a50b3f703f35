"""The hull of a ship file: displacement, wake, thrust deduction, resistance; it adds up the thrust of every screw."""

from __future__ import annotations

from typing import Any

from shipgrid.components.marine.hull import N_POINTS, Hull
from shipgrid.components.marine.thrust_sum import ThrustSum
from shipgrid.equipment.declaration import Published, choice, equipment
from shipgrid.model import param
from shipgrid.model.network import Every, Network
from shipgrid.units import KNOT, Kilogram, Newton, Ratio

PRESETS = {"table": 180.6, "paper_fit": 216.0}
"""Resistance over speed squared [N/kn2]: 18.06 kN at 10 kn ([DAgostino2020] table A1), and the fit of its fig. 7d."""
T_MARINE = 1e-3
"""Period of screws and hull [s]: the fastest of their time constants (shaft with screw) is 2 s."""


@equipment(
    "hull",
    signals=(
        Published("u_ship", "m/s", "speed through the water, positive ahead"),
        Published("acceleration", "m/s2", "acceleration of the ship"),
        Published("distance", "m", "distance made good ahead", "slow"),
        Published("resistance", "N", "resistance in still water, with the sign of the speed"),
    ),
)
class HullForm:
    """A hull in surge; the default is the ferry of [DAgostino2020]."""

    displacement: Kilogram = param("displacement", default=377e3, above=0.0, source="[DAgostino2020] table A1")
    added_mass: Kilogram = param(
        "added mass in surge", default=30.16e3, at_least=0.0, source="[DAgostino2020] table A1"
    )
    wake: Ratio = param("wake fraction", default=0.235, at_least=0.0, below=1.0, source="[DAgostino2020] table A1")
    thrust_deduction: Ratio = param(
        "thrust deduction", default=0.205, at_least=0.0, below=1.0, source="[DAgostino2020] table A1"
    )
    resistance: str = choice(
        "table: 0.1806 kN/kn2; paper_fit: 0.216 kN/kn2; lookup: r_2kn to r_12kn",
        "table",
        "paper_fit",
        "lookup",
        default="table",
    )
    r_2kn: Newton = param("resistance at 2 kn, for lookup", default=722.4, at_least=0.0, source="as table")
    r_4kn: Newton = param("resistance at 4 kn, for lookup", default=2889.6, at_least=0.0, source="as table")
    r_6kn: Newton = param("resistance at 6 kn, for lookup", default=6501.6, at_least=0.0, source="as table")
    r_8kn: Newton = param("resistance at 8 kn, for lookup", default=11558.4, at_least=0.0, source="as table")
    r_10kn: Newton = param("resistance at 10 kn, for lookup", default=18060.0, at_least=0.0, source="as table")
    r_12kn: Newton = param("resistance at 12 kn, for lookup", default=26006.4, at_least=0.0, source="as table")

    def component(self) -> Hull:
        """The hull as a component."""
        at_kn = [2 * k for k in range(1, N_POINTS + 1)]
        if self.resistance == "lookup":
            points = [getattr(self, f"r_{speed}kn") for speed in at_kn]
        else:
            points = [PRESETS[self.resistance] * speed**2 for speed in at_kn]
        return Hull(
            m=self.displacement,
            m_add=self.added_mass,
            w_f=self.wake,
            t_f=self.thrust_deduction,
            u_step=2.0 * KNOT,
            **{f"R_{k}": value for k, value in enumerate(points, start=1)},
        )

    def build(self, net: Network, name: str, ship: Any) -> None:
        """Wire the screws of all propulsions to the hull."""
        every = Every(T_MARINE)
        inputs: dict[str, str | float] = {}
        for k, item in enumerate(ship.items("propulsion")):
            thrust = f"{item}.propeller.thrust"
            if k:
                net.add(
                    f"{name}.sum_{k}", ThrustSum(), inputs={"first": inputs["thrust"], "second": thrust}, clock=every
                )
                thrust = f"{name}.sum_{k}.total"
            inputs["thrust"] = thrust
        net.add(f"{name}.surge", self.component(), inputs=inputs, clock=every)
        for public in type(self).__equipment__.signals:  # type: ignore[attr-defined]
            net.publish(
                f"{name}.{public.name}",
                source=f"{name}.surge.{public.name}",
                unit=public.unit,
                description=public.description,
                group=public.group,
            )
