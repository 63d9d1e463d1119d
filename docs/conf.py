"""How Sphinx builds the documentation; `make docs` runs it with warnings as errors."""

import os
import sys
from pathlib import Path

import piezoid

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_extensions"))
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

# The kernel that runs the cells: nothing in the home folder, no remark on how it is reached.
os.environ["IPYTHONDIR"] = str(HERE.parent / "build" / "docs" / "ipython")
_profile = Path(os.environ["IPYTHONDIR"]) / "profile_default"
_profile.mkdir(parents=True, exist_ok=True)
(_profile / "ipython_kernel_config.py").write_text("c.IPKernelApp.log_level = 40\n")

project = "piezoid"
author = "The piezoid developers"
copyright = author
release = piezoid.__version__

extensions = [
    "sphinx.ext.autodoc",
    "myst_nb",
    "sphinx_copybutton",
    "docstrings",
    "gallery",
    "zoo",
    "mathml",
    "shell",
    "targets_picture",
]
exclude_patterns = ["_extensions"]
nitpicky = True
nitpick_ignore_regex = [("py:.*", ".*")]  # types of other packages; our own names are checked

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 120

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True

html_theme = "pydata_sphinx_theme"
html_title = f"piezoid {release}"
html_static_path = ["_static"]
html_css_files = ["piezoid.css"]
html_math_renderer = "mathml"
html_show_sourcelink = False
html_show_copyright = False
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 5,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": [],
    "footer_end": [],
}
html_sidebars = {"index": []}
copybutton_exclude = ".linenos, .gp, .go"
