"""Brown-Conrady against OpenCV's projectPoints."""

import numpy as np
import pytest
from calibration_scene import CAMERA, GEOMETRY

from calib.cameras import BrownConrady

UNEQUAL = CAMERA.with_parameters([*CAMERA.parameters[:7], -5e-4])  # p1 and p2 differ


@pytest.mark.reference
@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_projection_and_derivatives_agree_with_opencv(scale):
    cv2 = pytest.importorskip("cv2")
    camera = UNEQUAL.with_parameters(UNEQUAL.parameters * np.repeat([1.0, scale], [3, 5]))
    ideal = BrownConrady.create(GEOMETRY, focal_length_mm=25.6)
    direction = ideal.unproject(GEOMETRY.grid_px(12))
    matrix, coefficients = camera.to_opencv()
    points, jacobian = cv2.projectPoints(direction, np.zeros(3), np.zeros(3), matrix, coefficients)
    projection = camera.project_jacobian(direction)
    np.testing.assert_allclose(projection.pixel_px, points[:, 0], rtol=0, atol=1e-10)
    # OpenCV's columns: rotation 0-2 (about the camera's axes), translation 3-5, fx, fy, cx, cy, k1, k2, p1, p2, k3
    theirs = jacobian.reshape(len(direction), 2, -1)
    np.testing.assert_allclose(projection.by_direction, theirs[:, :, 3:6], rtol=0, atol=1e-8)
    f = camera.value("focal_length_mm")
    pairs = {"q1_per_mm2": (10, 2), "q2_per_mm4": (11, 4), "p2_per_mm": (12, 1), "p1_per_mm": (13, 1)}
    pairs["q3_per_mm6"] = (14, 6)
    for name, (column, power) in pairs.items():
        ours = projection.by_parameter[:, :, camera.parameter_names.index(name)]
        np.testing.assert_allclose(ours, f**power * theirs[:, :, column], rtol=1e-9, atol=1e-9 * np.abs(ours).max())


def test_opencv_coefficients_there_and_back():
    camera = UNEQUAL
    matrix, coefficients = camera.to_opencv()
    again = BrownConrady.from_opencv(GEOMETRY, matrix, coefficients)
    np.testing.assert_allclose(again.parameters, camera.parameters, rtol=1e-12, atol=1e-12)
    four = BrownConrady.from_opencv(GEOMETRY, matrix, coefficients[:4])
    assert four.value("q3_per_mm6") == 0.0
