"""Sphinx: MyST pages, and a gallery whose examples are run at every build."""

import json
from importlib.metadata import version as package_version
from pathlib import Path

from roomfit.files.schema import Campaign, json_schema

project = "roomfit"
author = "the roomfit founders"
release = package_version("roomfit")
extensions = [
    "matplotlib.sphinxext.mathmpl",  # equations as pictures: no page fetches anything to show them
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "_templates", "examples", "gallery/*.py", "gallery/*.ipynb"]
templates_path = ["_templates"]
default_role = "code"  # docstrings quote names in single backticks

html_theme = "furo"
html_title = f"roomfit {release}"
html_static_path = ["_static"]
html_css_files = ["roomfit.css"]
html_show_copyright = False
html_show_sourcelink = False
html_copy_source = False

myst_heading_anchors = 3
autodoc_typehints = "none"
autosummary_generate = True
napoleon_google_docstring = False
napoleon_use_rtype = False
# several names of one meaning stay in one entry, as they are written
napoleon_custom_sections = [("Attributes", "params_style")]
toc_object_entries = False
mathmpl_fontsize = 12.0
mathmpl_srcset = ["2x"]
suppress_warnings = ["config.cache"]
sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/plot_",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "within_subsection_order": "FileNameSortKey",
}


def _write_schema(app, error):
    """Put the JSON schema of a campaign beside the first page."""
    if error is None:
        text = json.dumps(json_schema(Campaign, "Campaign"), indent=1)
        (Path(app.outdir) / "campaign.schema.json").write_text(text + "\n", encoding="utf-8")


def setup(app):
    """Register what is done after the pages."""
    app.connect("build-finished", _write_schema)
