r"""Brightness of the planets and the Moon: V against distance and phase, and the colour of their light.

Planets: A. Mallama and J. L. Hilton, "Computing apparent planetary magnitudes for The Astronomical Almanac", Astronomy
and Computing 25, 10 (2018), eq. 2-17, :math:`V = V_1(\alpha) + 5 \log_{10} (r \Delta)` with r and :math:`\Delta` in au.
The dependence on rotation and season of Mars (their tables of 0.06 and 0.09 mag at most) is neglected. Outside the
range of the equations V is NaN: Mercury and Venus beyond 179 deg, Mars beyond 120, Jupiter beyond 130, Saturn (with its
rings) beyond 6.5, Neptune beyond 133 or, before 2000, beyond 1.9 deg, where no observations exist.

Earth: T. D. Robinson, Planet. Sci. J. 7, 12 (2026; arXiv:2507.22258), eq. 14: 0.23 as geometric albedo and a
Henyey-Greenstein function of -0.33, fitted to what was seen from ground and spacecraft at 5 to 144 deg (400 to
700 nm, here taken for V). Up to 90 deg it is 0.6 to 0.9 mag fainter than eq. 5 of Mallama and Hilton, whose Bond albedo
is 0.57; here it is 0.31, and earthshine measures 0.297 (P. R. Goode et al., Geophys. Res. Lett. 28, 1671 (2001)).

Moon: `render.bodies.lunar_irradiance`.

Colours: geometric albedos of A. Mallama, B. Krobusek and H. Pavlov, Icarus 282, 19 (2017), table 7, Johnson-Cousins;
the Moon's as a point from the disk reflectance at 30 deg of H. H. Kieffer and T. C. Stone, AJ 129, 2887 (2005), table
4, as a parabola through its logarithms. They are taken at the effective wavelengths of the bands, linear between.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy import constants

from optics.arrays import FloatArray
from optics.errors import unknown_name
from optics.light.spectrum import TabulatedSed
from render.bodies.lunar_irradiance import moon_reflectance
from render.sky.sunlight import sun_spectrum

ALBEDO_NM = (360.0, 436.0, 549.0, 641.0, 700.0, 798.0, 900.0)  # U, B, V, Rc, R, Ic, I
ALBEDO = {
    "mercury": (0.087, 0.105, 0.142, 0.158, 0.172, 0.180, 0.208),
    "venus": (0.348, 0.658, 0.689, 0.658, 0.708, 0.640, 0.584),
    "earth": (0.688, 0.512, 0.434, 0.392, 0.418, 0.396, 0.430),
    "moon": (0.070, 0.092, 0.120, 0.140, 0.151, 0.168, 0.182),
    "mars": (0.060, 0.088, 0.170, 0.250, 0.288, 0.285, 0.330),
    "jupiter": (0.358, 0.443, 0.538, 0.513, 0.495, 0.389, 0.321),
    "saturn": (0.203, 0.339, 0.499, 0.646, 0.568, 0.543, 0.423),
    "uranus": (0.502, 0.561, 0.488, 0.264, 0.202, 0.089, 0.079),
    "neptune": (0.578, 0.562, 0.442, 0.226, 0.181, 0.072, 0.067),
}
"""Geometric albedo of each body at `ALBEDO_NM`; only the shape counts where a magnitude sets the scale."""

_SUN_V = -26.76  # C. N. A. Willmer, ApJS 236, 47 (2018), table 3
_V_NM = 549.0
_EARTH_AU, _MOON_AU = 6371.0084e3 / constants.au, 1737.4e3 / constants.au  # radii
# north poles in icrs (right ascension, declination [deg]) and flattening: B. A. Archinal et al., Celestial Mechanics
# and Dynamical Astronomy 130, 22 (2018), tables 1 and 4
_SATURN_POLE_DEG = (40.589, 83.537)
_URANUS_POLE_DEG, _URANUS_FLATTENING = (257.311, -15.175), 0.02293


def _mercury(a: float) -> float:
    if a > 179.0:
        return math.nan
    return _polynomial(a, -0.613, 6.3280e-02, -1.6336e-03, 3.3644e-05, -3.4265e-07, 1.6893e-09, -3.0334e-12)


def _venus(a: float) -> float:
    if a > 179.5:
        return math.nan
    if a <= 163.7:
        return _polynomial(a, -4.384, -1.044e-03, 3.687e-04, -2.814e-06, 8.938e-09)
    return _polynomial(a, 236.05828, -2.81914, 8.39034e-03)


def _earth(a: float) -> float:
    if a > 144.0:
        return math.nan
    g = -0.33
    phase = ((1.0 + g) ** 2 / (1.0 + g**2 + 2.0 * g * math.cos(math.radians(a)))) ** 1.5
    return _SUN_V - 2.5 * math.log10(0.23 * phase * _EARTH_AU**2)


def _moon(to_sun: FloatArray, to_observer: FloatArray, epoch_year: float) -> float:
    reflectance = moon_reflectance(_V_NM, to_sun=to_sun, to_observer=to_observer, epoch_year=epoch_year)
    return _SUN_V - 2.5 * float(np.log10(reflectance * _MOON_AU**2))


def _mars(a: float) -> float:
    if a > 120.0:
        return math.nan
    return _polynomial(a, -1.601, 2.267e-02, -1.302e-04) if a <= 50.0 else _polynomial(a, -0.367, -0.02573, 3.445e-4)


def _jupiter(a: float) -> float:
    if a > 130.0:
        return math.nan
    if a <= 12.0:
        return _polynomial(a, -9.395, -3.7e-04, 6.16e-04)
    return -9.428 - 2.5 * math.log10(_polynomial(a / 180.0, 1.0, -1.507, -0.363, -0.062, 2.809, -1.876))


def _saturn(a: float, to_sun: FloatArray, to_observer: FloatArray) -> float:
    latitudes = [_latitude_deg(v, _SATURN_POLE_DEG) for v in (to_sun, to_observer)]
    ring = math.sqrt(max(latitudes[0] * latitudes[1], 0.0))  # lit from behind it gives nothing
    if a > 6.5 or ring > 27.0:
        return math.nan
    tilt = math.sin(math.radians(ring))
    return -8.914 - 1.825 * tilt + 0.026 * a - 0.378 * tilt * math.exp(-2.25 * a)


def _uranus(a: float, to_sun: FloatArray, to_observer: FloatArray) -> float:
    stretch = (1.0 - _URANUS_FLATTENING) ** -2  # planetographic latitudes
    graphic = [
        math.degrees(math.atan(stretch * math.tan(math.radians(_latitude_deg(v, _URANUS_POLE_DEG)))))
        for v in (to_sun, to_observer)
    ]
    v = -7.110 - 8.4e-04 * (abs(graphic[0]) + abs(graphic[1])) / 2.0
    return math.nan if a > 154.0 else v + (_polynomial(a, 0.0, 6.587e-3, 1.045e-4) if a > 3.1 else 0.0)


def _neptune(a: float, year: float) -> float:
    v = -6.89 - 0.0054 * min(max(year - 1980.0, 0.0), 20.0) if year <= 2000.0 else -7.00
    if a <= 1.9:
        return v
    return math.nan if year <= 2000.0 or a > 133.14 else v + _polynomial(a, 0.0, 7.944e-3, 9.617e-5)


def _polynomial(x: float, *coefficients: float) -> float:
    total = 0.0
    for c in reversed(coefficients):
        total = total * x + c
    return total


def _latitude_deg(direction: FloatArray, pole_deg: tuple[float, float]) -> float:
    """Planetocentric latitude of the point from which a direction (icrs, any length) leaves."""
    ra, dec = (math.radians(v) for v in pole_deg)
    pole = np.array([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])
    return math.degrees(math.asin(max(-1.0, min(1.0, float(pole @ direction) / float(np.linalg.norm(direction))))))


def planet_v(name: str, *, to_sun_au: FloatArray, to_observer_au: FloatArray, epoch_year: float) -> float:
    """V magnitude of a planet or the Moon."""
    # to_sun_au, to_observer_au (3,) [au]
    if name not in ALBEDO:
        raise unknown_name("body of the solar system", name, ALBEDO)
    to_sun, to_observer = np.asarray(to_sun_au, float), np.asarray(to_observer_au, float)
    r, delta = float(np.linalg.norm(to_sun)), float(np.linalg.norm(to_observer))
    a = math.degrees(math.acos(max(-1.0, min(1.0, float(to_sun @ to_observer) / (r * delta)))))
    by_phase = {"mercury": _mercury, "venus": _venus, "earth": _earth, "mars": _mars, "jupiter": _jupiter}
    if name in by_phase:
        v = by_phase[name](a)
    elif name == "neptune":
        v = _neptune(a, epoch_year)
    elif name == "moon":
        v = _moon(to_sun, to_observer, epoch_year)
    else:
        v = {"saturn": _saturn, "uranus": _uranus}[name](a, to_sun, to_observer)
    return v + 5.0 * math.log10(r * delta)


@cache
def planet_spectrum(name: str) -> TabulatedSed:
    """Spectrum of the light reflected by a body, in arbitrary scale: sunlight times the albedo."""
    if name not in ALBEDO:
        raise unknown_name("body of the solar system", name, ALBEDO)
    sun = sun_spectrum()
    return TabulatedSed(
        name=name,
        source=f"{sun.source}; albedo after Mallama et al. 2017 or, of the Moon, Kieffer and Stone 2005",
        wavelength_nm=sun.wavelength_nm,
        value=sun.value * np.interp(sun.wavelength_nm, ALBEDO_NM, ALBEDO[name]),
        quantity="power",
    )
