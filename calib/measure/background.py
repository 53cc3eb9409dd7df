"""Sky background and noise of an image from its own pixels: a mesh of sigma-clipped cells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import median_filter
from scipy.special import erf, ndtri

from calib.records import SensorImage
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze_all

_FIRST_STEP, _FIRST_BOX = 2, 32
"""Cell size [px] of the first pass, which only finds stars, in every second pixel of every second row."""

_SORTED_PIXELS = 2**17
"""Pixels that are sorted at a time."""

SLOPE_FRACTION = 0.15
"""Smallest variation of the level within a cell that is subtracted, as a fraction of its noise."""


OVERSHOOT = 0.1
"""Part of the difference of neighbouring cells by which the level between them may exceed both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Background:
    """Background and its noise on a mesh of cells, smooth in between."""

    level_e: FloatArray  # (a, b) Mean electrons per pixel and standard deviation of one pixel in each cell
    sigma_e: FloatArray  # (a, b)
    centre_x_px: FloatArray  # (b,) Columns of the cell centres
    centre_y_px: FloatArray  # (a,) Rows of the cell centres
    shape: tuple[int, int]  # Rows and columns of the image

    def __post_init__(self) -> None:
        freeze_all(self, level_e=("a", "b"), sigma_e=("a", "b"), centre_x_px=("b",), centre_y_px=("a",))

    def _at(self, mesh: FloatArray, x_px: NDArray[Any], y_px: NDArray[Any]) -> FloatArray:
        """Values (n,) of a mesh: a cubic spline between the cells, straight beyond the outermost centres."""
        values = np.sum((_weights(self.centre_y_px, y_px) @ mesh) * _weights(self.centre_x_px, x_px), axis=1)
        low, high = _bounds(mesh)
        at = (_interval(self.centre_y_px, y_px), _interval(self.centre_x_px, x_px))
        return np.clip(values, low[at], high[at])

    def _image(self, mesh: FloatArray) -> FloatArray:
        row, column = (np.arange(size) for size in self.shape)
        values = _weights(self.centre_y_px, row) @ mesh @ _weights(self.centre_x_px, column).T
        low, high = _bounds(mesh)
        at = np.ix_(_interval(self.centre_y_px, row), _interval(self.centre_x_px, column))
        return np.clip(values, low[at], high[at], out=values)

    def level_at(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Background [e-] at columns ``x_px`` and rows ``y_px``, each (n,)."""
        return self._at(self.level_e, x_px, y_px)

    def sigma_at(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Noise of one pixel [e-] at columns ``x_px`` and rows ``y_px``, each (n,)."""
        return self._at(self.sigma_e, x_px, y_px)

    def level_image(self) -> FloatArray:
        """Background [e-] of every pixel, (h, w)."""
        return self._image(self.level_e)

    def sigma_image(self) -> FloatArray:
        """Noise [e-] of every pixel, (h, w)."""
        return self._image(self.sigma_e)


def _weights(centre: FloatArray, position: ArrayLike) -> FloatArray:
    """Weights (n, a) of a cells in an interpolating spline at positions (n,)."""
    if len(centre) == 1:
        return np.ones((np.size(position), 1))
    spline = make_interp_spline(centre, np.eye(len(centre)), k=min(3, len(centre) - 1))
    position = np.asarray(position, float)
    weights = spline(np.clip(position, centre[0], centre[-1]))
    for end, inner, beyond in ((0, 1, position < centre[0]), (-1, -2, position > centre[-1])):
        slope = (position[beyond] - centre[end]) / (centre[end] - centre[inner])
        weights[beyond, end] += slope
        weights[beyond, inner] -= slope
    return np.asarray(weights)


def _continued(mesh: FloatArray) -> FloatArray:
    """A mesh (a, b) with another cell on every side (a + 2, b + 2), by point reflection; a single row is repeated."""
    for axis in (0, 1):
        width = [(0, 0), (0, 0)]
        width[axis] = (1, 1)
        if mesh.shape[axis] > 1:
            mesh = np.pad(mesh, width, mode="reflect", reflect_type="odd")
        else:
            mesh = np.pad(mesh, width, mode="edge")
    return mesh


def _interval(centre: FloatArray, position: ArrayLike) -> NDArray[np.int64]:
    """Intervals between cell centres that positions lie in: 0 before the first centre, a after the last of a."""
    return np.asarray(np.searchsorted(centre, np.asarray(position, float)), np.int64)


def _bounds(mesh: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest value (a + 1, b + 1) in each interval: of the cells around it, with a margin of `OVERSHOOT` of
    their difference, so that the spline does not oscillate beside a limb; free beyond the outermost centres."""
    corners = sliding_window_view(_continued(mesh), (2, 2))
    low, high = corners.min(axis=(2, 3)), corners.max(axis=(2, 3))
    margin = OVERSHOOT * (high - low)
    return low - margin, high + margin


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
    deviation is corrected for the truncation of a normal distribution. The level is the mean of the remaining pixels
    (the expectation that the likelihood needs; whole DN quantise a median) or, in a crowded cell, 2.5 median - 1.5 mean
    (Bertin & Arnouts 1996, A&AS 117, 393, sec. 7.1). A second pass leaves out everything 3 sigma above the first, grown
    by two pixels. Cells without usable pixels take the median of the others, and a 3 x 3 median over the mesh removes
    cells filled by a bright object. Where the level varies within cells, level and noise are those of the image without
    the level of the first mesh.

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
    every = (slice(None, None, _FIRST_STEP), slice(None, None, _FIRST_STEP)) if box_px >= _FIRST_BOX else ()
    coarse = _mesh(electrons[every], usable[every], box_px // _FIRST_STEP if every else box_px, clip_sigma, quantum)
    first = _on_full_image(coarse, _FIRST_STEP, electrons.shape) if every else coarse
    bright = electrons > first._image(first.level_e + 3.0 * first.sigma_e)
    # bright pixels next to another one; isolated noise peaks remain, or the noise would be underestimated
    sky = usable & ~grown(bright & _with_bright_neighbour(bright), 2)
    if not sky.any():
        return first
    background = _mesh(electrons, sky, box_px, clip_sigma, quantum)
    if not _has_slopes(background) or np.median(background.sigma_e) < 2.0 * quantum:
        return background
    # the level varies within the cells (vignetting, twilight): noise and level of what remains without it
    remaining = _mesh(electrons - background.level_image(), sky, box_px, clip_sigma, 0.0)
    return replace(background, level_e=background.level_e + remaining.level_e, sigma_e=remaining.sigma_e)


def _has_slopes(background: Background) -> bool:
    """Whether the level varies within a cell by more than `SLOPE_FRACTION` of its noise (RMS of a slope)."""
    slope2 = np.zeros(background.level_e.shape)
    for axis, centre in enumerate((background.centre_y_px, background.centre_x_px)):
        if len(centre) > 1:
            step = 2.0 * centre[0] + 1.0
            slope2 = slope2 + np.gradient(background.level_e, centre, axis=axis) ** 2 * (step**2 - 1.0) / 12.0
    return bool(np.any(slope2 > (SLOPE_FRACTION * background.sigma_e) ** 2))


def _thinned(
    image: SensorImage, box_px: int, clip_sigma: float, exclude: NDArray[np.bool_] | None, step_px: int
) -> Background:
    """The background from every ``step_px``-th pixel in either direction, on the coordinates of the full image."""
    every = (slice(None, None, step_px), slice(None, None, step_px))
    thinned = replace(image, dn=image.dn[every], valid=image.valid[every], saturated=image.saturated[every])
    excluded = None if exclude is None else np.asarray(exclude, dtype=bool)[every]
    sky = estimate_background(thinned, box_px=box_px // step_px, clip_sigma=clip_sigma, exclude=excluded)
    return _on_full_image(sky, step_px, image.dn.shape)


def _on_full_image(thinned: Background, step_px: int, shape: tuple[int, ...]) -> Background:
    """A background of every ``step_px``-th pixel on the coordinates of the full image."""
    return replace(
        thinned,
        centre_x_px=thinned.centre_x_px * step_px,
        centre_y_px=thinned.centre_y_px * step_px,
        shape=(shape[0], shape[1]),
    )


def grown(mask: NDArray[np.bool_], by_px: int) -> NDArray[np.bool_]:
    """A mask (h, w) grown by squares of ``by_px``; ten times faster than `scipy.ndimage.maximum_filter`."""
    out = np.array(mask)
    for axis in (0, 1):
        before = np.moveaxis(np.array(out), axis, 0)
        target = np.moveaxis(out, axis, 0)
        for step in range(1, by_px + 1):
            target[step:] |= before[:-step]
            target[:-step] |= before[step:]
    return out


def _with_bright_neighbour(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (h, w) of which any of the eight neighbours is in the mask."""
    height, width = mask.shape
    padded = np.pad(mask, 1)
    shifts = [(row, column) for row in range(3) for column in range(3) if (row, column) != (1, 1)]
    return np.asarray(np.logical_or.reduce([padded[y : y + height, x : x + width] for y, x in shifts]))


def _mesh(
    electrons: FloatArray, usable: NDArray[np.bool_], box_px: int, clip_sigma: float, quantum: float
) -> Background:
    height, width = electrons.shape
    rows, columns = max(1, height // box_px), max(1, width // box_px)
    step_y, step_x = -(-height // rows), -(-width // columns)
    rows, columns = -(-height // step_y), -(-width // step_x)
    level, sigma = np.empty((2, rows, columns))
    chunk = max(1, _SORTED_PIXELS // (step_y * width))  # rows of cells whose numbers fit into the cache
    for first in range(0, rows, chunk):
        at = slice(first * step_y, min((first + chunk) * step_y, height))
        count = min(chunk, rows - first)
        padded = np.full((count * step_y, columns * step_x), np.nan)
        padded[: at.stop - at.start, :width] = np.where(usable[at], electrons[at], np.nan)
        cells = padded.reshape(count, step_y, columns, step_x).swapaxes(1, 2).reshape(count * columns, -1)
        statistics = np.reshape(_clipped_statistics(cells, clip_sigma, quantum), (2, count, columns))
        level[first : first + count], sigma[first : first + count] = statistics
    empty = ~np.isfinite(level)
    if empty.any():
        level[empty], sigma[empty] = np.nanmedian(level), np.nanmedian(sigma)
    if min(rows, columns) >= 3:
        # continued by point reflection, the median of a slope is the slope at the border too
        level, sigma = median_filter(_continued(level), 3)[1:-1, 1:-1], median_filter(sigma, 3)
    centre_y = [0.5 * (i * step_y + min((i + 1) * step_y, height) - 1) for i in range(rows)]
    centre_x = [0.5 * (i * step_x + min((i + 1) * step_x, width) - 1) for i in range(columns)]
    mesh_px = {"centre_x_px": np.array(centre_x), "centre_y_px": np.array(centre_y)}
    return Background(level_e=level, sigma_e=sigma, shape=(height, width), **mesh_px)


def _clipped_statistics(cells: FloatArray, clip_sigma: float, quantum: float) -> tuple[FloatArray, FloatArray]:
    """Sigma-clipped level and standard deviation of each row of ``cells`` (k, m), by prefix sums; NaN: left out."""
    ordered = np.sort(cells, axis=1)  # NaN sorts to the end
    count = np.isfinite(ordered).sum(axis=1)
    zero = ordered[:, :1].copy()
    k = np.arange(len(ordered))
    zero[:, 0] = ordered[k, np.maximum(count - 1, 0) // 2]  # moments about the median, without cancellation
    ordered = ordered - zero
    shifted = np.where(np.isnan(ordered), 0.0, ordered)
    sums, squares = np.zeros((2, shifted.shape[0], shifted.shape[1] + 1))
    np.cumsum(shifted, axis=1, out=sums[:, 1:])
    np.cumsum(shifted**2, axis=1, out=squares[:, 1:])
    # variance of a normal distribution cut at +- clip_sigma
    density = np.exp(-0.5 * clip_sigma**2) / np.sqrt(2.0 * np.pi)
    shrink = 1.0 - 2.0 * clip_sigma * density / erf(clip_sigma / np.sqrt(2.0))
    low, high = np.zeros(len(ordered), np.int64), count.copy()
    least = 1e-9 * np.abs(shifted).max(axis=1, initial=0.0)  # where most numbers are equal

    def below(limit: FloatArray, side: Literal["left", "right"] = "left") -> NDArray[np.int64]:
        """How many numbers of each row are smaller, or with "right" not larger, than its limit."""
        rows = zip(ordered, count, limit, strict=True)
        return np.array([row[:number].searchsorted(value, side) for row, number, value in rows], np.int64)

    for step in range(20):
        median, mean, sigma = _range_moments(shifted, sums, squares, low, high)
        spread = sigma / np.sqrt(shrink) if step else np.maximum(1.4826 * _range_mad(shifted, low, high), least)
        new_low = below(median - clip_sigma * spread)
        new_high = np.maximum(below(median + clip_sigma * spread, "right"), new_low + 1)
        new_high = np.minimum(new_high, count)
        if np.array_equal(new_low, low) and np.array_equal(new_high, high):
            break
        low, high = new_low, new_high
    median, mean, sigma = _range_moments(shifted, sums, squares, low, high)
    sigma = sigma / np.sqrt(shrink)
    if quantum > 0:  # median of grouped data: interpolated within the group of equal numbers
        fewer = below(median - 0.25 * quantum) - low
        same = below(median + 0.25 * quantum, "right") - low - fewer
        median = median + quantum * ((0.5 * (high - low) - fewer) / np.maximum(same, 1) - 0.5)
    crowded = mean - median > 0.1 * sigma
    level = np.where(crowded, 2.5 * median - 1.5 * mean, mean) + zero[:, 0]
    filled = count > 0
    for row in np.flatnonzero(filled & _coarse(ordered, count, quantum)):
        level[row], sigma[row] = _coarse_statistics(ordered[row, : count[row]], quantum)
        level[row] += zero[row, 0]
    return np.where(filled, level, np.nan), np.where(filled, sigma, np.nan)


def _coarse(ordered: FloatArray, count: NDArray[np.int64], quantum: float) -> NDArray[np.bool_]:
    """Rows whose numbers are too few for moments of a clipped normal distribution: narrow, or cut off below."""
    k = np.arange(len(ordered))
    low, middle, high = (ordered[k, np.minimum(count * part // 100, ordered.shape[1] - 1)] for part in (3, 50, 84))
    # 3 % of all have the lowest number there is, or hardly any differ
    cut_off = (low <= ordered[:, 0] + 0.5 * quantum) & (quantum * 8.0 > middle - ordered[:, 0] if quantum else True)
    return np.asarray(cut_off | (high - middle <= 1.5 * quantum))


def _coarse_statistics(values: FloatArray, quantum: float) -> tuple[float, float]:
    """Mean and standard deviation of sorted values with few different numbers, or clipped at the lowest.

    The underlying normal distribution follows from a straight line: edges between numbers against the normal quantiles
    of the fractions below them, from 2 to 97 %. Values 4 standard deviations above its mean are no background. Mean and
    deviation are of the rounded and clipped values, which detection and fits use.
    """
    if not quantum:  # e.g. means of colours
        step = np.diff(values)
        quantum = float(np.min(step[step > 1e-6 * (values[-1] - values[0])], initial=np.inf))
        if not np.isfinite(quantum):
            return float(values.mean()), 0.0
    code, number = np.unique(np.rint(values / quantum), return_counts=True)
    below = np.cumsum(number) / len(values)
    inside = (below > 0.02) & (below < 0.97)
    top = values[len(values) // 2] + 2.0 * quantum
    if inside.sum() >= 2:
        slope, middle = np.polyfit(ndtri(below[inside]), code[inside] + 0.5, 1)
        top = max((middle + 4.0 * slope + 0.5) * quantum, top)
    background = values[: np.searchsorted(values, top, "right")]
    return float(background.mean()), float(background.std())


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
