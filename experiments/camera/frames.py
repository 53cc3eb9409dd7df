"""Rendered frames against the prediction: a grid of artificial stars read out many times, and frames of the real sky.

Half of the artificial stars are bright and of equal magnitude: their scatter over the readouts is the NEA. The other
half lie about the limiting magnitude: the detected fraction is the completeness. The sky is rendered in the first
predicted attitudes; the camera model is fitted to the traced map of the lens (a calibration without error), and the
attitude is known a priori to `PRIOR_SIGMA_PX`, as in tracking mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.attitude_solution import solve_wahba
from calib.attitude.star_attitude import identify_stars, solve_attitude
from calib.cameras.base import CameraModel
from calib.cameras.fit import fit_camera
from calib.measure.reduced_frame import FrameReduction, MeasuredFrame, measure_frame
from experiments.camera.comparison import Rendered, SkyFrames, StarGridFrames, compare_noise
from experiments.camera.manufacture import RANKS, Manufactured, RenderedLens
from experiments.camera.operation import slewing_config
from experiments.camera.settings import CameraReportConfig
from experiments.harness.summary import Measured
from experiments.harness.system import processors, shared
from experiments.laboratory.bench.centroid_methods import needs_epsf
from experiments.laboratory.bench.readout.frames import mean_dark_frame
from experiments.laboratory.sensor_prediction import CameraPrediction, overridden_detector, predict_camera
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.errors import StarbenchError
from optics.lens.system import LensSystem
from render.engine.random import Streams
from render.motion.trajectory import ConstantRate, rate_of_trail
from render.observation import SkyLight
from render.psf_lattice import inset_axes, render_psf_grid
from render.records import Frame, StarField
from render.sensor_file.instrument import build_instrument
from render.simulator import SkySimulator

MATCH_PX = 2.0
"""Least match radius of detections and stars."""
MATCH_WIDTHS = 0.6
"""Match radius of detections and stars in FWHM of the detection filter, if larger than `MATCH_PX`."""
STAR_AREA_WIDTHS = 4.0
"""Side, in FWHM, of the square that a star covers in `CROWDED_FRACTION`."""
CROWDED_FRACTION = 0.02
"""Area fraction of artificial stars above which bright and faint stars are read out in separate frames."""
SATURATION_MARGIN_MAG = 0.3
"""Bright artificial stars are fainter than the saturation limit by at least this."""
COMPLETENESS_MARGIN_MAG = 0.5
"""Bright artificial stars are brighter than the 90 % completeness limit by at least this: linear response of fits."""
BRIGHT_STAR_MARGIN_MAG = 2.5
"""Bright artificial stars, if the quoted star is too faint: brighter than the completeness limit by this."""
FAINT_RANGE_MAG = (-1.2, 0.8)
"""Range of the faint artificial stars about the limiting magnitude."""
PRIOR_SIGMA_PX = 5.0
"""Standard deviation per axis of the a-priori attitude."""
PSF_GRID = 17
"""PSFs along the longer side of the detector, for attitudes."""
COARSE_PSF_GRID = 9
"""PSFs along the longer side of the detector; suffices for noise."""
SLEW_FRACTION = 0.5
"""Slew rate of the star grid in motion, as a fraction of the rate at which trails fill the window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _CatalogueStars:
    """Catalogue for `identify_stars`."""

    id: NDArray[np.int64]
    direction: FloatArray


