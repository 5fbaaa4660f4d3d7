"""Settings of the documentation; `docs/_ext` holds what is special to this project.

`uv run --group docs sphinx-build -W --keep-going docs docs/_build/html` builds it without network. The examples are
shown with the committed pictures; SIONNA_RADAR_GALLERY=small or full runs them, in small flights or as they are.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))

import sionna_radar  # noqa: E402

project = "sionna_radar"
author = "The sionna_radar developers"
project_copyright = author  # no year: a build does not depend on the day
version = release = sionna_radar.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.autosummary",
    "sphinx_gallery.gen_gallery",
    "sphinx_copybutton",
    "made_pages",
    "repository_pages",
    "house_docstrings",
    "example_gallery",
    "mathml",
]
nitpicky = True
exclude_patterns = ["_build", "_ext", "_static", "generated/gallery_source"]
default_role = "py:obj"  # single backticks, as in the docstrings: a link where the name is public, else code

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist", "fieldlist"]
myst_heading_anchors = 3
html_math_renderer = "mathml"

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
python_maximum_signature_line_length = 88
autosummary_generate = False
napoleon_google_docstring = False
napoleon_use_rtype = False
add_module_names = False

# One list of all pages beside each, no scripts to speak of, and good on a telephone.
html_theme = "furo"
html_title = "sionna_radar"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_search_scorer = str(HERE / "_static" / "search_scores.js")
html_show_sourcelink = False
html_copy_source = False
pygments_style = "tango"
smartquotes = False  # `--set` is no dash
copybutton_exclude = ".linenos, .gp, .go"

GALLERY = os.environ.get("SIONNA_RADAR_GALLERY", "pictures")
sphinx_gallery_conf = {
    "examples_dirs": "generated/gallery_source",
    "gallery_dirs": "gallery",
    "plot_gallery": GALLERY != "pictures",
    "image_scrapers": ("example_gallery.picture_scraper",),
    "within_subsection_order": "example_gallery.InTheirOrder",
    "reset_modules": (),
    "abort_on_example_error": True,
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "min_reported_time": 1e9,
    "show_signature": False,
    "default_thumb_file": str(HERE.parent / "examples" / "images" / "demo.png"),
}
