"""Stars in the field in many attitudes, without noise: identities, brightness, colour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from experiments.laboratory.settings.prediction import PredictedSensorConfig
from optics.arrays import FloatArray
from optics.errors import DomainError
from render.catalogue.index import build_index
from render.catalogue.temperature import star_temperature
from render.engine.random import Streams
from render.sensor_file.catalogue import load_catalogue
from render.sensor_file.instrument import build_instrument
from render.sensor_file.tables import CatalogueConfig, InstrumentConfig
from render.sky.field import FieldOfView, field_of_view
from render.sky.sampling import SkySample, sample_sky

DEPTH_STEP_MAG = 0.5
SIGHTINGS = 400_000
"""Number of stars up to which attitudes are looked up; wide fields need fewer attitudes."""
FEWEST = 100
_LAYERS = 32


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


def sky_view(config: PredictedSensorConfig, limit_mag: float) -> SkyView:
    """Stars to a magnitude or to where the catalogue ends, for the lens as designed; the last views are kept."""
    deep = DEPTH_STEP_MAG * float(np.ceil(limit_mag / DEPTH_STEP_MAG))
    kept = {name: getattr(config.instrument, name) for name in ("lens", "detector", "width_px", "height_px")}
    # coatings and absorption play no part: a lens without transmittance data has a field of view too
    plain = InstrumentConfig(**kept, defocus_mm=0.0, absorption=False, coating_nm=0.0)
    depth = min(deep, config.catalogue.faintest_mag)
    return _sky_view(plain, config.catalogue, config.window_px, depth, config.sky.attitudes, config.seed)


@lru_cache(maxsize=_LAYERS)
def _view(config: InstrumentConfig) -> FieldOfView:
    return field_of_view(build_instrument(config).camera, margin_px=0.0)


@lru_cache(maxsize=_LAYERS)
def _sky_view(
    instrument: InstrumentConfig, catalogue: CatalogueConfig, window_px: int, depth: float, attitudes: int, seed: int
) -> SkyView:
    whole = load_catalogue(catalogue)
    bright = np.flatnonzero(whole.magnitude <= depth)
    if not len(bright):
        brightest = float(np.nanmin(whole.magnitude))
        raise DomainError(
            f"no star of catalogue {whole.name} is brighter than the sensor's limiting magnitude of {depth:g} mag; "
            f"the brightest has {brightest:.2f} mag"
        )
    stars = whole.select(bright)
    view = _view(instrument)
    solid = 4.0 * float(np.prod(np.arctan(view.half_width)))  # of 4 pi, nearly
    expected = max(len(bright) * solid / (4.0 * np.pi), 1e-3)
    count = int(np.clip(SIGHTINGS / expected, min(FEWEST, attitudes), attitudes))
    turned = Rotation.random(count, rng=Streams(seed).child("camera").generator("attitudes"))
    sample = sample_sky(build_index(stars), view, turned)
    pixel_rad = 2.0 * float(np.arctan(view.half_width[0])) / view.width_px
    reach = window_px * np.sqrt(1.0 / np.pi) * pixel_rad  # a circle of the area of the window
    pairs = cKDTree(stars.direction).query_pairs(reach, output_type="ndarray")
    neighbour, brighter = np.full(len(stars), np.inf), np.full(len(stars), np.inf)
    apart_px = np.linalg.norm(np.subtract(*(stars.direction[k] for k in pairs.T)), axis=1) / pixel_rad
    for a, b in (pairs.T, pairs[:, ::-1].T):
        np.minimum.at(neighbour, a, stars.magnitude[b])
        outshone = stars.magnitude[b] < stars.magnitude[a]
        np.minimum.at(brighter, a[outshone], apart_px[outshone])
    row: NDArray[np.int64] = sample.row
    middle = np.array([view.width_px - 1, view.height_px - 1]) / 2.0
    return SkyView(
        sample=sample,
        magnitude=stars.magnitude[row],
        temperature_k=star_temperature(stars, catalogue.temperature)[row],
        radius_px=np.hypot(*(sample.pixel_px - middle).T),
        neighbour_mag=neighbour[row],
        brighter_px=brighter[row],
        attitudes=turned,
        depth_mag=depth,
    )