class _FrameChain:
    """Simulator and reduction of all frames of a camera."""

    def __init__(
        self,
        prediction: CameraPrediction,
        lens: LensSystem | None = None,
        *,
        long_side: int = PSF_GRID,
        dark_dn: NDArray[np.float32] | None = None,
    ) -> None:
        """``lens``: in place of the configured one, its image plane on the detector; ``dark_dn``: mean dark frame."""
        self.prediction, config = prediction, prediction.config
        sensor = build_instrument(config.instrument, detector=overridden_detector(config))
        if lens is not None:
            sensor = replace(sensor, camera=replace(sensor.camera, lens=lens, defocus_mm=0.0))
        self.streams = Streams(config.seed).child("camera")
        self.simulator = SkySimulator(
            sensor,
            passband=prediction.state.band,
            throughput_fraction=config.throughput_fraction,
            background_e_per_s=config.background_e_per_s,
            seed=self.streams,
            tolerance=1e-4,
        )
        self.camera_attitude = _camera_attitude(config)
        temperature_k = config.star.temperature_k
        processing = prediction.processing
        psfs = None
        if needs_epsf(config.centroid):
            psfs = render_psf_grid(
                sensor,
                prediction.state.light,
                temperature_k=temperature_k,
                window_px=config.window_px,
                trail_px=prediction.state.trail_px,
                axes=inset_axes(sensor.camera, long_side),
            )
        self.match_px = max(MATCH_PX, MATCH_WIDTHS * processing.fwhm_px)
        if dark_dn is None:
            dark_dn = mean_dark_frame(sensor, config.dark_frames, streams=self.streams, label="dark")
        self.reduction = FrameReduction(
            dark_dn=dark_dn,
            noise=processing.noise,
            centroid=config.centroid,
            window_px=config.window_px,
            threshold_sigma=processing.threshold_sigma,
            fwhm_px=processing.fwhm_px,
            psfs=psfs,
            background_step_px=1,
        )
        self.model: CameraModel = fit_camera(
            sensor.pixel_map(prediction.state.band, temperature_k=temperature_k)
        ).camera

    def expected(self, stars: StarField) -> tuple[SkyLight, FloatArray, FloatArray]:
        """Expected image of stars in the camera frame; photocentres (n, 2), electrons (n,), also outside it."""
        light = self.simulator.expected(self.camera_attitude, stars=stars)
        truth = light.truth
        position_px = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
        assert truth.electrons_beyond is not None
        return light, position_px, (truth.electrons_image + truth.electrons_beyond)[:, 0]

    def measure(self, frames: Sequence[Frame]) -> list[MeasuredFrame]:
        return shared(partial(measure_frame, reduction=self.reduction), frames)


def _batches(count: int) -> Iterator[range]:
    """Frame numbers in batches, one frame per processor."""
    return (range(first, min(first + processors(), count)) for first in range(0, count, processors()))


def _camera_attitude(config: CameraReportConfig) -> Rotation | ConstantRate:
    """Attitude during the exposure, relative to the camera frame at mid-exposure."""
    if not config.slew.rate_deg_per_s:
        return Rotation.identity()
    exposure_s = config.instrument.exposure_s
    rate_rad_per_s = rate_of_trail(config.slew.rate_deg_per_s, config.slew.direction_deg)
    initial = Rotation.from_rotvec(0.5 * exposure_s * rate_rad_per_s)
    return ConstantRate(initial=initial, rate_rad_per_s=rate_rad_per_s, end_s=exposure_s)


def render_frames(prediction: CameraPrediction, *, advance: Callable[[], None] = lambda: None) -> Rendered:
    """Render, read out and measure the star grid and the sky."""
    chain = _FrameChain(prediction)
    star_grid = _render_star_grid(chain, advance)
    slewing = _render_slewing_grid(prediction, chain.reduction.dark_dn, advance)
    sky, example_e, example_px = _render_sky(chain, advance)
    return Rendered(star_grid=star_grid, slewing=slewing, sky=sky, example_e=example_e, example_px=example_px)


def _render_sky(chain: _FrameChain, advance: Callable[[], None]) -> tuple[SkyFrames, NDArray[np.float32], FloatArray]:
    """Frames of the sky; electrons (h, w) above the dark and centroids (n, 2) of the first."""
    config = chain.prediction.config
    detected: list[int] = []
    usable: list[int] = []
    false_alarms: list[int] = []
    errors: list[FloatArray] = []
    for frames in _batches(config.frames.sky):
        rendered = [_sky_frame(chain, number) for number in frames]
        measurements = chain.measure([frame for _, frame, _ in rendered])
        for number, (visible, frame, position_px), measured in zip(frames, rendered, measurements, strict=True):
            detection, false = measured.matched(position_px, config.window_px, chain.match_px)
            detection = detection[detection >= 0]
            detected.append(len(detection))
            usable.append(int(np.count_nonzero(measured.fit[detection])))
            false_alarms.append(false)
            errors.append(_attitude_error(chain, measured, number, visible))
            if number == 0:
                example_e = (frame.dn - chain.reduction.dark_dn) / np.float32(frame.gain_dn_per_e)
                example_px = measured.stars.pixel_px
            advance()
    sky = SkyFrames(
        detected=np.array(detected, np.int64),
        usable=np.array(usable, np.int64),
        false_alarms=np.array(false_alarms, np.int64),
        error_arcsec=np.array(errors),
    )
    return sky, example_e, example_px


