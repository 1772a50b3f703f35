"""A made-up run with the shape of the ferry's mission, for tests of whatever reads results."""

import json

import numpy as np

from shipgrid.scenarios.recorder import ResultsWriter
from shipgrid.scenarios.results import open_results

RUN_YAML = """\
schema: 1
ship: |
  ship: ferry
  buses:
    dc_for: {kind: dc, v_n: 750 V}
    dc_aft: {kind: dc, v_n: 750 V}
    ac_for: {kind: ac, v_n: 400 V, f_n: 60 Hz}
    ac_aft: {kind: ac, v_n: 400 V, f_n: 60 Hz}
  equipment:
"""
SIDE = """\
    genset_{x}:     {{kind: genset, rating: 596 kW}}
    rectifier_{x}:  {{kind: rectifier, source: genset_{x}, bus: dc_{x}, f_sw: 1620 Hz}}
    bess_{x}:       {{kind: bess, bus: dc_{x}, capacity: 128 Ah}}
    propulsion_{x}: {{kind: propulsion, bus: dc_{x}, rating: 270 kW, propeller: propeller_{x}}}
    inverter_{x}:   {{kind: inverter, bus: dc_{x}, grid: ac_{x}, rating: 50 kVA}}
    hotel_{x}:      {{kind: ac_load, bus: ac_{x}, p: 10 kW}}
"""
TIES = """\
    dc_tie: {kind: dc_breaker, from: dc_for, to: dc_aft, length: 30 m}
    ac_tie: {kind: ac_breaker, from: ac_for, to: ac_aft}
"""


def write(folder, n=20_000, finished=True):
    """Write a run of 3400 s with `n` rows."""
    t = np.linspace(0.0, 3400.0, n)
    random = np.random.default_rng(1)
    trip = 0.5144 * np.array([0, 6, 6, 10, 10, 6, 6, 0])
    speed = np.interp(t, [10, 130, 310, 400, 1390, 1480, 1560, 1700], trip)
    speed -= np.interp(t, [1810, 1930, 2110, 2200, 3150, 3250, 3320, 3395], trip)
    power = 71.8e3 * np.abs(speed / 5.144) ** 3
    on = {"for": ((t > 312) & (t < 1425)).astype(float), "aft": ((t > 2112) & (t < 3200)).astype(float)}
    any_on = on["for"] + on["aft"]
    soc = 0.5 + np.cumsum(np.where(any_on > 0, 1.1e-4, -0.3e-4)) * (t[1] - t[0])
    v_dc = 750.0 - 17.0 * any_on - 5e-5 * power * (1 - any_on)
    columns, values = [("hull.u_ship", "m/s", "speed through water")], [speed]
    for x in ("for", "aft"):
        rows = {
            f"dc_{x}.v_dc": ("V", v_dc + (0.2 if x == "aft" else 0.0)),
            f"bess_{x}.i_b": ("A", np.where(any_on > 0, -72.0, power / 500.0)),
            f"bess_{x}.soc": ("1", soc),
            f"bess_{x}.mode": ("1", np.ones(n)),
            f"genset_{x}.on": ("1", on[x]),
            f"genset_{x}.p_ac": ("W", 300e3 * on[x]),
            f"genset_{x}.omega_pu": ("pu", on[x] * 0.975),
            f"genset_{x}.v_pu": ("pu", on[x]),
            f"propulsion_{x}.p_dc": ("W", power),
            f"inverter_{x}.on": ("1", np.ones(n)),
            f"ac_{x}.v_pu": ("1", 0.99 + 0.001 * random.standard_normal(n)),
        }
        columns += [(name, unit, name) for name, (unit, _) in rows.items()]
        values += [v for _, v in rows.values()]
    columns.append(("dc_tie.closed", "1", "contacts of the tie"))
    values.append(np.ones(n))
    value = np.stack(values, axis=1)
    low, high = value.copy(), value.copy()
    v_dc_column = [c[0] for c in columns].index("dc_for.v_dc")
    low[:, v_dc_column] -= 1.5 + 10.0 * np.exp(-(((t - 312.0) / 3.0) ** 2))
    high[:, v_dc_column] += 1.5
    events = [
        (10.0, "propulsion_for.speed_ref", "set to 3.08667"),
        (10.0, "propulsion_aft.speed_ref", "set to 3.08667"),
        (310.0, "genset_for.on", "true"),
        (310.0, "bess_for.i_ref", "-128 A"),
        (310.0, "bess_aft.i_ref", "-128 A"),
        (310.0, "propulsion_for.speed_ref", "10 kn"),
        (310.0, "propulsion_aft.speed_ref", "10 kn"),
        (316.0, "genset_for", "running"),
        (1390.0, "propulsion_for.speed_ref", "6 kn"),
        (1390.0, "propulsion_aft.speed_ref", "6 kn"),
        (1390.0, "bess_for.i_ref", "40 A"),
        (1390.0, "bess_aft.i_ref", "40 A"),
        (1420.0, "genset_for.on", "false"),
        (1421.0, "genset_for", "refused: the rest cannot carry the load yet"),
        (1560.0, "propulsion_for.speed_ref", "0 kn"),
        (1560.0, "propulsion_aft.speed_ref", "0 kn"),
        (1810.0, "propulsion_for.speed_ref", "-6 kn"),
        (1810.0, "propulsion_aft.speed_ref", "-6 kn"),
    ]
    attributes = {
        "version": "0.1.0",
        "commit": "0123abc",
        "numba": "0.68.1",
        "numpy": "2.4.6",
        "references": "Tremblay2009",
    }
    with ResultsWriter(folder, {"plant": columns}, {"plant": float(t[1])}, attributes) as writer:
        writer.append("plant", t, value, low, high)
        writer.events(events)
        writer.limiters(
            [
                ("rectifier_for.modulation", 315.2, 0.42, 3),
                ("propulsion_for.torque_limit", 311.0, 12.5, 1),
                ("rectifier_for.control.q_bound", 401.3, 1058.0, 4),
            ]
        )
    if finished:
        (folder / "run.yaml").write_text(RUN_YAML + SIDE.format(x="for") + SIDE.format(x="aft") + TIES)
        (folder / "summary.json").write_text(json.dumps(SUMMARY))
    return folder


