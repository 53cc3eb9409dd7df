"""Pixel-phase error of a centroid (its S-curve), which noise models do not contain.

Whole pixels sample a narrow star too coarsely for moments, and a window that truncates a wide star cuts off more on one
side; both depend on the phase of the pixel grid. For a star of given width the error is fixed; over many stars, or a
star that drifts over many pixels, it is a scatter in addition to the noise. Its size is computed once per centroider
and window, by measuring noiseless pixel-integrated Gaussians of many widths at many phases; the width of a real star is
determined from its second moment, measured in the same way.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from calib.flags import StarFlag
from calib.measure.centroiding.gaussian import draw_gaussian
from calib.measure.stamps import noiseless_stamps
from calib.records import NoiseModel, Stamps, StarTable, X, Y
from optics.arrays import FloatArray

SIGMA_PX = np.concatenate([np.arange(0.2, 1.0, 0.02), np.arange(1.0, 3.05, 0.1)])
PHASES = 6  # along columns and along rows; the error repeats with the pixel
TOLD_PART = 0.5
"""Part of the stated sigma above which the error is flagged: the true one is then more than an eighth larger."""


class MomentCentroider(Protocol):
    """A centroider whose error depends on the pixel phase; a frozen dataclass."""

    def measure_by(self, stamps: Stamps, noise: NoiseModel, known: PhaseTable | None) -> StarTable:
        """The stars with width and error by pixel phase from a table; without one, ``width_px`` is the root of the
        second moment itself, as the centroider measures it."""
        ...

    def __hash__(self) -> int: ...


class PhaseTable(NamedTuple):
    """By second moment (k,) [px^2] as a centroider measures it: width of the star, RMS error per axis (k,) [px]."""

    moment_px2: FloatArray
    sigma_px: FloatArray
    error_px: FloatArray


@lru_cache(maxsize=64)
def phase_table(centroider: MomentCentroider, shape: tuple[int, int]) -> PhaseTable:
    """Centroids of noiseless Gaussian stars by a centroider, in windows of ``shape`` = (h, w)."""
    phase = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    x, y = (offset.ravel() for offset in np.meshgrid(phase, phase))
    place = np.column_stack([x + shape[1] // 2, y + shape[0] // 2])
    count = len(place)
    moment, variance = np.empty((len(SIGMA_PX), count)), np.empty((len(SIGMA_PX), count))
    for k, sigma in enumerate(SIGMA_PX):
        light = 1e6 * draw_gaussian(place[:, 0], place[:, 1], float(sigma), shape)
        stars = noiseless_stamps(light, start_px=place)
        table = centroider.measure_by(stars, NoiseModel(read_noise_e=1e-3), None)
        moment[k] = table.width_px**2
        variance[k] = np.mean((table.pixel_px - place) ** 2, axis=1)
    # the moment depends on the phase too: what a star shows is the mean over all widths and phases that show as much
    known = np.isfinite(moment) & np.isfinite(variance)
    order = np.argsort(moment[known], kind="stable")
    width = np.repeat(SIGMA_PX, count).reshape(moment.shape)
    each = (moment, width, variance)
    mean = [uniform_filter1d(values[known][order], count, mode="nearest")[:: count // 4] for values in each]
    return PhaseTable(mean[0], mean[1], np.sqrt(np.maximum(mean[2], 0.0)))


def measure_with_phase(centroider: MomentCentroider, stamps: Stamps, noise: NoiseModel) -> StarTable:
    """Measured stars with their width, the error by pixel phase, and the flag where it matters against the noise."""
    if not len(stamps):
        return StarTable.empty()
    known = phase_table(centroider, (stamps.electrons.shape[1], stamps.electrons.shape[2]))
    return centroider.measure_by(stamps, noise, known)


def phase_columns(
    moment_px2: FloatArray | None, covariance: FloatArray, flags: NDArray[np.uint32], known: PhaseTable | None
) -> dict[str, Any]:
    """Columns ``width_px``, ``phase_error_px`` and ``flags`` (n,) of stars of second moments (n,) [px^2]."""
    if moment_px2 is None:
        return {"flags": flags}
    if known is None:
        return {"width_px": np.sqrt(np.maximum(moment_px2, 0.0)), "flags": flags}
    error = np.interp(moment_px2, known.moment_px2, known.error_px)  # NaN stays NaN
    variance = 0.5 * (covariance[:, X, X] + covariance[:, Y, Y])
    told = error**2 > TOLD_PART**2 * variance
    return {
        "width_px": np.interp(moment_px2, known.moment_px2, known.sigma_px),
        "phase_error_px": error,
        "flags": np.where(told, flags | np.uint32(int(StarFlag.PIXEL_PHASE)), flags),
    }
