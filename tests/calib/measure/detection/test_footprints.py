"""Footprints of stars: extent, bits of their pixels, overlaps."""

import numpy as np

from calib.measure.detection.footprints import footprint_bits, footprint_px, overlapping


def test_footprints_hold_their_pixels_and_meet():
    half = footprint_px(np.array([0.25, np.nan]), np.array([1.0, 0.0]), 0.5)
    sigma = np.sqrt(np.array([[0.25, 0.0], [1.0, 0.0]]) + 0.25 + 1.0 / 12.0)
    np.testing.assert_allclose(half, 3.0 * sigma + 0.5)
    bits = np.zeros((12, 20), np.uint8)
    bits[4, 7], bits[4, 8] = 1, 8
    centre, box = np.array([[5.0, 30.0], [5.0, 5.0]]), np.full((2, 2), 2.0)
    assert footprint_bits(centre, box, bits).tolist() == [1, 0]
    centre = np.array([[5.0, 8.0, 15.0], [5.0, 5.0, 5.0]])
    assert overlapping(centre, np.full((2, 3), 2.0), np.array([1e4, 50.0, 1e4]), 0.01).tolist() == [1]
    assert overlapping(centre, np.full((2, 3), 2.0), np.array([1e4, 500.0, 1e4]), 0.01).tolist() == [0, 1]
