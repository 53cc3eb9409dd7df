r"""Observed directions of stars: space motion to another epoch, parallax, deflection by the Sun and aberration.

Space motion is the standard model of the Hipparcos and Gaia catalogues, uniform motion in space (The Hipparcos and
Tycho Catalogues, ESA SP-1200, vol. 1, sec. 1.5.5, 1997): with the direction r, the vector of proper motion mu and the
radial motion mu_r = v_r parallax / A, A = 4.740470463 km/s per au/year,

.. math:: u(t) = r (1 + \mu_r t) + \mu t, \qquad r(t) = u / |u|, \qquad \varpi(t) = \varpi / |u|

Observed motions are per year of arrival of the light, which differs from the year of emission for a star with radial
velocity, and moving clocks are slower. Both are included as in ERFA's ``starpm`` (A. G. Butkevich and L. Lindegren, A&A
570, A62 (2014)): together 0.5 mas in 50 years for Kapteyn's star. The light time between observer and barycentre is
included: up to 8 min, 0.16 mas for Barnard's star.

Deflection: S. A. Klioner, AJ 125, 1580 (2003), eq. 70, for the Sun alone. Aberration: his eq. 10, the exact formula of
special relativity. `erfa.ab` adds the potential of the Sun, below 0.001 mas.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import constants

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from optics.stellar_aberration import aberrated
from render.catalogue.record import StarCatalog

_AU_PER_YEAR_KM_PER_S = constants.au / (365.25 * 86400.0) / 1e3
_LIGHT_KM_PER_S = constants.c / 1e3
_LIGHT_YEAR_PER_AU = constants.au / constants.c / (365.25 * 86400.0)
# 2 G M / c^2 of the Sun [au]: IAU 2015 nominal G M over CODATA c
_SUN_AU = 2.0 * 1.3271244e20 / constants.c**2 / constants.au
_SUN_RADIUS_AU = 0.00465
_LONGEST_YEAR = 5000.0
_STEPS = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observer:
    """Position and velocity of the camera relative to the barycentre of the solar system, in icrs axes.

    Attributes
    ----------
    position_au : (3,)
        Place [au]; parallax follows from it. Zero is the barycentre.
    velocity_km_per_s : (3,)
        Velocity; aberration follows from it.
    from_sun_au : (3,) or None
        Place as seen from the Sun [au]; deflection follows from it. None leaves it out.

    Raises
    ------
    DomainError
        Not finite, or at half the velocity of light or more: the unit must be another.
    """

    position_au: FloatArray
    velocity_km_per_s: FloatArray
    from_sun_au: FloatArray | None = None

    def __post_init__(self) -> None:
        freeze(self, "position_au", shape=(3,))
        if self.from_sun_au is not None:
            freeze(self, "from_sun_au", shape=(3,))
        velocity = freeze(self, "velocity_km_per_s", shape=(3,))
        speed = float(np.linalg.norm(velocity))
        if speed >= 0.5 * _LIGHT_KM_PER_S:
            raise DomainError(f"Observer moves at {speed:g} km/s, half the velocity of light or more; check the unit")

    @property
    def to_sun(self) -> FloatArray:
        """Unit vector (3,) towards the Sun along icrs, where `from_sun_au` is known."""
        if self.from_sun_au is None:
            raise DomainError("the observer's place as seen from the Sun is not known: Observer(from_sun_au=...)")
        return np.asarray(-self.from_sun_au / np.linalg.norm(self.from_sun_au))

    def moved(self, *, position_km: ArrayLike = (0.0, 0.0, 0.0), velocity_km_per_s: ArrayLike) -> Observer:
        """Another observer, given relative to this one: a satellite about the Earth, axes of icrs."""
        step = np.asarray(position_km, np.float64) * 1e3 / constants.au
        return Observer(
            position_au=self.position_au + step,
            from_sun_au=None if self.from_sun_au is None else self.from_sun_au + step,
            velocity_km_per_s=self.velocity_km_per_s + np.asarray(velocity_km_per_s, np.float64),
        )


def earth_observer(epoch_year: float) -> Observer:
    """The centre of the Earth, from astropy's built-in ephemeris (ERFA epv00: 5 mm/s, 14 km at worst 1900 ... 2100).

    Parameters
    ----------
    epoch_year : float
        Julian year (TDB).

    Returns
    -------
    Observer
        Position and velocity, for `load_sky`.

    Raises
    ------
    DomainError
        Before 1900 or after 2100.
    """
    from astropy import units
    from astropy.coordinates import get_body_barycentric, get_body_barycentric_posvel
    from astropy.time import Time

    if not 1900.0 <= epoch_year <= 2100.0:
        raise DomainError(f"epoch_year = {epoch_year:g}; the Earth's position is available for 1900 ... 2100")
    time = Time(epoch_year, format="jyear", scale="tdb")
    position, velocity = get_body_barycentric_posvel("earth", time, ephemeris="builtin")
    sun = get_body_barycentric("sun", time, ephemeris="builtin")
    return Observer(
        position_au=position.xyz.to_value(units.au),
        velocity_km_per_s=velocity.xyz.to_value(units.km / units.s),
        from_sun_au=(position - sun).xyz.to_value(units.au),
    )


def _interval(catalog: StarCatalog, epoch_year: float) -> float:
    years = float(epoch_year) - catalog.epoch_year
    if not abs(years) <= _LONGEST_YEAR:
        raise DomainError(f"epoch_year = {epoch_year:g}; it must lie within {_LONGEST_YEAR:g} years of the catalogue's")
    return years


def _motion(catalog: StarCatalog) -> tuple[FloatArray, FloatArray]:
    """Velocity over distance (n, 3) [rad/year] and parallax (n,) [rad]; unknown values are zero."""
    r = catalog.direction
    horizontal = np.hypot(r[:, 0], r[:, 1])
    polar = horizontal == 0.0  # right ascension 0 by convention
    safe = np.where(polar, 1.0, horizontal)
    sine, cosine = r[:, 1] / safe, np.where(polar, 1.0, r[:, 0] / safe)
    mu = np.nan_to_num(catalog.proper_motion_rad_per_year, nan=0.0)
    parallax = np.maximum(np.nan_to_num(catalog.parallax_rad, nan=0.0), 0.0)
    radial = np.nan_to_num(catalog.radial_velocity_km_per_s, nan=0.0) / _AU_PER_YEAR_KM_PER_S * parallax
    north = -r[:, 2] * mu[:, 1]
    velocity = radial[:, None] * r
    velocity[:, 0] += cosine * north - sine * mu[:, 0]
    velocity[:, 1] += sine * north + cosine * mu[:, 0]
    velocity[:, 2] += horizontal * mu[:, 1]
    return velocity, parallax


def _light_years(velocity: FloatArray, parallax: FloatArray) -> FloatArray:
    """Distances; 0 where not known, or where the star would move at a tenth of the velocity of light."""
    light_years = np.divide(_LIGHT_YEAR_PER_AU, parallax, out=np.zeros_like(parallax), where=parallax > 0)
    return np.where(_length(velocity) * light_years < 0.1, light_years, 0.0)


def _moved(catalog: StarCatalog, years: FloatArray | float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions of stars after years of observation.

    Returns place (n, 3) and velocity (n, 3) over the distance at the epoch, the velocity per year in the frame of the
    barycentre, and parallax (n,).
    """
    velocity, parallax = _motion(catalog)
    distance = _light_years(velocity, parallax)
    elapsed = np.broadcast_to(np.asarray(years, np.float64), parallax.shape)
    position = catalog.direction + elapsed[:, None] * velocity
    near = np.flatnonzero(distance)
    r, observed, distance_ly, waiting = catalog.direction[near], velocity[near], distance[near], elapsed[near]
    # velocities in units of that of light; d is the Doppler factor without the clock, slow the slower clock
    beta_radial = np.einsum("ij,ij->i", observed, r) * distance_ly
    across = observed * distance_ly[:, None] - beta_radial[:, None] * r
    radial, d, slow = beta_radial, np.ones_like(distance_ly), np.zeros_like(distance_ly)
    for _ in range(_STEPS):  # each is nearer by the star's velocity over that of light
        d = 1.0 + radial
        slow = _clock(radial, d * _length(across))
        radial = d * beta_radial + slow
    true = (d[:, None] * across + (d * beta_radial + slow)[:, None] * r) / distance_ly[:, None]
    end = r + waiting[:, None] * true
    for _ in range(_STEPS):
        end = r + (waiting + distance_ly * (1.0 - _length(end)))[:, None] * true
    position[near], velocity[near] = end, true
    return position, velocity, parallax


