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
from experiments.camera.manufacture import CHOSEN, Manufactured, RenderedLens
from experiments.camera.operation import moving
from experiments.camera.settings import Config
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
"""Largest distance of a detection from the light of its star: in px, and in widths of the filter."""
CROWDED = 0.02
"""Share of the chart that stars take up in squares of four widths, above which bright and faint ones are apart."""
CLEAR_MAG = 2.5
"""Chart stars of one brightness where the quoted star is too faint, from the magnitude at which 90 % are found."""
FAINTER_MAG, BRIGHTER_MAG = 0.8, 1.2
"""Chart stars about the limiting magnitude."""
ROUGH_PX = 5.0
LONG_SIDE, FEWER = 17, 9
"""PSFs along the longer side of the detector; fewer for noise alone."""
TURNING = 0.5
"""Slew rate of the chart in motion, of that at which trails fill the window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Known:
    """Stars that the attitude is solved with."""

    id: NDArray[np.int64]
    direction: FloatArray


class _Bench:
    """Simulator and reduction that all frames share."""

    def __init__(
        self,
        prediction: CameraPrediction,
        lens: LensSystem | None = None,
        *,
        long_side: int = LONG_SIDE,
        dark_dn: NDArray[np.float32] | None = None,
    ) -> None:
        """``lens``: another one, whose image plane is where the detector stands; ``dark_dn``: mean dark frame."""
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
        """Light of stars in cam, and place (n, 2) and electrons (n,) of each, those beyond the frame included."""
        light = self.simulator.expected(self.pose, stars=stars)
        truth = light.truth
        place = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
        assert truth.electrons_beyond is not None
        return light, place, (truth.electrons_image + truth.electrons_beyond)[:, 0]

    def measured(self, frames: Sequence[Frame]) -> list[MeasuredFrame]:
        return shared(partial(measure_frame, reduction=self.reduction), frames)


def _by_processors(count: int) -> Iterator[range]:
    """Numbers of frames that are measured at a time."""
    return (range(first, min(first + processors(), count)) for first in range(0, count, processors()))


def _pose(config: Config) -> Rotation | ConstantRate:
    """Stars are given in cam, as of the middle of the exposure."""
    if not config.slew.rate_deg_per_s:
        return Rotation.identity()
    exposure_s, turn = (
        config.instrument.exposure_s,
        rate_of_trail(config.slew.rate_deg_per_s, config.slew.direction_deg),
    )
    middle = Rotation.from_rotvec(0.5 * exposure_s * turn)
    return ConstantRate(initial=middle, rate_rad_per_s=turn, end_s=exposure_s)


def render_frames(prediction: CameraPrediction, *, advance: Callable[[], None] = lambda: None) -> Rendered:
    """Render, read out, measure."""
    bench = _Bench(prediction)
    chart = _chart(bench, advance)
    turning = _turning(prediction, bench.reduction.dark_dn, advance)
    found, useful, alarms, errors = [], [], [], []
    example: tuple[NDArray[np.float32], FloatArray] | None = None
    for frames in _by_processors(prediction.config.frames.sky):
        taken = [_sky_frame(bench, number) for number in frames]
        measurements = bench.measured([frame for _, frame, _ in taken])
        for number, (seen, frame, place), measured in zip(frames, taken, measurements, strict=True):
            partner, false = measured.matched(place, prediction.config.window_px, bench.match_px)
            fit = partner >= 0
            found.append(int(np.count_nonzero(fit)))
            fit[fit] = measured.fit[partner[fit]]
            useful.append(int(np.count_nonzero(fit)))
            alarms.append(false)
            errors.append(_attitude_error(bench, measured, number, seen))
            if example is None:
                light = (frame.dn - bench.reduction.dark_dn) / np.float32(frame.gain_dn_per_e)
                example = (light, measured.stars.pixel_px)
            advance()
    assert example is not None
    sky = SkyFrames(
        found=np.array(found, np.int64),
        fit=np.array(useful, np.int64),
        false_alarms=np.array(alarms, np.int64),
        error_arcsec=np.array(errors),
    )
    return Rendered(chart=chart, moving=turning, sky=sky, example_e=example[0], example_px=example[1])


def _turning(
    prediction: CameraPrediction, dark_dn: NDArray[np.float32], advance: Callable[[], None]
) -> tuple[CameraPrediction, ChartFrames] | None:
    """The chart at half of the slew rate at which trails fill the window; None without motion."""
    config = prediction.config
    if not config.motion.points or config.slew.rate_deg_per_s or config.instrument.line_time_us:
        return None
    try:
        turned = predict_camera(moving(config, TURNING))
    except StarbenchError:
        return None
    return turned, _chart(_Bench(turned, long_side=FEWER, dark_dn=dark_dn), advance)


def rendered_lenses(
    prediction: CameraPrediction, made: Manufactured, *, advance: Callable[[], None] = lambda: None
) -> list[RenderedLens]:
    """The chart through lenses as they were drawn; the PSFs of the centroider are their own."""
    found, dark_dn = [], None
    for share, (lens, ratio) in zip(CHOSEN, made.chosen, strict=True):
        bench = _Bench(prediction, lens, long_side=FEWER, dark_dn=dark_dn)
        one, dark_dn = noise_of_chart(prediction, _chart(bench, advance)), bench.reduction.dark_dn
        seen = Measured(value=one.measured, unit=one.unit, uncertainty=ratio * one.error, n=one.n)
        found.append(
            RenderedLens(share_percent=100.0 * share, measured_arcsec=seen, predicted_arcsec=ratio * one.predicted)
        )
    return found


def _chart(bench: _Bench, advance: Callable[[], None]) -> ChartFrames:
    prediction, sensor = bench.prediction, bench.simulator.sensor
    camera = sensor.camera
    config, rng = prediction.config, bench.streams.generator("chart")
    limit = prediction.value("limiting_magnitude_mag")
    full, whole = prediction.value("saturation_mag") + 0.3, prediction.value("complete_magnitude_mag")
    bright = max(config.star.magnitude_mag, full)
    if bright > whole - 0.5:  # a fit follows its linear response for stars well above the limit only
        bright = min(max(whole - CLEAR_MAG, full), whole - 0.5)
    place = _scattered(camera.width_px, camera.height_px, config.frames.chart_stars, config.window_px, rng)
    magnitude = np.full(len(place), bright)
    faint = np.arange(len(place)) % 2 == 1
    magnitude[faint] = limit + rng.uniform(-BRIGHTER_MAG, FAINTER_MAG, np.count_nonzero(faint))
    direction = sensor.direction_at(place[:, 0], place[:, 1])
    # where wide spots of bright stars fill the frame, it takes their light for noise: the faint ones have their own
    share = len(place) * (4.0 * prediction.processing.fwhm_px) ** 2 / (camera.width_px * camera.height_px)
    groups = [np.flatnonzero(~faint), np.flatnonzero(faint)] if share > CROWDED else [np.arange(len(place))]
    light_px, electrons, lights = np.empty_like(place), np.empty(len(place)), []
    for group in groups:
        stars = prediction.state.light.stars(direction[group], magnitude[group], config.star.temperature_k)
        light, light_px[group], electrons[group] = bench.expected(stars)
        lights.append(light)
    readouts, alarms = config.frames.readouts, []
    found, errors = np.zeros((readouts, len(place)), bool), np.full((readouts, len(place), 2), np.nan)
    for frames in _by_processors(readouts * len(groups)):
        taken = [bench.simulator.read(lights[n % len(groups)], frame=n, label="chart") for n in frames]
        for number, measured in zip(frames, bench.measured(taken), strict=True):
            group, readout = groups[number % len(groups)], number // len(groups)
            partner, false = measured.matched(light_px[group], config.window_px, bench.match_px)
            here = partner >= 0
            away = measured.stars.pixel_px[partner[here]] - light_px[group][here]
            found[readout, group] = here
            errors[readout, group[here]] = np.where(measured.fit[partner[here], None], away, np.nan)
            alarms.append(false)
            if number % len(groups) == 0:
                advance()
    return ChartFrames(
        bright_mag=bright,
        magnitude=magnitude,
        radius_px=np.hypot(*(light_px - camera.centre_px).T),
        electrons=electrons,
        found=found,
        error_px=errors,
        false_alarms=np.array(alarms, np.int64),
    )


def _scattered(width: int, height: int, count: int, window_px: int, rng: np.random.Generator) -> FloatArray:
    """Places (n, 2), at most ``count``, each in a cell of its own, two windows from the next one and from the edge."""
    least = 3.0 * window_px
    columns = max(1, int(min(np.sqrt(count * width / height), width // least)))
    rows = max(1, int(min(np.ceil(count / columns), height // least)))
    cell = np.array([width / columns, height / rows])
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    middle = np.column_stack([x.ravel(), y.ravel()]) * cell - 0.5
    return np.asarray(middle + rng.uniform(-0.5, 0.5, middle.shape) * (cell - 2.0 * window_px))


def _sky_frame(bench: _Bench, number: int) -> tuple[NDArray[np.bool_], Frame, FloatArray]:
    view = bench.prediction.view
    seen = view.sample.frame == number
    stars = bench.prediction.state.light.stars(
        view.sample.direction[seen], view.magnitude[seen], view.temperature_k[seen]
    )
    light, place, _ = bench.expected(stars)
    return seen, bench.simulator.read(light, frame=number, label="sky"), place


def _attitude_error(bench: _Bench, measured: MeasuredFrame, number: int, seen: NDArray[np.bool_]) -> FloatArray:
    view = bench.prediction.view
    truth = view.attitudes[number]
    known = _Known(id=view.sample.row[seen], direction=truth.inv().apply(np.array(view.sample.direction[seen])))
    pixel_rad = np.radians(bench.prediction.state.pixel_arcsec / 3600.0)
    rng = bench.streams.generator("rough", number)
    rough = Rotation.from_rotvec(ROUGH_PX * pixel_rad * rng.standard_normal(3)) * truth
    found = identify_stars(measured.stars, bench.model, known, near=rough, radius_px=4.0 * ROUGH_PX)
    solved = solve_attitude(measured.stars, found, bench.model, known)
    if not solved.ok:
        return np.full(3, np.nan)
    # weights: the errors that the sensor knows its stars to have
    pixel = measured.stars.pixel_px[solved.detected]
    sigma_px = bench.prediction.attitude.sigma_px[seen][solved.catalogue]
    weighted = solve_wahba(
        bench.model.unproject(pixel), known.direction[solved.catalogue], sigma_rad=pixel_rad * sigma_px
    )
    return attitude_error_arcsec(weighted.rotation, truth)
