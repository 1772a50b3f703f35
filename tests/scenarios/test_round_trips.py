"""The time-line of the scenario `round-trips` on a made-up ship; the ferry sails it in `make full`."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

import shipgrid as sg
from shipgrid.scenarios.timeline import Timeline
from shipgrid.units import KNOT

STEP = 1.0
CAPACITY = 128.0 * 3600.0
CURRENT = {40.0: 56.0, -128.0: -75.0, -36.0: 0.0, 0.0: 21.0}
"""What a battery gives at each set point [A], about."""


class Toy:
    """A ship that follows her orders along a ramp, on a plant with about the powers and currents of the ferry's."""

    def __init__(self, scenario, ship):
        commands = scenario.start_commands(ship)
        public = sorted({c.signal for entry in scenario.entries for c in entry.conditions})
        paths = [f"public:{name}" for name in public] + [f"command:{path}" for path in commands]
        self.index = {path: k for k, path in enumerate(paths)}
        self.sig = [0.0] * len(paths)
        for path, value in commands.items():
            self["command:" + path] = value
        for name, soc in scenario.start_soc.items():
            self[f"public:{name}.soc"] = soc
        published = {name: SimpleNamespace(source=f"public:{name}") for name in public}
        network = SimpleNamespace(name="toy", published=published, commands=commands)
        self.h, self.layout, self.network = STEP, SimpleNamespace(index=self.index), network

    def __getitem__(self, path):
        return self.sig[self.index[path]]

    def __setitem__(self, path, value):
        self.sig[self.index[path]] = value

    def step(self):
        ordered, u = self["command:propulsion_for.speed_ref"], self["public:hull.u_ship"]
        u += min(max(ordered - u, -0.05 * KNOT * STEP), 0.05 * KNOT * STEP)
        self["public:hull.u_ship"] = u
        self["public:hull.distance"] += u * STEP
        for side in ("for", "aft"):
            i_ref = self[f"command:bess_{side}.i_ref"]
            self[f"public:bess_{side}.soc"] -= CURRENT[i_ref if abs(u) > 0.1 or i_ref < 0.0 else 0.0] * STEP / CAPACITY
            on = self[f"command:genset_{side}.on"] and (abs(ordered) > 4.0 or i_ref < 0.0)
            self[f"public:rectifier_{side}.p_dc"] = 64e3 if on else 10e3


def test_the_time_line_goes_round_four_times_and_ends_where_it_began():
    ship, scenario = sg.load_ship("ferry"), sg.load_scenario("round-trips")
    toy = Toy(scenario, ship)
    work, events = SimpleNamespace(n=0, sig=toy.sig), []
    how = {"entries": scenario.entries, "named_times": scenario.named_times}
    due = Timeline(toy, work, events, scenario.events, **how)  # type: ignore[arg-type]
    socs = []
    while work.n * STEP < scenario.duration:
        moored = len(events)
        due.give()
        socs += [toy["public:bess_for.soc"] for _, who, _ in events[moored:] if who == "timeline"]
        toy.step()
        work.n += 1
    outcomes = {outcome.name: outcome for outcome in due.outcomes(complete=True)}
    assert all(outcome.verdict == "happened" for outcome in outcomes.values()), outcomes
    assert outcomes["battery fore charged"].happened == 8 and outcomes["moored at Intra"].happened == 4
    orders = [text for _, who, text in events if who == "propulsion_for.speed_ref"]
    knots = [round(float(text.split()[2]) / KNOT) + 0 for text in orders]
    assert knots == [6, 10, 6, 0, -6, -10, -6, 0] * 4
    gensets = [(who, text.split()[2]) for _, who, text in events if who.startswith("genset")]
    assert (
        gensets == [("genset_for.on", "1"), ("genset_for.on", "0"), ("genset_aft.on", "1"), ("genset_aft.on", "0")] * 4
    )
    assert abs(toy["public:hull.distance"]) < 50.0
    assert socs == pytest.approx([socs[0]] * 8, abs=5e-3)  # at each mooring
