"""Windows around stars, cut from an image or a windowed readout."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d
from scipy.spatial import cKDTree

from calib.flags import StarFlag
from calib.measure.background import Background
from calib.measure.statistics.robust import ROBUST_SIGMA
from calib.records import NoiseModel, SensorImage, Stamps
from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from render.records import WindowStack


def subpixel_peaks(
    images: FloatArray, image: IntArray | int, x: IntArray, y: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Columns and rows (n,) of maxima at whole pixels of images (m, h, w): vertices of parabolas along both axes."""
    peak = images[image, y, x]

    def vertex(before: FloatArray, after: FloatArray) -> FloatArray:
        curvature = before - 2.0 * peak + after
        offset = np.divide(0.5 * (before - after), curvature, out=np.zeros_like(peak), where=curvature < 0)
        return np.clip(offset, -0.5, 0.5)

    _, height, width = images.shape
    left, right = np.maximum(x - 1, 0), np.minimum(x + 1, width - 1)
    above, below = np.maximum(y - 1, 0), np.minimum(y + 1, height - 1)
    dx = vertex(images[image, y, left], images[image, y, right])
    return x + dx, y + vertex(images[image, above, x], images[image, below, x])


def coarse_position(light: FloatArray, valid: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Position of the highest point of each smoothed window, good to about 0.1 px for a star well above the noise.

    Shapes: ``light`` (n, h, w), ``valid`` (n, h, w), returns (n,).
    """
    kernel = np.array([0.25, 0.5, 0.25])
    smooth = np.where(valid, light, 0.0)
    for axis in (1, 2):
        smooth = correlate1d(smooth, kernel, axis=axis, mode="constant")
    count, _, width = smooth.shape
    highest = smooth.reshape(count, -1).argmax(axis=1) if count else np.empty(0, np.int64)
    y, x = np.divmod(highest, width)
    return subpixel_peaks(smooth, np.arange(count), x, y)


def ring_background(electrons: FloatArray, valid: NDArray[np.bool_]) -> FloatArray:
    """Background of each window [e-] from its outermost ring of pixels: mean after clipping at 3 sigma (MAD).

    The wings of the star raise it; a better value or a fit of the background avoids that.
    """
    edge = np.ones(electrons.shape[1:], dtype=bool)
    edge[1:-1, 1:-1] = False
    ring, usable = electrons[:, edge], valid[:, edge]
    level = np.zeros(len(electrons))
    determined = usable.any(axis=1)
    values = np.where(usable, ring, np.nan)[determined]
    median = np.nanmedian(values, axis=1, keepdims=True)
    spread = ROBUST_SIGMA * np.nanmedian(np.abs(values - median), axis=1, keepdims=True)
    inlier = np.abs(values - median) <= np.maximum(3.0 * spread, 1e-9)
    level[determined] = np.nanmean(np.where(inlier, values, np.nan), axis=1)
    return level


def extract_stamps(
    image: SensorImage,
    x_px: ArrayLike,
    y_px: ArrayLike,
    *,
    background: Background | ArrayLike,
    size_px: int = 11,
    flags: ArrayLike | None = None,
    psf_index: ArrayLike | None = None,
) -> Stamps:
    """Square windows around given positions.

    A window always has its full size; pixels beyond the image are invalid and set ``EDGE``. A second position within
    the window sets ``BLEND`` on both.

    Shapes: ``x_px`` (n,), ``y_px`` (n,), ``background`` (n,), ``flags`` (n,), ``psf_index`` (n,).
    """
    height, width = image.dn.shape
    _check_size(size_px, height, width)
    x, y = (np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (x_px, y_px))
    if x.shape != y.shape or x.ndim != 1:
        raise DomainError(f"x_px and y_px have shapes {x.shape} and {y.shape}; two arrays of equal length are needed")
    if not np.all(np.isfinite(x) & np.isfinite(y)):
        bad = int(np.argmin(np.isfinite(x) & np.isfinite(y)))
        raise DomainError(f"position of star {bad} is ({x[bad]}, {y[bad]}) px; finite values are needed")
    half = size_px // 2
    centre = np.rint(np.clip(np.column_stack([x, y]), -1e9, 1e9)).astype(np.int64)
    columns = centre[:, 0, None] - half + np.arange(size_px)
    rows = centre[:, 1, None] - half + np.arange(size_px)
    inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None, :]
    at = (np.clip(rows, 0, height - 1)[:, :, None], np.clip(columns, 0, width - 1)[:, None, :])
    saturated = image.saturated[at] & inside
    defect = ~image.valid[at] & inside
    valid = inside & ~saturated & ~defect
    electrons = np.where(valid, image.noise.to_electrons(image.dn[at]), 0.0)
    if isinstance(background, Background):
        level = background.level_at(x, y)
    else:
        level = np.broadcast_to(np.asarray(background, dtype=np.float64), x.shape)
    window_flags = _window_flags(inside, saturated, defect, valid)
    window_flags[_crowded(x, y, size_px)] |= int(StarFlag.BLEND)
    if flags is not None:
        window_flags |= np.asarray(flags, dtype=np.uint32)
    return Stamps(
        electrons=electrons,
        valid=valid,
        corner_px=centre - half,
        background_e=level,
        start_px=np.column_stack([x, y]),
        flags=window_flags,
        psf_index=np.zeros(len(x), np.int64) if psf_index is None else np.asarray(psf_index),
    )


def stamps_from_windows(stack: WindowStack, start_px: ArrayLike) -> tuple[Stamps, NoiseModel]:
    """Stamps of a readout of m frames and n windows, frame by frame (row ``frame * n + window``), background 0.

    Measurements start at ``start_px`` (n, 2); ``psf_index`` is the window.
    """
    noise = NoiseModel.of(stack)
    frames, windows, height, width = stack.dn.shape
    shape = (frames * windows, height, width)
    saturated = stack.saturated.reshape(shape)
    defect = np.broadcast_to(stack.defect, stack.dn.shape).reshape(shape)
    valid = ~(saturated | defect)
    stamps = Stamps(
        electrons=np.where(valid, noise.to_electrons(stack.dn).reshape(shape), 0.0),
        valid=valid,
        corner_px=np.tile(stack.corner_px, (frames, 1)),
        background_e=np.zeros(len(valid)),
        start_px=np.tile(start_px, (frames, 1)),
        flags=_window_flags(np.ones_like(valid), saturated, defect, valid),
        psf_index=np.tile(np.arange(windows), frames),
    )
    return stamps, noise


def centre_of_gravity(light_e: FloatArray) -> FloatArray:
    """Column and row (n, 2) in windows (n, h, w) of their positive light."""
    light = np.maximum(light_e, 0.0)
    light = light / np.maximum(light.sum((1, 2), keepdims=True), 1e-300)
    _, height, width = light.shape
    return np.column_stack([light.sum(1) @ np.arange(width), light.sum(2) @ np.arange(height)])


def noiseless_stamps(
    light_e: FloatArray,
    *,
    corner_px: NDArray[np.int64] | None = None,
    valid: NDArray[np.bool_] | None = None,
    start_px: FloatArray | None = None,
    psf_index: NDArray[np.int64] | None = None,
) -> Stamps:
    """Stamps of expected light (n, h, w) without background.

    Default ``start_px`` (n, 2): centres of gravity of the usable pixels; default ``psf_index``: a PSF for every window.
    """
    count = len(light_e)
    corner = np.zeros((count, 2), np.int64) if corner_px is None else corner_px
    usable = np.ones(light_e.shape, bool) if valid is None else valid
    light = np.where(usable, np.maximum(light_e, 0.0), 0.0)
    return Stamps(
        electrons=light,
        valid=usable,
        corner_px=corner,
        background_e=np.zeros(count),
        start_px=corner + centre_of_gravity(light) if start_px is None else start_px,
        flags=np.zeros(count, np.uint32),
        psf_index=np.arange(count) if psf_index is None else psf_index,
    )


def _check_size(size_px: int, height: int, width: int) -> None:
    if size_px < 3 or size_px % 2 == 0:
        raise DomainError(f"size_px = {size_px} px; a window needs an odd size of at least 3 px")
    if size_px > min(height, width):
        raise DomainError(f"size_px = {size_px} px is larger than the image ({width} x {height} px); choose less")


def _window_flags(
    inside: NDArray[np.bool_], saturated: NDArray[np.bool_], defect: NDArray[np.bool_], valid: NDArray[np.bool_]
) -> NDArray[np.uint32]:
    flags = np.zeros(len(inside), np.uint32)
    flags[~inside.all(axis=(1, 2))] |= int(StarFlag.EDGE)
    flags[saturated.any(axis=(1, 2))] |= int(StarFlag.SATURATED)
    flags[defect.any(axis=(1, 2))] |= int(StarFlag.DEFECT)
    flags[~valid.any(axis=(1, 2))] |= int(StarFlag.NO_DATA)
    return flags


def _crowded(x: FloatArray, y: FloatArray, size_px: int) -> NDArray[np.int64]:
    """Stars that have another one inside their window."""
    pairs = cKDTree(np.column_stack([x, y])).query_pairs(0.5 * size_px, p=np.inf, output_type="ndarray")
    return np.unique(pairs)
