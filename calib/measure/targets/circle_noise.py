"""Noise of a circle fitted to a contour of light, from the noise of pixels, without pictures or fits.

A circle fitted to a contour through points at every angle moves by the sum over the light of g times its noise. With
the window W(x) of the lines of `calib.measure.targets.circle_edge`, ``3 (1 - x^2 / h^2) / (4 h)``, the contour's radius
R and the slope s of the brightness there,

    g = W(r - R) cos(theta) / (pi R |s|)           per unit area, for x; sin(theta) for y.

For pixel noise of variance v, sampled along n rays separated by unused pixels, bilinear interpolation leaves 2/3 of the
variance across a ray, and 3 / (5 h) of it along:  var = (2 / n) (2/3) 3 v / (5 h s^2). The level of a spoke of the
hole's edge is half of the brightness next to the edge, whose noise is added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray

ACROSS, ALONG = 2.0 / 3.0, 3.0 / 5.0
"""Fractions of white pixel noise: after bilinear interpolation across a ray; integral of h W^2 along it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contour:
    """A contour of a round spot or hole."""

    radius: float  # [px]
    slope: float  # Fraction of full brightness per px
    brightness: float  # At the contour
    half: float  # Half width of the window [px]
    rim: float = 0.0  # Brightness of the rim whose half, extrapolated by a line, is the level; 0 for a common level


def line_weight(offset: FloatArray, half_px: float) -> FloatArray:
    """Weights of the line fits, integral 1."""
    return np.asarray(np.where(np.abs(offset) < half_px, 0.75 / half_px * (1.0 - (offset / half_px) ** 2), 0.0))


def line_slope(value: FloatArray, offset: FloatArray, half_px: float) -> float:
    """Slope of the weighted line through a profile about offset 0."""
    weight = line_weight(offset, half_px)
    return float((weight * offset * value).sum() / (weight * offset**2).sum())


def blurred_step_slope(blur_px: float, half_px: float) -> float:
    """Slope of the line through a step of height 1 that is blurred by a normal density [1/px]."""
    offset = np.linspace(-half_px, half_px, 401)
    fine = np.linspace(-6.0, 6.0, 4801)
    profile = np.array([np.exp(-0.5 * ((x - fine[fine > 0]) / blur_px) ** 2).sum() for x in offset])
    return line_slope(profile * (fine[1] - fine[0]) / (np.sqrt(2 * np.pi) * blur_px), offset, half_px)


def rim_contour(brightness: ArrayLike, radius_px: ArrayLike, hole_px: float, half_px: float, level: float) -> Contour:
    """Contour low on the rim of a spot around a dark hole, on a profile (n,) at equally spaced distances.

    ``half_px``: half width of the window of the lines; ``level``: of the contour, as a fraction of the brightest rim.
    """
    bright, radius = np.asarray(brightness, float), np.asarray(radius_px, float)
    size = round(half_px / float(radius[1] - radius[0]))
    rim = np.convolve(np.where(radius > hole_px, bright, 0.0), np.ones(size) / size, mode="same").max()
    outside = radius > hole_px + half_px
    at = float(np.interp(-level * rim, -bright[outside], radius[outside]))
    slope = line_slope(bright, radius - at, half_px)
    return Contour(radius=at, slope=slope, brightness=level * rim, half=half_px)


def centre_variance_px2(
    contour: Contour, full_e: float, rays: int, pixel_e2: float, rim_e2: float, rim_px: tuple[float, float]
) -> float:
    """Variance per axis of the centre of a circle fitted to a contour along all ``rays``; ``full_e``: full brightness.

    ``pixel_e2``, ``rim_e2``: variance of a pixel at the contour, and on the rim next to it, of which the range
    ``rim_px`` from the edge determines the level.
    """
    along = ALONG / contour.half * pixel_e2
    if contour.rim:
        near, far = rim_px
        middle, length = (near + far) / 2, far - near
        along += 0.25 * (1.0 / length + 12.0 * middle**2 / length**3) * rim_e2
    return 2.0 / rays * ACROSS * along / (contour.slope * full_e) ** 2


def ray_weights(angle_rad: FloatArray, radius_px: FloatArray, blur_px: float, rays: int) -> FloatArray:
    """Weights (2, n) of light at an angle in the mean over all rays of cos and sin, per px of arc; the spacing of the
    rays exceeds the width of the light of a particle."""
    spacing = 2 * np.pi / rays
    nearest = np.floor(angle_rad / spacing)
    total = np.zeros((2, len(angle_rad)))
    for step in (-1.0, 0.0, 1.0):
        at = (nearest + step + 0.5) * spacing
        weight = np.exp(-0.5 * (radius_px * (angle_rad - at) / blur_px) ** 2) / (np.sqrt(2 * np.pi) * blur_px)
        total += weight * np.stack([np.cos(at), np.sin(at)])
    return np.asarray(total / rays)


def hole_response(offset: FloatArray, half_px: float, blur_px: float, rim_px: tuple[float, float]) -> FloatArray:
    """Change of brightness at a hole's edge per px of radius by light at an offset with the width of the blur.

    Half of the change of the line fitted to the rim next to the edge is subtracted.
    """
    near, far = rim_px
    middle, length = (near + far) / 2, far - near
    fine = np.linspace(-12.0, 16.0, 2801)
    line = np.where((fine > near) & (fine < far), 1 / length - middle * (fine - middle) / (length**3 / 12), 0.0)
    kernel = np.exp(-0.5 * (np.linspace(-4.0, 4.0, 801) / blur_px) ** 2)
    table = np.convolve(line_weight(fine, half_px) - 0.5 * line, kernel / kernel.sum(), mode="same")
    return np.asarray(np.interp(offset, fine, table, left=0.0, right=0.0))


def light_offsets_px(
    x: FloatArray,
    y: FloatArray,
    per_px: float,
    spot: Contour,
    hole: Contour,
    blur_px: float,
    rays: int,
    rim_px: tuple[float, float],
) -> FloatArray:
    """Centres (2, 2) of a concentric spot, and of spot less hole, rendered by particles of light at ``x``, ``y`` (n,).

    ``per_px``: particles per px^2 of full brightness.
    """
    radius = np.hypot(x, y)
    lit = radius > hole.radius
    angle, radius = np.arctan2(y[lit], x[lit]), radius[lit]
    weights = ray_weights(angle, radius, blur_px, rays)
    outward = line_weight(radius - spot.radius, spot.half) / abs(spot.slope)
    inward = -hole_response(radius - hole.radius, hole.half, blur_px, rim_px) / hole.slope
    return np.array([2.0 * (response * weights).sum(1) / per_px for response in (outward, outward - inward)])
