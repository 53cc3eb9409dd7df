"""Rendered frames against the prediction: an artificial chart read out many times, and frames of the real sky.

The chart has stars of one brightness, whose scatter from readout to readout is the noise, and stars about the limiting
magnitude, of which a share is found. The sky is seen in the first attitudes that were predicted; the camera is
calibrated without error (a model fitted to its traced map), the attitude roughly known, as by a sensor that tracks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from calib.attitude.solve import solve_wahba
from calib.attitude.star_attitude import identify_stars, solve_attitude
from calib.cameras.base import CameraModel
from calib.cameras.fit import fit_camera
from experiments.camera.manufacture import CHOSEN, Manufactured, RenderedLens
from experiments.camera.operation import moving
from experiments.camera.settings import Config
from experiments.harness.plotting import new_figure
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import Section, agree, below, col, ratio_near
from experiments.harness.summary import Measured
from experiments.laboratory.centroid_methods import needs_epsf
from experiments.laboratory.detector_changes import overridden
from experiments.laboratory.instrument import Instrument, build_instrument, configured_detector
from experiments.laboratory.readout.frames import mean_dark_frame
from experiments.laboratory.readout.psf_grid import render_psf_grid
from experiments.laboratory.readout.reduction import MeasuredFrame, Reduction, measure_frame
from experiments.laboratory.sensor_prediction import CameraPrediction, exposed_s, predict_camera
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.errors import StarbenchError
from optics.figures import draw_image
from optics.lens.system import LensSystem
from render.camera import Camera
from render.detector.readout import expose
from render.engine.random import Streams
from render.forward import StarRenderer
from render.motion.trajectory import ConstantRate
from render.records import Frame, StarField
from render.tracing.motion.exposure import ExposureMotion, exposure_motion

__all__ = [
    "FRAMES",
    "SOLVED",
    "Compared",
    "Solved",
    "compare",
    "frames_drawn",
    "render_frames",
    "rendered_lenses",
    "solved_frames",
]

MATCH_PX, MATCH_WIDTHS = 2.0, 0.6
"""A detection this near to the light of a star, or so many widths of the filter, is that star."""
CROWDED = 0.02
"""Share of the chart that stars take up in squares of four widths, above which bright and faint ones are apart."""
FAINTER_MAG, BRIGHTER_MAG = 0.8, 1.2
"""Chart stars about the limiting magnitude."""
ROUGH_PX = 5.0
LONG_SIDE, FEWER = 17, 9
"""PSFs along the longer side of the detector; fewer where the noise alone is looked at."""
TURNING = 0.5
"""Slew rate of the chart in motion, of that at which trails fill the window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartFrames:
    """n artificial stars in k readouts."""

    bright_mag: float  # Magnitude of the stars whose scatter is measured
    # (n,) Of the stars; electrons that reach the detector, those beyond the stamps of diffraction images too
    magnitude: FloatArray
    radius_px: FloatArray
    electrons: FloatArray
    found: NDArray[np.bool_]  # (k, n) Whether a detection belongs to the star
    error_px: FloatArray  # (k, n, 2) Centroid minus mean of all light of the star; NaN where there is none
    false_alarms: NDArray[
        np.int64
    ]  # Of each frame: detections without a star, those that are flagged as too sharp left out


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyFrames:
    """m frames of the real sky; frame k has attitude k of the prediction."""

    found: NDArray[np.int64]  # (m,) Stars that are found, and those of them that are fit for an attitude
    fit: NDArray[np.int64]  # (m,)
    false_alarms: NDArray[np.int64]  # (m,) As for the chart
    error_arcsec: FloatArray  # (m, 3) Attitude minus truth about x, y (across) and z (roll); NaN where there is none
    status: tuple[str, ...]  # Of the identification


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendered:
    """What the frames showed."""

    chart: ChartFrames  # Artificial stars
    moving: tuple[CameraPrediction, ChartFrames] | None  # The same of the camera that turns
    sky: SkyFrames  # Real sky
    example_e: NDArray[np.float32]  # (h, w) First frame of the sky, electrons above the dark
    example_px: FloatArray  # (n, 2) Where its stars were measured


@dataclass(frozen=True, slots=True, kw_only=True)
class _Known:
    """Stars that the attitude is solved with."""

    id: NDArray[np.int64]
    direction: FloatArray


