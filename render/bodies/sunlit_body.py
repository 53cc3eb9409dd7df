r"""A sunlit body: the Moon, a planet, or a mesh of the user, and its total light.

The total of a sphere of uniform albedo has a closed form: with its radius R at distance D, geometric albedo p (2/3 a
for Lambert, a for Lommel and Seeliger) and phase function Phi it sends :math:`F_\odot r^{-2} p\, \Phi(\alpha) (R/D)^2`
(`sphere_photons`) for R small against D, to about R/D; F is the light of the Sun at 1 au, r its distance in au.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import constants

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.frames import perpendicular
from optics.light.magnitudes import photon_rate
from optics.records import freeze, freeze_all
from render.bodies.earth_air import BOND_ALBEDO, Air, earth_air
from render.bodies.lunar_irradiance import KNOWN_DEG, moon_reflectance
from render.bodies.lunar_map import HIGHLAND, MARE, lunar_map, moon_rotation
from render.bodies.planet_magnitudes import ALBEDO, ALBEDO_NM, planet_spectrum, planet_v
from render.bodies.solar_system import SolarSystem
from render.bodies.sphere_image import DirectionalLight
from render.plugins.lunar_surface import lommel_seeliger_phase
from render.sky.sunlight import sun_spectrum, sunlight

SCALED_AT_NM = 550.0
"""Where spectra of bodies are tied to their magnitude V."""
DISK_RINGS, DISK_ARMS = 96, 384
"""Points of the disk at which the light of a sphere with a map is summed up."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SunlitBody:
    """A body far away, and the Sun that lights it; directions along icrs."""

    direction: FloatArray  # (3,) Where its centre is seen, unit vector
    distance_km: float  # From the camera to its centre
    to_sun: FloatArray  # (3,) From the body to the Sun, unit vector
    sun_distance_au: float = 1.0  # Distance of the two
    radius_km: float  # Radius of a sphere; of a mesh, the sphere around its origin that holds it
    # albedo_nm, albedo: (k,) Albedo over wavelength, linear between and constant beyond: reflectance of a Lambertian
    # surface, normal reflectance of a lunar one
    albedo_nm: FloatArray = field(default_factory=lambda: np.array([550.0]))
    albedo: FloatArray
    law: Literal["lambert", "lunar"] = "lambert"  # How its surface scatters (`render.plugins.lunar_surface`)
    mesh: Path | str | None = None  # PLY or OBJ file; None is a sphere
    mesh_unit_km: float = 1.0  # Length of its unit
    rotation_icrs_from_body: FloatArray = field(default_factory=lambda: np.eye(3))  # (3, 3) Attitude of mesh or map
    # (rows, columns) Factor on the albedo of a sphere: latitudes from south to north, longitudes from -180 to 180 deg
    # east, values at the centres of the cells
    albedo_map: NDArray[np.float32] | None = None
    second_light: DirectionalLight | None = None  # Another light far away: the Earth's on the Moon
    air: Air | None = None  # Lit air around a sphere (`render.bodies.earth_air`)
    name: str = ""  # What it is called; part of the key of its random numbers

    def __post_init__(self) -> None:
        for name in ("direction", "to_sun"):
            vector = freeze(self, name, shape=(3,))
            if abs(np.linalg.norm(vector) - 1.0) > 1e-9:
                raise DomainError(f"SunlitBody.{name} has length {np.linalg.norm(vector):.9g}; a unit vector is needed")
        for name in ("distance_km", "sun_distance_au", "radius_km", "mesh_unit_km"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise DomainError(f"SunlitBody.{name} = {getattr(self, name)}; it must be positive and finite")
        if self.distance_km <= self.radius_km:
            raise DomainError(
                f"SunlitBody: the camera is {self.distance_km:g} km from the centre of a body of {self.radius_km:g} km "
                "radius; it must be outside"
            )
        freeze_all(self, albedo_nm=("k",), albedo=("k",), rotation_icrs_from_body=(3, 3))
        if (self.albedo < 0.0).any():
            raise DomainError(f"SunlitBody.albedo contains {self.albedo.min():g}; it must not be negative")
        if self.albedo_map is not None:
            map_ = freeze(self, "albedo_map", shape=("rows", "columns"), dtype=np.float32, sizes={})
            if min(map_.shape) < 2 or map_.min() < 0.0:
                raise DomainError(
                    f"SunlitBody.albedo_map of {map_.shape} cells, lowest {map_.min():g}; at least 2 x 2 cells are "
                    "needed, none negative"
                )
        if self.law not in ("lambert", "lunar"):
            raise ConfigError(f"SunlitBody.law = {self.law!r}; 'lambert' or 'lunar' is needed")
        if self.mesh is not None and not (
            Path(self.mesh).is_file() and Path(self.mesh).suffix.lower() in (".ply", ".obj")
        ):
            raise ConfigError(f"SunlitBody.mesh = {str(self.mesh)!r}: no such file, or neither .ply nor .obj")
        if self.mesh is not None and (self.albedo_map is not None or self.air is not None):
            raise ConfigError("SunlitBody: albedo_map and air belong to a sphere; a mesh has neither")

    @property
    def phase_rad(self) -> float:
        """Angle Sun - body - camera."""
        cross = float(np.linalg.norm(np.cross(self.to_sun, -self.direction)))
        return math.atan2(cross, float(-self.to_sun @ self.direction))

    @property
    def angular_radius_rad(self) -> float:
        """Half angle of the cone around it."""
        return math.asin(self.radius_km / self.distance_km)

    def albedo_at(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Albedo at wavelengths [nm]."""
        return np.asarray(np.interp(np.asarray(wavelength_nm, float), self.albedo_nm, self.albedo))


def _disk_factor(body: SunlitBody) -> float:
    """Geometric albedo of a sphere of unit albedo times its phase function, in sunlight alone."""
    a = body.phase_rad
    if body.albedo_map is not None:
        return _mapped_disk(body)
    if body.law == "lunar":
        return lommel_seeliger_phase(a)
    return (
        2.0 / 3.0 * (math.sin(a) + (math.pi - a) * math.cos(a)) / math.pi
    )  # Lambert 1760; Russell, ApJ 43, 173 (1916)


def _mapped_disk(body: SunlitBody) -> float:
    """The same with a map: mean over the disk of what it throws back, seen from far away."""
    node, weight = np.polynomial.legendre.leggauss(DISK_RINGS)
    r = np.sqrt(0.5 * (1.0 + node))[:, None]
    turn = 2.0 * np.pi * (np.arange(DISK_ARMS) + 0.5) / DISK_ARMS
    first, second = perpendicular(body.direction)
    mu = np.sqrt(1.0 - r**2)
    n = (r * np.cos(turn))[..., None] * first + (r * np.sin(turn))[..., None] * second - mu[..., None] * body.direction
    mu0 = np.maximum(n @ body.to_sun, 0.0)
    law = 2.0 * mu0 / (mu0 + mu) if body.law == "lunar" else mu0
    value = law * map_factor(body, n)
    return float((0.5 * weight[:, None] * value).sum() / DISK_ARMS)


def map_factor(body: SunlitBody, normal: FloatArray) -> FloatArray:
    """Factor of the map at points (..., 3) of the sphere along icrs, linear between the centres of cells; 1 without."""
    if body.albedo_map is None:
        return np.ones(normal.shape[:-1])
    rows, columns = body.albedo_map.shape
    v = normal @ body.rotation_icrs_from_body
    u = (np.arctan2(v[..., 1], v[..., 0]) / (2.0 * np.pi) + 0.5) * columns - 0.5
    w = np.clip((np.arcsin(np.clip(v[..., 2], -1.0, 1.0)) / np.pi + 0.5) * rows - 0.5, 0.0, rows - 1.0)
    column, row = np.floor(u).astype(int), np.minimum(np.floor(w).astype(int), rows - 2)
    a, b = u - column, w - row
    west, east = column % columns, (column + 1) % columns
    grid = body.albedo_map
    below, above = (grid[r, west] * (1.0 - a) + grid[r, east] * a for r in (row, row + 1))
    return np.asarray(below * (1.0 - b) + above * b)


def sphere_photons(body: SunlitBody, wavelength_nm: ArrayLike) -> FloatArray:
    """Photons s^-1 mm^-2 nm^-1 that arrive from a whole sphere: in closed form, with a map as a sum over the disk.

    A second light and air are not in it.
    """
    if body.mesh is not None:
        raise DomainError("the light of a mesh is known only after rendering")
    light = sunlight(wavelength_nm, distance_au=body.sun_distance_au) * body.albedo_at(wavelength_nm)
    return np.asarray(light * (_disk_factor(body) * (body.radius_km / body.distance_km) ** 2))


def planet_body(system: SolarSystem, name: str, *, law: Literal["lambert", "lunar"] | None = None) -> SunlitBody:
    """The Moon or a planet of ``system`` as a smooth sphere that has its published brightness and colour.

    The Moon has its map (`render.bodies.lunar_map`), turned as the observer sees it, and the light of the Earth on it.
    The Earth, which is seen from nearby, is Lambertian of its Bond albedo in V, without clouds, with lit air above its
    limb (`render.bodies.earth_air`). Light falls off towards limb and terminator by a law: lunar for the Moon and
    Mercury, Lambert for the others.

    The albedo is scaled so that the whole sphere has the magnitude of ``system``, the Moon's so that it has the
    measured reflectance at every wavelength (`render.bodies.lunar_irradiance`, whose albedo at 150 deg stands beyond).
    Where the magnitude is NaN, the geometric albedo stands with the phase function of the law. The Earth's is not
    scaled.
    """
    if name not in system.name:
        raise ConfigError(f"{name!r} is not among the bodies of this solar system: {', '.join(system.name)}")
    i = system.name.index(name)
    law = law or ("lunar" if name in ("moon", "mercury") else "lambert")
    shape = np.interp(sun_spectrum().wavelength_nm, ALBEDO_NM, ALBEDO[name])
    body = SunlitBody(
        direction=system.direction[i] / np.linalg.norm(system.direction[i]),
        distance_km=float(system.distance_au[i]) * constants.au / 1e3,
        to_sun=system.to_sun_au[i] / system.sun_distance_au[i],
        sun_distance_au=float(system.sun_distance_au[i]),
        radius_km=float(system.radius_km[i]),
        albedo_nm=sun_spectrum().wavelength_nm,
        albedo=shape if law == "lunar" else 1.5 * shape,
        law=law,
        name=name,
    )
    if name == "moon":
        factor = lunar_map() / np.float32(0.5 * (MARE + HIGHLAND))
        body = replace(body, albedo_map=factor, rotation_icrs_from_body=moon_rotation(system.epoch_year))
        body = replace(body, albedo=_lunar_albedo(body, body.albedo_nm, system.epoch_year))
        return replace(body, second_light=_earthlight(system.select([i]), body))
    if name == "earth":
        return replace(
            body, albedo=BOND_ALBEDO * shape / np.interp(SCALED_AT_NM, ALBEDO_NM, ALBEDO[name]), air=earth_air()
        )
    return replace(body, albedo=body.albedo * _scale(body, name, float(system.magnitude_v[i])))


def _scale(body: SunlitBody, name: str, magnitude_v: float) -> float:
    """Factor on the albedo that gives the sphere a magnitude; 1 where that is NaN."""
    if math.isnan(magnitude_v):
        return 1.0
    at = np.array([SCALED_AT_NM])
    wanted = photon_rate(planet_spectrum(name), magnitude_v, wavelength_nm=at)
    return float((wanted / sphere_photons(body, at))[0])


def _lunar_albedo(body: SunlitBody, wavelength_nm: ArrayLike, epoch_year: float) -> FloatArray:
    """Albedo at which the Moon's map, lit as ``body`` is, reflects what was measured; beyond that phase it stays."""
    observer = -body.direction
    aside = body.to_sun - (body.to_sun @ observer) * observer
    if body.phase_rad > math.radians(KNOWN_DEG) and np.linalg.norm(aside) > 0.0:
        angle = math.radians(KNOWN_DEG - 1e-6)
        to_sun = math.cos(angle) * observer + math.sin(angle) * aside / np.linalg.norm(aside)
        return _lunar_albedo(replace(body, to_sun=to_sun), wavelength_nm, epoch_year)
    measured = moon_reflectance(wavelength_nm, to_sun=body.to_sun, to_observer=observer, epoch_year=epoch_year)
    return np.asarray(measured / _disk_factor(body))


def _earthlight(moon: SolarSystem, body: SunlitBody) -> DirectionalLight | None:
    """Light of the Earth on the Moon, in units of sunlight there; None where the Earth shows it its night side.

    A surface is brighter the smaller the angle between its light and the observer: the albedo at the Sun's phase angle
    is taken to that at the Earth's. It has the colour of sunlight; earthshine was measured 0.15 mag bluer in B-V than
    the sunlit side (P. Thejll et al., A&A 563, A38 (2014)).
    """
    to_earth, to_sun = moon.to_earth_au[0], moon.to_sun_au[0]
    if not np.linalg.norm(to_earth) > 0.0:
        return None
    v = planet_v("earth", to_sun_au=to_sun - to_earth, to_observer_au=-to_earth, epoch_year=moon.epoch_year)
    if math.isnan(v):
        return None
    wavelength_nm = np.array([SCALED_AT_NM])
    irradiance = float(
        (photon_rate(planet_spectrum("earth"), v, wavelength_nm=wavelength_nm) / sunlight(wavelength_nm))[0]
    )
    irradiance *= float(moon.sun_distance_au[0]) ** 2
    towards = to_earth / np.linalg.norm(to_earth)
    albedo_towards_earth = _lunar_albedo(replace(body, to_sun=towards), wavelength_nm, moon.epoch_year)
    return DirectionalLight(towards, irradiance * float((albedo_towards_earth / body.albedo_at(wavelength_nm))[0]))


def covers(body: SunlitBody, direction: ArrayLike) -> NDArray[np.bool_]:
    """Which directions (n, 3) along icrs lie behind the body's sphere: stars to leave out."""
    return np.asarray(np.asarray(direction, float) @ body.direction > math.cos(body.angular_radius_rad))
