"""Mean, scatter and common motion of the positions of stars in several frames."""

import numpy as np

from calib.measure.frame_positions import common_motion_px2, frame_statistics


def test_statistics_leave_out_frames_without_a_position():
    position = np.array([[[1.0, 2.0], [5.0, 5.0]], [[np.nan] * 2] * 2, [[3.0, 6.0], [np.nan] * 2]])
    mean, sigma, count = frame_statistics(position)
    np.testing.assert_allclose(mean, [[2.0, 4.0], [np.nan] * 2])
    np.testing.assert_allclose(sigma, [[np.sqrt(2.0), np.sqrt(8.0)], [np.nan] * 2])
    assert count.tolist() == [2, 1]


def test_common_motion_of_points():
    rng = np.random.default_rng(4)
    common, own = rng.standard_normal((4000, 1, 2)) * [0.2, 0.1], 0.3 * rng.standard_normal((4000, 9, 2))
    motion, left = common_motion_px2(common + own)
    np.testing.assert_allclose(motion, [0.04, 0.01], rtol=0.1)
    np.testing.assert_allclose(left, 0.01, rtol=0.05)
    assert np.isnan(common_motion_px2(common)).all()
