"""Best focus: a minimum, and zero once the image plane stands there."""

import numpy as np
import pytest

from optics import load_lens, refocus, spot_moments, trace_spots
from optics.rays.best_focus import best_focus_shift_mm, focus_by_axis, white_focus

CAMERA = load_lens("star_camera_206mm")


def test_best_focus_is_a_minimum():
    fields, waves = ([0.0, 1.5, 3.0], [0.0, 0.0, 0.0]), [500.0, 600.0, 700.0, 800.0]
    shift = best_focus_shift_mm(CAMERA, *fields, waves)

    def white_variance(z):
        s = spot_moments(refocus(CAMERA, z), *fields, waves)
        across = s.rms_radius_mm**2 + (s.x_mm - s.x_mm.mean(1, keepdims=True)) ** 2
        return float(across.mean())

    here, near, far = white_variance(shift), white_variance(shift - 0.002), white_variance(shift + 0.002)
    assert here < near
    assert here < far
    assert near == pytest.approx(far, rel=1e-5)
    assert best_focus_shift_mm(refocus(CAMERA, shift), *fields, waves) == pytest.approx(0.0, abs=1e-12)


def test_both_axes_together_are_the_white_spot():
    """On the axis the two are alike; off axis a lens is astigmatic, and the best focus lies between the two."""
    spots = trace_spots(CAMERA, [0.0, 3.0], [0.0, 0.0], [600.0])
    _, (x, y) = focus_by_axis(spots, spots.area_mm2)
    assert x.best_mm[0] == pytest.approx(y.best_mm[0], abs=1e-9)
    both = white_focus(spots)
    np.testing.assert_allclose((x + y).rms_mm(0.1), both.rms_mm(0.1), rtol=1e-12)
    assert min(x.best_mm[1], y.best_mm[1]) < both.best_mm[1] < max(x.best_mm[1], y.best_mm[1])
