"""Tests of the Fisher distribution of high concentration: isotropy, tails, outliers.

Under it the coordinates on the tangent plane are independent normal variables of equal variance, and k (1 - cos) of the
angles from the mean follows the exponential distribution of mean 1. A real bench violates this by noise that is larger
along one direction (a moving table with clock jitter), noise that differs between places (a mixture: heavier tails),
and single wrong measurements.

The tests are from Fisher, Lewis & Embleton, *Statistical Analysis of Spherical Data* (1987), sec. 5.3, in the limit of
high concentration, in which the distribution of two of them is known exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.directional.fisher import fit_fisher, mean_and_chords, tangent_plane
from optics.arrays import BoolArray, FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all

CRITICAL_EXPONENTIAL = {0.15: 0.926, 0.10: 0.990, 0.05: 1.094, 0.025: 1.190, 0.01: 1.308}
"""Level -> critical value of the modified Kolmogorov statistic, exponential with estimated mean: Stephens (J. Am. Stat.
Assoc. 69, 730, 1974)."""
LEAST_COUNT = 4
LEVEL = 0.01
LARGEST_SHARE = 0.2
"""Outliers looked for, as a part of all directions; more than that is not an outlier but another distribution."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Isotropy:
    """Scatter along the axes of its ellipse."""

    major_rad: float  # Standard deviations along the axes of the ellipse [rad]
    minor_rad: float
    # (3,) Unit vector of the major axis on the tangent plane, in the frame of the directions; its sign means nothing
    direction: FloatArray
    p_value: float  # Chance of an ellipse at least as long in an isotropic distribution

    def __post_init__(self) -> None:
        freeze(self, "direction", shape=(3,))

    @property
    def ratio(self) -> float:
        """Major over minor."""
        return self.major_rad / self.minor_rad if self.minor_rad > 0 else float("inf")


