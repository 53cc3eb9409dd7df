"""Hold-out: every frame by a twin measured without it; cameras without one frame, rendered sets, statistics of both.

Common to all twins: detections and identification of the frames, the order of the camera model, the mask of hot pixels,
and the effect of the method on widths and residuals of bright stars: a rendered set is measured like the real one, and
the difference is subtracted (forward folding, by the other frames). The sky of a frame (its background, the detection
limit by its noise) and its attitude are its own: they are no property of the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander

from calib.detector.sky_transfer import BLOCK_PX
from calib.measure.detection import detection_noise
from calib.measure.filtered_noise import FilteredNoise
from calib.records import SensorImage
from experiments.harness.progress import Progress
from experiments.twin.compare import CLIP_PX, FrameStats, frame_stats, star_heights
from experiments.twin.measure import CameraFit, Prepared, field_airmass, measure_camera, prepare, residuals
from experiments.twin.night import field_stars
from experiments.twin.photometry import POGSON
from experiments.twin.solve import FWHM_PX, Detections, detections
from experiments.twin.twin import Assumed, Twin, TwinRenderer, as_image, build_twin
from optics.arrays import FloatArray
from render.engine.random import Streams

BRIGHTER_MAG = 1.5
"""Magnitudes above the limit of the stars used for the motion of single stars."""
FEWEST = 8
SKY_DEGREE, BLOCKS_PER_TERM = 10, 6
"""Polynomial of the sky of a rendered frame: finer structure would carry the real frame's noise."""
SURE_SIGMA = 8.0
"""Stars of this significance are detected at any noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bias:
    """Measured minus true values of a rendered set; for every frame by the others."""

    floor_px: float  # Error per axis that it finds where there is none
    motion_px: (
        FloatArray  # (frames,) Motion of single stars per axis: residuals of bright stars beyond the rendered set
    )
    width_ln: FloatArray  # (frames,) Logarithm of the widths of bright stars, real over rendered
    light_mag: FloatArray  # (frames,) How much brighter stars are in the filter of the detection, real over rendered

    def off(self, fit: CameraFit, frame: int | None = None) -> CameraFit:
        """Camera without this difference, for one frame or all."""
        shape = fit.psf.value.copy()
        at = slice(None) if frame is None else slice(frame, frame + 1)
        shape[3:5] += self.width_ln[at].mean()  # of the middle part, x and y
        above = fit.photometry.zero_point_above_mag
        assert above is not None
        light = replace(above, value=above.value + float(self.light_mag[at].mean()))
        return replace(
            fit,
            psf=replace(fit.psf, value=shape),
            photometry=replace(fit.photometry, zero_point_above_mag=light),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """Real frames and rendered sets, reduced alike."""

    fits: tuple[CameraFit, ...]  # Of each frame, without it (with it, where it is the only one)
    twins: tuple[Twin, ...]
    real: tuple[FrameStats, ...]
    sets: tuple[tuple[FrameStats, ...], ...]
    images: tuple[SensorImage, ...]  # Of the first rendered set
    airmass: FloatArray  # (frames,)
    bias: Bias


def held_out(
    known: Prepared,
    whole: CameraFit,
    *,
    assumed: Assumed,
    saturation_dn: float,
    realisations: int,
    streams: Streams,
    solve: Callable[[Detections], bool],
    progress: Progress,
    black_level_dn: float | None = None,
) -> HeldOut:
    """Fit without each frame, render, reduce."""
    frames = len(known.night)
    mass = np.array([field_airmass(known, k, whole.camera, whole.attitudes) for k in range(frames)])
    sky = [_sky(known, k) for k in range(frames)]
    limits = [detection_noise(one.image, one.seen.background, fwhm_px=FWHM_PX) for one in known.night.frames]

    def twin_of(fit: CameraFit) -> Twin:
        return build_twin(
            fit, assumed, name="twin", source="night frames", taken=None, saturation_dn=saturation_dn, hot=0
        )

    def rendered(
        fit: CameraFit, twin: Twin, renderer: TwinRenderer, frame: int, motion_px: float | None, at: Streams
    ) -> SensorImage:
        """One frame; without scatter and motion of single stars where the latter is None."""
        loss = fit.photometry.extinction_mag
        electrons = renderer.electrons(
            field_stars(known.night, frame, fit.camera, fit.attitudes[frame]),
            sky[frame],
            extinction_mag=0.0 if loss is None else loss.value,
            scatter_mag=0.0 if motion_px is None else _scatter_of(fit, frame, mass),
            motion_px=motion_px or 0.0,
            rng=at.generator("stars", frame),
        )
        image = as_image(twin, electrons, at, frame, known.night.frames[frame].image.noise)
        return replace(image, valid=~known.hot)

    with progress.stage("forward folding"):
        twin = twin_of(whole)
        renderer = TwinRenderer(twin)
        first = [rendered(whole, twin, renderer, k, None, streams.child("fold")) for k in range(frames)]
        bias = _bias(known, whole, first, black_level_dn, limits)
        # with the right width the light is right in the filter of the detection
        twin = twin_of(bias.off(whole))
        renderer = TwinRenderer(twin)
        second = [rendered(whole, twin, renderer, k, None, streams.child("light")) for k in range(frames)]
        bias = replace(bias, light_mag=_light(known, whole, second, limits))
    fits: list[CameraFit] = []
    for k in progress.track(range(frames), "cameras without one frame", total=frames):
        used = [other for other in range(frames) if other != k] or [k]
        one = measure_camera(known, order=whole.order, used=used, black_level_dn=black_level_dn, near=whole)
        fits.append(one)
    twins = [twin_of(bias.off(one, k)) for k, one in enumerate(fits)]
    renderers = [TwinRenderer(one) for one in twins]
    with progress.stage("real and rendered frames", total=frames * (realisations + 1)) as stage:
        real = []
        for k in range(frames):
            real.append(frame_stats(known, k, known.night.frames[k].image, fits[k], solve))
            stage.advance()
        sets, images = [], []
        for number in range(realisations):
            at, out = streams.child(f"set {number}"), []
            for k in range(frames):
                image = rendered(fits[k], twins[k], renderers[k], k, float(bias.motion_px[k]), at)
                if not number:
                    images.append(image)
                out.append(frame_stats(known, k, image, fits[k], solve, limits[k]))
                stage.advance()
            sets.append(tuple(out))
    return HeldOut(
        fits=tuple(fits),
        twins=tuple(twins),
        real=tuple(real),
        sets=tuple(sets),
        images=tuple(images),
        airmass=mass,
        bias=bias,
    )


def _sky(known: Prepared, frame: int) -> FloatArray:
    """Light of the sky (h, w) [e-] of a frame, its stars left out: a polynomial through the levels of its blocks."""
    blocks, image = known.blocks[frame], known.night.frames[frame].image
    columns, count = blocks.columns, len(blocks.level_dn)
    rows = count // columns
    degree = next(d for d in range(SKY_DEGREE, -1, -1) if (d + 1) * (d + 2) * BLOCKS_PER_TERM <= 2 * count or not d)
    terms = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]
    x, y = ((2.0 * np.arange(n) + 1.0) / n - 1.0 for n in (columns, rows))
    design = np.einsum("yb,xa->yxba", legvander(y, degree), legvander(x, degree)).reshape(count, degree + 1, -1)
    design = np.stack([design[:, b, a] for a, b in terms], axis=1)
    weight = np.nan_to_num(np.sqrt(blocks.count / blocks.variance_dn2))
    found = np.zeros(len(terms))
    for _ in range(3):
        found = np.linalg.lstsq(design * weight[:, None], blocks.level_dn * weight, rcond=None)[0]
        left = (blocks.level_dn - design @ found) * weight
        weight = np.where(np.abs(left) < 4.0 * 1.4826 * np.median(np.abs(left[weight > 0])), weight, 0.0)
    table = np.zeros((degree + 1, degree + 1))
    for (a, b), value in zip(terms, found, strict=True):
        table[b, a] = value
    height, width = image.dn.shape
    at = [
        np.clip((2.0 * np.arange(n) + 1.0) / (BLOCK_PX * m) - 1.0, -1, 1) for n, m in ((width, columns), (height, rows))
    ]
    level = legvander(at[1], degree) @ table @ legvander(at[0], degree).T
    return np.maximum(image.noise.to_electrons(level), 0.0)


def _scatter_of(fit: CameraFit, frame: int, airmass: FloatArray) -> float:
    """Scatter of a frame's stars [mag], by the other frames: linear in airmass if that is known."""
    used = np.array(fit.used)
    scatter, mass = fit.photometry.scatter_mag[used], airmass[used]
    if np.isfinite(airmass).all() and len(used) >= 4 and np.ptp(mass) > 0.1:
        return float(np.clip(np.polyval(np.polyfit(mass, scatter, 1), airmass[frame]), 0.0, 1.0))
    return float(np.mean(scatter))


