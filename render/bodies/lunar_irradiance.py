r"""Irradiance of the Moon: the model of the Robotic Lunar Observatory (ROLO).

H. H. Kieffer and T. C. Stone, "The spectral irradiance of the Moon", AJ 129, 2887 (2005), eq. 10 and table 4: the
reflectance A of a flat disk in place of the Moon, lit and seen square on,

.. math:: \ln A = \sum_{i=0}^{3} a_i g^i + \sum_{j=1}^{3} b_j \Phi^{2j-1} + c_1 \theta + c_2 \varphi + c_3 \Phi \theta
   + c_4 \Phi \varphi + d_1 e^{-g/p_1} + d_2 e^{-g/p_2} + d_3 \cos\frac{g - p_3}{p_4}

with the phase angle g (in radians in the polynomial, in degrees elsewhere), the selenographic longitude of the Sun
:math:`\Phi` [rad], latitude and longitude of the observer :math:`\theta, \varphi` [deg]. It was fitted to more than
1000 observations at every wavelength, to 1 %, from 1.55 to 97 deg. The bands err by 4 % against each other and are
replaced by a cubic polynomial of ln A in the logarithm of the wavelength. The scale is 2 to 5 % below that of LIME (C.
Toledano et al., Atmos. Chem. Phys. 24, 3649 (2024)), which is tied to the SI within 2 %.

Unpublished extrapolations: the equation unchanged below 1.55 deg (eclipses, earthshine), the law of C. W. Allen,
Astrophysical Quantities, 3rd ed. (1973), sec. 66, from 97 to 150 deg, joined at 97 deg in its colour, and the nearest
libration for observers who see another side of the Moon than the Earth does.
"""

from __future__ import annotations

import io
import math
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from render.bodies.lunar_map import moon_rotation

LIBRATION_DEG = 8.0
"""Largest libration, about; beyond it the terms of libration are constant."""
FITTED_DEG, KNOWN_DEG = 97.0, 150.0
DEGREE = 3
_C = (0.00034115, -0.0013425, 0.00095906, 0.00066229)
_P = (4.06054, 12.8802, -30.5858, 16.7498)


def moon_reflectance(
    wavelength_nm: ArrayLike, *, to_sun: ArrayLike, to_observer: ArrayLike, epoch_year: float
) -> FloatArray:
    """Reflectance of the Moon's disk, phase and libration included: over that of the Sun, its light is A (R / D)^2."""
    # to_sun, to_observer (3,)
    turn = moon_rotation(epoch_year)
    sun, observer = ((v / np.linalg.norm(v)) @ turn for v in (np.asarray(to_sun), np.asarray(to_observer)))
    phase = math.degrees(math.atan2(float(np.linalg.norm(np.cross(sun, observer))), float(sun @ observer)))
    band_nm, table = _table()
    x = np.log(np.clip(np.asarray(wavelength_nm, float), band_nm[0], band_nm[-1]) / band_nm[0])
    if phase > KNOWN_DEG:
        return np.full(x.shape, np.nan)
    longitude, latitude = math.degrees(math.atan2(observer[1], observer[0])), math.degrees(math.asin(observer[2]))
    elongation = (math.degrees(math.atan2(sun[1], sun[0])) - longitude + 180.0) % 360.0 - 180.0
    longitude, latitude = (max(-LIBRATION_DEG, min(LIBRATION_DEG, v)) for v in (longitude, latitude))
    solar = math.radians(max(-FITTED_DEG, min(FITTED_DEG, elongation)) + longitude)
    g = min(phase, FITTED_DEG)
    libration = _C[0] * latitude + _C[1] * longitude + solar * (_C[2] * latitude + _C[3] * longitude)
    terms = (
        *(math.radians(g) ** i for i in range(4)),
        *(solar**j for j in (1, 3, 5)),
        *(math.exp(-g / p) for p in _P[:2]),
        math.cos((g - _P[2]) / _P[3]),
    )
    log = np.polynomial.polynomial.polyval(x, table @ np.array(terms)) + libration
    return np.asarray(np.exp(log) * 10 ** (-0.4 * (_allen(phase) - _allen(g))))


def _allen(phase_deg: float) -> float:
    """Magnitudes below full Moon."""
    return 0.026 * phase_deg + 4e-9 * phase_deg**4


@cache
def _table() -> tuple[FloatArray, FloatArray]:
    """Wavelengths of the bands [nm]; what brings the terms of ln A to a polynomial in ln wavelength (4, 10)."""
    text = files("render").joinpath("data", "rolo_2005.csv").read_text(encoding="utf-8")
    rows = np.loadtxt(io.StringIO(text), delimiter=",")
    powers = np.vander(np.log(rows[:, 0] / rows[0, 0]), DEGREE + 1, increasing=True)
    return rows[:, 0], np.linalg.pinv(powers) @ rows[:, 1:]
