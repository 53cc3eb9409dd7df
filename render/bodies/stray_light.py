"""Stray light of Sun, Moon and Earth in electrons per pixel, from a table of point-source transmittance.

The light is uniform over the detector, because PST is a mean over it. The Moon is a point, the Earth a fully lit
Lambertian sphere as a sum of points: PST adds up over an extended source.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy import constants
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError
from optics.frames import polar_direction
from optics.light.band import Band, band_nodes
from optics.light.magnitudes import band_photon_rate
from optics.light.pst import PointSourceTransmittance, read_pst
from render.bodies.planet_magnitudes import planet_spectrum
from render.bodies.solar_system import RADIUS_KM, solar_system
from render.catalogue.motion import Observer
from render.detector.spec import Detector
from render.sky.sunlight import sunlight

FULL_MOON_V = -12.74
"""Mean full Moon (C. W. Allen, Astrophysical Quantities)."""
EARTH_ALBEDO = 0.3
"""Bond albedo of the Earth (P. R. Goode et al., Geophys. Res. Lett. 28, 1671 (2001): 0.297)."""
RINGS, ARMS = 24, 48


@dataclass(frozen=True, slots=True, kw_only=True)
class BandLight:
    """Light of a source of unit PST: electrons per second in a pixel."""

    sun_e_per_s: float  # At 1 au
    full_moon_e_per_s: float
    moon_zero_e_per_s: float  # Of light like the Moon's, of V = 0


def band_light(detector: Detector, band: Band, *, nodes: int = 12) -> BandLight:
    """Electrons per second and pixel of a pass band; transmission of the lens is part of the PST."""
    rule = band_nodes([band], nodes)
    wave = rule.wavelength_nm[0]
    weight = rule.weight_nm[0] * rule.transmission[0] * detector.quantum_efficiency.interpolate(wave)
    area = detector.pixel_pitch_mm**2
    sun = float((sunlight(wave) * weight).sum()) * area
    shape = planet_spectrum("moon")
    passed = float((shape.photon_density(wave) * rule.weight_nm[0] * rule.transmission[0]).sum())
    weights = float((shape.photon_density(wave) * weight).sum()) / passed
    zero = float(np.ravel(band_photon_rate(shape, 0.0, [band], system="V"))[0]) * weights * area
    return BandLight(sun_e_per_s=sun, full_moon_e_per_s=zero * 10.0 ** (-0.4 * FULL_MOON_V), moon_zero_e_per_s=zero)


@cache
def _cap(radius_rad: float) -> tuple[FloatArray, FloatArray]:
    """Unit vectors over a cap about +z, and solid angles."""
    node, weight = np.polynomial.legendre.leggauss(RINGS)
    bottom = math.cos(radius_rad)
    cosine = 0.5 * (1.0 + bottom) + 0.5 * (1.0 - bottom) * node
    phi = 2.0 * np.pi * (np.arange(ARMS) + 0.5) / ARMS
    sine = np.sqrt(1.0 - cosine**2)[:, None]
    points = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.broadcast_to(cosine[:, None], (RINGS, ARMS))], -1)
    return points.reshape(-1, 3), np.repeat(weight * 0.5 * (1.0 - bottom) * 2.0 * np.pi / ARMS, ARMS)


def earth_points(towards_centre: ArrayLike, radius_rad: float) -> tuple[FloatArray, FloatArray]:
    """Directions (n, 3) over a disk of an angular radius about a unit vector, and their solid angles."""
    points, solid = _cap(round(float(radius_rad), 9))
    centre = np.asarray(towards_centre, dtype=np.float64)
    side = np.cross(centre, [1.0, 0.0, 0.0] if abs(centre[0]) < 0.9 else [0.0, 1.0, 0.0])
    side = side / np.linalg.norm(side)
    return points @ np.stack([side, np.cross(centre, side), centre]), solid


def limb_pst(pst: PointSourceTransmittance, towards_centre: ArrayLike, radius_rad: float) -> float:
    """Irradiance on the detector over that of the Sun: the Earth's disk in full light."""
    points, solid = earth_points(towards_centre, radius_rad)
    return float(EARTH_ALBEDO / np.pi * (pst.at(points) * solid).sum())


def earth_limb_pst(pst: PointSourceTransmittance, limb_deg: float, altitude_km: float) -> float:
    """`limb_pst` at an altitude, the limb of the Earth at an angle from the boresight, at azimuth 0."""
    radius = math.asin(RADIUS_KM["earth"] / (RADIUS_KM["earth"] + altitude_km))
    return limb_pst(pst, polar_direction(limb_deg + math.degrees(radius)), radius)


class StrayLight:
    """Stray light of Sun, Moon and, for an observer above it, the Earth, in an attitude [e- s^-1 per pixel].

    ``table`` is a file or record of the camera, ``light`` that of its pass band; ``ghosts``: ghosts of Sun and Moon are
    drawn separately, if the table has the cause ``ghosts``. `ConfigError` without an observer whose place is known.
    """

    def __init__(
        self,
        table: str | Path | PointSourceTransmittance,
        light: BandLight,
        *,
        observer: Observer | None,
        epoch_year: float,
        earth: bool = False,
        ghosts: bool = False,
    ) -> None:
        if observer is None or observer.from_sun_au is None:
            raise ConfigError(
                "stray light needs an observer, from which the Sun's direction follows: load_sky(observer='earth')"
            )
        self.pst = table if isinstance(table, PointSourceTransmittance) else read_pst(table)
        self._drawn_ghosts = self.pst.only("ghosts") if ghosts and "ghosts" in self.pst.causes else None
        distance_au, self._earth = float(np.linalg.norm(observer.from_sun_au)), earth
        self._sun, self._to_sun = light.sun_e_per_s / distance_au**2, -observer.from_sun_au / distance_au
        self._bodies = solar_system(epoch_year, observer=observer, bodies=("moon", "earth") if earth else ("moon",))
        self._moon = light.moon_zero_e_per_s * 10.0 ** (-0.4 * float(self._bodies.magnitude_v[0]))

    @property
    def draws_ghosts(self) -> bool:
        """Whether ghosts are drawn separately."""
        return self._drawn_ghosts is not None

    def _point_sources(self, pst: PointSourceTransmittance, attitude: Rotation) -> dict[str, float]:
        towards = attitude.apply(np.array(self._bodies.direction))
        light = {"sun": float(self._sun * pst.at(attitude.apply(self._to_sun)))}
        if math.isfinite(self._moon):
            light["moon"] = float(self._moon * pst.at(towards[0]))
        return light

    def total(self, attitude: Rotation) -> dict[str, float]:
        """All of it, by its source."""
        light = self._point_sources(self.pst, attitude)
        if self._earth:
            distance_km = float(np.linalg.norm(self._bodies.to_observer_au[1])) * constants.au * 1e-3
            angular_radius, direction = math.asin(min(1.0, RADIUS_KM["earth"] / distance_km)), self._bodies.direction[1]
            light["earth"] = self._sun * limb_pst(self.pst, attitude.apply(np.array(direction)), angular_radius)
        return light

    def ghosts(self, attitude: Rotation) -> dict[str, float]:
        """Stray light by separately drawn ghosts; empty without them."""
        return {} if self._drawn_ghosts is None else self._point_sources(self._drawn_ghosts, attitude)

    def uniform(self, attitude: Rotation) -> dict[str, float]:
        """Uniform part of the stray light."""
        drawn = self.ghosts(attitude)
        return {name: max(light - drawn.get(name, 0.0), 0.0) for name, light in self.total(attitude).items()}
