"""The Moon's face: direction of its axes, and a map of its albedo with the maria.

Axes: B. A. Archinal et al., Celestial Mechanics and Dynamical Astronomy 130, 22 (2018), table 2 (that of the 2009
report), right to some 0.01 deg; libration follows from them and the observer's position. The map is made by a program,
not by a camera: highland and mare have the normal albedos 0.135 and 0.07 (Lunar Sourcebook, G. H. Heiken et al. 1991,
sec. 3), maria are circles of the IAU's gazetteer with edges roughened at random, four young craters have rays.
Positions are accurate to a few degrees; no feature is a landmark.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.records import locked

MARE, HIGHLAND = 0.07, 0.135
MOON_KM = 1737.4
# longitude east, latitude [deg], radius [km]
MARIA = (
    (-16, 34, 540), (17, 28, 330), (30, 9, 400), (59, 17, 240), (51, -7, 370), (35, -15, 170), (-17, -20, 340),
    (-39, -24, 210), (-56, 20, 560), (-48, 2, 480), (-60, 40, 300), (0, 56, 180), (-30, 57, 200), (25, 56, 160),
    (3, 13, 130), (-5, 3, 120), (-10, -5, 200), (86, 0, 160), (-22, -10, 260),
)  # fmt: skip
RAYED = ((-11.4, -43.3, 85, 1500), (-20.1, 9.6, 93, 500), (-38.0, 8.1, 31, 350), (-47.5, 23.7, 40, 300))
"""Tycho, Copernicus, Kepler, Aristarchus: longitude, latitude [deg], diameter, reach of the rays [km]."""
FAR_SIDE = ((147, 27, 140), (164, -34, 160), (129, -20, 90), (-95, -20, 160))
"""Moscoviense, Ingenii, Tsiolkovskiy, Orientale."""
CELL_DEG = 0.5

# E1 to E13 at J2000 [deg], their rates [deg/d]
_ARGUMENT = np.array(
    [
        (125.045, -0.0529921), (250.089, -0.1059842), (260.008, 13.0120009), (176.625, 13.3407154),
        (357.529, 0.9856003), (311.589, 26.4057084), (134.963, 13.0649930), (276.617, 0.3287146),
        (34.226, 1.7484877), (15.134, -0.1589763), (119.743, 0.0036096), (239.961, 0.1643573), (25.053, 12.9590088),
    ]
)  # fmt: skip
_POLE_RA = np.array([-3.8787, -0.1204, 0.0700, -0.0172, 0, 0.0072, 0, 0, 0, -0.0052, 0, 0, 0.0043])
_POLE_DEC = np.array([1.5419, 0.0239, -0.0278, 0.0068, 0, -0.0029, 0.0009, 0, 0, 0.0008, 0, 0, -0.0009])
_TURN = np.array(
    [
        3.5610, 0.1208, -0.0642, 0.0158, 0.0252, -0.0066, -0.0047, -0.0046, 0.0028, 0.0052, 0.0040, 0.0019, -0.0044,
    ]
)  # fmt: skip


def moon_rotation(epoch_year: float) -> FloatArray:
    """Attitude of the Moon (3, 3), icrs from body: x through the mean middle of the near side, z its north pole."""
    days = (epoch_year - 2000.0) * 365.25
    centuries = days / 36525.0
    e = np.radians(_ARGUMENT[:, 0] + _ARGUMENT[:, 1] * days)
    ra = 269.9949 + 0.0031 * centuries + _POLE_RA @ np.sin(e)
    dec = 66.5392 + 0.0130 * centuries + _POLE_DEC @ np.cos(e)
    turn = 38.3213 + 13.17635815 * days - 1.4e-12 * days**2 + _TURN @ np.sin(e)
    return np.asarray(Rotation.from_euler("ZXZ", [ra + 90.0, 90.0 - dec, turn], degrees=True).as_matrix())


@cache
def lunar_map() -> NDArray[np.float32]:
    """Normal albedo (latitudes from south to north, longitudes from -180 deg on) at the centres of cells of 0.5 deg."""
    latitude = np.radians(np.arange(-90.0 + CELL_DEG / 2, 90.0, CELL_DEG))[:, None]
    longitude = np.radians(np.arange(-180.0 + CELL_DEG / 2, 180.0, CELL_DEG))
    v = _unit_vector(longitude, latitude)
    rng = np.random.default_rng(11)
    edge = sum(size * _noise(v, rng, frequency) for size, frequency in ((0.18, 7.0), (0.14, 17.0), (0.09, 45.0)))
    depth = np.full(v.shape[:-1], -np.inf)
    for lon, lat, radius in MARIA + FAR_SIDE:
        depth = np.maximum(depth, 1.0 - _distance_km(v, lon, lat) / radius)
    mare = 1.0 / (1.0 + np.exp(-(depth + edge) / 0.05))
    albedo = HIGHLAND + (MARE - HIGHLAND) * mare
    albedo *= 1.0 + 0.07 * _noise(v, rng, 12.0) + 0.05 * _noise(v, rng, 45.0)
    for ray_lon, ray_lat, diameter, reach in RAYED:
        away = _distance_km(v, ray_lon, ray_lat)
        albedo *= 1.0 + 0.7 * np.exp(-((away / diameter) ** 2)) + 0.25 * np.exp(-away / (0.5 * reach))
    return locked(albedo.astype(np.float32))


def _unit_vector(longitude_rad: FloatArray, latitude_rad: FloatArray) -> FloatArray:
    a, b = np.broadcast_arrays(longitude_rad, latitude_rad)
    return np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], axis=-1)


def _distance_km(v: FloatArray, longitude_deg: float, latitude_deg: float) -> FloatArray:
    to = _unit_vector(np.radians(longitude_deg), np.radians(latitude_deg))
    return np.asarray(np.arccos(np.clip(v @ to, -1.0, 1.0)) * MOON_KM)


def _noise(v: FloatArray, rng: np.random.Generator, frequency: float, waves: int = 24) -> FloatArray:
    """Smooth random field of unit variance with features of about 1/frequency rad."""
    total = np.zeros(v.shape[:-1])
    for k, phase in zip(rng.normal(size=(waves, 3)) * frequency, rng.uniform(0.0, 2.0 * np.pi, waves), strict=True):
        total += np.cos(v @ k + phase)
    return np.asarray(np.sqrt(2.0 / waves) * total)
