"""Images at field points against spots by another function, in and out of focus."""

import numpy as np
import pytest

from optics import best_focus_shift_mm, load_lens, refocus, spot_moments
from optics.rays.polychromatic_spots import polychromatic_spots

LENS, WAVES = load_lens("star_camera_206mm"), [500.0, 600.0, 800.0]


def test_position_size_and_focus():
    field = [0.0, 1.5, 3.0], [0.0, 0.5, 0.0]
    made = polychromatic_spots(LENS, *field, WAVES, np.ones(3), refocused=True, shift_mm=0.02, order=(12, 24))
    assert made.shift_mm == pytest.approx(best_focus_shift_mm(LENS, *field, WAVES) + 0.02, abs=1e-4)
    moments = spot_moments(refocus(LENS, made.shift_mm), *field, WAVES)
    light = moments.transmitted_mm2 / moments.transmitted_mm2.sum(1, keepdims=True)
    for axis, mean in enumerate((moments.x_mm, moments.y_mm)):
        np.testing.assert_allclose(made.position_mm[:, axis], (light * mean).sum(1), atol=1e-5)
    x, y = (m - (light * m).sum(1, keepdims=True) for m in (moments.x_mm, moments.y_mm))
    square = (light * (moments.rms_radius_mm**2 + x**2 + y**2)).sum(1)
    np.testing.assert_allclose(made.square_mm2, square, rtol=1e-3)
    assert np.abs((made.weight * made.x_mm).sum((1, 2))).max() < 1e-12
