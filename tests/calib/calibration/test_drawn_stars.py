"""A random sky in frames: as many stars as asked, where the camera has them, uniform."""

import numpy as np
import pytest
from calibration_scene import CAMERA
from scipy.spatial.transform import Rotation

from calib.calibration.drawn_stars import draw_stars

ATTITUDE = Rotation.from_rotvec(np.linspace(0.0, 0.5, 60)[:, None] * [0.6, 0.0, 0.8])


def test_number_of_stars():
    stars = draw_stars(CAMERA, ATTITUDE, np.random.default_rng([2, 0]), mean=34.0)
    assert len(stars) / 60 == pytest.approx(34.0, abs=1.0)  # the next fainter star may be in all frames
    exact = draw_stars(CAMERA, ATTITUDE, np.random.default_rng([2, 0]), exactly=7)
    assert np.bincount(exact.frame).tolist() == [7] * 60


def test_stars_are_where_the_camera_sees_them():
    stars = draw_stars(CAMERA, ATTITUDE, np.random.default_rng([2, 3]), mean=20.0)
    assert np.linalg.norm(stars.direction, axis=1) == pytest.approx(1.0, abs=1e-12)
    assert stars.pixel_px.min() >= -0.5
    assert stars.pixel_px.max() <= 1023.5
    direction = CAMERA.unproject(stars.pixel_px)
    turned = ATTITUDE[stars.frame].apply(stars.direction.copy())
    assert direction == pytest.approx(turned, abs=1e-12)
    order = np.argsort(stars.star, kind="stable")
    same = np.diff(stars.star[order]) == 0
    assert np.all(np.diff(stars.direction[order], axis=0)[same] == 0)  # a star is one star in all frames


def test_sky_is_uniform():
    """30 skies in the first frame, 8 equal bins along each axis: chi^2 of 7, at 1e-3."""
    pixel = np.concatenate(
        [
            (s := draw_stars(CAMERA, ATTITUDE, np.random.default_rng([5, k]), mean=40.0)).pixel_px[s.frame == 0]
            for k in range(30)
        ]
    )
    for axis in range(2):
        count = np.histogram(pixel[:, axis], bins=8, range=(-0.5, 1023.5))[0]
        expected = len(pixel) / 8
        # the outer bins see 10 % less sky per pixel, and distortion moves some stars out
        assert ((count - expected) ** 2 / expected).sum() < 24.3 + len(pixel) * 0.05**2
