"""Hold-out: every frame by a twin measured without it; cameras without one frame, rendered sets, statistics of both.

Common to all twins: detections and identification of the frames, the order of the camera model, the mask of hot pixels,
and the effect of the method on widths and residuals of bright stars: a rendered set is measured like the real one, and
the difference is subtracted (forward folding, by the other frames). The sky of a frame (its background, the detection
limit by its noise) and its attitude are its own: they are no property of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.attitude.identify_unknown_scale import BlindIdentifier
from calib.calibration.frame_attitudes import camera_residuals
from calib.detector.sky_photon_transfer import BLOCK_PX
from calib.measure.detection.filtered_noise import FilteredNoise
from calib.measure.detection.matched_filter import detection_noise
from calib.measure.sky_surface import sky_surface
from calib.photometry.zero_point import POGSON, scatter_at
from calib.records import SensorImage
from experiments.harness.progress import Progress
from experiments.twin.compare import BRIGHT_MAG, CLIP_PX, FrameStatistics, frame_statistics
from experiments.twin.measure import CameraFit, Centroids, PreparedNight, measure_camera, prepare
from experiments.twin.night import FWHM_PX, detections
from experiments.twin.twin import Assumed, TwinRenderer, build_twin
from optics.arrays import BoolArray, FloatArray
from render.engine.random import Streams

FEWEST = 8
LARGEST_BIAS = 0.2
SURE_SIGMA, SURE_MAG = 8.0, 1.0
"""Stars of this significance, this far above the limit, are detected at any noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoldingBias:
    """Measured minus true values of a rendered set; for every frame by the others."""

    floor_px: float  # Error per axis that it finds where there is none
    motion_px: FloatArray  # (frames,) Motion of single stars per axis: residuals of bright stars beyond those rendered
    width_ln: FloatArray  # (frames,) Logarithm of the widths of bright stars, real over rendered
    light_mag: FloatArray  # (frames,) How much brighter stars are in the filter of the detection, real over rendered

    def off(self, fit: CameraFit, frame: int | None = None) -> CameraFit:
        """Camera without this difference, for one frame or all."""
        shape = fit.psf.value.copy()
        at = slice(None) if frame is None else slice(frame, frame + 1)
        shape[3:5] += self.width_ln[at].mean()  # of the middle component, x and y
        above = fit.photometry.above_mag + float(self.light_mag[at].mean())
        return replace(fit, psf=replace(fit.psf, value=shape), photometry=replace(fit.photometry, above_mag=above))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """Real frames and rendered sets, reduced alike."""

    real: tuple[FrameStatistics, ...]
    sets: tuple[tuple[FrameStatistics, ...], ...]
    images: tuple[SensorImage, ...]  # Of the first rendered set
    airmass: FloatArray  # (frames,)
    bias: FoldingBias


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rendering:
    """What the rendered frames of a night have in common."""

    known: PreparedNight
    assumed: Assumed
    sky_e: tuple[FloatArray, ...]  # (h, w) Light of the sky of each frame without its stars
    limits: tuple[FilteredNoise, ...]  # Detection limit of each frame
    airmass: FloatArray  # (frames,)

    def renderer(self, fit: CameraFit) -> TwinRenderer:
        """The renderer of a camera."""
        return TwinRenderer(build_twin(fit, self.assumed))

    def image(
        self, fit: CameraFit, renderer: TwinRenderer, frame: int, streams: Streams, motion_px: float | None = None
    ) -> SensorImage:
        """One frame; without scatter and motion of single stars where the latter is None."""
        used = list(fit.used)
        scatter = scatter_at(self.airmass[used], fit.photometry.scatter_mag[used], self.airmass[frame])
        image = renderer.frame(
            self.known.stars(frame, fit.camera, fit.attitudes),
            self.sky_e[frame],
            extinction_mag=np.nan_to_num(fit.photometry.extinction_mag),
            scatter_mag=0.0 if motion_px is None else scatter,
            motion_px=motion_px or 0.0,
            streams=streams,
            number=frame,
            noise=self.known.night.frames[frame].image.noise,
        )
        return replace(image, valid=~self.known.hot)


