"""Rendered frames against the prediction: an artificial chart read out many times, and frames of the real sky.

The chart has stars of one brightness, whose scatter over the readouts is the noise, and stars about the limiting
magnitude, of which a fraction is detected. The sky is rendered in the first predicted attitudes; the camera is
calibrated without error (a model fitted to its traced map), the attitude approximately known, as for a tracking sensor.
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
from experiments.camera.comparison import ChartFrames, Rendered, SkyFrames, noise_of_chart
from experiments.camera.manufacture import RANKS, Manufactured, RenderedLens
from experiments.camera.operation import moving
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

MATCH_PX, MATCH_WIDTHS = 2.0, 0.6
"""Match radius of detections and stars: the larger of 2 px and 0.6 FWHM of the detection filter."""
CROWDED_FRACTION = 0.02
"""Area fraction of stars (squares of 4 FWHM) above which bright and faint chart stars are read out separately."""
CLEAR_MAG = 2.5
"""Bright chart stars where the quoted star is too faint: brighter by this than the 90 % completeness limit."""
FAINTER_MAG, BRIGHTER_MAG = 0.8, 1.2
"""Range of the faint chart stars about the limiting magnitude."""
ATTITUDE_ERROR_PX = 5.0
"""Standard deviation per axis of the approximate attitude."""
PSF_GRID, COARSE_PSF_GRID = 17, 9
"""PSFs along the longer side of the detector; the coarse grid suffices for noise."""
SLEW_FRACTION = 0.5
"""Slew rate of the chart in motion, as a fraction of the rate at which trails fill the window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _CatalogueStars:
    """Catalogue for `identify_stars`."""

    id: NDArray[np.int64]
    direction: FloatArray


