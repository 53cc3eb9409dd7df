"""The measured split of the attitude error, term by term, with the prediction for the same times.

Within a segment the stars cross several pixels, but no noticeable part of the field: temporal noise (differs between
the two readouts) and pixel spatial error (common to both) vary there; constant errors are of low frequency. Between
segments the sky changes. The part of the pixel spatial error that is constant within a segment, where stars move by
less than a pixel, counts as low-frequency in measurement and prediction alike; so does the change of pixel phase errors
by the focus of a heated lens, which is thermo-elastic as far as it is constant over the frames rendered cold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from experiments.flight.frames import Segment
from experiments.flight.prediction import TERMS, Budget, SegmentErrors
from experiments.harness.quantities import Outcome
from experiments.harness.sections import FALSE_ALARM, Verdict, agree, col, ratio_near
from experiments.harness.summary import Criterion, Measured
from optics.arrays import FloatArray

LABELS = {
    "bias": "Bias",
    "thermo_elastic": "Thermo-elastic error",
    "fov_spatial": "FOV spatial error",
    "pixel_spatial": "Pixel spatial error",
    "temporal_noise": "Temporal noise",
    "aberration": "Aberration of light, residual",
    "total": "Total",
}
COMPONENTS: tuple[tuple[str, tuple[int, ...]], ...] = (("across", (0, 1)), ("roll", (2,)))
DWELL_PX = 1.2
"""Distance over which pixel patterns and pixel phase change: a star is that wide."""
SMALL = 0.05
"""A term is not judged by its ratio where prediction and measurement are below this share of the total."""
CERTAIN = 4.0
"""Standard deviations by which a measurement is above it."""
FEWEST_SOLVED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """One term of the budget, root mean square over the flight, about one axis; roll apart."""

    measured_arcsec: Sequence[Measured] | None = col("Measured", "arcsec", dims="component", default=None)
    predicted_arcsec: FloatArray = col("Predicted", "arcsec", ".4g", "component")
    ratio: Sequence[Measured] | None = col("Measured / predicted", dims="component", default=None)
    # Slope of measured errors against predicted ones over the segments; NaN for random terms
    slope: Sequence[Measured] | None = col("Slope of measured against predicted", dims="component", default=None)
    term: str  # Its key in `LABELS`


def _known(verdict: Verdict, name: str, term: str, component: str) -> Verdict:
    """The verdict, where its number is known."""

    def judge(outcome: Outcome) -> list[Criterion]:
        if name not in outcome.data or term not in outcome.data["term"].values:
            return []
        value = float(outcome.values(name, term=term, component=component))
        return verdict(outcome) if math.isfinite(value) else []

    judge.names = verdict.names  # type: ignore[attr-defined]
    found: Verdict = judge  # type: ignore[assignment]
    return found


VERDICTS = [
    *(
        _known(
            ratio_near(
                "term_ratio",
                within=0.10 if term == "total" else 0.15,
                at={"term": term, "component": component},
                title="measured over predicted",
            ),
            *("term_ratio", term, component),
        )
        for term in (*TERMS, "total")
        for component, _ in COMPONENTS
    ),
    *(
        _known(
            agree(
                "term_slope",
                1.0,
                at={"term": term, "component": component},
                slack=0.15,
                title="slope of the measured errors against the predicted ones",
                advice="a wrong sign, unit or frame: the errors have the predicted size but the wrong direction",
            ),
            *("term_slope", term, component),
        )
        for term in ("thermo_elastic", "fov_spatial", "aberration")
        for component, _ in COMPONENTS
    ),
]


def correlations(budget: Budget, start_s: float, frames: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Correlation between frames (n, n) of errors by pixel patterns; (3, n, n) by pixel phase, about x, y and roll.

    Errors by pixel phase have the period of a pixel, and all stars cross pixels alike: the attitude error oscillates
    as each star's does. A turn about x moves stars along y.

    ``frames``: of this many of its first frames.
    """
    times = budget.flight.frame_times_s(start_s)[:frames]
    rate = np.asarray(budget.flight.trajectory.rate(start_s))[:2] / budget.pixel_rad
    moved = rate[:, None, None] * (times[:, None] - times)
    patterns = np.clip(1.0 - np.hypot(*moved) / DWELL_PX, 0.0, None)
    x, y = np.cos(2.0 * np.pi * moved)
    return patterns, np.stack([x, y, 0.5 * (x + y)])


