"""Pupil sampling: quadrature and Sobol points of the unit disk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze_alike


@dataclass(frozen=True, slots=True, kw_only=True)
class PupilSamples:
    """Points of the unit disk with weights that sum to 1."""

    x: FloatArray  # (n,)
    y: FloatArray  # (n,)
    weight: FloatArray  # (n,) Equal for Sobol points

    def __post_init__(self) -> None:
        freeze_alike(self, "x", "y", "weight", shape=("n",))


def gauss_disk(rings: int, arms: int, *, inner: float = 0.0) -> PupilSamples:
    """Gauss-Legendre in r^2 times trapezoid in phi.

    Exact for polynomials in (x, y) of degree min(4 rings - 1, arms - 1) (Peirce 1957, J. Soc. Indust. Appl. Math. 5,
    66): the trapezoid removes every angular order below ``arms``, the rest is a polynomial in r^2 that Gauss-Legendre
    integrates up to degree 2 rings - 1. For ``arms`` divisible by 4 the points are symmetric about both axes.

    Parameters
    ----------
    rings, arms : int
        Number of radii and of azimuths.
    inner : float
        Inner radius of an annulus; 0 for the disk.

    Returns
    -------
    PupilSamples
        rings x arms points of the unit disk, with weights.

    Raises
    ------
    DomainError
        If either is below 1.
    """
    if rings < 1 or arms < 1:
        raise DomainError(f"pupil sampling of {rings} rings x {arms} arms; at least 1 x 1 is needed")
    node, weight = np.polynomial.legendre.leggauss(rings)
    r = np.sqrt(inner**2 + (1.0 - inner**2) * 0.5 * (1.0 + node))
    phi = 2.0 * np.pi * (np.arange(arms) + 0.5) / arms
    return PupilSamples(
        x=np.outer(r, np.cos(phi)).ravel(),
        y=np.outer(r, np.sin(phi)).ravel(),
        weight=np.repeat(0.5 * weight / arms, arms),
    )


def disk_from_square(u: ArrayLike, v: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Area-preserving map of the unit square to the unit disk: r = sqrt(u), phi = 2 pi v."""
    r, phi = np.sqrt(np.asarray(u, float)), 2.0 * np.pi * np.asarray(v, float)
    return r * np.cos(phi), r * np.sin(phi)


def sobol_disk(count: int, *, seed: int) -> PupilSamples:
    """Scrambled Sobol points in the unit disk.

    Parameters
    ----------
    count : int
        Number of points, a power of two (what the balance of a Sobol set needs).
    seed : int
        Seed of the scrambling.

    Returns
    -------
    PupilSamples
        Points of the unit disk, of equal weights.

    Raises
    ------
    DomainError
        If ``count`` is not a power of two from 1 to 2^30.
    """
    if not (0 < count <= 1 << 30) or count & (count - 1):
        raise DomainError(f"{count} Sobol points; a power of two from 1 to 2^30 is needed")
    from scipy.stats import qmc  # slow to import

    square = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(seed)).random_base2(count.bit_length() - 1)
    x, y = disk_from_square(square[:, 0], square[:, 1])
    return PupilSamples(x=x, y=y, weight=np.full(count, 1.0 / count))
