"""Chromatic shift of stars: movement of the photocentre with the temperature of a star, against a reference star."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.lens.system import LensSystem
from optics.light.spectrum import Blackbody
from optics.rays.photocentre import photocentre
from optics.rays.spots import QUADRATURE


def stellar_chromatic_shift_mm(
    lens: LensSystem,
    field_x_deg: ArrayLike,
    field_y_deg: ArrayLike,
    *,
    wavelength_nm: FloatArray,
    response: FloatArray,
    temperature_k: Sequence[float],
    reference_k: float,
    order: tuple[int, int] = QUADRATURE,
) -> FloatArray:
    """Photocentres of black-body stars minus that of the reference star at the same field point, by ray trace.

    Parameters
    ----------
    lens : LensSystem
        The focused lens.
    field_x_deg, field_y_deg : (f,)
        Field angles [deg].
    wavelength_nm, response : (w,)
        Wavelengths [nm], and the detected fraction of the photons there times the width of the node, in any unit.
    temperature_k : (t,)
        Temperatures of the stars [K].
    reference_k : float
        Temperature of the reference star [K].
    order : (int, int)
        As in `optics.rays.spots.trace_spots`, whose errors are raised.

    Returns
    -------
    (t, f, 2)
        Shifts [mm] in the image plane, lens frame axes (y against increasing row).
    """
    stars = [Blackbody(temperature_k=kelvin) for kelvin in (*temperature_k, reference_k)]
    spectrum = np.stack([response * star.photon_density(wavelength_nm) for star in stars])
    light = photocentre(lens, field_x_deg, field_y_deg, wavelength_nm, spectrum, order=order)
    position = np.moveaxis(np.stack([light.x_mm, light.y_mm], axis=-1), 1, 0)
    return np.asarray(position[:-1] - position[-1])
