"""Filters of a chromatic test: a wedge separated from the lens, and exchanged files of two filters.

The shift of a point at r between a filter and the reference filter, at a place of the field whose filters have the
angle t to the camera, is

    shift = lens + scale (r - centre) + R(t) wedge,

``lens`` the shift by a decentred element (prism: uniform, turns with the camera), ``wedge`` the shift by the filter
relative to the reference filter (turns with the filter), R the rotation from +x to +y. At one angle only the sum of
both is known. If the angles of filter and reference filter differ, ``(R(t) - R(t of the reference)) wedge of the
reference`` is added; undetermined quantities are NaN.

Exchanged files: light and width of a spot are a product of filter and place. If exchanging two filters at a place makes
places agree that otherwise disagree, the filters are exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from optics.arrays import FloatArray

LIGHT_FLOOR, WIDTH_FLOOR = 0.03, 0.02
"""Relative change of light and width from place to place between filters: vignetting and chromatic aberrations."""
LEAST_GAIN, EXCHANGE_RATIO = 25.0, 0.25
"""Least reduction of the squares over these floors by an exchange, absolute, and largest ratio after it."""
DETERMINED = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftParts:
    """Parts of the shift of a pair of filters [px]; NaN where the angles do not determine them."""

    constant_px: FloatArray  # (2,) Uniform part, mean over the places
    lens_px: FloatArray  # (2,) Uniform part by the lens
    wedge_px: FloatArray  # (2,) Uniform part by the filter relative to the reference, at the angle 0
    constant_sigma_px: FloatArray  # (2,) Standard deviations
    lens_sigma_px: FloatArray  # (2,)
    wedge_sigma_px: FloatArray  # (2,)


def _rotation(angle_deg: float) -> FloatArray:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[c, -s], [s, c]])


def separate_wedge(
    shift_px: FloatArray,
    sigma_px: FloatArray,
    from_centre_px: FloatArray,
    filter_deg: FloatArray,
    reference_deg: FloatArray,
) -> ShiftParts:
    """Lens and wedge by weighted least squares of the module's equation; undetermined modes by the SVD.

    Standard deviations are widened where the misfit exceeds them.

    Shapes: ``shift_px``, ``sigma_px``, ``from_centre_px`` (p, j, 2), shifts of j points at p places, their standard
    deviations and positions from the principal point; ``filter_deg``, ``reference_deg`` (p,), angles of filter and
    reference filter to the camera.
    """
    places, points, _ = shift_px.shape
    design_matrix = np.zeros((places, 2, 6))
    for row, (turn, reference) in enumerate(zip(filter_deg, reference_deg, strict=True)):
        design_matrix[row] = np.hstack([np.eye(2), _rotation(turn), _rotation(turn) - _rotation(reference)])
    # the scale from the points of each place alone: a motion between the series of a place moves all of them
    middle = from_centre_px.mean(1)
    lever = (from_centre_px - middle[:, None]) / sigma_px
    power = max(float((lever**2).sum()), 1e-300)
    scale = float((lever * (shift_px - shift_px.mean(1, keepdims=True)) / sigma_px).sum()) / power
    scale_variance = 1.0 / power if points > 1 else 0.0
    variance = ((sigma_px**2).sum(1) / points**2).ravel()
    weight, rows = 1.0 / np.sqrt(variance), design_matrix.reshape(-1, 6)
    _, singular_values, modes = np.linalg.svd(rows * weight[:, None])
    rank = int((singular_values > DETERMINED * singular_values[0]).sum())
    undetermined = modes[rank:]
    pseudo_inverse = np.linalg.pinv(rows * weight[:, None], rcond=DETERMINED) * weight
    data = (shift_px.mean(1) - scale * middle).ravel()
    estimate = pseudo_inverse @ data
    residual, degrees = (data - rows @ estimate) * weight, len(data) - rank
    widening = max(float(residual @ residual) / degrees, 1.0) if degrees else 1.0
    noise = np.diag(variance) * widening + scale_variance * np.outer(middle, middle)
    covariance = pseudo_inverse @ noise @ pseudo_inverse.T

    def part(functional: FloatArray) -> tuple[FloatArray, FloatArray]:
        determined = np.linalg.norm(undetermined @ functional.T, axis=0) < np.sqrt(DETERMINED)
        sigma = np.sqrt(np.einsum("ik,kl,il->i", functional, covariance, functional))
        return np.where(determined, functional @ estimate, np.nan), np.where(determined, sigma, np.nan)

    constant, lens, wedge = (part(rows) for rows in (design_matrix.mean(0), np.eye(6)[:2], np.eye(6)[2:4]))
    return ShiftParts(
        constant_px=constant[0],
        lens_px=lens[0],
        wedge_px=wedge[0],
        constant_sigma_px=constant[1],
        lens_sigma_px=lens[1],
        wedge_sigma_px=wedge[1],
    )


def spot_radius_px(mean_e: FloatArray) -> float:
    """RMS radius of mean spots (j, h, h) within 0.3 of their windows' side, mean over the points [px].

    The background of a window is the median of its first and last row.
    """
    light = mean_e - np.median(mean_e[:, [0, -1]], axis=(1, 2))[:, None, None]
    size = light.shape[1]
    axis = np.arange(size) - (size - 1) / 2.0
    near = np.hypot(*np.meshgrid(axis, axis)) <= 0.3 * size
    light = np.where(near, np.maximum(light, 0.0), 0.0)
    total = light.sum((1, 2))
    x, y = (light.sum(k) @ axis / total for k in (1, 2))
    square = (light * np.add.outer(axis**2, axis**2)).sum((1, 2)) / total - x**2 - y**2
    return float(np.sqrt(np.maximum(square, 1e-6)).mean())


def exchanged_filters(light: FloatArray, radius_px: FloatArray) -> list[tuple[int, int, int]]:
    """Exchanged filters (place, filter, filter); several where the data do not tell them apart.

    Shapes: ``light`` (per second), ``radius_px`` (`spot_radius_px`) (p, b) of b filters at p places; a single place
    shows no exchange.
    """
    places, filters = light.shape
    if places < 2:
        return []
    features = np.stack([np.log(light) / LIGHT_FLOOR, np.log(radius_px) / WIDTH_FLOOR])

    def misfit(values: FloatArray) -> float:
        """Sum of squares of the interaction of place and filter."""
        interaction = (
            values - values.mean(1, keepdims=True) - values.mean(2, keepdims=True) + values.mean((1, 2), keepdims=True)
        )
        return float((interaction**2).sum())

    before, misfits = misfit(features), {}
    for at in range(places):
        for first, second in combinations(range(filters), 2):
            swapped = features.copy()
            swapped[:, at, [first, second]] = features[:, at, [second, first]]
            misfits[at, first, second] = misfit(swapped)
    least = min(misfits.values())
    if before - least < LEAST_GAIN or least > EXCHANGE_RATIO * before:
        return []
    return [exchange for exchange, value in misfits.items() if value <= least + 1e-9 * before]
