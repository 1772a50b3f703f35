"""Entries of a time-line that wait for a condition of the plant, or for another entry, in place of a time.

An entry waits from `from` on, or from when an entry named in its `after` has happened and `delay` has passed. It
happens at the first instant at which all its conditions hold, each for its `for` without a break; without a condition
as soon as the wait is over. Then it is spent. One that may happen again waits anew when an entry of its `after` has
happened again; without `after`, when one of its conditions has been false.

Instants are whole multiples of the interlocks' `PERIOD` in steps, counted from the start of the run. So what happens
depends neither on the pieces a run is cut into, nor on a clock, nor on where a run was continued. Values are those of
that instant. Time is counted in steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from shipgrid.errors import ParameterError

if TYPE_CHECKING:
    from shipgrid.assembly.plan import Plan

HAPPENED, NEVER, TOO_SELDOM = "happened", "never happened", "too few times"
NOT_EVALUATED, NOT_NEEDED = "not evaluated", "not needed"
"""What became of an entry: see `Outcome`."""


@dataclass(frozen=True)
class Condition:
    """A public signal above one limit, below another one, or both.

    Attributes
    ----------
    signal : str
        Public name.
    above, below : float
        Limits in the unit of the signal, SI; a value at a limit is not beyond it. Infinite where there is none.
    hold : float
        Time for which it has to hold [s].
    hysteresis : float
        How far the signal has to be back before the condition counts as false again, in the unit of the signal.
    text : str
        The condition in words, as it was written.
    """

    signal: str
    above: float = -math.inf
    below: float = math.inf
    hold: float = 0.0
    hysteresis: float = 0.0
    text: str = ""

    def holds(self, value: float, slack: float = 0.0) -> bool:
        """Whether a value of the signal is within the limits, widened by a slack in the same unit."""
        return self.above - slack < value < self.below + slack


@dataclass(frozen=True)
class ConditionalEntry:
    """An entry of a time-line without a time of its own.

    Attributes
    ----------
    name : str
        Its name, or its place in the file, `timeline.3`.
    commands : tuple of (str, float)
        Path and value (SI) of each command that it gives; there may be none.
    conditions : tuple of Condition
        All of them have to hold.
    after : tuple of str
        Names of entries one of which has to have happened before.
    delay : float
        Time from then on before it is looked at [s].
    start, end : float
        The time of the run in which it is looked at [s], both ends included.
    times : int or None
        How often it happens at most, and is expected to; None for any number, at least once.
    optional : bool
        Whether nobody minds if it never happens.
    """

    name: str
    commands: tuple[tuple[str, float], ...] = ()
    conditions: tuple[Condition, ...] = ()
    after: tuple[str, ...] = ()
    delay: float = 0.0
    start: float = 0.0
    end: float = math.inf
    times: int | None = 1
    optional: bool = False

    @property
    def text(self) -> str:
        """What it waits for, in words."""
        words = " and ".join(condition.text for condition in self.conditions)
        if not self.after:
            return words
        since = f"{self.delay:g} s after " if self.delay else "after "
        return f"{words}, {since}{' or '.join(self.after)}" if words else f"{since}{' or '.join(self.after)}"


@dataclass(frozen=True)
class Outcome:
    """What became of an entry that waited.

    Attributes
    ----------
    name, waits_for : str
        The entry, and what it waits for.
    times : int or None
        How often it was expected; None for once or more.
    happened : int
        How often it happened.
    first_s, last_s : float or None
        When first and last [s].
    verdict : str
        `happened`; `never happened` or `too few times` at the end of the scenario; `not evaluated` where the run ended
        before; `not needed` if it is optional and did not happen.
    """

    name: str
    waits_for: str
    times: int | None
    happened: int
    first_s: float | None
    last_s: float | None
    verdict: str

    @property
    def missing(self) -> bool:
        """Whether the scenario is not fulfilled because of it."""
        return self.verdict in (NEVER, TOO_SELDOM)

    @property
    def count(self) -> str:
        """How often it happened, in words: `once`, `3 times`, `2 of 4 times`, `never`."""
        if self.times is not None and 0 < self.happened < self.times:
            return f"{self.happened} of {self.times} times"
        return {0: "never", 1: "once"}.get(self.happened, f"{self.happened} times")

    @property
    def text(self) -> str:
        """A sentence on it: `recharge ends never happened: bess_aft.soc above 60 %`."""
        happened = f"happened {self.count}" if self.happened else "never happened"
        return f"{self.name} {happened}: {self.waits_for}"

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for `summary.json`."""
        return asdict(self)


@dataclass
class State:
    """Where an entry stands; steps are counted from the start of the run.

    Attributes
    ----------
    armed : int or None
        Step since which it has waited; None while it does not.
    since : list of (int or None)
        Step since which each condition has held without a break.
    count : int
        How often it has happened.
    first, last : int or None
        Steps at which it happened first and last.
    """

    armed: int | None
    since: list[int | None]
    count: int = 0
    first: int | None = None
    last: int | None = None


@dataclass(frozen=True)
class _Counted:
    """Times of an entry in steps, and where its signals lie."""

    delay: int
    start: int
    end: float
    hold: tuple[int, ...]
    places: tuple[int, ...]
    after: frozenset[str] = field(default_factory=frozenset)


