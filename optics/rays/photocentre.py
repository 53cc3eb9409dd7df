"""Spectral photocentre: mean of the light of a source on the image plane, over pupil and spectrum.

With the bundle means r(w) of rays at the wavelengths w, the area A(w) of the beam that arrives and the spectrum s(w) of
the detected light (source, filter, response), the photocentre is ``sum s A r / sum s A``. The shift of a star with its
colour is the difference of two photocentres. Rays are weighted by their area in the pupil; losses on their paths in
coatings and glass, which change the colour shift of a coated lens by some 0.2 %, are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.rays.spots import QUADRATURE, SpotMoments, spot_moments, weighted_mean
from optics.records import freeze_alike


@dataclass(frozen=True, slots=True, kw_only=True)
class Photocentres:
    """Light of s spectra from f fields on the image plane; NaN where no ray arrives."""

    x_mm: FloatArray  # (f, s) Photocentre
    y_mm: FloatArray  # (f, s)
    rms_radius_mm: FloatArray  # (f, s) Root mean square distance of the light from it
    # (f, s) Cross-section of the beam that arrives, mean over the spectrum
    area_mm2: FloatArray

    def __post_init__(self) -> None:
        freeze_alike(self, *self.__dataclass_fields__, shape=("f", "s"), finite=False)


def photocentres_of(spots: SpotMoments, spectrum: ArrayLike) -> Photocentres:
    """Photocentres from the moments of traced bundles of f fields at w wavelengths.

    ``spectrum`` (s, w): detected photons of each spectrum at these wavelengths, in any unit, 0 where a spectrum has
    none; `DomainError` for another shape, negative values, or no light.
    """
    weight = np.atleast_2d(np.asarray(spectrum, float))
    if weight.ndim != 2 or weight.shape[1] != spots.x_mm.shape[1]:
        raise DomainError(f"spectrum of shape {weight.shape}; (s, {spots.x_mm.shape[1]}) is needed")
    if not (np.all(weight >= 0.0) and np.all(weight.sum(1) > 0.0) and np.all(np.isfinite(weight))):
        raise DomainError("a spectrum is negative, not finite or without light; photons at the wavelengths are needed")
    weight = weight / weight.sum(1, keepdims=True)
    x, y, second, area = (
        v[:, None] for v in (spots.x_mm, spots.y_mm, spots.xx_mm2 + spots.yy_mm2, spots.transmitted_mm2)
    )
    light = weight * area
    mean_x, mean_y = weighted_mean(x, light), weighted_mean(y, light)
    spread = second + (x - mean_x[..., None]) ** 2 + (y - mean_y[..., None]) ** 2
    return Photocentres(
        x_mm=mean_x, y_mm=mean_y, rms_radius_mm=np.sqrt(weighted_mean(spread, light)), area_mm2=light.sum(-1)
    )


def photocentre(
    lens: LensSystem,
    field_x_deg: ArrayLike,
    field_y_deg: ArrayLike,
    wavelength_nm: ArrayLike,
    spectrum: ArrayLike,
    *,
    order: tuple[int, int] = QUADRATURE,
    collimation: FloatArray | None = None,
) -> Photocentres:
    """Trace bundles and take the mean of their light.

    Parameters
    ----------
    lens, field_x_deg, field_y_deg, wavelength_nm, order, collimation
        As in `optics.rays.spots.trace_spots`, whose errors are raised.
    spectrum : (s, w)
        As in `photocentres_of`.

    Returns
    -------
    Photocentres
        In the image plane, lens frame axes (y against increasing row).
    """
    spots = spot_moments(lens, field_x_deg, field_y_deg, wavelength_nm, order=order, collimation=collimation)
    return photocentres_of(spots, spectrum)
