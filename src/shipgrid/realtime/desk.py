"""The desk of a live run: who commands the plant from outside is checked here, and what they see is taken from here.

It lives in a process beside the one that runs the plant. A command is obeyed if it exists, is in its range, and the
interlocks have nothing against it in the plant as it was published last, some tens of microseconds ago. Commands of
one instant are judged together, so that two sources can change places. A controller that falls silent is lost: what it
has commanded is held, goes to a safe value over a ramp, or back to what the scenario had given. What somebody else has
commanded since is no longer its own.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.automation.interlocks import Interlocks
from shipgrid.realtime.shared import SharedArrays
from shipgrid.scenarios.outside import in_range
from shipgrid.solvers.pacing import SLOTS

ORIGINS = ("UDP", "Modbus", "the gateway")
UDP, MODBUS, GATEWAY = range(len(ORIGINS))
OBEYED, UNKNOWN, OUT_OF_RANGE, REFUSED, BUSY, NO_TOKEN = range(6)
ANSWERS = ("obeyed", "no such command", "out of range", "refused by the interlocks", "too many at once", "no token")
"""What became of a command, by the code a controller is answered with."""
LOST = ("hold", "safe", "local")
"""What is done about the commands of a lost controller."""
NOT_JUDGED = ("speed_ref", "v_ref", "v_dc_ref", "wind_speed", "wind_from", "wave_height")
"""Commands that the interlocks have nothing to say about."""
SAFE = {"speed_ref": 0.0, "i_ref": 0.0}
"""Where commands of a lost controller go over the ramp, if that is in their range (the speed of a genset has the name
of a ship's); the others stay."""
RAMP = 10.0
"""Time of that ramp [s]."""
RAMP_STEP = 0.02
"""Time [s] between two values of it."""
AGAIN = 0.1
"""Time [s] after which what the interlocks held back at its end is tried again."""


@dataclass
class Controller:
    """One who commands: when it was heard last [s], its commands as they are, and as they were before it gave them.

    Attributes
    ----------
    heard : float
    now, before : dict of str to float
    lost_at : float
        When it was lost [s]; `inf` while it is not.
    leaving : dict of str to (float, float)
        After that: from where and to where its commands go.
    moved_at : float
        When they were moved last [s].
    """

    heard: float
    now: dict[str, float] = field(default_factory=dict)
    before: dict[str, float] = field(default_factory=dict)
    lost_at: float = math.inf
    leaving: dict[str, tuple[float, float]] = field(default_factory=dict)
    moved_at: float = -math.inf

    def forget(self, path: str) -> float:
        """Somebody else has it now; what it was before."""
        self.now.pop(path, None)
        self.leaving.pop(path, None)
        return self.before.pop(path)


@dataclass
class Given:
    """A command on its way: its number in the inbox, and how much was published when it had been taken."""

    number: int
    value: float
    seen: int | None = None


class Desk:
    """What a gateway process knows of the plant, and all it can do to it.

    Parameters
    ----------
    ship : Ship
    plan : Plan
        Of that ship, as the other process has it.
    shared : SharedArrays
    lost : {"hold", "safe", "local"}
        What is done about the commands of a lost controller.
    timeout : float
        Silence [s] after which a controller is lost.
    clock : callable, optional
        Time [s], for tests.

    Attributes
    ----------
    busy : Lock
        Held by whoever calls the methods: one bus at a time.
    sig : ndarray
        The plant's signals after step number `step`, with commands on their way as if they had arrived.
    """

    def __init__(
        self,
        ship: Any,
        plan: Plan,
        shared: SharedArrays,
        lost: str = "hold",
        timeout: float = 0.5,
        clock: Callable[[], float] = time.monotonic,
    ):
        self.commands, self.interlocks, self.h = ship.commands, Interlocks(ship, plan), plan.h
        self.arrays, self.lost, self.timeout, self.clock = shared.arrays, lost, timeout, clock
        self.inbox = self.arrays["inbox"].view(np.ndarray)  # records cost microseconds
        self.sig = plan.layout.initial.copy()
        self.step = -1
        self.place = {path: plan.layout.index[f"command:{path}"] for path in self.commands}
        self.places = np.array(list(self.place.values()))
        self.signals = list(plan.network.published)
        self.sources = np.array([plan.layout.index[public.source] for public in plan.network.published.values()])
        self.given: dict[int, Given] = {}
        self.controllers: dict[int, Controller] = {}
        self.busy = threading.Lock()
        self.counted: Counter[str] = Counter()

    def look(self) -> int:
        """Take the newest of what the plant has published; the step it was after, -1 before the first."""
        outbox, steps, count = (self.arrays[name] for name in ("outbox", "outbox_step", "outbox_count"))
        while (now := int(count[0])) > 0:
            slot = (now - 1) % SLOTS
            self.sig[:] = outbox[slot]
            self.step = int(steps[slot])
            if int(count[0]) - now < SLOTS - 1:  # nobody has written there meanwhile
                break
        taken = int(self.arrays["inbox_count"][1])
        for place, given in list(self.given.items()):
            if given.seen is not None and now > given.seen:
                del self.given[place]
                continue
            if given.seen is None and given.number < taken:
                given.seen = int(count[0])
            self.sig[place] = given.value
        for controller in self.controllers.values():
            for path, value in list(controller.now.items()):
                if self.sig[self.place[path]] != value:  # the scenario has given another one
                    controller.forget(path)
        return self.step

    def measured(self) -> np.ndarray:
        """Values of the public signals as looked at last, in the order of `signals`."""
        return self.sig[self.sources]

    def commanded(self) -> np.ndarray:
        """Values of the commands, in the order of `commands`."""
        return self.sig[self.places]

    def command(
        self, asked: Sequence[tuple[str, float]], origin: int, measured: int = 0, *, whole: bool = False
    ) -> list[int]:
        """Give commands of one instant; what became of each, as codes of `ANSWERS`.

        Parameters
        ----------
        asked : sequence of (str, float)
            Paths and values: SI; the code of a word. Of two for one path the later one counts.
        origin : int
            Who asks, as a place in `ORIGINS`.
        measured : int
            Step of the measurement that they answer, if known.
        whole : bool
            Obey all or none.
        """
        codes = [self._checked(path, value) for path, value in asked]
        wrong = [code for code in codes if code != OBEYED]
        if whole and wrong:
            codes = [wrong[0]] * len(codes)
        else:
            good = {path: value for (path, value), code in zip(asked, codes, strict=True) if code == OBEYED}
            became = self._obey(good, origin, measured, self._controller(origin), whole=whole)
            codes = [became[path] if code == OBEYED else code for (path, _), code in zip(asked, codes, strict=True)]
        for code in codes:
            self.counted[f"commands {ANSWERS[code]}"] += 1
        return codes

    def heard(self, origin: int) -> None:
        """A controller has given a sign of life."""
        controller = self._controller(origin)
        if controller.lost_at < math.inf:
            self.counted["controllers regained"] += 1
            controller.lost_at = math.inf
            controller.leaving.clear()
        controller.heard = self.clock()

    def watch(self) -> None:
        """Look after controllers that have fallen silent; to be called every few milliseconds, after a `look`."""
        now = self.clock()
        for origin, controller in self.controllers.items():
            if controller.lost_at == math.inf:
                if now - controller.heard <= self.timeout:
                    continue
                controller.lost_at = now
                self.counted[f"controllers lost, {ORIGINS[origin]}"] += 1
                controller.leaving = dict(self._ways(controller))
            left = max(0.0, 1.0 - (now - controller.lost_at) / RAMP) if self.lost == "safe" else 0.0
            if controller.leaving and now - controller.moved_at >= (RAMP_STEP if left > 0.0 else AGAIN):
                controller.moved_at = now
                asked = {path: end + left * (start - end) for path, (start, end) in controller.leaving.items()}
                became = self._obey(asked, GATEWAY, 0, controller)
                for path, code in became.items():
                    if left == 0.0 and code == OBEYED:
                        del controller.leaving[path]

    def _ways(self, controller: Controller) -> Iterable[tuple[str, tuple[float, float]]]:
        """From where to where the commands of a lost controller go."""
        for path, value in controller.now.items():
            command, safe = self.commands[path], SAFE.get(path.rpartition(".")[2])
            if self.lost == "local":
                yield path, (value, controller.before[path])
            elif self.lost == "safe" and safe is not None and command.low <= safe <= command.high:
                yield path, (value, safe)

    def _controller(self, origin: int) -> Controller:
        if origin not in self.controllers:
            self.controllers[origin] = Controller(self.clock())
        return self.controllers[origin]

    def _checked(self, path: str, value: float) -> int:
        command = self.commands.get(path)
        if command is None:
            return UNKNOWN
        return OBEYED if in_range(command, value) else OUT_OF_RANGE

    def _obey(
        self, asked: dict[str, float], origin: int, measured: int, owner: Controller, *, whole: bool = False
    ) -> dict[str, int]:
        """Give what the interlocks let pass; codes by path."""
        became = dict.fromkeys(asked, OBEYED)
        if judged := {path: value for path, value in asked.items() if path.rpartition(".")[2] not in NOT_JUDGED}:
            present = dict(zip(self.place, self.commanded().tolist(), strict=True))
            became |= dict.fromkeys(self.interlocks.refusals(self.sig, present, judged), REFUSED)
        if whole and REFUSED in became.values():
            return dict.fromkeys(asked, REFUSED)
        count = self.arrays["inbox_count"]
        room = len(self.arrays["inbox"]) - (int(count[0]) - int(count[2]))
        if whole and room < len(asked):
            return dict.fromkeys(asked, BUSY)
        for path, value in asked.items():
            if became[path] == OBEYED and not self._give(path, value, origin, measured, owner):
                became[path] = BUSY
        return became

    def _give(self, path: str, value: float, origin: int, measured: int, owner: Controller) -> bool:
        """Put a command into the box, if there is room; one that repeats its giver's last changes nothing."""
        place, count, inbox = self.place[path], self.arrays["inbox_count"], self.inbox
        present = float(self.sig[place])
        if owner.now.get(path) == value == present:
            return True
        number = int(count[0])
        if number - int(count[2]) >= len(inbox):
            return False
        for other in self.controllers.values():
            if other is not owner and path in other.now:
                owner.before.setdefault(path, other.forget(path))
        owner.before.setdefault(path, present)
        owner.now[path] = value
        inbox[number % len(inbox)] = place, value, origin, measured
        count[0] = number + 1
        self.given[place] = Given(number, value)
        self.sig[place] = value
        return True