class Conditions:
    """Evaluates the conditions of a time-line.

    Parameters
    ----------
    plan : Plan
        Where the public signals are.
    entries : iterable of ConditionalEntry
    every : int
        Steps between two instants.

    Raises
    ------
    ParameterError
        If a condition is on something that the plant does not publish.
    """

    def __init__(self, plan: Plan, entries: Iterable[ConditionalEntry], every: int):
        self.entries, self.every, self.h = tuple(entries), every, plan.h
        public, index = plan.network.published, plan.layout.index
        wrong = sorted({c.signal for e in self.entries for c in e.conditions if c.signal not in public})
        if wrong:
            raise ParameterError(
                f"conditions are on signals that {plan.network.name} does not have: {', '.join(wrong)}"
            )
        self.counted = [
            _Counted(
                round(e.delay / plan.h),
                round(e.start / plan.h),
                round(e.end / plan.h) if math.isfinite(e.end) else math.inf,
                tuple(round(c.hold / plan.h) for c in e.conditions),
                tuple(index[public[c.signal].source] for c in e.conditions),
                frozenset(e.after),
            )
            for e in self.entries
        ]
        self.states = [State(None if e.after else 0, [None] * len(e.conditions)) for e in self.entries]

    def snapshot(self) -> list[dict[str, Any]]:
        """Where every entry stands, as plain values."""
        return [asdict(state) for state in self.states]

    def restore(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Take back a `snapshot`."""
        self.states = [State(**{**state, "since": list(state["since"])}) for state in states]

    def next_step(self, n: int) -> float:
        """The next instant (step) after step `n` at which an entry may happen or begin to wait again; or infinity."""
        return min((self._next(k, n) for k in range(len(self.entries))), default=math.inf)

    def evaluate(self, sig: Any, n: int) -> list[ConditionalEntry]:
        """Entries that happen at step `n`, which is one of the instants, in the order of the file.

        Parameters
        ----------
        sig : ndarray
            The plant's signals after that many steps.
        n : int

        Notes
        -----
        Evaluated twice at one instant, an entry happens once: what has happened at it waits for a later one.
        """
        happened = [entry for k, entry in enumerate(self.entries) if self._evaluate(k, sig, n)]
        for entry in happened:
            self.has_happened(entry.name, n)
        return happened

    def has_happened(self, name: str, n: int) -> None:
        """Let the entries that come after a named one wait from step `n` on, at which that one has happened."""
        for k, counted in enumerate(self.counted):
            if name in counted.after and not self._over(k):
                self.states[k].armed = n
                self.states[k].since = [None] * len(self.states[k].since)

    def outcomes(self, *, complete: bool) -> list[Outcome]:
        """What became of every entry.

        Parameters
        ----------
        complete : bool
            Whether the run has come to the end of the scenario.
        """
        outcomes = []
        for entry, state in zip(self.entries, self.states, strict=True):
            enough = state.count >= (entry.times or 1)
            verdict = HAPPENED if enough else NEVER if state.count == 0 else TOO_SELDOM
            if not enough and entry.optional:
                verdict = NOT_NEEDED if state.count == 0 else HAPPENED
            elif not enough and not complete:
                verdict = NOT_EVALUATED
            first, last = (None if n is None else n * self.h for n in (state.first, state.last))
            outcomes.append(Outcome(entry.name, entry.text, entry.times, state.count, first, last, verdict))
        return outcomes

    def _over(self, k: int) -> bool:
        """Whether an entry has happened as often as it may."""
        times = self.entries[k].times
        return times is not None and self.states[k].count >= times

    def _next(self, k: int, n: int) -> float:
        state, counted = self.states[k], self.counted[k]
        if self._over(k) or (state.armed is None and counted.after):
            return math.inf
        first = max(n + 1, counted.start)
        if state.armed is not None and counted.after:
            first = max(first, state.armed + counted.delay, state.armed + 1)
        at = -(-first // self.every) * self.every
        return at if at <= counted.end else math.inf

    def _evaluate(self, k: int, sig: Any, n: int) -> bool:
        """Whether an entry happens at an instant; it goes on from where it stood."""
        state, counted, entry = self.states[k], self.counted[k], self.entries[k]
        if self._over(k) or not counted.start <= n <= counted.end:
            return False
        values = [float(sig[place]) for place in counted.places]
        conditions = list(zip(entry.conditions, values, strict=True))
        if state.armed is None:
            if not counted.after and not all(c.holds(value, c.hysteresis) for c, value in conditions):
                state.armed = n
            return False
        if counted.after and (n <= state.armed or n < state.armed + counted.delay):
            return False
        state.since = [
            (n if since is None else since) if condition.holds(value) else None
            for since, (condition, value) in zip(state.since, conditions, strict=True)
        ]
        held = zip(state.since, counted.hold, strict=True)
        if not all(since is not None and n - since >= hold for since, hold in held):
            return False
        state.armed, state.since = None, [None] * len(state.since)
        state.count, state.last = state.count + 1, n
        state.first = n if state.first is None else state.first
        return True
