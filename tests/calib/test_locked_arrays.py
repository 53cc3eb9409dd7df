"""Records lock their arrays, which the rotations of SciPy refuse: every function of `calib` takes them all the same."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.association import associate, match_stars
from calib.attitude.gyro_attitude import integrate_rates
from calib.attitude.solve import solve_wahba
from calib.attitude.star_attitude import balanced_attitude
from calib.attitude.star_vectors import initial_frame_vectors
from calib.cameras import BrownConrady, SensorGeometry
from calib.cameras.fit import fit_to_map
from calib.cameras.line_of_sight import line_of_sight_map
from optics.records import locked

MODEL = BrownConrady.create(SensorGeometry(width_px=101, height_px=101, pixel_pitch_mm=0.01), focal_length_mm=5.0)
PIXEL = locked([[10, 10], [90, 12], [11, 90], [90, 90], [50, 20]])
DIRECTION = locked(MODEL.unproject(PIXEL))
HERE = Rotation.identity()


@pytest.mark.parametrize(
    "call",
    [
        lambda: solve_wahba(DIRECTION, DIRECTION, sigma_rad=locked(np.full(5, 1e-5))),
        lambda: balanced_attitude(DIRECTION, DIRECTION, locked(np.full(5, 1e-4)), 2e-3),
        lambda: match_stars(PIXEL, DIRECTION, HERE, MODEL, radius_px=5.0),
        lambda: associate(PIXEL, DIRECTION, HERE, MODEL, radius_px=5.0),
        lambda: line_of_sight_map(MODEL, DIRECTION, PIXEL, covariance=locked(1e-9 * np.eye(8))),
        lambda: fit_to_map(MODEL, DIRECTION, PIXEL, free=("focal_length_mm",)),
        lambda: initial_frame_vectors(MODEL, PIXEL, installation=HERE, table_rotation=HERE),
        lambda: integrate_rates(locked(np.arange(6.0)), locked(np.full((5, 3), 0.01)), locked([1.0, 2.0])),
    ],
    ids=["wahba", "balanced", "match", "associate", "line_of_sight", "fit_to_map", "star_vectors", "gyro"],
)
def test_locked_arrays_are_taken(call):
    call()


def test_what_comes_back_from_a_camera_goes_into_a_rotation():
    assert np.isfinite(HERE.apply(MODEL.unproject(PIXEL))).all()
