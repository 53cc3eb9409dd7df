"""Guide stars in the field, and identification lost in space.

Guide stars (`CameraPrediction.guide_stars`) do not saturate and have a detection probability of 0.9. For lost in
space, star lists are drawn from the prediction (detections, centroid errors, false alarms) and identified by tetra3rs
with the calibrated camera: thousands of times cheaper than frames (`experiments.camera.frames`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.accuracy.attitude_forecast import draw_star_list, whole_windows
from calib.attitude.identify import identify
from calib.attitude.star_attitude import star_patterns
from calib.cameras.base import CameraModel
from calib.cameras.fit import fit_camera
from experiments.harness.quantities import Quantities
from experiments.harness.sections import Section, col
from experiments.harness.summary import Measured
from experiments.laboratory.sensor_prediction import CameraPrediction
from optics.arrays import FloatArray
from optics.attitude import attitude_error_arcsec
from optics.errors import DomainError, StarbenchError
from render.engine.random import Streams
from render.sensor_file.catalogue import load_catalogue

GUIDE_COUNTS = (2, 3, 4, 5, 6, 8, 10, 15, 20)
PATTERN_STARS = 4
"""Stars of a pattern of tetra3rs."""
MISIDENTIFICATION_PX = 3.0
"""Cross-boresight error of a wrong identification, at least."""
MISIDENTIFICATION_SIGMA = 10.0
"""Cross-boresight error of a wrong identification in predicted standard deviations, at least."""
MIN_FIELD_DEG = 2.0
"""Diagonal of the narrowest field for patterns of the whole sky."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """Guide stars over the sky."""

    guide_brightest_mag: float = col("Guide stars from", "mag", ".2f")
    guide_faintest_mag: float = col("Guide stars to", "mag", ".2f")
    guide_stars_mean_per_frame: float = col("Guide stars per frame, mean over the sky", "", ".1f")
    sky_coverage_percent: float = col(f"Sky with {PATTERN_STARS} guide stars or more", "percent", ".2f")
    sky_percent: FloatArray = col("Fraction of the sky", "percent", ".2f", "min_guide_stars")


def coverage(prediction: CameraPrediction) -> Coverage:
    """Guide stars in the attitudes of the prediction."""
    view, state, config = prediction.view, prediction.state, prediction.config
    camera = state.sensor.camera
    inside = whole_windows(view.sample.pixel_px, (camera.width_px, camera.height_px), config.window_px)
    brightest, faintest = prediction.value("saturation_mag"), prediction.limits_mag[0.9]
    catalogue = load_catalogue(config.catalogue)
    stars = catalogue.select(np.flatnonzero(catalogue.magnitude <= view.depth_mag))
    try:
        guides = prediction.guide_stars(stars, stars.direction, brightest_mag=brightest, faintest_mag=faintest).row
    except DomainError:  # no guide star
        guides = np.empty(0, np.int64)
    guide = inside & np.isin(view.sample.row, guides)
    count = view.sample.summed(guide.astype(float))
    # the counts are sums of floats: compared half a star below the integer
    sky_percent = [100.0 * float(np.mean(count > minimum - 0.5)) for minimum in GUIDE_COUNTS]
    return Coverage(
        guide_brightest_mag=brightest,
        guide_faintest_mag=faintest,
        guide_stars_mean_per_frame=float(count.mean()),
        sky_coverage_percent=sky_percent[GUIDE_COUNTS.index(PATTERN_STARS)],
        sky_percent=np.array(sky_percent),
    )


def _guide_count_axis(q: Quantities, coverage: Coverage) -> None:
    del coverage
    q.axis("min_guide_stars", np.array(GUIDE_COUNTS), "Guide stars, at least")


@dataclass(frozen=True, slots=True, kw_only=True)
class LostInSpace:
    """Identification of simulated star lists without a prior attitude."""

    attitudes: int = col("Attitudes identified lost in space")
    lost_success_percent: float = col("Lost in space: identified", "percent", ".1f", default=math.nan)
    success_fraction: Measured | None = col("Fraction of attitudes identified", default=None)
    wrong_percent: float = col("Lost in space: wrongly identified", "percent", ".2f", default=math.nan)
    identification_time_s: float = col("Identification on this machine, median", "s", ".2g", default=math.nan)
    reason_skipped: str = col("Reason for no identification", default="")


def lost_in_space(prediction: CameraPrediction, *, advance: Callable[[], None] = lambda: None) -> LostInSpace | None:
    """Simulate star lists and identify them; None without attitudes."""
    count = min(prediction.config.lost.attitudes, prediction.view.sample.frames)
    if not count:
        return None
    try:
        model, patterns = _camera_and_patterns(prediction)
    except StarbenchError as error:  # a field too narrow, or tetra3rs, an extra, not installed
        return LostInSpace(attitudes=0, reason_skipped=str(error).splitlines()[0])
    correct, wrong = 0, 0
    times_s: list[float] = []
    for number, (position_px, flux) in enumerate(_simulated_star_lists(prediction, model, count)):
        start = time.perf_counter()
        identification = identify(position_px, model, patterns, flux=flux)
        times_s.append(time.perf_counter() - start)
        solution = identification.attitude
        if identification.ok and solution is not None and solution.rotation is not None:
            misidentified = _is_misidentified(prediction, number, solution.rotation)
            correct += not misidentified
            wrong += misidentified
        advance()
    return LostInSpace(
        attitudes=count,
        lost_success_percent=100.0 * correct / count,
        success_fraction=fraction_measured(correct, count),
        wrong_percent=100.0 * wrong / count,
        identification_time_s=float(np.median(times_s)),
    )


def _camera_and_patterns(prediction: CameraPrediction) -> tuple[CameraModel, Any]:
    """The camera of the solver, and the patterns of tetra3rs for its field."""
    if prediction.value("field_diagonal_deg") < MIN_FIELD_DEG:
        raise DomainError(f"fields below {MIN_FIELD_DEG:g} deg are too narrow for patterns of the whole sky")
    state = prediction.state
    pixel_map = state.sensor.pixel_map(state.band, temperature_k=prediction.config.star.temperature_k)
    model = fit_camera(pixel_map).camera
    return model, star_patterns(model)


def _simulated_star_lists(
    prediction: CameraPrediction, model: CameraModel, count: int
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Centroids (n, 2) [px] and electrons (n,) of detected stars and false alarms in the first attitudes."""
    view, forecast = prediction.view, prediction.attitude
    streams = Streams(prediction.config.seed).child("camera")
    electrons = prediction.state.electrons_per_s(view.magnitude, view.temperature_k, view.radius_px)
    by_frame = np.argsort(view.sample.frame, kind="stable")
    starts = np.searchsorted(view.sample.frame[by_frame], np.arange(count + 1))
    for number in range(count):
        rows = by_frame[starts[number] : starts[number + 1]]
        yield draw_star_list(
            model.project(view.sample.direction[rows]),
            electrons[rows],
            forecast.sigma_px[rows],
            forecast.chance[rows],
            false_alarms=prediction.value("false_alarms_per_frame"),
            size_px=(model.geometry.width_px, model.geometry.height_px),
            rng=streams.generator("lost", number),
        )


