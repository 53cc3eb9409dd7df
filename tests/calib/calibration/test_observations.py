"""Observations: what is kept, what is refused."""

import numpy as np
import pytest
from star_directions import sky_directions

from calib.calibration.observations import Observations

N = 6


def made(**change):
    values = {
        "pixel_px": np.arange(2.0 * N).reshape(N, 2),
        "direction": sky_directions(N),
        "frame": [0, 0, 1, 1, 3, 3],
        "sigma_px": 0.1,
    }
    return Observations.isotropic(**(values | change))


def test_isotropic_fills_in_what_was_left_out_and_locks_copies():
    observations = made(sigma_px=np.linspace(0.1, 0.6, N))
    assert len(observations) == N
    assert observations.frames == 4
    assert observations.band.tolist() == [0] * N
    assert observations.star.tolist() == [-1] * N
    np.testing.assert_allclose(observations.covariance_px2[2], [[0.09, 0.0], [0.0, 0.09]], rtol=1e-14)
    pixel = np.zeros((N, 2))
    observations = made(pixel_px=pixel)
    pixel[0] = 7.0
    assert observations.pixel_px[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        observations.direction[0, 0] = 1.0


def test_select_keeps_the_numbers_of_the_frames():
    observations = made(band=[0, 1, 0, 1, 0, 1], star=np.arange(N))
    for rows in (observations.frame == 1, slice(2, 4), [2, 3]):
        part = observations.select(rows)
        assert part.frame.tolist() == [1, 1]
        assert part.frames == 4
        assert part.band.tolist() == [0, 1]
        assert part.star.tolist() == [2, 3]
        np.testing.assert_array_equal(part.direction, observations.direction[2:4])
    assert len(observations.select(np.zeros(N, bool))) == 0


def test_empty_lists_and_directions_of_single_precision():
    empty = made(pixel_px=np.empty((0, 2)), direction=np.empty((0, 3)), frame=[], frames=5)
    assert (len(empty), empty.frames, empty.covariance_px2.shape) == (0, 5, (0, 2, 2))
    assert made(pixel_px=np.empty((0, 2)), direction=np.empty((0, 3)), frame=[]).frames == 0
    exact = sky_directions(N)
    observations = made(direction=exact.astype(np.float32))
    np.testing.assert_allclose(np.linalg.norm(observations.direction, axis=1), 1.0, rtol=0, atol=3e-16)
    np.testing.assert_array_equal(made(direction=exact).direction, exact)
