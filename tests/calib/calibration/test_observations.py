"""Observations: what is kept, what is refused."""

import numpy as np
import pytest

from calib.calibration.observations import Observations
from optics.errors import DomainError

N = 6


def unit_vectors(count=N):
    v = np.random.default_rng(3).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def made(**change):
    values = {
        "pixel_px": np.arange(2.0 * N).reshape(N, 2),
        "direction": unit_vectors(),
        "frame": [0, 0, 1, 1, 3, 3],
        "sigma_px": 0.1,
    }
    return Observations.isotropic(**(values | change))


def test_isotropic_fills_in_what_was_left_out():
    observations = made(sigma_px=np.linspace(0.1, 0.6, N))
    assert len(observations) == N
    assert observations.frames == 4
    assert observations.band.tolist() == [0] * N
    assert observations.star.tolist() == [-1] * N
    np.testing.assert_allclose(observations.covariance_px2[2], [[0.09, 0.0], [0.0, 0.09]], rtol=1e-14)


def test_arrays_are_copied_and_locked():
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
    with pytest.raises(DomainError, match="mask"):
        observations.select([True, False])


def test_an_empty_list_has_all_its_columns():
    empty = made(pixel_px=np.empty((0, 2)), direction=np.empty((0, 3)), frame=[], frames=5)
    assert (len(empty), empty.frames, empty.covariance_px2.shape) == (0, 5, (0, 2, 2))
    assert made(pixel_px=np.empty((0, 2)), direction=np.empty((0, 3)), frame=[]).frames == 0


def test_directions_from_single_precision_are_brought_to_length_one():
    exact = unit_vectors()
    observations = made(direction=exact.astype(np.float32))
    np.testing.assert_allclose(np.linalg.norm(observations.direction, axis=1), 1.0, rtol=0, atol=3e-16)
    np.testing.assert_array_equal(made(direction=exact).direction, exact)


def degrees_as_vectors():
    return np.column_stack([np.linspace(10, 350, N), np.linspace(-80, 80, N), np.zeros(N)])


def hours_as_vectors():
    return np.column_stack([np.linspace(0.1, 23, N), np.linspace(-1, 1, N), np.ones(N)])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"direction": degrees_as_vectors()}, "degrees or hours"),
        ({"direction": hours_as_vectors()}, "degrees or hours"),
        ({"direction": degrees_as_vectors()[:, :2]}, "right ascension, declination"),
        ({"direction": unit_vectors() * 1.001}, "row 0 has length 1.001"),
        ({"direction": np.zeros((N, 3))}, "unit vectors"),
        ({"direction": unit_vectors(5)}, "shape"),
        ({"direction": np.where(np.eye(N, 3), np.nan, unit_vectors())}, "finite"),
        ({"pixel_px": np.full((N, 2), np.nan)}, "finite"),
        ({"pixel_px": np.zeros((N, 3))}, "shape"),
        ({"pixel_px": np.zeros(N)}, "shape"),
        ({"frame": [0, 0, 1, 1, 3]}, "shape"),
        ({"frame": [0, 0, 1, 1, 3, 4], "frames": 4}, r"0 \.\. 3"),
        ({"frame": [-1, 0, 1, 1, 3, 3]}, "frame"),
        ({"frame": [0.5, 0, 1, 1, 3, 3]}, "whole numbers"),
        ({"frame": [np.nan, 0, 1, 1, 3, 3], "frames": 4}, "whole numbers"),
        ({"frames": -1}, "frames"),
        ({"frames": 4.0}, "frames"),
        ({"band": [-1, 0, 0, 0, 0, 0]}, "band"),
        ({"star": [-2, 0, 0, 0, 0, 0]}, "star"),
        ({"sigma_px": 0.0}, "positive"),
        ({"sigma_px": np.nan}, "positive"),
        ({"sigma_px": [0.1, 0.2]}, "sigma_px"),
    ],
)
def test_bad_input_is_refused_in_one_line(change, match):
    with pytest.raises(DomainError, match=match) as caught:
        made(**change)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "covariance",
    [[[0.01, 0.0], [0.0, 0.0]], [[0.01, 0.02], [0.02, 0.01]], [[0.01, 0.001], [0.0, 0.01]], [[-1.0, 0.0], [0.0, -1.0]]],
    ids=["singular", "correlation above 1", "not symmetric", "negative"],
)
def test_covariances_must_be_covariances(covariance):
    given = made()
    with pytest.raises(DomainError, match=r"row 0 .* positive definite"):
        Observations(
            pixel_px=given.pixel_px,
            covariance_px2=np.tile(covariance, (N, 1, 1)),
            direction=given.direction,
            frame=given.frame,
            frames=4,
        )
