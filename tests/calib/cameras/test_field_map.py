"""Maps of shifts over the field: polynomials come back, and the similar part of a motion with what is left."""

import numpy as np

from calib.cameras.field_map import (
    _smooth,
    fit_field_map,
    fit_similarity,
    growth_along_axes,
    polynomial_basis,
    smooth_map_rms,
)


def test_a_polynomial_of_the_degree_comes_back_anywhere_in_the_field():
    rng = np.random.default_rng(1)
    plane = rng.uniform(-0.2, 0.2, (200, 2))
    direction = np.column_stack([plane, np.ones(200)]) / np.sqrt(1.0 + (plane**2).sum(1))[:, None]
    x, y = 5.0 * plane.T
    shift = np.column_stack([1.0 + x**3 * y**2, x - 2.0 * y**5])
    field_map = fit_field_map(direction[:100], shift[:100])
    np.testing.assert_allclose(field_map.at(direction[100:]), shift[100:], atol=1e-9)
    rough = fit_field_map(direction, shift, degree=2)
    assert np.abs(rough.at(direction) - shift).max() > 0.1


def test_shift_roll_and_growth_are_told_apart_from_the_rest():
    position = np.random.default_rng(2).uniform(-500.0, 500.0, (60, 2))
    x, y = position.T
    similar = np.column_stack([0.3 - 1e-4 * y + 2e-5 * x, -0.2 + 1e-4 * x + 2e-5 * y])
    motion, residual = fit_similarity(position, similar)
    np.testing.assert_allclose(motion, [0.3, -0.2, 1e-4, 2e-5], rtol=1e-9)
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)
    cubic = 1e-9 * position * (position**2).sum(1)[:, None]
    _, left = fit_similarity(position, similar + cubic)
    np.testing.assert_allclose(left, fit_similarity(position, cubic)[1], atol=1e-12)
    assert 0.0 < np.abs(left).max() < np.abs(cubic).max()


def test_what_a_fit_leaves_counts_its_parameters():
    """Noise of 0.03 px at 48 points about a cubic of ten terms: RMS 0.03 in the mean over 300 draws."""
    rng, place = np.random.default_rng(2), np.random.default_rng(1).uniform(0.0, 4000.0, (48, 2))
    smooth = polynomial_basis(place / 2000.0 - 1.0, 3) @ rng.standard_normal((10, 2))
    smooth *= [0.05, 0.08] / smooth.std(0)
    noise = np.array([0.03, 0.05])
    drawn = smooth + noise * rng.standard_normal((300, 48, 2))
    squares = np.mean([_smooth(place, one, 3)[1] ** 2 for one in drawn], axis=0)
    np.testing.assert_allclose(np.sqrt(squares), noise, rtol=4.0 / np.sqrt(2 * 38 * 300))
    # the smooth map itself, of this RMS about its mean, without what the noise of its terms adds
    found, stated = np.transpose([smooth_map_rms(place, one) for one in drawn], (1, 0, 2))
    np.testing.assert_allclose(found.mean(0), [0.05, 0.08], atol=4.0 * 0.05 / np.sqrt(48 * 300))
    np.testing.assert_allclose(found.std(0), stated.mean(0), rtol=4.0 / np.sqrt(600))


def test_growth_and_its_standard_deviation():
    """x grows by 3e-5 along x, y by 4e-5 along y; pulls of 500 draws are normal."""
    rng, place = np.random.default_rng(3), np.random.default_rng(1).uniform(0.0, 4000.0, (48, 2))
    true = np.array([3e-5, 4e-5])
    shifts = true * place + [5.0, -2.0] + 0.05 * rng.standard_normal((500, 48, 2))
    found, sigma = np.transpose([growth_along_axes(place, shift) for shift in shifts], (1, 0, 2))
    pull = (found - true) / sigma
    assert np.abs(pull.mean(0)).max() < 4.0 / np.sqrt(500)
    # Student's t of 45 degrees of freedom: variance 45 / 43
    np.testing.assert_allclose(pull.std(0), np.sqrt(45 / 43), rtol=4.0 / np.sqrt(1000))
