"""Result of a fit: values, status, covariance, statistics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.fitting.misfit import ChiSquare, joined
from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name
from optics.records import freeze_all

STATUSES = ("converged", "stalled", "iteration_limit", "singular", "refused", "refuted")
LARGEST_RISE = 1.5
"""Chi-square at one standard deviation above which a covariance of first order does not hold; 1 is a linear problem."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Solution:
    """Outcome of a least-squares fit; a fit that failed says so here and raises nothing."""

    value: FloatArray  # (p,) Unknowns, in their own units
    names: tuple[str, ...]  # Their names, each ending in its unit
    # (p, p) Covariance from the noise the data state; infinite on the diagonal for what the data do not determine
    covariance: FloatArray
    # "converged"; "stalled" (no step lowers the cost, the gradient is not zero); "iteration_limit"; "singular"
    # (unknowns that the data do not determine); "refused" (nothing was fitted, the message says why); "refuted" (the
    # residuals at the minimum contradict the stated noise: a false minimum, a wrong model or wrong data)
    status: str
    message: str  # One line on the status
    iterations: int  # Steps tried
    chi2: float  # Sum of squared whitened residuals
    degrees_of_freedom: int  # Measurements minus unknowns
    condition: float  # Condition number of the scaled Jacobian
    residual_pulls: FloatArray  # (m,) Residuals over their standard deviations
    # (k,) Weight, 0 .. 1, that the loss left to each group of residuals (to each star); ones for the linear loss
    robust_weight: FloatArray
    # Degrees of freedom that test the stated noise where the terms of ``chi2`` are correlated, so that there are
    # fewer than ``degrees_of_freedom``; 0 where no noise was stated; None: all of them
    independent: int | None = None
    # Rise of chi-square at one standard deviation along the least determined direction, 1 for a linear problem; NaN:
    # not evaluated
    chi2_rise: float = float("nan")

    def __post_init__(self) -> None:
        if self.status not in STATUSES:
            raise unknown_name("status", self.status, STATUSES)
        sizes = {"p": len(self.names)}
        freeze_all(
            self,
            value=("p",),
            covariance=("p", "p"),
            residual_pulls=("m",),
            robust_weight=("k",),
            sizes=sizes,
            finite=False,
        )

    def __repr__(self) -> str:
        values = ", ".join(
            f"{n} = {v:.6g} +- {e:.2g}" for n, v, e in zip(self.names, self.value, self.sigma, strict=True)
        )
        return f"<Solution {joined(self.status, values, self.message, str(self.misfit), self.misfit.note)}>"

    @property
    def misfit(self) -> ChiSquare:
        """Whether the residuals are as large as the stated noise makes them."""
        freedom = max(self.degrees_of_freedom, 0)
        tested = freedom if self.independent is None else max(self.independent, 0)
        return ChiSquare(value=self.chi2 * tested / freedom if freedom else self.chi2, degrees_of_freedom=tested)

    @property
    def converged(self) -> bool:
        """Whether the values may be used."""
        return self.status == "converged"

    @property
    def first_order(self) -> bool:
        """Whether the covariance, which is of first order, describes the errors; True where it was not evaluated."""
        return not self.chi2_rise > LARGEST_RISE

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (p,)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    @property
    def reduced_chi2(self) -> float:
        """chi2 per degree of freedom; NaN without any."""
        return self.chi2 / self.degrees_of_freedom if self.degrees_of_freedom > 0 else float("nan")

    def index(self, name: str) -> int:
        """Position of an unknown."""
        if name not in self.names:
            raise unknown_name("unknown", name, self.names)
        return self.names.index(name)

    def pulls(self, truth: ArrayLike) -> FloatArray:
        """Errors over their predicted standard deviations (p,), NaN for what was held or is not determined."""
        true = np.asarray(truth, dtype=np.float64)
        if true.shape != self.value.shape:
            raise DomainError(f"truth of shape {true.shape} for {len(self.names)} unknowns")
        sigma = self.sigma
        determined = (sigma > 0) & np.isfinite(sigma)
        return np.divide(self.value - true, sigma, out=np.full(true.shape, np.nan), where=determined)