def isotropy_check(vectors: ArrayLike) -> Isotropy:
    r"""Test whether directions scatter equally along all axes.

    Mauchly's sphericity test on the tangent plane, exact for two normal variables: with the scatter matrix C of n
    directions and v = 2 sqrt(det C)/tr C, the chance of a smaller v is v^(n - 2) (Anderson, *Multivariate Statistical
    Analysis*, 2003, sec. 10.7). For high concentration Kent's test (J. R. Stat. Soc. B 44, 71, 1982), n/4 times the
    square of the variances' difference over their mean against chi-square with 2 degrees of freedom, is its
    limit for many directions.

    Parameters
    ----------
    vectors : (n, 3)
        Unit vectors, at least four.

    Raises
    ------
    DomainError
        On too few directions, and as `calib.directional.fisher.fit_fisher`.
    """
    w, mean = _fitted(vectors)
    plane = tangent_plane(w, mean)
    plane = plane - plane.mean(0)
    scatter = plane.T @ plane / (len(plane) - 1)
    values, axes = np.linalg.eigh(scatter)
    roundness = 2.0 * np.sqrt(max(values[0], 0.0) * values[1]) / (values[0] + values[1])
    spanned = np.linalg.lstsq(plane, w - w.mean(0), rcond=None)[0]  # (2, 3): the plane's axes in space
    along = axes[:, 1] @ spanned
    return Isotropy(
        major_rad=float(np.sqrt(values[1])),
        minor_rad=float(np.sqrt(max(values[0], 0.0))),
        direction=along / np.linalg.norm(along),
        p_value=float(roundness ** (len(w) - 2)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Exponential:
    """Angles from the mean against what the distribution expects."""

    expected: FloatArray  # (n,) Quantiles of the exponential distribution of mean 1, rising: -ln(1 - (i - 1/2)/n)
    found: FloatArray  # (n,) k (1 - cos) of the directions, in rising order
    statistic: float  # Modified Kolmogorov statistic (D - 0.2/n)(sqrt n + 0.26 + 0.5/sqrt n)

    def __post_init__(self) -> None:
        freeze_all(self, expected=("n",), found=("n",))

    @property
    def level(self) -> float:
        """Smallest tabulated level at which the distribution is refused; 1: at none."""
        return min((level for level, limit in CRITICAL_EXPONENTIAL.items() if self.statistic > limit), default=1.0)


def exponential_check(vectors: ArrayLike) -> Exponential:
    """Compare the angles from the mean with the exponential distribution (a QQ plot and a test).

    Parameters
    ----------
    vectors : (n, 3)
        Unit vectors, at least four.

    Raises
    ------
    DomainError
        As `isotropy_check`.
    """
    w, mean = _fitted(vectors)
    chord2 = np.sort(np.einsum("ni,ni->n", w - mean, w - mean))
    deviates = chord2 / chord2.mean()
    count = len(deviates)
    steps = np.arange(count + 1) / count
    below = -np.expm1(-deviates)
    largest = float(max((steps[1:] - below).max(), (below - steps[:-1]).max()))
    return Exponential(
        expected=-np.log1p(-(np.arange(count) + 0.5) / count),
        found=deviates,
        statistic=(largest - 0.2 / count) * (np.sqrt(count) + 0.26 + 0.5 / np.sqrt(count)),
    )


def effective_degrees(vectors: ArrayLike) -> float:
    r"""Degrees of freedom of the sum of squared chords, from the variance of these.

    The variance of a sum of independent squared chords c is n var(c) for any distribution; the chi-square of the same
    relative variance has

    .. math:: \nu = 2 (n - 1)\, \langle c \rangle^2 / \mathrm{var}(c)

    degrees of freedom. In a Fisher distribution var(c) = <c>^2 and it is 2 (n - 1); an ellipse or heavy tails make it
    smaller and the interval of sigma wider, as they must. It needs some 50 vectors, rather more for rare outliers.

    Shapes: ``vectors`` (n, 3).
    """
    w, mean = _fitted(vectors)
    chord2 = np.einsum("ni,ni->n", w - mean, w - mean)
    return float(2.0 * (len(w) - 1) * chord2.mean() ** 2 / max(chord2.var(ddof=1), 1e-300))


def fisher_outliers(vectors: ArrayLike, *, level: float = LEVEL) -> BoolArray:
    r"""Directions that a Fisher distribution does not explain.

    Generalised extreme deviates (Rosner, Technometrics 25, 165, 1983), so that outliers do not hide each other: the
    direction farthest from the mean of the remaining ones is removed repeatedly, up to a fifth of all; the last step at
    which it stood out counts, with all before it. Whether it stands out: leaving one of n directions out,

    .. math:: E = (n - 2)\, \frac{S_n - S_{n-1}}{S_{n-1}} \sim F_{2,\, 2n - 4}

    for one chosen beforehand (Fisher, Lewis & Embleton, sec. 5.3, for high concentration), S the sums of squared
    chords; its chance (1 + E/(n - 2))^(-(n - 2)) is multiplied by n for the farthest of n.

    Cutting the tail of a good sample makes sigma smaller: at the default level that happens once in a hundred samples.

    Shapes: ``vectors`` (n, 3).
    """
    if not 0.0 < level < 1.0:
        raise DomainError(f"level = {level}; a chance between 0 and 1 is needed, like {LEVEL}")
    w, _ = _fitted(vectors)
    keep = np.ones(len(w), dtype=bool)
    order: list[int] = []
    last = 0
    for step in range(max(int(LARGEST_SHARE * len(w)), 1)):
        remaining = np.flatnonzero(keep)
        if len(remaining) < LEAST_COUNT:
            break
        _, chord2 = mean_and_chords(w[None, remaining])
        total, count = float(chord2.sum()), len(remaining)
        farthest = int(np.argmax(chord2[0]))
        without = total - float(chord2[0, farthest]) * count / (count - 1)
        keep[remaining[farthest]] = False
        order.append(int(remaining[farthest]))
        if count * max(without / total, 0.0) ** (count - 2) < level:  # (1 + E/(n - 2))^-1 = S_{n-1}/S_n
            last = step + 1
    outlier = np.zeros(len(w), dtype=bool)
    outlier[order[:last]] = True
    return outlier


def _fitted(vectors: ArrayLike) -> tuple[FloatArray, FloatArray]:
    w = np.asarray(vectors, np.float64)
    mean = fit_fisher(w).mean
    if len(w) < LEAST_COUNT:
        raise DomainError(f"{len(w)} directions; at least {LEAST_COUNT} are needed to judge their distribution")
    return w / np.linalg.norm(w, axis=1, keepdims=True), mean
