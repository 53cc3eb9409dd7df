"""How many digits 1 - R keeps: squared chords, a subtraction, and SciPy, against arithmetic of 50 digits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext

import numpy as np

from calib.directional.fisher import fit_fisher, sample_fisher
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.engine.random import Streams

__all__ = ["DigitsPoint", "digits_sweep"]


MEAN = np.array([0.48, -0.6, 0.64])
VECTORS = 400
REFERENCE_DIGITS = 50
SIGMAS_ARCSEC = (100.0, 30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001)


@dataclass(frozen=True, slots=True, kw_only=True)
class DigitsPoint:
    """Relative error of the concentration 1/(1 - R) of one sample, against 50 digits."""

    sigma_arcsec: float  # Standard deviation per axis of the vectors
    chords: float  # By sums of squared chords
    subtraction: float  # By 1 - R in double precision; infinite where that is 0
    scipy: float  # By `scipy.stats.vonmises_fisher.fit`, which solves eq. 10; NaN where it gives up


def digits_sweep(streams: Streams, sigmas_arcsec: Sequence[float] = SIGMAS_ARCSEC) -> list[DigitsPoint]:
    """Estimate one sample of vectors in three ways, for one noise after the other."""
    points = []
    for i, sigma in enumerate(sigmas_arcsec):
        vectors = sample_fisher(MEAN, (sigma * ARCSEC_RAD) ** -2, VECTORS, streams.generator("digits", i))
        exact = _deficit(vectors)
        naive = 1.0 - float(np.linalg.norm(vectors.mean(0)))
        points.append(
            DigitsPoint(
                sigma_arcsec=sigma,
                chords=abs(fit_fisher(vectors).concentration_document * exact - 1.0),
                subtraction=abs(exact / naive - 1.0) if naive != 0.0 else float("inf"),
                scipy=_by_scipy(vectors, exact),
            )
        )
    return points


def _deficit(vectors: FloatArray) -> float:
    """1 - R, literally, in 50 digits."""
    with localcontext() as context:
        context.prec = REFERENCE_DIGITS
        total = [Decimal(0)] * 3
        for row in vectors:
            parts = [Decimal(float(x)) for x in row]
            length = sum((x * x for x in parts), Decimal(0)).sqrt()
            total = [a + x / length for a, x in zip(total, parts, strict=True)]
        return float(1 - sum((x * x for x in total), Decimal(0)).sqrt() / len(vectors))


def _by_scipy(vectors: FloatArray, exact: float) -> float:
    from scipy.stats import vonmises_fisher

    try:
        with np.errstate(all="ignore"):
            concentration = float(vonmises_fisher.fit(vectors)[1])
    except (ValueError, RuntimeError, ArithmeticError):  # no bracket, no convergence
        return float("nan")
    return abs(concentration * exact - 1.0)
