r"""Fisher distribution on the sphere: scatter of directions about a mean (FISHER23, S400-S500).

Density, for a unit vector w about the mean direction m with the concentration k:

.. math:: f(w) = \frac{k}{4 \pi \sinh k}\, e^{k\, m \cdot w}

For high k it is, on the plane that touches the sphere at m, an isotropic normal distribution of standard deviation

.. math:: \sigma = 1/\sqrt{k}

per axis (FISHER23 eq. 12). Everything follows from the *deficit* d = 1 - R of the mean resultant length
R = \|sum w_i\| / n. Star vectors good to 1 arcsec have d = 2.4e-11: the subtraction 1 - R would leave four digits of
it, and none at 0.01 arcsec. It is not subtracted here. With the unit mean m,

.. math:: d = \frac{1}{n} \sum (1 - m \cdot w_i) = \frac{1}{2n} \sum |w_i - m|^2

exactly, and the differences of nearly equal vectors lose nothing.

Estimators. Maximum likelihood solves coth k - 1/k = R (eq. 10); for high k that is the document's k = 1/(1 - R) = 1/d
(eq. 11), whose scatter is that about the estimated mean and therefore too small. In that limit (Watson,
Mon. Not. R. Astr. Soc. Geophys. Suppl. 7, 153, 1956) the sum of squared chords S = 2 n d obeys

.. math:: k S \sim \chi^2_\nu, \qquad \nu = 2 (n - 1)

so that S/nu is unbiased for **1/k = sigma^2**; that is what k = (n - 1)/(n d) rests on, and as an estimate of *k* it is
too large by nu/(nu - 2); unbiased for k itself is (n - 2)/(n d) (McFadden, Geophys. J. R. astr. Soc. 60, 397, 1980).
The interval follows from the same chi-square. If vectors were reduced with a calibration that was fitted to the same
data with p unknowns in all (star direction included), nu is 2 n - p, not 2 (n - 1): hand it in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.stats import chi2

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.frames import perpendicular
from optics.records import freeze

UNIT_TOLERANCE = 1e-9
LEAST_CONCENTRATION = 1e-6
LOW_CONCENTRATION = 10.0
"""Below, the chi-square of the high-concentration limit is no basis for an interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FisherFit:
    """A Fisher distribution fitted to directions.

    Attributes
    ----------
    mean : (3,)
        Unit mean direction.
    count : int
        Directions, n.
    deficit : float
        d = 1 - R, without cancellation.
    degrees_of_freedom : float
        nu of the sum of squared chords; 2 (n - 1) unless the directions were reduced with what was fitted to them.
    """

    mean: FloatArray
    count: int
    deficit: float
    degrees_of_freedom: float

    def __post_init__(self) -> None:
        freeze(self, "mean", shape=(3,))

    @property
    def chord_sum_rad2(self) -> float:
        """S = 2 n d, the sum of squared chords from the mean."""
        return 2.0 * self.count * self.deficit

    @property
    def concentration_document(self) -> float:
        """k = 1/(1 - R), eq. 11: maximum likelihood for high concentration, the scatter about the fitted mean."""
        return 1.0 / self.deficit

    @property
    def concentration_likelihood(self) -> float:
        """The solution of coth k - 1/k = R (eq. 10), for any concentration."""
        return concentration_from_deficit(self.deficit)

    @property
    def concentration(self) -> float:
        """nu/S, which is (n - 1)/(n (1 - R)): its inverse is unbiased."""
        return self.degrees_of_freedom / self.chord_sum_rad2

    @property
    def sigma_rad(self) -> float:
        """Standard deviation per axis [rad] (eq. 12): the root of the unbiased estimate of 1/k."""
        return float(np.sqrt(self.chord_sum_rad2 / self.degrees_of_freedom))

    @property
    def sigma_uncertainty_rad(self) -> float:
        """Standard deviation of `sigma_rad` [rad], sigma / sqrt(2 nu)."""
        return self.sigma_rad / float(np.sqrt(2.0 * self.degrees_of_freedom))

    def concentration_interval(self, level: float = 0.95, *, effective: float | None = None) -> tuple[float, float]:
        """Central confidence interval of k.

        Parameters
        ----------
        level : float
            Confidence, between 0 and 1.
        effective : float, optional
            Degrees of freedom of the chi-square that the interval is taken from, where the vectors do not follow the
            distribution (`calib.directional.fisher_checks.effective_degrees`); by default ``degrees_of_freedom``.

        Raises
        ------
        DomainError
            On another level, or a concentration below 10, where the chi-square does not hold.
        """
        tail = _tail(level)
        if self.concentration < LOW_CONCENTRATION:
            raise DomainError(
                f"concentration {self.concentration:.3g}: the interval assumes high concentration, at least "
                f"{LOW_CONCENTRATION:g}; use another method for directions with such scatter"
            )
        nu = self.degrees_of_freedom if effective is None else effective
        if not nu > 0:
            raise DomainError(f"effective = {nu:g} degrees of freedom; a positive number is needed")
        low, high = chi2.ppf([tail, 1.0 - tail], nu) / nu * self.concentration
        return float(low), float(high)

    def sigma_interval_rad(self, level: float = 0.95, *, effective: float | None = None) -> tuple[float, float]:
        """Central confidence interval of sigma per axis [rad]; takes and raises what `concentration_interval` does."""
        low, high = self.concentration_interval(level, effective=effective)
        return float(high**-0.5), float(low**-0.5)

    def mean_cone_rad(self, level: float = 0.95) -> float:
        """Half angle of the cone about the mean that holds the true direction with this confidence [rad].

        Fisher (Proc. R. Soc. A 217, 295, 1953): 1 - cos a = (n - nR)/(nR) ((1 - level)^(-1/(n - 1)) - 1).

        Raises
        ------
        DomainError
            On a level not between 0 and 1.
        """
        tail = 2.0 * _tail(level)
        part = self.deficit / max(1.0 - self.deficit, 1e-300) * np.expm1(-np.log(tail) / (self.count - 1))
        return float(2.0 * np.arcsin(np.sqrt(np.minimum(part / 2.0, 1.0))))


