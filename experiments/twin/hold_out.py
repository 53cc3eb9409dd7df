"""Leave-one-out comparison: each frame rendered by a twin that was measured from the other frames.

All twins share the detections and identifications, the order of the camera model, the hot-pixel mask and the bias of
the method on widths, residuals and fluxes of bright stars. That bias is measured on a rendered set, reduced like the
real one, and subtracted (forward folding); for each frame it comes from the other frames. Background, detection limit
and attitude belong to the frame, not to the camera: they are the frame's.
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
from experiments.twin.twin import AssumedCamera, TwinRenderer, build_twin
from optics.arrays import BoolArray, FloatArray
from render.engine.random import Streams

MIN_STARS = 8
"""Bright stars for an estimate of the bias, at least."""
FOLDING_LIMIT = 0.2
"""Largest correction of the width (ln) and of the flux (mag)."""
BRIGHT_SIGMA, BELOW_LIMIT_MAG = 8.0, 1.0
"""Stars of this significance and brighter than the limiting magnitude by this are detected in every realisation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoldingBias:
    """Bias of the method, from a rendered set; for each frame from the other frames."""

    floor_px: float  # Error floor per axis that is measured on frames rendered without one
    motion_px: FloatArray  # (frames,) Motion of single stars per axis: residual of bright stars, real minus rendered
    width_ln: FloatArray  # (frames,) Logarithm of the widths of bright stars, real over rendered
    flux_mag: FloatArray  # (frames,) Flux in the detection filter, real over rendered

    def corrected(self, fit: CameraFit, frame: int | None = None) -> CameraFit:
        """Camera without the bias of a frame, or of all frames on average."""
        shape = fit.psf.value.copy()
        frames = slice(None) if frame is None else slice(frame, frame + 1)
        shape[3:5] += self.width_ln[frames].mean()  # logarithmic widths of the middle Gaussian, x and y
        above = fit.photometry.above_mag + float(self.flux_mag[frames].mean())
        return replace(fit, psf=replace(fit.psf, value=shape), photometry=replace(fit.photometry, above_mag=above))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """Statistics of the real frames and of the rendered sets."""

    real: tuple[FrameStatistics, ...]
    sets: tuple[tuple[FrameStatistics, ...], ...]
    images: tuple[SensorImage, ...]  # First rendered set
    airmass: FloatArray  # (frames,)
    bias: FoldingBias


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rendering:
    """Inputs of all rendered frames of a night."""

    prepared: PreparedNight
    assumed: AssumedCamera
    sky_e: tuple[FloatArray, ...]  # (h, w) Light of the sky of each frame without its stars
    limits: tuple[FilteredNoise, ...]  # Detection limit of each frame
    airmass: FloatArray  # (frames,)

    def renderer(self, fit: CameraFit) -> TwinRenderer:
        """Renderer of a measured camera."""
        return TwinRenderer(build_twin(fit, self.assumed))

    def image(
        self, fit: CameraFit, renderer: TwinRenderer, frame: int, streams: Streams, motion_px: float | None = None
    ) -> SensorImage:
        """A rendered frame; ``motion_px`` None: no scintillation and no motion of single stars."""
        used = list(fit.used)
        scatter = scatter_at(self.airmass[used], fit.photometry.scatter_mag[used], self.airmass[frame])
        image = renderer.frame(
            self.prepared.stars(frame, fit.camera, fit.attitudes),
            self.sky_e[frame],
            extinction_mag=np.nan_to_num(fit.photometry.extinction_mag),
            scatter_mag=0.0 if motion_px is None else scatter,
            motion_px=motion_px or 0.0,
            streams=streams,
            number=frame,
            noise=self.prepared.night.frames[frame].image.noise,
        )
        return replace(image, valid=~self.prepared.hot)


def held_out(
    prepared: PreparedNight,
    full_fit: CameraFit,
    *,
    assumed: AssumedCamera,
    realisations: int,
    streams: Streams,
    identifier: BlindIdentifier,
    progress: Progress,
    black_level_dn: float | None = None,
) -> HeldOut:
    """Measure the camera without each frame in turn, render the frame by it, and reduce real and rendered frames."""
    night, frames = prepared.night, range(len(prepared.night))
    rendering = Rendering(
        prepared=prepared,
        assumed=assumed,
        sky_e=tuple(_sky(prepared, k) for k in frames),
        limits=tuple(
            detection_noise(frame.image, frame.detected.background, fwhm_px=FWHM_PX) for frame in night.frames
        ),
        airmass=np.array([np.median(prepared.stars(k, full_fit.camera, full_fit.attitudes).airmass) for k in frames]),
    )
    with progress.stage("forward folding"):
        renderer = rendering.renderer(full_fit)
        images = [rendering.image(full_fit, renderer, k, streams.child("fold")) for k in frames]
        bias = _folding_bias(rendering, full_fit, images, black_level_dn)
        # flux in the detection filter depends on the width: measured after the widths are corrected
        renderer = rendering.renderer(bias.corrected(full_fit))
        images = [rendering.image(full_fit, renderer, k, streams.child("light")) for k in frames]
        bias = replace(bias, flux_mag=_flux_bias(rendering, full_fit, images))
    fits: list[CameraFit] = []
    for k in progress.track(frames, "cameras without one frame", total=len(frames)):
        used = [other for other in frames if other != k] or [k]
        fits.append(
            measure_camera(prepared, order=full_fit.order, used=used, black_level_dn=black_level_dn, start=full_fit)
        )
    renderers = [rendering.renderer(bias.corrected(fit, k)) for k, fit in enumerate(fits)]
    with progress.stage("real and rendered frames", total=len(frames) * (realisations + 1)) as stage:

        def reduced(
            images: Sequence[SensorImage], limits: Sequence[FilteredNoise | None]
        ) -> tuple[FrameStatistics, ...]:
            out = []
            for k, (image, limit) in enumerate(zip(images, limits, strict=True)):
                out.append(frame_statistics(prepared, k, image, fits[k], identifier, limit))
                stage.advance()
            return tuple(out)

        real = reduced([frame.image for frame in night.frames], [None for _ in frames])
        sets: list[tuple[FrameStatistics, ...]] = []
        first_set: tuple[SensorImage, ...] = ()
        for number in range(realisations):
            set_streams = streams.child(f"set {number}")
            rendered = tuple(
                rendering.image(fits[k], renderers[k], k, set_streams, float(bias.motion_px[k])) for k in frames
            )
            sets.append(reduced(rendered, rendering.limits))
            first_set = first_set or rendered
    return HeldOut(real=real, sets=tuple(sets), images=first_set, airmass=rendering.airmass, bias=bias)


