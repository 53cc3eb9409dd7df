"""Figures are files to look at; here only what can be checked: they draw what they were given."""

import numpy as np
from lens_texts import STOP, table_lens

from optics import draw_distortion, draw_lens, draw_spots, load_lens, spot_moments


def test_a_mirror_that_is_a_piece_beside_the_axis_is_drawn_as_that_piece():
    """The piece is a rectangle from y = 30 to 50 mm of a parabola; nothing of it stands on the axis."""
    piece = {"kind": "rectangle", "half_width_mm": [10.0, 10.0], "centre_mm": [0.0, 40.0]}
    mirror = {"radius_mm": -200.0, "conic": -1.0, "thickness_mm": -100.0, "medium": "mirror", "aperture": [piece]}
    lens = table_lens({**STOP, "semi_diameter_mm": 60.0, "thickness_mm": 150.0}, mirror, max_field_deg=0.1)
    (drawn,) = [line for line in draw_lens(lens).axes[0].lines if len(line.get_ydata()) > 10]
    height = np.asarray(drawn.get_ydata())
    height = height[np.isfinite(height)]
    assert 30.0 <= height.min() < 32.0
    assert 48.0 < height.max() <= 50.0


def test_spot_title_holds_the_white_rms_radius():
    lens = load_lens("star_camera_206mm")
    figure = draw_spots(lens, fields_deg=[(0.0, 0.0)], wavelength_nm=[600.0], pixel_um=5.5)
    title = figure.axes[0].get_title()
    expected = 1e3 * spot_moments(lens, 0.0, 0.0, 600.0).rms_radius_mm[0, 0]
    assert f"rms {expected:.2f} µm" in title


def test_distortion_grid_is_exaggerated_by_the_stated_factor():
    lens = load_lens("star_tracker_26mm")
    plain = draw_distortion(lens, count=5, exaggeration=1.0).axes[0].lines
    large = draw_distortion(lens, count=5, exaggeration=10.0).axes[0].lines
    ideal, real, exaggerated = (np.array(lines.get_xdata()) for lines in (plain[0], plain[10], large[10]))
    np.testing.assert_allclose(exaggerated - ideal, 10.0 * (real - ideal), atol=1e-12)
