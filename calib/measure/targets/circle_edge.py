"""Sub-pixel edge of a round spot: crossings of one brightness level along spokes from an approximate centre.

Any contour of equal brightness locates a spot, with a soft edge as well as with a sharp one: the contours of a blurred
round disk are round about its centre. Each spoke is the mean of several rays; a straight line is fitted to brightness
against radius around the crossing, which uses all pixels there, gives a standard error, and has the same small
curvature error at every angle, which changes the radius and not the centre.

Points are measured in a plane (such as mm on a screen) through a mapping to pixels: in the projection of an oblique
picture the centres of ellipses are displaced.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates, uniform_filter1d

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, freeze_all

INTERPOLATED = 2.25
"""Variance of pixel noise over the mean variance (2/3)^2 that bilinear interpolation leaves of it: samples scatter less
than pixels, and those closer than a pixel are not independent. Sums over samples scatter as the pixels do."""

POOL = 15
"""Spokes that share an estimate of the noise."""

Mapping = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Spokes:
    """Brightness along rays from a centre."""

    centre: FloatArray  # (2,) In the plane
    angle_rad: FloatArray  # (k,) Direction of each spoke, the mean of its rays
    radius: FloatArray  # (m,) Sampled distances
    value: FloatArray  # (k, m) Mean brightness of a spoke's rays; NaN outside the image
    step_px: float  # Spacing of the samples along a ray in pixels

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze_all(self, centre=(2,), angle_rad=("k",), radius=("m",), sizes=sizes)
        freeze(self, "value", shape=("k", "m"), finite=False, sizes=sizes)


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgePoints:
    """Crossings of a level on spokes."""

    point: FloatArray  # (n, 2) In the plane
    sigma: FloatArray  # (n,) Standard error across the edge
    level: float  # Brightness of the contour

    def __post_init__(self) -> None:
        freeze_all(self, point=("n", 2), sigma=("n",))

    def __len__(self) -> int:
        return len(self.point)

    def outside(self, centre: ArrayLike, radius: float) -> EdgePoints:
        """The points farther than ``radius`` from ``centre``."""
        keep = np.hypot(*(self.point - np.asarray(centre, float)).T) > radius
        return EdgePoints(point=self.point[keep], sigma=self.sigma[keep], level=self.level)


def sample_spokes(
    image: ArrayLike,
    centre: ArrayLike,
    radius: ArrayLike,
    *,
    to_pixel: Mapping | None = None,
    spokes: int = 120,
    rays: int = 5,
) -> Spokes:
    """Brightness of an image (h, w) along spokes from a centre (2,) at increasing radii (m,)."""
    brightness, distance, middle = (np.asarray(value, np.float64) for value in (image, radius, centre))
    if spokes < 8 or rays < 1 or brightness.ndim != 2:
        raise DomainError(f"spokes = {spokes}, rays = {rays}: at least 8 spokes of 1 ray in an image (h, w) are needed")
    if distance.ndim != 1 or len(distance) < 5 or not np.all(np.diff(distance) > 0):
        raise DomainError("at least 5 increasing radii are needed to find an edge")
    angle = 2 * np.pi * (np.arange(spokes * rays) + 0.5) / (spokes * rays)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    point = middle + distance[None, :, None] * along[:, None, :]
    flat = point.reshape(-1, 2)
    pixel = flat if to_pixel is None else to_pixel(flat)
    value = map_coordinates(brightness, pixel[:, ::-1].T, order=1, mode="constant", cval=np.nan)
    return Spokes(
        centre=middle,
        angle_rad=angle.reshape(spokes, rays).mean(1),
        radius=distance,
        value=value.reshape(spokes, rays, -1).mean(1),
        step_px=_step_px(pixel.reshape(len(angle), len(distance), 2)),
    )


def _step_px(pixel: FloatArray) -> float:
    """Mean distance in pixels of neighbouring samples of a ray, for pixels (rays, samples, 2)."""
    return float(np.mean(np.hypot(*np.moveaxis(np.diff(pixel, axis=1), -1, 0))))


def edge_crossings(spokes: Spokes, level: ArrayLike, *, rising: bool, half_width: float) -> EdgePoints:
    """Points at which the brightness crosses a level, () or of each spoke (k,); at most one per spoke."""
    value, radius = spokes.value, spokes.radius
    level = np.broadcast_to(np.asarray(level, float), (len(value),))
    crossing = _first_crossing(smoothed(spokes, half_width), radius, level, rising=rising)
    for _ in range(2):
        crossing, error = _line_crossing(value, radius, level, crossing, half_width)
    error = error * np.sqrt(INTERPOLATED / min(spokes.step_px, 1.0))
    good = np.isfinite(crossing) & np.isfinite(error) & (error > 0)
    along = np.stack([np.cos(spokes.angle_rad), np.sin(spokes.angle_rad)], axis=1)
    point = spokes.centre + crossing[:, None] * along
    return EdgePoints(point=point[good], sigma=error[good], level=float(np.mean(level)))


def smoothed(spokes: Spokes, half_width: float) -> FloatArray:
    """Running means (k, m) of the profiles over ``half_width``; NaN stays NaN."""
    step = float(np.median(np.diff(spokes.radius)))
    size = max(round(half_width / step), 1)
    finite = np.isfinite(spokes.value)
    weight = uniform_filter1d(finite.astype(float), size, axis=1, mode="nearest")
    mean = uniform_filter1d(np.where(finite, spokes.value, 0.0), size, axis=1, mode="nearest")
    return np.where(finite, mean / np.maximum(weight, 1e-9), np.nan)


def _first_crossing(value: FloatArray, radius: FloatArray, level: FloatArray, *, rising: bool) -> FloatArray:
    above = value > level[:, None]
    change = (~above[:, :-1] & above[:, 1:]) if rising else (above[:, :-1] & ~above[:, 1:])
    change &= np.isfinite(value[:, :-1]) & np.isfinite(value[:, 1:])
    last = change.shape[1] - 1
    at = np.argmax(change, axis=1) if rising else last - np.argmax(change[:, ::-1], axis=1)
    rows = np.arange(len(value))
    low, high = value[rows, at], value[rows, at + 1]
    difference = np.where(high != low, high - low, 1.0)
    crossing = radius[at] + (level - low) / difference * (radius[at + 1] - radius[at])
    return np.where(change.any(axis=1), crossing, np.nan)


def _pooled(squares: FloatArray, freedom: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Variance about the lines, from each spoke and its neighbours: a single spoke has too few samples."""
    size = min(POOL, len(squares))
    total, degrees = (
        uniform_filter1d(np.where(usable, values, 0.0), size, mode="wrap") for values in (squares, freedom)
    )
    return np.asarray(np.maximum(total, 0.0) / np.maximum(degrees, 1e-9))


