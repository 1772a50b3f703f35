"""The circuits of the gallery as netlists for ngspice, and what is compared of them.

Each circuit is a dictionary of its parameters in SI (those of its example in `examples/circuits`), a netlist written
from them, and the figures that are taken from its waves. The figures ask for waves by name and take times with them, so
that both programs are measured by the same lines (`waves.py`).

How the switches are modelled, for all of them alike:

- A controlled switch is ngspice's voltage-controlled switch, R_on or `R_OFF`, no slope in between. Upper and lower
  switch of a leg have the same control voltage with opposite signs: exactly one is closed, so that one R_on is
  always in series with the choke of the leg. It is *part of* the series resistance in the dictionary, which is
  what a simulator with ideal switches gets; the netlist's resistor has the rest.
- A diode is ngspice's junction diode with an emission coefficient of 0.03, which is 25 mV at 100 A in place of 0.8 V,
  and a bulk resistance that is part of the series resistance in the same way. The open switch's `R_OFF` lies
  across it: with none, the poles of a blocked bridge hang on nothing but rounding.
- Carrier, comparator and hysteresis are in the netlist where a reference varies: edges are found by ngspice, and only
  the sampled reference comes from here, a staircase of the values in force.
- With diodes the integration is Gear's second order, which damps: where a diode ends the current of a choke, the
  trapezoidal rule has the choke's voltage ring for ever, from step to step, and ngspice shortens the step to nothing.
- Tolerances are those of the quantities (kilovolts and kiloamperes: abstol, vntol, chgtol); the step is at most `STEP`.
  There are no snubbers, no ramps on sources, no changed limits of iterations.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from verification import waves
from verification.ngspice import run

STEP = 0.2e-6
"""Longest step of ngspice [s]."""

R_OFF = 1e6
"""Open switch [ohm]: below 1 mA at 750 V."""

COMMON = f"""\
.options reltol=1e-4 abstol=1e-6 vntol=1e-6 chgtol=1e-12
.model ideal sw(vt=0 vh=0 ron={{R_on}} roff={R_OFF:g})
"""

DIODE = """\
.options method=gear
.model junction d(is=1e-12 n=0.03 rs={R_on})
"""


@cache
def example(name: str) -> Any:
    """Module of an example of the folder `examples/circuits`."""
    path = Path(__file__).parents[2] / "examples" / "circuits" / f"plot_{name}.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Circuit:
    """One circuit of the gallery.

    Attributes
    ----------
    parameters : dict
        SI; series resistances include the switch or diode.
    netlist : callable
        `netlist(parameters)`, text.
    names : dict of str to str
        Our name of each wave, and ngspice's.
    figures : callable
        `figures(w, parameters)` of waves by our names, `w["time"]` among them.
    """

    parameters: dict[str, Any]
    netlist: Callable[[dict[str, Any]], str]
    names: dict[str, str]
    figures: Callable[[dict[str, np.ndarray], dict[str, Any]], dict[str, float]]

    def solve(self, **changed: float) -> dict[str, np.ndarray]:
        """Waves by ngspice, by our names, with some parameters changed."""
        found = run(self.netlist(self.parameters | changed))
        return {"time": found["time"]} | {ours: found[theirs] for ours, theirs in self.names.items()}


def saved(names: dict[str, str]) -> str:
    """Line that makes ngspice keep what is measured and nothing else."""
    return ".save " + " ".join(names.values()) + "\n"


def triangle(node: str, f: float) -> str:
    """Carrier from 1 at time zero to 0 and back; the corner of 1 ns is what ngspice needs for a pulse."""
    return f"Vtri {node} 0 pulse(1 0 0 {0.5 / f:.12g} {0.5 / f - 1e-9:.12g} 1n {1.0 / f:.12g})\n"


def gate(node: str, f: float, s: float) -> str:
    """Gate signal of constant duty ratio `s`, 1 or -1, its pulse in the middle of the carrier's period.

    ngspice sets steps on the edges of a source, but not on the crossing of two: of a leg at 5 kHz that is a tenth of a
    per cent of the energy a period.
    """
    T = 1.0 / f
    return f"V{node} {node} 0 pulse(-1 1 {0.5 * (1.0 - s) * T - 5e-10:.12g} 1n 1n {s * T - 1e-9:.12g} {T:.12g})\n"


def staircase(name: str, node: str, times: np.ndarray, values: np.ndarray) -> str:
    """Source that takes each value at its time, within 1 ns."""
    points = [f"0 {values[0]:.9g}"]
    for at, before, after in zip(times[1:], values[:-1], values[1:], strict=True):
        points += [f"{at:.12g} {before:.9g}", f"{at + 1e-9:.12g} {after:.9g}"]
    lines = [" ".join(points[k : k + 8]) for k in range(0, len(points), 8)]
    return f"{name} {node} 0 pwl(" + "\n+ ".join(lines) + ")\n"


def diode(name: str, anode: str, cathode: str) -> str:
    """Diode with the open switch across it."""
    return f"D{name} {anode} {cathode} junction\nRd{name} {anode} {cathode} {R_OFF:g}\n"


def three_phase(line: str) -> str:
    """`line` for each of the phases a, b, c, in place of its `#`."""
    return "".join(line.replace("#", phase) for phase in "abc")


# --- buck-boost converter with load step -----------------------------------------------------------------------------


def buck_boost_netlist(p: dict[str, Any]) -> str:
    i_l = p["v_dc_0"] / p["R_load"] / p["s"]
    v_c = p["e"] - p["R_b"] * i_l
    return (
        "* battery, choke, one leg, bus with a load that is doubled\n"
        + COMMON.format(**p)
        + f"Ve e 0 {p['e']}\n"
        + f"Rb e c {p['R_b']}\n"
        + f"Cb c 0 {p['C']} ic={v_c}\n"
        + f"Rl c l {p['R'] - p['R_on']}\n"
        + f"Ll l leg {p['L']} ic={i_l}\n"
        + gate("g", p["f_sw"], p["s"])
        + "Sup leg dc g 0 ideal\n"
        + "Slo leg 0 0 g ideal\n"
        + f"Cdc dc 0 {p['C_dc']} ic={p['v_dc_0']}\n"
        + f"Rload dc 0 {p['R_load']}\n"
        + f"Vstep step 0 pwl(0 -1 {p['t_step']} -1 {p['t_step'] + 1e-9:.12g} 1)\n"
        + "Sload dc more step 0 ideal\n"
        + f"Rmore more 0 {p['R_step'] - p['R_on']}\n"
        + f".tran {STEP} {p['t_end']} 0 {STEP} uic\n"
    )


def buck_boost_figures(w: dict[str, np.ndarray], p: dict[str, Any]) -> dict[str, float]:
    t, i, v, T = w["time"], w["i_l"], w["v_dc"], 1.0 / p["f_sw"]
    before, after = (p["t_step"] - 20 * T, p["t_step"]), (p["t_end"] - 20 * T, p["t_end"])
    dip, at = waves.peak(t, -v, p["t_step"], p["t_end"])
    highest, when = waves.peak(t, i, p["t_step"], p["t_end"])
    return {
        "i_l mean before": waves.mean(t, i, *before),
        "i_l mean after": waves.mean(t, i, *after),
        "i_l ripple before": waves.ripple(t, i, T, *before),
        "i_l ripple after": waves.ripple(t, i, T, *after),
        "v_dc mean before": waves.mean(t, v, *before),
        "v_dc mean after": waves.mean(t, v, *after),
        "v_dc lowest": -dip,
        "v_dc lowest at": at,
        "i_l peak": highest,
        "i_l peak at": when,
    }


BUCK_BOOST = example("buck_boost").CASE | {"R_on": 1e-3}

BUCK_BOOST_NAMES = {"i_l": "i(ll)", "v_dc": "v(dc)"}


# --- boost leg in discontinuous conduction ---------------------------------------------------------------------------


def boost_netlist(p: dict[str, Any]) -> str:
    return (
        "* the lower switch alone is driven: at light load the choke's current rests at zero\n"
        + COMMON.format(**p)
        + DIODE.format(**p)
        + f"Ve e 0 {p['e']}\n"
        + f"Rl e l {p['R'] - p['R_on']}\n"
        + f"Ll l leg {p['L']} ic=0\n"
        + gate("g", p["f_sw"], p["s"])
        + "Slo leg 0 0 g ideal\n"
        + diode("up", "leg", "dc")
        + f"Cdc dc 0 {p['C_dc']} ic={p['v_dc_0']}\n"
        + f"Rload dc 0 {p['R_load']}\n"
        + f".tran {STEP} {p['t_end']} 0 {STEP} uic\n"
    )


def boost_figures(w: dict[str, np.ndarray], p: dict[str, Any]) -> dict[str, float]:
    t, i, v, T = w["time"], w["i_l"], w["v_dc"], 1.0 / p["f_sw"]
    last = (p["t_end"] - 20 * T, p["t_end"])
    inside_t, inside_i = waves.part(t, i, *last)
    resting = np.interp(np.linspace(*last, 20001), inside_t, inside_i) < 0.05
    return {
        "i_l mean": waves.mean(t, i, *last),
        "i_l peak": waves.ripple(t, i, T, *last),
        "v_dc mean": waves.mean(t, v, *last),
        "share at rest": float(np.mean(resting)),
    }


BOOST = example("boost").CASE | {"R_on": 1e-3}

BOOST_NAMES = {"i_l": "i(ll)", "v_dc": "v(dc)"}


# --- three-phase inverter, LCL filter, R load ------------------------------------------------------------------------


def duty_ratios(alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Duty ratios (3, n) of a modulation vector with min-max injection."""
    phase = np.array([alpha, -0.5 * alpha + math.sqrt(0.75) * beta, -0.5 * alpha - math.sqrt(0.75) * beta])
    return 0.5 + phase - 0.5 * (phase.max(axis=0) + phase.min(axis=0))


