"""Real and rendered frames compared: statistics, completeness, false detections, separability of star windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.fitting.misfit import two_sided_quantile
from calib.measure.detection.limiting_magnitude import completeness
from calib.measure.statistics.separability import FEATURES, Separability, separability, window_features
from experiments.harness.quantities import Outcome, shown_unit
from experiments.harness.sections import col
from experiments.harness.summary import Criterion, Measured, measured
from experiments.twin.compare import THRESHOLDS_SIGMA, FrameStatistics, joined, statistics_of
from experiments.twin.hold_out import HeldOut
from experiments.twin.pipeline import MeasuredNight
from optics.arrays import FloatArray, IntArray

FALSE_ALARM = 0.01
"""Probability that an exact twin fails a criterion."""
COMPLETENESS_LIMIT = 0.03
"""Allowed difference of the detected fraction."""
FRAME_LIMIT = 0.07
"""Allowed relative difference of the stars in a frame."""
NOISE_LIMIT = 0.01
"""Allowed relative difference of the noise of a frame."""
FALSE_LIMIT_SIGMA = two_sided_quantile(FALSE_ALARM)
MIN_STARS_IN_BIN = 30
MIN_WINDOWS = 30
"""Star windows, real and rendered each, for a classifier."""
CLASSIFIED_MAG = 1.0
"""Classified star windows: stars brighter than the limiting magnitude by this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameNumbers:
    """Solved frame, real and rendered."""

    name: str = col("Frame", shown=False)
    detections: int = col("Detections")
    identified: int = col("Identified")
    solution_time_s: float = col("Time", "s", ".2f")
    background_dn: float = col("Background", "DN", ".0f")
    stars: float = col("Stars at 5 sigma", "", ".0f")
    rendered_stars: Measured = col("Twin")
    stars_difference_percent: float = col("Difference", "percent", ".1f")
    noise_dn: float = col("Noise", "DN", ".3f")
    rendered_noise_dn: Measured = col("Twin's noise", "DN")
    noise_difference_percent: float = col("Difference", "percent", ".2f")
    photometric_scatter_mag: float = col("Scatter of photometry", "mag", ".3f")
    trail_detections: int = col("Detections on trails")


def frame_numbers(night: MeasuredNight, compared: HeldOut) -> list[FrameNumbers]:
    """Solved frames, real and rendered."""
    rows = []
    for number, row in enumerate(night.rows):
        solution = night.solutions[row]
        real = compared.real[number]
        stars, noise = (
            np.array([float(quantity(frames[number])) for frames in (compared.real, *compared.sets)])
            for quantity in (_star_count, _noise_dn)
        )
        rows.append(
            FrameNumbers(
                name=solution.name,
                detections=len(solution.detected.stars),
                identified=len(solution.identification.detected),
                solution_time_s=solution.seconds,
                background_dn=float(np.median(real.blocks.level_dn)),
                stars=stars[0],
                rendered_stars=_of_sets(stars[1:]),
                stars_difference_percent=100.0 * (stars[1:].mean() / max(stars[0], 1) - 1.0),
                noise_dn=noise[0],
                rendered_noise_dn=_of_sets(noise[1:]),
                noise_difference_percent=100.0 * (noise[1:].mean() / noise[0] - 1.0),
                photometric_scatter_mag=float(night.fit.photometry.scatter_mag[number]),
                trail_detections=real.trail_detections,
            )
        )
    return rows


def _star_count(frame: FrameStatistics) -> int:
    return int((frame.significance >= THRESHOLDS_SIGMA[0]).sum())


def _noise_dn(frame: FrameStatistics) -> float:
    return float(np.sqrt(np.nanmedian(frame.blocks.variance_dn2)))


def _of_sets(values: FloatArray, spread: float | None = None) -> Measured:
    """Mean of the rendered sets; ``spread``: standard deviation of a single set, by default from their scatter."""
    spread = float(values.std(ddof=1)) if spread is None else spread
    return measured(values.mean(), spread / np.sqrt(len(values)), len(values))


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedStatistic:
    """Statistic of real and of rendered frames."""

    key: str = col("Key", shown=False)
    label: str
    unit: str = col("Unit")
    real: Measured = col("Real", "{statistic}")
    twin: Measured = col("Twin", "{statistic}")
    difference: Measured = col("Difference")
    allowed: float | None = col("Allowed", "", ".3g")
    within_limit: str = col("Within", "")


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinCompleteness:
    """Completeness between two magnitudes."""

    magnitude_mag: float = col("G", "mag", ".2f")
    stars: int = col("Stars")
    real_5_sigma: Measured = col("Real, 5 sigma")
    twin_5_sigma: Measured = col("Twin, 5 sigma")
    real_6_sigma: Measured = col("Real, 6 sigma")
    twin_6_sigma: Measured = col("Twin, 6 sigma")


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionNumbers:
    """False detections in all frames, and separability of stars."""

    false_5_sigma: Measured = col("False detections at 5 sigma")
    false_twin_5_sigma: Measured = col("Twin's false detections at 5 sigma")
    false_6_sigma: Measured = col("False detections at 6 sigma")
    false_twin_6_sigma: Measured = col("Twin's false detections at 6 sigma")
    false_difference_sigma: float = col("Difference over its standard deviation, 5 sigma", "sigma", ".2f")
    trail_detections: int = col("Detections on trails, not counted")
    roc_area: Measured | None = col("Area under the ROC curve, real against rendered", default=None)
    strongest_feature: str = col("Feature with the largest difference", default="")


