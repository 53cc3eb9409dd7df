"""Mean, scatter and common motion of the positions of stars in several frames."""

import numpy as np
import pytest

from calib.measure.statistics import frame_positions


def test_statistics_leave_out_frames_without_a_position():
    position = np.array([[[1.0, 2.0], [5.0, 5.0]], [[np.nan] * 2] * 2, [[3.0, 6.0], [np.nan] * 2]])
    mean, sigma, count = frame_positions.frame_statistics(position)
    np.testing.assert_allclose(mean, [[2.0, 4.0], [np.nan] * 2])
    np.testing.assert_allclose(sigma, [[np.sqrt(2.0), np.sqrt(8.0)], [np.nan] * 2])
    assert count.tolist() == [2, 1]
    np.testing.assert_allclose(frame_positions.position_covariance_px2(position[:, :1])[0], [[2.0, 4.0], [4.0, 8.0]])


def test_common_motion_of_points_that_move_and_its_limit_for_points_at_rest():
    rng = np.random.default_rng(4)
    common, own = rng.standard_normal((4000, 1, 2)) * [0.2, 0.1], 0.3 * rng.standard_normal((4000, 9, 2))
    motion, left = frame_positions.common_motion_px2(common + own)
    np.testing.assert_allclose(motion, [0.04, 0.01], rtol=0.1)
    np.testing.assert_allclose(left, 0.01, rtol=0.05)
    assert np.isnan(frame_positions.common_motion_px2(common)).all()
    # four frames of two points: 5 % of 4000 axes, within four standard deviations
    rng, limit = np.random.default_rng(6), frame_positions.common_motion_limit(4, 2, 0.05)
    motion = np.array([frame_positions.common_motion_px2(rng.standard_normal((4, 2, 2))) for _ in range(2000)])
    ratio = motion.sum(1) / motion[:, 1]
    assert np.mean(ratio > limit) == pytest.approx(0.05, abs=4.0 * np.sqrt(0.05 * 0.95 / 4000))
