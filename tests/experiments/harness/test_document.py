"""Reports from Markdown templates: blocks by name, numbers as in tables, a user's text never taken as markup."""

import re
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import pytest
from refusals import refuses

from experiments.harness.document import render_document
from experiments.harness.plotting import figure_png, figure_svg, house_style, new_figure
from experiments.harness.provenance import collect
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.summary import Criterion, verdict_line
from experiments.harness.tables import Column, Table
from optics.errors import ConfigError, DomainError

PROVENANCE = collect("demo", {}, variant=None, quick=True, times_s={})


def drawing():
    with house_style():
        figure, axes = new_figure(width="half")
        axes.plot([0, 1], [0, 1])
    return figure


DRAWINGS = {
    "plot": drawing,
    "svg": lambda: figure_svg(drawing()),
    "png": lambda: figure_png(drawing()),
    "div": lambda: "<div>",
    "gif": lambda: b"GIF89a",
}


@pytest.fixture
def page(tmp_path):
    def render(body, *, criteria=(), title="# T & T\n\nLead.\n\n## S\n\n", label="plain"):
        q = Quantities()
        q.axis("axis", ["x", "y"])
        q.add("te", [1.0, -2.0], "Error", unit="arcsec", dims="axis", error=[0.012, 0.034])
        q.add("count", 12345)
        path = tmp_path / "report.md"
        path.write_text(title + body, encoding="utf-8")
        outcome = Outcome(config=SimpleNamespace(label=label), result=None, data=q.dataset)
        tables = {"t": Table(columns=["<x>"], rows=[("<y>",)], caption="A *table* of <b>.")}
        tables["wide"] = Table(
            columns=["Axis", *(Column(name=f"Number {n}", unit="px") for n in range(9))], rows=[range(10)]
        )
        tables["long"] = Table(columns=["Kind"], rows=[("a",), ("b",), ("c",)])
        return render_document(
            path, outcome, tables=tables, draw=lambda name: DRAWINGS[name](), criteria=criteria, provenance=PROVENANCE
        )

    return render


def criterion(passed):
    return Criterion(name="c", value=0.0 if passed else 2.0, limit=1.0)


def test_what_could_not_notice_a_quarter_counts_neither_way():
    small, good = Criterion(name="c", value=1.1, about=1.0, limit=0.6, notices=0.6), criterion(True)
    assert verdict_line([small]) == "The simulation is not judged: the sample is too small to reveal an error of 25 %."
    assert verdict_line([good, good, small]) == (
        "The simulation is consistent: all 2 criteria hold; 1 not judged: the sample is too small to reveal an error "
        "of 25 %."
    )
    assert replace(small, value=1.7).failed


def test_prose_and_what_is_said_first(page):
    html = page(
        "> In *short*: {{ value('te', axis='x') }}″.\n", title="# T & T\n\nLead one.\n\n", criteria=[criterion(True)]
    )
    assert "<h1>T &amp; T</h1>" in html
    assert "default-src 'none'" in html  # a page fetches nothing and runs nothing
    assert "<title>T &amp; T</title>" in html
    verdict = "<strong>The simulation is consistent: the criterion holds.</strong>"
    assert f"{verdict} In <em>short</em>: 1.000 ± 0.012″." in html
    assert '<div class="lead"><p>Lead one.</p>' in html.replace("\n", "")


@pytest.mark.parametrize("label", ["<b>7 & 8</b>", "a_b_c *x* `y`", "[a](javascript:b)", "# head", "&lt;", "1. one"])
def test_text_of_a_user_is_shown_letter_by_letter(page, label):
    html = page("Label: {{ config.label }}, and so on.", label=label)
    shown = re.search("<p>Label: (.*?), and so on.</p>", html)[1]
    assert "<" not in shown
    assert unescape(shown) == label
    assert "<script" not in page("<script>alert(1)</script>")  # nor is markup of a template


def test_criteria_stand_where_the_template_says(page):
    both = [criterion(True), criterion(False)]
    sections = "Words.\n\n## One\n\n{{ figure('plot') }}\n\n## Two\n\nMore."
    first, placed = page(sections, criteria=both), page("Words.\n\n{{ criteria() }}", criteria=both)
    assert first.index("</figure>") < first.index("<h2>Criteria</h2>") < first.index("<h2>Two</h2>")
    assert placed.index("<h2>Criteria</h2>") > placed.index("Words.")
    for html in (first, placed):
        assert html.count("✓ yes") == html.count("✗ no") == html.count("<h2>Criteria</h2>") == 1
        assert 'class="verdict bad"' in html


def test_figures_of_every_source_are_numbered_in_order(page):
    html = page(
        "{% call figure('plot') %}vector, **bold**{% endcall %}\n{{ figure('plot', caption='pixels', raster=true) }}\n"
        "{{ row(figure('png', caption='file'), figure('svg', caption='ready')) }}\n{{ table('t') }}\n"
    )
    assert html.count("<svg") == 2
    assert html.count("data:image/png;base64,iVBOR") == 2
    captions = [("1", "vector"), ("2", "pixels"), ("3", "file"), ("4", "ready")]
    assert re.findall(r"Figure (\d)\.</b> (\w+)", html) == captions
    assert "<b>Table 1.</b> A <em>table</em> of &lt;b&gt;." in html
    assert "&lt;x&gt;" in html


def test_tables_fold_if_they_are_wide_and_give_the_rows_asked_for(page):
    html = page("{{ table('wide') }}\n\n{{ table('long') }}")
    assert html.count('class="fold"') == 1
    folded = re.findall(r'<td[^>]*data-of="Number (\d)" data-unit="px">(\d)</td>', html)
    assert folded == [(str(n), str(n + 1)) for n in range(9)]
    assert "<td>a</td>" in html
    html = page("{{ table('long', Kind=['a', 'c']) }}")
    assert re.findall(r"<td>(\w)</td>", html) == ["a", "c"]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("{{ figure('div') }}", "figure 1"),
        ("{{ table('u') }}", "known: long, t"),
        ("{{ value('tee', axis='x') }}", "te"),
        ("{{ config.lable }}", "lable"),
        ("{% if %}", "report.md"),
        ("{{ table('long', Kin=['a']) }}", "Kind"),
    ],
)
def test_a_wrong_template_is_refused(page, body, words):
    refuses((ConfigError, DomainError), words, page, body)
    refuses(ConfigError, "Title", page, "words", title="")