@dataclass(frozen=True, slots=True, kw_only=True)
class Feature:
    """Difference of real and rendered star windows in a feature."""

    name: str = col("Feature", shown=False)
    effect_sigma: float = col("Rendered minus real", "sigma", ".3f")


def compare_statistics(compared: HeldOut, limit_mag: float) -> list[ComparedStatistic]:
    """Statistics of the real frames and of the rendered sets."""
    sets = [statistics_of(frames, limit_mag, compared.airmass) for frames in (compared.real, *compared.sets)]
    rows = []
    for real, *rendered in zip(*sets, strict=True):
        values = np.array([statistic.value for statistic in rendered])
        spread = float(values.std(ddof=1))
        scale = real.value if real.relative and real.value else 1.0
        difference = (float(values.mean()) - real.value) / scale
        error = spread * np.sqrt(1.0 + 1.0 / len(values)) / abs(scale)
        judged = np.isfinite(real.limit) and np.isfinite(difference)
        rows.append(
            ComparedStatistic(
                key=real.key,
                label=real.label,
                unit=shown_unit(real.unit),
                real=measured(real.value, spread, unit=real.unit),
                twin=_of_sets(values),
                difference=measured(difference, error),
                allowed=float(real.limit),
                within_limit=("yes" if abs(difference) <= real.limit else "no") if judged else "",
            )
        )
    return rows


def completeness_bins(compared: HeldOut, limit_mag: float) -> list[TwinCompleteness]:
    """Detected fraction per half magnitude about the limit."""
    edges = np.arange(np.floor(2.0 * limit_mag) / 2.0 - 1.5, limit_mag + 1.01, 0.5)

    def of_sets(sigma: float) -> tuple[IntArray, FloatArray]:
        sets = [
            completeness(joined(frames, "magnitude"), joined(frames, "significance") >= sigma, edges)
            for frames in (compared.real, *compared.sets)
        ]
        return sets[0][0], np.array([fraction for _, fraction in sets])

    (count, fraction_5), (_, fraction_6) = (of_sets(sigma) for sigma in THRESHOLDS_SIGMA)
    rows = []
    for k in np.flatnonzero(count >= MIN_STARS_IN_BIN):
        # binomial standard deviation of a single set
        spread = [float(np.sqrt(p * (1.0 - p) / count[k])) for p in (fraction_5[:, k].mean(), fraction_6[:, k].mean())]
        real = measured([fraction_5[0, k], fraction_6[0, k]], spread, int(count[k]))
        rows.append(
            TwinCompleteness(
                magnitude_mag=float(edges[k] + 0.25),
                stars=int(count[k]),
                real_5_sigma=real[0],
                twin_5_sigma=_of_sets(fraction_5[1:, k], spread[0]),
                real_6_sigma=real[1],
                twin_6_sigma=_of_sets(fraction_6[1:, k], spread[1]),
            )
        )
    return rows


def star_separability(night: MeasuredNight, compared: HeldOut) -> Separability | None:
    """Separability of windows about the bright stars of real and rendered frames; None where there are too few."""
    faintest = night.prepared.limit_mag - CLASSIFIED_MAG
    images = [frame.image for frame in night.prepared.night.frames], compared.images
    features = [
        window_features(image.dn, frame.position_px[frame.star_magnitude < faintest])
        for frame_images, frames in zip(images, (compared.real, compared.sets[0]), strict=True)
        for image, frame in zip(frame_images, frames, strict=True)
    ]
    count, frames = [len(part) for part in features], len(compared.real)
    kind, frame = (np.repeat(numbers, count) for numbers in np.divmod(np.arange(2 * frames), frames))
    values = np.concatenate(features)
    good = np.isfinite(values).all(axis=1)
    if np.bincount(kind[good], minlength=2).min() < MIN_WINDOWS:
        return None
    return separability(values[good], kind[good], frame[good])


