"""Stray light of Sun, Moon and Earth in electrons per pixel, from a table of point-source transmittance.

The light is even over the detector: PST is a mean over it. The Moon is taken as a point, the Earth as a Lambertian
sphere in full light, a sum of points: PST adds up over a source that is extended.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError
from optics.light.band import Band, band_nodes
from optics.light.photometry import band_photon_rate
from optics.light.pst import PointSourceTransmittance, read_pst
from render.bodies.brightness import planet_spectrum
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
    """What a source of unit PST would do: electrons per second in a pixel under all of its light."""

    sun_e_per_s: float  # At 1 au
    full_moon_e_per_s: float
    moon_zero_e_per_s: float  # Of light like the Moon's, of V = 0


def band_light(detector: Detector, band: Band, *, nodes: int = 12) -> BandLight:
    """Electrons per second and pixel of a pass band; transmission of the lens is part of the PST.

    Raises
    ------
    DomainError
        A band beyond what is known of the detector or the Sun.
    """
    rule = band_nodes([band], nodes)
    wave = rule.wavelength_nm[0]
    weight = rule.weight_nm[0] * rule.transmission[0] * detector.quantum_efficiency.interpolate(wave)
    area = detector.pixel_pitch_mm**2
    sun = float((sunlight(wave) * weight).sum()) * area
    shape = planet_spectrum("moon")
    passed = float((shape.photon_density(wave) * rule.weight_nm[0] * rule.transmission[0]).sum())
    share = float((shape.photon_density(wave) * weight).sum()) / passed
    zero = float(np.ravel(band_photon_rate(shape, 0.0, [band], system="V"))[0]) * share * area
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


def stray_electrons_per_s(
    pst: PointSourceTransmittance,
    attitude: Rotation,
    *,
    light: BandLight,
    observer: Observer | None,
    epoch_year: float,
    earth: bool = False,
) -> dict[str, float]:
    """Stray light [e- s^-1 per pixel] of Sun, Moon and, for an observer above it, the Earth.

    Parameters
    ----------
    pst : PointSourceTransmittance
        Of the camera.
    attitude : Rotation
        cam from icrs.
    light : BandLight
        Of its pass band.
    observer : Observer
        Where the camera is (that of the sky).
    epoch_year : float
        Julian year.
    earth : bool
        Whether the observer is above the Earth and sees its disk.

    Raises
    ------
    ConfigError
        No observer, or one whose place from the Sun is not known.
    """
    if observer is None or observer.from_sun_au is None:
        raise ConfigError(
            "stray light needs an observer, from which the Sun's direction follows: load_sky(observer='earth')"
        )
    far = float(np.linalg.norm(observer.from_sun_au))
    sun = light.sun_e_per_s / far**2
    names = ("moon", "earth") if earth else ("moon",)
    bodies = solar_system(epoch_year, observer=observer, bodies=names)
    towards = attitude.apply(np.array(bodies.direction))
    found = {"sun": float(sun * pst.at(attitude.apply(-observer.from_sun_au / far)))}
    magnitude = float(bodies.magnitude_v[0])
    if math.isfinite(magnitude):
        found["moon"] = float(light.moon_zero_e_per_s * 10.0 ** (-0.4 * magnitude) * pst.at(towards[0]))
    if earth:
        radius = math.asin(min(1.0, RADIUS_KM["earth"] / _distance_km(bodies.to_observer_au[1])))
        found["earth"] = sun * limb_pst(pst, towards[1], radius)
    return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StrayLight:
    """Stray light of each body in an attitude [e- s^-1 per pixel]; made by `stray_light`."""

    whole: Callable[[Rotation], dict[str, float]]
    ghosts: Callable[[Rotation], dict[str, float]] | None  # What of it are ghosts that are drawn, of Sun and Moon

    def even(self, attitude: Rotation) -> dict[str, float]:
        """What lies evenly on the detector."""
        drawn = {} if self.ghosts is None else self.ghosts(attitude)
        return {name: max(light - drawn.get(name, 0.0), 0.0) for name, light in self.whole(attitude).items()}


def stray_light(
    table: str | Path | PointSourceTransmittance,
    detector: Detector,
    band: Band,
    *,
    observer: Observer | None,
    epoch_year: float,
    earth: bool = False,
    ghosts: bool = False,
) -> StrayLight:
    """Stray light by a table; ``ghosts``: its cause of that name is drawn apart. Others as `stray_electrons_per_s`.

    Raises
    ------
    ConfigError
        A table that cannot be read.
    """
    pst = table if isinstance(table, PointSourceTransmittance) else read_pst(table)
    at = partial(stray_electrons_per_s, light=band_light(detector, band), observer=observer, epoch_year=epoch_year)
    drawn = pst.only("ghosts") if ghosts and "ghosts" in pst.causes else None
    return StrayLight(
        whole=partial(at, pst, earth=earth),
        ghosts=None if drawn is None else partial(at, drawn),
    )


def _distance_km(vector_au: FloatArray) -> float:
    from scipy import constants

    return float(np.linalg.norm(vector_au)) * constants.au * 1e-3
