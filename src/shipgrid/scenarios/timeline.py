"""The commands of a run, each given at its step: the scenario's, which the interlocks judge, and those from outside.

A scenario's commands come at a time, or when a condition of the plant holds (`scenarios/conditions.py`).

Commands from outside are those that a live run was given while it ran (judged where they came in); a run that repeats
it gives them at the same steps.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from shipgrid.assembly.plan import Plan
from shipgrid.assembly.workspace import Workspace
from shipgrid.automation.interlocks import PERIOD, Interlocks
from shipgrid.automation.power_management import LowSocOperator
from shipgrid.scenarios.conditions import ConditionalEntry, Conditions, Outcome
from shipgrid.scenarios.outside import Outside

Logged = list[tuple[float, str, str]]
"""An event log: time [s], who, what."""


TIMELINE = "timeline"
"""Source of the events of entries that give no commands, and of those that never happened."""
QUIET = 1.0
"""A controller may command a thousand times a second: time [s] between two of its events for one command in the log."""


class Timeline:
    """Gives commands and logs what became of them.

    Parameters
    ----------
    plan : Plan
    work : Workspace
        Commands in it are changed; those before its time have been given.
    events : list
        The log, added to.
    commands : iterable of (float, str, float)
        Time [s], path, value.
    said : callable
        Text of the event of a command, from its path and value.
    places : mapping of str to int, optional
        Where in the flat vector what a path names lies; commands if left out.
    interlocks : Interlocks, optional
        What may hold back a command; every command is obeyed if left out.
    operator : LowSocOperator, optional
        Who gives commands by a rule of power management, through the interlocks.
    outside : iterable of Outside
    entries : iterable of ConditionalEntry
        What gives commands when a condition holds.
    named_times : mapping of str to float
        Times [s] of entries that have a time and a name, which others may wait for.
    continued : bool
        Whether the run has been going on before: what was due earlier has been given, what is due at this step has not.
    """

    def __init__(
        self,
        plan: Plan,
        work: Workspace,
        events: Logged,
        commands: Iterable[tuple[float, str, float]],
        said: Callable[[str, float], str] = lambda path, value: f"set to {value:.6g}",
        places: Mapping[str, int] | None = None,
        interlocks: Interlocks | None = None,
        operator: LowSocOperator | None = None,
        outside: Iterable[Outside] = (),
        *,
        entries: Iterable[ConditionalEntry] = (),
        named_times: Mapping[str, float] | None = None,
        continued: bool = False,
    ):
        self.h, self.work, self.events, self.said, self.interlocks = plan.h, work, events, said, interlocks
        self.operator = operator
        self.places = places or {path: plan.layout.index[f"command:{path}"] for path in plan.network.commands}
        self.every = max(1, round(PERIOD / plan.h))
        due = sorted(((round(t / plan.h), path, value) for t, path, value in commands), key=lambda e: e[0])
        self.pending = deque(command for command in due if not continued or command[0] >= work.n)
        self.outside = deque(command for command in outside if not continued or command.step >= work.n)
        self.quiet: dict[tuple[str, str], tuple[float, int]] = {}
        self.conditions = Conditions(plan, entries, self.every)
        named = sorted(((round(t / plan.h), name) for name, t in (named_times or {}).items()), key=lambda e: e[0])
        self.named = deque(entry for entry in named if not continued or entry[0] >= work.n)

    def outcomes(self, *, complete: bool) -> list[Outcome]:
        """What became of the entries that waited for a condition; `complete`: the scenario has been run to its end."""
        return self.conditions.outcomes(complete=complete)

    def remembered(self) -> dict[str, Any]:
        """A copy of what it, the interlocks and the operator have to know to go on, in lists and mappings of texts."""
        found: dict[str, Any] = {"quiet": [[*key, *said] for key, said in self.quiet.items()]}
        found["conditions"] = self.conditions.snapshot()
        if self.interlocks is not None:
            found |= {"held": dict(self.interlocks.held), "said": dict(self.interlocks.said)}
        if self.operator is not None:
            found |= {"operator": dict(self.operator.state)}
        return found

    def remember(self, found: Mapping[str, Any]) -> None:
        """Know again what another one had `remembered`."""
        self.quiet = {(path, origin): (last, count) for path, origin, last, count in found["quiet"]}
        self.conditions.restore(found["conditions"])
        if self.interlocks is not None:
            self.interlocks.held |= found["held"]
            self.interlocks.said |= found["said"]
        if self.operator is not None:
            self.operator.state |= found["operator"]

    def state(self) -> dict[str, Any]:
        """A copy of all that it has to know to go on from this step, in this process."""
        waiting = {"pending": deque(self.pending), "outside": deque(self.outside), "named": deque(self.named)}
        return waiting | copy.deepcopy(self.remembered())

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go back to a `state`."""
        self.pending, self.outside, self.named = (deque(state[name]) for name in ("pending", "outside", "named"))
        if self.interlocks is not None:
            self.interlocks.held.clear()
            self.interlocks.said.clear()
        if self.operator is not None:
            self.operator.state.clear()
        self.remember(copy.deepcopy(dict(state)))

    def command(self, path: str, value: float, origin: str) -> str:
        """Give a command at once; why the interlocks hold it back, empty if it has taken effect.

        Parameters
        ----------
        path : str
        value : float
            SI; the code of a word.
        origin : str
            Whose it is, for the log.
        """
        text = f"{self.said(path, value)}, by {origin}"
        if self.interlocks is None:
            self.work.sig[self.places[path]] = value
            self._log(path, text)
            return ""
        (verdict,) = self.interlocks.give(self.work.sig, {path: value})
        self._log(path, f"refused: {verdict.reason} ({text})" if verdict.reason else text)
        return verdict.reason

    def give(self) -> bool:
        """Give what is due at this step, and look again at what is held back; true if there was anything."""
        n = self.work.n
        look = n % self.every == 0
        looked = look and self.conditions.next_step(n - 1) == n
        now: dict[str, tuple[float, str]] = {}
        while self.named and self.named[0][0] <= n:
            step, name = self.named.popleft()
            self.conditions.has_happened(name, step)
        while self.pending and self.pending[0][0] <= n:
            _, path, value = self.pending.popleft()
            self._add(now, path, value, "")
        for entry in self.conditions.evaluate(self.work.sig, n) if look else ():
            why = f" by {entry.name}: {entry.text}"
            if not entry.commands:
                self._log(TIMELINE, f"{entry.name}: {entry.text}")
            for path, value in entry.commands:
                self._add(now, path, value, why)
        self._give(now, look=look)
        if look:
            self._operate()
        given = bool(now) or looked or (look and self._watches())
        while self.outside and self.outside[0].step <= self.work.n:
            command = self.outside.popleft()
            self.work.sig[self.places[command.path]] = command.value
            self.obeyed(command)
            given = True
        return given

    def obeyed(self, command: Outside) -> None:
        """Log a command from outside that has taken effect; it takes the place of one that is held back."""
        t, key = command.step * self.h, (command.path, command.origin)
        last, count = self.quiet.get(key, (-math.inf, 0))
        if t - last < QUIET:
            self.quiet[key] = last, count + 1
        else:
            self.quiet[key] = t, 0
            more = f", after {count} more" if count else ""
            self._log(command.path, f"{self.said(command.path, command.value)}, by {command.origin}{more}", t)
        if self.interlocks is not None:
            self.interlocks.held.pop(command.path, None)
            self.interlocks.said.pop(command.path, None)

    def until(self) -> float:
        """The next step at which `give` has something to do."""
        at: list[float] = [self.pending[0][0]] if self.pending else []
        at += [self.named[0][0]] if self.named else []
        at += [self.outside[0].step] if self.outside else []
        if self._watches():
            at.append((self.work.n // self.every + 1) * self.every)  # whole multiples: the same in every run
        at.append(self.conditions.next_step(self.work.n))
        return min(at, default=math.inf)

    def _add(self, now: dict[str, tuple[float, str]], path: str, value: float, why: str) -> None:
        """Put a command to those of one step: the later of two for one path counts, and both are in the log."""
        if path in now:
            self._log(path, self.said(path, now[path][0]) + now[path][1])
        now[path] = value, why

    def _give(self, commands: Mapping[str, tuple[float, str]], *, look: bool) -> None:
        """Without commands only at instants to `look`: at others this run happens to stop for a moment."""
        sig, interlocks = self.work.sig, self.interlocks
        if interlocks is None:
            for path, (value, why) in commands.items():
                sig[self.places[path]] = value
                self._log(path, self.said(path, value) + why)
            return
        values = {path: value for path, (value, _) in commands.items()}
        for again, verdicts in (
            (False, interlocks.give(sig, values) if values else []),
            (True, interlocks.again(sig) if interlocks.held and (look or values) else []),
        ):
            for path, value, reason in verdicts:
                said = self.said(path, value) + (commands[path][1] if path in commands else "")
                text = said + (", as it had been asked to" if again else "")
                self._log(path, f"refused: {reason} ({said})" if reason else text)

    def _watches(self) -> bool:
        return self.operator is not None or (self.interlocks is not None and bool(self.interlocks.held))

    def _operate(self) -> None:
        """Let a rule of power management look at the plant, and give its commands as anybody's, with their origin."""
        if self.operator is None or self.interlocks is None:
            return
        order = self.operator.look(self.work.sig)
        if order is None:
            return
        for path, value, reason in self.interlocks.give(self.work.sig, order.commands):
            text = f"{self.said(path, value)} by {self.operator.rule.name}: {order.why}"
            self._log(path, f"refused: {reason} ({text})" if reason else text)

    def _log(self, who: str, what: str, t: float | None = None) -> None:
        self.events.append((self.work.n * self.h if t is None else t, who, what))
