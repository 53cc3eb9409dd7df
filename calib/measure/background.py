"""Sky background and noise of an image from its own pixels: a mesh of sigma-clipped cells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import binary_dilation, median_filter
from scipy.special import erf

from calib.records import SensorImage
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze

__all__ = ["Background", "estimate_background"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Background:
    """Background and its noise on a mesh of cells, smooth in between."""

    level_e: FloatArray  # (a, b) Mean electrons per pixel and standard deviation of one pixel in each cell
    sigma_e: FloatArray  # (a, b)
    centre_x_px: FloatArray  # (b,) Columns of the cell centres
    centre_y_px: FloatArray  # (a,) Rows of the cell centres
    shape: tuple[int, int]  # Rows and columns of the image

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "level_e", shape=("a", "b"), sizes=sizes)
        freeze(self, "sigma_e", shape=("a", "b"), sizes=sizes)
        freeze(self, "centre_x_px", shape=("b",), sizes=sizes)
        freeze(self, "centre_y_px", shape=("a",), sizes=sizes)

    def _evaluate(self, mesh: FloatArray, x_px: NDArray[Any], y_px: NDArray[Any], grid: bool) -> FloatArray:
        centre_y, centre_x = self.centre_y_px, self.centre_x_px
        if len(centre_y) == 1:  # a spline needs two nodes; repeat a single cell
            centre_y, mesh = np.array([centre_y[0], centre_y[0] + 1.0]), np.repeat(mesh, 2, axis=0)
        if len(centre_x) == 1:
            centre_x, mesh = np.array([centre_x[0], centre_x[0] + 1.0]), np.repeat(mesh, 2, axis=1)
        spline = RectBivariateSpline(
            centre_y, centre_x, mesh, kx=min(3, len(centre_y) - 1), ky=min(3, len(centre_x) - 1)
        )
        y_inside = np.clip(y_px, centre_y[0], centre_y[-1])  # constant beyond the outermost centres
        x_inside = np.clip(x_px, centre_x[0], centre_x[-1])
        return np.asarray(spline(y_inside, x_inside, grid=grid))

    def level_at(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Background [e-] at columns ``x_px`` and rows ``y_px``, each (n,)."""
        return self._evaluate(self.level_e, np.asarray(x_px, float), np.asarray(y_px, float), grid=False)

    def sigma_at(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Noise of one pixel [e-] at columns ``x_px`` and rows ``y_px``, each (n,)."""
        return self._evaluate(self.sigma_e, np.asarray(x_px, float), np.asarray(y_px, float), grid=False)

    def level_image(self) -> FloatArray:
        """Background [e-] of every pixel, (h, w)."""
        return self._evaluate(self.level_e, np.arange(self.shape[1]), np.arange(self.shape[0]), grid=True)

    def sigma_image(self) -> FloatArray:
        """Noise [e-] of every pixel, (h, w)."""
        return self._evaluate(self.sigma_e, np.arange(self.shape[1]), np.arange(self.shape[0]), grid=True)


def estimate_background(
    image: SensorImage,
    *,
    box_px: int = 64,
    clip_sigma: float = 3.0,
    exclude: NDArray[np.bool_] | None = None,
    step_px: int = 1,
) -> Background:
    """Background level and noise of an image.

    In each cell the pixels are clipped at ``clip_sigma`` around the median until nothing changes; the standard
    deviation is corrected for the truncation of a normal distribution. The level is the mean of what is left (the
    expectation, which the likelihood needs, and not the median, which whole DN quantise) or, in a crowded cell,
    2.5 median - 1.5 mean (Bertin & Arnouts 1996, A&AS 117, 393, sec. 7.1). A second pass leaves out everything
    3 sigma above the first, grown by two pixels. Cells without usable pixels take the median of the others, and a
    3 x 3 median over the mesh removes cells filled by a bright object.

    Parameters
    ----------
    image : SensorImage
        The image.
    box_px : int
        Side of a cell, at least 8 px; made smaller than the image where needed.
    clip_sigma : float
        Clipping limit, at least 1.5.
    exclude : (h, w) bool, optional
        Pixels to leave out.
    step_px : int
        Use every ``step_px``-th pixel of every ``step_px``-th row only: faster by its square, noisier by itself. A
        cell needs at least 8 x 8 of them.

    Returns
    -------
    Background
        In electrons.

    Raises
    ------
    DomainError
        If no pixel is usable, or ``box_px``, ``clip_sigma`` or ``step_px`` is out of range.
    """
    if step_px < 1:
        raise DomainError(f"step_px = {step_px}; it must be at least 1")
    if box_px < 8 * step_px:
        raise DomainError(
            f"box_px = {box_px} px; a background cell needs at least 8 px"
            + (f" in steps of step_px = {step_px}, so {8 * step_px} px" if step_px > 1 else "")
        )
    if step_px > 1:
        return _thinned(image, box_px, clip_sigma, exclude, step_px)
    if not clip_sigma >= 1.5:
        raise DomainError(f"clip_sigma = {clip_sigma}; it must be at least 1.5")
    usable = image.valid & ~image.saturated
    if exclude is not None:
        if np.shape(exclude) != usable.shape:
            raise DomainError(f"exclude has shape {np.shape(exclude)} where {usable.shape} is needed")
        usable &= ~np.asarray(exclude, dtype=bool)
    if not usable.any():
        raise DomainError(f"image {image.source!r} has no usable pixel (all NaN, saturated, defective or excluded)")
    electrons = image.noise.to_electrons(image.dn)
    quantum = 1.0 / image.noise.gain_dn_per_e if image.noise.quantised else 0.0
    first = _mesh(electrons, usable, box_px, clip_sigma, quantum)
    stars = electrons > first.level_image() + 3.0 * first.sigma_image()
    rest = usable & ~binary_dilation(stars & _has_bright_neighbour(stars), np.ones((5, 5), bool))
    return _mesh(electrons, rest, box_px, clip_sigma, quantum) if rest.any() else first


def _thinned(
    image: SensorImage, box_px: int, clip_sigma: float, exclude: NDArray[np.bool_] | None, step_px: int
) -> Background:
    """The background from every ``step_px``-th pixel in either direction, on the coordinates of the whole image."""
    every = (slice(None, None, step_px), slice(None, None, step_px))
    some = replace(image, dn=image.dn[every], valid=image.valid[every], saturated=image.saturated[every])
    left_out = None if exclude is None else np.asarray(exclude, dtype=bool)[every]
    found = estimate_background(some, box_px=box_px // step_px, clip_sigma=clip_sigma, exclude=left_out)
    return replace(
        found,
        centre_x_px=found.centre_x_px * step_px,
        centre_y_px=found.centre_y_px * step_px,
        shape=(image.dn.shape[0], image.dn.shape[1]),
    )


def _has_bright_neighbour(bright: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Bright pixels next to another one; lone noise peaks stay in, or the noise would be underestimated."""
    ring = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=bool)
    return np.asarray(binary_dilation(bright, ring))


