"""Pictures of the gallery: every matplotlib figure that a script leaves behind, made with pyplot or without.

HTML files that it leaves behind (values that are their paths) are shown too, in a frame.
"""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

SEEN = "_shown_in_gallery"


def _figures(values: list[object]) -> list[Figure]:
    """Figures among the values and of axes among them, in the order in which they stand there."""
    found: dict[int, Figure] = {}
    for value in values:
        several = value.ravel() if isinstance(value, np.ndarray) and value.dtype == object else [value]
        for one in several:
            figure = one.get_figure(root=True) if isinstance(one, Axes) else one
            if isinstance(figure, Figure):
                found.setdefault(id(figure), figure)
    return list(found.values())


def figure_scraper(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save the figures that a block made (a scraper of sphinx-gallery) and return the text that shows them."""
    opened = [pyplot.figure(number) for number in pyplot.get_fignums()]
    paths = []
    for figure in _figures([*block_vars["example_globals"].values(), *opened]):
        if getattr(figure, SEEN, False):
            continue
        setattr(figure, SEEN, True)
        paths.append(block_vars["image_path_iterator"].next())
        figure.savefig(paths[-1], dpi=110)
    pyplot.close("all")
    files = [one for one in block_vars["example_globals"].values() if isinstance(one, Path) and one.suffix == ".html"]
    return figure_rst(paths, gallery_conf["src_dir"]) + "".join(map(_frame, files))


def _frame(file: Path) -> str:
    """The text that shows an HTML file."""
    content = escape(file.read_text(encoding="utf-8")).replace("\n", "&#10;")
    return f'\n\n.. raw:: html\n\n    <iframe class="page" title="{file.stem}" srcdoc="{content}"></iframe>\n\n'


def _get_sg_image_scraper() -> Any:
    """What sphinx-gallery looks for in a module that is named as a scraper."""
    return figure_scraper
