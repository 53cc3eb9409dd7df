"""The light of a point target at the camera: images and PSFs, and offsets that differ from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.measure.epsf import draw_epsf
from experiments.laboratory.bench.point_bench import Bench, point_field
from optics.arrays import FloatArray
from optics.units import ARCSEC_RAD
from render.camera import Camera
from render.engine.random import Streams
from render.forward import StarRenderer
from render.records import EffectivePsf, ExpectedImage, StarField
from render.sensor_file.instrument import Instrument
from render.tracing.psf import epsf_tracer, render_epsf
from render.tracing.tracer import Tracer


@dataclass(frozen=True, slots=True)
class TargetLight:
    """Renders targets through one camera; holds what is prepared once (`target_light`)."""

    bench: Bench  # The laboratory
    instrument: Instrument
    renderer: StarRenderer  # For images and for PSFs
    tracer: Tracer

    def image(self, direction: FloatArray) -> ExpectedImage:
        """Noiseless image of points (j, 3) behind every filter, with truth."""
        stars, collimator = point_field(self.bench, self.instrument, direction), self.bench.collimator
        exposure_s, pixel_rad = self.instrument.config.exposure_s, self.instrument.pixel_arcsec * ARCSEC_RAD
        return self.renderer.render(
            stars, motion=None if collimator is None else collimator.motion(exposure_s, pixel_rad)
        )

    def psfs(self, direction: FloatArray, half_size_px: int) -> list[list[EffectivePsf]]:
        """PSF of each of the points (j, 3) behind each filter."""
        stars, collimator = point_field(self.bench, self.instrument, direction), self.bench.collimator
        by_rays = self.instrument.camera.diffraction == "rays"
        found = render_epsf((not by_rays and self.renderer.tracer) or self.tracer, stars, half_size_px=half_size_px)
        if collimator is None:
            return found
        pixel_rad = self.instrument.pixel_arcsec * ARCSEC_RAD
        return [[collimator.pinhole_psf(psf, pixel_rad) for psf in row] for row in found]


def bundle_means(camera: Camera, stars: StarField) -> FloatArray:
    """Mean landing points (n, b, 2) [px] by the renderer's kernel, without an image; rays count by the transmission of
    their paths where the camera has losses."""
    return Tracer(camera, general=True).bundle_means(stars, rings=4, arms=12)


def seen_camera(bench: Bench, instrument: Instrument) -> Camera:
    """The camera with the blur by vibration within an exposure, a Gaussian in addition to charge diffusion."""
    camera, (_, within) = instrument.camera, bench.power_px2(instrument)
    return replace(camera, charge_diffusion_px=float(np.hypot(camera.charge_diffusion_px, within**0.5)))


def target_light(bench: Bench, instrument: Instrument, *, by_grid: bool = True) -> TargetLight:
    """The light of a bench; its points are few, but mostly stand at many places in turn (`Tracer`, ``by_grid``)."""
    camera = seen_camera(bench, instrument)
    renderer = StarRenderer(camera, exposure_s=instrument.config.exposure_s, by_grid=by_grid)
    return TargetLight(bench, instrument, renderer, epsf_tracer(camera, by_grid=by_grid))


def frame_light(
    light_e: FloatArray,
    corner_px: NDArray[np.int64],
    place_px: FloatArray,
    psf: Sequence[EffectivePsf],
    bench: Bench,
    instrument: Instrument,
    streams: Streams,
) -> FloatArray:
    """Light of windows (n, h, w) frame by frame (f, n, h, w) where the line of sight is not at rest; else unchanged.
    The rendered light is changed by the change of its PSF under the motion.
    """
    if bench.collimator is None:
        return light_e
    offset = bench.collimator.offsets_px(streams, bench.frames, instrument.config.exposure_s, instrument.pixel_arcsec)
    if offset is None:
        return light_e
    moved = np.empty((len(offset), *light_e.shape))
    for star, (light, corner, place) in enumerate(zip(light_e, corner_px, place_px, strict=True)):
        x, y = (place - corner + np.concatenate([np.zeros((1, 2)), offset])).T
        drawn = draw_epsf(psf[star], x, y, light.shape)
        moved[:, star] = light + (drawn[1:] - drawn[0]) * (light.sum() / drawn[0].sum())
    return np.maximum(moved, 0.0)
