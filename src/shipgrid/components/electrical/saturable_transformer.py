"""Three-phase transformer whose core saturates: primary winding, core and secondary winding, placed together.

    net.add("transformer", SaturableTransformer.per_unit(50e3, 400.0, 230.0, 60.0), primary=bar, secondary=lights)

It is the T of `components/electrical/transformer.py` with a knee in its magnetising branch. Its parts are components by
themselves, on a bus of their own: `transformer.primary`, `transformer.core`, `transformer.secondary`, and the bus
`transformer.inner`, whose voltage is the core's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from shipgrid.components.electrical.rl_branch import RlBranch
from shipgrid.components.electrical.saturable_core import SaturableCore
from shipgrid.components.electrical.secondary_winding import SecondaryWinding
from shipgrid.components.electrical.transformer import Transformer
from shipgrid.errors import TopologyError
from shipgrid.model.connections import AcBus
from shipgrid.model.network import Network


@dataclass(frozen=True, kw_only=True)
class SaturableTransformer:
    """Transformer with a saturable core, of three components.

    Parameters
    ----------
    windings : Transformer
        Ratio, vector group, resistances and leakages; its magnetising branch is not read.
    core : SaturableCore
        The magnetising branch, on the primary side.
    """

    windings: Transformer
    core: SaturableCore

    @classmethod
    def per_unit(
        cls,
        rating: float,
        v_1n: float,
        v_2n: float,
        f_n: float,
        *,
        group: str = "Dyn11",
        X: float = 0.10,
        R: float = 0.005,
        X_m: float = 500.0,
        R_m: float = 500.0,
        knee: float = 1.2,
        X_sat: float = 0.32,
    ) -> SaturableTransformer:
        """Transformer from its vector group and per-unit values, the series impedance split in halves.

        Parameters
        ----------
        rating, v_1n, v_2n, f_n, group, X, R, X_m, R_m
            As of `Transformer.per_unit`.
        knee : float
            Flux at the knee, over the peak at rated voltage.
        X_sat : float
            Reactance of the core beyond the knee [pu].

        Returns
        -------
        SaturableTransformer
        """
        windings = Transformer.per_unit(rating, v_1n, v_2n, f_n, group=group, X=X, R=R, X_m=X_m, R_m=R_m)
        omega = 2.0 * math.pi * f_n
        core = SaturableCore(
            L_m=windings.L_m,
            R_m=windings.R_m,
            L_sat=X_sat * v_1n**2 / rating / omega,
            psi_knee=knee * math.sqrt(2.0 / 3.0) * v_1n / omega,
            turn=math.pi / 6.0 if group.startswith("D") else 0.0,
        )
        return cls(windings=windings, core=core)

    def place(self, net: Network, path: str, ends: dict[str, Any]) -> None:
        """Place the parts, between the AC buses `primary` and `secondary`."""
        if set(ends) != {"primary", "secondary"} or not all(isinstance(end, AcBus) for end in ends.values()):
            raise TopologyError(
                f"{path} (SaturableTransformer) has the three-phase terminals ['primary', 'secondary'], expected an AC "
                f"bus at each; connected are {sorted(ends)}"
            )
        w = self.windings
        inner = net.ac_bus(f"{path}.inner", w.v_1n, ends["primary"].f_n)
        net.add(f"{path}.primary", RlBranch(R=w.R_1, L=w.L_1), a=ends["primary"], b=inner)
        net.add(f"{path}.core", self.core, a=inner)
        secondary = SecondaryWinding(v_1n=w.v_1n, v_2n=w.v_2n, R_2=w.R_2, L_2=w.L_2, clock=w.clock)
        net.add(f"{path}.secondary", secondary, core=inner, line=ends["secondary"])