class _Bench:
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
        self.pose = _pose(config)
        kelvin, processing = config.star.temperature_k, prediction.processing
        psfs = None
        if needs_epsf(config.centroid):
            psfs = render_psf_grid(
                sensor,
                prediction.state.light,
                temperature_k=kelvin,
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
        self.model: CameraModel = fit_camera(sensor.pixel_map(prediction.state.band, temperature_k=kelvin)).camera

    def expected(self, stars: StarField) -> tuple[SkyLight, FloatArray, FloatArray]:
        """Expected image of stars in cam; position (n, 2) and electrons (n,) of each, also beyond the frame."""
        light = self.simulator.expected(self.pose, stars=stars)
        truth = light.truth
        position_px = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
        assert truth.electrons_beyond is not None
        return light, position_px, (truth.electrons_image + truth.electrons_beyond)[:, 0]

    def measured(self, frames: Sequence[Frame]) -> list[MeasuredFrame]:
        return shared(partial(measure_frame, reduction=self.reduction), frames)


def _batches(count: int) -> Iterator[range]:
    """Frame numbers in batches, one frame per processor."""
    return (range(first, min(first + processors(), count)) for first in range(0, count, processors()))


def _pose(config: CameraReportConfig) -> Rotation | ConstantRate:
    """Attitude of cam during the exposure, about its middle."""
    if not config.slew.rate_deg_per_s:
        return Rotation.identity()
    exposure_s = config.instrument.exposure_s
    rate_rad_per_s = rate_of_trail(config.slew.rate_deg_per_s, config.slew.direction_deg)
    initial = Rotation.from_rotvec(0.5 * exposure_s * rate_rad_per_s)
    return ConstantRate(initial=initial, rate_rad_per_s=rate_rad_per_s, end_s=exposure_s)


def render_frames(prediction: CameraPrediction, *, advance: Callable[[], None] = lambda: None) -> Rendered:
    """Render, read out and measure the chart and the sky."""
    bench = _Bench(prediction)
    chart = _chart(bench, advance)
    slewing = _slewing_chart(prediction, bench.reduction.dark_dn, advance)
    detected, fit, alarms, errors = [], [], [], []
    example: tuple[NDArray[np.float32], FloatArray] | None = None
    for frames in _batches(prediction.config.frames.sky):
        rendered = [_sky_frame(bench, number) for number in frames]
        measurements = bench.measured([frame for _, frame, _ in rendered])
        for number, (visible, frame, position_px), measured in zip(frames, rendered, measurements, strict=True):
            partner, false = measured.matched(position_px, prediction.config.window_px, bench.match_px)
            detections = partner[partner >= 0]
            detected.append(len(detections))
            fit.append(int(np.count_nonzero(measured.fit[detections])))
            alarms.append(false)
            errors.append(_attitude_error(bench, measured, number, visible))
            if example is None:
                light = (frame.dn - bench.reduction.dark_dn) / np.float32(frame.gain_dn_per_e)
                example = (light, measured.stars.pixel_px)
            advance()
    assert example is not None
    sky = SkyFrames(
        detected=np.array(detected, np.int64),
        fit=np.array(fit, np.int64),
        false_alarms=np.array(alarms, np.int64),
        error_arcsec=np.array(errors),
    )
    return Rendered(chart=chart, slewing=slewing, sky=sky, example_e=example[0], example_px=example[1])


def _slewing_chart(
    prediction: CameraPrediction, dark_dn: NDArray[np.float32], advance: Callable[[], None]
) -> tuple[CameraPrediction, ChartFrames] | None:
    """Chart at `SLEW_FRACTION` of the slew rate at which trails fill the window; None without motion."""
    config = prediction.config
    if not config.motion.points or config.slew.rate_deg_per_s or config.instrument.line_time_us:
        return None
    try:
        slewing = predict_camera(moving(config, SLEW_FRACTION))
    except StarbenchError:
        return None
    return slewing, _chart(_Bench(slewing, long_side=COARSE_PSF_GRID, dark_dn=dark_dn), advance)


def rendered_lenses(
    prediction: CameraPrediction, lenses: Manufactured, *, advance: Callable[[], None] = lambda: None
) -> list[RenderedLens]:
    """Chart through three drawn lenses; the centroider has the PSFs of the drawn lens."""
    rendered, dark_dn = [], None
    for rank, (lens, ratio) in zip(RANKS, lenses.ranked, strict=True):
        bench = _Bench(prediction, lens, long_side=COARSE_PSF_GRID, dark_dn=dark_dn)
        nea, dark_dn = noise_of_chart(prediction, _chart(bench, advance)), bench.reduction.dark_dn
        measured = Measured(value=nea.measured, unit=nea.unit, uncertainty=ratio * nea.error, n=nea.n)
        rendered.append(
            RenderedLens(rank_percent=100.0 * rank, measured_arcsec=measured, predicted_arcsec=ratio * nea.predicted)
        )
    return rendered


def _chart(bench: _Bench, advance: Callable[[], None]) -> ChartFrames:
    prediction, sensor = bench.prediction, bench.simulator.sensor
    camera = sensor.camera
    config, rng = prediction.config, bench.streams.generator("chart")
    limit = prediction.value("limiting_magnitude_mag")
    brightest, complete = prediction.value("saturation_mag") + 0.3, prediction.value("complete_magnitude_mag")
    bright = max(config.star.magnitude_mag, brightest)
    if bright > complete - 0.5:  # the linear response of a fit holds only for stars well above the limit
        bright = min(max(complete - CLEAR_MAG, brightest), complete - 0.5)
    position_px = _scattered(camera.width_px, camera.height_px, config.frames.chart_stars, config.window_px, rng)
    count = len(position_px)
    magnitude = np.full(count, bright)
    faint = np.arange(count) % 2 == 1
    magnitude[faint] = limit + rng.uniform(-BRIGHTER_MAG, FAINTER_MAG, np.count_nonzero(faint))
    direction = sensor.direction_at(*position_px.T)
    # light of bright stars with wide spots raises the noise estimate of the background: separate frames
    area_fraction = count * (4.0 * prediction.processing.fwhm_px) ** 2 / (camera.width_px * camera.height_px)
    crowded = area_fraction > CROWDED_FRACTION
    groups = [np.flatnonzero(~faint), np.flatnonzero(faint)] if crowded else [np.arange(count)]
    light_px, electrons, lights = np.empty_like(position_px), np.empty(count), []
    for group in groups:
        stars = prediction.state.light.stars(direction[group], magnitude[group], config.star.temperature_k)
        light, light_px[group], electrons[group] = bench.expected(stars)
        lights.append(light)
    readouts, alarms = config.frames.readouts, []
    detected, errors = np.zeros((readouts, count), bool), np.full((readouts, count, 2), np.nan)
    for frames in _batches(readouts * len(groups)):
        read = [bench.simulator.read(lights[n % len(groups)], frame=n, label="chart") for n in frames]
        for number, measured in zip(frames, bench.measured(read), strict=True):
            group, readout = groups[number % len(groups)], number // len(groups)
            partner, false = measured.matched(light_px[group], config.window_px, bench.match_px)
            matched = partner >= 0
            error_px = measured.stars.pixel_px[partner[matched]] - light_px[group][matched]
            detected[readout, group] = matched
            errors[readout, group[matched]] = np.where(measured.fit[partner[matched], None], error_px, np.nan)
            alarms.append(false)
            if number % len(groups) == 0:
                advance()
    return ChartFrames(
        bright_mag=bright,
        magnitude=magnitude,
        radius_px=np.hypot(*(light_px - camera.centre_px).T),
        electrons=electrons,
        detected=detected,
        error_px=errors,
        false_alarms=np.array(alarms, np.int64),
    )


def _scattered(width: int, height: int, count: int, window_px: int, rng: np.random.Generator) -> FloatArray:
    """Positions (n, 2), at most about ``count``, jittered in a grid: two windows between stars, one to the edge."""
    cell_px = 3.0 * window_px
    columns = max(1, int(min(np.sqrt(count * width / height), width // cell_px)))
    rows = max(1, int(min(np.ceil(count / columns), height // cell_px)))
    cell = np.array([width / columns, height / rows])
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    middle = np.column_stack([x.ravel(), y.ravel()]) * cell - 0.5
    return np.asarray(middle + rng.uniform(-0.5, 0.5, middle.shape) * (cell - 2.0 * window_px))


def _sky_frame(bench: _Bench, number: int) -> tuple[NDArray[np.bool_], Frame, FloatArray]:
    """Rows of the predicted stars in a frame, the frame, and the positions (n, 2) of the stars."""
    view = bench.prediction.view
    visible = view.sample.frame == number
    stars = bench.prediction.state.light.stars(
        view.sample.direction[visible], view.magnitude[visible], view.temperature_k[visible]
    )
    light, position_px, _ = bench.expected(stars)
    return visible, bench.simulator.read(light, frame=number, label="sky"), position_px


def _attitude_error(bench: _Bench, measured: MeasuredFrame, number: int, visible: NDArray[np.bool_]) -> FloatArray:
    view = bench.prediction.view
    truth = view.attitudes[number]
    direction = truth.inv().apply(np.array(view.sample.direction[visible]))
    catalogue = _CatalogueStars(id=view.sample.row[visible], direction=direction)
    pixel_rad = np.radians(bench.prediction.state.pixel_arcsec / 3600.0)
    rng = bench.streams.generator("rough", number)
    rough = Rotation.from_rotvec(ATTITUDE_ERROR_PX * pixel_rad * rng.standard_normal(3)) * truth
    matches = identify_stars(measured.stars, bench.model, catalogue, near=rough, radius_px=4.0 * ATTITUDE_ERROR_PX)
    solved = solve_attitude(measured.stars, matches, bench.model, catalogue)
    if not solved.ok:
        return np.full(3, np.nan)
    # the solution of the sensor, weighted by the predicted errors of its stars
    v_cam = bench.model.unproject(measured.stars.pixel_px[solved.detected])
    sigma_rad = pixel_rad * bench.prediction.attitude.sigma_px[visible][solved.catalogue]
    weighted = solve_wahba(v_cam, direction[solved.catalogue], sigma_rad=sigma_rad)
    return attitude_error_arcsec(weighted.rotation, truth)
