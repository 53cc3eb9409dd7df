"""Two kinds of star images: alike, apart, and features of an image that is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from calib.measure.centroiding.gaussian import draw_gaussian
from calib.measure.statistics.separability import FEATURES, roc_area, separability, window_features


def drawn(shift, count=400, seed=1):
    rng = np.random.default_rng(seed)
    features, kind = rng.standard_normal((2 * count, 4)), np.repeat([0, 1], count)
    features[kind == 1, 2] += shift
    return features, kind, rng.integers(0, 8, 2 * count)


def test_area_of_two_normal_distributions_and_of_pairs_with_ties():
    """Shifted by d the best area is Phi(d / sqrt 2); of 400 + 400 its standard deviation is below 0.02."""
    result = separability(*drawn(1.0))
    assert result.area == pytest.approx(norm.cdf(1.0 / np.sqrt(2.0)), abs=0.06)
    assert 0.01 < result.error < 0.02
    assert result.first == 400
    np.testing.assert_allclose(result.effect, [0.0, 0.0, 1.0, 0.0], atol=4.0 * np.sqrt(2.0 / 400.0))
    result = separability(*drawn(0.0))
    assert abs(result.area - 0.5) < 0.08
    score, kind = np.array([1.0, 2.0, 2.0, 3.0]), np.array([0, 0, 1, 1])
    assert roc_area(score, kind) == pytest.approx((1.0 + 0.5 + 1.0 + 1.0) / 4.0)


def test_features_of_a_gaussian_star():
    x, y, sigma = np.array([20.0, 45.0, 2.0]), np.array([20.0, 12.0, 30.0]), 0.9
    image = 100.0 + sum(5000.0 * draw_gaussian(x[k : k + 1], y[k : k + 1], sigma, (64, 64))[0] for k in range(3))
    image += np.random.default_rng(5).normal(0.0, 2.0, image.shape)
    features = window_features(image, np.column_stack([x, y]))
    assert features.shape == (2, len(FEATURES))  # the third is too near to the edge
    values = dict(zip(FEATURES, features[0], strict=True))
    inside = norm.cdf(0.5 / sigma) * 2.0 - 1.0
    assert values["share of the brightest pixel"] == pytest.approx(inside**2, rel=0.03)
    assert values["moment along columns"] == pytest.approx(sigma**2 + 1.0 / 12.0, rel=0.05)
    assert np.exp(values["noise of the rim"]) == pytest.approx(2.0, rel=0.4)
    assert values["level of the rim"] == pytest.approx(100.0, abs=1.5)
