"""Exponential map and right Jacobian of SO(3) against SciPy and central differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.fitting.rotation_vectors import exponential, right_jacobian, skew


@pytest.mark.parametrize("size", [0.0, 1e-9, 5e-3, 0.1, 3.0])
def test_exponential_and_its_derivative(size):
    vector = size * np.array([[0.6, -0.48, 0.64], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(exponential(vector), Rotation.from_rotvec(vector).as_matrix(), atol=2e-15)
    for v, j in zip(vector, right_jacobian(vector), strict=True):
        for axis, e in enumerate(np.eye(3)):
            h = 1e-6
            ahead = (Rotation.from_rotvec(v).inv() * Rotation.from_rotvec(v + h * e)).as_rotvec()
            behind = (Rotation.from_rotvec(v).inv() * Rotation.from_rotvec(v - h * e)).as_rotvec()
            np.testing.assert_allclose(j[:, axis], (ahead - behind) / (2 * h), atol=1e-9)


def test_skew_is_the_cross_product():
    a, b = np.random.default_rng(0).standard_normal((2, 7, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", skew(a), b), np.cross(a, b), atol=1e-15)
