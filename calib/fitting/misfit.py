"""Chi-square of residuals against its expectation.

A covariance is valid only for the stated noise. The sum of squares of residuals over their stated sigma is chi-square
distributed, its mean the degrees of freedom, its variance twice that. A note is given if so large *or so small* a sum
has a probability below 0.001 and the noise is off by more than a fifth: with thousands of degrees of freedom no stated
noise is exact to the last digit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainc, gammaincc, stdtrit

SAME_SPREAD = 1.2  # a typical residual this close to the stated sigma, as a factor, is the stated sigma
NOTE_PROBABILITY = 1e-3  # two-sided, below which chance is no explanation
LARGEST_RATIO = 10.0  # typical residual over the stated sigma above which a fit is refused
LARGEST_WRONG_PART = 0.4  # part of the data that do not fit above which a robust fit is refused


@dataclass(frozen=True, slots=True, kw_only=True)
class ChiSquare:
    """A sum of squares of residuals in units of their stated sigma.

    Examples
    --------
    Ten times the stated noise, 40 degrees of freedom:

    >>> print(ChiSquare(value=4000.0, degrees_of_freedom=40))
    chi-square 4000, expected 40 +- 8.9, probability < 1e-300
    >>> ChiSquare(value=4000.0, degrees_of_freedom=40).note.split(":")[0]
    'residuals are 10 times what the stated sigma makes them'
    >>> ChiSquare(value=43.0, degrees_of_freedom=40).note
    ''
    """

    value: float  # The sum
    # Its expectation: measurements minus unknowns; 0 where no noise was stated, or nothing is left to test it
    degrees_of_freedom: int

    @property
    def tested(self) -> bool:
        """Whether there is anything to test."""
        return self.degrees_of_freedom > 0 and bool(np.isfinite(self.value))

    @property
    def ratio(self) -> float:
        """Size of the residuals over what the stated sigma makes them, sqrt(chi-square / degrees of freedom)."""
        return float(np.sqrt(self.value / self.degrees_of_freedom)) if self.tested else float("nan")

    @property
    def probability(self) -> float:
        """Probability of a sum so far from its expectation, in either direction; NaN where nothing is tested."""
        if not self.tested:
            return float("nan")
        half, x = 0.5 * self.degrees_of_freedom, 0.5 * self.value
        return float(min(1.0, 2.0 * min(gammainc(half, x), gammaincc(half, x))))

    @property
    def contradicts(self) -> bool:
        """Whether residuals and stated noise contradict each other, in either direction."""
        ratio = self.ratio
        return self.tested and not 1.0 / SAME_SPREAD <= ratio <= SAME_SPREAD and self.probability < NOTE_PROBABILITY

    @property
    def refuted(self) -> bool:
        """Whether the residuals are too large for the stated noise: a false minimum, a wrong model or wrong data."""
        return self.contradicts and self.ratio > 1.0

    @property
    def note(self) -> str:
        """One line where stated noise and residuals contradict each other, else nothing."""
        if not self.contradicts:
            return ""
        ratio = self.ratio
        cause = (
            "the noise is stated too small or the model is wrong, which the covariance does not include"
            if ratio > 1.0
            else "the noise is stated too large, and so is the covariance"
        )
        return f"residuals are {ratio:.3g} times what the stated sigma makes them: {cause} ({self})"

    def __str__(self) -> str:
        if not self.tested:
            return "chi-square not tested"
        freedom, chance = self.degrees_of_freedom, self.probability
        stated = "< 1e-300" if chance < 1e-300 else f"{chance:.2g}"
        spread = f"{np.sqrt(2.0 * freedom):.2g}"
        return f"chi-square {self.value:.4g}, expected {freedom} +- {spread}, probability {stated}"


def chi_square_minimum(value: ArrayLike, chi2: ArrayLike, degrees_of_freedom: int) -> tuple[float, float]:
    """Value of the least chi-square, by a parabola through three or more values, and its standard deviation.

    The variance is scaled such that chi-square per degree of freedom is 1 at the minimum; NaN if there is no minimum.
    """
    a, b, c = np.polyfit(np.asarray(value, float), np.asarray(chi2, float), 2)
    if a <= 0:
        return float("nan"), float("nan")
    least = c - b * b / (4.0 * a)
    return float(-b / (2.0 * a)), float(np.sqrt(max(least, 0.0) / degrees_of_freedom / a))


def two_sided_quantile(probability: float, degrees_of_freedom: float = np.inf) -> float:
    """Standard deviations beyond which a normal deviate lies with this probability, on either side.

    Of a standard deviation that was itself estimated, with the degrees of freedom of Student's t distribution.
    """
    return float(-stdtrit(degrees_of_freedom, probability / 2.0))


UNTESTED = ChiSquare(value=0.0, degrees_of_freedom=0)
"""Where no noise was stated."""


def joined(*notes: str) -> str:
    """Messages joined by semicolons, empty ones left out."""
    return "; ".join(note for note in notes if note)
