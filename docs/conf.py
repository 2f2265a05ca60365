"""Sphinx: MyST pages, and a gallery whose examples are run at every build."""

from importlib.metadata import version as package_version

project = "roomfit"
author = "the roomfit founders"
release = package_version("roomfit")
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "examples", "gallery/*.py", "gallery/*.ipynb"]
html_theme = "alabaster"
html_theme_options = {
    "description": "The absorption of a real room's walls, and how sure one can be",
    "fixed_sidebar": True,
    "page_width": "62em",
}
myst_enable_extensions = ["dollarmath"]
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autosummary_generate = True
napoleon_google_docstring = False
suppress_warnings = ["config.cache"]
sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/plot_",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "within_subsection_order": "FileNameSortKey",
}
