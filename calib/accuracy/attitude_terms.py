"""Terms of an attitude error (ECSS-E-ST-60-20C): predicted, and separated in measured errors by switching their causes.

Attitudes are measured in segments, parts of an orbit short enough that stars cross pixels but not the field; every
frame is read out twice. Temporal noise differs between both readouts, pixel spatial error is common to both and varies
within a segment. Thermo-elastic error and aberration are differences from frames without the cause. What remains of the
means of the segments is bias (its mean) and field-of-view (FOV) spatial error (its variation). The part of the pixel
spatial error that is constant within a segment, where stars move by less than a pixel, counts as FOV spatial in
measurement and prediction alike; so does the change of pixel phase errors by the focus of a heated lens, which is
thermo-elastic as far as it is constant over the frames without the heat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm
from scipy.stats import t as student

from optics.arrays import FloatArray

TERMS = ("bias", "thermo_elastic", "fov_spatial", "pixel_spatial", "temporal_noise", "aberration")
DWELL_PX = 1.2
"""Distance over which pixel patterns and pixel phase change: a star is that wide."""
SMALL = 0.05
"""Fraction of the total below which a term is too small to be compared."""
CERTAIN = 4.0
"""Standard deviations by which a measured term exceeds that fraction to be compared all the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeErrors:
    """Predicted errors of an attitude at one time, about x, y and roll; NaN where there is none."""

    time_s: float
    available: bool
    stars: float  # Guide stars, times their probability to be fit
    noise_arcsec2: FloatArray  # (3,) Variance by temporal noise
    pixel_arcsec2: FloatArray  # (3,) Variance by pixel patterns
    fov_arcsec: FloatArray  # (3,) Error by colour and distortion
    spot_arcsec2: FloatArray  # (3,) Variance by pixel phase: of the fit, and of spots of other colours
    focus_arcsec2: FloatArray  # (3,) Variance by pixel phase of spots of the heated lens
    thermal_arcsec: FloatArray  # (3,) Error by the heated lens
    aberration_arcsec: FloatArray  # (3,) Error by the unknown part of the velocity

    @property
    def static_arcsec2(self) -> FloatArray:
        """Variance (3,) by everything that depends on the pixels and their phases."""
        return self.pixel_arcsec2 + self.spot_arcsec2 + self.focus_arcsec2

    @property
    def signed_arcsec(self) -> FloatArray:
        """Sum (3,) of the errors of known sign."""
        return self.fov_arcsec + self.thermal_arcsec + self.aberration_arcsec


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameCorrelation:
    """Correlation between frames of attitude errors by pixels."""

    patterns: FloatArray  # (n, n) By pixel patterns
    phases: FloatArray  # (3, n, n) By pixel phase, about x, y and roll


def frame_correlation(rate_px_per_s: ArrayLike, time_s: ArrayLike) -> FrameCorrelation:
    """Correlations while a camera turns at a rate (2,) about x and y, at times (n,).

    Errors by pixel phase have the period of a pixel, and all stars cross pixels alike: the attitude error oscillates
    as each star's does. A turn about x moves stars along y.
    """
    time = np.asarray(time_s, float)
    moved_px = np.asarray(rate_px_per_s, float)[:, None, None] * (time[:, None] - time)
    x, y = np.cos(2.0 * np.pi * moved_px)
    patterns = np.clip(1.0 - np.hypot(*moved_px) / DWELL_PX, 0.0, None)
    return FrameCorrelation(patterns=patterns, phases=np.stack([x, y, 0.5 * (x + y)]))