def _bias(
    known: Prepared,
    whole: CameraFit,
    images: Sequence[SensorImage],
    black_level_dn: float | None,
    limits: Sequence[FilteredNoise],
) -> Bias:
    """Measure a rendered set like the real one."""
    frames = tuple(
        replace(one, image=image, seen=detections(image, noise=limit))
        for one, image, limit in zip(known.night.frames, images, limits, strict=True)
    )
    night = replace(known.night, frames=frames)
    again = prepare(night, whole.calibration, known.hot, attitudes=whole.attitudes)
    again = replace(again, limit_mag=known.limit_mag, width_px=known.width_px)
    made = measure_camera(again, order=whole.order, used=whole.used, black_level_dn=black_level_dn, near=whole)
    numbers = range(len(frames))
    squares = np.array([[_bright_square(one, known.limit_mag, k) for k in numbers] for one in (whole, made)])
    widths = np.array([[_bright_width(one, known.limit_mag, k) for k in numbers] for one in (whole, made)])
    return Bias(
        floor_px=made.floor_px,
        motion_px=np.sqrt(np.maximum(squares[0] - squares[1], 0.0)),
        width_ln=np.clip(np.nan_to_num(np.log(widths[0] / widths[1])), -0.2, 0.2),
        light_mag=np.zeros(len(frames)),
    )