class _Bench:
    """Everything that all frames share."""

    def __init__(
        self, prediction: CameraPrediction, lens: LensSystem | None = None, *, long_side: int = LONG_SIDE
    ) -> None:
        """``lens``: another one, whose image plane is where the detector stands."""
        self.prediction, config = prediction, prediction.config
        setting = config.instrument
        detector = overridden(configured_detector(setting), config.detector)
        self.instrument: Instrument = build_instrument(setting, detector=detector)
        if lens is not None:
            camera = replace(self.instrument.camera, lens=lens, defocus_mm=0.0)
            self.instrument = replace(self.instrument, camera=camera)
        self.streams = Streams(config.seed).child("camera")
        self.motion = _slew(config, self.instrument.camera)
        exposed = exposed_s(config) if self.motion is None else self.motion.exposure_s
        self.renderer = StarRenderer(self.instrument.camera, exposure_s=exposed, tolerance=1e-4)
        light, kelvin = prediction.state.light, config.star.temperature_k
        psfs = None
        if needs_epsf(config.centroid):
            psfs = render_psf_grid(
                self.instrument,
                light,
                temperature_k=kelvin,
                window_px=config.window_px,
                trail_px=prediction.state.trail_px,
                long_side=long_side,
            )
        processing = prediction.processing
        self.match_px = max(MATCH_PX, MATCH_WIDTHS * processing.fwhm_px)
        self.reduction = Reduction(
            dark_dn=mean_dark_frame(self.instrument, config.dark_frames, streams=self.streams, label="dark"),
            noise=processing.noise,
            centroid=config.centroid,
            window_px=config.window_px,
            threshold_sigma=processing.threshold_sigma,
            fwhm_px=processing.fwhm_px,
            psfs=psfs,
            background_step_px=1,
        )
        self.model: CameraModel = fit_camera(
            self.instrument.pixel_map(prediction.state.band, temperature_k=kelvin)
        ).camera

    def expected(self, stars: StarField) -> tuple[NDArray[np.float32], FloatArray, FloatArray]:
        """Noiseless image, and place (n, 2) and electrons (n,) of the light of the stars on it."""
        if self.motion is not None:  # lasts for the exposure; light that is lost on the way is left out of the stars
            lost = self.prediction.config.throughput_fraction
            stars = replace(stars, photon_rate=stars.photon_rate * lost)
        traced = self.renderer.trace(stars, motion=self.motion)
        truth = traced.truth
        place = np.column_stack([truth.photon_x_px[:, 0], truth.photon_y_px[:, 0]])
        assert truth.electrons_beyond is not None
        return traced.electrons[:, :, 0], place, (truth.electrons_image + truth.electrons_beyond)[:, 0]

    def read(self, electrons: NDArray[np.float32], number: int, label: str) -> Frame:
        config = self.prediction.config
        return expose(
            electrons,
            self.instrument.detector,
            streams=self.streams,
            frame=number,
            exposure_s=config.instrument.exposure_s,
            temperature_c=config.instrument.chip_temperature_c,
            background_e_per_s=config.background_e_per_s,
            band=label,
        )


def _slew(config: Config, camera: Camera) -> ExposureMotion | None:
    """Turn during an exposure; the attitude asked for is that of its middle."""
    rate, towards = math.radians(config.slew.rate_deg_per_s), math.radians(config.slew.direction_deg)
    if not rate:
        return None
    exposure = config.instrument.exposure_s
    turn = rate * np.array([math.sin(towards), -math.cos(towards), 0.0])
    path = ConstantRate(initial=Rotation.from_rotvec(0.5 * exposure * turn), rate_rad_per_s=turn, end_s=exposure)
    return exposure_motion(path, start_s=0.0, exposure_s=exposure, camera=camera)


def render_frames(prediction: CameraPrediction, *, advance: Callable[[], None] = lambda: None) -> Rendered:
    """Render, read out, measure."""
    bench = _Bench(prediction)
    chart = _chart(bench, advance)
    turning = _turning(prediction, advance)
    found, useful, alarms, errors, status = [], [], [], [], []
    example: tuple[NDArray[np.float32], FloatArray] | None = None
    for number in range(prediction.config.frames.sky):
        seen, frame, measured, place = _sky_frame(bench, number)
        partner, false = measured.matched(place, prediction.config.window_px, bench.match_px)
        fit = partner >= 0
        found.append(int(np.count_nonzero(fit)))
        fit[fit] = measured.fit[partner[fit]]
        useful.append(int(np.count_nonzero(fit)))
        alarms.append(false)
        error, how = _attitude_error(bench, measured, number, seen)
        errors.append(error)
        status.append(how)
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
        status=tuple(status),
    )
    return Rendered(chart=chart, moving=turning, sky=sky, example_e=example[0], example_px=example[1])