def _is_misidentified(prediction: CameraPrediction, number: int, attitude: Rotation) -> bool:
    """Whether the cross-boresight error is above `MISIDENTIFICATION_PX` and `MISIDENTIFICATION_SIGMA`."""
    error_arcsec = math.hypot(*attitude_error_arcsec(attitude, prediction.view.attitudes[number])[:2])
    sigma_arcsec = math.hypot(*prediction.attitude.total_arcsec[number, :2])  # infinite with too few stars
    by_sigma_arcsec = MISIDENTIFICATION_SIGMA * sigma_arcsec if math.isfinite(sigma_arcsec) else 0.0
    return error_arcsec > max(MISIDENTIFICATION_PX * prediction.state.pixel_arcsec, by_sigma_arcsec)


def fraction_measured(successes: int, count: int) -> Measured:
    """Fraction with its binomial standard error; p (1 - p) >= 1 / n, or none of n would have no error."""
    p = successes / count
    return Measured(value=p, uncertainty=math.sqrt(max(p * (1 - p), 1 / count) / count), n=count)


COVERAGE = Section(
    record=Coverage,
    axes=_guide_count_axis,
    rows="min_guide_stars",
    columns="sky_percent",
    caption="Fraction of the sky with at least this number of guide stars in the field.",
)
LOST_IN_SPACE = Section(record=LostInSpace)
