"""Sums for moment centroids: light above the background, its moments, their noise.

No PSF is needed; the price is noise of the whole window, or a bias that depends on the star's position in its pixel
(S-curve). The covariance propagates the temporal noise, sum over pixels of (dx/dd)^2 variance(d); the bias is separate
(`calib.measure.centroid_error.s_curve`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.flags import StarFlag, has_flag
from calib.measure.centroid_error.s_curve import PhaseTable, phase_columns
from calib.records import FLUX, NoiseModel, Stamps, StarTable, X, Y
from optics.arrays import FloatArray

FWHM_PER_SIGMA = 2.354820045
"""Full width at half maximum of a Gaussian over its standard deviation, 2 sqrt(2 ln 2)."""


class Moments(NamedTuple):
    """Sums of values times powers of offsets, each (n,): ``xy`` is the sum of value * x * y."""

    total: FloatArray
    x: FloatArray
    y: FloatArray
    xx: FloatArray
    xy: FloatArray
    yy: FloatArray

    @classmethod
    def of(cls, values: FloatArray, rows: FloatArray, columns: FloatArray) -> Moments:
        """Moments of ``values`` (n, h, w), given `powers` of the offsets of rows (n, 3, h) and columns (n, 3, w)."""
        sums = rows @ values @ columns.swapaxes(1, 2)  # [n, power of y, power of x]
        return cls(*(sums[:, y, x] for y, x in ((0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0))))


TIE_PX2 = 1e-9
"""Squares of distances that differ by less are equal."""


def powers(offset: FloatArray) -> FloatArray:
    """Powers 0, 1 and 2 of offsets (n, m) as (n, 3, m)."""
    return np.stack([np.ones_like(offset), offset, offset**2], axis=1)


def light_above_background(stamps: Stamps, half_width_px: int | None) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Light above the background and the used pixels, (n, h, w); both zero outside the sub-window."""
    used = stamps.valid
    if half_width_px is not None:
        centre = np.rint(stamps.start_px - stamps.corner_px)
        near_x = np.abs(np.arange(used.shape[2]) - centre[:, 0, None]) <= half_width_px
        near_y = np.abs(np.arange(used.shape[1]) - centre[:, 1, None]) <= half_width_px
        used = used & near_y[:, :, None] & near_x[:, None, :]
    return np.where(used, stamps.electrons - stamps.background_e[:, None, None], 0.0), used


def pixel_variance(stamps: Stamps, noise: NoiseModel, used: NDArray[np.bool_]) -> FloatArray:
    """Variance [e-^2] of the used pixels (n, h, w) from their own signal, 0 for the others.

    Signal + floor is unbiased for each pixel; clipping single pixels at zero would raise the sum.
    """
    return np.where(used, stamps.electrons + noise.floor_e2, 0.0)


