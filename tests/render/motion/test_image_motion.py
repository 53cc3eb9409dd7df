"""Displacements of stars by rates and jitter: numbers that are computed by hand."""

import numpy as np
import pytest

from render.motion.image_motion import image_motion


def test_displacements_add_up():
    """1e-3 rad/s at 1e-4 rad per pixel: 10 px/s; 0.2 s of exposure in a frame of 0.5 s."""
    common = {"exposure_s": 0.2, "duration_s": 0.5, "pixel_rad": 1e-4, "size_px": (80, 60)}
    moved = image_motion(across_rad_per_s=1e-3, about_rad_per_s=0.04, jitter_rad=np.array([3e-4, 4e-4, 0.01]), **common)
    assert (moved.trail_px, moved.drift_px) == pytest.approx((2.0, 2.5))
    assert moved.jitter_px == pytest.approx(5.0)
    assert moved.roll_px == pytest.approx((0.25 * 0.04 + 0.01) * 50.0)
    assert moved.reach_px == pytest.approx(2.5 + 5.0 + 1.0)
    spun = image_motion(across_rad_per_s=0.0, about_rad_per_s=100.0, jitter_rad=np.zeros(3), **common)
    assert spun.reach_px == pytest.approx(50.0 - 30.0)  # no star comes in from farther than the corners
