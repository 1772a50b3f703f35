"""Interlocks: a command that would make the plant unsafe is held back, with its reason, until it is safe.

Two rules, for every group of DC buses that ties join:

1. at most one source forms the voltage: batteries in the mode `voltage`, and rectifiers in theirs. Ties count as closed
   if they are or shall be;
2. a group under load keeps a source that holds its voltage, by droop or by forming it, and sources that together carry
   the load: a battery in droop what it gives at `SAG` of the voltage, in the mode `current` its set point, a rectifier
   what its bound has been opened to. Only sources that run already count. Ties count as closed if they are and shall
   stay so.

A command is refused if it adds a violation to what there is; what the plant does by itself is not judged here. Commands
of one instant are judged together first, so that two sources can change places, and then one by one. A refused command
stands: it is looked at again every `PERIOD`, until it can be obeyed or another one takes its place.

What depends on measured voltages is judged where they are measured, every few milliseconds, by the ties' own control: a
DC tie closes below 10 V across, an AC tie in synchronism (`equipment/breakers.py`, `automation/ac_tie.py`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from shipgrid.equipment import bess, rectifier

PERIOD = 0.1
"""Time [s] after which a command that was held back is looked at again: a switchboard's relay logic takes as long."""
SMALL_LOAD = 1e3
"""Power [W] below which a bus counts as unloaded: its bleeder, and drives that stand still."""
SAG = 0.05
"""Fall of a bus' voltage at which a battery's droop is counted: the full droop, where its unloading is given up too."""
DROOP, VOLTAGE = 1.0, 2.0
FORMING = 1.0


class Verdict(NamedTuple):
    """What became of one command: obeyed if `reason` is empty."""

    path: str
    value: float
    reason: str