def inverter_netlist(p: dict[str, Any]) -> str:
    times = np.arange(round(p["t_end"] * p["f_sample"]) + 1) / p["f_sample"]
    angle = 2.0 * math.pi * p["f"] * times
    duty = duty_ratios(p["m"] * np.cos(angle), p["m"] * np.sin(angle))
    return (
        "* two-level bridge, LCL filter, resistive star\n"
        + COMMON.format(**p)
        + f"Ve e 0 {p['e']}\n"
        + f"Rs e e1 {p['R_s']}\n"
        + f"Ls e1 dc {p['L_s']} ic=0\n"
        + f"Cdc dc 0 {p['C_dc']} ic={p['e']}\n"
        + triangle("tri", p["f_sw"])
        + "".join(staircase(f"Vs{k}", f"s{k}", times, row) for k, row in zip("abc", duty, strict=True))
        + three_phase("Sup# p# dc s# tri ideal\nSlo# p# 0 tri s# ideal\n")
        + three_phase(f"R1# p# x# {p['R_1'] - p['R_on']}\nL1# x# y# {p['L_1']} ic=0\n")
        + three_phase(f"Rd# y# z# {p['R_d']}\nC# z# star {p['C']} ic=0\n")
        + three_phase(f"R2# y# w# {p['R_2']}\nL2# w# o# {p['L_2']} ic=0\n")
        + three_phase(f"Rload# o# neutral {p['R_load']}\n")
        + f"Rstar star 0 {R_OFF:g}\nRneutral neutral 0 {R_OFF:g}\n"
        + f".tran {STEP} {p['t_end']} 0 {STEP} uic\n"
    )


