"""A plant told what to do and watched while it does it: commands at their times, signals from every few steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from shipgrid.assembly.assemble import assemble
from shipgrid.assembly.code_store import core
from shipgrid.assembly.start import settle_outputs
from shipgrid.assembly.tables import arguments
from shipgrid.assembly.workspace import new_workspace
from shipgrid.automation.interlocks import PERIOD, Interlocks
from shipgrid.equipment.ship import Ship
from shipgrid.io.quantities import parse_quantity
from shipgrid.io.ship_file import read_ship
from shipgrid.io.yaml_lines import read_text
from shipgrid.model.connections import DcBus
from shipgrid.model.network import Network

HOTEL = """
schema: 1
ship: hotel
buses:
  # A kilofarad a side: two stiff DC buses, so that what is seen is the hotel grid's own.
  dc_for: {kind: dc, v_n: 750 V, capacitance: 1000 F}
  dc_aft: {kind: dc, v_n: 750 V, capacitance: 1000 F}
  ac_for: {kind: ac, v_n: 400 V, f_n: 60 Hz}
  ac_aft: {kind: ac, v_n: 400 V, f_n: 60 Hz}
equipment:
  # Off; a ship file's bus has a source.
  bess_for: {kind: bess, bus: dc_for}
  bess_aft: {kind: bess, bus: dc_aft}
  inverter_for: {kind: inverter, bus: dc_for, grid: ac_for, rating: 50 kVA}
  inverter_aft: {kind: inverter, bus: dc_aft, grid: ac_aft, rating: 50 kVA}
  hotel_for: {kind: ac_load, bus: ac_for, p: 10 kW, power_factor: 0.9}
  hotel_aft: {kind: ac_load, bus: ac_aft, p: 10 kW, power_factor: 0.9}
  dc_tie: {kind: dc_breaker, from: dc_for, to: dc_aft, length: 30 m}
  ac_tie: {kind: ac_breaker, from: ac_for, to: ac_aft, length: 30 m}
"""


RING = """
schema: 1
ship: ring
buses: {a: {kind: dc, v_n: 750 V}, b: {kind: dc, v_n: 750 V}, c: {kind: dc, v_n: 750 V}}
equipment:
  bess_c: {kind: bess, bus: c}
  drive: {kind: propulsion, bus: a, propeller: screw}
  tie_ab: {kind: dc_breaker, from: a, to: b, length: 30 m}
  tie_bc: {kind: dc_breaker, from: c, to: b, length: 30 m}
  tie_ca: {kind: dc_breaker, from: c, to: a, length: 30 m}
hull: {}
"""
"""Three DC buses joined in a ring, so that there are two ways from the battery to the drive."""


def ship_of(text: str, **changes: str) -> Ship:
    """The ship of a ship file's text, with some of its entries changed."""
    return read_ship(read_text(text, "ship.yaml"), list(changes.items())).checked()


class Story:
    """One plant under way.

    Parameters
    ----------
    ship : Ship
    step : float
        Step [s].
    every : int
        Steps between two samples of the watched signals.
    watch : iterable of str
        Paths of signals beside the public ones.
    work, plan : optional
        Where to carry on; else everything is off, with every DC bus at its nominal voltage.
    interlocks : bool
        Whether commands go through the interlocks.
    """

    def __init__(
        self, ship, step=60e-6, *, every=1, watch: Iterable[str] = (), plan=None, work=None, interlocks: bool = False
    ):
        if plan is None:
            network = Network(ship.name)
            ship.build(network)
            plan = assemble(network, step)
        self.ship, self.plan, self.every = ship, plan, every
        self.index = plan.layout.index
        public = {name: self.index[s.source] for name, s in plan.network.published.items()}
        self.places = public | {path: self.index[path] for path in watch}
        self.columns = np.array(list(self.places.values()))
        if work is None:
            work = new_workspace(plan)
            for bus in plan.network.buses.values():
                if isinstance(bus, DcBus):
                    work.sig[self.index[bus.nodes[0]]] = bus.v_n
            settle_outputs(plan, work)
        self.work = work
        self.entry, self.values = core(), arguments(plan, work)
        self.t: list[float] = []
        self.rows: list[np.ndarray] = []
        self._table = np.zeros((0, 0))
        self.interlocks = Interlocks(ship, plan) if interlocks else None
        self.events: list[tuple[float, str, str]] = []

        self.look = 0.0

    @property
    def now(self) -> float:
        """Simulated time [s]."""
        return self.work.n * self.plan.h

    def set(self, **commands: float) -> Story:
        """Give commands, `item__name=value` or through `tell`."""
        return self.tell({path.replace("__", "."): value for path, value in commands.items()})

    def tell(self, commands: Mapping[str, float | str | bool]) -> Story:
        """Give commands by path; a word where the command takes words."""
        values = {}
        for path, value in commands.items():
            words = self.ship.commands[path].words
            values[path] = words[value] if isinstance(value, str) and words is not None else float(value)
        if self.interlocks is not None:
            self._judged(self.interlocks.give(self.work.sig, values))
        else:
            for path, value in values.items():
                self.work.sig[self.index[f"command:{path}"]] = value
        return self

    def mode(self, name: str) -> Story:
        """Give the commands of an operating mode."""
        commands = self.ship.catalogue.modes[name]
        return self.tell({path: parse_quantity(v, "A") if v.endswith("A") else v for path, v in commands.items()})

    def _judged(self, verdicts):
        for path, _, reason in verdicts:
            self.events.append((self.now, path, f"refused: {reason}" if reason else "obeyed"))

    def go(self, seconds: float) -> Story:
        """Run on."""
        last = self.work.n + round(seconds / self.plan.h)
        while self.work.n < last:
            n = min(self.every, last - self.work.n)
            if self.interlocks is not None and self.interlocks.held and self.now >= self.look:
                self._judged(self.interlocks.again(self.work.sig))
                self.look = self.now + PERIOD
            done = self.entry(n, self.work.n, *self.values)
            self.work.n += abs(done)
            assert done > 0, f"diverged at {self.now} s"
            self.t.append(self.now)
            self.rows.append(self.work.sig[self.columns].copy())
            self.work.step.rows[:] = 0
            if self.work.step.event_count[0]:
                self._log()
        return self

    def _log(self):
        step = self.work.step
        for k in range(int(step.event_count[0])):
            watched = self.plan.network.watched[step.event_which[k]]
            code = int(step.event_value[k])
            if not (watched.refusal and code == 0):
                text = ("refused: " if watched.refusal else "") + watched.texts[code]
                self.events.append((float(step.event_step[k] * self.plan.h), watched.owner, text))
        step.event_count[0] = 0

    def __getitem__(self, name: str) -> float:
        """The present value of a signal."""
        return float(self.work.sig[self.places.get(name, self.index.get(name, -1))])

    def history(self, name: str, since: float = 0.0, until: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
        """Times and values of a signal."""
        if len(self._table) != len(self.rows):
            self._table = np.array(self.rows)
        t = np.array(self.t)
        chosen = (t > since) & (t <= until)
        return t[chosen], self._table[chosen, list(self.places).index(name)]

    def when(self, owner: str, text: str) -> float:
        """Time of the last event of an item that says so."""
        return [t for t, who, what in self.events if who == owner and text in what][-1]
