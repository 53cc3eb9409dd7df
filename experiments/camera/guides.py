"""Guide stars in the field, and identification lost in space.

Guide stars (`CameraPrediction.guide_stars`) do not saturate and have a detection probability of 0.9. For lost in
space, star lists are drawn from the prediction (detections, centroid errors, false alarms) and identified by tetra3rs
with the calibrated camera: thousands of times cheaper than frames (`experiments.camera.frames`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.accuracy.attitude_forecast import draw_star_list, whole_windows
from calib.attitude.identify import identify
from calib.attitude.star_attitude import star_patterns
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
WRONG_PX, WRONG_SIGMA = 3.0, 10.0
"""An attitude error above both limits is a wrong identification."""
NARROWEST_DEG = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """Guide stars over the sky."""

    guide_brightest_mag: float = col("Guide stars from", "mag", ".2f")
    guide_faintest_mag: float = col("Guide stars to", "mag", ".2f")
    guide_stars_mean_per_frame: float = col("Guide stars per frame, mean over the sky", "", ".1f")
    sky_coverage_percent: float = col(f"Sky with {PATTERN_STARS} guide stars or more", "percent", ".2f")
    sky_percent: FloatArray = col("Fraction of the sky", "percent", ".2f", "least")


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
    sky_percent = [100.0 * float(np.mean(count > least - 0.5)) for least in GUIDE_COUNTS]
    return Coverage(
        guide_brightest_mag=brightest,
        guide_faintest_mag=faintest,
        guide_stars_mean_per_frame=float(count.mean()),
        sky_coverage_percent=sky_percent[GUIDE_COUNTS.index(PATTERN_STARS)],
        sky_percent=np.array(sky_percent),
    )


def _guide_count_axis(q: Quantities, coverage: Coverage) -> None:
    del coverage
    q.axis("least", np.array(GUIDE_COUNTS), "Guide stars, at least")


@dataclass(frozen=True, slots=True, kw_only=True)
class LostInSpace:
    """Identification of drawn star lists without a prior attitude."""

    attitudes: int = col("Attitudes identified lost in space")
    lost_success_percent: float = col("Lost in space: identified", "percent", ".1f", default=math.nan)
    success_fraction: Measured | None = col("Fraction of attitudes identified", default=None)
    wrong_percent: float = col("Lost in space: wrongly identified", "percent", ".2f", default=math.nan)
    identification_time_s: float = col("Identification on this machine, median", "s", ".2g", default=math.nan)
    refusal: str = col("Reason for no identification", default="")


def lost_in_space(prediction: CameraPrediction, *, advance: Callable[[], None] = lambda: None) -> LostInSpace | None:
    """Draw and identify; None without attitudes."""
    config, state, view = prediction.config, prediction.state, prediction.view
    count = min(config.lost.attitudes, view.sample.frames)
    if not count:
        return None
    try:
        if prediction.value("field_diagonal_deg") < NARROWEST_DEG:
            return LostInSpace(
                attitudes=0,
                refusal=f"fields below {NARROWEST_DEG:g} deg are too narrow for patterns of the whole sky",
            )
        model = fit_camera(state.sensor.pixel_map(state.band, temperature_k=config.star.temperature_k)).camera
        patterns = star_patterns(model)
    except StarbenchError as error:  # such as tetra3rs, which is an extra
        return LostInSpace(attitudes=0, refusal=str(error).splitlines()[0])
    streams, forecast = Streams(config.seed).child("camera"), prediction.attitude
    electrons = state.electrons_per_s(view.magnitude, view.temperature_k, view.radius_px)
    size, correct, wrong, times_s = (model.geometry.width_px, model.geometry.height_px), 0, 0, []
    order = np.argsort(view.sample.frame, kind="stable")
    ends = np.searchsorted(view.sample.frame[order], np.arange(count + 1))
    for number in range(count):
        rows = order[ends[number] : ends[number + 1]]
        position_px, flux = draw_star_list(
            model.project(view.sample.direction[rows]),
            electrons[rows],
            forecast.sigma_px[rows],
            forecast.chance[rows],
            false_alarms=prediction.value("false_alarms_per_frame"),
            size_px=size,
            rng=streams.generator("lost", number),
        )
        start = time.perf_counter()
        identification = identify(position_px, model, patterns, flux=flux)
        times_s.append(time.perf_counter() - start)
        solution = identification.attitude
        if identification.ok and solution is not None and solution.rotation is not None:
            across = math.hypot(*attitude_error_arcsec(solution.rotation, view.attitudes[number])[:2])
            sigma = math.hypot(*forecast.total_arcsec[number, :2])
            allowed = max(WRONG_PX * state.pixel_arcsec, WRONG_SIGMA * sigma if math.isfinite(sigma) else 0.0)
            correct, wrong = correct + (across <= allowed), wrong + (across > allowed)
        advance()
    return LostInSpace(
        attitudes=count,
        lost_success_percent=100.0 * correct / count,
        success_fraction=fraction_measured(correct, count),
        wrong_percent=100.0 * wrong / count,
        identification_time_s=float(np.median(times_s)),
    )


def fraction_measured(successes: int, count: int) -> Measured:
    """Fraction with its binomial standard error; p (1 - p) is at least 1 / n."""
    p = successes / count
    return Measured(value=p, uncertainty=math.sqrt(max(p * (1 - p), 1 / count) / count), n=count)


COVERAGE = Section(
    record=Coverage,
    axes=_guide_count_axis,
    rows="least",
    columns="sky_percent",
    caption="Fraction of the sky with at least this number of guide stars in the field.",
)
LOST_IN_SPACE = Section(record=LostInSpace)