def half_light_radius(light: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Radius [px] around (x, y) that holds half the light of each stamp (n, h, w), from the growth curve."""
    n, height, width = light.shape
    radius2 = (np.arange(width) - x[:, None])[:, None, :] ** 2 + (np.arange(height) - y[:, None])[:, :, None] ** 2
    order = np.argsort(radius2.reshape(n, height * width), axis=1)
    sorted2 = np.take_along_axis(radius2.reshape(n, height * width), order, axis=1)
    growth = np.cumsum(np.take_along_axis(light.reshape(n, height * width), order, axis=1), axis=1)
    growth = _even_among_equals(growth, sorted2)
    half = 0.5 * growth[:, -1:]
    first = np.argmax(growth >= half, axis=1)
    # k pixels cover the area pi r^2 = k; between two pixels the growth is taken as linear in area
    k = np.arange(n)
    before = np.where(first > 0, growth[k, np.maximum(first - 1, 0)], 0.0)
    rise = growth[k, first] - before
    fraction = np.divide(half[:, 0] - before, rise, out=np.ones(n), where=rise > 0)
    return np.sqrt((first + np.clip(fraction, 0.0, 1.0)) / np.pi)


def _even_among_equals(growth: FloatArray, radius2: FloatArray) -> FloatArray:
    """Growth curves (n, k) that rise evenly over pixels of equal radius, in any order of sorting."""
    count = radius2.shape[1]
    step = np.diff(radius2, axis=1) > TIE_PX2
    rank = np.broadcast_to(np.arange(count), radius2.shape)
    edge = np.ones((len(radius2), 1), dtype=bool)
    first = np.maximum.accumulate(np.where(np.hstack([edge, step]), rank, 0), axis=1)
    last = np.where(np.hstack([step, edge]), rank, count - 1)[:, ::-1]
    last = np.minimum.accumulate(last, axis=1)[:, ::-1]
    below = np.take_along_axis(np.hstack([np.zeros((len(growth), 1)), growth]), first, axis=1)
    top = np.take_along_axis(growth, last, axis=1)
    return below + (top - below) * (rank - first + 1) / (last - first + 1)


def gravity_table(
    stamps: Stamps,
    noise: NoiseModel,
    table: PhaseTable | None,
    *,
    weight: FloatArray,
    light: FloatArray,
    used: NDArray[np.bool_],
) -> StarTable:
    """Centre of gravity of ``weight`` and sum of ``light``, both (n, h, w), over the ``used`` pixels.

    The width follows from the second moment of the weight, mean of both axes.
    """
    _, height, width = weight.shape
    columns, rows = np.arange(width, dtype=float), np.arange(height, dtype=float)
    total = weight.sum(axis=(1, 2))
    lost = ~(total > 0)
    divisor = np.where(lost, 1.0, total)
    across, down = weight.sum(axis=1), weight.sum(axis=2)
    x = across @ columns / divisor
    y = down @ rows / divisor
    variance = pixel_variance(stamps, noise, used)
    along_y, along_x = powers(rows - y[:, None]), powers(columns - x[:, None])
    second = Moments.of(variance * (weight != 0), along_y, along_x)
    spread = (across[:, None, :] @ along_x[:, 2, :, None] + down[:, None, :] @ along_y[:, 2, :, None])[:, 0, 0]
    covariance = np.empty((len(x), 3, 3))
    covariance[:, X, X] = second.xx / divisor**2
    covariance[:, Y, Y] = second.yy / divisor**2
    covariance[:, X, Y] = covariance[:, Y, X] = second.xy / divisor**2
    covariance[:, X, FLUX] = covariance[:, FLUX, X] = second.x / divisor
    covariance[:, Y, FLUX] = covariance[:, FLUX, Y] = second.y / divisor
    covariance[:, FLUX, FLUX] = variance.sum(axis=(1, 2))
    flags = np.array(stamps.flags)
    outside = (np.abs(x - (width - 1) / 2) > width / 2) | (np.abs(y - (height - 1) / 2) > height / 2)
    flags[outside & ~lost] |= int(StarFlag.NOT_CONVERGED)
    return measured_table(
        stamps,
        x=x,
        y=y,
        light=light,
        covariance=covariance,
        iterations=np.ones(len(x), np.int64),
        flags=flags,
        lost=lost,
        moment_px2=np.where(lost, np.nan, 0.5 * spread / divisor),
        table=table,
    )


def measured_table(
    stamps: Stamps,
    *,
    x: FloatArray,
    y: FloatArray,
    light: FloatArray,
    covariance: FloatArray,
    iterations: NDArray[np.int64],
    flags: NDArray[np.uint32],
    lost: NDArray[np.bool_],
    moment_px2: FloatArray | None = None,
    table: PhaseTable | None = None,
) -> StarTable:
    """Result of a centroider without a PSF model, as a `StarTable`.

    Shapes: ``x`` (n,), ``y`` (n,), ``light`` (n, h, w), ``covariance`` (n, 3, 3), ``iterations`` (n,), ``flags``
    (n,), ``lost`` (n,), ``moment_px2`` (n,).
    """
    flags = np.where(lost, flags | np.uint32(int(StarFlag.NO_DATA)), flags)
    lost = has_flag(flags, StarFlag.NO_DATA)
    diagonal = np.diagonal(covariance, axis1=1, axis2=2)
    covariance = np.where((lost | ~np.all(diagonal > 0, axis=1))[:, None, None], np.nan, covariance)
    return StarTable(
        x_px=np.where(lost, np.nan, x + stamps.corner_px[:, 0]),
        y_px=np.where(lost, np.nan, y + stamps.corner_px[:, 1]),
        flux_e=np.where(lost, np.nan, light.sum(axis=(1, 2))),
        background_e=stamps.background_e,
        covariance=covariance,
        iterations=iterations,
        **phase_columns(moment_px2, covariance, flags, table),
    )


def centre_of_light(electrons: FloatArray) -> FloatArray:
    """First moments (n, 2) of windows (n, h, w) above their border; (column, row) in the window."""
    border = np.concatenate([electrons[:, 0], electrons[:, -1], electrons[:, 1:-1, 0], electrons[:, 1:-1, -1]], axis=1)
    light = electrons - border.mean(axis=1)[:, None, None]
    total = light.sum((1, 2))
    column, row = np.arange(light.shape[2]), np.arange(light.shape[1])
    return np.column_stack([(light.sum(1) * column).sum(1), (light.sum(2) * row).sum(1)]) / total[:, None]


def disk_centre_variance_px2(
    level_e: ArrayLike,
    radius_px: float,
    window_px: int,
    *,
    frames: int,
    floor_e2: float,
    offset_e: float,
    column_e: float,
    prnu: float,
) -> FloatArray:
    """Variance (n,) per axis of `centre_of_light` for a disk of ``level_e`` (n,) electrons per pixel, in closed form.

    The centre moves by ``(x - x_c) / F`` times the noise of a pixel, F the disk's electrons; the window's border is
    subtracted. ``frames`` are averaged; ``floor_e2``: temporal variance of a dark pixel; ``offset_e``, ``column_e``:
    standard deviations of the fixed pattern of pixels and of columns.
    """
    level = np.asarray(level_e, float)
    light = level * np.pi * radius_px**2
    x2 = ((np.arange(window_px) - (window_px - 1) / 2) ** 2).sum()
    of_disk, of_window = np.pi * radius_px**4 / 4, window_px * x2  # integrals of x^2
    border = window_px**2 * np.sqrt(1.0 / 12.0)  # a wrong border moves it to the window's middle, some 0.3 px off
    fixed2 = offset_e**2 + floor_e2 / frames
    variance = (level / frames + (prnu * level) ** 2) * of_disk + fixed2 * of_window
    variance += column_e**2 * window_px**2 * x2 / 2  # columns move x alone, half of it per axis
    variance += border**2 * fixed2 / (4 * window_px - 4)
    return np.asarray(variance / light**2)
