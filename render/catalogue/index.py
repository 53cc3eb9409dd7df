"""Stars around a direction: a k-d tree on the unit vectors of a catalogue."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.errors import DomainError
from render.catalogue.record import StarCatalog

# Leaves of 64 without balancing cost the same to search as scipy's defaults and half as much to build.
_LEAF_SIZE = 64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SkyIndex:
    """A catalogue with its search tree; made by `build_index`."""

    catalog: StarCatalog  # The stars
    tree: Any  # Over their directions at the epoch of the catalogue
    fastest_rad_per_year: float  # Largest known proper motion
    nearest_rad: float  # Largest known parallax

    def __len__(self) -> int:
        return len(self.catalog)

    def within(
        self, direction: ArrayLike, radius_rad: float, *, magnitude_limit: float | None = None
    ) -> NDArray[np.int64]:
        """Rows of all stars in a cone."""
        # direction (3,) -> (m,)
        centre = np.asarray(direction, np.float64)
        if centre.shape != (3,) or not abs(float(centre @ centre) - 1.0) < 2e-9:
            raise DomainError(f"direction {centre.tolist()} is no unit vector of three components")
        if not 0.0 < radius_rad <= math.pi:
            raise DomainError(f"radius_rad = {radius_rad:g}; it must be above 0 and at most pi")
        # the chord of the cone's half angle: exact for small angles, where a cosine would not be
        rows = np.array(
            self.tree.query_ball_point(centre, 2.0 * math.sin(radius_rad / 2.0), return_sorted=True), dtype=np.int64
        )
        if magnitude_limit is None:
            return rows
        if math.isnan(magnitude_limit):
            raise DomainError("magnitude_limit is NaN; give the faintest magnitude wanted, or leave it out")
        return np.asarray(rows[self.catalog.magnitude[rows] <= magnitude_limit])


def build_index(catalog: StarCatalog) -> SkyIndex:
    """Search tree of a catalogue of at least one star."""
    from scipy.spatial import cKDTree

    if not len(catalog):
        raise DomainError(f"catalogue {catalog.name!r} is empty; there is nothing to search")
    motion = np.hypot(*catalog.proper_motion_rad_per_year.T)
    return SkyIndex(
        catalog=catalog,
        tree=cKDTree(catalog.direction, leafsize=_LEAF_SIZE, balanced_tree=False, compact_nodes=False),
        fastest_rad_per_year=float(np.nanmax(motion, initial=0.0)),
        nearest_rad=float(np.nanmax(catalog.parallax_rad, initial=0.0)),
    )