class Interlocks:
    """Gate between those who command and the plant.

    Parameters
    ----------
    ship : Ship
    plan : Plan
        Of that ship: where its signals are.
    """

    def __init__(self, ship: Any, plan: Any):
        self.ship, self.index = ship, plan.layout.index
        place = {name: self.index[signal.source] for name, signal in plan.network.published.items()}
        # behind the bridges: on their DC side power is pulsed at switching fidelity, and zero in every zero vector
        self.powers = {name: (place[f"{name}.tau_e"], place[f"{name}.omega_m"]) for name in ship.items("propulsion")}
        self.powers |= {name: (place[f"{name}.p_ac"],) for name in ship.items("inverter")}
        self.batteries, self.ties = ship.items("bess"), ship.items("dc_breaker")
        self.items = {**self.batteries, **ship.items("rectifier")}
        self.consumers = {name: ship.item(name).bus for name in self.powers}
        self.held: dict[str, float] = {}
        self.said: dict[str, str] = {}

    def give(self, sig: Any, commands: Mapping[str, float]) -> list[Verdict]:
        """Give commands of one instant; those that are safe take effect.

        Parameters
        ----------
        sig : ndarray
            The plant's signals; commands in it are changed.
        commands : mapping of str to float
            Values by path.

        Returns
        -------
        list of Verdict
            One for each command.
        """
        for path in commands:
            self.held.pop(path, None)
            self.said.pop(path, None)
        return self._judge(sig, dict(commands))

    def again(self, sig: Any) -> list[Verdict]:
        """Look again at what is held back; verdicts that are new."""
        known = dict(self.said)
        verdicts = self._judge(sig, dict(self.held))
        return [v for v in verdicts if v.reason != known.get(v.path)]

    def _judge(self, sig: Any, asked: dict[str, float]) -> list[Verdict]:
        present = {path: float(sig[self.index[f"command:{path}"]]) for path in self.ship.commands}
        reasons = self.refusals(sig, present, asked)
        for path, value in asked.items():
            if path in reasons:
                self.held[path], self.said[path] = value, reasons[path]
            else:
                sig[self.index[f"command:{path}"]] = value
                self.held.pop(path, None)
                self.said.pop(path, None)
        return [Verdict(path, value, reasons.get(path, "")) for path, value in asked.items()]

    def refusals(self, sig: Any, present: Mapping[str, float], asked: Mapping[str, float]) -> dict[str, str]:
        """Why commands of one instant may not be given, those that may not: judged together first, then one by one.

        Parameters
        ----------
        sig : ndarray
            The plant's signals.
        present : mapping of str to float
            All commands as they are.
        asked : mapping of str to float
        """
        if not self.refusal(sig, present, asked):
            return {}
        present, waiting, reasons = dict(present), dict(asked), {}
        moved = True
        while waiting and moved:
            moved = False
            for path, value in list(waiting.items()):
                reasons[path] = self.refusal(sig, present, {path: value})
                if not reasons[path]:
                    present[path] = waiting.pop(path)
                    moved = True
        return {path: reasons[path] for path in waiting}

    def refusal(self, sig: Any, present: Mapping[str, float], asked: Mapping[str, float]) -> str:
        """Why commands may not be given now, empty if they may."""
        after = self.violations(sig, {**present, **asked})
        if not after:
            return ""
        before = self.violations(sig, present)
        return "; ".join(dict.fromkeys(text for key, text in after.items() if key not in before))

    def violations(self, sig: Any, commands: Mapping[str, float]) -> dict[tuple[str, str], str]:
        """What is unsafe in the plant as it is with these commands: texts by rule and bus."""
        found = {}
        for group in self._groups(sig, commands, wide=True):
            formers = [name for name in self._sources(group) if self._forms(sig, commands, name)]
            if len(formers) > 1:
                text = f"{' and '.join(formers)} would both form the voltage of {' and '.join(group)}"
                found |= {("formers", bus): text for bus in group}
        for group in self._groups(sig, commands, wide=False):
            load = self._load(sig, group)
            sources = [self._supply(sig, commands, name) for name in self._sources(group)]
            if load > SMALL_LOAD and not any(holds for holds, _ in sources):
                text = f"no running source would hold {' and '.join(group)} under load"
                found |= {("held", bus): text for bus in group}
            elif load > SMALL_LOAD and sum(power for _, power in sources) < load:
                text = f"the running sources would not carry the load of {' and '.join(group)}"
                found |= {("held", bus): text for bus in group}
        return found

    def _now(self, sig: Any, path: str) -> float:
        return float(sig[self.index[path]])

    def _groups(self, sig: Any, commands: Mapping[str, float], *, wide: bool) -> list[list[str]]:
        """DC buses that ties join; `wide`: by those that are or shall be closed, else by those that are and shall."""
        group = {item.bus: {item.bus} for item in self.items.values()}
        for name, tie in self.ties.items():
            closed = self._now(sig, f"{name}.sequence.closed") > 0.5, commands[f"{name}.close"] > 0.5
            if any(closed) if wide else all(closed):
                joined = group.get(tie.from_, {tie.from_}) | group.get(tie.to, {tie.to})
                group |= dict.fromkeys(joined, joined)
        return [list(buses) for buses in dict.fromkeys(tuple(sorted(buses)) for buses in group.values())]

    def _sources(self, group: list[str]) -> list[str]:
        return [name for name, item in self.items.items() if item.bus in group]

    def _forms(self, sig: Any, commands: Mapping[str, float], name: str) -> bool:
        if name in self.batteries:
            on = commands[f"{name}.on"] > 0.5 or self._now(sig, f"{name}.sequence.state") >= bess.RAMP_IN
            return on and commands[f"{name}.mode"] == VOLTAGE
        on = commands[f"{self.items[name].source}.on"] > 0.5 or self._now(sig, f"{name}.sequence.connected") > 0.5
        return on and commands[f"{name}.mode"] == FORMING

    def _supply(self, sig: Any, commands: Mapping[str, float], name: str) -> tuple[bool, float]:
        """Whether a source holds its bus, and the power it can feed into it [W]."""
        item, state = self.items[name], self._now(sig, f"{name}.sequence.state")
        if name not in self.batteries:
            connected = commands[f"{item.source}.on"] > 0.5 and state == rectifier.CONNECTED
            return connected, item.rating * self._now(sig, f"{name}.sequence.limit") if connected else 0.0
        if commands[f"{name}.on"] < 0.5 or not bess.RAMP_IN <= state <= bess.ON:
            return False, 0.0
        mode, most = commands[f"{name}.mode"], item.i_limit * item.i_n
        i = commands[f"{name}.i_ref"] + (SAG * item.k_dr * item.i_n if mode == DROOP else 0.0)
        i = most if mode == VOLTAGE else min(max(i, -most), most)
        return mode in (DROOP, VOLTAGE), i * (self._now(sig, f"{name}.converter.v_c") - item.R * i)

    def _load(self, sig: Any, group: list[str]) -> float:
        """What drives and inverters on a group of buses give to shafts and hotel grid [W]."""
        taken = {
            name: math.prod(float(sig[k]) for k in factors)
            for name, factors in self.powers.items()
            if self.consumers[name] in group
        }
        return sum(max(0.0, power) for power in taken.values())