def _clock(radial: FloatArray, across: FloatArray) -> FloatArray:
    """1/gamma - 1 of velocities in units of that of light."""
    square = radial * radial + across * across
    return np.asarray(-square / (np.sqrt(1.0 - square) + 1.0))


def _observed(position: FloatArray, velocity: FloatArray, parallax: FloatArray) -> FloatArray:
    """Velocity over distance (n, 3) per year of arrival, from the one in the frame of the barycentre."""
    r = _unit(position)
    distance = _light_years(velocity, parallax)
    radial = np.einsum("ij,ij->i", velocity, r)
    across = velocity - radial[:, None] * r
    slow = _clock(radial * distance, _length(across) * distance)
    d = 1.0 + radial * distance
    slow = np.divide(slow, distance, out=np.zeros_like(slow), where=distance > 0)
    return np.asarray((across + (radial - slow)[:, None] * r) / (d * _length(position))[:, None])


def _length(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / _length(vectors)[:, None])


def directions_at(catalog: StarCatalog, epoch_year: float, observer: Observer | None = None) -> FloatArray:
    """Directions (n, 3) along icrs in which the stars are seen; a motion or parallax that is not known counts as zero.

    An observer adds parallax, deflection and aberration; without one they are those from the barycentre at rest.
    """
    years = _interval(catalog, epoch_year)
    if observer is None:
        return _unit(_moved(catalog, years)[0])
    earlier = np.einsum("ij,j->i", catalog.direction, observer.position_au * _LIGHT_YEAR_PER_AU)
    position, _, parallax = _moved(catalog, years + earlier)
    apparent = _unit(position - parallax[:, None] * observer.position_au)
    if observer.from_sun_au is not None:
        apparent = deflected(apparent, observer.from_sun_au)
    return aberrated(apparent, observer.velocity_km_per_s)


