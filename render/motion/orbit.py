"""Orbits about the Earth, axes of icrs: Kepler's ellipse, two-line elements; attitude fixed to the local vertical."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError

EARTH_RADIUS_KM = 6378.137
"""Equatorial radius, WGS 84."""
GM_KM3_PER_S2 = 398600.4418
"""Of the Earth, WGS 84."""
NEWTON_STEPS = 30

State = Callable[[ArrayLike], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Orbit:
    """An orbit about the centre of the Earth; made by `kepler_orbit` or `sgp4_orbit`."""

    state: State  # Position (..., 3) [km] and velocity (..., 3) [km/s] at times (...) after the epoch [s]
    period_s: float
    epoch_year: float  # Julian year of time 0

    @property
    def pole(self) -> FloatArray:
        """Direction (3,) of the angular momentum at time 0."""
        momentum = np.cross(*self.state(0.0))
        return np.asarray(momentum / np.linalg.norm(momentum))

    def local_vertical(self, time_s: ArrayLike, off_zenith_deg: float = 0.0) -> Rotation:
        """Attitudes (n,), cam from icrs: boresight from the zenith towards the pole, columns against the flight."""
        position, _ = self.state(time_s)
        zenith = position / np.linalg.norm(position, axis=-1, keepdims=True)
        tilt = math.radians(off_zenith_deg)
        boresight = math.cos(tilt) * zenith + math.sin(tilt) * self.pole
        backward = -np.cross(self.pole, zenith)
        return Rotation.from_matrix(np.stack([backward, np.cross(boresight, backward), boresight], axis=-2))


def kepler_orbit(
    *,
    perigee_km: float,
    eccentricity: float,
    inclination_deg: float,
    node_deg: float,
    perigee_deg: float,
    anomaly_deg: float,
    epoch_year: float,
) -> Orbit:
    """Ellipse of the two-body problem, in axes of the equator of J2000 (icrs to 0.02 arcsec).

    Height of the perigee above `EARTH_RADIUS_KM`; inclination to the equator, right ascension of the ascending node,
    argument of the perigee; mean anomaly at the epoch, the Julian year of time 0.
    """
    e = eccentricity
    if not 0.0 <= e < 1.0:
        raise DomainError(f"eccentricity = {e:g}; an ellipse has 0 <= eccentricity < 1")
    a = (EARTH_RADIUS_KM + perigee_km) / (1.0 - e)
    motion = math.sqrt(GM_KM3_PER_S2 / a**3)
    angles = [math.radians(angle) for angle in (node_deg, inclination_deg, perigee_deg)]
    # towards the perigee, and 90 deg further along the orbit
    axes = Rotation.from_euler("ZXZ", angles).as_matrix().T[:2]

    def state(time_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        mean = math.radians(anomaly_deg) + motion * np.asarray(time_s, float)
        eccentric = mean + e * np.sin(mean)
        for _ in range(NEWTON_STEPS):  # Kepler's equation
            eccentric = eccentric - (eccentric - e * np.sin(eccentric) - mean) / (1.0 - e * np.cos(eccentric))
        cos, sin, flat = np.cos(eccentric), np.sin(eccentric), math.sqrt(1.0 - e * e)
        speed = a * motion / (1.0 - e * cos)
        position = np.stack([a * (cos - e), a * flat * sin], axis=-1)
        velocity = np.stack([-speed * sin, speed * flat * cos], axis=-1)
        return position @ axes, velocity @ axes

    return Orbit(state=state, period_s=2.0 * math.pi / motion, epoch_year=epoch_year)


def sgp4_orbit(first: str, second: str) -> Orbit:
    """Two-line elements by SGP4, from their epoch on (package sgp4: `ConfigError`).

    `DomainError` on damaged elements, and from the state of an orbit that leads into the ground.
    """
    import erfa

    try:
        from sgp4 import io
        from sgp4.api import SGP4_ERRORS, Satrec
    except ModuleNotFoundError:
        raise ConfigError(
            "two-line elements need the package sgp4; pip install 'starbench[orbit]', or give perigee and angles"
        ) from None
    try:
        io.verify_checksum(first, second)
        satellite = Satrec.twoline2rv(first, second)
    except ValueError as error:
        raise DomainError(f"two-line elements: {' '.join(str(error).split())}") from None
    days = satellite.jdsatepoch, satellite.jdsatepochF
    # true equator and mean equinox of date, which SGP4 uses, to icrs; it turns by 0.01 arcsec in an orbit
    equinox = Rotation.from_euler("z", erfa.eqeq94(*days)).as_matrix()
    icrs_from_date = erfa.pnm06a(*days).T @ equinox

    def state(time_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        time = np.asarray(time_s, float)
        fraction = days[1] + time.ravel() / 86400.0
        failed, position, velocity = satellite.sgp4_array(np.full(fraction.shape, days[0]), fraction)
        if failed.any():
            raise DomainError(f"two-line elements: {SGP4_ERRORS[int(failed[failed > 0][0])]}")
        position, velocity = ((v @ icrs_from_date.T).reshape(*time.shape, 3) for v in (position, velocity))
        return position, velocity

    period_s = 120.0 * math.pi / satellite.no_kozai
    return Orbit(state=state, period_s=period_s, epoch_year=2000.0 + (sum(days) - 2451545.0) / 365.25)


def in_shadow(position_km: ArrayLike, sun: ArrayLike, radius_km: float = EARTH_RADIUS_KM) -> NDArray[np.bool_]:
    """Whether (...,) positions (..., 3) about a body lie in its cylinder of shadow; ``sun``: unit vector (3,)."""
    position, towards = np.asarray(position_km, float), np.asarray(sun, float)
    along = position @ towards
    across = np.linalg.norm(position - along[..., None] * towards, axis=-1)
    return np.asarray((along < 0.0) & (across < radius_km))


def limb_angle_deg(direction: ArrayLike, position_km: ArrayLike, radius_km: float = EARTH_RADIUS_KM) -> FloatArray:
    """Angle (...,) from directions (..., 3) to the limb of a body at the origin; negative within its disk."""
    position = np.asarray(position_km, float)
    distance = np.linalg.norm(position, axis=-1)
    angle = np.arccos(np.clip(-(np.asarray(direction) * position).sum(-1) / distance, -1.0, 1.0))
    return np.asarray(np.degrees(angle - np.arcsin(np.minimum(radius_km / distance, 1.0))))