def held_out(
    known: PreparedNight,
    whole: CameraFit,
    *,
    assumed: Assumed,
    realisations: int,
    streams: Streams,
    identifier: BlindIdentifier,
    progress: Progress,
    black_level_dn: float | None = None,
) -> HeldOut:
    """Measure, render and reduce every frame without itself."""
    night, frames = known.night, range(len(known.night))
    scene = Rendering(
        known=known,
        assumed=assumed,
        sky_e=tuple(_sky(known, k) for k in frames),
        limits=tuple(
            detection_noise(frame.image, frame.detected.background, fwhm_px=FWHM_PX) for frame in night.frames
        ),
        airmass=np.array([np.median(known.stars(k, whole.camera, whole.attitudes).airmass) for k in frames]),
    )
    with progress.stage("forward folding"):
        renderer = scene.renderer(whole)
        images = [scene.image(whole, renderer, k, streams.child("fold")) for k in frames]
        bias = _bias(scene, whole, images, black_level_dn)
        # with the right width the light is right in the filter of the detection
        renderer = scene.renderer(bias.off(whole))
        images = [scene.image(whole, renderer, k, streams.child("light")) for k in frames]
        bias = replace(bias, light_mag=_light(scene, whole, images))
    fits: list[CameraFit] = []
    for k in progress.track(frames, "cameras without one frame", total=len(frames)):
        used = [other for other in frames if other != k] or [k]
        fits.append(measure_camera(known, order=whole.order, used=used, black_level_dn=black_level_dn, near=whole))
    renderers = [scene.renderer(bias.off(fit, k)) for k, fit in enumerate(fits)]
    with progress.stage("real and rendered frames", total=len(frames) * (realisations + 1)) as stage:

        def reduced(
            images: Sequence[SensorImage], limits: Sequence[FilteredNoise | None]
        ) -> tuple[FrameStatistics, ...]:
            out = []
            for k, (image, limit) in enumerate(zip(images, limits, strict=True)):
                out.append(frame_statistics(known, k, image, fits[k], identifier, limit))
                stage.advance()
            return tuple(out)

        real = reduced([frame.image for frame in night.frames], [None for _ in frames])
        sets: list[tuple[FrameStatistics, ...]] = []
        first: tuple[SensorImage, ...] = ()
        for number in range(realisations):
            at = streams.child(f"set {number}")
            rendered = tuple(scene.image(fits[k], renderers[k], k, at, float(bias.motion_px[k])) for k in frames)
            sets.append(reduced(rendered, scene.limits))
            first = first or rendered
    return HeldOut(real=real, sets=tuple(sets), images=first, airmass=scene.airmass, bias=bias)


def _sky(known: PreparedNight, frame: int) -> FloatArray:
    """Light of the sky (h, w) [e-] of a frame, its stars left out."""
    blocks, image = known.blocks[frame], known.night.frames[frame].image
    mesh = (-1, blocks.columns)
    sigma = np.sqrt(blocks.variance_dn2 / blocks.count)
    level = sky_surface(blocks.level_dn.reshape(mesh), sigma.reshape(mesh), image.dn.shape, BLOCK_PX)
    return np.maximum(image.noise.to_electrons(level), 0.0)


def _bias(
    scene: Rendering, whole: CameraFit, images: Sequence[SensorImage], black_level_dn: float | None
) -> FoldingBias:
    """Measure a rendered set like the real one."""
    known = scene.known
    frames = tuple(
        replace(frame, image=image, detected=detections(image, noise=limit))
        for frame, image, limit in zip(known.night.frames, images, scene.limits, strict=True)
    )
    again = prepare(replace(known.night, frames=frames), whole.calibration, known.hot, attitudes=whole.attitudes)
    again = replace(again, limit_mag=known.limit_mag, width_px=known.width_px)
    made = measure_camera(again, order=whole.order, used=whole.used, black_level_dn=black_level_dn, near=whole)
    squares, widths = (
        np.array([[measure(fit, known.limit_mag, k) for k in range(len(frames))] for fit in (whole, made)])
        for measure in (_bright_square, _bright_width)
    )
    return FoldingBias(
        floor_px=made.floor_px,
        motion_px=np.sqrt(np.maximum(squares[0] - squares[1], 0.0)),
        width_ln=np.clip(np.nan_to_num(np.log(widths[0] / widths[1])), -LARGEST_BIAS, LARGEST_BIAS),
        light_mag=np.zeros(len(frames)),
    )


def _light(scene: Rendering, whole: CameraFit, images: Sequence[SensorImage]) -> FloatArray:
    """Median ratio [mag] of the significance of stars, real over rendered, in all frames but one (frames,): the height
    in the filter by which stars are found must be right."""
    known, ratios = scene.known, []
    for k, image in enumerate(images):
        stars = known.stars(k, whole.camera, whole.attitudes)
        both = known.night.frames[k].detected, detections(image, noise=scene.limits[k])
        real, twin = (detected.pairs(stars)[0] for detected in both)
        good = (stars.magnitude < known.limit_mag - SURE_MAG) & (np.minimum(real, twin) > SURE_SIGMA)
        ratios.append(POGSON * np.log(real[good] / twin[good]))
    out = np.zeros(len(ratios))
    for k in range(len(ratios)):
        others = np.concatenate([ratio for j, ratio in enumerate(ratios) if j != k or len(ratios) == 1])
        if len(others) >= FEWEST:
            out[k] = np.clip(np.median(others), -LARGEST_BIAS, LARGEST_BIAS)
    return out


def _others(stars: Centroids, good: BoolArray, without: int) -> BoolArray:
    """Rows of all frames but one; a single frame has no others."""
    others = good & (stars.observations.frame != without)
    return others if others.sum() >= FEWEST else good


def _bright_width(fit: CameraFit, limit_mag: float, without: int) -> float:
    """Median width [px] of the Gaussian fits of bright stars in all frames but one."""
    stars = fit.gaussian
    good = _others(stars, (stars.magnitude < limit_mag - BRIGHT_MAG) & np.isfinite(stars.width_px), without)
    return float(np.median(stars.width_px[good])) if good.sum() >= FEWEST else 1.0


def _bright_square(fit: CameraFit, limit_mag: float, without: int) -> float:
    """Mean squared residual per axis [px^2] of Gaussian fits of bright stars in all frames but one."""
    stars = fit.gaussian
    residual = camera_residuals(stars.observations, fit.camera, fit.attitudes)
    near = (stars.magnitude < limit_mag - BRIGHT_MAG) & (np.hypot(*residual.T) < CLIP_PX)
    good = _others(stars, near, without)
    return float((residual[good] ** 2).mean()) if good.sum() >= FEWEST else 0.0
