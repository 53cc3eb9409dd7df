"""Ghosts of all sources of a lens: stars inside and outside the frame, Sun, Moon and planets in any direction.

For Sun and Moon a table of point-source transmittance (`optics.light.pst`) states the ghost light behind the baffle,
and the traced paths its distribution: their image is scaled to the mean of the table. Without a table the lens has no
baffle. Both bodies are uniform disks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy import constants
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray, IntArray
from optics.light.band import Band, band_nodes
from render.bodies.solar_system import planet_field, solar_system
from render.bodies.stray_light import StrayLight
from render.catalogue.motion import Observer
from render.records import StarField, Truth
from render.sky.sunlight import SUN_RADIUS_KM, sunlight
from render.tracing.ghosts import Ghosting, GhostTruth


def sun_field(from_sun_au: FloatArray, bands: Sequence[Band], *, nodes: int = 5) -> tuple[StarField, float]:
    """The Sun, seen from a place along icrs [au], as a point of light; and the radius of its disk [rad]."""
    rule, distance_au = band_nodes(bands, nodes), float(np.linalg.norm(from_sun_au))
    rate = sunlight(rule.wavelength_nm, distance_au=distance_au) * rule.weight_nm * rule.transmission
    sun = StarField(
        direction=-from_sun_au[None] / distance_au,
        wavelength_nm=rule.wavelength_nm,
        photon_rate=rate[None],
        band=rule.name,
    )
    return sun, math.asin(SUN_RADIUS_KM * 1e3 / constants.au / distance_au)


class GhostSources:
    """Adds the ghosts of a sky to images: of all its stars (along icrs), and of bodies that have a magnitude.

    Without an observer there are stars alone. Ghosts of Sun and Moon hold as much light as ``stray`` says; a table that
    does not tell them apart holds them evenly.
    """

    def __init__(
        self,
        ghosting: Ghosting,
        stars: StarField,
        star_id: IntArray,
        *,
        exposure_s: float,
        bands: Sequence[Band],
        observer: Observer | None,
        epoch_year: float,
        bodies: Sequence[str] = (),
        stray: StrayLight | None = None,
    ) -> None:
        self.ghosting, self.exposure_s = ghosting, exposure_s
        self._stray = stray
        bright, nodes = ghosting.bright(stars, exposure_s), stars.wavelength_nm.shape[1]
        self._id = star_id[bright]
        self._stars = stars.select(bright)
        self._bodies: list[tuple[str, StarField, float]] = []
        if observer is None:
            return
        named = {*bodies} - {"earth"} if stray is None else {*bodies} - {"earth", "moon"}
        if stray is not None and stray.draws_ghosts and observer.from_sun_au is not None:
            named.add("moon")
            self._bodies.append(("sun", *sun_field(observer.from_sun_au, bands, nodes=nodes)))
        system = solar_system(epoch_year, observer=observer, bodies=sorted(named))
        for row in np.flatnonzero(np.isfinite(system.magnitude_v)):
            body = system.select([row])
            radius = 0.5 * float(body.angular_diameter_rad[0]) if body.name[0] == "moon" else 0.0
            self._bodies.append((body.name[0], planet_field(body, bands, nodes=nodes), radius))

    def add(
        self, image: NDArray[np.float32], attitude: Rotation, stars: StarField, star_id: IntArray, truth: Truth
    ) -> tuple[GhostTruth, tuple[str, ...]]:
        """Add ghosts to an image (h, w, b) [e-]; attitude is cam from icrs.

        ``stars`` are the stars of the frame, along icrs, with their truth; ``star_id`` (n,) their identifiers. Returns
        the ghosts, whose rows from ``len(stars)`` on are further sources, and the names of these: ids of stars, then
        bodies.
        """
        turn = attitude.as_matrix().T
        ghosts = [self.ghosting.add(image, stars.direction @ turn, stars.wavelength_nm, truth)]
        direction = self._stars.direction @ turn
        outside = (direction[:, 2] > 0.0) & ~np.isin(self._id, star_id)
        names = [str(ghost) for ghost in self._id[outside].tolist()]
        others = replace(self._stars.select(outside), direction=direction[outside])
        first, seconds = len(stars), self.exposure_s
        ghosts.append(self.ghosting.add_beside(image, others, exposure_s=seconds, first=first))
        table_e_per_s = {} if self._stray is None else self._stray.ghosts(attitude)
        for name, light, radius in self._bodies:
            body_image, number = np.zeros_like(image), first + len(names)
            inside = replace(light, direction=light.direction @ turn)
            ghost = self.ghosting.add_beside(body_image, inside, exposure_s=seconds, radius_rad=radius, first=number)
            if name in table_e_per_s and body_image.any():
                scale = seconds * table_e_per_s[name] / float(body_image.mean(dtype=float))
                body_image *= np.float32(scale)
                scaled = {key: scale * getattr(ghost, key) for key in ("electrons", "electrons_image", "peak_e")}
                ghost = replace(ghost, **scaled)
            elif name in table_e_per_s:
                body_image += np.float32(seconds * table_e_per_s[name])
            image += body_image
            ghosts.append(ghost)
            names.append(name)
        parts = {f.name: np.concatenate([getattr(ghost, f.name) for ghost in ghosts]) for f in fields(GhostTruth)}
        rows = parts["star"] >= first
        source, order = np.unique(parts["star"][rows], return_inverse=True)
        parts["star"][rows] = first + order
        return GhostTruth(**parts), tuple(names[k - first] for k in source)