def _tail(level: float) -> float:
    if not 0.0 < level < 1.0:
        raise DomainError(f"level = {level}; a confidence between 0 and 1 is needed, like 0.95")
    return (1.0 - level) / 2.0


def fit_fisher(vectors: ArrayLike, *, degrees_of_freedom: float | None = None) -> FisherFit:
    """Fit a Fisher distribution to directions.

    Parameters
    ----------
    vectors : (n, 3)
        Unit vectors, at least two.
    degrees_of_freedom : float, optional
        Of the sum of squared chords; 2 (n - 1) for independent directions.

    Returns
    -------
    FisherFit

    Raises
    ------
    DomainError
        On fewer than two vectors, vectors that are not unit or not finite, vectors that are all equal or cancel, or
        no degrees of freedom.

    Examples
    --------
    Four directions 1e-6 rad from an axis; the naive 1 - R would be 5.000445e-13:

    >>> fit = fit_fisher([[1e-6, 0, 1], [-1e-6, 0, 1], [0, 1e-6, 1], [0, -1e-6, 1]])
    >>> print(f"{fit.deficit:.6e} {fit.sigma_rad:.6e}")
    5.000000e-13 8.164966e-07
    """
    w = _checked(vectors)
    mean, chord = mean_and_chords(w[None])
    deficit = float(0.5 * np.mean(chord[0]))
    if not deficit > 0.0:
        raise DomainError(
            f"all {len(w)} directions are the same: their concentration is infinite; noise is missing, or a "
            "measurement was repeated"
        )
    nu = 2.0 * (len(w) - 1) if degrees_of_freedom is None else float(degrees_of_freedom)
    if not (np.isfinite(nu) and nu > 0):
        raise DomainError(
            f"degrees_of_freedom = {nu:g} for {len(w)} directions; it must be positive: take more measurements than "
            "the calibration has unknowns"
        )
    return FisherFit(mean=mean[0], count=len(w), deficit=deficit, degrees_of_freedom=nu)


