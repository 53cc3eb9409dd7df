"""Images of a lens at field points: positions, sizes and rays, in the best focus of all or where the detector is."""

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
    shift_mm: float  # Of the image plane, from where the lens has it
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

    Parameters
    ----------
    lens : LensSystem
        The lens.
    field_x_deg, field_y_deg : (g,)
        Field angles [deg].
    wavelength_nm, fraction : (w,)
        Wavelengths [nm], and the light at each, relative.
    refocused : bool
        Whether the image plane is set to the least mean square of all spots first.
    shift_mm : float
        Shift of the image plane from there, or from where the lens has it.
    order : (int, int)
        Rings and azimuths of the pupil.

    Raises
    ------
    ConvergenceError
        No light at a field point.
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
    means, rest = [], []
    for position, component in ((rays.x, rays.dx), (rays.y, rays.dy)):
        height = np.where(lit, position + shift_mm * component / np.where(lit, rays.dz, 1.0), 0.0)
        means.append((weight * height).sum((1, 2)))
        rest.append(height - means[-1][:, None, None])
    return PolychromaticSpots(
        position_mm=np.stack(means, axis=-1),
        square_mm2=(weight * (rest[0] ** 2 + rest[1] ** 2)).sum((1, 2)),
        light_mm2=light,
        shift_mm=shift_mm,
        x_mm=rest[0],
        y_mm=rest[1],
        weight=weight,
    )
