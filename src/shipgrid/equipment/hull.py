"""The hull of a ship file: displacement, wake, thrust deduction, resistance, and the wind and waves it meets.

It adds up the thrust of every screw. Wind and waves are commands as a scenario gives them, but nobody's on board.
"""

from __future__ import annotations

import math
from typing import Any

from shipgrid.components.marine.hull import RESISTANCE_POINT, SPEED_POINT, Hull
from shipgrid.components.marine.thrust_sum import ThrustSum
from shipgrid.components.marine.wind_and_waves import WindAndWaves
from shipgrid.equipment.declaration import Command, Published, block, curve, equipment
from shipgrid.model import param
from shipgrid.model.network import Network
from shipgrid.model.placed import Every
from shipgrid.units import Kilogram, Ratio

PRESETS = {"table": RESISTANCE_POINT, "paper_fit": 21.6e3}
"""Resistance [N] at 10 kn, with the square of speed: [DAgostino2020] table A1, and the fit of its fig. 7d."""
WIND_MAX, WAVES_MAX = 40.0, 3.0
"""Largest wind [m/s] and significant wave height [m] that can be asked for."""
T_MARINE = 1e-3
"""Period of screws and hull [s]: the fastest of their time constants (shaft with screw) is 2 s."""


@equipment(
    "hull",
    commands=(
        Command("wind_speed", "m/s", "true wind, along the ship", 0.0, WIND_MAX, 0.0),
        Command(
            "wind_from", "rad", "where the wind comes from: angle from the bow", -2.0 * math.pi, 2.0 * math.pi, 0.0
        ),
        Command(
            "wave_height", "m", "significant height of a head sea, from the way the ship goes", 0.0, WAVES_MAX, 0.0
        ),
    ),
    signals=(
        Published("u_ship", "m/s", "speed through the water, positive ahead"),
        Published("acceleration", "m/s2", "acceleration of the ship"),
        Published("distance", "m", "distance made good ahead", "slow"),
        Published("resistance", "N", "resistance in still water, with the sign of the speed"),
        Published("T_wind", "N", "added resistance of the wind, positive against the ship going ahead", "slow"),
        Published("T_wave", "N", "added resistance of the waves, positive against the ship going ahead", "slow"),
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
    resistance: str | tuple[tuple[float, float], ...] = curve(
        "table: 18.06 kN at 10 kn; paper_fit: 21.6 kN at 10 kn; or pairs of speed and resistance, both rising",
        "table",
        "paper_fit",
        units=("m/s", "N"),
        default="table",
    )
    weather: WindAndWaves = block(WindAndWaves)

    def component(self) -> Hull:
        """The hull as a component."""
        given = self.resistance
        return Hull(
            m=self.displacement,
            m_add=self.added_mass,
            w_f=self.wake,
            t_f=self.thrust_deduction,
            resistance=((SPEED_POINT, PRESETS[given]),) if isinstance(given, str) else given,
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
        weather = {command: net.command(f"{name}.{command}") for command in ("wind_speed", "wind_from", "wave_height")}
        weather["u_ship"] = f"{name}.surge.u_ship"
        net.add(f"{name}.weather", self.weather, inputs=weather, clock=every)
        inputs["T_env"] = f"{name}.weather.T_env"
        net.add(f"{name}.surge", self.component(), inputs=inputs, clock=every)
        for public in type(self).__equipment__.signals:  # type: ignore[attr-defined]
            part = "weather" if public.name in ("T_wind", "T_wave") else "surge"
            net.publish(
                f"{name}.{public.name}",
                source=f"{name}.{part}.{public.name}",
                unit=public.unit,
                description=public.description,
                group=public.group,
            )
