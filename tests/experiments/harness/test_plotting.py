"""House style of the figures, their bytes, and colours of light."""

import re

import numpy as np

from experiments.harness.plotting import (
    band_colours,
    figure_svg,
    house_style,
    new_figure,
    wavelength_colour,
)


def test_ids_of_figures_stay_apart_and_references_follow():
    with house_style():
        figure, axes = new_figure()
        axes.plot([0, 1], [0, 1])
    first, second = figure_svg(figure, prefix="a"), figure_svg(figure, prefix="b")
    assert first.replace("a-", "").count("<path") == second.replace("b-", "").count("<path")
    ids = set(re.findall(r'\bid="([^"]+)"', first))
    assert ids
    assert not ids & set(re.findall(r'\bid="([^"]+)"', second))
    used = set(re.findall(r'(?:href="|url\()#([^")]+)', first))
    assert used
    assert used <= ids


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