def _mesh(
    electrons: FloatArray, usable: NDArray[np.bool_], box_px: int, clip_sigma: float, quantum: float
) -> Background:
    height, width = electrons.shape
    rows, columns = max(1, height // box_px), max(1, width // box_px)
    step_y, step_x = -(-height // rows), -(-width // columns)
    rows, columns = -(-height // step_y), -(-width // step_x)
    padded = np.full((rows * step_y, columns * step_x), np.nan)
    padded[:height, :width] = np.where(usable, electrons, np.nan)
    cells = padded.reshape(rows, step_y, columns, step_x).swapaxes(1, 2).reshape(rows * columns, -1)
    level, sigma = _clipped_statistics(cells, clip_sigma, quantum)
    level, sigma = level.reshape(rows, columns), sigma.reshape(rows, columns)
    empty = ~np.isfinite(level)
    if empty.any():
        level[empty], sigma[empty] = np.nanmedian(level), np.nanmedian(sigma)
    if min(rows, columns) >= 3:
        smooth, sigma = median_filter(level, 3), median_filter(sigma, 3)
        # at the border the median of a slope is off by a cell; there only outliers are replaced
        replace = np.abs(level - smooth) > sigma
        replace[1:-1, 1:-1] = True
        level = np.where(replace, smooth, level)
    centre_y = [0.5 * (i * step_y + min((i + 1) * step_y, height) - 1) for i in range(rows)]
    centre_x = [0.5 * (i * step_x + min((i + 1) * step_x, width) - 1) for i in range(columns)]
    return Background(
        level_e=level,
        sigma_e=sigma,
        centre_x_px=np.array(centre_x),
        centre_y_px=np.array(centre_y),
        shape=(height, width),
    )


def _clipped_statistics(cells: FloatArray, clip_sigma: float, quantum: float) -> tuple[FloatArray, FloatArray]:
    """Sigma-clipped level and standard deviation of each row of ``cells`` (k, m); NaN marks pixels to leave out.

    The rows are sorted once; clipping then only moves two indices, and prefix sums give the moments.
    """
    ordered = np.sort(cells, axis=1)  # NaN sorts to the end
    count = np.isfinite(ordered).sum(axis=1)
    zero = ordered[:, :1].copy()
    k = np.arange(len(ordered))
    zero[:, 0] = ordered[k, np.maximum(count - 1, 0) // 2]  # moments about the median keep their digits
    shifted = np.nan_to_num(ordered - zero)
    sums = np.pad(np.cumsum(shifted, axis=1), ((0, 0), (1, 0)))
    squares = np.pad(np.cumsum(shifted**2, axis=1), ((0, 0), (1, 0)))
    # variance of a normal distribution cut at +- clip_sigma
    density = np.exp(-0.5 * clip_sigma**2) / np.sqrt(2.0 * np.pi)
    shrink = 1.0 - 2.0 * clip_sigma * density / erf(clip_sigma / np.sqrt(2.0))
    low, high = np.zeros(len(ordered), np.int64), count.copy()
    filled = np.where(np.isfinite(ordered), ordered - zero, np.inf)
    for step in range(20):
        median, mean, sigma = _range_moments(shifted, sums, squares, low, high)
        spread = sigma / np.sqrt(shrink) if step else np.maximum(1.4826 * _range_mad(shifted, low, high), 1e-9)
        new_low = (filled < (median - clip_sigma * spread)[:, None]).sum(axis=1)
        new_high = np.maximum((filled <= (median + clip_sigma * spread)[:, None]).sum(axis=1), new_low + 1)
        new_high = np.minimum(new_high, count)
        if np.array_equal(new_low, low) and np.array_equal(new_high, high):
            break
        low, high = new_low, new_high
    median, mean, sigma = _range_moments(shifted, sums, squares, low, high)
    sigma = sigma / np.sqrt(shrink)
    if quantum > 0:  # median of grouped data: interpolated within the group of equal numbers
        below = (filled < (median - 0.25 * quantum)[:, None]).sum(axis=1) - low
        same = (filled <= (median + 0.25 * quantum)[:, None]).sum(axis=1) - low - below
        median = median + quantum * ((0.5 * (high - low) - below) / np.maximum(same, 1) - 0.5)
    crowded = mean - median > 0.1 * sigma
    level = np.where(crowded, 2.5 * median - 1.5 * mean, mean) + zero[:, 0]
    some = count > 0
    return np.where(some, level, np.nan), np.where(some, sigma, np.nan)


def _range_moments(
    shifted: FloatArray, sums: FloatArray, squares: FloatArray, low: NDArray[Any], high: NDArray[Any]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    k = np.arange(len(shifted))
    number = np.maximum(high - low, 1)
    last = shifted.shape[1] - 1
    middle = np.minimum((low + np.maximum(high - 1, low)) // 2, last)
    upper = np.minimum((low + np.maximum(high, low + 1)) // 2, last)
    median = 0.5 * (shifted[k, middle] + shifted[k, upper])
    mean = (sums[k, high] - sums[k, low]) / number
    variance = (squares[k, high] - squares[k, low]) / number - mean**2
    return median, mean, np.sqrt(np.maximum(variance, 0.0))


def _range_mad(shifted: FloatArray, low: NDArray[Any], high: NDArray[Any]) -> FloatArray:
    """Half the interquartile range: the median absolute deviation of a symmetric distribution."""
    k = np.arange(len(shifted))
    number = high - low
    last = np.maximum(high - 1, 0)
    lower = shifted[k, np.minimum(low + number // 4, last)]
    upper = shifted[k, np.minimum(low + (3 * number) // 4, last)]
    return 0.5 * (upper - lower)