def mean_correlation(correlation: FloatArray) -> FloatArray:
    """Mean correlation (...) of two frames, of (..., n, n): share of the variance that stays within a segment."""
    count = correlation.shape[-1]
    return np.asarray((correlation.sum(axis=(-2, -1)) - count) / max(count * (count - 1), 1) + (count < 2))


def predicted_squares(budget: Budget, errors: Sequence[SegmentErrors], axes: tuple[int, ...]) -> dict[str, float]:
    """Mean squares about one component over the times of some segments, and their sum as ``total`` [arcsec^2]."""
    pick = list(axes)

    def mean(values: Sequence[FloatArray]) -> float:
        return float(np.mean([np.asarray(one)[pick] for one in values]))

    fov = np.array([one.fov_arcsec[pick] for one in errors])
    middle = fov.mean(axis=0)
    bias = budget.bias_arcsec()[pick] + middle
    alike = [[mean_correlation(each) for each in correlations(budget, one.time_s)] for one in errors]
    stays = [one.pixel_arcsec2 * p + one.spot_arcsec2 * q for one, (p, q) in zip(errors, alike, strict=True)]
    focus = [one.focus_arcsec2 * q for one, (_, q) in zip(errors, alike, strict=True)]
    kept = _kept_focus(budget, errors, axes)
    found = {
        "bias": float((bias**2).mean()),
        "thermo_elastic": max(mean([one.thermal_arcsec**2 for one in errors]) + float(kept.mean()), 0.0),
        "fov_spatial": max(float(((fov - middle) ** 2).mean()) + mean(stays), 0.0),
        "pixel_spatial": max(mean([one.static_arcsec2 for one in errors]) - mean(stays) - mean(focus), 0.0),
        "temporal_noise": mean([one.noise_arcsec2 for one in errors]),
        "aberration": mean([one.aberration_arcsec**2 for one in errors]),
    }
    # errors that are known with their signs add up as such in every segment, the others by their squares
    signed = [budget.bias_arcsec() + one.fov_arcsec + one.thermal_arcsec + one.aberration_arcsec for one in errors]
    return {
        **found,
        "total": mean([one**2 for one in signed]) + mean([one.static_arcsec2 + one.noise_arcsec2 for one in errors]),
    }


def _kept_focus(budget: Budget, errors: Sequence[SegmentErrors], axes: tuple[int, ...]) -> FloatArray:
    """Variances (p, axes) by the focus at pixel phases that stay in the frames rendered cold too: thermo-elastic."""
    switched = budget.config.frames.switched
    stays = [mean_correlation(correlations(budget, one.time_s, switched)[1]) for one in errors]
    return np.array([(s * one.focus_arcsec2)[list(axes)] for s, one in zip(stays, errors, strict=True)])


def predicted_terms(budget: Budget, errors: Sequence[SegmentErrors]) -> list[Term]:
    """The prediction alone; nothing where the sensor has no attitude at any of the times."""
    seen = [one for one in errors if one.available]
    if not seen:
        return []
    squares = [predicted_squares(budget, seen, axes) for _, axes in COMPONENTS]
    return [Term(term=name, predicted_arcsec=np.sqrt([one[name] for one in squares])) for name in (*TERMS, "total")]


