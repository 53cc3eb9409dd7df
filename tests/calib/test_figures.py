"""Drawings of stars and residuals: groups, positions and arrows as in the tables."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from star_images import NOISE, gaussian_stars, image_of, stamps_of

from calib import StarFlag, draw_residuals, get_centroider, mark_stars, show_image, star_marks

X, Y = np.array([4.8, 5.1, 5.3]), np.array([5.2, 4.9, 5.0])


@pytest.fixture(scope="module")
def stars():
    """Three stars, the first identified, the last blended."""
    flux = np.array([1e4, 3e4, 2e4])[:, None, None]
    table = get_centroider("gaussian").measure(stamps_of(flux * gaussian_stars(X, Y, 0.8), X, Y), NOISE)
    return replace(table, flags=np.array([0, 0, int(StarFlag.BLEND)], np.uint32))


IDENTIFIED = SimpleNamespace(detected=np.array([0]), catalogue_id=np.array([77]), residual_px=np.array([[0.1, -0.2]]))


def test_marked_stars_are_drawn_by_group_at_their_positions(stars):
    image = image_of(np.where(np.eye(12) > 0, np.nan, 100.0))
    axes = mark_stars(show_image(image), stars, IDENTIFIED)
    labels = [group.get_label() for group in axes.collections]
    assert labels == ["1 identified", "1 star", "1 flagged"]
    drawn = np.vstack([group.get_offsets() for group in axes.collections])
    np.testing.assert_allclose(drawn, np.column_stack([X, Y]), atol=1e-2)


def test_layers_of_a_page_name_stars_flags_and_residuals(stars):
    layers = {layer.name: layer for layer in star_marks(stars, IDENTIFIED)}
    assert list(layers) == ["identified", "measured stars", "flagged", "residuals of the attitude"]
    assert layers["identified"].columns["catalogue"].tolist() == ["77"]
    assert layers["flagged"].columns["flags"] == ["BLEND"]
    arrow = layers["residuals of the attitude"]
    np.testing.assert_allclose([arrow.x_px + arrow.dx_px, arrow.y_px + arrow.dy_px], [X[:1], Y[:1]], atol=1e-2)
    assert [layer.name for layer in star_marks(stars)] == ["measured stars", "flagged"]
    np.testing.assert_array_equal(np.argsort(star_marks(stars)[0].columns["flux [e-]"]), [1, 0])  # brightest first


def test_arrows_are_the_enlarged_residuals(stars):
    attitude = type("Attitude", (SimpleNamespace,), {"__len__": lambda self: 1})(**vars(IDENTIFIED))
    axes = draw_residuals(attitude, stars, scale=10.0)
    (arrows,) = axes.collections
    np.testing.assert_allclose([arrows.U, arrows.V], [[1.0], [-2.0]])
    assert "1 stars, 0.158 px RMS" in axes.get_title()
