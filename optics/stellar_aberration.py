"""Stellar aberration: apparent directions of stars for a moving observer."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import constants

from optics.arrays import FloatArray
from optics.errors import DomainError


def aberrated(direction: ArrayLike, velocity_km_per_s: ArrayLike) -> FloatArray:
    """Apparent directions (n, 3) for an observer of velocity (3,); the opposite velocity gives the inverse.

    The exact formula of special relativity: S. A. Klioner, AJ 125, 1580 (2003), eq. 10. `DomainError` from the speed of
    light on.
    """
    r = np.asarray(direction, np.float64)
    beta = np.asarray(velocity_km_per_s, np.float64) * 1e3 / constants.c
    if r.ndim != 2 or r.shape[1] != 3 or beta.shape != (3,):
        raise DomainError(f"directions (n, 3) and a velocity (3,) are needed, got {r.shape} and {beta.shape}")
    if not float(beta @ beta) < 1.0:
        raise DomainError(
            f"velocity {np.linalg.norm(beta) * constants.c / 1e3:g} km/s; it must be below the speed of light"
        )
    inverse_gamma = math.sqrt(1.0 - float(beta @ beta))
    along = r @ beta
    apparent = inverse_gamma * r + (1.0 + along / (1.0 + inverse_gamma))[:, None] * beta
    return np.asarray(apparent / np.sqrt(np.einsum("ij,ij->i", apparent, apparent))[:, None])
