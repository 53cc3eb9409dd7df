"""Point sources that a frame sees: stars of the catalogue, and planets smaller than a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.dataset.frames.plan import FramePlan
from experiments.dataset.frames.scene import Scene, seen_at
from experiments.dataset.frames.sky_light import PLANET_IDS
from optics.arrays import FloatArray
from optics.records import freeze
from render.bodies.solar_system import joined
from render.records import StarField

__all__ = ["PointSources", "point_sources", "smear_px"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointSources:
    """n point sources."""

    light: StarField  # Directions along icrs and light, as the renderer takes them
    star_id: NDArray[np.int64]  # (n,) Who they are
    catalogue_row: NDArray[np.int64]  # (n,) Who they are
    magnitude: FloatArray  # (n,) As the truth tells them
    temperature_k: FloatArray  # (n,) As the truth tells them

    def __post_init__(self) -> None:
        sizes = {"n": len(self.light)}
        for name, kind in (("star_id", np.int64), ("catalogue_row", np.int64), ("magnitude", np.float64)):
            freeze(self, name, shape=("n",), dtype=kind, sizes=sizes)
        freeze(self, "temperature_k", shape=("n",), sizes=sizes, finite=False)

    def __len__(self) -> int:
        return len(self.light)

    @property
    def direction(self) -> FloatArray:
        """Unit vectors (n, 3) along icrs."""
        return self.light.direction


def point_sources(scene: Scene, plan: FramePlan) -> PointSources:
    """Point sources of a frame, stars in the order of the catalogue, planets behind them."""
    field = seen_at(scene, plan.attitude)
    kelvin = scene.temperature_k[field.row]
    stars = PointSources(
        light=scene.light.stars(field.direction, field.stars.magnitude, kelvin),
        star_id=field.stars.id,
        catalogue_row=scene.row[field.row],
        magnitude=field.stars.magnitude,
        temperature_k=kelvin,
    )
    planets = _planets(scene, plan)
    return stars if planets is None else _together(stars, planets)


def smear_px(scene: Scene, seen: PointSources, plan: FramePlan, row_px: FloatArray) -> FloatArray:
    """Motion (n, 2) of chief rays at the design wavelength from the start to the end of their row's exposure [px]."""
    if plan.trajectory is None or not len(seen):
        return np.zeros((len(seen), 2))
    camera = scene.config.instrument
    last = scene.instrument.camera.height_px - 1.0
    starts = plan.start_s + np.clip(np.nan_to_num(row_px), 0.0, last) * (camera.line_time_us * 1e-6)
    direction = np.array(seen.direction)
    ends = [
        scene.view.pixel_of(plan.trajectory.attitude(times).apply(direction))
        for times in (starts, starts + camera.exposure_s)
    ]
    return np.asarray(ends[1] - ends[0])


def _planets(scene: Scene, plan: FramePlan) -> PointSources | None:
    sky, view = scene.sky_light, scene.view
    if sky.points is None or sky.light is None:
        return None
    seen = np.flatnonzero(view.on_detector(view.pixel_of(sky.points.direction @ plan.attitude.as_matrix().T)))
    if not len(seen):
        return None
    light = StarField(
        direction=sky.light.direction[seen],
        wavelength_nm=sky.light.wavelength_nm,
        photon_rate=sky.light.photon_rate[seen],
        band=sky.light.band,
    )
    return PointSources(
        light=light,
        star_id=np.array([PLANET_IDS[sky.points.name[i]] for i in seen]),
        catalogue_row=np.full(len(seen), -1),
        magnitude=sky.points.magnitude_v[seen],
        temperature_k=np.full(len(seen), np.nan),
    )


def _together(first: PointSources, second: PointSources) -> PointSources:
    columns = ("star_id", "catalogue_row", "magnitude", "temperature_k")
    both = {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in columns}
    return PointSources(light=joined(first.light, second.light), **both)
