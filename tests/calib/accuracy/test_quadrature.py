"""Sums of independent terms: by hand, and against drawn numbers."""

import numpy as np
import pytest

from calib.accuracy.quadrature import ratio_of_lengths, rms_uncertainty, root_sum_square, stratified_variance_ratio
from render.engine.random import stratified_normal


def test_root_sum_square():
    assert root_sum_square([[3.0, 1.0], [4.0, 0.0]]) == pytest.approx([5.0, 1.0])
    assert root_sum_square([], axes=3) == pytest.approx([0.0] * 3)


def test_ratio_of_two_lengths_by_drawn_numbers():
    """20 000 draws of both sides on two axes: the ratio of their lengths scatters as stated."""
    rng = np.random.default_rng(5)
    a, b = np.array([1.0, 2.0]), np.array([1.2, 1.9])
    sigma_a, sigma_b = np.array([0.02, 0.05]), np.array([0.03, 0.04])
    value, sigma = ratio_of_lengths(a, sigma_a, b, sigma_b)
    drawn = [np.linalg.norm(v + s * rng.standard_normal((20_000, 2)), axis=1) for v, s in ((a, sigma_a), (b, sigma_b))]
    assert value == pytest.approx(np.sqrt(5.0) / np.hypot(1.2, 1.9))
    assert sigma == pytest.approx((drawn[0] / drawn[1]).std(), rel=0.03)


def test_rms_of_stratified_draws():
    """RMS of a stratified term of 2 and a free one of 1, of 20 draws; 400 repeats tell their scatter to 3.5 %."""
    rng, found = np.random.default_rng(6), []
    for _ in range(400):
        even = 2.0 * stratified_normal(rng, 20, 1)[:, 0]
        found.append(np.sqrt(np.mean((even + rng.standard_normal(20)) ** 2)))
    total = np.full(1, np.sqrt(5.0))
    assert np.std(found) == pytest.approx(rms_uncertainty(total, [np.full(1, 2.0)], total, draws=20)[0], rel=0.15)
    assert stratified_variance_ratio([np.ones(3)], np.ones(3), draws=50) == pytest.approx(np.full(3, 0.02))