def inverter_figures(w: dict[str, np.ndarray], p: dict[str, Any]) -> dict[str, float]:
    t, last = w["time"], (p["t_end"] - 2.0 / p["f"], p["t_end"])
    i_1 = waves.harmonics(t, w["i_1"], p["f"], *last, 100)
    i_2 = waves.harmonics(t, w["i_2"], p["f"], *last, 100)
    return {
        "i_1 fundamental": abs(i_1[0]),
        "i_1 angle": math.degrees(np.angle(i_1[0])),
        "i_1 thd": waves.thd(i_1),
        "i_1 at the carrier's lower sideband": abs(i_1[24]),
        "i_2 fundamental": abs(i_2[0]),
        "i_2 angle": math.degrees(np.angle(i_2[0])),
        "i_2 thd": waves.thd(i_2),
        "v_dc mean": waves.mean(t, w["v_dc"], *last),
        "v_dc ripple": waves.ripple(t, w["v_dc"], 1.0 / p["f"], *last),
        "i_s mean": waves.mean(t, w["i_s"], *last),
    }


INVERTER = example("inverter").CASE | {"R_on": 1e-3}

INVERTER_NAMES = {"i_1": "i(l1a)", "i_2": "i(l2a)", "v_dc": "v(dc)", "i_s": "i(ls)"}


# --- six-pulse diode rectifier with capacitor ------------------------------------------------------------------------


def sources(p: dict[str, Any]) -> str:
    """Three phases of peak `e`, phase a at its crest at time zero, about the node `n`."""
    return (
        "".join(f"Ve{k} e{k} n sin(0 {p['e']} {p['f']} 0 0 {90 - 120 * j})\n" for j, k in enumerate("abc"))
        + f"Rn n 0 {R_OFF:g}\n"
    )


