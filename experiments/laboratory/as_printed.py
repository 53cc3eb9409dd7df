"""ACC18's equations written down a second time, from the paper, sum by sum: what the reductions are held against.

Nothing here is used to reduce a measurement, and nothing of the reductions is used here: plain loops over the centroids
of frames, as an engineer would check a report with a sheet of paper. A criterion compares the two numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from optics.arrays import FloatArray

__all__ = ["distortion_arcsec", "high_frequency_arcsec", "temporal_arcsec"]


def temporal_arcsec(position_px: FloatArray, pixel_arcsec: float) -> tuple[float, float]:
    """TE(3 sigma) of eq. 1-2, x and y: the mean over the stars of their standard deviations, as an angle."""
    stars = position_px.shape[1]
    found = []
    for axis in (0, 1):
        total = 0.0
        for star in range(stars):
            seen = [float(v) for v in position_px[:, star, axis] if math.isfinite(v)]
            mean = math.fsum(seen) / len(seen)
            total += math.sqrt(math.fsum((v - mean) ** 2 for v in seen) / (len(seen) - 1))
        found.append(3.0 * total / stars * pixel_arcsec)
    return found[0], found[1]


def high_frequency_arcsec(mean_px: FloatArray, pixel_arcsec: float) -> tuple[float, float]:
    """HSFE(3 sigma) of eq. 3-12, x and y."""
    positions, stars = mean_px.shape[:2]
    found = []
    for axis in (0, 1):
        square = 0.0
        for k in range(1, positions):
            moved = [float(mean_px[k, j, axis] - mean_px[k - 1, j, axis]) for j in range(stars)]
            platform = math.fsum(moved) / stars
            square += math.fsum((v - platform) ** 2 for v in moved)
        found.append(3.0 * math.sqrt(square / (stars * (positions - 1))) * pixel_arcsec)
    return found[0], found[1]


def distortion_arcsec(
    centroid_px: FloatArray, coordinate_px: FloatArray, order: int, pixel_arcsec: float
) -> list[tuple[float, float]]:
    """sigma_d, sigma_Dd and sigma_C1 (3 sigma) of eq. 19-30, each x and y.

    The polynomial is taken away monomial by monomial (Gram and Schmidt, twice for the digits).
    """
    points = len(centroid_px)
    reach = max(abs(float(v)) for v in coordinate_px.ravel())
    place = [(float(x) / reach, float(y) / reach) for x, y in coordinate_px]
    basis: list[list[float]] = []
    for degree in range(order + 1):
        for power in range(degree + 1):
            column = _without([x ** (degree - power) * y**power for x, y in place], basis)
            length = math.sqrt(math.fsum(v * v for v in column))
            basis.append([v / length for v in column])
    numbers: list[list[float]] = [[], [], []]
    for axis in (0, 1):
        d = [float(seen[axis] - stated[axis]) for seen, stated in zip(centroid_px, coordinate_px, strict=True)]
        found, left = (_variance(values, points) for values in (d, _without(d, basis)))
        for number, square in zip(numbers, (found, left, found - left), strict=True):
            number.append(3.0 * math.sqrt(max(square, 0.0)) * pixel_arcsec)
    return [(x, y) for x, y in numbers]


def _without(values: list[float], basis: Sequence[list[float]]) -> list[float]:
    """Values less their part along each of a set of orthonormal columns."""
    for _ in range(2):
        for column in basis:
            part = math.fsum(v * c for v, c in zip(values, column, strict=True))
            values = [v - part * c for v, c in zip(values, column, strict=True)]
    return values


def _variance(values: list[float], count: int) -> float:
    """Mean square about the mean, divisor W - 1."""
    mean = math.fsum(values) / count
    return math.fsum((v - mean) ** 2 for v in values) / (count - 1)
