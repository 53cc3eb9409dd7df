"""Robust losses of least squares: the weight of a residual, bounded so that a wrong match cannot distort the fit.

A loss rho acts on the squared length s of one whitened residual, a scalar or the two coordinates of a star. The
least-squares core minimises the sum of rho(s); its normal equations contain the weight w(s) = rho'(s).

=========  ===================================  ==========================  =========
name       rho(s)                               w(s)                        large s
=========  ===================================  ==========================  =========
linear     s                                    1                           grows as s
huber      s, then 2 c sqrt(s) - c^2            1, then c / sqrt(s)         sqrt(s)
soft_l1    2 c^2 (sqrt(1 + s/c^2) - 1)          1 / sqrt(1 + s/c^2)         sqrt(s)
cauchy     c^2 log(1 + s/c^2)                   1 / (1 + s/c^2)             log(s)
tukey      c^2/3 (1 - (1 - s/c^2)^3), c^2/3     (1 - s/c^2)^2, 0            constant
=========  ===================================  ==========================  =========

Only "tukey" (Beaton & Tukey 1974, Technometrics 16, 147) ignores a wrong match completely; it needs good start values,
which the stages of a fit prepare by lowering the scale step by step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name

Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """A robust loss in units of one sigma."""

    name: str  # Name of the loss
    tuning: float  # The c of the table [sigma]: where the loss begins to bend

    @property
    def redescending(self) -> bool:
        """Whether the pull of a residual falls again far out; such a loss has local minima and needs a good start."""
        return self.name in ("cauchy", "tukey")

    def rho(self, squared: FloatArray) -> FloatArray:
        """Loss of squared residual lengths (n,)."""
        c2 = self.tuning**2
        return c2 * _SHAPES[self.name][0](squared / c2)

    def weight(self, squared: FloatArray) -> FloatArray:
        """Weight rho'(s) of squared residual lengths (n,), between 0 and 1."""
        return _SHAPES[self.name][1](squared / self.tuning**2)

    def variance_factor(self, group: int) -> float:
        """Factor by which the inverse of the weighted information becomes the covariance.

        For normal residuals of unit variance in ``group`` coordinates the estimator has the covariance
        E[psi psi^T] / E[psi']^2 times the inverse of the unweighted information (Huber 1981, Robust Statistics,
        eq. 7.6.5), psi = w(s) r. The weighted information is E[w] times the unweighted one, so the factor is

            E[w^2 s] / g * E[w] / (E[w] + 2 E[w' s] / g)^2,     g = group.
        """
        return _moments(self.name, float(self.tuning), group)[0]

    def efficiency(self, group: int) -> float:
        """Variance of plain least squares over that of this loss, for normal residuals."""
        return _moments(self.name, float(self.tuning), group)[1]


def _huber_rho(t: FloatArray) -> FloatArray:
    return np.where(t <= 1.0, t, 2.0 * np.sqrt(t) - 1.0)


def _huber_weight(t: FloatArray) -> FloatArray:
    return 1.0 / np.sqrt(np.maximum(t, 1.0))


def _tukey_rho(t: FloatArray) -> FloatArray:
    return (1.0 - np.maximum(1.0 - t, 0.0) ** 3) / 3.0


def _tukey_weight(t: FloatArray) -> FloatArray:
    return np.maximum(1.0 - t, 0.0) ** 2


# rho and its derivative as functions of s / c^2, each in units of c^2 and 1
_SHAPES: dict[str, tuple[Function, Function]] = {
    "linear": (lambda t: t, np.ones_like),
    "huber": (_huber_rho, _huber_weight),
    "soft_l1": (lambda t: 2.0 * (np.sqrt(1.0 + t) - 1.0), lambda t: 1.0 / np.sqrt(1.0 + t)),
    "cauchy": (np.log1p, lambda t: 1.0 / (1.0 + t)),
    "tukey": (_tukey_rho, _tukey_weight),
}

# c such that a star position (two coordinates) keeps 95 % of its efficiency under normal noise; see efficiency()
_TUNING = {"linear": 1.0, "huber": 1.501, "soft_l1": 1.309, "cauchy": 2.549, "tukey": 5.123}


def list_losses() -> tuple[str, ...]:
    """Names that `get_loss` knows."""
    return tuple(_SHAPES)


def get_loss(loss: str | Loss, *, tuning: float | None = None) -> Loss:
    """Loss by name."""
    if isinstance(loss, Loss):
        return loss
    if loss not in _SHAPES:
        raise unknown_name("loss", loss, _SHAPES)
    c = _TUNING[loss] if tuning is None else float(tuning)
    if not (np.isfinite(c) and c > 0):
        raise DomainError(f"tuning = {tuning} sigma of loss {loss!r}; it must be positive, typically 1 to 6")
    return Loss(name=loss, tuning=c)


@lru_cache(maxsize=64)
def _moments(name: str, tuning: float, group: int) -> tuple[float, float]:
    """Variance factor and efficiency under a normal distribution of ``group`` coordinates."""
    if name == "linear":
        return 1.0, 1.0
    loss = Loss(name=name, tuning=tuning)
    # radius of a standard normal vector: chi distribution; a fine midpoint rule also copes with the kinks
    radius = (np.arange(40000) + 0.5) * (12.0 / 40000)
    density = radius ** (group - 1) * np.exp(-0.5 * radius**2)
    density /= density.sum()
    s = np.asarray(radius**2, np.float64)
    w = loss.weight(s)
    slope = np.gradient(w, radius) * radius / 2.0  # w'(s) s, the derivative being by s
    mean_w, spread = float(density @ w), float(density @ (w**2 * s)) / group
    bend = mean_w + 2.0 * float(density @ slope) / group
    return spread * mean_w / bend**2, bend**2 / spread
