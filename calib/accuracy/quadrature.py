"""Root sums of squares of independent terms, and how well they are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray


def root_sum_square(terms: Sequence[ArrayLike], *, axes: int = 1) -> FloatArray:
    """Root sum of squares of terms per axis (``axes``,); zero without terms."""
    return np.sqrt(sum((np.asarray(term, float) ** 2 for term in terms), np.zeros(axes)))


def ratio_of_lengths(
    first: FloatArray, first_sigma: FloatArray, second: FloatArray, second_sigma: FloatArray
) -> tuple[float, float]:
    """Ratio of the lengths of two vectors with independent errors, and its standard deviation to first order."""
    ratio = np.linalg.norm(first) / np.linalg.norm(second)
    relative = [
        np.linalg.norm(value * sigma) / np.sum(value**2)
        for value, sigma in ((first, first_sigma), (second, second_sigma))
    ]
    return float(ratio), float(ratio * np.linalg.norm(relative))


def rms_uncertainty(rms: FloatArray, stratified: Sequence[FloatArray], total: FloatArray, *, draws: int) -> FloatArray:
    """Standard deviation (n,) of a measured RMS of independent draws whose inputs are stratified in part."""
    return np.asarray(rms * np.sqrt(stratified_variance_ratio(stratified, total, draws=draws) / (2 * draws)))


def stratified_variance_ratio(stratified: Sequence[FloatArray], total: FloatArray, *, draws: int) -> FloatArray:
    """Variance of a measured mean square over that of independent draws, where some terms are stratified.

    The mean square of a sum of terms holds the mean squares of the terms and their products. Stratified inputs
    (`render.engine.random.stratified`) bring the mean square of their own term to its expectation, so its part ``term^4
    / total^4`` of the variance is missing; the error of this is at most of the order of one draw.

    Shapes: standard deviations (n,) of each stratified term and of the sum of all terms.
    """
    missing = sum(((term / total) ** 4 for term in stratified), np.zeros_like(total))
    return np.maximum(1.0 - missing, 1.0 / draws)
