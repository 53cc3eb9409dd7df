"""Lateral colour: shift of the image with wavelength, of the chief ray or of the entire bundle."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.lens.system import LensSystem
from optics.rays.chief_ray import chief_ray_points
from optics.rays.spots import spot_moments


def lateral_colour(
    lens: LensSystem,
    field_x_deg: ArrayLike,
    field_y_deg: ArrayLike,
    wavelength_nm: ArrayLike,
    *,
    reference_nm: float | None = None,
    of: Literal["bundle", "chief"] = "bundle",
) -> tuple[FloatArray, FloatArray]:
    """Shift of the image with wavelength.

    Parameters
    ----------
    lens : LensSystem
        The lens.
    field_x_deg, field_y_deg : (f,)
        Field angles [deg].
    wavelength_nm : (w,)
        Wavelengths [nm].
    reference_nm : float, optional
        Wavelength of zero shift; the design wavelength if left out.
    of : {"bundle", "chief"}
        Mean of the ray bundle, or chief ray.

    Returns
    -------
    dx_mm, dy_mm : (f, w)
        Shift in the image plane [mm].
    """
    reference = lens.design_wavelength_nm if reference_nm is None else reference_nm
    waves = np.append(np.atleast_1d(np.asarray(wavelength_nm, float)), reference)
    if of == "chief":
        fx, fy = (np.atleast_1d(np.asarray(v, float))[:, None] for v in (field_x_deg, field_y_deg))
        x, y = chief_ray_points(lens, fx, fy, waves)
    elif of == "bundle":
        moments = spot_moments(lens, field_x_deg, field_y_deg, waves)
        x, y = moments.x_mm, moments.y_mm
    else:
        raise DomainError(f"lateral colour of {of!r}; 'bundle' or 'chief' is needed")
    return x[:, :-1] - x[:, -1:], y[:, :-1] - y[:, -1:]
