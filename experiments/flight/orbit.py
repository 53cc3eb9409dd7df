"""Where the sensor flies: position and velocity, Sun, Moon and Earth, the shadow."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from experiments.flight.settings import OrbitConfig
from optics.arrays import FloatArray
from render.bodies.solar_system import solar_system
from render.catalogue.motion import Observer, earth_observer

__all__ = ["EARTH_RADIUS_KM", "Orbit", "build_orbit"]


EARTH_RADIUS_KM = 6378.137
"""Equatorial radius, WGS 84."""
GM_KM3_PER_S2 = 398600.4418
"""Of the Earth, WGS 84."""
YEAR_S = 365.25 * 86400.0
KEPLER_STEPS = 30


@dataclass(frozen=True, kw_only=True, eq=False)
class Orbit:
    """Kepler's orbit at an epoch; made by `build_orbit`. Axes of icrs, those of the equator of J2000 to 0.02 arcsec."""

    config: OrbitConfig
    earth: Observer  # Centre of the Earth at time 0
    moon: FloatArray  # (3,) Direction of the Moon from the Earth at time 0
    axes: FloatArray = field(repr=False)  # (2, 3) Towards the perigee, and 90 deg further along the orbit

    @property
    def semi_major_km(self) -> float:
        """Half of the long axis."""
        return (EARTH_RADIUS_KM + self.config.perigee_km) / (1.0 - self.config.eccentricity)

    @property
    def period_s(self) -> float:
        """Time of one revolution."""
        return 2.0 * math.pi * math.sqrt(self.semi_major_km**3 / GM_KM3_PER_S2)

    @property
    def pole(self) -> FloatArray:
        """Direction (3,) of the angular momentum."""
        return np.cross(*self.axes)

    def state(self, time_s: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 3) [km] and velocity (..., 3) [km/s] about the centre of the Earth."""
        e, a = self.config.eccentricity, self.semi_major_km
        motion = 2.0 * math.pi / self.period_s
        mean = math.radians(self.config.anomaly_deg) + motion * np.asarray(time_s, float)
        angle = mean + e * np.sin(mean)
        for _ in range(KEPLER_STEPS):  # Newton's method on Kepler's equation
            angle = angle - (angle - e * np.sin(angle) - mean) / (1.0 - e * np.cos(angle))
        cos, sin, flat = np.cos(angle), np.sin(angle), math.sqrt(1.0 - e * e)
        speed = a * motion / (1.0 - e * cos)
        place = np.stack([a * (cos - e), a * flat * sin], axis=-1)
        velocity = np.stack([-speed * sin, speed * flat * cos], axis=-1)
        return place @ self.axes, velocity @ self.axes

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
    """The orbit at an epoch.

    Raises
    ------
    DomainError
        An epoch beyond the ephemeris of the Earth.
    """
    node, tilt, perigee = (math.radians(v) for v in (config.node_deg, config.inclination_deg, config.perigee_deg))
    ascending = np.array([math.cos(node), math.sin(node), 0.0])
    ahead = np.array([-math.sin(node) * math.cos(tilt), math.cos(node) * math.cos(tilt), math.sin(tilt)])
    cos, sin = math.cos(perigee), math.sin(perigee)
    axes = np.stack([cos * ascending + sin * ahead, -sin * ascending + cos * ahead])
    moon = solar_system(epoch_year, bodies=("moon",)).direction[0]
    return Orbit(config=config, earth=earth_observer(epoch_year), moon=np.array(moon), axes=axes)
