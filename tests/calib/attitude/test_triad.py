"""TRIAD: frame by hand, covariance against scatter, what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.triad import angle_between_rad, triad

TURN = Rotation.from_rotvec([0.3, -1.2, 0.7])


def test_frame_of_directions_out_of_square_and_small_angles():
    """Z is the first direction; the second lies in the X-Z plane on the side of +X; Y completes (ECSS)."""
    second = np.array([np.cos(2e-3), 0.0, np.sin(2e-3)])
    found = triad([[0, 0, 1], [1, 0, 0]], TURN.inv().apply([[0.0, 0.0, 1.0], second]))
    assert found.rotation.as_matrix() == pytest.approx(TURN.as_matrix(), abs=1e-13)
    assert found.angle_error_rad == pytest.approx(-2e-3)
    assert not found.covariance_rad2.any()
    assert angle_between_rad([0, 0, 1], [1e-9, 0, 1]) == pytest.approx(1e-9, rel=1e-12)


@pytest.mark.parametrize("angle_deg", [90.0, 20.0])
def test_covariance_is_the_scatter(angle_deg):
    """1000 noisy pairs of unequal noise: elements agree to 4.5 sqrt(2 / 1000) of the variances."""
    rng, angle = np.random.default_rng(3), np.radians(angle_deg)
    known = np.array([[0.0, 0.0, 1.0], [np.sin(angle), 0.0, np.cos(angle)]])
    true, sigma = TURN.inv().apply(known), np.array([1e-5, 2e-5])
    spread = sigma[:, None, None] ** 2 * (np.eye(3) - true[:, :, None] * true[:, None, :])
    noisy = true + sigma[:, None] * rng.standard_normal((1000, 2, 3))
    errors = np.array([(triad(known, pair).rotation * TURN.inv()).as_rotvec() for pair in noisy])
    expected = triad(known, true, covariance_rad2=spread).covariance_rad2
    size = np.sqrt(np.diag(expected))
    away = (errors.T @ errors / 1000 - expected) / np.outer(size, size)
    assert np.abs(away).max() < 4.5 * np.sqrt(2.0 / 1000)