def _render_slewing_grid(
    prediction: CameraPrediction, dark_dn: NDArray[np.float32], advance: Callable[[], None]
) -> tuple[CameraPrediction, StarGridFrames] | None:
    """Star grid at `SLEW_FRACTION` of the slew rate at which trails fill the window; None without motion."""
    config = prediction.config
    if not config.motion.points or config.slew.rate_deg_per_s or config.instrument.line_time_us:
        return None
    try:
        slewing = predict_camera(slewing_config(config, SLEW_FRACTION))
    except StarbenchError:
        return None
    return slewing, _render_star_grid(_FrameChain(slewing, long_side=COARSE_PSF_GRID, dark_dn=dark_dn), advance)


def rendered_lenses(
    prediction: CameraPrediction, lenses: Manufactured, *, advance: Callable[[], None] = lambda: None
) -> list[RenderedLens]:
    """Star grid through three sampled lenses; the centroider has the PSFs of the sampled lens."""
    rendered: list[RenderedLens] = []
    dark_dn = None
    for rank, (lens, ratio) in zip(RANKS, lenses.ranked, strict=True):
        chain = _FrameChain(prediction, lens, long_side=COARSE_PSF_GRID, dark_dn=dark_dn)
        dark_dn = chain.reduction.dark_dn
        nea = compare_noise(prediction, _render_star_grid(chain, advance))
        measured = Measured(value=nea.measured, unit=nea.unit, uncertainty=ratio * nea.error, n=nea.n)
        rendered.append(
            RenderedLens(rank_percent=100.0 * rank, measured_arcsec=measured, predicted_arcsec=ratio * nea.predicted)
        )
    return rendered


@dataclass(frozen=True, slots=True, kw_only=True)
class _GridStars:
    """n artificial stars."""

    bright_mag: float
    faint: NDArray[np.bool_]  # (n,)
    position_px: FloatArray  # (n, 2) Chief rays
    magnitude: FloatArray  # (n,)


def _choose_grid_stars(chain: _FrameChain) -> _GridStars:
    """Half bright stars of equal magnitude for the NEA, half about the limiting magnitude for the completeness."""
    prediction = chain.prediction
    config = prediction.config
    camera = chain.simulator.sensor.camera
    rng = chain.streams.generator("chart")
    brightest = prediction.value("saturation_mag") + SATURATION_MARGIN_MAG
    complete = prediction.value("complete_magnitude_mag")
    bright = max(config.star.magnitude_mag, brightest)
    if bright > complete - COMPLETENESS_MARGIN_MAG:
        bright = min(max(complete - BRIGHT_STAR_MARGIN_MAG, brightest), complete - COMPLETENESS_MARGIN_MAG)
    position_px = _jittered_grid(camera.width_px, camera.height_px, config.frames.chart_stars, config.window_px, rng)
    faint = np.arange(len(position_px)) % 2 == 1
    magnitude = np.full(len(position_px), bright)
    limit = prediction.value("limiting_magnitude_mag")
    magnitude[faint] = limit + rng.uniform(*FAINT_RANGE_MAG, np.count_nonzero(faint))
    return _GridStars(bright_mag=bright, faint=faint, position_px=position_px, magnitude=magnitude)


