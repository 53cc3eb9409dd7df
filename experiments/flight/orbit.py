"""Orbit of the sensor: position and velocity, Sun, Moon and Earth, the shadow."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from experiments.flight.settings import OrbitConfig
from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from render.bodies.solar_system import solar_system
from render.catalogue.motion import Observer, earth_observer

EARTH_RADIUS_KM = 6378.137
"""Equatorial radius, WGS 84."""
GM_KM3_PER_S2 = 398600.4418
"""Of the Earth, WGS 84."""
KEPLER_STEPS = 30


@dataclass(frozen=True, kw_only=True, eq=False)
class Orbit:
    """An orbit from an epoch on; made by `build_orbit`. Axes of icrs."""

    # Position (..., 3) [km] and velocity (..., 3) [km/s] about the centre of the Earth, at times (...) [s]
    state: Callable[[ArrayLike], tuple[FloatArray, FloatArray]]
    period_s: float
    epoch_year: float  # Julian year of time 0
    earth: Observer  # Centre of the Earth at time 0
    moon: FloatArray  # (3,) Direction of the Moon from the Earth at time 0

    @property
    def pole(self) -> FloatArray:
        """Direction (3,) of the angular momentum at time 0."""
        spin = np.cross(*self.state(0.0))
        return spin / np.linalg.norm(spin)

    def velocity_km_per_s(self, time_s: ArrayLike) -> FloatArray:
        """Velocity (..., 3) against the barycentre of the solar system."""
        return np.asarray(self.earth.velocity_km_per_s + self.state(time_s)[1])

    @property
    def sun(self) -> FloatArray:
        """Direction (3,) of the Sun from the Earth; it moves by 0.07 deg in an orbit, which is left out."""
        assert self.earth.from_sun_au is not None
        return -self.earth.from_sun_au / np.linalg.norm(self.earth.from_sun_au)

    def shadowed(self, time_s: ArrayLike) -> NDArray[np.bool_]:
        """Whether (...,) the Earth, as a cylinder of shadow, hides the Sun."""
        place, _ = self.state(time_s)
        along = place @ self.sun
        across = np.linalg.norm(place - along[..., None] * self.sun, axis=-1)
        return np.asarray((along < 0.0) & (across < EARTH_RADIUS_KM))

    def earth_limb_deg(self, boresight: FloatArray, time_s: ArrayLike) -> FloatArray:
        """Angle (...,) from directions (..., 3) to the limb of the Earth; negative within its disk."""
        place, _ = self.state(time_s)
        distance = np.linalg.norm(place, axis=-1)
        angle = np.arccos(np.clip(-(boresight * place).sum(-1) / distance, -1.0, 1.0))
        return np.asarray(np.degrees(angle - np.arcsin(np.minimum(EARTH_RADIUS_KM / distance, 1.0))))


def build_orbit(config: OrbitConfig, epoch_year: float) -> Orbit:
    """The orbit at an epoch: that of the two-line elements, where the configuration has them.

    Raises
    ------
    ConfigError
        Two-line elements without the package sgp4.
    DomainError
        An epoch beyond the ephemeris of the Earth; elements that are damaged or lead into the ground.
    """
    if config.tle:
        state, period_s, epoch_year = _propagated(*config.tle)
    else:
        state, period_s = _kepler(config)
    moon = solar_system(epoch_year, bodies=("moon",)).direction[0]
    return Orbit(
        state=state,
        period_s=period_s,
        epoch_year=epoch_year,
        earth=earth_observer(epoch_year),
        moon=np.array(moon),
    )


def _kepler(config: OrbitConfig) -> tuple[Callable[[ArrayLike], tuple[FloatArray, FloatArray]], float]:
    """Kepler's orbit in axes of the equator of J2000, icrs to 0.02 arcsec; and its period."""
    e, a = config.eccentricity, (EARTH_RADIUS_KM + config.perigee_km) / (1.0 - config.eccentricity)
    motion = math.sqrt(GM_KM3_PER_S2 / a**3)
    node, tilt, perigee = (math.radians(v) for v in (config.node_deg, config.inclination_deg, config.perigee_deg))
    # towards the perigee, and 90 deg further along the orbit
    axes = Rotation.from_euler("ZXZ", [node, tilt, perigee]).as_matrix().T[:2]

    def state(time_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        mean = math.radians(config.anomaly_deg) + motion * np.asarray(time_s, float)
        angle = mean + e * np.sin(mean)
        for _ in range(KEPLER_STEPS):  # Newton's method on Kepler's equation
            angle = angle - (angle - e * np.sin(angle) - mean) / (1.0 - e * np.cos(angle))
        cos, sin, flat = np.cos(angle), np.sin(angle), math.sqrt(1.0 - e * e)
        speed = a * motion / (1.0 - e * cos)
        place = np.stack([a * (cos - e), a * flat * sin], axis=-1)
        velocity = np.stack([-speed * sin, speed * flat * cos], axis=-1)
        return place @ axes, velocity @ axes

    return state, 2.0 * math.pi / motion


def _propagated(first: str, second: str) -> tuple[Callable[[ArrayLike], tuple[FloatArray, FloatArray]], float, float]:
    """Two-line elements by SGP4, their period and the Julian year of their epoch."""
    import erfa

    try:
        from sgp4 import io
        from sgp4.api import SGP4_ERRORS, Satrec
    except ModuleNotFoundError:
        raise ConfigError(
            "orbit.tle needs the package sgp4; pip install 'starbench[orbit]', or give perigee_km and the angles"
        ) from None
    try:
        io.verify_checksum(first, second)
        satellite = Satrec.twoline2rv(first, second)
    except ValueError as error:
        raise DomainError(f"orbit.tle: {error}") from None
    days = satellite.jdsatepoch, satellite.jdsatepochF
    # true equator and mean equinox of date, which SGP4 uses, to icrs; it turns by 0.01 arcsec in an orbit
    equinox = Rotation.from_euler("z", erfa.eqeq94(*days)).as_matrix()
    icrs_from_date = erfa.pnm06a(*days).T @ equinox

    def state(time_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        time = np.asarray(time_s, float)
        part = days[1] + time.ravel() / 86400.0
        failed, place, velocity = satellite.sgp4_array(np.full(part.shape, days[0]), part)
        if failed.any():
            raise DomainError(f"orbit.tle: {SGP4_ERRORS[int(failed[failed > 0][0])]}")
        return tuple((one @ icrs_from_date.T).reshape(*time.shape, 3) for one in (place, velocity))

    return state, 120.0 * math.pi / satellite.no_kozai, 2000.0 + (sum(days) - 2451545.0) / 365.25
