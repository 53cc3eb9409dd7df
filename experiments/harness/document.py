"""``report.html`` from a Markdown template: prose in ``report.md``, tables and figures called by name.

A template is Jinja in Markdown; similar reports extend a common one. Its ``# title`` comes first, then the lead; a
block quote holds the verdict, ``numbers`` the large figures at the top, and every ``## head`` begins a section.
Sections after the first one with a figure are folded under their headings. A template has ``config``, ``result``,
``data``, ``outcome`` and

===================================  ==================================================================================
``value("q", axis="x")``             a quantity by name; printed with its uncertainty, or in its own format
``table("name")``                    a table of the experiment; ``table("name", Head=[...])`` only the rows with these
                                     cells
``figure("name", ...)``              a drawing: figure NAME of the sections, drawn with the outcome and the further
                                     arguments; its caption stands in ``{% call figure("name") %} ... {% endcall %}``
``row(a, b)``                        figures or tables side by side
``equation(r"...", note)``           a displayed equation, in matplotlib's subset of LaTeX
``numbers(number(...))``             the large figures: ``number(label, value, unit, format, note)``
``criteria()``                       the table of criteria; by default it follows the first section with a figure
``x | cell(".3f")``, ``x | g``       a number as tables set it; as %g
``x | digits(2)``                    a number with this number of significant digits
``x | md``                           text that is Markdown; any other text is taken letter by letter
===================================  ==================================================================================

Printed numbers are set as in tables: real minus signs, powers of ten, value ± uncertainty.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from experiments.harness.blocks import Artist, Equation, Figure, FigureRow, KeyNumber
from experiments.harness.glossary import Glossary
from experiments.harness.quantities import Outcome, Quantity, shown_unit
from experiments.harness.summary import CRITERIA_NOTE, Criterion, Measured, dumps, percent, verdict_line
from experiments.harness.tables import Table, cell_text, significant
from optics.errors import ConfigError, DomainError, unknown_name

_MARK = re.compile("(?:<p>)?\ue000(\\d+)\ue001(?:</p>)?")
_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|~&])")


@dataclass(frozen=True, slots=True)
class _KeyNumbers:
    items: Sequence[KeyNumber]


@dataclass(frozen=True, slots=True)
class _CriteriaTable:
    pass


@dataclass
class _Context:
    """Functions of a template; the Markdown holds a placeholder for each block."""

    outcome: Outcome
    tables: Mapping[str, Any]
    draw: Callable[..., Any]
    blocks: list[Any] = field(default_factory=list)

    def _mark(self, block: Any) -> Markup:
        self.blocks.append(block)
        return Markup(f"\n\n\ue000{len(self.blocks) - 1}\ue001\n\n")

    def value(self, name: str, **at: Any) -> Any:
        quantity = self.outcome.quantity(name, **at)
        return quantity.values if quantity.dims else quantity

    def table(self, name: str, **only: Sequence[Any]) -> Markup:
        if name not in self.tables:
            raise unknown_name("table", name, self.tables)
        table = self.tables[name]
        heads = [column.name for column in table.heads]
        for head, cells in only.items():
            if head not in heads:
                raise unknown_name(f"column of table {name!r}:", head, heads)
            table = replace(table, rows=[row for row in table.rows if row[heads.index(head)] in cells])
        return self._mark(table)

    def figure(
        self, name: str, *arguments: Any, caption: str = "", alt: str = "", raster: bool = False, caller: Any = None
    ) -> Markup:
        text = caller() if caller is not None else caption
        drawing = self.draw(name, *arguments)
        return self._mark(Figure(drawing=drawing, caption=Markup(text), alt=alt or _plain(text), raster=raster))

    def row(self, *marks: str, caller: Any = None) -> Markup:
        text = "".join(marks) + (caller() if caller is not None else "")
        return self._mark(FigureRow([self.blocks[int(number)] for number in re.findall("\ue000(\\d+)\ue001", text)]))

    def equation(self, latex: str, note: str = "") -> Markup:
        return self._mark(Equation(latex=latex, note=note))

    def numbers(self, *items: KeyNumber) -> Markup:
        return self._mark(_KeyNumbers([item for item in items if item]))

    @staticmethod
    def number(label: str, value: Any, unit: str = "", format: str = "", note: Any = "") -> KeyNumber:
        if isinstance(value, Quantity):
            unit, format, value = unit or value.unit, format or value.format, value.scalar()
        if isinstance(value, np.generic):
            value = value.item()
        unit = unit or (value.unit if isinstance(value, Measured) else "")
        return KeyNumber(label=label, value=value, unit=shown_unit(unit), format=format, note=str(_printed(note)))

    def criteria(self) -> Markup:
        return self._mark(_CriteriaTable())


def _plain(text: str) -> str:
    return " ".join(re.sub(r"\\(.)|[*`]", r"\1", text).split())


def _printed(value: Any) -> Any:
    """What ``{{ value }}`` prints."""
    if isinstance(value, Markup):
        return value
    if isinstance(value, Quantity):
        return Markup(cell_text(value.scalar(), value.format))
    if isinstance(value, str):
        return Markup(_SPECIAL.sub(r"\\\1", value))
    if isinstance(value, (int, float, Measured, np.generic)):
        return Markup(cell_text(value))
    return value


def _cell(value: Any, format: str = "") -> Markup:
    return Markup(cell_text(value.scalar() if isinstance(value, Quantity) else value, format))


def _digits(value: Any, digits: int = 2) -> Markup:
    number = value.values.item() if isinstance(value, Quantity) else value
    return Markup(significant(number.value if isinstance(number, Measured) else float(number), digits))


def _general(value: Any) -> Markup:
    return Markup(f"{value:g}".replace("-", "\N{MINUS SIGN}"))


def _environment(folder: Path, **options: Any) -> Any:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    options |= {"undefined": StrictUndefined, "trim_blocks": True, "lstrip_blocks": True}
    return Environment(loader=FileSystemLoader(folder), **options)


def _typeset(context: _Context, path: Path) -> str:
    """The Markdown of a template, with marks for its blocks."""
    from jinja2 import TemplateError

    environment = _environment(path.parent, finalize=_printed)
    environment.filters |= {"cell": _cell, "g": _general, "digits": _digits, "md": Markup}
    calls = ("value", "table", "figure", "row", "equation", "numbers", "number", "criteria")
    environment.globals |= {call: getattr(context, call) for call in calls}
    outcome = context.outcome
    try:
        return environment.get_template(path.name).render(
            config=outcome.config, result=outcome.result, data=outcome.data, outcome=outcome
        )
    except TemplateError as error:
        raise ConfigError(f"report template {path.name}: {error}") from error


def render_document(
    path: Path,
    outcome: Outcome,
    *,
    tables: Mapping[str, Any],
    draw: Callable[..., Any],
    criteria: Sequence[Criterion],
    provenance: Mapping[str, Any],
    judged: str = "simulation",
    folded: bool = True,
) -> str:
    """The report as one HTML page without a reference to another file or host; ``folded``: later sections closed."""
    from markdown_it import MarkdownIt

    context = _Context(outcome, {name: table for name, table in tables.items() if isinstance(table, Table)}, draw)
    text = _typeset(context, path)
    markdown = MarkdownIt("commonmark", {"html": False}).enable("table")
    page, sections = _split(markdown, text, context.blocks, path.name)
    answer = _after_first_figure(sections, context.blocks)
    if folded:
        sections[answer:] = [_folded(section) for section in sections[answer:]]
    if criteria and not any(isinstance(block, _CriteriaTable) for block in context.blocks):
        sections.insert(answer, context.criteria())
    page["sections"] = "\n".join(sections)
    environment = _environment(Path(__file__).with_name("templates"), autoescape=True)
    environment.filters |= {
        "cell": cell_text,
        "percent": percent,
        "shown_unit": shown_unit,
        "pretty": lambda value: dumps(value).rstrip(),
        "inline": lambda words: Markup(markdown.renderInline(" ".join(str(words).split()))),
    }
    environment.globals |= {
        "kind": lambda block: type(block).__name__.lstrip("_"),
        "draw": Artist([block for block in context.blocks if isinstance(block, Figure)]),
        "criteria": criteria,
        "criteria_note": CRITERIA_NOTE,
        "provenance": provenance,
    }
    blocks = environment.get_template("blocks.html").make_module(vars={"provenance": provenance})
    show = blocks.show  # a macro of the template
    filled = {
        name: Markup(_MARK.sub(lambda mark: str(show(context.blocks[int(mark[1])])).strip(), html))
        for name, html in page.items()
    }
    glossary = Glossary()
    remarks: tuple[str, ...] = getattr(outcome.config, "remarks", tuple)()
    filled = {name: html if name == "title" else glossary.mark(str(html)) for name, html in filled.items()}
    return environment.get_template("report.html").render(
        **filled,
        passed=not any(criterion.failed for criterion in criteria),
        verdict_line=verdict_line(criteria, judged) if criteria else "",
        remarks=remarks,
        glossary=glossary,
    )


def _split(markdown: Any, text: str, blocks: Sequence[Any], name: str) -> tuple[dict[str, str], list[str]]:
    """HTML of title, lead, verdict and numbers, and of the sections."""
    tokens = markdown.parse(text)
    edges = [n for n, token in enumerate(tokens) if token.type == "heading_open" and token.tag == "h2"] + [len(tokens)]

    def html(part: Sequence[Any]) -> str:
        return str(markdown.renderer.render(part, markdown.options, {}))

    page = {"title": "", "lead": "", "verdict": "", "numbers": ""}
    for part in _top_level(tokens[: edges[0]]):
        opening = part[0]
        if opening.type == "heading_open" and opening.tag == "h1":
            page["title"] = html(part[1:2])
        elif opening.type == "blockquote_open":
            page["verdict"] += " ".join(html([token]) for token in part if token.type == "inline")
        elif (mark := _MARK.fullmatch(html(part).strip())) and isinstance(blocks[int(mark[1])], _KeyNumbers):
            page["numbers"] += html(part)
        else:
            page["lead"] += html(part)
    if not page["title"]:
        raise ConfigError(f"report template {name}: a first line '# Title' is needed")
    return page, [f"<section>\n{html(tokens[start:end])}</section>" for start, end in pairwise(edges)]


def _after_first_figure(sections: Sequence[str], blocks: Sequence[Any]) -> int:
    """Number of sections up to the first figure, which hold the answer."""
    for number, html in enumerate(sections):
        blocks_here = [blocks[int(mark)] for mark in _MARK.findall(html)]
        blocks_here += [inner for block in blocks_here if isinstance(block, FigureRow) for inner in block.blocks]
        if any(isinstance(block, Figure) for block in blocks_here):
            return number + 1
    return len(sections)


def _folded(section: str) -> str:
    """The section with its text under its heading, shown when the heading is clicked, and on paper."""
    head, _, rest = section.removeprefix("<section>\n").removesuffix("</section>").partition("</h2>")
    return f'<details class="section">\n<summary>{head}</h2></summary>\n{rest}</details>'


def _top_level(tokens: Sequence[Any]) -> list[list[Any]]:
    """Tokens grouped by the block of the outermost level that they belong to."""
    groups: list[list[Any]] = []
    depth = 0
    for token in tokens:
        if depth == 0:
            groups.append([])
        groups[-1].append(token)
        depth += token.nesting
    if depth:
        raise DomainError("the report's Markdown does not close its blocks")
    return groups
