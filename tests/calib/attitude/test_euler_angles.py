"""The document's angles, and the small rotations that the estimators work with."""

import numpy as np
import pytest
from calibration_scene import document_matrix
from scipy.spatial.transform import Rotation

from calib.attitude.euler_angles import angle_per_increment, angles_of_rotation, increment_per_angle, rotation_of_angles

ANGLES = [(0.0, 0.0, 0.0), (56.9476, -1.0046, -25.3335), (2.0, 2.0, 2.0), (-89.0, 170.0, -120.0)]


@pytest.mark.parametrize("angles_deg", ANGLES)
def test_matrices_as_printed(angles_deg):
    np.testing.assert_allclose(
        rotation_of_angles(np.deg2rad(angles_deg)).as_matrix(), document_matrix(angles_deg), atol=1e-15
    )


def test_positive_angles_turn_the_frame():
    """Turning the frame by +10 deg about z moves the x axis, seen from the frame, to -10 deg."""
    seen = rotation_of_angles([0.0, 0.0, np.deg2rad(10.0)]).apply([1.0, 0.0, 0.0])
    assert np.degrees(np.arctan2(seen[1], seen[0])) == pytest.approx(-10.0)


@pytest.mark.parametrize("angles_deg", ANGLES)
def test_angles_come_back(angles_deg):
    found = angles_of_rotation(rotation_of_angles(np.deg2rad(angles_deg)))
    np.testing.assert_allclose(np.rad2deg(found), angles_deg, atol=1e-12)


@pytest.mark.parametrize("first_deg", [90.0, -90.0])
def test_gimbal_lock_keeps_the_rotation(first_deg):
    rotation = rotation_of_angles(np.deg2rad([first_deg, 20.0, 30.0]))
    again = rotation_of_angles(angles_of_rotation(rotation))
    assert (again * rotation.inv()).magnitude() < 1e-7


@pytest.mark.parametrize("angles_deg", ANGLES)
def test_increments_of_the_angles(angles_deg):
    angle, h = np.deg2rad(angles_deg), 1e-6
    columns = [
        (rotation_of_angles(angle + h * e) * rotation_of_angles(angle - h * e).inv()).as_rotvec() / (2 * h)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(increment_per_angle(angle), np.column_stack(columns), atol=1e-9)


def test_angles_that_only_their_sum_defines_have_no_finite_rate():
    """At a1 = 90 deg the rotation vector moves a1 alone; beside it, the inverse of numerical derivatives."""
    locked = angle_per_increment(np.deg2rad([90.0, 20.0, 0.0]))
    assert np.isfinite(locked[0]).all()
    assert np.isinf(locked[1:]).all()
    angle, turn = np.deg2rad([60.0, 20.0, -40.0]), np.array([2e-7, -1e-7, 3e-7])
    moved = angles_of_rotation(Rotation.from_rotvec(turn) * rotation_of_angles(angle))
    np.testing.assert_allclose(angle_per_increment(angle) @ turn, moved - angle, atol=1e-12)
