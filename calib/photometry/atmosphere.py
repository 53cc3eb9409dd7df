"""The atmosphere above a site: zenith, refraction, air mass.

Earth rotation is that of ERFA (``c2t06a``), with UTC for UT1 (0.9 s, 14 arcsec).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import erfa
import numpy as np
from astropy.time import Time
from scipy.optimize import least_squares

from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD, RAD_DEG

LOWEST_COSINE = 0.17
"""Below 10 deg of altitude refraction is not proportional to tan z."""
FEWEST_POINTINGS = 4
LARGEST_SCATTER_DEG, LARGEST_ERROR_RAD = 1.0, 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteZenith:
    """The zenith of a site, stated or fitted to altitudes of pointings."""

    direction: FloatArray  # (n, 3) Unit vectors in icrs at the times of the frames
    latitude_deg: float
    longitude_deg: float
    error_deg: float = 0.0  # Standard deviation of latitude and of longitude; 0 where stated
    offset_deg: float = 0.0  # True minus stated altitude
    scatter_deg: float = 0.0  # Of the stated altitudes about the fit


def earth_rotation(taken: datetime) -> FloatArray:
    """Rotation matrix (3, 3), terrestrial from celestial axes, at a time in UTC."""
    time = Time(taken.replace(tzinfo=None), scale="utc")
    return np.asarray(erfa.c2t06a(time.tt.jd1, time.tt.jd2, time.utc.jd1, time.utc.jd2, 0.0, 0.0))


def zenith_directions(latitude_deg: float, longitude_deg: float, taken: Sequence[datetime]) -> FloatArray:
    """Unit vectors (n, 3) in icrs towards the zenith of a site at n times (UTC)."""
    vertical = _vertical(*np.radians([latitude_deg, longitude_deg]))
    return np.stack([earth_rotation(time).T @ vertical for time in taken])


def _vertical(latitude_rad: float, longitude_rad: float) -> FloatArray:
    cosine = np.cos(latitude_rad)
    return np.array([cosine * np.cos(longitude_rad), cosine * np.sin(longitude_rad), np.sin(latitude_rad)])


def fit_zenith(boresight: FloatArray, altitude_deg: FloatArray, taken: Sequence[datetime]) -> SiteZenith | None:
    """Site at which boresights (n, 3) in icrs have the stated altitudes (n,), up to a common offset.

    The offset contains the angle between mount axis and boresight, and refraction. None for fewer than four pointings,
    for pointings along a line, and for altitudes of another mount (scatter above 1 deg).
    """
    if len(boresight) < FEWEST_POINTINGS:
        return None
    terrestrial = np.stack([earth_rotation(time) @ axis for time, axis in zip(taken, boresight, strict=True)])

    def residual_deg(p: FloatArray) -> FloatArray:
        sine = np.clip(terrestrial @ _vertical(p[0], p[1]), -1.0, 1.0)
        return np.asarray(np.arcsin(sine) * RAD_DEG - altitude_deg - p[2])

    mean = terrestrial.mean(0) / np.linalg.norm(terrestrial.mean(0))
    fit = least_squares(
        residual_deg, [np.arcsin(mean[2]), np.arctan2(mean[1], mean[0]), 0.0], x_scale=[0.01, 0.01, 1.0]
    )
    scatter = float(np.sqrt(2.0 * fit.cost / (len(boresight) - 3)))
    try:
        covariance = np.linalg.inv(fit.jac.T @ fit.jac) * scatter**2
    except np.linalg.LinAlgError:
        return None
    if scatter > LARGEST_SCATTER_DEG or not covariance[0, 0] < LARGEST_ERROR_RAD**2:
        return None
    latitude, longitude = np.degrees(fit.x[:2])
    longitude = (longitude + 180.0) % 360.0 - 180.0
    return SiteZenith(
        direction=zenith_directions(latitude, longitude, taken),
        latitude_deg=float(latitude),
        longitude_deg=float(longitude),
        error_deg=float(np.degrees(np.sqrt(covariance[0, 0]))),
        offset_deg=float(fit.x[2]),
        scatter_deg=scatter,
    )


def refracted(direction: FloatArray, zenith: FloatArray, arcsec: float) -> FloatArray:
    """Apparent directions (n, 3) of true ones (n, 3), raised towards the zenith (3,) by ``arcsec * tan z``.

    58.3 arcsec at sea level; below 10 deg of altitude the value of 10 deg is used.
    """
    cosine = direction @ zenith
    low = np.maximum(cosine, LOWEST_COSINE)
    lift = arcsec * ARCSEC_RAD * np.sqrt(1.0 - np.minimum(low, 1.0) ** 2) / low
    up = zenith - cosine[:, None] * direction
    up /= np.maximum(np.linalg.norm(up, axis=1), 1e-12)[:, None]
    apparent = direction + lift[:, None] * up
    return np.asarray(apparent / np.linalg.norm(apparent, axis=1)[:, None])


def airmass(direction: FloatArray, zenith: FloatArray) -> FloatArray:
    """Relative optical air mass (n,) of directions (n, 3): Kasten and Young, Applied Optics 28, 4735 (1989)."""
    altitude = np.degrees(np.arcsin(np.clip(direction @ zenith, 0.0, 1.0)))
    return np.asarray(1.0 / (np.sin(np.radians(altitude)) + 0.50572 * (altitude + 6.07995) ** -1.6364))
