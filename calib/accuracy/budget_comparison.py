"""Error budgets of repeated tests, and predicted against measured ones: ratios, deviations, frame terms together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.accuracy.error_budget import FRAME_TERMS, ErrorBudget, ErrorTerm
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD

CHIP_SCATTER = ("HSFE", "LSFE-C1")
"""Terms whose predicted uncertainty is the scatter of the measured number from chip to chip."""
SIGNIFICANT = 5.0
"""Standard deviations of the measurement from which on a term has a ratio."""


def repeated_term(terms: Sequence[ErrorTerm]) -> ErrorTerm:
    """Root mean square of a term over independent repetitions of its test."""
    value = np.sqrt(np.mean([term.arcsec**2 for term in terms], axis=0))
    of_square = np.array([2.0 * term.arcsec * np.nan_to_num(term.uncertainty_arcsec) for term in terms])
    spread = np.sqrt((of_square**2).sum(0)) / len(terms) / np.maximum(2.0 * value, 1e-300)
    return ErrorTerm(arcsec=value, uncertainty_arcsec=spread, n=sum(term.n for term in terms))


def survey_term(direction: FloatArray) -> ErrorTerm | None:
    """Marking error of a target, 3 sigma: scatter of repeated surveys (q, n, 3) of its n points in their plane.

    None for a single survey.
    """
    plane = direction[..., :2] / direction[..., 2:]
    free = (len(plane) - 1) * plane.shape[1]
    if not free:
        return None
    value = 3.0 / ARCSEC_RAD * np.sqrt(((plane - plane.mean(0)) ** 2).sum((0, 1)) / free)
    return ErrorTerm(arcsec=value, uncertainty_arcsec=value / np.sqrt(2.0 * free), n=plane.shape[0] * plane.shape[1])


def next_draw_variance(drawn: FloatArray) -> FloatArray:
    """Squared deviation that a further draw has from the mean of k draws (k, ...), expected from these k.

    The mean has an error of its own, 1 / k, and a variance known from a few is Student's with k - 1 degrees of freedom,
    (k - 1) / (k - 3) (JCGM 101:2008, 6.4.9.4); up to three say too little for that.
    """
    k = len(drawn)
    student = (k - 1.0) / (k - 3.0) if k > 3 else 1.0
    return np.asarray(student * drawn.var(0, ddof=1) * (1.0 + 1.0 / k))


def difference_sigma(name: str, predicted: FloatArray, measured: FloatArray) -> FloatArray:
    """Standard deviation of predicted minus measured, of a term by its name, from both standard deviations.

    The predicted uncertainty of HSFE and C1 is the scatter of the measured number from chip to chip. It already
    contains the measured uncertainty by jackknife and surveys, which is therefore not added.
    """
    return np.asarray(predicted if name in CHIP_SCATTER else np.hypot(predicted, measured))


def term_ratio(name: str, predicted: ErrorTerm, measured: ErrorTerm) -> tuple[FloatArray, FloatArray]:
    """Predicted over measured term (2,), and its standard deviation; NaN for terms below 5 sigma of the measurement."""
    significant = (predicted.arcsec > SIGNIFICANT * measured.uncertainty_arcsec) & (predicted.arcsec > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = predicted.arcsec / measured.arcsec
        relative = (term.uncertainty_arcsec / term.arcsec for term in (predicted, measured))
        sigma = ratio * difference_sigma(name, *relative)
    return np.where(significant, ratio, np.nan), np.where(significant, sigma, np.nan)


def term_pull(name: str, predicted: ErrorTerm, measured: ErrorTerm) -> FloatArray:
    """Predicted minus measured term (2,) in standard deviations of the difference."""
    spread = difference_sigma(name, predicted.uncertainty_arcsec, measured.uncertainty_arcsec)
    return np.asarray((predicted.arcsec - measured.arcsec) / spread)


def frame_terms_ratio(predicted: ErrorBudget, measured: ErrorBudget) -> tuple[FloatArray, FloatArray]:
    """Root sum of squares of `FRAME_TERMS`, predicted over measured (2,), and its standard deviation."""
    sides = (predicted, measured)
    a, b = (np.sqrt(np.sum([side[name].arcsec ** 2 for name in FRAME_TERMS], axis=0)) for side in sides)
    variance = np.zeros(2)
    for name in FRAME_TERMS:
        sigma = difference_sigma(name, *(side[name].uncertainty_arcsec for side in sides))
        variance = variance + (measured[name].arcsec * sigma) ** 2
    return a / b, np.sqrt(variance) / b**2
