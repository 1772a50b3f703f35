"""The desk of a live run: who commands the plant from outside is checked here, and what they see is taken from here.

It lives in a process beside the one that runs the plant. A command is obeyed if it exists, is in its range, and the
interlocks have nothing against it in the plant as it was published last, at most some 100 us ago. A controller that
falls silent is lost: what it has commanded is held, goes to a safe value over a ramp, or back to what the scenario had
given.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from shipgrid.assembly.plan import Plan
from shipgrid.automation.interlocks import Interlocks
from shipgrid.realtime.shared import SharedArrays
from shipgrid.solvers.pacing import SLOTS

ORIGINS = ("Python", "UDP", "Modbus", "console", "the gateway")
PYTHON, UDP, MODBUS, CONSOLE, GATEWAY = range(len(ORIGINS))
OBEYED, UNKNOWN, OUT_OF_RANGE, REFUSED, BUSY = range(5)
ANSWERS = ("obeyed", "no such command", "out of range", "refused by the interlocks", "too many at once")
"""What became of a command, by the code a controller is answered with."""
LOST = ("hold", "safe", "local")
"""What is done about the commands of a lost controller."""
NOT_JUDGED = ("speed_ref", "v_ref", "v_dc_ref", "wind_speed", "wind_from", "wave_height")
"""Commands that the interlocks have nothing to say about."""
SAFE = {"speed_ref": 0.0, "i_ref": 0.0}
"""Where commands of a lost controller go over the ramp; the others stay."""
RAMP = 10.0
"""Time of that ramp [s]."""
RAMP_STEP = 0.02
"""Time [s] between two values of it."""


@dataclass
class Controller:
    """One who commands: when it was heard last [s], what its commands were before it came, and what they are now."""

    heard: float
    before: dict[str, float] = field(default_factory=dict)
    now: dict[str, float] = field(default_factory=dict)
    lost_at: float = math.inf
    ramped_at: float = 0.0


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
    """

    def __init__(self, ship: Any, plan: Plan, shared: SharedArrays, lost: str = "hold", timeout: float = 0.5):
        self.commands, self.interlocks, self.h = ship.commands, Interlocks(ship, plan), plan.h
        self.arrays, self.lost, self.timeout = shared.arrays, lost, timeout
        self.sig = plan.layout.initial.copy()
        self.step = -1
        self.place = {path: plan.layout.index[f"command:{path}"] for path in self.commands}
        self.signals = list(plan.network.published)
        self.sources = np.array([plan.layout.index[public.source] for public in plan.network.published.values()])
        self.given: dict[int, Given] = {}
        self.controllers: dict[int, Controller] = {}
        self.busy = threading.RLock()  # one bus at a time
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
        return self.step

    def measured(self) -> np.ndarray:
        """Values of the public signals as looked at last, in the order of `signals`."""
        return self.sig[self.sources]

    def command(self, path: str, value: float, origin: int, measured: int = 0) -> int:
        """Give one command; what became of it, as a code of `ANSWERS`.

        Parameters
        ----------
        path : str
        value : float
            SI; the code of a word.
        origin : int
            Who asks, as a place in `ORIGINS`.
        measured : int
            Step of the measurement that it answers, if known.
        """
        code = self._judged(path, value)
        if code == OBEYED:
            code = self._give(path, value, origin, measured)
        self.counted[f"commands {ANSWERS[code]}"] += 1
        return code

    def heard(self, origin: int) -> None:
        """A controller has given a sign of life."""
        now = time.monotonic()
        controller = self.controllers.setdefault(origin, Controller(now))
        if controller.lost_at < math.inf:
            self.counted["controllers regained"] += 1
            controller.lost_at = math.inf
        controller.heard = now

    def watch(self) -> None:
        """Look after controllers that have fallen silent; to be called every few milliseconds."""
        now = time.monotonic()
        for origin, controller in self.controllers.items():
            if controller.lost_at == math.inf:
                if now - controller.heard <= self.timeout:
                    continue
                controller.lost_at = now
                self.counted[f"controllers lost, {ORIGINS[origin]}"] += 1
                if self.lost == "local":
                    for path, value in controller.before.items():
                        self.command(path, value, GATEWAY)
                    controller.before.clear()
            if self.lost == "safe" and now - controller.ramped_at >= RAMP_STEP:
                controller.ramped_at = now
                left = max(0.0, 1.0 - (now - controller.lost_at) / RAMP)
                for path, value in list(controller.now.items()):
                    name = path.rpartition(".")[2]
                    # the speed of a genset has the name of a ship's, and no safe value
                    if name in SAFE and self.commands[path].low <= SAFE[name]:
                        self.command(path, SAFE[name] + left * (value - SAFE[name]), GATEWAY)
                if left == 0.0:
                    controller.now.clear()

    def _judged(self, path: str, value: float) -> int:
        command = self.commands.get(path)
        if command is None:
            return UNKNOWN
        if not command.low <= value <= command.high or (command.words and value not in command.words.values()):
            return OUT_OF_RANGE  # so is what is not a number
        if path.rpartition(".")[2] in NOT_JUDGED:
            return OBEYED
        present: Mapping[str, float] = {name: float(self.sig[place]) for name, place in self.place.items()}
        return REFUSED if self.interlocks.refusal(self.sig, present, {path: value}) else OBEYED

    def _give(self, path: str, value: float, origin: int, measured: int) -> int:
        place, count, inbox = self.place[path], self.arrays["inbox_count"], self.arrays["inbox"]
        present = float(self.sig[place])
        if origin != GATEWAY:
            controller = self.controllers.setdefault(origin, Controller(time.monotonic()))
            controller.before.setdefault(path, present)
            controller.now[path] = value
        if value == present:
            return OBEYED
        number = int(count[0])
        if number - int(count[1]) >= len(inbox) - 1:
            return BUSY
        entry = inbox[number % len(inbox)]
        entry.place, entry.value, entry.origin, entry.measured = place, value, origin, measured
        count[0] = number + 1
        self.given[place] = Given(number, value)
        self.sig[place] = value
        return OBEYED