def _sky(prepared: PreparedNight, frame: int) -> FloatArray:
    """Background (h, w) [e-] of a frame without its stars."""
    blocks, image = prepared.blocks[frame], prepared.night.frames[frame].image
    mesh = (-1, blocks.columns)
    sigma = np.sqrt(blocks.variance_dn2 / blocks.count)
    level = sky_surface(blocks.level_dn.reshape(mesh), sigma.reshape(mesh), image.dn.shape, BLOCK_PX)
    return np.maximum(image.noise.to_electrons(level), 0.0)


def _folding_bias(
    rendering: Rendering, full_fit: CameraFit, images: Sequence[SensorImage], black_level_dn: float | None
) -> FoldingBias:
    """Bias of widths and residuals: a rendered set measured like the real one."""
    prepared = rendering.prepared
    frames = tuple(
        replace(frame, image=image, detected=detections(image, noise=limit))
        for frame, image, limit in zip(prepared.night.frames, images, rendering.limits, strict=True)
    )
    folded = prepare(
        replace(prepared.night, frames=frames), full_fit.calibration, prepared.hot, attitudes=full_fit.attitudes
    )
    folded = replace(folded, limit_mag=prepared.limit_mag, width_px=prepared.width_px)
    refit = measure_camera(
        folded, order=full_fit.order, used=full_fit.used, black_level_dn=black_level_dn, start=full_fit
    )
    squares, widths = (
        np.array([[measure(fit, prepared.limit_mag, k) for k in range(len(frames))] for fit in (full_fit, refit)])
        for measure in (_bright_square, _bright_width)
    )
    return FoldingBias(
        floor_px=refit.floor_px,
        motion_px=np.sqrt(np.maximum(squares[0] - squares[1], 0.0)),
        width_ln=np.clip(np.nan_to_num(np.log(widths[0] / widths[1])), -FOLDING_LIMIT, FOLDING_LIMIT),
        flux_mag=np.zeros(len(frames)),
    )


def _flux_bias(rendering: Rendering, full_fit: CameraFit, images: Sequence[SensorImage]) -> FloatArray:
    """Median ratio [mag] of the significances of bright stars, real over rendered, of the other frames (frames,)."""
    prepared, ratios_mag = rendering.prepared, []
    for k, image in enumerate(images):
        stars = prepared.stars(k, full_fit.camera, full_fit.attitudes)
        pair = prepared.night.frames[k].detected, detections(image, noise=rendering.limits[k])
        real, twin = (detected.match(stars)[0] for detected in pair)
        good = (stars.magnitude < prepared.limit_mag - BELOW_LIMIT_MAG) & (np.minimum(real, twin) > BRIGHT_SIGMA)
        ratios_mag.append(POGSON * np.log(real[good] / twin[good]))
    bias_mag = np.zeros(len(ratios_mag))
    for k in range(len(ratios_mag)):
        others = np.concatenate([ratio for j, ratio in enumerate(ratios_mag) if j != k or len(ratios_mag) == 1])
        if len(others) >= MIN_STARS:
            bias_mag[k] = np.clip(np.median(others), -FOLDING_LIMIT, FOLDING_LIMIT)
    return bias_mag


def _other_frames(stars: Centroids, good: BoolArray, without: int) -> BoolArray:
    """Rows of the other frames; all rows where these are fewer than `MIN_STARS`."""
    other_frames = good & (stars.observations.frame != without)
    return other_frames if other_frames.sum() >= MIN_STARS else good


def _bright_width(fit: CameraFit, limit_mag: float, without: int) -> float:
    """Median width [px] of the Gaussian fits of bright stars, of the other frames."""
    stars = fit.gaussian
    good = _other_frames(stars, (stars.magnitude < limit_mag - BRIGHT_MAG) & np.isfinite(stars.width_px), without)
    return float(np.median(stars.width_px[good])) if good.sum() >= MIN_STARS else 1.0


def _bright_square(fit: CameraFit, limit_mag: float, without: int) -> float:
    """Mean squared residual per axis [px^2] of Gaussian fits of bright stars, of the other frames."""
    stars = fit.gaussian
    residual = camera_residuals(stars.observations, fit.camera, fit.attitudes)
    bright = (stars.magnitude < limit_mag - BRIGHT_MAG) & (np.hypot(*residual.T) < CLIP_PX)
    good = _other_frames(stars, bright, without)
    return float((residual[good] ** 2).mean()) if good.sum() >= MIN_STARS else 0.0
