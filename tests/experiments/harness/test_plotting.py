"""House style of the figures, their bytes, and colours of light."""

from __future__ import annotations

import re
from itertools import pairwise

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from experiments.harness.plotting import (
    WIDTH_IN,
    band_colours,
    equation_svg,
    figure_png,
    figure_svg,
    house_style,
    log_ticks,
    narrow,
    new_figure,
    side_by_side,
    wavelength_colour,
)
from optics.errors import DomainError


def drawing(**options):
    with house_style():
        figure, axes = new_figure(**options)
        axes.plot([0, 1], [0, 1])
    return figure


def test_an_equation_that_cannot_be_set_is_refused():
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


def test_ticks_of_logarithmic_axes_are_plain_numbers_within_the_limits():
    with house_style():
        _, axes = new_figure()
        axes.set(xscale="log", yscale="log", xlim=(0.3, 30.0), ylim=(1200.0, 90.0))
        log_ticks(axes, "x")
        log_ticks(axes, "y", (50, 100, 1000, 2000))
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0.5", "1", "2", "5", "10", "20"]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["100", "1000"]
    assert len(axes.get_xticks(minor=True)) == 0


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


@pytest.mark.parametrize(
    ("columns", "options", "parts"),
    [(2, {"sharey": True}, 2), (3, {"sharey": True}, 0)],
    ids=["one scale", "scale of the first"],
)
def test_panels_may_stand_one_above_the_other(columns, options, parts):
    with house_style():
        figure, axes = new_figure(1, columns, squeeze=False, **options)
        for axis in axes.ravel():
            shown = axis.imshow(np.eye(3))
        figure.colorbar(shown, ax=axes[0, -1])  # belongs to its panel
        figure_svg(figure)
        found = side_by_side(figure)
    assert len(found) == parts
    if columns == 2:
        (left, middle), (after, right) = found
        assert 0 <= left < 0.3 < middle < after + 0.02 < 0.7 < right <= 1
    for (_, end), (start, _) in pairwise(found):
        assert end < start + 0.02


def test_one_plot_is_drawn_again_for_narrow_screens():
    with house_style():
        figure, axes = new_figure(aspect_ratio=0.4)
        for number in range(6):
            axes.plot([0, 1], [0, number], label=f"a long name, number {number}")
        axes.legend(ncols=6, loc="upper center", bbox_to_anchor=(0.5, -0.2))
        assert narrow(figure)
        figure_svg(figure)
        legend = axes.get_legend().get_window_extent(FigureCanvasAgg(figure).get_renderer())
    assert figure.get_figwidth() < 5 < WIDTH_IN["full"]
    assert legend.width <= figure.bbox.width
    with house_style():
        image, axes = new_figure()
        axes.imshow(np.eye(3))
        assert not narrow(image)
        assert not narrow(new_figure(1, 3)[0])
        assert not narrow(new_figure(width="half")[0])
