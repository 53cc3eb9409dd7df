"""Covariance of what data determine, against the closed form of a straight line."""

import numpy as np

from calib.fitting.determined import covariance_of_jacobian, transformed_covariance


def test_a_straight_line_has_the_textbook_covariance():
    x = np.linspace(-1.0, 4.0, 30)
    found = covariance_of_jacobian(np.column_stack([np.ones(30), x]), ("offset", "slope"))
    spread = np.sum((x - x.mean()) ** 2)
    expected = np.array([[1 / 30 + x.mean() ** 2 / spread, -x.mean() / spread], [-x.mean() / spread, 1 / spread]])
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-12)
    assert not found.unknown
    assert not found.message


def test_what_is_not_determined_is_infinite_and_named_with_its_direction():
    """All points at x = 2: offset and slope can change together by (-2, 1); the third unknown is untouched."""
    rows = np.column_stack([np.ones(9), np.full(9, 2.0), np.tile([1.0, -1.0, 0.0], 3)])
    found = covariance_of_jacobian(rows, ("offset", "slope", "wave"))
    assert np.isinf(np.diagonal(found.covariance)).tolist() == [True, True, False]
    np.testing.assert_allclose(found.covariance[2, 2], 1 / 6, rtol=1e-12)
    assert np.isinf(found.condition)
    assert found.unknown == ["offset", "slope"]
    assert "+1 offset, -0.5 slope" in found.message or "-1 offset, +0.5 slope" in found.message


def test_what_has_no_effect_or_no_rate_has_no_finite_variance():
    found = covariance_of_jacobian(np.array([[1.0, 0.0, 0.0]]), ("a", "b", "c"))
    assert np.isinf(np.diagonal(found.covariance)).tolist() == [False, True, True]
    assert found.covariance[0, 0] == 1.0
    out = transformed_covariance(np.diag([4.0, 1.0]), np.array([[1.0, 0.0], [np.inf, np.inf]]))
    np.testing.assert_array_equal(out, [[4.0, 0.0], [0.0, np.inf]])
