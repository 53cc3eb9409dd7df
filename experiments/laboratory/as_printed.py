"""ACC18's equations written down a second time, from the paper, sum by sum: what the reductions are held against.

Nothing here is used to reduce a measurement, and nothing of the reductions is used here: plain loops over the centroids
of frames, as an engineer would check a report with a sheet of paper. A criterion compares the two numbers.
"""

from __future__ import annotations

import math

from optics.arrays import FloatArray

__all__ = ["high_frequency_arcsec", "temporal_arcsec"]


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
