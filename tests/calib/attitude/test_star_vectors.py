"""Star vectors in the table's initial frame: a star that stands still gives one vector, whatever the table does."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.star_vectors import initial_frame_vectors
from calib.cameras import BrownConrady, SensorGeometry
from optics.errors import DomainError

SENSOR = SensorGeometry(width_px=1024, height_px=1024, pixel_pitch_mm=0.01)
MODEL = BrownConrady.create(SENSOR, focal_length_mm=25.6, x0_px=10.0, y0_px=-10.0, q1_per_mm2=2e-4, p1_per_mm=2e-4)
STAR = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
INSTALLATION = Rotation.from_rotvec([0.02, -0.03, 0.4])


def _turns(count: int) -> Rotation:
    return Rotation.from_rotvec(np.random.default_rng(2).uniform(-0.1, 0.1, (count, 3)))


def test_a_standing_star_gives_one_vector() -> None:
    turns = _turns(20)
    pixel = MODEL.project((INSTALLATION * turns.inv()).apply(STAR))
    vectors = initial_frame_vectors(MODEL, pixel, installation=INSTALLATION, table_rotation=turns)
    np.testing.assert_allclose(vectors, np.tile(STAR, (20, 1)), atol=1e-12)


def test_a_pixel_of_error_is_an_angle_of_error() -> None:
    """One pixel of 10 um behind 25.6 mm is 391 microradian on the axis, in a direction square to the star."""
    pixel = MODEL.project(np.array([[0.0, 0.0, 1.0]]))
    both = np.vstack([pixel, np.add(pixel, [1.0, 0.0])])
    one = Rotation.identity()
    exact, off = initial_frame_vectors(MODEL, both, installation=one, table_rotation=one)
    assert np.arccos(exact @ off) == pytest.approx(0.01 / 25.6, rel=0.02)


def test_what_cannot_be_inverted_is_nan() -> None:
    folded = BrownConrady.create(SENSOR, focal_length_mm=25.6, q1_per_mm2=-0.05)
    pixel = np.array([[511.5, 511.5], [5000.0, 511.5]])
    vectors = initial_frame_vectors(folded, pixel, installation=INSTALLATION, table_rotation=_turns(2))
    assert np.isfinite(vectors[0]).all()
    assert np.isnan(vectors[1]).all()


@pytest.mark.parametrize(
    ("pixel", "installation", "turns", "words"),
    [
        (np.zeros((3, 3)), INSTALLATION, _turns(3), "shape"),
        (np.zeros((3, 2)), INSTALLATION, _turns(2), "2 table attitudes for 3 images"),
        (np.zeros((3, 2)), _turns(3), _turns(3), "single rotation"),
    ],
)
def test_shapes_that_do_not_fit(pixel: np.ndarray, installation: Rotation, turns: Rotation, words: str) -> None:
    with pytest.raises(DomainError, match=words):
        initial_frame_vectors(MODEL, pixel, installation=installation, table_rotation=turns)
