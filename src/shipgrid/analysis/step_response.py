"""What a step does to signals, over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Response:
    """Deviations from an operating point over time.

    Attributes
    ----------
    time : ndarray
        [s].
    signals : dict of str to ndarray
        By path; `response[path]` is the same.
    """

    time: np.ndarray
    signals: dict[str, np.ndarray]

    def __getitem__(self, path: str) -> np.ndarray:
        return self.signals[path]
