"""Smooth part of measured shifts and growth along the axes against drawn noise."""

import numpy as np

from calib.cameras.field_map import _smooth, growth_along_axes, smooth_map_rms
from optics.field_map import polynomial_basis


def test_what_a_fit_leaves_counts_its_parameters():
    """Noise of 0.03 px at 48 points about a cubic of ten terms: RMS 0.03 in the mean over 300 draws."""
    rng, place = np.random.default_rng(2), np.random.default_rng(1).uniform(0.0, 4000.0, (48, 2))
    smooth = polynomial_basis(place / 2000.0 - 1.0, 3) @ rng.standard_normal((10, 2))
    smooth *= [0.05, 0.08] / smooth.std(0)
    noise = np.array([0.03, 0.05])
    drawn = smooth + noise * rng.standard_normal((300, 48, 2))
    squares = np.mean([_smooth(place, shift, 3)[1] ** 2 for shift in drawn], axis=0)
    np.testing.assert_allclose(np.sqrt(squares), noise, rtol=4.0 / np.sqrt(2 * 38 * 300))
    # the smooth map itself, of this RMS about its mean, without what the noise of its terms adds
    found, stated = np.transpose([smooth_map_rms(place, shift) for shift in drawn], (1, 0, 2))
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
