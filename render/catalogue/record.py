"""Star catalogues: one record for all of them, missing values NaN."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze
from optics.units import ARCSEC_RAD, RAD_ARCSEC, RAD_DEG

MAS_RAD = ARCSEC_RAD * 1e-3
_COLUMNS = ("parallax_rad", "radial_velocity_km_per_s", "magnitude", "bp_rp_mag", "b_v_mag", "effective_temperature_k")
# Beyond these no star is known; a value beyond them is in another unit. Barnard's star 10.4"/year, Proxima 0.77".
_FASTEST_RAD_PER_YEAR = 30.0 * ARCSEC_RAD
_NEAREST_RAD = 2.0 * ARCSEC_RAD
# What stars, and the planets beside them, can have. The Sun has V = -26.7; the stars about the centre of the Galaxy
# reach 24 000 km/s (Peissker et al., ApJ 899, 50 (2020)); reddened carbon stars B-V = 6, young white dwarfs 2e5 K.
_POSSIBLE = {
    "magnitude": (-28.0, 40.0, "mag"),
    "bp_rp_mag": (-3.0, 15.0, "mag"),
    "b_v_mag": (-3.0, 12.0, "mag"),
    "radial_velocity_km_per_s": (-3e4, 3e4, "km/s"),
    "effective_temperature_k": (300.0, 1e6, "K"),
}


def direction_from_angles(ra_rad: ArrayLike, dec_rad: ArrayLike) -> FloatArray:
    """Unit vectors (n, 3) of right ascension and declination (n,) [rad]."""
    ra, dec = np.asarray(ra_rad, np.float64), np.asarray(dec_rad, np.float64)
    if dec.size and np.nanmax(np.abs(dec)) > math.pi / 2 * (1 + 1e-12):
        worst = float(dec.flat[np.nanargmax(np.abs(dec))])
        raise DomainError(f"declination {worst:g} rad is beyond the pole (pi/2); are the angles in degrees?")
    direction = np.empty((*np.broadcast_shapes(ra.shape, dec.shape), 3))
    cos_dec = np.cos(dec)
    direction[..., 0] = np.cos(ra) * cos_dec
    direction[..., 1] = np.sin(ra) * cos_dec
    direction[..., 2] = np.sin(dec)
    return direction


def _unknown() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarCatalog:
    """Star catalogue at a single epoch; unknown values are NaN.

    Attributes
    ----------
    name, source, attribution : str
        What it is, where it comes from, and what its licence asks to be said.
    epoch_year : float
        Julian year (TCB or TDB) of directions and proper motions.
    magnitude_system : {"V", "G"}
        What ``magnitude`` is measured in (`optics.light.magnitudes.magnitude_system`).
    id : (n,) int64
        Number in the catalogue that ``source`` names.
    direction : (n, 3)
        Unit vectors in icrs from the barycentre of the solar system.
    proper_motion_rad_per_year : (n, 2)
        Towards growing right ascension (times cos dec) and declination, per Julian year.
    parallax_rad : (n,)
        Parallax; not positive or NaN is taken for infinitely far.
    radial_velocity_km_per_s : (n,)
        Away from the Sun.
    magnitude : (n,)
        Magnitudes in ``magnitude_system``.
    bp_rp_mag, b_v_mag : (n,)
        Colours BP-RP (Gaia) and B-V (Johnson).
    effective_temperature_k : (n,)
        Effective temperature, given or from the colour (`render.catalogue.temperature`).
    notes : tuple of str
        What the reader left out or put in.

    Columns other than ``id`` and ``direction`` may be left out; they are filled with NaN.

    Raises
    ------
    DomainError
        Wrong shapes, vectors that are not of unit length (1e-9), infinite values, motions or parallaxes so large that
        their unit must be another.
    ConfigError
        Unknown magnitude system, no source.
    """

    name: str
    source: str
    epoch_year: float
    magnitude_system: Literal["V", "G"]
    id: NDArray[np.int64]
    direction: FloatArray
    attribution: str = ""
    proper_motion_rad_per_year: FloatArray = field(default_factory=_unknown)
    parallax_rad: FloatArray = field(default_factory=_unknown)
    radial_velocity_km_per_s: FloatArray = field(default_factory=_unknown)
    magnitude: FloatArray = field(default_factory=_unknown)
    bp_rp_mag: FloatArray = field(default_factory=_unknown)
    b_v_mag: FloatArray = field(default_factory=_unknown)
    effective_temperature_k: FloatArray = field(default_factory=_unknown)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "id", shape=("n",), dtype=np.int64, sizes=sizes)
        direction = freeze(self, "direction", shape=("n", 3), sizes=sizes)
        count = len(direction)
        for name, shape in (("proper_motion_rad_per_year", (count, 2)), *((name, (count,)) for name in _COLUMNS)):
            if not np.size(getattr(self, name)):
                object.__setattr__(self, name, np.full(shape, np.nan))
            values = freeze(self, name, shape=shape, finite=False)
            if np.isinf(values).any():
                raise DomainError(f"StarCatalog.{name} of star {np.argwhere(np.isinf(values))[0][0]} is infinite")
        if self.magnitude_system not in ("V", "G"):
            raise ConfigError(f"StarCatalog.magnitude_system = {self.magnitude_system!r}; 'V' or 'G' is needed")
        if not self.source:
            raise ConfigError(f"catalogue {self.name!r} needs a source; say where its numbers come from")
        if not (1000.0 < self.epoch_year < 3000.0):
            raise DomainError(f"StarCatalog.epoch_year = {self.epoch_year:g}; a Julian year such as 2016.0 is needed")
        self._check_values()

    def _check_values(self) -> None:
        length = np.einsum("ij,ij->i", self.direction, self.direction)
        if len(length) and np.abs(length - 1.0).max() > 2e-9:
            worst = int(np.argmax(np.abs(length - 1.0)))
            raise DomainError(
                f"StarCatalog.direction[{worst}] has length {math.sqrt(length[worst]):.9g}; unit vectors are needed"
            )
        for name, limit, unit in (
            ("proper_motion_rad_per_year", _FASTEST_RAD_PER_YEAR, "arcsec/year"),
            ("parallax_rad", _NEAREST_RAD, "arcsec"),
        ):
            values = np.abs(getattr(self, name))
            if values.size and np.nanmax(values, initial=0.0) > limit:
                worst = int(np.argwhere(values > limit)[0][0])
                raise DomainError(
                    f"StarCatalog.{name} of star {worst} (id {self.id[worst]}) is {values[worst].max() * RAD_ARCSEC:g} "
                    f"{unit}, more than the {limit * RAD_ARCSEC:g} any star has; check its unit"
                )

        for name, (low, high, unit) in _POSSIBLE.items():
            values = getattr(self, name)
            beyond = (values < low) | (values > high)
            if beyond.any():
                at = int(np.argmax(beyond))
                raise DomainError(
                    f"{self.name}: {name} of star {at} (id {self.id[at]}) is {values[at]:g} {unit}, outside "
                    f"{low:g} ... {high:g}; is it a code for a missing value?"
                )

    def __len__(self) -> int:
        return len(self.id)

    @property
    def ra_rad(self) -> FloatArray:
        """Right ascension [rad], 0 ... 2 pi."""
        return np.asarray(np.arctan2(self.direction[:, 1], self.direction[:, 0]) % (2.0 * math.pi))

    @property
    def dec_rad(self) -> FloatArray:
        """Declination [rad]."""
        x, y, z = self.direction.T
        return np.asarray(np.arctan2(z, np.hypot(x, y)))

    def select(self, rows: ArrayLike) -> StarCatalog:
        """The stars of a boolean mask or of row numbers (n,), in that order."""
        chosen = np.asarray(rows)
        if chosen.dtype != np.bool_:
            chosen = chosen.astype(np.int64)
        columns: dict[str, Any] = {
            name: getattr(self, name)[chosen] for name in ("id", "direction", "proper_motion_rad_per_year", *_COLUMNS)
        }
        return replace(self, **columns)

    def row_of(self, identifier: int) -> int:
        """Row of a star by its id; `ConfigError` without such a star."""
        rows = np.flatnonzero(self.id == identifier)
        if not len(rows):
            raise ConfigError(f"catalogue {self.name!r} has no star with id {identifier}")
        return int(rows[0])

    def __repr__(self) -> str:
        bright, faint = np.nanmin(self.magnitude, initial=np.inf), np.nanmax(self.magnitude, initial=-np.inf)
        ra, dec = self.ra_rad * RAD_DEG, self.dec_rad * RAD_DEG
        where = (
            f", ra {ra.min():.2f} ... {ra.max():.2f}, dec {dec.min():.2f} ... {dec.max():.2f} deg" if len(self) else ""
        )
        return (
            f"<StarCatalog {self.name!r}: {len(self)} stars, {self.magnitude_system} {bright:.2f} ... {faint:.2f}, "
            f"epoch {self.epoch_year:g}{where}>"
        )
