"""Vignetting and collecting area: the cross-section of the beam that reaches the image, absolute and relative."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import ConvergenceError
from optics.lens.system import LensSystem
from optics.rays.spots import spot_moments


def vignetting(
    lens: LensSystem, field_x_deg: ArrayLike, field_y_deg: ArrayLike, wavelength_nm: float | None = None
) -> FloatArray:
    """Transmitted area of the beam relative to field 0, (f,); the cosine of the field angle is not part of it.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    field_x_deg, field_y_deg : (f,)
        Field angles [deg].
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.

    Returns
    -------
    (f,) array
        Fractions.
    """
    fx, fy = np.broadcast_arrays(np.atleast_1d(field_x_deg), np.atleast_1d(field_y_deg))
    wave = lens.design_wavelength_nm if wavelength_nm is None else wavelength_nm
    area = spot_moments(lens, np.append(fx, 0.0), np.append(fy, 0.0), wave).transmitted_mm2[:, 0]
    if not area[-1] > 0:
        raise ConvergenceError(f"lens {lens.name!r}: no ray of field 0 reaches the image plane")
    return np.asarray(area[:-1] / area[-1])


def collecting_area_mm2(lens: LensSystem, wavelength_nm: float | None = None) -> float:
    """Cross-section of the on-axis beam that reaches the image.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    wavelength_nm : float, optional
        Wavelength; the design wavelength if left out.

    Returns
    -------
    float
        Area [mm^2]; errors as `optics.rays.spots.trace_spots`.
    """
    wave = lens.design_wavelength_nm if wavelength_nm is None else wavelength_nm
    return float(spot_moments(lens, 0.0, 0.0, wave).transmitted_mm2[0, 0])
