"""Star vectors in the table's initial frame: a star that stands still gives one vector, whatever the table does."""

import numpy as np
import pytest
from calibration_scene import CAMERA, GEOMETRY
from scipy.spatial.transform import Rotation

from calib.attitude.star_vectors import initial_frame_vectors, sampled_method_ratios
from calib.cameras import BrownConrady, SensorGeometry
from calib.directional.pixel_method import pixel_noise_ratio, spherical_noise_ratio

STAR = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
INSTALLATION = Rotation.from_rotvec([0.02, -0.03, 0.4])
TURNS = Rotation.from_rotvec(np.random.default_rng(2).uniform(-0.1, 0.1, (20, 3)))


def test_a_standing_star_gives_one_vector_and_what_cannot_be_inverted_nan():
    pixel = CAMERA.project((INSTALLATION * TURNS.inv()).apply(STAR))
    vectors = initial_frame_vectors(CAMERA, pixel, installation=INSTALLATION, table_rotation=TURNS)
    np.testing.assert_allclose(vectors, np.tile(STAR, (20, 1)), atol=1e-12)
    folded = BrownConrady.create(GEOMETRY, focal_length_mm=25.6, q1_per_mm2=-0.05)
    pixel = np.array([[511.5, 511.5], [5000.0, 511.5]])
    vectors = initial_frame_vectors(folded, pixel, installation=INSTALLATION, table_rotation=TURNS[:2])
    assert np.isfinite(vectors[0]).all()
    assert np.isnan(vectors[1]).all()


def test_a_pixel_of_error_is_an_angle_of_error():
    """One pixel of 10 um behind 25.6 mm is 391 microradian on the axis, in a direction square to the star."""
    pixel = CAMERA.project(np.array([[0.0, 0.0, 1.0]]))
    both = np.vstack([pixel, np.add(pixel, [1.0, 0.0])])
    one = Rotation.identity()
    exact, off = initial_frame_vectors(CAMERA, both, installation=one, table_rotation=one)
    assert np.arccos(exact @ off) == pytest.approx(0.01 / 25.6, rel=0.02)


def test_drawn_vectors_have_the_bias_of_the_pixel_method():
    """N = 10 runs of 3000: ratios of methods on the same vectors, so 0.02 % and better."""
    camera = BrownConrady.of_field(SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055), 20.0)
    runs = [sampled_method_ratios(camera, 3000, 5e-6, np.random.default_rng(seed)) for seed in range(10)]
    mean, error = np.mean(runs, axis=0), np.std(runs, axis=0, ddof=1) / np.sqrt(10)
    expected = [spherical_noise_ratio(20.0), 1.0, pixel_noise_ratio(20.0)]
    assert np.all(np.abs(mean - expected) < 5 * error)
    assert max(error[0], error[2]) < 2e-4
