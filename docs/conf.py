"""How the documentation is built: ``python -m sphinx -W -j 2 docs build/site`` from the repository root."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]
# notebooks and parallel readers are processes of their own: they shall find the same packages
os.environ["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), *filter(None, [os.environ.get("PYTHONPATH")])])

project = "starbench"
author = "The starbench authors"
copyright = "The starbench authors, MIT licence"

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_nb",
    "sphinx_gallery.gen_gallery",
    "api_pages",
    "code_links",
    "mathml",
    "site_check",
]
exclude_patterns = ["gallery/README.rst", "examples", "**.ipynb_checkpoints"]
nitpicky = False
default_role = "obj"
html_math_renderer = "mathml"  # shown by the browser itself: nothing is loaded from elsewhere

# Names
autodoc_typehints = "none"
autosummary_generate = [f"api/{page}.rst" for page in ("optics", "render", "calib", "experiments", "further")]
autosummary_imported_members = False
templates_path = ["_templates"]
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

# Markdown and notebooks
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE.parent / "build" / "notebooks")
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

# Gallery
sphinx_gallery_conf = {
    "examples_dirs": ["gallery"],
    "gallery_dirs": ["auto_gallery"],
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": ("figures",),
    "reset_modules": (),
    "abort_on_example_error": False,
    "backreferences_dir": "auto_gallery/backreferences",
    "doc_module": ("optics", "render", "calib", "experiments"),
    "reference_url": {"optics": None, "render": None, "calib": None, "experiments": None},
    "capture_repr": (),
    "download_all_examples": False,
    "show_signature": False,
    "notebook_extensions": set(),
    "write_computation_times": False,
    "min_reported_time": 10,
    "plot_gallery": "True",
    "remove_config_comments": True,
}

# Pages
html_theme = "pydata_sphinx_theme"
html_title = "starbench"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "navigation_with_keys": False,
    "show_prev_next": False,
    "header_links_before_dropdown": 8,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "monokai",
}
