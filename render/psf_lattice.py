"""PSFs on a lattice over a detector, and the landing points of stars without an image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from optics.arrays import FloatArray
from render.camera import Camera
from render.records import EffectivePsf, StarField
from render.sensor import StarSensor
from render.sky.star_light import StarLight
from render.tracing.psf import TOLERANCE, render_epsf
from render.tracing.tracer import Tracer

TRACE_AT_ONCE = 2000


class PsfLattice:
    """Renders effective PSFs of one camera at regular steps from edge to edge; its tracer is prepared once.

    Parameters
    ----------
    sensor : StarSensor
        Camera and detector.
    light : StarLight
        The pass band.
    spacing_px : float
        About the distance of the PSFs; there are at least two along each axis.
    half_size_px, oversampling, sobol_log2_rays : int
        As in `render.tracing.psf.render_epsf` and `Tracer`.
    """

    def __init__(
        self,
        sensor: StarSensor,
        light: StarLight,
        *,
        spacing_px: float,
        half_size_px: int,
        oversampling: int = 4,
        sobol_log2_rays: int = 16,
    ) -> None:
        self._sensor, self._light = sensor, light
        self._half_size_px, self._oversampling = half_size_px, oversampling
        self._tracer = Tracer(sensor.camera, tolerance=TOLERANCE, sobol_log2_rays=sobol_log2_rays)
        self.lay_out(spacing_px)

    @property
    def size_px(self) -> tuple[int, int]:
        """Columns and rows of the detector."""
        return self._sensor.camera.width_px, self._sensor.camera.height_px

    def lay_out(self, spacing_px: float) -> None:
        """Change the distance of the PSFs."""
        self.columns, self.rows = (1 + max(1, round(n / spacing_px)) for n in self.size_px)
        axes = (np.linspace(-0.5, n - 0.5, k) for n, k in zip(self.size_px, (self.columns, self.rows), strict=True))
        x, y = (v.ravel() for v in np.meshgrid(*axes))
        self._direction = self._sensor.direction_at(x, y)

    def render(self, temperature_k: float) -> tuple[EffectivePsf, ...]:
        """PSFs of one colour, row by row, each centred on the mean of the rays of that colour."""
        stars = self._light.stars(self._direction, 5.0, temperature_k)
        images = render_epsf(self._tracer, stars, half_size_px=self._half_size_px, oversampling=self._oversampling)
        return tuple(row[0] for row in images)


def ray_means_px(camera: Camera, stars: StarField, *, sobol_log2_rays: int = 16) -> FloatArray:
    """Mean landing points (n, 2) [px] of rays of stars of one band in cam: no image, no noise; NaN without light."""
    # one pixel of an image is enough where only rays count
    tiny = replace(camera, width_px=1, height_px=1, centre_px=camera.centre_px)
    tracer = Tracer(tiny, sobol_log2_rays=sobol_log2_rays)
    parts = [np.zeros((0, 2))]
    for start in range(0, len(stars), TRACE_AT_ONCE):
        rows = slice(start, start + TRACE_AT_ONCE)
        some = replace(stars, direction=stars.direction[rows], photon_rate=stars.photon_rate[rows])
        if tracer.pupil.exact:  # a mean needs few rays where nothing cuts the bundle
            parts.append(tracer.bundle_means(some, rings=8, arms=20)[:, 0])
        else:
            truth = tracer.render(some, exposure_s=1.0).truth
            parts.append(np.column_stack([truth.bundle_x_px, truth.bundle_y_px]))
    return np.concatenate(parts)
