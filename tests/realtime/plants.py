"""A plant that stands still, as a gateway sees it: it takes commands from the box, and publishes when it is told to."""

from __future__ import annotations

from typing import Any

from shipgrid.assembly.plan import Plan
from shipgrid.realtime.shared import SharedArrays
from shipgrid.solvers.pacing import SLOTS, pace_work


class Plant:
    def __init__(self, plan: Plan, sig: Any):
        self.sig, self.index, self.steps = sig.copy(), plan.layout.index, 0
        pace = pace_work(bins=1, windows=1, worst=1, commands=64, signals=len(sig))
        self.shared = SharedArrays.create(pace._asdict())
        self.shared.__exit__()  # nobody else maps it
        self.arrays = self.shared.arrays
        self.publish()

    def publish(self) -> None:
        count = self.arrays["outbox_count"]
        slot = int(count[0]) % SLOTS
        self.arrays["outbox"][slot], self.arrays["outbox_step"][slot] = self.sig, self.steps
        count[0] += 1

    def take(self) -> list[tuple[int, float, int, int]]:
        """Obey what is in the box, log it, and publish: place, value, origin, measured of each."""
        box, count, taken = self.arrays["inbox"], self.arrays["inbox_count"], []
        while count[1] < count[0]:
            entry = box[int(count[1]) % len(box)]
            self.sig[entry.place] = entry.value
            taken.append((int(entry.place), float(entry.value), int(entry.origin), int(entry.measured)))
            count[1] += 1
        count[2] = count[1]
        self.steps += 1
        self.publish()
        return taken

    def command(self, path: str) -> float:
        return float(self.sig[self.index[f"command:{path}"]])
