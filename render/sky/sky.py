"""The sky of one observer at one time: stars, their observed directions and their light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze_all
from render.catalogue.index import SkyIndex, build_index
from render.catalogue.motion import Observer, directions_at, earth_observer
from render.catalogue.record import StarCatalog
from render.catalogue.temperature import star_temperature
from render.records import StarField
from render.sky.field import FieldOfView, SkyField, field_of
from render.sky.star_light import StarLight

FAINTEST_MAG = 8.0
EPOCH_YEAR = 2016.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Sky:
    """Stars as seen by an observer; created by `load_sky`.

    Attributes
    ----------
    index : SkyIndex
        n catalogue stars with their search tree.
    direction : (n, 3)
        Apparent directions, unit vectors in icrs at the epoch, with parallax and aberration if there is an observer.
        Attitudes are solved with these.
    temperature_k : (n,)
        Black-body temperatures of the stars.
    epoch_year : float
        Julian year of the exposure.
    observer : Observer or None
        Where the camera is; None is the barycentre of the solar system.
    """

    index: SkyIndex
    direction: FloatArray
    temperature_k: FloatArray
    epoch_year: float
    observer: Observer | None = None

    def __post_init__(self) -> None:
        freeze_all(self, direction=("n", 3), temperature_k=("n",), sizes={"n": len(self.index)})

    def __repr__(self) -> str:
        seen_from = "the barycentre" if self.observer is None else "an observer"
        text = f"{len(self)} stars of {self.catalog.name}, seen from {seen_from} in {self.epoch_year:g}"
        if count := int(self.unmoved.sum()):
            text += f"; {count} without proper motion stay at {self.catalog.epoch_year:g}"
        return f"<Sky of {text}>"

    def __len__(self) -> int:
        return len(self.index)

    @property
    def catalog(self) -> StarCatalog:
        """The stars at the epoch of the catalogue."""
        return self.index.catalog

    @property
    def id(self) -> NDArray[np.int64]:
        """Identifiers (n,): Gaia's source_id, -HIP, or what the catalogue counts by."""
        return self.catalog.id

    @property
    def magnitude(self) -> FloatArray:
        """Magnitudes (n,) in the system of the catalogue."""
        return self.catalog.magnitude

    @property
    def unmoved(self) -> NDArray[np.bool_]:
        """Stars (n,) that stay at the epoch of the catalogue, since it holds no proper motion of theirs."""
        if self.epoch_year == self.catalog.epoch_year:
            return np.zeros(len(self), bool)
        return np.asarray(np.isnan(self.catalog.proper_motion_rad_per_year).any(axis=1))

    def field(self, view: FieldOfView, attitude: Rotation, *, velocity_km_per_s: ArrayLike | None = None) -> SkyField:
        """Stars that a camera sees in an attitude, cam from icrs; `SkyField.row` counts in this sky.

        A velocity (3,) of the camera along icrs takes the place of the observer's.
        """
        return field_of(
            self.index,
            view,
            attitude,
            epoch_year=self.epoch_year,
            observer=self.observer,
            velocity_km_per_s=velocity_km_per_s,
        )

    def star_field(self, field: SkyField, light: StarLight) -> StarField:
        """The stars of a field with their light, prepared for the magnitudes of the catalogue (`ConfigError`)."""
        if light.magnitude_system != self.catalog.magnitude_system:
            raise ConfigError(
                f"bands were prepared for {light.magnitude_system} magnitudes, the catalogue has "
                f"{self.catalog.magnitude_system}; star_light(..., magnitude_system={self.catalog.magnitude_system!r})"
            )
        return light.stars(field.direction, field.stars.magnitude, self.temperature_k[field.row])


def load_sky(
    catalogue: StarCatalog | None = None,
    *,
    faintest_mag: float = FAINTEST_MAG,
    epoch_year: float = EPOCH_YEAR,
    observer: Observer | Literal["earth"] | None = None,
    temperature: Literal["colour", "effective"] = "colour",
) -> Sky:
    """Stars to a magnitude limit, as seen by an observer.

    Parameters
    ----------
    catalogue : StarCatalog, optional
        The stars (`render.catalogue.read.read_catalog` for files); Gaia DR3 and Hipparcos to G = 10 if left out, which
        come with the program and need no network.
    faintest_mag : float
        Faintest star, in the magnitudes of the catalogue. A star tracker of 13 mm aperture centroids stars to about 7
        in 0.2 s.
    epoch_year : float
        Julian year of the exposures. Stars of the built-in sky that Hipparcos-2 does not know (1.9 % to G = 6, 7 % to
        7, 22 % to 8, half to 9) have no proper motion and stay at 2016.0, see `Sky.unmoved`.
    observer : Observer or "earth", optional
        Adds parallax, deflection by the Sun and aberration (20 arcsec); left out: seen from the barycentre.
    temperature : {"colour", "effective"}
        Temperature of the black body that stands for a star (`render.catalogue.temperature.star_temperature`).

    Returns
    -------
    Sky
        Directions, magnitudes and temperatures, with a search tree.

    Raises
    ------
    ConfigError, DomainError
        The built-in catalogue is missing; no star is bright enough; epoch out of range.
    """
    stars_of_sky = built_in_catalogue(epoch_year != EPOCH_YEAR) if catalogue is None else catalogue
    bright = np.flatnonzero(stars_of_sky.magnitude <= faintest_mag)
    if not len(bright):
        raise DomainError(
            f"faintest_mag = {faintest_mag:g}: catalogue {stars_of_sky.name} has no star that bright; raise it"
        )
    stars = stars_of_sky.select(bright)
    viewer = earth_observer(epoch_year) if observer == "earth" else observer
    assert not isinstance(viewer, str)
    return Sky(
        index=build_index(stars),
        direction=directions_at(stars, epoch_year, viewer),
        temperature_k=star_temperature(stars, temperature),
        epoch_year=epoch_year,
        observer=viewer,
    )


@cache
def built_in_catalogue(motions: bool) -> StarCatalog:
    """Gaia DR3 and Hipparcos to G = 10, with motions or at 2016.0."""
    from render.catalogue.gaia import load_gaia

    return load_gaia(motions=motions)