def rectifier_netlist(p: dict[str, Any]) -> str:
    return (
        "* three-phase source, six diodes, capacitor, resistor\n"
        + COMMON.format(**p)
        + DIODE.format(**p)
        + sources(p)
        + three_phase(f"Rg# e# x# {p['R'] - p['R_on']}\nLg# x# p# {p['L']} ic=0\n")
        + three_phase(diode("up#", "p#", "dc") + diode("lo#", "0", "p#"))
        + f"Cdc dc 0 {p['C_dc']} ic={p['v_dc_0']}\n"
        + f"Rload dc 0 {p['R_load']}\n"
        + f".tran {STEP} {p['t_end']} 0 {STEP} uic\n"
    )


def rectifier_figures(w: dict[str, np.ndarray], p: dict[str, Any]) -> dict[str, float]:
    t, last = w["time"], (p["t_end"] - 2.0 / p["f"], p["t_end"])
    i = waves.harmonics(t, w["i_a"], p["f"], *last, 50)
    highest, when = waves.peak(t, w["i_a"], 0.0, p["t_end"])
    return {
        "v_dc mean": waves.mean(t, w["v_dc"], *last),
        "v_dc ripple": waves.ripple(t, w["v_dc"], 1.0 / (6.0 * p["f"]), *last),
        "i_a fundamental": abs(i[0]),
        "i_a angle": math.degrees(np.angle(i[0])),
        "i_a thd": waves.thd(i),
        "i_a fifth": abs(i[4]),
        "i_a peak": highest,
        "i_a peak at": when,
    }


RECTIFIER = example("diode_rectifier").CASE | {"R_on": 1e-3}

RECTIFIER_NAMES = {"i_a": "i(lga)", "v_dc": "v(dc)"}


# --- DC short circuit with freewheeling diodes -----------------------------------------------------------------------


def short_circuit_netlist(p: dict[str, Any]) -> str:
    return (
        "* motor at speed behind a blocked bridge, charged capacitor, short circuit of the bus\n"
        + COMMON.format(**p)
        + DIODE.format(**p)
        + sources(p)
        + three_phase(f"Rg# e# x# {p['R'] - p['R_on']}\nLg# x# p# {p['L']} ic=0\n")
        + three_phase(diode("up#", "p#", "dc") + diode("lo#", "0", "p#"))
        + f"Cdc dc 0 {p['C_dc']} ic={p['v_dc_0']}\n"
        + f"Vt t 0 pwl(0 -1 {p['t_fault']} -1 {p['t_fault'] + 1e-9:.12g} 1)\n"
        + "Sfault dc f t 0 ideal\n"
        + f"Rf f g {p['R_f'] - p['R_on']}\n"
        + f"Lf g 0 {p['L_f']} ic=0\n"
        + f".tran {STEP} {p['t_end']} 0 {STEP} uic\n"
    )


def short_circuit_figures(w: dict[str, np.ndarray], p: dict[str, Any]) -> dict[str, float]:
    t, i, v = w["time"], w["i_f"], w["v_dc"]
    highest, when = waves.peak(t, i, p["t_fault"], p["t_end"])
    empty = int(np.argmax((t > p["t_fault"]) & (v <= 0.0)))
    phase, phase_when = waves.peak(t, w["i_a"], p["t_fault"], p["t_end"])
    return {
        "i_f peak": highest,
        "i_f peak at": when - p["t_fault"],
        "v_dc zero at": float(np.interp(0.0, v[[empty, empty - 1]], t[[empty, empty - 1]])) - p["t_fault"],
        "i_f at 2 ms": float(np.interp(p["t_fault"] + 2e-3, t, i)),
        "i_f at 5 ms": float(np.interp(p["t_fault"] + 5e-3, t, i)),
        "i_f mean of the last cycle": waves.mean(t, i, p["t_end"] - 1.0 / p["f"], p["t_end"]),
        "i_a peak": phase,
        "i_a peak at": phase_when - p["t_fault"],
        "v_dc lowest": -waves.peak(t, -v, p["t_fault"], p["t_end"])[0],
    }


# Six separate diodes. `R` contains the one of a leg that conducts while the bus is not reversed. While it is reversed
# both share the current of the phase, which then has half of `R_on` in the netlist, and in ours half of it beside all
# of `R`: 2 mohm more, 0.1 % of the motor's current.
SHORT_CIRCUIT = example("short_circuit").CASE