def mean_and_chords(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean directions and squared chords from them, of many samples at once.

    Shapes: ``vectors`` (r, n, 3), returns (r, 3), returns (r, n).
    """
    # Two passes: a sum of n vectors is rounded by n eps, differences from a first mean are not.
    first = vectors[:, 0]
    total = first + (vectors - first[:, None]).mean(1)
    length = np.linalg.norm(total, axis=1)
    if np.any(length < UNIT_TOLERANCE):
        raise DomainError("the directions cancel: their sum is zero, so that no mean direction exists")
    mean = total / length[:, None]
    difference = vectors - mean[:, None]
    return mean, np.einsum("rni,rni->rn", difference, difference)


def _checked(vectors: ArrayLike) -> FloatArray:
    w = np.asarray(vectors, dtype=np.float64)
    if w.ndim != 2 or w.shape[1] != 3:
        raise DomainError(f"directions of shape {w.shape}; (n, 3) unit vectors are needed")
    if len(w) < 2:
        raise DomainError(f"{len(w)} direction(s); at least 2 are needed for a scatter")
    length = np.linalg.norm(w, axis=1)
    off = ~(np.abs(length - 1.0) <= UNIT_TOLERANCE)  # NaN too
    if off.any():
        at = int(np.argmax(off))
        raise DomainError(f"direction {at} = {w[at].tolist()} has length {length[at]:.12g}; unit vectors are needed")
    return np.asarray(w / length[:, None])


def deficit_of_concentration(concentration: float) -> float:
    """1 - R = 1 - coth k + 1/k of the distribution (eq. 10), without cancellation.

    Examples
    --------
    >>> deficit_of_concentration(1e12)
    1e-12
    """
    k = float(concentration)
    if not k > 0:
        raise DomainError(f"concentration = {k:g}; it must be positive")
    if k < 1e-3:
        return 1.0 - k / 3.0 + k**3 / 45.0
    return 1.0 / k - (2.0 / np.expm1(2.0 * k) if k < 350.0 else 0.0)


def concentration_from_deficit(deficit: float) -> float:
    """The k of coth k - 1/k = 1 - d (eq. 10); 1/d to the last digit from k = 20 on."""
    d = float(deficit)
    if not 0.0 < d < 1.0:
        raise DomainError(f"1 - R = {d:g}; it must lie between 0 and 1")
    if d < 0.02:  # exp(-100) of relative difference
        return 1.0 / d
    if 1.0 - d < LEAST_CONCENTRATION / 3.0:
        return 3.0 * (1.0 - d)
    # 1/k - d is above 1 - coth k and below it plus 2/(e^{2k} - 1): the root lies between these
    return float(brentq(lambda k: deficit_of_concentration(k) - d, LEAST_CONCENTRATION / 2.0, 1.0 / d, xtol=1e-14))


def tangent_plane(vectors: ArrayLike, mean: ArrayLike) -> FloatArray:
    """Coordinates of directions on the sphere about a mean, flattened without changing chords (Lambert).

    Shapes: ``vectors`` (n, 3), ``mean`` (3,).
    """
    w, m = np.asarray(vectors, np.float64), np.asarray(mean, np.float64)
    basis = tangent_basis(m)
    across = (w - m) @ basis.T
    chord2 = np.einsum("ni,ni->n", w - m, w - m)
    across2 = np.einsum("ni,ni->n", across, across)
    scale = np.sqrt(np.divide(chord2, across2, out=np.ones_like(chord2), where=across2 > 0))
    return np.asarray(across * scale[:, None])


def tangent_basis(mean: ArrayLike) -> FloatArray:
    """Unit vectors (2, 3) across a mean: Y x m, which is +X for a mean at +Z, and m times that, +Y then."""
    m = np.asarray(mean, np.float64)
    across = np.cross([0.0, 1.0, 0.0], m)
    if np.linalg.norm(across) < 1e-3:
        across = np.cross(m, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(m, across)])


def sample_fisher(mean: ArrayLike, concentration: float, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw directions; exact at any concentration (inverse of the distribution of 1 - cos).

    Parameters
    ----------
    mean : (3,)
        Unit vector.
    concentration : float
        k > 0.
    count : int
        How many, n.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    (n, 3)
        Unit vectors.

    Raises
    ------
    DomainError
        On a concentration that is not positive.
    """
    k = float(concentration)
    if not (np.isfinite(k) and k > 0):
        raise DomainError(f"concentration = {k:g}; it must be positive")
    m = np.asarray(mean, np.float64)
    u, turn = rng.random(count), rng.uniform(0.0, 2.0 * np.pi, count)
    # P(1 - cos > c) = (exp(-k c) - exp(-2k)) / (1 - exp(-2k))
    versine = -np.log1p(u * np.expm1(-2.0 * k)) / k if k < 350.0 else -np.log1p(-u) / k
    sine = np.sqrt(versine * (2.0 - versine))
    first, second = perpendicular(m)
    across = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return np.asarray(m + (sine[:, None] * across - versine[:, None] * m))
