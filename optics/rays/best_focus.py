"""Best focus of traced spots: ray heights are linear in the shift of the image plane, the mean square a parabola."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.lens.system import LensSystem
from optics.rays.spots import Spots, trace_spots

NO_SLOPE = 1e-20
"""Mean square of slopes that is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusCurve:
    """RMS spot radius against a shift z of the image: ``r^2 = square + 2 cross z + slope z^2``, exact for rays."""

    # (...) Mean square of the ray heights about their mean, their mean product with the slopes, mean square of the
    # slopes
    square_mm2: FloatArray
    cross_mm: FloatArray
    slope: FloatArray

    def __post_init__(self) -> None:
        for name in ("square_mm2", "cross_mm", "slope"):
            object.__setattr__(self, name, np.array(getattr(self, name), np.float64))
            getattr(self, name).setflags(write=False)

    def __add__(self, other: FocusCurve) -> FocusCurve:
        """Curve of two axes together."""
        return FocusCurve(
            square_mm2=self.square_mm2 + other.square_mm2,
            cross_mm=self.cross_mm + other.cross_mm,
            slope=self.slope + other.slope,
        )

    def blurred(self, sigma_mm: float) -> FocusCurve:
        """The curve of spots blurred by a round Gaussian of this standard deviation."""
        return replace(self, square_mm2=self.square_mm2 + 2.0 * sigma_mm**2)

    def rms_mm(self, shift_mm: ArrayLike = 0.0) -> FloatArray:
        """RMS radius [mm] at image-plane shifts that broadcast against the curve."""
        z = np.asarray(shift_mm, np.float64)
        return np.sqrt(np.maximum(self.square_mm2 + 2.0 * self.cross_mm * z + self.slope * z * z, 0.0))

    @property
    def best_mm(self) -> FloatArray:
        """Shift of the image plane with the smallest spot [mm]; 0 where rays have no slopes (a measured lens)."""
        sloped = ~(self.slope <= NO_SLOPE)
        return np.asarray(np.where(sloped, -self.cross_mm / np.where(sloped, self.slope, 1.0), 0.0))

    @property
    def mean(self) -> FocusCurve:
        """Curve of the mean square over all fields, with equal weights."""
        return FocusCurve(square_mm2=self.square_mm2.mean(), cross_mm=self.cross_mm.mean(), slope=self.slope.mean())


def focus_by_axis(
    spots: Spots, light: FloatArray, over: tuple[int, ...] = (-2, -1)
) -> tuple[FloatArray, tuple[FocusCurve, FocusCurve]]:
    """Mean positions (2, ...) [mm] and focus curves along x and y of rays, by the ``light`` (f, w, n) of each ray.

    Means are over the axes ``over`` of (field, wavelength, ray); NaN where no ray arrives.
    """
    rays, total = spots.rays, light.sum(over, keepdims=True)
    weight = np.divide(light, total, out=np.full_like(light, np.nan), where=total > 0)
    means, curves = [], []
    for position, component in ((rays.x, rays.dx), (rays.y, rays.dy)):
        height = np.where(rays.ok, position, 0.0)
        slope = np.where(rays.ok, component / np.where(rays.ok, rays.dz, 1.0), 0.0)
        means.append((weight * height).sum(over))
        height = height - (weight * height).sum(over, keepdims=True)
        slope = slope - (weight * slope).sum(over, keepdims=True)
        square, cross = (weight * height * height).sum(over), (weight * height * slope).sum(over)
        curves.append(FocusCurve(square_mm2=square, cross_mm=cross, slope=(weight * slope * slope).sum(over)))
    return np.stack(means), (curves[0], curves[1])


def white_focus(spots: Spots, fraction: ArrayLike = 1.0) -> FocusCurve:
    """Focus curve (f,) of all light about its common mean; ``fraction`` (w,) or (f, w) of the light by wavelength."""
    fraction = np.broadcast_to(fraction, spots.area_mm2.shape[:2])
    _, (x, y) = focus_by_axis(spots, spots.area_mm2 * fraction[..., None])
    return x + y


def best_focus_shift_mm(
    lens: LensSystem, field_x_deg: ArrayLike, field_y_deg: ArrayLike, wavelength_nm: ArrayLike
) -> float:
    """Shift of the image plane [mm] that minimises the polychromatic spots.

    Minimises the mean over fields of the mean square distance from the spot's mean over all wavelengths, fields and
    wavelengths alike. Apply it with `optics.lens.perturb.refocus`. Errors as `optics.rays.spots.trace_spots`.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    field_x_deg, field_y_deg : (f,)
        Field angles [deg].
    wavelength_nm : (w,)
        Wavelengths [nm].

    Returns
    -------
    float
        Shift [mm], positive away from the lens.
    """
    lens.check_surfaces()
    return float(white_focus(trace_spots(lens, field_x_deg, field_y_deg, wavelength_nm)).mean.best_mm)