def _turning(prediction: CameraPrediction, advance: Callable[[], None]) -> tuple[CameraPrediction, ChartFrames] | None:
    """The chart at half of the slew rate at which trails fill the window; None where no motion is asked for."""
    config = prediction.config
    if not config.motion.points or config.slew.rate_deg_per_s or config.instrument.line_time_us:
        return None
    try:
        turned = predict_camera(moving(config, TURNING))
    except StarbenchError:
        return None
    return turned, _chart(_Bench(turned, long_side=FEWER), advance)


def rendered_lenses(
    prediction: CameraPrediction, made: Manufactured, *, advance: Callable[[], None] = lambda: None
) -> list[RenderedLens]:
    """The chart through lenses as they were drawn; the PSFs of the centroider are their own."""
    found = []
    for share, (lens, ratio) in zip(CHOSEN, made.chosen, strict=True):
        one = _noise(prediction, _chart(_Bench(prediction, lens, long_side=FEWER), advance))
        seen = Measured(value=one.measured, unit=one.unit, uncertainty=ratio * one.error, n=one.n)
        found.append(
            RenderedLens(share_percent=100.0 * share, measured_arcsec=seen, predicted_arcsec=ratio * one.predicted)
        )
    return found


def _chart(bench: _Bench, advance: Callable[[], None]) -> ChartFrames:
    prediction, camera = bench.prediction, bench.instrument.camera
    config, rng = prediction.config, bench.streams.generator("chart")
    limit = prediction.value("limiting_magnitude_mag")
    bright = max(config.star.magnitude_mag, prediction.value("saturation_mag") + 0.3)
    bright = min(bright, prediction.value("complete_magnitude_mag") - 0.5)
    place = _scattered(camera.width_px, camera.height_px, config.frames.chart_stars, config.window_px, rng)
    magnitude = np.full(len(place), bright)
    faint = np.arange(len(place)) % 2 == 1
    magnitude[faint] = limit + rng.uniform(-BRIGHTER_MAG, FAINTER_MAG, np.count_nonzero(faint))
    direction = camera.nominal_direction(place[:, 0], place[:, 1], bench.instrument.focal_length_mm)
    # where wide spots of bright stars fill the frame, it takes their light for noise: the faint ones have their own
    share = len(place) * (4.0 * prediction.processing.fwhm_px) ** 2 / (camera.width_px * camera.height_px)
    groups = [np.flatnonzero(~faint), np.flatnonzero(faint)] if share > CROWDED else [np.arange(len(place))]
    light_px, electrons, images = np.empty_like(place), np.empty(len(place)), []
    for group in groups:
        stars = prediction.state.light.stars(direction[group], magnitude[group], config.star.temperature_k)
        image, light_px[group], electrons[group] = bench.expected(stars)
        images.append(np.array(image))
    found, errors, alarms = [], [], []
    for number in range(config.frames.readouts):
        seen, error = np.zeros(len(place), bool), np.full((len(place), 2), np.nan)
        for k, (group, image) in enumerate(zip(groups, images, strict=True)):
            frame = bench.read(image, number * len(groups) + k, "chart")
            measured = measure_frame(frame, bench.reduction)
            partner, false = measured.matched(light_px[group], config.window_px, bench.match_px)
            here = partner >= 0
            away = measured.stars.pixel_px[partner[here]] - light_px[group][here]
            seen[group], error[group[here]] = here, np.where(measured.fit[partner[here], None], away, np.nan)
            alarms.append(false)
        found.append(seen)
        errors.append(error)
        advance()
    return ChartFrames(
        bright_mag=bright,
        magnitude=magnitude,
        radius_px=np.hypot(*(light_px - camera.centre_px).T),
        electrons=electrons,
        found=np.array(found),
        error_px=np.array(errors),
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


def _sky_frame(bench: _Bench, number: int) -> tuple[NDArray[np.bool_], Frame, MeasuredFrame, FloatArray]:
    view = bench.prediction.view
    seen = view.sample.frame == number
    stars = bench.prediction.state.light.stars(
        view.sample.direction[seen], view.magnitude[seen], view.temperature_k[seen]
    )
    image, place, _ = bench.expected(stars)
    frame = bench.read(image, number, "sky")
    return seen, frame, measure_frame(frame, bench.reduction), place


def _attitude_error(
    bench: _Bench, measured: MeasuredFrame, number: int, seen: NDArray[np.bool_]
) -> tuple[FloatArray, str]:
    view = bench.prediction.view
    truth = view.attitudes[number]
    known = _Known(id=view.sample.row[seen], direction=truth.inv().apply(np.array(view.sample.direction[seen])))
    pixel_rad = np.radians(bench.prediction.state.pixel_arcsec / 3600.0)
    rng = bench.streams.generator("rough", number)
    rough = Rotation.from_rotvec(ROUGH_PX * pixel_rad * rng.standard_normal(3)) * truth
    found = identify_stars(measured.stars, bench.model, known, near=rough, radius_px=4.0 * ROUGH_PX)
    solved = solve_attitude(measured.stars, found, bench.model, known)
    if not solved.ok:
        return np.full(3, np.nan), found.status if not found.ok else solved.solution.status
    # weights: the errors that the sensor knows its stars to have
    pixel = measured.stars.pixel_px[solved.detected]
    sigma_px = bench.prediction.attitude.sigma_px[seen][solved.catalogue]
    weighted = solve_wahba(
        bench.model.unproject(pixel), known.direction[solved.catalogue], sigma_rad=pixel_rad * sigma_px
    )
    return attitude_error_arcsec(weighted.rotation, truth), "solved"


# --- Measured against predicted


WIDEST_MAG = 3.0
UNFIT_SHARE = 0.05
"""Stars whose fit does not converge, or that look too sharp: known to so much of their number."""
MODEL_SHARE, MODEL_MAG = 0.03, 0.05
"""What the prediction leaves out (fields between five, PSFs in cells, a linear response), three standard deviations."""
FEWEST_STARS = 8
"""Fewer are not always told from chance."""
MAG = 2.5 / math.log(10.0)
"""Magnitudes that stand for a relative error of the light."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """One quantity, measured in frames and predicted for the same stars and attitudes."""

    comparison: str = col("Quantity")
    label: str = col("Quantity", json="")
    measured: float = col("Measured", format=".4g")
    predicted: float = col("Predicted", format=".4g")
    unit: str = col("Unit", json="")
    error: float = col("Standard deviation", format=".2g")
    n: int = col("Samples", json="")
    pull: Measured = col("Difference", "sigma", ".1f", json="")
    # In standard deviations what an error of the whole would be
    whole: float = col("Predicted over its standard deviation", "sigma", json="", shown=False)


def compared(**given: Any) -> Compared:
    """A comparison with its difference in standard deviations."""
    error = given["error"]
    pull = (given["measured"] - given["predicted"]) / error if error > 0 else math.nan
    whole = abs(MAG if given["unit"] == "mag" else given["predicted"]) / error if error > 0 else math.nan
    return Compared(pull=Measured(value=pull, unit="sigma", uncertainty=1.0), whole=whole, **given)


@dataclass(frozen=True, slots=True, kw_only=True)
class Solved:
    """Frames of the sky, and their attitudes."""

    chart_stars: int = col("Chart stars", json="")
    frames_unsolved: int = col(f"Frames with {FEWEST_STARS} stars or more that are not solved")
    # None where no frame was solved
    attitude_ratio: Measured | None = col("Attitude errors over predicted ones, RMS of three axes", default=None)
    rendered: Rendered


def solved_frames(prediction: CameraPrediction, rendered: Rendered) -> Solved:
    """What became of the frames of the sky."""
    error = rendered.sky.error_arcsec
    enough = prediction.attitude.stars[: len(error)] >= FEWEST_STARS
    known = np.isfinite(error).all(axis=1)
    pull = error[known] / prediction.attitude.total_arcsec[: len(error)][known]
    ratio = None
    if pull.size:
        rms, spread = float(np.sqrt((pull**2).mean())), float(1.0 / np.sqrt(2.0 * pull.size))
        ratio = Measured(value=rms, uncertainty=spread, n=pull.size)
    return Solved(
        chart_stars=len(rendered.chart.magnitude),
        frames_unsolved=int(np.count_nonzero(enough & ~known)),
        attitude_ratio=ratio,
        rendered=rendered,
    )


def compare(prediction: CameraPrediction, rendered: Rendered) -> list[Compared]:
    """All comparisons of a run."""
    return [
        _electrons(prediction, rendered),
        _noise(prediction, rendered.chart),
        *([] if rendered.moving is None else [_noise(*rendered.moving, key="nea_moving")]),
        _limit(prediction, rendered),
        _alarms(prediction, rendered),
        *_stars(prediction, rendered),
        *_attitude(prediction, rendered),
    ]


def bright_stars(chart: ChartFrames) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors (k, n, 2) [px], electrons and distances (n,) of the chart's bright stars that are fit in all readouts."""
    good = (chart.magnitude == chart.bright_mag) & np.isfinite(chart.error_px).all(axis=(0, 2))
    return chart.error_px[:, good], chart.electrons[good], chart.radius_px[good]


def _electrons(prediction: CameraPrediction, rendered: Rendered) -> Compared:
    """Light of the renderer, beside lens area times throughput by another trace with other rays."""
    chart = rendered.chart
    whole = chart.magnitude == chart.bright_mag
    kelvin = prediction.config.star.temperature_k
    expected = prediction.electrons(chart.magnitude[whole], kelvin, chart.radius_px[whole])
    # both are quadratures of the pupil: a part in a thousand is what they promise
    return compared(
        comparison="electrons",
        label=f"Electrons of a star of {chart.bright_mag:.2f} mag",
        unit="e-",
        measured=float(chart.electrons[whole].mean()),
        predicted=float(expected.mean()),
        error=1e-3 * float(expected.mean()),
        n=int(whole.sum()),
    )


def _noise(prediction: CameraPrediction, chart: ChartFrames, key: str = "nea") -> Compared:
    errors, electrons, radius = bright_stars(chart)
    readouts, stars = errors.shape[:2]
    rate = prediction.config.slew.rate_deg_per_s
    scale, star = prediction.state.pixel_arcsec, prediction.stars
    seen = float(np.sqrt(errors.var(axis=0, ddof=1).mean())) * scale
    expected = float(np.sqrt((star.sigma_at(star.centroid.noise_px, electrons, radius) ** 2).mean())) * scale
    samples = 2 * stars * (readouts - 1)
    # pixels differ in read noise: of the some 4 pi s^2 under a star each has its own
    pixel = prediction.processing.pixel
    under = max(4.0 * np.pi * (prediction.state.fwhm_px / 2.3548) ** 2 * stars, 1.0)
    chips = 0.5 * np.sqrt(pixel.floor_e4 / under) / pixel.floor_e2
    return compared(
        comparison=key,
        label=f"NEA of a star of {chart.bright_mag:.2f} mag" + (f" at {rate:.3g} °/s" if rate else ""),
        unit="arcsec",
        measured=seen,
        predicted=expected,
        error=expected * math.hypot(1.0 / math.sqrt(2.0 * samples), chips, MODEL_SHARE / 3.0),
        n=samples,
    )


def _limit(prediction: CameraPrediction, rendered: Rendered) -> Compared:
    """Shift of the predicted completeness curve that makes the chart's faint stars found as often as they were."""
    chart, star = rendered.chart, prediction.stars
    faint = chart.magnitude != chart.bright_mag
    electrons, radius, seen = chart.electrons[faint], chart.radius_px[faint], chart.found[:, faint].mean(axis=0)

    def share(shift_mag: float) -> FloatArray:
        return star.found_at(electrons * 10.0 ** (0.4 * shift_mag), radius)

    def excess(shift_mag: float) -> float:
        return float(share(shift_mag).mean() - seen.mean())

    limit = prediction.value("limiting_magnitude_mag")
    inside = excess(-WIDEST_MAG) < 0.0 < excess(WIDEST_MAG)
    shift = float(brentq(excess, -WIDEST_MAG, WIDEST_MAG)) if inside else float("nan")
    slope = (excess(0.02) - excess(-0.02)) / 0.04
    spread = (seen - share(0.0)).std(ddof=1) / np.sqrt(len(seen))  # stars differ; readouts of one star share its place
    return compared(
        comparison="limiting_magnitude",
        label="Limiting magnitude, half are found",
        unit="mag",
        measured=limit + shift,
        predicted=limit,
        error=math.hypot(spread / slope, MODEL_MAG / 3.0),
        n=int(seen.size * len(chart.found)),
    )


def _alarms(prediction: CameraPrediction, rendered: Rendered) -> Compared:
    counts = np.concatenate([rendered.chart.false_alarms, rendered.sky.false_alarms])
    expected = prediction.value("false_alarms_per_frame") * len(counts)
    # Poisson, and the mean dark frame is the same in all frames: its noise repeats
    repeated = 1.0 + len(counts) / (1.0 + prediction.config.dark_frames)
    return compared(
        comparison="false_alarms",
        label=f"False alarms in {len(counts)} frames",
        unit="",
        measured=float(counts.sum()),
        predicted=expected,
        error=float(np.sqrt(expected * repeated + 1.0 + (0.1 * expected) ** 2)),
        n=int(counts.sum()),
    )


def _stars(prediction: CameraPrediction, rendered: Rendered) -> tuple[Compared, ...]:
    forecast, frames = prediction.attitude, len(rendered.sky.found)
    variance = float(forecast.found_variance[:frames].sum())
    return tuple(
        compared(
            comparison=name,
            label=words,
            unit="",
            measured=float(seen.sum()),
            predicted=float(expected[:frames].sum()),
            error=float(np.sqrt(variance + 1.0 + (share * expected[:frames].sum()) ** 2)),
            n=frames,
        )
        for name, words, seen, expected, share in (
            ("stars", f"Stars found in {frames} frames of the sky", rendered.sky.found, forecast.found, 0.0),
            ("fit_stars", "Stars fit for an attitude", rendered.sky.fit, forecast.stars, UNFIT_SHARE),
        )
    )


def _attitude(prediction: CameraPrediction, rendered: Rendered) -> tuple[Compared, ...]:
    """Root mean square of the errors, beside that of the standard deviations predicted for the same attitudes."""
    error = rendered.sky.error_arcsec
    solved = np.isfinite(error).all(axis=1)
    sigma = prediction.attitude.total_arcsec[: len(error)][solved]
    found: list[Compared] = []
    if not solved.any():
        return ()
    for name, columns, words in (("cross", slice(0, 2), "across"), ("roll", slice(2, 3), "roll")):
        seen, expected = error[solved][:, columns], sigma[:, columns]
        typical = float(np.sqrt((expected**2).mean()))
        # the mean square of normal errors of different sigma
        spread = float(np.sqrt(2.0 * (expected**4).sum())) / expected.size / (2.0 * typical)
        found.append(
            compared(
                comparison=f"attitude_{name}",
                label=f"Attitude {words}, RMS of {int(solved.sum())} frames",
                unit="arcsec",
                measured=float(np.sqrt((seen**2).mean())),
                predicted=typical,
                error=spread,
                n=int(seen.size),
            )
        )
    return tuple(found)


def _comparisons(q: Quantities, compared: list[Compared]) -> None:
    keys = np.array([one.comparison for one in compared], dtype=object)
    q.axis("comparison", keys, "Quantity", names=[one.label for one in compared])


def frames_drawn(outcome: Outcome) -> Figure:
    """The first frame of the sky, with what was detected in it."""
    rendered: Rendered = outcome.result["solved"].rendered
    height, width = rendered.example_e.shape
    figure, panel = new_figure(aspect_ratio=min(1.05, 0.92 * height / width + 0.05))
    draw_image(rendered.example_e, panel)
    ring = {"markersize": 9, "markerfacecolor": "none", "markeredgecolor": "#f0b000", "markeredgewidth": 0.8}
    panel.plot(*rendered.example_px.T, "o", **ring)
    panel.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="column [px]", ylabel="row [px]")
    panel.grid(False)
    return figure


