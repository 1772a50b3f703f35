"""Sphinx settings: `pip install '.[docs]'`, then `sphinx-build -W docs site`."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import shipgrid

project = "shipgrid"
author = "The shipgrid authors"
copyright = "The shipgrid authors, Apache 2.0"
version = release = shipgrid.__version__

extensions = ["myst_parser", "sphinx.ext.mathjax", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_missing"]  # citation keys in square brackets are entries of references.bib, not links
nitpicky = False

html_theme = "alabaster"
exclude_patterns = ["figures", "extra"]
html_extra_path = ["extra"]

REPORTS = Path(__file__).parent / "extra" / "reports"
REPORTS.mkdir(parents=True, exist_ok=True)


def sail(app) -> None:
    """Make the reports of the paper's three experiments where they are missing: some six minutes, once.

    They are not kept in the repository (two megabytes); `rm -r docs/extra` has them made anew.
    """
    for name in ("dc-regulation", "ac-regulation", "mission"):
        place = REPORTS / f"{name}.html"
        if app.builder.format == "html" and not place.is_file():
            with TemporaryDirectory() as folder:
                ship, scenario = shipgrid.load_ship("ferry"), shipgrid.load_scenario(name)
                with shipgrid.simulate(ship, scenario, out=Path(folder) / name) as run:
                    shutil.copy(run.folder / "report.html", place)


def setup(app) -> None:
    """Called by Sphinx before it builds."""
    app.connect("builder-inited", sail)
