"""Settings of Sphinx for these pages. `make docs` needs no network."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]

project = "irl-bench"
author = "the irl-bench authors"
extensions = ["myst_parser", "sphinx.ext.autodoc", "mathml", "plain_docstrings", "generated_pages"]
exclude_patterns = ["_ext"]
html_theme = "furo"
html_title = "irl-bench"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_copy_source = False
html_show_copyright = False
html_theme_options = {"source_edit_link": ""}
html_math_renderer = "mathml"
pygments_style = "friendly"
pygments_dark_style = "monokai"
highlight_language = "none"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"
autodoc_inherit_docstrings = False
autodoc_type_aliases = {name: name for name in ("Array", "Learner", "Payment", "RandomActions")}
smartquotes = False
python_use_unqualified_type_names = True