JUDGED = {
    "nea": "scatter of readouts against prediction",
    "nea_moving": "scatter of readouts against prediction, camera turning",
    "limiting_magnitude": "share of chart stars found against prediction",
    "false_alarms": "counted against predicted",
    "stars": "counted against predicted",
}
ADVICE = {"nea": "the centroider does not follow its linear response: too faint a star, too small a window"}
FRAMES = Section(
    record=Compared,
    dim="comparison",
    axes=_comparisons,
    prefix="compared_",
    place="frames[comparison]",
    table="frames",
    hidden="comparison",
    rows="comparison",
    columns="label measured predicted unit error n pull",
    caption="Rendered frames against the prediction for the same stars and attitudes.",
    note="Standard deviation: of measured minus predicted, as predicted; the difference is in units of it.",
    verdicts=[
        agree(
            "compared_pull",
            0.0,
            at={"comparison": key},
            title=title,
            of="compared_whole",
            advice=ADVICE.get(key, ""),
        )
        for key, title in JUDGED.items()
    ],
)
SOLVED = Section(
    record=Solved,
    figures={"frame": frames_drawn},
    verdicts=[
        ratio_near(
            "attitude_ratio",
            within=0.05,
            title="attitudes across and roll: errors of solved frames over predicted ones, RMS",
            advice="centroids are worse than predicted, or the camera model of the solver is not that of the lens",
        ),
        below("frames_unsolved", 0.0, title=f"frames of the sky with {FEWEST_STARS} stars or more, not solved"),
    ],
)