def detection_numbers(compared: HeldOut, roc: Separability | None) -> DetectionNumbers:
    """False detections of the real and of the rendered sets."""

    def false_detections(sigma: float) -> tuple[Measured, Measured]:
        real, *rendered = (
            (joined(frames, "false_significance") >= sigma).sum() for frames in (compared.real, *compared.sets)
        )
        mean = float(np.mean(rendered))
        return measured(real, np.sqrt(max(real, 1))), measured(mean, np.sqrt(max(mean, 0.5) / len(rendered)))

    (real_5, twin_5), (real_6, twin_6) = (false_detections(sigma) for sigma in THRESHOLDS_SIGMA)
    spread = np.hypot(real_5.uncertainty or 1.0, twin_5.uncertainty or 0.0)
    return DetectionNumbers(
        false_5_sigma=real_5,
        false_twin_5_sigma=twin_5,
        false_6_sigma=real_6,
        false_twin_6_sigma=twin_6,
        false_difference_sigma=float((twin_5.value - real_5.value) / spread),
        trail_detections=sum(frame.trail_detections for frame in compared.real),
        roc_area=None if roc is None else measured(roc.area, roc.error, roc.first),
        strongest_feature="" if roc is None else FEATURES[int(np.argmax(np.abs(roc.effect)))],
    )


def agreement_lines(statistics: Sequence[ComparedStatistic], detections: DetectionNumbers) -> list[str]:
    """Agreement of twin and camera for users of its frames: a line per judged statistic."""
    lines = []
    for statistic in statistics:
        if statistic.within_limit:
            real, rendered = (f"{value.value:.4g}" for value in (statistic.real, statistic.twin))
            unit = f" {statistic.real.unit}" if statistic.real.unit else ""
            suffix = "" if statistic.within_limit == "yes" else " (above the allowed difference)"
            lines.append(f"{statistic.label}: real {real}, rendered {rendered}{unit}{suffix}")
    if detections.roc_area is not None:
        area = detections.roc_area.value
        lines.append(f"star windows: area under the ROC curve of the classifier {area:.2f} (0.5: not separable)")
    return lines


def _error(quantity: Any) -> FloatArray:
    """Standard deviations; 0 where there are none."""
    return np.zeros(np.shape(quantity.values)) if quantity.error is None else np.nan_to_num(quantity.error)


def _criterion(name: str, value: float, limit: float, advice: str = "") -> Criterion:
    notices = limit if limit > 0 else None
    return Criterion(name=name, value=value, limit=limit, false_alarm=FALSE_ALARM, notices=notices, advice=advice)


def judge_statistics(outcome: Outcome) -> list[Criterion]:
    """Each difference within its limit and the noise of a single set."""
    criteria = []
    for k, label in enumerate(outcome.names("statistic")):
        difference, allowed = outcome.quantity("difference").at(statistic=k), float(outcome.values("allowed")[k])
        if not np.isfinite(allowed) or not np.isfinite(difference.values):
            continue
        limit = allowed + two_sided_quantile(FALSE_ALARM, outcome.config.realisations - 1) * float(_error(difference))
        advice = "see the table of causes and the features of the classifier"
        criteria.append(_criterion(f"twin against real: {label}", float(abs(difference.values)), limit, advice))
    return criteria


def judge_completeness(outcome: Outcome) -> list[Criterion]:
    """The largest difference of the completeness at each threshold."""
    criteria = []
    for sigma in ("5", "6"):
        real, twin = outcome.quantity(f"real_{sigma}_sigma"), outcome.quantity(f"twin_{sigma}_sigma")
        difference = np.abs(real.values - twin.values)
        error = np.hypot(_error(real), _error(twin))
        quantile = two_sided_quantile(FALSE_ALARM / len(difference))  # of the largest of all bins
        worst = int(np.argmax(difference - quantile * error))
        limit = COMPLETENESS_LIMIT + quantile * float(error[worst])
        name = f"completeness per half magnitude, {sigma} sigma: twin against real, the worst"
        criteria.append(_criterion(name, float(difference[worst]), limit))
    return criteria


def judge_frames(outcome: Outcome) -> list[Criterion]:
    """The largest difference of a frame in star count and in noise."""
    criteria = []
    sets = float(outcome.config.realisations)
    for name, field, base, allowed in (
        ("stars per frame", "stars_difference_percent", "stars", FRAME_LIMIT),
        ("noise of the background per frame", "noise_difference_percent", "noise_dn", NOISE_LIMIT),
    ):
        difference, level = np.abs(outcome.values(field)) / 100.0, outcome.values(base)
        rendered = outcome.quantity(f"rendered_{base}")
        # a few sets determine the scatter of a frame poorly: the relative scatter, as of counts, is pooled over frames
        relative = _error(rendered) * np.sqrt(sets + 1.0) / np.sqrt(level)
        error = np.sqrt(np.mean(relative**2) / level)
        quantile = two_sided_quantile(FALSE_ALARM / len(difference), len(difference) * (sets - 1.0))
        worst = int(np.argmax(difference - quantile * error))
        limit = allowed + quantile * float(error[worst])
        criteria.append(
            _criterion(f"{name}: twin against real, the worst of {len(difference)}", float(difference[worst]), limit)
        )
    return criteria