def deflected(direction: ArrayLike, from_sun_au: ArrayLike) -> FloatArray:
    """Directions of stars whose light the Sun bends; behind its disk the deflection is that of the edge."""
    # direction (n, 3), from_sun_au (3,) [au] -> (n, 3)
    r, sun_to_observer = np.asarray(direction, np.float64), np.asarray(from_sun_au, np.float64)
    if r.ndim != 2 or r.shape[1] != 3 or sun_to_observer.shape != (3,):
        raise DomainError(f"directions (n, 3) and a place (3,) are needed, got {r.shape} and {sun_to_observer.shape}")
    distance = float(np.linalg.norm(sun_to_observer))
    if not distance > _SUN_RADIUS_AU:
        raise DomainError(
            f"the observer is {distance:g} au from the centre of the Sun; {_SUN_RADIUS_AU} au is its edge"
        )
    away = sun_to_observer / distance
    along = r @ away  # minus the cosine of the angle to the Sun
    edge = (_SUN_RADIUS_AU / distance) ** 2 / 2.0
    bend = _SUN_AU / distance / np.maximum(1.0 + along, edge)
    return _unit(r + bend[:, None] * (away - along[:, None] * r))


def propagate(catalog: StarCatalog, epoch_year: float) -> StarCatalog:
    """The catalogue at another epoch; a motion or parallax that is not known counts as zero and stays NaN."""
    position, velocity, parallax = _moved(catalog, _interval(catalog, epoch_year))
    nearer = 1.0 / _length(position)
    direction = position * nearer[:, None]
    rate = _observed(position, velocity, parallax)
    along = np.einsum("ij,ij->i", rate, direction)
    horizontal = np.hypot(direction[:, 0], direction[:, 1])
    polar = horizontal == 0.0
    safe = np.where(polar, 1.0, horizontal)
    sine, cosine = direction[:, 1] / safe, np.where(polar, 1.0, direction[:, 0] / safe)
    east = cosine * rate[:, 1] - sine * rate[:, 0]
    north = horizontal * rate[:, 2] - direction[:, 2] * (cosine * rate[:, 0] + sine * rate[:, 1])
    motion = np.where(np.isnan(catalog.proper_motion_rad_per_year), np.nan, np.stack([east, north], axis=1))
    away = _AU_PER_YEAR_KM_PER_S * np.divide(along, parallax * nearer, out=np.zeros_like(along), where=parallax > 0)
    speed = np.where(parallax > 0, away, catalog.radial_velocity_km_per_s)
    return replace(
        catalog,
        epoch_year=float(epoch_year),
        direction=direction,
        proper_motion_rad_per_year=motion,
        parallax_rad=catalog.parallax_rad * nearer,
        radial_velocity_km_per_s=np.where(np.isnan(catalog.radial_velocity_km_per_s), np.nan, speed),
    )
