"""What `shipgrid plot` draws: signals over time, those of one unit in one panel."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

from shipgrid.errors import ParameterError

matplotlib.use("Agg")

from matplotlib import pyplot


def plot_signals(results: Any, signals: Sequence[str], start: float | None, end: float | None, out: Path) -> None:
    """Draw signals of a run into a file.

    Parameters
    ----------
    results : Results
        The run.
    signals : sequence of str
        Public names.
    start, end : float or None
        Window [s].
    out : Path
        Picture; its suffix tells the format.

    Raises
    ------
    ParameterError
        If a signal is not in the results, or the window has no sample.
    """
    if out.suffix not in (".png", ".svg", ".pdf"):
        raise ParameterError(f"--out: {out} is no picture, expected a name that ends in .png, .svg or .pdf")
    panels: dict[str, list[str]] = {}
    for name in signals:
        panels.setdefault(str(results[name].attrs.get("units", "1")), []).append(name)
    figure, axes = pyplot.subplots(len(panels), 1, sharex=True, squeeze=False, figsize=(9.0, 1.0 + 2.2 * len(panels)))
    for (unit, names), axis in zip(panels.items(), axes[:, 0], strict=True):
        for name in names:
            data = results[name].sel(time=slice(start, end))
            if data.time.size == 0:
                raise ParameterError(f"{name} has no sample between {start} s and {end} s")
            axis.plot(data.time, data, label=name, linewidth=1.0)
            if f"{name}_min" in results.group(_group_of(results, name)):
                low, high = (results[f"{name}_{edge}"].sel(time=slice(start, end)) for edge in ("min", "max"))
                axis.fill_between(data.time, low, high, alpha=0.3, linewidth=0.0)
        axis.set_ylabel(names[0].rpartition(".")[2] + ("" if unit == "1" else f" [{unit}]"))
        axis.legend(loc="best", fontsize="small")
        axis.grid(alpha=0.3)
    axes[-1, 0].set_xlabel("time [s]")
    figure.suptitle(results.name)
    figure.tight_layout()
    figure.savefig(out, dpi=150)
    pyplot.close(figure)


def _group_of(results: Any, name: str) -> str:
    return results._where[name]
