"""The commands of a run, each given at its step: the scenario's, which the interlocks judge, and those from outside.

Commands from outside are those that a live run was given while it ran (judged where they came in); a run that repeats
it gives them at the same steps.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from shipgrid.assembly.plan import Plan, Workspace
from shipgrid.automation.interlocks import PERIOD, Interlocks
from shipgrid.automation.power_management import LowSocOperator
from shipgrid.scenarios.outside import Outside

Logged = list[tuple[float, str, str]]
"""An event log: time [s], who, what."""


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

    def remembered(self) -> dict[str, Any]:
        """A copy of what it, the interlocks and the operator have to know to go on, in lists and mappings of texts."""
        found: dict[str, Any] = {"quiet": [[*key, *said] for key, said in self.quiet.items()]}
        if self.interlocks is not None:
            found |= {"held": dict(self.interlocks.held), "said": dict(self.interlocks.said)}
        if self.operator is not None:
            found |= {"operator": dict(self.operator.state)}
        return found

    def remember(self, found: Mapping[str, Any]) -> None:
        """Know again what another one had `remembered`."""
        self.quiet = {(path, origin): (last, count) for path, origin, last, count in found["quiet"]}
        if self.interlocks is not None:
            self.interlocks.held |= found["held"]
            self.interlocks.said |= found["said"]
        if self.operator is not None:
            self.operator.state |= found["operator"]

    def give(self) -> bool:
        """Give what is due at this step, and look again at what is held back; true if there was anything."""
        now: dict[str, float] = {}
        while self.pending and self.pending[0][0] <= self.work.n:
            _, path, value = self.pending.popleft()
            if path in now:  # the later of two commands of one step counts, and both are in the log
                self._log(path, self.said(path, now[path]))
            now[path] = value
        self._give(now, look=self.work.n % self.every == 0)
        if self.work.n % self.every == 0:
            self._operate()
        looked = self.work.n % self.every == 0 and self._watches()
        given = bool(now) or looked
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
        at = [self.pending[0][0]] if self.pending else []
        at += [self.outside[0].step] if self.outside else []
        if self._watches():
            at.append((self.work.n // self.every + 1) * self.every)  # whole multiples: the same in every run
        return min(at, default=math.inf)

    def _give(self, commands: Mapping[str, float], *, look: bool) -> None:
        """Without commands only at instants to `look`: at others this run happens to stop for a moment."""
        sig, interlocks = self.work.sig, self.interlocks
        if interlocks is None:
            for path, value in commands.items():
                sig[self.places[path]] = value
                self._log(path, self.said(path, value))
            return
        for again, verdicts in (
            (False, interlocks.give(sig, commands) if commands else []),
            (True, interlocks.again(sig) if interlocks.held and (look or commands) else []),
        ):
            for path, value, reason in verdicts:
                text = self.said(path, value) + (", as it had been asked to" if again else "")
                self._log(path, f"refused: {reason} ({self.said(path, value)})" if reason else text)

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