def _light(
    known: Prepared, whole: CameraFit, images: Sequence[SensorImage], limits: Sequence[FilteredNoise]
) -> FloatArray:
    """Median ratio [mag] of the significance of stars, real over rendered, in all frames but one (frames,): the height
    in the filter by which stars are found must be right."""
    ratios = []
    for k, (frame, image) in enumerate(zip(known.night.frames, images, strict=True)):
        stars = field_stars(known.night, k, whole.camera, whole.attitudes[k])
        real, twin = (star_heights(seen, stars) for seen in (frame.seen, detections(image, noise=limits[k])))
        good = (stars.magnitude < known.limit_mag - 1.0) & (np.minimum(real, twin) > SURE_SIGMA)
        ratios.append(POGSON * np.log(real[good] / twin[good]))
    out = np.zeros(len(ratios))
    for k in range(len(ratios)):
        others = np.concatenate([one for j, one in enumerate(ratios) if j != k or len(ratios) == 1])
        out[k] = np.clip(np.median(others), -0.2, 0.2) if len(others) >= FEWEST else 0.0
    return out


def _bright_width(fit: CameraFit, limit_mag: float, without: int) -> float:
    """Median width [px] of the Gaussian fits of bright stars in all frames but one."""
    stars = fit.gaussian
    good = (stars.magnitude < limit_mag - BRIGHTER_MAG) & np.isfinite(stars.width_px)
    others = good & (stars.observations.frame != without)
    good = others if others.sum() >= FEWEST else good
    return float(np.median(stars.width_px[good])) if good.sum() >= FEWEST else 1.0


def _bright_square(fit: CameraFit, limit_mag: float, without: int) -> float:
    """Mean squared residual per axis [px^2] of Gaussian fits of bright stars in all frames but one."""
    stars = fit.gaussian.observations
    left = residuals(stars, fit.camera, fit.attitudes)
    good = (fit.gaussian.magnitude < limit_mag - BRIGHTER_MAG) & (np.linalg.norm(left, axis=1) < CLIP_PX)
    others = good & (stars.frame != without)
    good = others if others.sum() >= FEWEST else good  # a single frame has no others
    return float((left[good] ** 2).mean()) if good.sum() >= FEWEST else 0.0
