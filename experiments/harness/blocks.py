"""Blocks of a report other than prose and tables: figures, equations, rows of them, headline numbers."""

from __future__ import annotations

import base64
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

from markupsafe import Markup
from matplotlib.figure import Figure as Drawing

from experiments.harness.plotting import (
    WIDTH_IN,
    equation_svg,
    figure_png,
    figure_svg,
    house_style,
    narrow,
    side_by_side,
)
from experiments.harness.summary import Measured
from experiments.harness.system import shared
from experiments.harness.tables import Table
from optics.errors import DomainError


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A drawing with its caption; figures are numbered in the order of the report."""

    drawing: Drawing | str | bytes  # A figure (`plotting.new_figure`), an ``<svg>`` element, or the bytes of a PNG file
    caption: str  # What is shown and what to see in it; ``*`` as in `Text`
    alt: str = ""  # Text in its place; the caption if left empty
    raster: bool = False  # Store a matplotlib figure as PNG: for tens of thousands of marks


@dataclass(frozen=True, slots=True, kw_only=True)
class Equation:
    """A displayed equation."""

    latex: str  # In matplotlib's subset of LaTeX, without dollar signs
    note: str = ""  # Its number in the source, e.g. "ACC18 eq. 16"


@dataclass(frozen=True, slots=True)
class FigureRow:
    """Two or three blocks side by side: figures of width "half", small tables."""

    blocks: Sequence[Figure | Table]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyNumber:
    """A large number at the top of the report."""

    label: str
    value: float | int | str | Measured
    unit: str = ""  # As printed
    format: str = ""  # Of a plain float
    note: str = ""  # Small print under it, e.g. "published 0.12 px"


class Artist:
    """Turns figures and equations into markup and numbers them, so that their ids differ."""

    def __init__(self, figures: Sequence[Figure]) -> None:
        with house_style():
            markup = shared(_markup, list(enumerate(figures, 1)))
        self._markup = {id(figure): text for figure, text in zip(figures, markup, strict=True)}
        self.figure_number, self.table_number, self._equation_number = (count(1).__next__ for _ in range(3))

    def figure(self, figure: Figure) -> Markup:
        return Markup(self._markup[id(figure)])

    def equation(self, equation: Equation) -> Markup:
        return Markup(equation_svg(equation.latex, prefix=f"eq{self._equation_number()}"))

    @staticmethod
    def half(figure: Figure) -> bool:
        """Whether a figure fits half the width of the text."""
        return isinstance(figure.drawing, Drawing) and figure.drawing.get_figwidth() <= 1.1 * WIDTH_IN["half"]


def _markup(numbered: tuple[int, Figure]) -> str:
    """A figure as HTML, its ids prefixed by its number."""
    number, figure = numbered
    drawing = figure.drawing
    if isinstance(drawing, Drawing) and not figure.raster:
        text = figure_svg(drawing, prefix=f"fig{number}")
        parts = side_by_side(drawing)
        return text + (_in_parts(text, parts) if parts else _narrow_too(drawing, f"fig{number}n"))
    if isinstance(drawing, str):
        if not drawing.lstrip().startswith("<svg"):
            raise DomainError(f"figure {number}: text that is not an <svg> element")
        return drawing
    width = ""
    if isinstance(drawing, Drawing):
        width = f' width="{round(96 * drawing.get_figwidth())}"'
        drawing = figure_png(drawing)
    if not drawing.startswith(b"\x89PNG"):
        raise DomainError(f"figure {number}: bytes that are not a PNG file")
    data = base64.b64encode(drawing).decode("ascii")
    return f'<img alt=""{width} src="data:image/png;base64,{data}">'


def _narrow_too(drawing: Drawing, prefix: str) -> str:
    """A version of the figure for narrow screens; "" if it cannot be so narrow, of which matplotlib warns."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        try:
            svg = figure_svg(drawing, prefix=prefix) if narrow(drawing) else ""
        except UserWarning:
            return ""
    return svg.replace("<svg", '<svg class="narrow" aria-hidden="true"', 1)


def _in_parts(svg: str, parts: Sequence[tuple[float, float]]) -> str:
    """Parts of a figure below each other, for narrow screens: the same drawing through several windows."""
    box = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)
    group = re.search(r'<g id="([^"]+)"', svg)
    if box is None or group is None:
        return ""
    width, height = float(box[1]), float(box[2])
    windows = (
        f'<svg class="part" viewBox="{start * width:.1f} 0 {(end - start) * width:.1f} {height:g}" aria-hidden="true">'
        f'<use href="#{group[1]}"/></svg>'
        for start, end in parts
    )
    return "".join(windows)
