"""Stars in the field in many attitudes, with their neighbours, without rendering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from render.catalogue.index import build_index
from render.catalogue.record import StarCatalog
from render.sky.field import FieldOfView
from render.sky.sampling import SkySample, sample_sky


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SkyView:
    """Made by `sky_view`; m sightings of stars in f attitudes."""

    sample: SkySample  # Which star where
    magnitude: FloatArray  # (m,) Of each sighting
    temperature_k: FloatArray  # (m,)
    radius_px: FloatArray  # (m,) From the middle of the detector
    neighbour_mag: FloatArray  # (m,) Brightest star within the window; infinite where there is none
    # (m,) Distance of the nearest brighter star within the window; infinite where there is none
    brighter_px: FloatArray
    attitudes: Rotation  # cam from icrs
    depth_mag: float  # Faintest catalogue stars used


def expected_stars(stars: int, view: FieldOfView) -> float:
    """Mean number in a field of stars that are spread over the sky, at least 0.001."""
    solid_angle = 4.0 * float(np.prod(np.arctan(view.half_width)))  # of 4 pi, nearly
    return max(stars * solid_angle / (4.0 * np.pi), 1e-3)


def sky_view(
    stars: StarCatalog,
    temperature_k: FloatArray,
    view: FieldOfView,
    attitudes: Rotation,
    *,
    window_px: int,
    depth_mag: float,
) -> SkyView:
    """Look up the n stars of a catalogue, with their temperatures (n,), in attitudes (f), cam from icrs.

    A neighbour disturbs within a circle of the area of the window. ``depth_mag`` is kept as a note.
    """
    sample = sample_sky(build_index(stars), view, attitudes)
    pixel_rad = 2.0 * float(np.arctan(view.half_width[0])) / view.width_px
    neighbour, brighter = neighbours(stars.direction, stars.magnitude, window_px * np.sqrt(1.0 / np.pi) * pixel_rad)
    row, middle = sample.row, np.array([view.width_px - 1, view.height_px - 1]) / 2.0
    return SkyView(
        sample=sample,
        magnitude=stars.magnitude[row],
        temperature_k=temperature_k[row],
        radius_px=np.hypot(*(sample.pixel_px - middle).T),
        neighbour_mag=neighbour[row],
        brighter_px=brighter[row] / pixel_rad,
        attitudes=attitudes,
        depth_mag=depth_mag,
    )


def neighbours(direction: FloatArray, magnitude: FloatArray, reach_rad: float) -> tuple[FloatArray, FloatArray]:
    """Brightest other star within reach of stars (n, 3), and the distance [rad] of the nearest brighter one.

    Shapes (n,); infinite where there is none. Small angles: chords stand for arcs.
    """
    pairs = cKDTree(direction).query_pairs(reach_rad, output_type="ndarray")
    brightest, nearest = np.full(len(direction), np.inf), np.full(len(direction), np.inf)
    separation = np.linalg.norm(np.subtract(*(direction[k] for k in pairs.T)), axis=1)
    for a, b in (pairs.T, pairs[:, ::-1].T):
        np.minimum.at(brightest, a, magnitude[b])
        outshone = magnitude[b] < magnitude[a]
        np.minimum.at(nearest, a[outshone], separation[outshone])
    return brightest, nearest