def mean_correlation(correlation: FloatArray) -> FloatArray:
    """Mean correlation (...) of two frames, of (..., n, n): fraction of the variance that stays within a segment."""
    count = correlation.shape[-1]
    return np.asarray((correlation.sum(axis=(-2, -1)) - count) / max(count * (count - 1), 1) + (count < 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class TermEstimate:
    """A measured term about one axis and its prediction, as mean squares over segments and axes."""

    predicted_arcsec2: float
    measured_arcsec2: float  # May be negative by its error
    error_arcsec2: float  # Standard deviation of the measured mean square, where the prediction is right
    samples: int
    least_arcsec2: float  # Below it a prediction is too small for a ratio
    slope: tuple[float, float]  # Of measured against predicted errors of the segments, and its error; NaN: random

    @property
    def comparable(self) -> bool:
        """Whether prediction or measurement are large enough for a ratio."""
        return max(self.predicted_arcsec2, self.measured_arcsec2 - CERTAIN * self.error_arcsec2) > self.least_arcsec2

    @property
    def root_arcsec(self) -> tuple[float, float]:
        """Root mean square, and its standard error."""
        root = math.sqrt(max(self.measured_arcsec2, 0.0))
        return root, self.error_arcsec2 / (2.0 * max(root, math.sqrt(0.5 * self.error_arcsec2), 1e-12))

    @property
    def ratio(self) -> tuple[float, float]:
        """Measured over predicted root mean square, and its standard error."""
        expected = max(self.predicted_arcsec2, self.least_arcsec2)
        ratio = math.sqrt(max(self.measured_arcsec2, 0.0) / expected)
        return ratio, self.error_arcsec2 / expected / (2.0 * max(ratio, 0.5))


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudePrediction:
    """Predicted errors of p segments."""

    errors: Sequence[AttitudeErrors]
    correlation: Sequence[FrameCorrelation]  # Of the frames of each segment
    bias_arcsec: FloatArray  # (3,) Constant error of the alignment
    switched: int  # So many first frames of a segment are repeated without a cause

    def squares(self, axes: Sequence[int]) -> dict[str, float]:
        """Mean squares [arcsec^2] of the terms about some axes, over the segments, and of their sum as ``total``."""
        pick = list(axes)

        def mean(values: Sequence[FloatArray]) -> float:
            return float(np.mean([value[pick] for value in values]))

        fov = np.array([error.fov_arcsec[pick] for error in self.errors])
        middle = fov.mean(axis=0)
        constant, focus = [], []
        for error, frames in zip(self.errors, self.correlation, strict=True):
            phases = mean_correlation(frames.phases)
            constant.append(error.pixel_arcsec2 * mean_correlation(frames.patterns) + error.spot_arcsec2 * phases)
            focus.append(error.focus_arcsec2 * phases)
        thermal = mean([error.thermal_arcsec**2 for error in self.errors])
        static = mean([error.static_arcsec2 for error in self.errors])
        noise = mean([error.noise_arcsec2 for error in self.errors])
        return {
            "bias": float(((self.bias_arcsec[pick] + middle) ** 2).mean()),
            "thermo_elastic": max(thermal + float(self._constant_focus(pick).mean()), 0.0),
            "fov_spatial": max(float(((fov - middle) ** 2).mean()) + mean(constant), 0.0),
            "pixel_spatial": max(static - mean(constant) - mean(focus), 0.0),
            "temporal_noise": noise,
            "aberration": mean([error.aberration_arcsec**2 for error in self.errors]),
            # errors of known sign add up as such in every segment, the others by their squares
            "total": mean([(self.bias_arcsec + error.signed_arcsec) ** 2 for error in self.errors]) + static + noise,
        }

    def _constant_focus(self, pick: list[int]) -> FloatArray:
        """Variances (p, axes) by the focus at pixel phases that stay in the frames without heat: thermo-elastic."""
        count = self.switched
        return np.array(
            [
                (mean_correlation(frames.phases[:, :count, :count]) * error.focus_arcsec2)[pick]
                for error, frames in zip(self.errors, self.correlation, strict=True)
            ]
        )

    def _pixel_error(self, solved: Sequence[NDArray[np.bool_]], pick: list[int]) -> float:
        """Standard deviation of the pixel spatial mean square: of products of two normal errors, correlated."""
        power, freedom = 0.0, 0
        for error, frames, rows in zip(self.errors, self.correlation, solved, strict=True):
            both, count = np.ix_(rows, rows), int(rows.sum())
            centred = np.eye(count) - 1.0 / count
            for axis in pick:
                phase = (error.spot_arcsec2 + error.focus_arcsec2)[axis] * frames.phases[axis][both]
                static = centred @ (error.pixel_arcsec2[axis] * frames.patterns[both] + phase) @ centred
                power += (static**2).sum() + ((static + error.noise_arcsec2[axis] * centred) ** 2).sum()
            freedom += len(pick) * (count - 1)
        return math.sqrt(power) / freedom

    def compare(
        self,
        axes: Sequence[int],
        *,
        error_arcsec: Sequence[FloatArray],
        thermal_arcsec: Sequence[FloatArray],
        aberration_arcsec: Sequence[FloatArray],
        false_alarm: float = 1e-3,
    ) -> dict[str, TermEstimate]:
        """Estimates of `TERMS` and ``total``: measured errors about some axes (0: x, 1: y, 2: roll), and prediction.

        ``error_arcsec``: p arrays (2, n, 3), errors of both readouts of n frames of every segment, NaN where there is
        no attitude; two frames of each are needed. ``thermal_arcsec``, ``aberration_arcsec``: p arrays (s, 3), changes
        of the error by switching the cause. Errors of slopes of few segments are wider by Student's distribution at
        ``false_alarm``.
        """
        pick, predicted = list(axes), self.squares(axes)
        signed = {
            name: np.array([getattr(error, f"{name}_arcsec")[pick] for error in self.errors])
            for name in ("thermal", "aberration", "fov")
        }
        solved = [np.asarray(np.isfinite(error).all(axis=(0, 2))) for error in error_arcsec]
        errors = [error[:, rows][:, :, pick] for error, rows in zip(error_arcsec, solved, strict=True)]
        thermal, thermal_error = _segment_means([change[:, pick] for change in thermal_arcsec])
        aberration, aberration_error = _segment_means([change[:, pick] for change in aberration_arcsec])
        noise, pixel, total, mean_error, count = _within_segments(errors)
        # means of the segments without what switching explains, and their scatter about the prediction
        rest = np.array([error.mean(axis=(0, 1)) for error in errors]) - thermal - aberration
        parts, segments, mean_error = len(pick), len(errors), mean_error + thermal_error
        scatter = float((rest - signed["fov"]).var(axis=0, ddof=1).mean())
        unknown, focus = max(scatter, mean_error), np.maximum(self._constant_focus(pick), 0.0)
        fov_power = 4.0 * predicted["fov_spatial"] * unknown + 2.0 * unknown**2
        bias, variance = rest.mean(axis=0), float(rest.var(axis=0, ddof=1).mean())
        # mean square of each term, and its standard deviation where the prediction is right
        estimates = {
            "bias": (
                float((bias**2).mean()) - scatter / segments,
                _square_error(np.full(parts, math.sqrt(predicted["bias"])), unknown / segments),
            ),
            "thermo_elastic": (
                float((thermal**2).mean()) - thermal_error,
                _square_error(signed["thermal"], thermal_error + focus),
            ),
            "fov_spatial": (
                variance * (1.0 - 1.0 / segments) - mean_error,
                math.sqrt(fov_power / (parts * (segments - 1))),
            ),
            "pixel_spatial": (pixel, self._pixel_error(solved, pick)),
            "temporal_noise": (noise, max(noise, predicted["temporal_noise"]) * math.sqrt(2.0 / count)),
            "aberration": (
                float((aberration**2).mean()) - aberration_error,
                _square_error(signed["aberration"], aberration_error),
            ),
        }
        estimates["total"] = total, math.sqrt(sum(error**2 for _, error in estimates.values()))
        slopes = {
            "thermo_elastic": slope_through_zero(signed["thermal"], thermal, false_alarm),
            "aberration": slope_through_zero(signed["aberration"], aberration, false_alarm),
            "fov_spatial": slope_through_zero(signed["fov"] - signed["fov"].mean(axis=0), rest - bias, false_alarm),
        }
        return {
            name: TermEstimate(
                predicted_arcsec2=predicted[name],
                measured_arcsec2=square,
                error_arcsec2=error,
                samples=count if name in ("temporal_noise", "pixel_spatial", "total") else parts * segments,
                least_arcsec2=SMALL**2 * predicted["total"],
                slope=slopes.get(name, (math.nan, math.nan)),
            )
            for name, (square, error) in estimates.items()
        }


def _within_segments(errors: Sequence[FloatArray]) -> tuple[float, float, float, float, int]:
    """Mean squares by noise, by pixels and in total, variance of the mean of a segment by both, and count of errors.

    Errors (2, n, axes) of both readouts: half of the mean square difference is noise; pixels are what varies alike.
    """
    counts = np.array([error.shape[1] for error in errors])
    noises = np.array([((first - second) ** 2).mean() / 2.0 for first, second in errors])
    products = [((a - a.mean(0)) * (b - b.mean(0))).sum() / a.shape[1] / (len(a) - 1) for a, b in errors]
    pixel = float(np.average(products, weights=counts - 1))
    total = float(np.average([(error**2).mean() for error in errors], weights=counts))
    mean_error = float(np.mean((0.5 * noises + max(pixel, 0.0)) / counts))
    return float(np.average(noises, weights=counts)), pixel, total, mean_error, errors[0].shape[2] * int(counts.sum())


def _square_error(signed: FloatArray, variance: FloatArray | float) -> float:
    """Standard deviation of the mean square of known errors (p, axes) with normal ones of a variance in addition."""
    return math.sqrt(float((4.0 * signed**2 * variance + 2.0 * np.square(variance)).sum())) / signed.size


def _segment_means(values: Sequence[FloatArray]) -> tuple[FloatArray, float]:
    """Means (p, axes) over the frames of each segment, and the variance of such a mean."""
    mean = np.array([np.nanmean(value, axis=0) for value in values])
    counts = np.array([np.isfinite(value[:, 0]).sum() for value in values])
    spread = [np.nanvar(value, axis=0, ddof=1).mean() / n for value, n in zip(values, counts, strict=True) if n > 1]
    return mean, float(np.mean(spread)) if spread else 0.0


def slope_through_zero(x: FloatArray, y: FloatArray, false_alarm: float = 1e-3) -> tuple[float, float]:
    """Slope of y against x, same shape, and its error, at this level that of Student's distribution; NaN if x is 0."""
    power = float((x**2).sum())
    if power <= 0.0:
        return math.nan, math.nan
    slope, freedom = float((y * x).sum()) / power, max(y.size - 1, 1)
    variance = float(((y - slope * x) ** 2).sum()) / freedom
    wider = float(student.isf(0.5 * false_alarm, freedom) / norm.isf(0.5 * false_alarm))
    return slope, wider * math.sqrt(variance / power)
