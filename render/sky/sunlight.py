"""The Sun as a source of light: its spectrum outside the atmosphere, at any distance.

ASTM G173-03, extraterrestrial column, in steps of 5 nm (`docs/make_solar_spectrum.py`). Through the passbands of
`optics.light.magnitudes` it has V = -26.76, as C. N. A. Willmer, ApJS 236, 47 (2018), table 3 gives it.
"""

from __future__ import annotations

import io
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.light.spectrum import TabulatedSed

SUN_RADIUS_KM = 695_700.0
"""Nominal solar radius, IAU 2015 resolution B3."""


@cache
def sun_spectrum() -> TabulatedSed:
    """Spectral irradiance of the Sun at 1 au, 285 to 1300 nm; W mm^-2 nm^-1, so photon densities are absolute."""
    text = files("render").joinpath("data", "solar_spectrum.csv").read_text(encoding="utf-8")
    table = np.loadtxt(io.StringIO(text), delimiter=",")
    return TabulatedSed(
        name="Sun",
        source="ASTM G173-03, extraterrestrial",
        wavelength_nm=table[:, 0],
        value=table[:, 1] * 1e-6,  # W m^-2 -> W mm^-2
        quantity="power",
    )


def sunlight(wavelength_nm: ArrayLike, *, distance_au: float = 1.0) -> FloatArray:
    """Photons s^-1 mm^-2 nm^-1 that the Sun sends through an area facing it."""
    if not 0.0 < distance_au < np.inf:
        raise DomainError(f"distance from the Sun = {distance_au} au; it must be positive and finite")
    return sun_spectrum().photon_density(wavelength_nm) / distance_au**2
