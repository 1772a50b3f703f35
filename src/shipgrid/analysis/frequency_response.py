"""Responses in frequency: impedance of a bus, loop gain of a controller.

From the continuous small-signal model (`linearise`). The impedance of a bus is the voltage that a small current into it
makes, everything that is connected and every control included:

    Z(s) = dv/di                        DC bus                                                  (1)
    [v_d; v_q] = [Z_dd, Z_dq; Z_qd, Z_qq] [i_d; i_q]       AC bus, in the frame of its island   (2)

The loop gain at the input u of a component is what comes back there, negative, if a signal is put in its place:

    L = -G,   G = T / (1 + T)                                                                   (3)

where T is what the input's source answers to a disturbance added to the input, the loop closed. So nothing is opened,
and a loop that is unstable when open has one as well. 1 + L = 0 gives the poles; for several inputs together L is a
matrix and det(1 + L) = 0 does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shipgrid.analysis.linearise import LinearModel
from shipgrid.analysis.small_signal_plots import draw_response
from shipgrid.errors import ParameterError
from shipgrid.model.connections import DcBus


@dataclass(frozen=True, repr=False)
class FrequencyResponse:
    """A response over frequency.

    Attributes
    ----------
    frequency : ndarray
        [Hz].
    value : ndarray of complex, shape (n,) or (n, m, m)
    name : str
        What it is of, with its unit.
    """

    frequency: np.ndarray
    value: np.ndarray
    name: str

    def __repr__(self) -> str:
        return f"<FrequencyResponse {self.name}: {len(self.frequency)} frequencies>"

    def at(self, frequency: float) -> Any:
        """Value at the frequency [Hz] nearest to one.

        Parameters
        ----------
        frequency : float
            The one [Hz].
        """
        return self.value[int(np.argmin(np.abs(self.frequency - frequency)))]

    def margins(self) -> tuple[float, float]:
        """Phase margin [degrees] and gain margin [1] of a scalar loop gain; infinite where there is no crossing.

        Raises
        ------
        ParameterError
            If it is a matrix.
        """
        if self.value.ndim != 1:
            raise ParameterError(f"{self.name}: margins are those of a scalar loop gain")
        size, angle = np.abs(self.value), np.unwrap(np.angle(self.value))
        crossings = np.flatnonzero((size[:-1] - 1.0) * (size[1:] - 1.0) < 0.0)
        phase = [_between(np.log(size), angle, int(k), 0.0) for k in crossings]
        turns = np.floor((angle - np.pi) / (2.0 * np.pi))
        gain = []
        for k in np.flatnonzero(turns[:-1] != turns[1:]):
            target = np.pi + 2.0 * np.pi * max(turns[k], turns[k + 1])
            gain.append(1.0 / np.exp(_between(angle, np.log(size), int(k), target)))
        worst = min((abs((p + np.pi + np.pi) % (2.0 * np.pi) - np.pi) for p in phase), default=np.inf)
        return float(np.degrees(worst)), float(min((max(g, 1.0 / g) for g in gain), default=np.inf))

    def plot(self, axes: Any | None = None, **style: Any) -> Any:
        """Draw magnitude and phase.

        Parameters
        ----------
        axes : pair of matplotlib axes, optional
            For magnitude and phase; a new figure if left out.
        **style
            Passed on to matplotlib.

        Returns
        -------
        pair of matplotlib axes
        """
        return draw_response(self.frequency, self.value, self.name, axes, **style)


def _between(x: np.ndarray, y: np.ndarray, k: int, target: float) -> float:
    """Value of y between k and k + 1 where x is `target`, on a straight line."""
    return float(y[k] + (target - x[k]) / (x[k + 1] - x[k]) * (y[k + 1] - y[k]))


def impedance(model: LinearModel, bus: str, frequency: Sequence[float] | np.ndarray) -> FrequencyResponse:
    """Impedance of a bus [ohm].

    Parameters
    ----------
    model : LinearModel
        From `linearise`.
    bus : str
        Name of a DC or AC bus.
    frequency : sequence of float
        Frequencies [Hz]; of an AC bus, in the island's turning frame.

    Returns
    -------
    FrequencyResponse
        Scalar for a DC bus, 2 x 2 for an AC bus.
    """
    f = np.asarray(frequency, dtype=float)
    found = model.plan.network.bus(bus)
    B = np.column_stack([model.injection(node) for node in found.nodes])
    value = model.respond(B, [model.signal_row(node) for node in found.nodes], f)
    return FrequencyResponse(f, value[:, 0, 0] if isinstance(found, DcBus) else value, f"impedance of {bus}, ohm")


def loop_gain(
    model: LinearModel, at: str | Sequence[str], frequency: Sequence[float] | np.ndarray
) -> FrequencyResponse:
    """Loop gain at an input of a component, positive where the loop opposes what disturbs it.

    Parameters
    ----------
    model : LinearModel
        From `linearise`.
    at : str or sequence of str
        Path of a connected input ("rectifier_for.control.v_dc"), or several that are opened together (both axes of a
        current).
    frequency : sequence of float
        Frequencies [Hz].

    Returns
    -------
    FrequencyResponse
        Scalar for one input, a matrix for several.

    Raises
    ------
    ParameterError
        If it is no input of a component, or nothing that moves is connected to it.
    """
    f = np.asarray(frequency, dtype=float)
    paths = [at] if isinstance(at, str) else list(at)
    unknown = [path for path in paths if ("u", path) not in model.plan.layout.slots]
    if unknown:
        raise ParameterError(f"'{unknown[0]}' is no input of a component: a loop is opened where a signal is read")
    T = model.transfer(paths, paths, f)
    one = np.eye(len(paths))
    value = np.array([-np.linalg.solve((one + t).T, t.T).T for t in T])
    name = f"loop gain at {', '.join(paths)}"
    return FrequencyResponse(f, value[:, 0, 0] if isinstance(at, str) else value, name)
