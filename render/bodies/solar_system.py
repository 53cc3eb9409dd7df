"""The Moon and the planets for an epoch and an observer: directions, sizes, brightness.

Places: astropy's built-in ephemeris, offline (ERFA: ``epv00`` for Earth and Sun, ``plan94`` for the planets, ``moon98``
for the Moon). Errors against JPL's ephemerides are some arcseconds for Mercury to Mars and the Moon, up to 10" for
Neptune, 80" for Jupiter, Saturn and Uranus (J. L. Simon et al., A&A 282, 663 (1994), 1900 ... 2100). Directions include
light time and the aberration of `render.catalogue.motion`. Deflection by the Sun, below 0.1" beyond five degrees from
it, is neglected.

A body smaller than about a pixel is added to the stars (`planet_field`, `joined`); a larger one is rendered
(`render.bodies.sunlit_body`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import constants

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError, unknown_name
from optics.light.band import Band, band_nodes
from optics.light.magnitudes import band_photon_rate, photon_rate
from optics.records import freeze_all
from optics.stellar_aberration import aberrated
from render.bodies.planet_magnitudes import planet_spectrum, planet_v
from render.catalogue.motion import Observer, earth_observer
from render.records import StarField

RADIUS_KM = {
    "mercury": 2439.4, "venus": 6051.8, "earth": 6371.0084, "moon": 1737.4, "mars": 3389.50,
    "jupiter": 69911.0, "saturn": 58232.0, "uranus": 25362.0, "neptune": 24622.0,
}  # fmt: skip
"""Mean radii: B. A. Archinal et al., Celestial Mechanics and Dynamical Astronomy 130, 22 (2018), tables 4 and 5."""

BODIES = ("mercury", "venus", "moon", "mars", "jupiter", "saturn", "uranus", "neptune")
"""Default bodies; an observer off the Earth may add ``"earth"``."""

HIDING_MM = 2.0**30
_LIGHT_DAYS_PER_AU = constants.au / constants.c / 86400.0
_LIGHT_STEPS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolarSystem:
    """Bodies as one observer sees them at one time."""

    name: tuple[str, ...]  # The n bodies
    direction: FloatArray  # (n, 3) Where they are seen: unit vectors along icrs, light time and aberration included
    # to_sun_au, to_observer_au, to_earth_au: (n, 3) From the body (when the light left) to the Sun, to the observer
    # and to the Earth, along icrs [au]
    to_sun_au: FloatArray
    to_observer_au: FloatArray
    to_earth_au: FloatArray
    radius_km: FloatArray  # (n,) Mean radius
    magnitude_v: FloatArray  # (n,) V; NaN where no published equation holds (`render.bodies.planet_magnitudes`)
    epoch_year: float  # Julian year (TDB)

    def __post_init__(self) -> None:
        sizes = {"n": len(self.name)}
        vector = ("n", 3)
        freeze_all(self, direction=vector, to_sun_au=vector, to_observer_au=vector, to_earth_au=vector, sizes=sizes)
        freeze_all(self, radius_km=("n",), magnitude_v=("n",), finite=False, sizes=sizes)

    def __len__(self) -> int:
        return len(self.name)

    @property
    def distance_au(self) -> FloatArray:
        """Distance from the observer (n,) [au]."""
        return np.asarray(np.linalg.norm(self.to_observer_au, axis=1))

    @property
    def sun_distance_au(self) -> FloatArray:
        """Distance from the Sun (n,) [au]."""
        return np.asarray(np.linalg.norm(self.to_sun_au, axis=1))

    @property
    def phase_rad(self) -> FloatArray:
        """Angle Sun - body - observer (n,)."""
        return np.asarray(
            np.arctan2(
                np.linalg.norm(np.cross(self.to_sun_au, self.to_observer_au), axis=1),
                np.einsum("ij,ij->i", self.to_sun_au, self.to_observer_au),
            )
        )

    @property
    def angular_diameter_rad(self) -> FloatArray:
        """Diameter of the disk (n,)."""
        return np.asarray(2.0 * np.arcsin(self.radius_km * 1e3 / constants.au / self.distance_au))

    def sun_angle_rad(self, rotation_cam_from_icrs: FloatArray) -> FloatArray:
        """Direction of the Sun (n,) in the image of an attitude, seen from each body: from +column towards +row."""
        v_cam, to_sun = self.direction @ rotation_cam_from_icrs.T, self.to_sun_au @ rotation_cam_from_icrs.T
        across = to_sun - v_cam * np.sum(to_sun * v_cam, axis=1, keepdims=True)
        return np.asarray(np.arctan2(across[:, 1], across[:, 0]))

    def select(self, rows: ArrayLike) -> SolarSystem:
        """Some of the bodies, by mask or index (m,)."""
        chosen = np.arange(len(self))[np.asarray(rows)]
        arrays = {
            name: values[chosen] for name in self.__slots__ if isinstance(values := getattr(self, name), np.ndarray)
        }
        return replace(self, name=tuple(self.name[i] for i in chosen), **arrays)


def solar_system(epoch_year: float, *, observer: Observer | None = None, bodies: Sequence[str] = BODIES) -> SolarSystem:
    """Look up the Moon and the planets at a Julian year (TDB), from the Earth's centre or an observer's position.

    Raises `ConfigError` on an unknown body, `DomainError` before 1900, after 2100 or for an observer inside a body.
    """
    for name in bodies:
        if name not in RADIUS_KM:
            raise unknown_name("body of the solar system", name, RADIUS_KM)
    if not 1900.0 <= epoch_year <= 2100.0:
        raise DomainError(f"epoch_year = {epoch_year:g}; positions of the planets are available for 1900 ... 2100")
    viewer = earth_observer(epoch_year) if observer is None else observer
    position_au = np.array([_apparent_position(name, epoch_year, viewer.position_au) for name in bodies]).reshape(-1, 3)
    to_body = position_au - viewer.position_au
    to_sun = _position("sun", epoch_year, 0.0) - position_au
    radius = np.array([RADIUS_KM[name] for name in bodies])
    distance_km = np.linalg.norm(to_body, axis=1) * constants.au / 1e3
    if (distance_km <= radius).any():
        inside = int(np.argmax(distance_km <= radius))
        raise DomainError(
            f"the observer is {distance_km[inside]:.0f} km from the centre of {bodies[inside]}, whose radius is "
            f"{radius[inside]:.0f} km; leave it out or give an observer outside"
        )
    magnitude = [
        planet_v(name, to_sun_au=s, to_observer_au=-v, epoch_year=epoch_year)
        for name, s, v in zip(bodies, to_sun, to_body, strict=True)
    ]
    unit = to_body / np.linalg.norm(to_body, axis=1, keepdims=True)
    return SolarSystem(
        name=tuple(bodies),
        direction=aberrated(unit, viewer.velocity_km_per_s),
        to_sun_au=to_sun,
        to_observer_au=-to_body,
        to_earth_au=_position("earth", epoch_year, 0.0) - position_au,
        radius_km=radius,
        magnitude_v=np.array(magnitude),
        epoch_year=epoch_year,
    )


def _position(name: str, epoch_year: float, days_before: float) -> FloatArray:
    """Place from the barycentre [au], along icrs."""
    from astropy import units
    from astropy.coordinates import get_body_barycentric
    from astropy.time import Time

    time = Time(epoch_year, format="jyear", scale="tdb") - days_before * units.day
    return np.asarray(get_body_barycentric(name, time, ephemeris="builtin").xyz.to_value(units.au))


def _apparent_position(name: str, epoch_year: float, observer_au: FloatArray) -> FloatArray:
    """Place of a body when the light left that arrives now."""
    days = 0.0
    for _ in range(_LIGHT_STEPS):
        position_au = _position(name, epoch_year, days)
        days = float(np.linalg.norm(position_au - observer_au)) * _LIGHT_DAYS_PER_AU
    return _position(name, epoch_year, days)


def hiding_spheres(system: SolarSystem) -> dict[str, Any]:
    """Spheres, for the scene of the stars (mm, icrs, the camera at the origin), that hide objects behind them.

    All are of one radius, at distances that give them their size: Mitsuba warns of spheres that float32 makes uneven.
    """
    sine = np.sin(0.5 * system.angular_diameter_rad)
    return {
        str(name): {"type": "sphere", "center": (direction * HIDING_MM / s).tolist(), "radius": HIDING_MM}
        for name, direction, s in zip(system.name, system.direction, sine, strict=True)
    }


def planet_field(system: SolarSystem, bands: Sequence[Band], *, nodes: int = 5) -> StarField:
    """Bodies as points of light."""
    rule = band_nodes(bands, nodes)
    unknown = np.isnan(system.magnitude_v)
    if unknown.any():
        first = int(np.argmax(unknown))
        raise DomainError(
            f"{system.name[first]} has no published magnitude at a phase of {np.degrees(system.phase_rad[first]):.1f} "
            "deg; leave it out (SolarSystem.select) or render it"
        )
    rates = np.zeros((len(system), *rule.wavelength_nm.shape))
    for i, name in enumerate(system.name):
        spectrum, v = planet_spectrum(name), float(system.magnitude_v[i])
        rate = photon_rate(spectrum, v, wavelength_nm=rule.wavelength_nm) * rule.weight_nm * rule.transmission
        # a few nodes miss some 0.1 % of a spectrum as rough as the Sun's: they share the integral over all its pieces
        rates[i] = rate * (band_photon_rate(spectrum, v, bands) / rate.sum(1))[:, None]
    return StarField(direction=system.direction, wavelength_nm=rule.wavelength_nm, photon_rate=rates, band=rule.name)


def joined(first: StarField, *others: StarField) -> StarField:
    """One star field of several that have the same bands and wavelengths."""
    for other in others:
        if other.band != first.band or not np.array_equal(other.wavelength_nm, first.wavelength_nm):
            raise ConfigError(
                f"star fields of bands {', '.join(first.band)} and {', '.join(other.band)} do not share wavelengths; "
                "make both with the same bands and number of nodes"
            )
    direction, photon_rate = (
        np.concatenate([getattr(part, name) for part in (first, *others)]) for name in ("direction", "photon_rate")
    )
    return StarField(direction=direction, wavelength_nm=first.wavelength_nm, photon_rate=photon_rate, band=first.band)