def measured_terms(budget: Budget, segments: Sequence[Segment], errors: Sequence[SegmentErrors]) -> list[Term]:
    """Measured and predicted terms, over the segments with both."""
    pairs = [
        (segment, error)
        for segment, error in zip(segments, errors, strict=True)
        if error.available and segment.solved.sum() >= FEWEST_SOLVED
    ]
    if len(pairs) < 2:
        return predicted_terms(budget, errors)
    seen, told = [one for one, _ in pairs], [one for _, one in pairs]
    columns = [_component(budget, seen, told, axes) for _, axes in COMPONENTS]
    return [
        Term(
            term=name,
            measured_arcsec=[column[name][0] for column in columns],
            predicted_arcsec=np.array([column[name][1] for column in columns]),
            ratio=[column[name][2] for column in columns],
            slope=[column[name][3] for column in columns],
        )
        for name in (*TERMS, "total")
    ]


Row = tuple[Measured, float, Measured, Measured]
UNKNOWN = Measured(value=math.nan, uncertainty=math.nan)


def _component(
    budget: Budget, segments: Sequence[Segment], told: Sequence[SegmentErrors], axes: tuple[int, ...]
) -> dict[str, Row]:
    pick, predicted = list(axes), predicted_squares(budget, told, axes)
    both = [one.error_arcsec[:, one.solved][:, :, pick] for one in segments]  # (2, n, axes) of every segment
    counts = np.array([one.shape[1] for one in both])
    parts = len(pick)
    # temporal noise: half of the mean square difference of the readouts
    each_noise = np.array([((one[0] - one[1]) ** 2).mean() / 2.0 for one in both])
    noise = float(np.average(each_noise, weights=counts))
    spread = {"temporal_noise": max(noise, predicted["temporal_noise"]) * math.sqrt(2.0 / (parts * counts.sum()))}
    # pixel spatial: what varies within a segment in both readouts alike
    products = np.array(
        [((one[0] - one[0].mean(0)) * (one[1] - one[1].mean(0))).sum() / parts / (one.shape[1] - 1) for one in both]
    )
    freedom = counts - 1
    pixel = float(np.average(products, weights=freedom))
    spread["pixel_spatial"] = _pixel_spread(budget, segments, told, pick)
    # low frequency: means of the segments, by switching
    middle = np.array([one.mean(axis=(0, 1)) for one in both])
    of_mean = float(np.mean((0.5 * each_noise + max(pixel, 0.0)) / counts))
    warm, warm_error = _switched([one.thermal_arcsec[:, pick] for one in segments])
    moving, moving_error = _switched([one.aberration_arcsec[:, pick] for one in segments])
    rest = middle - warm - moving
    bias, fov_told = rest.mean(axis=0), np.array([one.fov_arcsec[pick] for one in told])
    scatter = float((rest - fov_told).var(axis=0, ddof=1).mean())  # what the prediction does not tell, error by error
    square = {
        "temporal_noise": noise,
        "pixel_spatial": pixel,
        "thermo_elastic": float((warm**2).mean() - warm_error),
        "aberration": float((moving**2).mean() - moving_error),
        "bias": float((bias**2).mean() - scatter / len(segments)),
        "fov_spatial": float(rest.var(axis=0, ddof=1).mean() * (1.0 - 1.0 / len(segments)) - of_mean - warm_error),
    }
    free = parts * (len(segments) - 1)
    unknown = max(scatter, of_mean + warm_error)
    kept = np.maximum(_kept_focus(budget, told, axes), 0.0)
    spread["thermo_elastic"] = _square_spread(np.array([one.thermal_arcsec[pick] for one in told]), warm_error + kept)
    spread["aberration"] = _square_spread(np.array([one.aberration_arcsec[pick] for one in told]), moving_error)
    spread["bias"] = _square_spread(np.full(parts, math.sqrt(predicted["bias"])), unknown / len(segments))
    spread["fov_spatial"] = math.sqrt((4.0 * predicted["fov_spatial"] * unknown + 2.0 * unknown**2) / free)
    square["total"] = float(np.average([(one**2).mean() for one in both], weights=counts))
    spread["total"] = math.sqrt(sum(spread[name] ** 2 for name in TERMS))
    samples = {name: parts * len(segments) for name in (*TERMS, "total")}
    samples |= {name: parts * int(counts.sum()) for name in ("temporal_noise", "pixel_spatial", "total")}
    slopes = {
        "thermo_elastic": _slope(warm, np.array([one.thermal_arcsec[pick] for one in told])),
        "aberration": _slope(moving, np.array([one.aberration_arcsec[pick] for one in told])),
        "fov_spatial": _slope(rest - bias, fov_told - fov_told.mean(axis=0)),
    }
    rows: dict[str, Row] = {}
    for name in (*TERMS, "total"):
        least = SMALL**2 * predicted["total"]
        large = predicted[name] > least or square[name] > least + CERTAIN * spread[name]
        rows[name] = (
            _root(square[name], spread[name], samples[name]),
            math.sqrt(predicted[name]),
            _ratio(square[name], spread[name], max(predicted[name], least), samples[name]) if large else UNKNOWN,
            slopes.get(name, UNKNOWN) if large else UNKNOWN,
        )
    return rows


