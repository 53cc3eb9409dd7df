r"""Zodiacal light: sunlight scattered by the dust between the planets, over the sky and over wavelength.

C. Leinert et al., "The 1997 reference of diffuse night sky brightness", A&AS 127, 1 (1998): table 17 gives the radiance
at 500 nm seen from the Earth over longitude from the Sun and latitude of the ecliptic; section 8.4.2 its spectrum,

.. math:: I(\lambda) = I(500\,nm) \frac{S(\lambda)}{S(500\,nm)} f_{co}, \qquad f_{co} = 1 + a \log_{10}
          \frac{\lambda}{500\,nm}

with the Sun's spectrum S and, eq. 22, a = 1.2 (below 500 nm) or 0.8 (above) within 30 deg of the Sun, 0.9 or 0.6 at
90 deg and beyond, linear between; for 220 ... 2500 nm. The pole has 60 S10, 77 in the units of the table. Away from
1 au the radiance goes as r^-2.3 (C. Leinert et al., A&A 103, 177 (1981): Helios, 0.3 ... 1 au).

The table holds for a cloud symmetric about the ecliptic and the mean of the year; the real plane of symmetry is
inclined by 3 deg (C. Leinert et al., A&A 82, 328 (1980)), and the seasons that follow from it are not in here. Within
15 deg of the Sun the table has no values, and there are none here.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from render.sky.sunlight import sun_spectrum, sunlight

CLOSEST_DEG = 15.0
"""Angle from the Sun at which the table ends."""

_OBLIQUITY_RAD = math.radians(84381.406 / 3600.0)  # mean obliquity of J2000, IAU 2006
_LONGITUDE_DEG = (0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 60, 75, 90, 105, 120, 135, 150, 165, 180)
_LATITUDE_DEG = (0, 5, 10, 15, 20, 25, 30, 45, 60, 75, 90)
_POLE = 77
_NONE = 0
# 1e-8 W m^-2 sr^-1 um^-1 at 500 nm; a row for each longitude
_TABLE_17 = (
    (_NONE, _NONE, _NONE, 3140, 1610, 985, 640, 275, 150, 100),
    (_NONE, _NONE, _NONE, 2940, 1540, 945, 625, 271, 150, 100),
    (_NONE, _NONE, 4740, 2470, 1370, 865, 590, 264, 148, 100),
    (11500, 6780, 3440, 1860, 1110, 755, 525, 251, 146, 100),
    (6400, 4480, 2410, 1410, 910, 635, 454, 237, 141, 99),
    (3840, 2830, 1730, 1100, 749, 545, 410, 223, 136, 97),
    (2480, 1870, 1220, 845, 615, 467, 365, 207, 131, 95),
    (1650, 1270, 910, 680, 510, 397, 320, 193, 125, 93),
    (1180, 940, 700, 530, 416, 338, 282, 179, 120, 92),
    (910, 730, 555, 442, 356, 292, 250, 166, 116, 90),
    (505, 442, 352, 292, 243, 209, 183, 134, 104, 86),
    (338, 317, 269, 227, 196, 172, 151, 116, 93, 82),
    (259, 251, 225, 193, 166, 147, 132, 104, 86, 79),
    (212, 210, 197, 170, 150, 133, 119, 96, 82, 77),
    (188, 186, 177, 154, 138, 125, 113, 90, 77, 74),
    (179, 178, 166, 147, 134, 122, 110, 90, 77, 73),
    (179, 178, 165, 148, 137, 127, 116, 96, 79, 72),
    (196, 192, 179, 165, 151, 141, 131, 104, 82, 72),
    (230, 212, 195, 178, 163, 148, 134, 105, 83, 72),
)
_UNIT = 1e-17  # W mm^-2 sr^-1 nm^-1 in a unit of the table
_DISTANCE_EXPONENT, _NEAREST_AU, _FARTHEST_AU = -2.3, 0.3, 1.1


def ecliptic_from_icrs() -> FloatArray:
    """Rotation (3, 3) from icrs to the mean ecliptic of J2000 (the frame bias, 0.02 arcsec, left out)."""
    c, s = math.cos(_OBLIQUITY_RAD), math.sin(_OBLIQUITY_RAD)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def _continued(table: FloatArray) -> FloatArray:
    """The table with its blank corner filled in by power laws of the angle from the Sun.

    Of what is filled in, only what touches cells of the table takes part in values handed out, and those lie within a
    degree of the blank corner.
    """
    filled = table.copy()
    longitude, latitude = np.radians(_LONGITUDE_DEG), np.radians(_LATITUDE_DEG)
    angle = np.arccos(np.outer(np.cos(longitude), np.cos(latitude)))
    for row in (0, 1):  # inwards along the latitude
        filled[row, 2] = _power_law(angle[row, 2], angle[row, 3:5], filled[row, 3:5])
    for column in (0, 1, 2):  # inwards along the longitude
        for row in (2, 1, 0):
            if filled[row, column] == _NONE:
                at = max(angle[row, column], math.radians(5.0))
                filled[row, column] = _power_law(
                    at, angle[row + 1 : row + 3, column], filled[row + 1 : row + 3, column]
                )
    return filled


def _power_law(at: float, angle: FloatArray, value: FloatArray) -> float:
    slope = math.log(value[1] / value[0]) / math.log(angle[1] / angle[0])
    return float(value[0] * (at / angle[0]) ** slope)


@cache
def _log_radiance() -> FloatArray:
    """Logarithm of the table on a grid of 1 deg, (181, 91): monotone cubics, level at the axes of symmetry."""
    from scipy.interpolate import PchipInterpolator

    table = np.full((len(_LONGITUDE_DEG), len(_LATITUDE_DEG)), float(_POLE))
    table[:, :-1] = _TABLE_17
    logs = np.log(_continued(table))
    longitude, latitude = np.array(_LONGITUDE_DEG, float), np.array(_LATITUDE_DEG, float)
    turned = np.concatenate([-longitude[:0:-1], longitude, 360.0 - longitude[-2::-1]])
    logs = PchipInterpolator(turned, np.concatenate([logs[:0:-1], logs, logs[-2::-1]]))(np.arange(181.0))
    mirrored = np.concatenate([-latitude[:0:-1], latitude])
    both = np.concatenate([logs[:, :0:-1], logs], axis=1)
    fine: FloatArray = PchipInterpolator(mirrored, both, axis=1)(np.arange(91.0))
    fine.setflags(write=False)
    return fine


def _at_500_nm(longitude_deg: FloatArray, latitude_deg: FloatArray) -> FloatArray:
    """Table 17 [1e-8 W m^-2 sr^-1 um^-1] at longitudes 0 ... 180 and latitudes 0 ... 90 deg."""
    logs = _log_radiance()
    i = np.minimum(longitude_deg.astype(np.intp), 179)
    j = np.minimum(latitude_deg.astype(np.intp), 89)
    u, v = longitude_deg - i, latitude_deg - j
    low = logs[i, j] * (1.0 - v) + logs[i, j + 1] * v
    high = logs[i + 1, j] * (1.0 - v) + logs[i + 1, j + 1] * v
    return np.asarray(np.exp(low * (1.0 - u) + high * u))


def _colour(wavelength_nm: FloatArray, angle_deg: FloatArray) -> FloatArray:
    """Reddening factor (n, k), Leinert eq. 22."""
    fraction = np.clip((angle_deg - 30.0) / 60.0, 0.0, 1.0)[:, None]
    within_30 = np.where(wavelength_nm < 500.0, 1.2, 0.8)
    beyond_90 = np.where(wavelength_nm < 500.0, 0.9, 0.6)
    return np.asarray(1.0 + (within_30 + (beyond_90 - within_30) * fraction) * np.log10(wavelength_nm / 500.0))


def zodiacal_radiance(direction: ArrayLike, *, from_sun_au: ArrayLike, wavelength_nm: ArrayLike) -> FloatArray:
    """Radiance of the zodiacal light."""
    # direction (n, 3), from_sun_au (3,) [au], wavelength_nm (k,) [nm] -> (n, k)
    v, sun_to_observer = np.asarray(direction, np.float64), np.asarray(from_sun_au, np.float64)
    wave = np.atleast_1d(np.asarray(wavelength_nm, np.float64))
    if v.ndim != 2 or v.shape[1] != 3 or sun_to_observer.shape != (3,) or wave.ndim != 1:
        raise DomainError(
            f"directions (n, 3), a place (3,) and wavelengths (k,) are needed, got {v.shape}, "
            f"{sun_to_observer.shape} and {wave.shape}"
        )
    distance = float(np.linalg.norm(sun_to_observer))
    if not _NEAREST_AU <= distance <= _FARTHEST_AU:
        raise DomainError(
            f"the observer is {distance:g} au from the Sun; the zodiacal light is known for {_NEAREST_AU} ... "
            f"{_FARTHEST_AU} au"
        )
    turn = ecliptic_from_icrs()
    x, y, z = np.clip(v @ turn.T, -1.0, 1.0).T
    sun = turn @ (-sun_to_observer / distance)
    angle = np.degrees(np.arccos(np.clip(x * sun[0] + y * sun[1] + z * sun[2], -1.0, 1.0)))
    if len(v) and angle.min() < CLOSEST_DEG - 1e-6:
        raise DomainError(
            f"a direction lies {angle.min():.1f} deg from the Sun; zodiacal light is known from {CLOSEST_DEG:g} deg "
            "on: point elsewhere or leave it out"
        )
    longitude = np.degrees(np.arctan2(y, x) - math.atan2(sun[1], sun[0]))
    longitude = np.abs((longitude + 180.0) % 360.0 - 180.0)
    watt = _at_500_nm(longitude, np.degrees(np.arcsin(np.abs(z)))) * (_UNIT * distance**_DISTANCE_EXPONENT)
    photons = sunlight(wave) / float(sun_spectrum().value[_index_500()])  # per W mm^-2 nm^-1 at 500 nm
    return np.asarray(watt[:, None] * photons * _colour(wave, angle))


@cache
def _index_500() -> int:
    return int(np.flatnonzero(sun_spectrum().wavelength_nm == 500.0)[0])
