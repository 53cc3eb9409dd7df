"""``report.html``: one file that holds everything, made of a few kinds of block.

A report is data: ``Report(title, lead, sections=[Section(title, blocks=[Text, Figure, Table, Equation, Row])])``.
Criteria, verdict line and provenance are added when it is written.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure as Drawing

from experiments.harness.plotting import WIDTH_IN, equation_svg, figure_png, figure_svg, house_style
from experiments.harness.summary import Criterion, Measured, dumps
from experiments.harness.tables import Table, cell_text
from optics.errors import DomainError

__all__ = [
    "Artist",
    "Equation",
    "Figure",
    "KeyNumber",
    "Report",
    "Row",
    "Section",
    "Table",
    "Text",
    "render_html",
    "verdict_line",
]


@dataclass(frozen=True, slots=True)
class Text:
    """Paragraphs; a blank line parts them, ``*word*`` is set in italics and ``**word**`` in bold.

    Attributes
    ----------
    body : str
        Plain text; nothing in it is taken as HTML.
    """

    body: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A drawing with its caption; figures are numbered in the order of the report.

    Attributes
    ----------
    drawing : matplotlib Figure, str or bytes
        A figure (`plotting.new_figure`), an ``<svg>`` element, or the bytes of a PNG file.
    caption : str
        What is shown and what to see in it; ``*`` as in `Text`.
    alt : str
        For those who cannot see it; the caption if left empty.
    raster : bool
        Store a matplotlib figure as PNG: for tens of thousands of marks.
    """

    drawing: Drawing | str | bytes
    caption: str
    alt: str = ""
    raster: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Equation:
    """A displayed equation.

    Attributes
    ----------
    latex : str
        In matplotlib's subset of LaTeX, without dollar signs.
    note : str
        Its number in the source, e.g. "ACC18 eq. 16".
    """

    latex: str
    note: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """Two (or three) blocks side by side: figures of width "half", small tables."""

    blocks: Sequence[Figure | Table | Text]


Block = Text | Figure | Table | Equation | Row


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A titled part of the report."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyNumber:
    """A number shown large at the top.

    Attributes
    ----------
    label : str
        What it is, in a few words.
    value : float, int, str or Measured
        The number.
    unit : str
        Its unit; taken from a `Measured` if left empty.
    format : str
        Format of a plain float.
    note : str
        A few small words beneath, e.g. "published 0.12 px".
    """

    label: str
    value: float | int | str | Measured
    unit: str = ""
    format: str = ""
    note: str = ""

    @property
    def shown_unit(self) -> str:
        """The unit to print."""
        return self.unit or (self.value.unit if isinstance(self.value, Measured) else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What an experiment has to say.

    Attributes
    ----------
    title : str
        Title.
    lead : str
        One or two sentences that say what was done and what came out.
    verdict : str
        What was found, in a sentence that is true whether the criteria hold or not; it follows the line "All n
        criteria hold" or "m of n criteria do not hold". May be empty.
    key_numbers : sequence of KeyNumber
        At most four or five.
    sections : sequence of Section
        In reading order.
    """

    title: str
    lead: str
    sections: Sequence[Section]
    verdict: str = ""
    key_numbers: Sequence[KeyNumber] = ()


def verdict_line(criteria: Sequence[Criterion]) -> str:
    """How many criteria hold, as a sentence."""
    failed = sum(not criterion.passed for criterion in criteria)
    if not criteria:
        return "No criteria were set."
    if len(criteria) == 1:
        return "The criterion does not hold." if failed else "The criterion holds."
    if failed == 0:
        return f"All {len(criteria)} criteria hold."
    return f"{failed} of {len(criteria)} criteria {'does' if failed == 1 else 'do'} not hold."


def render_html(report: Report, criteria: Sequence[Criterion], provenance: Mapping[str, Any]) -> str:
    """The report as one HTML page without any reference to another file or host.

    Parameters
    ----------
    report : Report
        Its content; all text in it is escaped.
    criteria : sequence of Criterion
        Shown after the lead, with the verdict.
    provenance : mapping
        As of `experiments.harness.provenance.collect`.

    Returns
    -------
    str
        HTML text.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["cell"] = cell_text
    environment.filters["pretty"] = lambda value: dumps(value).rstrip()
    environment.filters["prose"] = lambda text: Markup(_prose(str(text)))
    environment.filters["inline"] = lambda text: Markup(_emphasis(str(text)))
    environment.globals["kind"] = lambda block: type(block).__name__
    environment.globals["draw"] = Artist()
    environment.globals["relation"] = {"<=": "≤", "<": "<", ">=": "≥", ">": ">"}
    return environment.get_template("report.html").render(
        report=report,
        criteria=criteria,
        passed=all(criterion.passed for criterion in criteria),
        verdict_line=verdict_line(criteria),
        provenance=provenance,
    )


class Artist:
    """Turns figures and equations into markup and counts them, so that ids stay apart."""

    def __init__(self) -> None:
        self._figures = 0
        self._tables = 0
        self._equations = 0

    def figure_number(self) -> int:
        self._figures += 1
        return self._figures

    def table_number(self) -> int:
        self._tables += 1
        return self._tables

    def figure(self, figure: Figure, number: int) -> Any:
        from markupsafe import Markup

        drawing = figure.drawing
        if isinstance(drawing, Drawing) and not figure.raster:
            with house_style():
                drawing = figure_svg(drawing, prefix=f"fig{number}")
        if isinstance(drawing, str):
            if not drawing.lstrip().startswith("<svg"):
                raise DomainError(f"figure {number}: text that is not an <svg> element")
            return Markup(drawing)
        width = ""
        if isinstance(drawing, Drawing):
            width = f' width="{round(96 * drawing.get_figwidth())}"'
            with house_style():
                drawing = figure_png(drawing)
        if not drawing.startswith(b"\x89PNG"):
            raise DomainError(f"figure {number}: bytes that are not a PNG file")
        data = base64.b64encode(drawing).decode("ascii")
        return Markup('<img alt=""{} src="data:image/png;base64,{}">').format(Markup(width), data)

    def equation(self, equation: Equation) -> Any:
        from markupsafe import Markup

        self._equations += 1
        return Markup(equation_svg(equation.latex, prefix=f"eq{self._equations}"))

    @staticmethod
    def half(figure: Figure) -> bool:
        """Whether a figure was made for half the width of the text."""
        drawing = figure.drawing
        return isinstance(drawing, Drawing) and drawing.get_figwidth() <= 1.1 * WIDTH_IN["half"]


def _emphasis(text: str) -> str:
    from markupsafe import escape

    safe = str(escape(" ".join(text.split())))
    safe = re.sub(r"\*\*(?=\S)(.+?)(?<=\S)\*\*", r"<strong>\1</strong>", safe)
    return re.sub(r"(?<![\w*])\*(?=[^\s*])(.+?)(?<=[^\s*])\*(?![\w*])", r"<em>\1</em>", safe)


def _prose(text: str) -> str:
    paragraphs = [part for part in re.split(r"\n\s*\n", text.strip()) if part.strip()]
    return "\n".join(f"<p>{_emphasis(part)}</p>" for part in paragraphs)
