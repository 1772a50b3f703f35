"""Sphinx settings: `pip install '.[docs]'`, then `sphinx-build -W docs site`."""

from __future__ import annotations

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
exclude_patterns = ["figures"]
