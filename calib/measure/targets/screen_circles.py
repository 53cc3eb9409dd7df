"""Circles in pictures of a screen with a round aperture: the aperture itself, and a spot of light around it (CUBE09).

The spot is as wide as the aperture plus the Sun's image over the path of the light, so that only its rim is visible
around the hole; the contour fitted to it is low on the rim. The edge of the hole in the same picture also gives the
aperture.

Edges are transformed from the picture to the plane of the screen before the circles are fitted, so that an oblique view
has no effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from calib.measure.targets.circle_edge import EdgePoints, edge_crossings, sample_spokes, smoothed
from calib.measure.targets.circle_fit import CircleFit, fit_circle
from optics.arrays import FloatArray
from optics.errors import ConvergenceError

RIM_LEVEL = 0.3
"""Contour of the spot, as a fraction of the brightest rim."""
SPOKES, RAYS = 90, 3
HOLE_MARGIN_PX = 4.0
RIM_PX = (2.5, 7.0)
"""Range of the rim, from the hole's edge, whose brightness is extrapolated to the edge by a line."""
EDGE_HALF_WIDTH_PX = {"aperture": 1.5, "spot": 14.0, "hole": 1.5}


class ScreenCamera(Protocol):
    """A camera that images a plane screen."""

    @property
    def pitch_mm(self) -> float:
        """One pixel on the screen, in the middle of the field."""

    def to_pixel(self, screen_mm: Any) -> FloatArray:
        """Pixels (n, 2) of points (n, 2) of the screen [mm]."""

    def to_screen(self, pixel_px: Any) -> FloatArray:
        """Points (n, 2) of the screen [mm] of pixels (n, 2)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScreenPicture:
    """A read-out picture of the screen."""

    electrons: FloatArray  # (h, w) (DN - offset) / gain
    camera: ScreenCamera  # The camera in its calibrated pose


@dataclass(frozen=True, slots=True, kw_only=True)
class SpotOffset:
    """Spot minus aperture."""

    offset_px: FloatArray  # (2,) x and y in the laboratory, in pixels of the screen
    covariance_px2: FloatArray  # (2, 2) From the two circle fits
    spot: CircleFit  # In mm on the screen
    aperture: CircleFit

    @property
    def sigma_px(self) -> FloatArray:
        """Standard deviations (2,)."""
        return np.sqrt(np.diag(self.covariance_px2))


def _spokes(picture: ScreenPicture, centre_mm: FloatArray, low_mm: float, high_mm: float, step_px: float = 0.5) -> Any:
    radius = np.arange(low_mm, high_mm, step_px * picture.camera.pitch_mm)
    return sample_spokes(
        picture.electrons, centre_mm, radius, to_pixel=picture.camera.to_pixel, spokes=SPOKES, rays=RAYS
    )


def fit_aperture(picture: ScreenPicture, radius_mm: float, *, advice: str = "") -> CircleFit:
    """Circle through the edge of the glowing aperture: half the brightness of its inside."""
    width = EDGE_HALF_WIDTH_PX["aperture"] * picture.camera.pitch_mm
    centre, moved = np.zeros(2), np.inf
    while moved > 2.0 * picture.camera.pitch_mm:
        spokes = _spokes(picture, centre, 0.6 * radius_mm, radius_mm + 12 * picture.camera.pitch_mm)
        inside = spokes.radius < 0.85 * radius_mm
        outside = spokes.radius > radius_mm + 8 * picture.camera.pitch_mm
        level = 0.5 * (np.nanmedian(spokes.value[:, inside]) + np.nanmedian(spokes.value[:, outside]))
        edge = edge_crossings(spokes, level, rising=False, half_width=width)
        fit = _circle(edge, "aperture", advice)
        moved, centre = float(np.hypot(*(fit.centre - centre))), fit.centre
    return fit


def fit_spot(picture: ScreenPicture, aperture: CircleFit, reach_mm: float, *, advice: str = "") -> CircleFit:
    """Circle through a contour low on the rim of the spot, where it shows outside the hole."""
    pitch = picture.camera.pitch_mm
    width = EDGE_HALF_WIDTH_PX["spot"] * pitch
    centre = _brightest(picture, aperture)
    for _ in range(2):
        spokes = _spokes(picture, centre, 0.5 * aperture.radius, reach_mm + 25 * pitch, 1.0)
        dark = np.nanmedian(spokes.value[:, -8:])
        rim = np.nanmax(smoothed(spokes, width), axis=1)
        level = dark + RIM_LEVEL * (np.nanpercentile(rim, 90) - dark)
        edge = edge_crossings(spokes, level, rising=False, half_width=width)
        edge = edge.outside(aperture.centre, aperture.radius + HOLE_MARGIN_PX * pitch)
        fit = _circle(edge, "spot", advice)
        centre = fit.centre
    return fit


def fit_hole(picture: ScreenPicture, aperture: CircleFit, *, advice: str = "") -> CircleFit:
    """Circle through the dark edge of the hole in the picture of the spot, each spoke at half its own brightness."""
    pitch = picture.camera.pitch_mm
    width = EDGE_HALF_WIDTH_PX["hole"] * pitch
    centre, moved = aperture.centre, np.inf
    while moved > 2.0 * pitch:
        spokes = _spokes(picture, centre, 0.6 * aperture.radius, aperture.radius + 9 * pitch)
        inside = spokes.radius < aperture.radius - 5 * pitch
        out_px = (spokes.radius - aperture.radius) / pitch
        rim = (out_px > RIM_PX[0]) & (out_px < RIM_PX[1])
        dark = np.nanmedian(spokes.value[:, inside])
        at_edge = _lines(spokes.radius[rim] - aperture.radius, spokes.value[:, rim])
        edge = edge_crossings(spokes, 0.5 * (dark + at_edge), rising=True, half_width=width)
        fit = _circle(edge, "edge of the hole", advice)
        moved, centre = float(np.hypot(*(fit.centre - centre))), fit.centre
    return fit


def _circle(edge: EdgePoints, what: str, advice: str) -> CircleFit:
    """Circle whose covariance follows from the scatter of the points about it: residuals of the lines by the curvature
    of the edge are equal on every spoke, and no noise."""
    if len(edge) < SPOKES // 6:
        raise ConvergenceError(f"the {what} shows only {len(edge)} edge points on {SPOKES} spokes; {advice}")
    fit = fit_circle(edge.point, sigma=edge.sigma)
    if not fit.converged:
        reason = fit.message.partition(";")[0]
        raise ConvergenceError(f"the {len(edge)} edge points of the {what} do not form a circle ({reason}); {advice}")
    return replace(fit, covariance=fit.covariance * min(fit.misfit.ratio**2, 1.0))


def _lines(x: FloatArray, value: FloatArray) -> FloatArray:
    """Value at x = 0 of a line through each row."""
    return np.asarray(np.polynomial.polynomial.polyfit(x, value.T, 1)[0])


def _brightest(picture: ScreenPicture, aperture: CircleFit) -> FloatArray:
    """Rough centre of the spot: mean of the picture's light, the hole taken as evenly filled."""
    height, width = picture.electrons.shape
    step = 4
    row, column = np.mgrid[0:height:step, 0:width:step]
    light = picture.electrons[::step, ::step]
    light = np.clip(light - np.percentile(light, 20), 0, None)
    light = np.where(light > 0.05 * light.max(), light, 0.0)
    point = picture.camera.to_screen(np.column_stack([column.ravel(), row.ravel()]))
    weight = light.ravel()
    if not weight.sum() > 0:
        return aperture.centre
    return np.asarray((weight @ point) / weight.sum())


def measure_offset(aperture: CircleFit, spot: CircleFit, pitch_mm: float) -> SpotOffset:
    """Difference of two fitted centres."""
    return SpotOffset(
        offset_px=(spot.centre - aperture.centre) / pitch_mm,
        covariance_px2=(spot.covariance[:2, :2] + aperture.covariance[:2, :2]) / pitch_mm**2,
        spot=spot,
        aperture=aperture,
    )
