"""Blocks of the report and the house style of its figures."""

from __future__ import annotations

import re

import matplotlib as mpl
import numpy as np
import pytest

from experiments.harness.plotting import (
    band_colours,
    equation_svg,
    figure_png,
    figure_svg,
    house_style,
    new_figure,
    wavelength_colour,
)
from experiments.harness.report import Equation, Figure, Report, Section, Table, Text, render_html, verdict_line
from experiments.harness.summary import Criterion
from optics.errors import DomainError

PROVENANCE = {
    "experiment": "demo",
    "seed": 1,
    "quick": True,
    "finished_utc": "2026-01-01T00:00:00+00:00",
    "runtime_s": 1.0,
    "stages_s": {},
    "peak_memory_mb": 1.0,
    "backend": {"variant": None, "llvm": None, "threads": 2},
    "machine": {"cpu": "cpu", "system": "Linux", "architecture": "x86_64"},
    "python": "3.11",
    "packages": {"numpy": "2"},
    "git": None,
    "config": {},
}


def page(*blocks, criteria=()):
    report = Report(title="T & T", lead="lead", sections=[Section(title="S", blocks=list(blocks))])
    return render_html(report, criteria, PROVENANCE)


def drawing(**options):
    with house_style():
        figure, axes = new_figure(**options)
        axes.plot([0, 1], [0, 1])
    return figure


def criterion(passed):
    return Criterion(name="c", value=0.0 if passed else 2.0, limit=1.0)


@pytest.mark.parametrize(
    ("passed", "line"),
    [
        ([], "No criteria were set."),
        ([True], "The criterion holds."),
        ([False], "The criterion does not hold."),
        ([True, True], "All 2 criteria hold."),
        ([True, False, True], "1 of 3 criteria does not hold."),
        ([False, False, True], "2 of 3 criteria do not hold."),
    ],
)
def test_verdict_line(passed, line):
    assert verdict_line([criterion(one) for one in passed]) == line


def test_text_is_prose_with_emphasis_and_nothing_else():
    html = page(Text("One *two* and **three**, 2 * 3 * 4 & <i>x</i>.\n\nNext."))
    assert "<p>One <em>two</em> and <strong>three</strong>, 2 * 3 * 4 &amp; &lt;i&gt;x&lt;/i&gt;.</p>" in html
    assert "<p>Next.</p>" in html
    assert "T &amp; T" in html


def test_failed_criterion_is_marked():
    html = page(criteria=[criterion(True), criterion(False)])
    assert html.count("✓ yes") == 1
    assert html.count("✗ no") == 1
    assert 'class="verdict bad"' in html


def test_figures_of_every_source():
    svg = figure_svg(drawing())
    html = page(
        Figure(drawing=drawing(), caption="vector"),
        Figure(drawing=drawing(), caption="pixels", raster=True),
        Figure(drawing=figure_png(drawing()), caption="file"),
        Figure(drawing=svg, caption="ready"),
    )
    assert html.count("<svg") == 2
    assert html.count("data:image/png;base64,iVBOR") == 2
    assert "Figure 4." in html


@pytest.mark.parametrize("wrong", ["<div>", b"GIF89a"])
def test_figure_of_another_kind_is_refused(wrong):
    with pytest.raises(DomainError, match="figure 1"):
        page(Figure(drawing=wrong, caption=""))


def test_table_columns_are_escaped():
    assert "&lt;x&gt;" in page(Table(columns=["<x>"], rows=[("<y>",)]))


def test_equation_is_drawn_and_told():
    html = page(Equation(latex=r"\sigma^2 < \lambda", note="eq. 1"))
    assert "<svg" in html
    assert r'aria-label="\sigma^2 &lt; \lambda"' in html
    with pytest.raises(DomainError, match="cannot be set"):
        equation_svg(r"\nosuchcommand{")


def test_ids_of_figures_stay_apart_and_references_follow():
    figure = drawing()
    first, second = figure_svg(figure, prefix="a"), figure_svg(figure, prefix="b")
    assert first.replace("a-", "").count("<path") == second.replace("b-", "").count("<path")
    ids = set(re.findall(r'\bid="([^"]+)"', first))
    assert ids
    assert not ids & set(re.findall(r'\bid="([^"]+)"', second))
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', first))
    assert used
    assert used <= ids


def test_same_figure_same_bytes():
    assert figure_svg(drawing()) == figure_svg(drawing())
    assert figure_png(drawing()) == figure_png(drawing())


def test_png_has_the_asked_resolution_and_leaves_the_figure():
    figure = drawing(width="half", aspect_ratio=1.0)
    before = figure.get_dpi()
    data = figure_png(figure, dpi=100)
    assert int.from_bytes(data[16:20], "big") == 370  # PNG header: width
    assert figure.get_dpi() == before


def test_style_is_gone_afterwards():
    before = dict(mpl.rcParams)
    with house_style():
        assert mpl.rcParams["axes.spines.top"] is False
    assert dict(mpl.rcParams) == before


def channels(colour):
    return [int(colour[start : start + 2], 16) for start in (1, 3, 5)]


def test_colours_of_light():
    red, green, blue = (channels(wavelength_colour(nm)) for nm in (650.0, 530.0, 460.0))
    assert red[0] > 2 * max(red[1:])
    assert green[1] > 2 * min(green) and green[1] == max(green)  # noqa: PT018  # one statement about one colour
    assert blue[2] == max(blue)
    assert wavelength_colour(800.0) == wavelength_colour(690.0)  # what the eye cannot see gets its last hue


def luminance(colour):
    """Relative luminance of sRGB (IEC 61966-2-1)."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in np.array(channels(colour)) / 255]
    return float(np.dot(linear, [0.2126, 0.7152, 0.0722]))


def test_bands_are_told_apart_without_colour_and_keep_their_order():
    colours = band_colours([800.0, 500.0, 600.0])
    dark, light, middle = (luminance(colour) for colour in colours)
    assert dark < 0.6 * middle < 0.6 * 0.8 * light
    assert band_colours([500.0, 600.0, 800.0]) == (colours[1], colours[2], colours[0])
    assert len(band_colours([600.0])) == 1


@pytest.mark.parametrize("wavelength", [0.0, -5.0, float("nan")])
def test_no_colour_for_no_wavelength(wavelength):
    with pytest.raises(DomainError, match="must be positive"):
        wavelength_colour(wavelength)
