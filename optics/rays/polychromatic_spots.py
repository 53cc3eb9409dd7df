"""Polychromatic spots at field points: positions, sizes and rays, in best focus or at a shift of the image plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConvergenceError
from optics.lens.system import LensSystem
from optics.rays.best_focus import white_focus
from optics.rays.spots import trace_spots


@dataclass(frozen=True, slots=True, kw_only=True)
class PolychromaticSpots:
    """Images at g field points."""

    position_mm: FloatArray  # (g, 2) Mean of all light
    square_mm2: FloatArray  # (g,) Mean square distance from it
    light_mm2: FloatArray  # (g,) Collecting area, weighted over the wavelengths
    shift_mm: float  # Of the image plane, from its position in the lens
    x_mm: FloatArray  # (g, w, n) Rays from the mean
    y_mm: FloatArray
    weight: FloatArray  # (g, w, n) Fraction of the light of the field point


def polychromatic_spots(
    lens: LensSystem,
    field_x_deg: ArrayLike,
    field_y_deg: ArrayLike,
    wavelength_nm: ArrayLike,
    fraction: ArrayLike,
    *,
    refocused: bool = False,
    shift_mm: float = 0.0,
    order: tuple[int, int] = (6, 16),
) -> PolychromaticSpots:
    """Trace a lens at field points.

    Fields, wavelengths and ``order`` as of `optics.rays.spots.trace_spots`; ``fraction`` (w,) of the light at each
    wavelength, in any unit. The image plane is shifted by ``shift_mm`` along the light from its position in the lens,
    or if ``refocused`` from the least mean square of all spots. `ConvergenceError` if a field point has no light.
    """
    spots = trace_spots(lens, field_x_deg, field_y_deg, wavelength_nm, order=order)
    weight = spots.area_mm2 * np.asarray(fraction, np.float64)[:, None]
    light = weight.sum((1, 2))
    if not (light > 0.0).all():
        raise ConvergenceError("no light reaches a point of the detector")
    weight = weight / light[:, None, None]
    rays, lit = spots.rays, weight > 0.0
    if refocused:
        shift_mm = shift_mm + float(white_focus(spots, fraction).mean.best_mm)
    means, distances = [], []
    for position, component in ((rays.x, rays.dx), (rays.y, rays.dy)):
        height = np.where(lit, position + shift_mm * component / np.where(lit, rays.dz, 1.0), 0.0)
        means.append((weight * height).sum((1, 2)))
        distances.append(height - means[-1][:, None, None])
    x, y = distances
    return PolychromaticSpots(
        position_mm=np.stack(means, axis=-1),
        square_mm2=(weight * (x**2 + y**2)).sum((1, 2)),
        light_mm2=light,
        shift_mm=shift_mm,
        x_mm=x,
        y_mm=y,
        weight=weight,
    )
