"""Electromagnetic-transient simulation of shipboard DC microgrids: the public names.

    import shipgrid as sg

    run = sg.simulate(sg.load_ship("ferry"), sg.load_scenario("mission"), out="results/mission")
    run["dc_for.v_dc"].plot()

    with sg.Session(sg.Case("ferry", "mission")) as session:
        session.advance(to=300.0)
        session.command("genset_for.on", True)
        session.read("dc_for.v_dc")

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
    from shipgrid import units
    from shipgrid.analysis.frequency_response import FrequencyResponse, impedance, loop_gain
    from shipgrid.analysis.linearise import LinearModel, linearise
    from shipgrid.analysis.modes import Mode, Modes
    from shipgrid.analysis.steady_state import OperatingPoint, steady_state
    from shipgrid.components.converters.two_level_bridge import HalfBridge, TwoLevelBridge
    from shipgrid.components.electrical.breaker import Breaker
    from shipgrid.components.electrical.capacitor import Capacitor
    from shipgrid.components.electrical.choke import Choke
    from shipgrid.components.electrical.coupled_inductors import CoupledInductors
    from shipgrid.components.electrical.dc_load import DcLoad
    from shipgrid.components.electrical.lcl_filter import LclFilter
    from shipgrid.components.electrical.load import Load
    from shipgrid.components.electrical.resistor import Resistor
    from shipgrid.components.electrical.rl_branch import RlBranch
    from shipgrid.components.electrical.rlc_branch import RlcBranch
    from shipgrid.components.electrical.saturable_core import SaturableCore
    from shipgrid.components.electrical.saturable_transformer import SaturableTransformer
    from shipgrid.components.electrical.three_pole_breaker import ThreePoleBreaker
    from shipgrid.components.electrical.transformer import Transformer
    from shipgrid.components.electrical.voltage_dependent_load import VoltageDependentLoad
    from shipgrid.components.machines.induction_motor import InductionMotor
    from shipgrid.components.machines.pmsm import Pmsm
    from shipgrid.components.marine.hull import Hull
    from shipgrid.components.marine.propeller import Propeller
    from shipgrid.components.mechanical.diesel_engine import DieselEngine
    from shipgrid.components.mechanical.shaft import Shaft
    from shipgrid.components.sources.battery import Battery
    from shipgrid.components.sources.dc_source import CurrentSource, DcSource, InductiveDcSource
    from shipgrid.components.sources.supercapacitor import Supercapacitor
    from shipgrid.components.sources.synchronous_generator import SynchronousGenerator
    from shipgrid.components.sources.three_phase_source import ThreePhaseSource
    from shipgrid.controllers.exciter_ac1a import Ac1a
    from shipgrid.controllers.governor_degov1 import Degov1
    from shipgrid.equipment.ship import Ship
    from shipgrid.io.case import Case
    from shipgrid.io.scenario_file import Scenario, load_scenario
    from shipgrid.io.ship_file import load_ship
    from shipgrid.model import Terminal, component, kernel, param, signal
    from shipgrid.model.connections import Across, Pole, Pole3
    from shipgrid.model.network import Network
    from shipgrid.model.placed import Every, Sampled
    from shipgrid.modulators.averaged import AveragedBridge, AveragedLeg, DirectBridge
    from shipgrid.modulators.hysteresis import HysteresisBridge
    from shipgrid.modulators.open_loop import SineModulation
    from shipgrid.modulators.time_stamped import Carrier, TimeStampedBridge, TimeStampedLeg
    from shipgrid.scenarios.circuit import CircuitRun, assemble, plan
    from shipgrid.scenarios.events import At, Close, Open, Set
    from shipgrid.scenarios.results import Results, open_results
    from shipgrid.scenarios.session import Session, SessionState
    from shipgrid.scenarios.simulate import simulate

__version__ = "0.1.0"

__all__ = [
    "Ac1a",
    "Across",
    "At",
    "AveragedBridge",
    "AveragedLeg",
    "Battery",
    "Breaker",
    "Capacitor",
    "Carrier",
    "Case",
    "Choke",
    "CircuitRun",
    "Close",
    "CoupledInductors",
    "CurrentSource",
    "DcLoad",
    "DcSource",
    "Degov1",
    "DieselEngine",
    "DirectBridge",
    "Every",
    "FrequencyResponse",
    "HalfBridge",
    "Hull",
    "HysteresisBridge",
    "InductionMotor",
    "InductiveDcSource",
    "LclFilter",
    "LinearModel",
    "Load",
    "Mode",
    "Modes",
    "Network",
    "Open",
    "OperatingPoint",
    "Pmsm",
    "Pole",
    "Pole3",
    "Propeller",
    "Resistor",
    "Results",
    "RlBranch",
    "RlcBranch",
    "Sampled",
    "SaturableCore",
    "SaturableTransformer",
    "Scenario",
    "Session",
    "SessionState",
    "Set",
    "Shaft",
    "Ship",
    "SineModulation",
    "Supercapacitor",
    "SynchronousGenerator",
    "Terminal",
    "ThreePhaseSource",
    "ThreePoleBreaker",
    "TimeStampedBridge",
    "TimeStampedLeg",
    "Transformer",
    "TwoLevelBridge",
    "VoltageDependentLoad",
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
    "plan",
    "signal",
    "simulate",
    "steady_state",
    "units",
]

_HOMES = {
    "shipgrid.analysis.frequency_response": ("FrequencyResponse", "impedance", "loop_gain"),
    "shipgrid.analysis.linearise": ("LinearModel", "linearise"),
    "shipgrid.analysis.modes": ("Mode", "Modes"),
    "shipgrid.analysis.steady_state": ("OperatingPoint", "steady_state"),
    "shipgrid.components.converters.two_level_bridge": ("HalfBridge", "TwoLevelBridge"),
    "shipgrid.components.electrical.breaker": ("Breaker",),
    "shipgrid.components.electrical.capacitor": ("Capacitor",),
    "shipgrid.components.electrical.choke": ("Choke",),
    "shipgrid.components.electrical.coupled_inductors": ("CoupledInductors",),
    "shipgrid.components.electrical.lcl_filter": ("LclFilter",),
    "shipgrid.components.electrical.load": ("Load",),
    "shipgrid.components.electrical.resistor": ("Resistor",),
    "shipgrid.components.electrical.rl_branch": ("RlBranch",),
    "shipgrid.components.electrical.rlc_branch": ("RlcBranch",),
    "shipgrid.components.electrical.saturable_core": ("SaturableCore",),
    "shipgrid.components.electrical.saturable_transformer": ("SaturableTransformer",),
    "shipgrid.components.electrical.three_pole_breaker": ("ThreePoleBreaker",),
    "shipgrid.components.electrical.transformer": ("Transformer",),
    "shipgrid.components.electrical.dc_load": ("DcLoad",),
    "shipgrid.components.electrical.voltage_dependent_load": ("VoltageDependentLoad",),
    "shipgrid.components.machines.induction_motor": ("InductionMotor",),
    "shipgrid.components.machines.pmsm": ("Pmsm",),
    "shipgrid.components.sources.dc_source": ("CurrentSource", "DcSource", "InductiveDcSource"),
    "shipgrid.components.sources.supercapacitor": ("Supercapacitor",),
    "shipgrid.components.sources.synchronous_generator": ("SynchronousGenerator",),
    "shipgrid.components.sources.three_phase_source": ("ThreePhaseSource",),
    "shipgrid.components.marine.hull": ("Hull",),
    "shipgrid.components.marine.propeller": ("Propeller",),
    "shipgrid.components.mechanical.shaft": ("Shaft",),
    "shipgrid.components.mechanical.diesel_engine": ("DieselEngine",),
    "shipgrid.components.sources.battery": ("Battery",),
    "shipgrid.controllers.governor_degov1": ("Degov1",),
    "shipgrid.controllers.exciter_ac1a": ("Ac1a",),
    "shipgrid.io.case": ("Case",),
    "shipgrid.io.scenario_file": ("Scenario", "load_scenario"),
    "shipgrid.io.ship_file": ("Ship", "load_ship"),
    "shipgrid.model": ("Terminal", "component", "kernel", "param", "signal"),
    "shipgrid.model.connections": ("Across", "Pole", "Pole3"),
    "shipgrid.model.network": ("Network",),
    "shipgrid.model.placed": ("Every", "Sampled"),
    "shipgrid.modulators.averaged": ("AveragedBridge", "AveragedLeg", "DirectBridge"),
    "shipgrid.modulators.hysteresis": ("HysteresisBridge",),
    "shipgrid.modulators.open_loop": ("SineModulation",),
    "shipgrid.modulators.time_stamped": ("Carrier", "TimeStampedBridge", "TimeStampedLeg"),
    "shipgrid.scenarios.circuit": ("CircuitRun", "assemble", "plan"),
    "shipgrid.scenarios.events": ("At", "Close", "Open", "Set"),
    "shipgrid.scenarios.results": ("Results", "open_results"),
    "shipgrid.scenarios.session": ("Session", "SessionState"),
    "shipgrid.scenarios.simulate": ("simulate",),
}


def __getattr__(name: str) -> Any:
    if name == "units":
        return importlib.import_module("shipgrid.units")
    for home, names in _HOMES.items():
        if name in names:
            value = getattr(importlib.import_module(home), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'shipgrid' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
