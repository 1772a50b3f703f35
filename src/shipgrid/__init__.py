"""Electromagnetic-transient simulation of shipboard DC microgrids: the public names.

    import shipgrid as sg

    run = sg.simulate(sg.load_ship("ferry"), sg.load_scenario("mission"), out="results/mission")
    run["dc_for.v_dc"].plot()

A run always writes its output folder. Without `out` that is `results/<scenario>-<fidelity>` in the current directory,
and an older folder of results in that place is replaced.

Operating points and small signals of any plan: `steady_state`, `linearise`, and `modes()`, `impedance`, `loop_gain` of
what they return.

Below ships and scenarios there is the circuit level (`Network`, its buses and connections, `assemble`), and below that
the declaration of a device (`component`, `kernel`, `param`, `signal`). Errors are those of `shipgrid.errors`. Names are
imported when they are first used, so that `import shipgrid` is immediate.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from shipgrid.analysis.equilibrium import OperatingPoint, steady_state
    from shipgrid.analysis.frequency_response import FrequencyResponse, impedance, loop_gain
    from shipgrid.analysis.linearise import LinearModel, linearise
    from shipgrid.analysis.modes import Mode, Modes
    from shipgrid.assembly.plan import assemble
    from shipgrid.io.scenario_file import Scenario, load_scenario
    from shipgrid.io.ship_file import Ship, load_ship
    from shipgrid.model import Terminal, component, kernel, param, signal
    from shipgrid.model.network import Across, Every, Network, Pole, Pole3, Sampled
    from shipgrid.scenarios.results import Results, open_results
    from shipgrid.scenarios.runner import simulate

__version__ = "0.1.0"

__all__ = [
    "Across",
    "Every",
    "FrequencyResponse",
    "LinearModel",
    "Mode",
    "Modes",
    "Network",
    "OperatingPoint",
    "Pole",
    "Pole3",
    "Results",
    "Sampled",
    "Scenario",
    "Ship",
    "Terminal",
    "__version__",
    "assemble",
    "component",
    "impedance",
    "kernel",
    "linearise",
    "load_scenario",
    "load_ship",
    "loop_gain",
    "open_results",
    "param",
    "signal",
    "simulate",
    "steady_state",
]

_HOMES = {
    "shipgrid.analysis.equilibrium": ("OperatingPoint", "steady_state"),
    "shipgrid.analysis.frequency_response": ("FrequencyResponse", "impedance", "loop_gain"),
    "shipgrid.analysis.linearise": ("LinearModel", "linearise"),
    "shipgrid.analysis.modes": ("Mode", "Modes"),
    "shipgrid.assembly.plan": ("assemble",),
    "shipgrid.io.scenario_file": ("Scenario", "load_scenario"),
    "shipgrid.io.ship_file": ("Ship", "load_ship"),
    "shipgrid.model": ("Terminal", "component", "kernel", "param", "signal"),
    "shipgrid.model.network": ("Across", "Every", "Network", "Pole", "Pole3", "Sampled"),
    "shipgrid.scenarios.results": ("Results", "open_results"),
    "shipgrid.scenarios.runner": ("simulate",),
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            value = getattr(importlib.import_module(home), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'shipgrid' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