def _line_crossing(
    value: FloatArray, radius: FloatArray, level: FloatArray, guess: FloatArray, half_width: float
) -> tuple[FloatArray, FloatArray]:
    """Crossing of a line fitted around ``guess``, and its error from the scatter about the lines.

    Weights fall to the ends, so that samples that enter the window do not move the crossing from spoke to spoke.
    """
    offset = radius[None, :] - guess[:, None]
    inside = (np.abs(offset) < half_width) & np.isfinite(value)
    complete = (guess - half_width >= radius[0]) & (guess + half_width <= radius[-1])
    x, y = np.where(inside, offset, 0.0), np.where(inside, value, 0.0)
    weight = np.where(inside, 1.0 - (x / half_width) ** 2, 0.0)
    count, total = inside.sum(1), np.maximum(weight.sum(1), 1e-12)
    mean_x, mean_y = (weight * x).sum(1) / total, (weight * y).sum(1) / total
    dx, dy = np.where(inside, x - mean_x[:, None], 0.0), np.where(inside, y - mean_y[:, None], 0.0)
    moment = (weight * dx**2).sum(1)
    determined = moment > 0
    moment = np.where(determined, moment, 1.0)
    slope = (weight * dx * dy).sum(1) / moment
    usable = complete & (count >= 4) & determined & (np.abs(slope) > 0)
    divisor = np.where(usable, slope, 1.0)
    lever = (level - mean_y) / divisor
    residual = np.where(inside, dy - slope[:, None] * dx, 0.0)
    variance = _pooled((residual**2).sum(1), np.maximum(count - 2, 0), usable)
    of_mean = (weight**2).sum(1) / total**2
    of_slope = (weight**2 * dx**2).sum(1) / moment**2
    error = np.sqrt(variance * (of_mean + lever**2 * of_slope)) / np.abs(divisor)
    shift = mean_x + lever
    usable &= np.abs(shift) <= half_width
    return np.where(usable, guess + shift, np.nan), np.where(usable, error, np.nan)
