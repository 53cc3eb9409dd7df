"""Where light of one colour falls, by ray trace: the truth that calibrated cameras are compared with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from experiments.skycal.scene import Scene
from experiments.skycal.settings import Config
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from render.tracing.tracer import Tracer

__all__ = ["Chart", "trace_chart", "trace_colour"]


TRACE_AT_ONCE = 2000
EDGE_FRACTION = 0.012
"""The chart ends this part of the longer side inside the detector, so that its traced points stay on it."""
CHART_LOG2_RAYS = 3
"""The truth gets eight times the rays of a star: errors of some 1e-3 px average out over stars, but not in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """The truth: where light of the reference colour falls, traced."""

    direction: FloatArray  # (n, 3) Unit vectors in cam
    pixel_px: FloatArray  # (n, 2) Mean of the rays
    rows: int  # Grid, row by row; rows times columns is n
    columns: int  # Grid, row by row; rows times columns is n

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "direction", shape=("n", 3), sizes=sizes)
        freeze(self, "pixel_px", shape=("n", 2), sizes=sizes)


def trace_colour(scene: Scene, direction: FloatArray, temperature_k: float, *, more_log2_rays: int = 0) -> FloatArray:
    """Where the mean of the rays of a star of one colour falls: (n, 2) [px], no image, no noise."""
    camera = scene.instrument.camera
    # one pixel of an image is enough where only rays count
    tiny = replace(camera, width_px=1, height_px=1, centre_px=camera.centre_px)
    tracer = Tracer(tiny, sobol_log2_rays=scene.config.sobol_log2_rays + more_log2_rays)
    parts = []
    for start in range(0, len(direction), TRACE_AT_ONCE):
        stars = scene.of_one_colour(direction[start : start + TRACE_AT_ONCE], temperature_k)
        if tracer.pupil.exact:  # a mean needs few rays where nothing cuts the bundle
            parts.append(tracer.bundle_means(stars, rings=8, arms=20)[:, 0])
        else:
            truth = tracer.render(stars, exposure_s=1.0).truth
            parts.append(np.column_stack([truth.bundle_x_px, truth.bundle_y_px]))
    if not parts:
        raise DomainError(f"{scene.name}: no star to trace")
    return np.concatenate(parts)


def trace_chart(scene: Scene, config: Config) -> Chart:
    """Trace the truth on a regular grid of nominal pixels."""
    camera = scene.instrument.camera
    longer = max(camera.width_px, camera.height_px)
    columns, rows = (max(3, round(config.map_points * n / longer)) for n in (camera.width_px, camera.height_px))
    edge = EDGE_FRACTION * longer
    x, y = np.meshgrid(
        np.linspace(edge, camera.width_px - 1 - edge, columns), np.linspace(edge, camera.height_px - 1 - edge, rows)
    )
    direction = camera.nominal_direction(x.ravel(), y.ravel(), scene.instrument.focal_length_mm)
    pixel = trace_colour(scene, direction, config.sky.reference_k, more_log2_rays=CHART_LOG2_RAYS)
    if not np.isfinite(pixel).all():
        dark = int((~np.isfinite(pixel).all(axis=1)).sum())
        raise DomainError(
            f"{scene.name}: no light reaches {dark} of {len(pixel)} places of the detector through lens "
            f"{camera.lens.name!r}; set {scene.name}.instrument.width_px and height_px smaller"
        )
    return Chart(direction=direction, pixel_px=pixel, rows=rows, columns=columns)
