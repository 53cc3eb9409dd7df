"""Pixel-phase error of a centroid (its S-curve), which noise models do not contain.

Pixels sample a narrow star too coarsely for moments, and a window that truncates a wide star cuts off more on one side;
both depend on the phase of the pixel grid. For a star of given width the error is fixed; over many stars, or a star
that drifts over many pixels, it is a scatter in addition to the noise. Its size is computed once per centroider and
window on noiseless pixel-integrated Gaussians of many widths and phases; the width of a real star follows from its
second moment, measured in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from calib.flags import StarFlag
from calib.measure.centroiding.gaussian import draw_gaussian
from calib.measure.centroiding.options import check_options
from calib.measure.stamps import noiseless_stamps
from calib.records import NoiseModel, Stamps, StarTable, X, Y
from optics.arrays import FloatArray

SIGMA_PX = np.concatenate([np.arange(0.2, 1.0, 0.02), np.arange(1.0, 3.05, 0.1)])
PHASES = 6  # along columns and along rows; the error repeats with the pixel
FLAGGED_FRACTION = 0.5
"""Fraction of the stated sigma above which the error is flagged: the true sigma is then more than an eighth larger."""


class PhaseTable(NamedTuple):
    """By second moment (k,) [px^2] as a centroider measures it: width of the star, RMS error per axis (k,) [px]."""

    moment_px2: FloatArray
    sigma_px: FloatArray
    error_px: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class MomentCentroider:
    """A centroider without a PSF, whose error depends on the pixel phase."""

    def __post_init__(self) -> None:
        check_options(self)

    def measure(self, stamps: Stamps, noise: NoiseModel) -> StarTable:
        """Stars with flux of the window, width, error by pixel phase, and a flag where it exceeds the noise."""
        return self.measure_by(stamps, noise, phase_table(self, stamps.window)) if len(stamps) else StarTable.empty()

    def measure_by(self, stamps: Stamps, noise: NoiseModel, table: PhaseTable | None) -> StarTable:
        """The stars with width and error by pixel phase from a table; without one, ``width_px`` is the root of the
        second moment that the centroider measures."""
        raise NotImplementedError


@lru_cache(maxsize=64)
def phase_table(centroider: MomentCentroider, shape: tuple[int, int]) -> PhaseTable:
    """Centroids of noiseless Gaussian stars by a centroider, in windows of ``shape`` = (h, w)."""
    phase = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    x, y = (offset.ravel() for offset in np.meshgrid(phase, phase))
    position_px = np.column_stack([x + shape[1] // 2, y + shape[0] // 2])
    count = len(position_px)
    moment, variance = np.empty((len(SIGMA_PX), count)), np.empty((len(SIGMA_PX), count))
    for k, sigma in enumerate(SIGMA_PX):
        light = 1e6 * draw_gaussian(position_px[:, 0], position_px[:, 1], float(sigma), shape)
        stars = noiseless_stamps(light, start_px=position_px)
        measured = centroider.measure_by(stars, NoiseModel(read_noise_e=1e-3), None)
        moment[k] = measured.width_px**2
        variance[k] = np.mean((measured.pixel_px - position_px) ** 2, axis=1)
    # the moment depends on the phase too: mean over all widths and phases of similar moment
    finite = np.isfinite(moment) & np.isfinite(variance)
    order = np.argsort(moment[finite], kind="stable")
    width = np.repeat(SIGMA_PX, count).reshape(moment.shape)
    mean = [
        uniform_filter1d(values[finite][order], count, mode="nearest")[:: count // 4]
        for values in (moment, width, variance)
    ]
    return PhaseTable(mean[0], mean[1], np.sqrt(np.maximum(mean[2], 0.0)))


def phase_columns(
    moment_px2: FloatArray | None, covariance: FloatArray, flags: NDArray[np.uint32], table: PhaseTable | None
) -> dict[str, Any]:
    """Columns ``width_px``, ``phase_error_px`` and ``flags`` (n,) of stars of second moments (n,) [px^2]."""
    if moment_px2 is None:
        return {"flags": flags}
    if table is None:
        return {"width_px": np.sqrt(np.maximum(moment_px2, 0.0)), "flags": flags}
    error = np.interp(moment_px2, table.moment_px2, table.error_px)  # NaN stays NaN
    variance = 0.5 * (covariance[:, X, X] + covariance[:, Y, Y])
    flagged = error**2 > FLAGGED_FRACTION**2 * variance
    return {
        "width_px": np.interp(moment_px2, table.moment_px2, table.sigma_px),
        "phase_error_px": error,
        "flags": np.where(flagged, flags | np.uint32(int(StarFlag.PIXEL_PHASE)), flags),
    }