SHORT_CIRCUIT_NAMES = {"i_f": "i(lf)", "i_a": "i(lga)", "v_dc": "v(dc)"}


# --- motor with hysteresis control -----------------------------------------------------------------------------------


def motor_netlist(p: dict[str, Any]) -> str:
    start = [p["i_ref"] * math.cos(math.radians(-120.0 * j)) for j in range(3)]
    return (
        "* motor at constant speed on a two-level bridge, each leg's comparator with hysteresis\n"
        + COMMON.format(**p)
        + f".model band sw(vt=0 vh={p['band']} ron={p['R_on']} roff={R_OFF:g})\n"
        + f"Vdc dc 0 {p['v_dc']}\n"
        + sources(p)
        + "".join(
            f"Vref{k} ref{k} 0 sin(0 {p['i_ref']} {p['f']} 0 0 {90 - 120 * j})\n"
            f"Hi{k} err{k} ref{k} Vi{k} -1\n"  # err = reference - current
            f"Sup{k} dc p{k} err{k} 0 band off\n"
            f"Slo{k} p{k} 0 0 err{k} band on\n"
            f"Vi{k} p{k} x{k} 0\n"
            f"Rg{k} x{k} y{k} {p['R'] - p['R_on']}\n"
            f"Lg{k} y{k} e{k} {p['L']} ic={start[j]:.9g}\n"
            for j, k in enumerate("abc")
        )
        + f".tran {STEP} {p['t_end']} 0 {STEP} uic\n"
    )


def motor_figures(w: dict[str, np.ndarray], p: dict[str, Any]) -> dict[str, float]:
    t, last = w["time"], (p["t_end"] - p["cycles"] / p["f"], p["t_end"])
    errors, rates, fundamentals = [], [], []
    for k, phase in enumerate("abc"):
        angle = 2.0 * math.pi * (p["f"] * t - k / 3.0)
        inside, error = waves.part(t, w[f"i_{phase}"] - p["i_ref"] * np.cos(angle), *last)
        errors.append(error)
        leg = waves.part(t, w[f"v_{phase}"], *last)[1] > 0.5 * p["v_dc"]
        rates.append(np.count_nonzero(np.diff(leg)) / 2.0 / (last[1] - last[0]))
        found = waves.harmonics(t, w[f"i_{phase}"], p["f"], *last, 1)[0]
        fundamentals.append(found * np.exp(2j * math.pi * k / 3.0))
    fundamental = np.mean(fundamentals)
    return {
        "i fundamental": abs(fundamental),
        "i angle": math.degrees(np.angle(fundamental)),
        "error rms": math.sqrt(np.mean([waves.rms(inside, error, *last) ** 2 for error in errors])),
        "error peak": float(np.max(np.abs(errors))),
        "edges up and down a second": float(np.mean(rates)),
    }


MOTOR = example("motor").CASE | {"R_on": 2e-3}

MOTOR_NAMES = {f"i_{k}": f"i(lg{k})" for k in "abc"} | {f"v_{k}": f"v(p{k})" for k in "abc"}


def _circuit(parameters: Any, netlist: Any, names: dict[str, str], figures: Any) -> Circuit:
    return Circuit(parameters, lambda p: netlist(p) + saved(names) + ".end\n", names, figures)


GALLERY = {
    "buck-boost": _circuit(BUCK_BOOST, buck_boost_netlist, BUCK_BOOST_NAMES, buck_boost_figures),
    "boost": _circuit(BOOST, boost_netlist, BOOST_NAMES, boost_figures),
    "inverter": _circuit(INVERTER, inverter_netlist, INVERTER_NAMES, inverter_figures),
    "diode-rectifier": _circuit(RECTIFIER, rectifier_netlist, RECTIFIER_NAMES, rectifier_figures),
    "short-circuit": _circuit(SHORT_CIRCUIT, short_circuit_netlist, SHORT_CIRCUIT_NAMES, short_circuit_figures),
    "motor": _circuit(MOTOR, motor_netlist, MOTOR_NAMES, motor_figures),
}


@cache
def solution(name: str) -> dict[str, np.ndarray]:
    """Waves of a circuit by ngspice, found once a process."""
    return GALLERY[name].solve()


@cache
def reference(name: str) -> dict[str, float]:
    """Figures of a circuit by ngspice."""
    return GALLERY[name].figures(solution(name), GALLERY[name].parameters)
