"""Chromatic error of a star camera (ACC18 eq. 13-16, Table 1) from mean centroids behind several filters.

Positions have the shape (p, j, b, 2): j points at p places of the field behind b filters. The shift of a point between
two filters is eq. 15; Table 1 is the signed mean of the shifts over places and points, halved (eq. 16), which vanishes
for the lateral colour of a centred lens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calib.accuracy.error_budget import ErrorTerm
from optics.arrays import FloatArray

CALIBRATIONS: Mapping[str, Sequence[int]] = {
    "as found": [],
    "principal point": [0, 1],
    "focal length": [2],
    "both": [0, 1, 2],
}
"""Parameters that a camera model may have per band, and their columns in the design matrix of `after_calibration`."""

Pair = tuple[str, int, int]
"""Name of a pair of bands, index of the longer wavelength and of the shorter one."""


def band_pairs(centres_nm: Sequence[float], reference: int) -> list[Pair]:
    """Differences of every band to a reference, the longer wavelength first (ACC18 eq. 15); "800-600"."""
    pairs = []
    for band in range(len(centres_nm)):
        if band != reference:
            high, low = (band, reference) if centres_nm[band] > centres_nm[reference] else (reference, band)
            pairs.append((f"{centres_nm[high]:g}-{centres_nm[low]:g}", high, low))
    return pairs


def shifts(position_px: FloatArray, pairs: Sequence[Pair]) -> dict[str, FloatArray]:
    """Shift (..., 2) of every point for each pair of bands, from positions (..., b, 2); ACC18 eq. 15."""
    return {name: position_px[..., high, :] - position_px[..., low, :] for name, high, low in pairs}


def table1(shift_px: FloatArray) -> FloatArray:
    """Signed mean over places and points, halved (ACC18 eq. 16): (..., p, j, 2) -> (..., 2)."""
    return np.asarray(shift_px.mean((-3, -2)) / 2.0)


def rms_shift_px(shift_px: FloatArray) -> FloatArray:
    """Root mean square per axis over places and points, (p, j, 2) -> (2,)."""
    return np.asarray(np.sqrt((shift_px**2).mean((0, 1))))


def chromatic_error(table1_px: FloatArray, sigma_px: FloatArray, pixel_arcsec: float, n: int = 0) -> ErrorTerm:
    """Chromatic term of the budget, 3 sigma: per axis the largest entry of Table 1 as three standard deviations.

    Shapes: ``table1_px``, ``sigma_px`` (k, 2), entries for k pairs of bands and their standard deviations; ``n``:
    frames of an entry, 0 for a prediction.
    """
    largest = np.abs(table1_px).argmax(0)[None]
    entry, sigma = (np.take_along_axis(v, largest, axis=0)[0] for v in (np.abs(table1_px), np.asarray(sigma_px)))
    return ErrorTerm(arcsec=pixel_arcsec * entry, uncertainty_arcsec=pixel_arcsec * sigma, n=n)


def after_calibration(shift_px: FloatArray, from_centre_px: FloatArray) -> dict[str, FloatArray]:
    """Shifts (..., 2) that remain when a camera model has parameters for the band, by the names of `CALIBRATIONS`.

    Shapes: ``shift_px`` (..., 2) of one pair of bands, ``from_centre_px`` (..., 2) positions from the principal point.
    """
    shift, position = shift_px.reshape(-1, 2), from_centre_px.reshape(-1, 2)
    unit, zero = np.ones(len(shift)), np.zeros(len(shift))
    x, y = position.T
    design_matrix = np.stack([[unit, zero, x], [zero, unit, y]]).transpose(2, 0, 1).reshape(-1, 3)
    data = shift.ravel()
    residual_px = {}
    for name, columns in CALIBRATIONS.items():
        terms = design_matrix[:, list(columns)]
        fit = terms @ np.linalg.lstsq(terms, data, rcond=None)[0] if columns else 0.0
        residual_px[name] = (data - fit).reshape(shift_px.shape)
    return residual_px


def shift_sigma(
    sigma_px: FloatArray,
    frames: NDArray[np.int64],
    pattern_px: FloatArray,
    pairs: Sequence[Pair],
    *,
    variance_fraction: FloatArray | float = 1.0,
) -> dict[str, FloatArray]:
    """Standard deviation (p, j, 2) of every shift, by pair of bands.

    The scatter of the frames is pooled over the points of a place (the estimate of one point from 30 frames would have
    pulls of Student's law) and distributed over them as predicted: the centroid error of a small spot changes by a
    factor of three with its position on the pixels.

    Shapes: ``sigma_px`` (p, j, b, 2) of the centroid of a frame, ``frames`` (p, j, b), ``pattern_px`` (q, p, j, b, 2)
    effect of q fixed patterns of the pixels on the centroids, common to the filters; ``variance_fraction`` (p, j, b, 2)
    predicted variance of a frame's centroid, in any unit.
    """
    pattern = shifts(pattern_px, pairs)
    fraction = np.broadcast_to(variance_fraction, sigma_px.shape)
    of_frame = fraction * (sigma_px**2 / fraction).mean(1, keepdims=True)
    of_mean = of_frame / frames[..., None]
    return {
        name: np.sqrt(of_mean[..., high, :] + of_mean[..., low, :] + (pattern[name] ** 2).mean(0))
        for name, high, low in pairs
    }


def table1_sigma(
    sigma_px: FloatArray,
    frames: NDArray[np.int64],
    pattern_px: FloatArray,
    pairs: Sequence[Pair],
    *,
    common_px: float = 0.0,
) -> dict[str, FloatArray]:
    """Standard deviation (2,) of an entry of Table 1, by pair of bands; arguments as in `shift_sigma`.

    ``common_px``: part of the mean centroids' standard deviation that all points of a place share (motion of the line
    of sight).
    """
    pattern = shifts(pattern_px, pairs)
    of_mean = (sigma_px**2).mean(1, keepdims=True) / frames[..., None]
    sigma = {}
    for name, high, low in pairs:
        temporal = of_mean[..., high, :] + of_mean[..., low, :]
        places, points = temporal.shape[:2]
        # the common motion does not average over the points of a place
        common = 2.0 * common_px**2 * (1.0 / places - 1.0 / (places * points)) / 4.0
        independent = temporal.sum((0, 1)) / (2 * places * points) ** 2
        sigma[name] = np.sqrt(independent + common + (table1(pattern[name]) ** 2).mean(0))
    return sigma


def independent_shifts(count: int, points: int, common_px: float, sigma_px: FloatArray) -> float:
    """Independent values among ``count`` squared pulls of shifts.

    The points of a place share a motion of the standard deviation ``common_px`` per mean centroid; ``sigma_px`` are
    the standard deviations of the shifts, in which it is contained twice.
    """
    correlation = 2.0 * common_px**2 / float((sigma_px**2).mean())
    return count / (1.0 + (points - 1.0) * correlation**2)