def _render_star_grid(chain: _FrameChain, advance: Callable[[], None]) -> StarGridFrames:
    """Render the artificial stars once, read them out repeatedly, and match the detections."""
    prediction, config = chain.prediction, chain.prediction.config
    camera = chain.simulator.sensor.camera
    stars = _choose_grid_stars(chain)
    count = len(stars.magnitude)
    direction = chain.simulator.sensor.direction_at(*stars.position_px.T)
    # wings of bright stars raise the noise estimate of the background about faint ones: separate frames
    star_area_px2 = (STAR_AREA_WIDTHS * prediction.processing.fwhm_px) ** 2
    crowded = count * star_area_px2 / (camera.width_px * camera.height_px) > CROWDED_FRACTION
    groups = [np.flatnonzero(~stars.faint), np.flatnonzero(stars.faint)] if crowded else [np.arange(count)]
    images: list[SkyLight] = []
    photocentre_px = np.empty((count, 2))
    electrons = np.empty(count)
    for group in groups:
        field = prediction.state.light.stars(direction[group], stars.magnitude[group], config.star.temperature_k)
        image, photocentre_px[group], electrons[group] = chain.expected(field)
        images.append(image)
    readouts = config.frames.readouts
    detected = np.zeros((readouts, count), bool)
    errors_px = np.full((readouts, count, 2), np.nan)
    false_alarms = []
    for frames in _batches(readouts * len(groups)):  # the groups alternate
        read = [chain.simulator.read(images[number % len(groups)], frame=number, label="chart") for number in frames]
        for number, measured in zip(frames, chain.measure(read), strict=True):
            readout, group_number = divmod(number, len(groups))
            group = groups[group_number]
            detection, false = measured.matched(photocentre_px[group], config.window_px, chain.match_px)
            matched = detection >= 0
            error_px = measured.stars.pixel_px[detection[matched]] - photocentre_px[group][matched]
            detected[readout, group] = matched
            errors_px[readout, group[matched]] = np.where(measured.fit[detection[matched], None], error_px, np.nan)
            false_alarms.append(false)
            if group_number == 0:
                advance()
    return StarGridFrames(
        bright_mag=stars.bright_mag,
        magnitude=stars.magnitude,
        radius_px=np.hypot(*(photocentre_px - camera.centre_px).T),
        electrons=electrons,
        detected=detected,
        error_px=errors_px,
        false_alarms=np.array(false_alarms, np.int64),
    )


def _jittered_grid(width: int, height: int, count: int, window_px: int, rng: np.random.Generator) -> FloatArray:
    """Positions (n, 2), at most about ``count``, jittered in a grid: two windows between stars, one to the edge."""
    cell_px = 3.0 * window_px
    columns = max(1, int(min(np.sqrt(count * width / height), width // cell_px)))
    rows = max(1, int(min(np.ceil(count / columns), height // cell_px)))
    cell = np.array([width / columns, height / rows])
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    centre = np.column_stack([x.ravel(), y.ravel()]) * cell - 0.5
    return np.asarray(centre + rng.uniform(-0.5, 0.5, centre.shape) * (cell - 2.0 * window_px))


def _sky_frame(chain: _FrameChain, number: int) -> tuple[NDArray[np.bool_], Frame, FloatArray]:
    """Rows of the predicted stars in a frame, the frame, and the positions (n, 2) of the stars."""
    view = chain.prediction.view
    visible = view.sample.frame == number
    stars = chain.prediction.state.light.stars(
        view.sample.direction[visible], view.magnitude[visible], view.temperature_k[visible]
    )
    light, position_px, _ = chain.expected(stars)
    return visible, chain.simulator.read(light, frame=number, label="sky"), position_px


def _attitude_error(chain: _FrameChain, measured: MeasuredFrame, number: int, visible: NDArray[np.bool_]) -> FloatArray:
    """Error (3,) of the attitude of a frame of the sky, its stars identified from the a-priori attitude; NaN: none."""
    view = chain.prediction.view
    truth = view.attitudes[number]
    direction = truth.inv().apply(np.array(view.sample.direction[visible]))
    catalogue = _CatalogueStars(id=view.sample.row[visible], direction=direction)
    pixel_rad = np.radians(chain.prediction.state.pixel_arcsec / 3600.0)
    rng = chain.streams.generator("rough", number)
    prior = Rotation.from_rotvec(PRIOR_SIGMA_PX * pixel_rad * rng.standard_normal(3)) * truth
    matches = identify_stars(measured.stars, chain.model, catalogue, near=prior, radius_px=4.0 * PRIOR_SIGMA_PX)
    solved = solve_attitude(measured.stars, matches, chain.model, catalogue)
    if not solved.ok:
        return np.full(3, np.nan)
    # Wahba's problem again, weighted by the predicted errors of the stars as a sensor does
    direction_cam = chain.model.unproject(measured.stars.pixel_px[solved.detected])
    sigma_rad = pixel_rad * chain.prediction.attitude.sigma_px[visible][solved.catalogue]
    weighted = solve_wahba(direction_cam, direction[solved.catalogue], sigma_rad=sigma_rad)
    return attitude_error_arcsec(weighted.rotation, truth)
