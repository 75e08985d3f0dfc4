"""Configuration of the documentation: `sphinx-build -W .github/docs out/docs`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import stiffopt

project = "stiffopt"
release = stiffopt.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "command_reference",
]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 4
# Relative links of included pages lead to files beside them in the repository, not to pages.
suppress_warnings = ["myst.xref_missing"]
autodoc_typehints = "none"
napoleon_google_docstring = False
napoleon_use_ivar = True
html_theme = "furo"
html_title = f"stiffopt {release}"
exclude_patterns = ["_build"]
