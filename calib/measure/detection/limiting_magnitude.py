"""Completeness of detections against a catalogue: detected stars and fractions, limiting magnitude, clouds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from optics.arrays import FloatArray, IntArray

CANDIDATES = 6
START_WIDTH_MAG = 0.15
TILES, CLOUD_TILES = 5, 3
FEWEST_EXPECTED, CLOUDED_FRACTION = 5, 0.5


def detected_stars(
    star_px: FloatArray, detection_px: FloatArray, significance: FloatArray, radius_px: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Significance of every catalogue star (n,), 0 if not detected, and detections (m,) of no catalogue star.

    A detection is attributed to the brightest star within the radius.

    Shapes: ``star_px`` (n, 2), the brightest first; ``detection_px`` (m, 2), ``significance`` (m,).
    """
    of_star = np.zeros(len(star_px))
    if not len(detection_px) or not len(star_px):
        return of_star, np.ones(len(detection_px), bool)
    distance, nearest = cKDTree(star_px).query(detection_px, k=np.arange(1, min(CANDIDATES, len(star_px)) + 1))
    star = np.where(distance < radius_px, nearest, len(star_px)).min(axis=1)
    matched = star < len(star_px)
    np.maximum.at(of_star, star[matched], significance[matched])
    return of_star, ~matched


def limiting_magnitude(magnitude: FloatArray, detected: NDArray[np.bool_]) -> float:
    """Magnitude at which half of n stars are detected: maximum likelihood of a logistic curve.

    NaN where all or none are. Shapes: ``magnitude`` (n,), ``detected`` (n,).
    """
    if not detected.any() or detected.all():
        return float("nan")
    start = float(np.sort(magnitude)[int(detected.sum())])

    def loss(p: FloatArray) -> float:
        z = (p[0] - magnitude) / np.exp(p[1])
        return float(np.logaddexp(0.0, -z)[detected].sum() + np.logaddexp(0.0, z)[~detected].sum())

    return float(minimize(loss, [start, np.log(START_WIDTH_MAG)], method="Nelder-Mead").x[0])


def completeness(
    magnitude: FloatArray, detected: NDArray[np.bool_], edges_mag: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Number of stars and detected fraction (k,) between edges (k + 1,) of magnitude; NaN where there is no star."""
    count = np.histogram(magnitude, edges_mag)[0]
    with np.errstate(invalid="ignore"):
        return count, np.histogram(magnitude[detected], edges_mag)[0] / count


def empty_fraction(shape: tuple[int, ...], position_px: FloatArray) -> float:
    """Fraction of the tiles of a frame without a detection at positions (n, 2), if the others have several each."""
    count = _counts(position_px, shape, TILES)
    return float((count == 0).mean()) if count.sum() >= 2 * (count > 0).sum() > 0 else 0.0


def clouded_fraction(shape: tuple[int, ...], expected_px: FloatArray, detected: NDArray[np.bool_]) -> float:
    """Fraction of a frame in which most of the stars well above the detection limit are missing.

    Shapes: ``expected_px`` (n, 2) positions of these stars, ``detected`` (n,).
    """
    expected = _counts(expected_px, shape, CLOUD_TILES)
    present = _counts(expected_px[np.asarray(detected, bool)], shape, CLOUD_TILES)
    judged = expected >= FEWEST_EXPECTED
    return float((present[judged] < CLOUDED_FRACTION * expected[judged]).mean()) if judged.any() else 0.0


def _counts(position_px: FloatArray, shape: tuple[int, ...], tiles: int) -> FloatArray:
    edges = [np.linspace(-0.5, n - 0.5, tiles + 1) for n in shape]
    return np.histogram2d(position_px[:, 1], position_px[:, 0], bins=edges)[0]