def _square_spread(known: FloatArray, variance: FloatArray | float) -> float:
    """Standard deviation of the mean square of known errors (p, axes) with normal ones of a variance in addition."""
    return math.sqrt(float((4.0 * known**2 * variance + 2.0 * np.square(variance)).sum())) / known.size


def _pixel_spread(budget: Budget, segments: Sequence[Segment], told: Sequence[SegmentErrors], pick: list[int]) -> float:
    """Standard deviation of the pixel spatial mean square: of products of two normal errors, correlated over frames."""
    power, freedom = 0.0, 0
    for segment, one in zip(segments, told, strict=True):
        patterns, phases = correlations(budget, segment.start_s)
        seen, count = np.ix_(segment.solved, segment.solved), int(segment.solved.sum())
        centred = np.eye(count) - 1.0 / count
        for axis in pick:
            phase = (one.spot_arcsec2 + one.focus_arcsec2)[axis] * phases[axis][seen]
            static = centred @ (one.pixel_arcsec2[axis] * patterns[seen] + phase) @ centred
            power += (static**2).sum() + ((static + one.noise_arcsec2[axis] * centred) ** 2).sum()
        freedom += len(pick) * (count - 1)
    return math.sqrt(power) / freedom


def _switched(values: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    """Means (p, axes) over the frames of each segment, and the variance of such a mean."""
    mean = np.array([np.nanmean(one, axis=0) for one in values])
    counts = np.array([np.isfinite(one[:, 0]).sum() for one in values])
    spread = [np.nanvar(one, axis=0, ddof=1).mean() / n for one, n in zip(values, counts, strict=True) if n > 1]
    return mean, float(np.mean(spread)) if spread else 0.0


def _root(square: float, spread: float, n: int) -> Measured:
    root = math.sqrt(max(square, 0.0))
    error = spread / (2.0 * max(root, math.sqrt(0.5 * spread), 1e-12))
    return Measured(value=root, unit="arcsec", uncertainty=error, n=n)


def _ratio(square: float, spread: float, expected: float, n: int) -> Measured:
    ratio, error = math.sqrt(max(square, 0.0) / expected), spread / expected
    return Measured(value=ratio, uncertainty=error / (2.0 * max(ratio, 0.5)), n=n)


def _slope(measured: FloatArray, predicted: FloatArray) -> Measured:
    power = float((predicted**2).sum())
    if power <= 0.0:
        return UNKNOWN
    slope, freedom = float((measured * predicted).sum()) / power, max(measured.size - 1, 1)
    left = float(((measured - slope * predicted) ** 2).sum()) / freedom
    # of few values: wider by Student's distribution at the level of a verdict
    few = float(student.isf(0.5 * FALSE_ALARM, freedom) / norm.isf(0.5 * FALSE_ALARM))
    return Measured(value=slope, uncertainty=few * math.sqrt(left / power), n=measured.size)
