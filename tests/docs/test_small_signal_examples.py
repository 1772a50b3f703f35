"""The examples of small signals run and end in their figure."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("name", ["plot_modes", "plot_bus_impedance"])
def test_the_example_ends_in_a_figure(name, tmp_path, monkeypatch):
    figure = tmp_path / f"{name}.png"
    monkeypatch.setattr(sys, "argv", [name, "--out", str(figure)])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert figure.stat().st_size > 20_000