def _verdict(name, signal, measure, unit, limit, value, margin, at, first, verdict):
    return dict(name=name, signal=signal, measure=measure, unit=unit, limit=limit, window=[5.0, None], value=value,
                margin=margin, at=at, first_violation=first, verdict=verdict)  # fmt: skip


SUMMARY = {
    "scenario": "mission",
    "ship": "ferry",
    "fidelity": "averaged",
    "step_s": 60e-6,
    "simulated_s": 3400.0,
    "steps": 56_666_667,
    "wall_s": 212.0,
    "startup_s": 1.4,
    "us_per_step": 3.74,
    "energy_balance_error": 2.1e-4,
    "limiters": [
        {
            "signal": "rectifier_for.control.q_bound",
            "first_s": 401.3,
            "duration_s": 1058.0,
            "count": 4,
            "share": 1058.0 / 3400.0,
            "meaning": "the bridge's voltage bounds the reactive current",
        },
    ],
    "requirements": [
        _verdict("DC bus", "dc_for.v_dc", "band", "V", [715.0, 785.0], 721.5, 6.5, 312.0, None, "met"),
        _verdict("SOC", "bess_for.soc", "max", "1", [None, 0.61], 0.617, -0.007, 1424.0, 1360.0, "violated"),
    ],
    "class_limits": [
        _verdict("IACS UR E5: voltage", "dc_for.v_dc", "band", "V", [675.0, 825.0], 721.5, 46.5, 312.0, None, "met"),
        _verdict(
            "ISO 8528-5 G2: speed, transient",
            "genset_for.omega_pu",
            "band",
            "1",
            [0.9, 1.12],
            0.875,
            -0.025,
            311.0,
            310.9,
            "violated",
        ),
    ],
    "energy": {
        "sources": {
            "genset_for.engine": 3.2e8,
            "genset_aft.engine": 3.1e8,
            "bess_for.cell": -9e7,
            "bess_aft.cell": -9e7,
        },
        "consumers": {
            "propulsion_for.screw": 1.6e8,
            "propulsion_aft.screw": 1.6e8,
            "hotel_for": 3.4e7,
            "hotel_aft": 3e7,
        },
        "losses": {"rectifier_for.lcl": 6e6, "bess_for.converter": 5e6, "bess_for.cell": 1e6, "dc_tie": 1e5},
        "stored": {"hull": 1e3, "dc_for": -2e3},
    },
}


def opened(folder, summary):
    """A finished run with another summary."""
    write(folder, n=200)
    (folder / "summary.json").write_text(json.dumps(summary))
    return open_results(folder)
