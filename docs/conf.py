"""Settings of the documentation site; `make docs` builds it into build/docs, without a network."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE / "gallery")]

import geraf2  # noqa: E402 - after the path

project = "geraf2"
author = "The geraf2 developers"
project_copyright = "the geraf2 developers, Apache-2.0"
release = geraf2.__version__
version = release.split("+")[0]

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.doctest",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "docstrings",
    "flowchart",
    "formulas",
    "generated",
]
root_doc = "index"
# README.md is the list of pages where the folder is read without a site.
exclude_patterns = ["README.md", "_*", "gallery"]
templates_path = ["_templates"]
default_role = "literal"
nitpicky = False
keep_warnings = False
smartquotes_action = "qe"  # quotes and ellipses; two hyphens are a flag, no dash

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "deflist"]
myst_fence_as_directive = ["mermaid"]

autosummary_generate = True
autosummary_ignore_module_all = False
# Names of `__all__` are imported from elsewhere; `geraf2.__dir__` does not list `__all__` itself.
autosummary_imported_members = True
# A name of the public face has its page there, not once more in its subpackage.
autosummary_context = {"public": geraf2.__all__}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
napoleon_google_docstring = False
# The examples of the docstrings run in the tests (tests/test_public.py), those of pages as well.
doctest_test_doctest_blocks = ""

html_theme = "pydata_sphinx_theme"
html_title = "geraf2"
html_static_path = ["_static"]
html_favicon = "_static/mark.svg"
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "navbar_align": "left",
    "navigation_depth": 2,
    "collapse_navigation": True,  # a whole tree on each of 200 pages takes a minute
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
# Pages of single names are reached from their list; a tree beside each takes seconds to make.
html_sidebars = {"generated/api/*": []}
html_context = {"default_mode": "auto"}

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "generated/gallery",
    "filename_pattern": r"/plot_",
    "ignore_pattern": r"pictures\.py",
    "plot_gallery": os.environ.get("GERAF2_GALLERY", "") == "run",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "write_computation_times": False,
    "within_subsection_order": "FileNameSortKey",
}
