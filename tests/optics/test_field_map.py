"""Shifts over the field: polynomials come back, and a similarity is separated from the rest."""

import numpy as np

from optics.field_map import fit_field_map, fit_similarity


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


def test_shift_roll_and_growth_are_separated_from_the_rest():
    position = np.random.default_rng(2).uniform(-500.0, 500.0, (60, 2))
    x, y = position.T
    similar = np.column_stack([0.3 - 1e-4 * y + 2e-5 * x, -0.2 + 1e-4 * x + 2e-5 * y])
    motion, residual = fit_similarity(position, similar)
    np.testing.assert_allclose(motion, [0.3, -0.2, 1e-4, 2e-5], rtol=1e-9)
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)
    cubic = 1e-9 * position * (position**2).sum(1)[:, None]
    _, rest = fit_similarity(position, similar + cubic)
    np.testing.assert_allclose(rest, fit_similarity(position, cubic)[1], atol=1e-12)
    assert 0.0 < np.abs(rest).max() < np.abs(cubic).max()
