"""Rendered frames (`experiments.camera.frames`) against the prediction for the same stars and attitudes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calib.accuracy.frame_check import (
    MeasuredAgainst,
    centroid_scatter,
    false_alarms_against,
    limit_shift,
    rms_against_sigma,
)
from calib.photometry.zero_point import POGSON
from experiments.harness.plotting import new_figure
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import Section, agree, below, col, ratio_near
from experiments.harness.summary import Measured
from experiments.laboratory.sensor_prediction import CameraPrediction
from optics.arrays import FloatArray
from optics.figures import draw_image


@dataclass(frozen=True, slots=True, kw_only=True)
class StarGridFrames:
    """n artificial stars on a jittered grid, read out k times."""

    bright_mag: float  # Magnitude of the stars whose scatter is measured
    magnitude: FloatArray  # (n,)
    radius_px: FloatArray  # (n,) Distance from the detector's centre
    electrons: FloatArray  # (n,) Expected on the detector, light beyond the stamps of diffraction images included
    detected: NDArray[np.bool_]  # (k, n)
    error_px: FloatArray  # (k, n, 2) Centroid minus photocentre of the star; NaN: not detected, or centroid not usable
    false_alarms: NDArray[np.int64]  # (frames,) Detections without a star that are not flagged as too sharp


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyFrames:
    """m frames of the real sky; frame k has attitude k of the prediction."""

    detected: NDArray[np.int64]  # (m,) Number of detected stars
    usable: NDArray[np.int64]  # (m,) Number of detected stars whose centroid is usable for an attitude
    false_alarms: NDArray[np.int64]  # (m,) Detections without a star that are not flagged as too sharp
    error_arcsec: FloatArray  # (m, 3) Attitude minus truth about x, y (cross-boresight) and z (roll); NaN: not solved


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendered:
    """Measurements from the rendered frames."""

    star_grid: StarGridFrames
    slewing: tuple[CameraPrediction, StarGridFrames] | None  # Prediction and frames of the star grid during a slew
    sky: SkyFrames
    example_e: NDArray[np.float32]  # (h, w) First frame of the sky, electrons above the mean dark frame
    example_px: FloatArray  # (n, 2) Centroids in the first frame of the sky


UNUSABLE_FRACTION = 0.05
"""Relative uncertainty of the number of usable stars: centroid fits that fail or are flagged as too sharp."""
COUNT_FLOOR = 1.0
"""Least variance of a predicted number of stars: one count, for certain detections of variance 0."""
MIN_SOLVABLE_STARS = 8
"""Frames with this number of predicted stars are required to be solved."""
PUPIL_QUADRATURE = 1e-3
"""Relative error of electrons by two independent integrations over the pupil."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameComparison:
    """A quantity measured in frames, and predicted for the same stars and attitudes."""

    comparison: str = col("Quantity")
    label: str = col("Quantity")
    measured: float = col("Measured", format=".4g")
    predicted: float = col("Predicted", format=".4g")
    unit: str = col("Unit")
    error: float = col("Standard deviation", format=".2g")
    n: int = col("Samples")
    deviation_sigma: Measured = col("Difference", "sigma", ".1f")
    # Change by a relative error of 100 %: the predicted value; of a magnitude, Pogson's factor 2.5 / ln 10
    relative_error_scale_sigma: float = col("Relative error of 100 %", "sigma", shown=False)


def compare_sample(
    comparison: str, label: str, unit: str, sample: MeasuredAgainst, scale: float = 1.0
) -> FrameComparison:
    """A comparison with its difference in standard deviations; ``scale`` converts to the unit."""
    deviation = math.nan
    relative_error_scale = math.nan
    if sample.error > 0:
        deviation = (sample.measured - sample.predicted) / sample.error
        relative_error_scale = abs(POGSON if unit == "mag" else sample.predicted) / sample.error
    return FrameComparison(
        comparison=comparison,
        label=label,
        measured=scale * sample.measured,
        predicted=scale * sample.predicted,
        unit=unit,
        error=scale * sample.error,
        n=sample.n,
        deviation_sigma=Measured(value=deviation, unit="sigma", uncertainty=1.0),
        relative_error_scale_sigma=relative_error_scale,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SolvedFrames:
    """Frames of the sky, and their attitudes."""

    chart_stars: int = col("Artificial stars")
    frames_unsolved: int = col(f"Frames with {MIN_SOLVABLE_STARS} stars or more that are not solved")
    # RMS of error / predicted sigma over frames and axes; None: no frame solved
    attitude_ratio: Measured | None = col("Attitude errors over predicted ones, RMS of three axes", default=None)
    rendered: Rendered


def solved_frames(prediction: CameraPrediction, rendered: Rendered) -> SolvedFrames:
    """Solution statistics of the frames of the sky."""
    error = rendered.sky.error_arcsec
    solvable = prediction.attitude.stars[: len(error)] >= MIN_SOLVABLE_STARS
    solved = np.isfinite(error).all(axis=1)
    ratio = None
    if solved.any():
        sigma = prediction.attitude.total_arcsec[: len(error)][solved]
        sample = rms_against_sigma(error[solved] / sigma, np.ones_like(sigma))
        ratio = Measured(value=sample.measured, uncertainty=sample.error, n=sample.n)
    return SolvedFrames(
        chart_stars=len(rendered.star_grid.magnitude),
        frames_unsolved=int(np.count_nonzero(solvable & ~solved)),
        attitude_ratio=ratio,
        rendered=rendered,
    )


def compare(prediction: CameraPrediction, rendered: Rendered) -> list[FrameComparison]:
    """All comparisons of a run."""
    return [
        _compare_electrons(prediction, rendered),
        compare_noise(prediction, rendered.star_grid),
        *([] if rendered.slewing is None else [compare_noise(*rendered.slewing, key="nea_moving")]),
        _compare_limiting_magnitude(prediction, rendered),
        _compare_false_alarms(prediction, rendered),
        *_compare_star_counts(prediction, rendered),
        *_compare_attitudes(prediction, rendered),
    ]


def bright_stars(grid: StarGridFrames) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors (k, n, 2) [px], electrons and radii (n,) [px] of the bright stars, if usable in all readouts."""
    usable = (grid.magnitude == grid.bright_mag) & np.isfinite(grid.error_px).all(axis=(0, 2))
    return grid.error_px[:, usable], grid.electrons[usable], grid.radius_px[usable]


def _compare_electrons(prediction: CameraPrediction, rendered: Rendered) -> FrameComparison:
    """Electrons of the renderer, against aperture area times throughput from an independent trace."""
    grid = rendered.star_grid
    bright = grid.magnitude == grid.bright_mag
    temperature_k = prediction.config.star.temperature_k
    predicted = float(prediction.electrons(grid.magnitude[bright], temperature_k, grid.radius_px[bright]).mean())
    measured = float(grid.electrons[bright].mean())
    error = PUPIL_QUADRATURE * predicted
    sample = MeasuredAgainst(measured=measured, predicted=predicted, error=error, n=int(bright.sum()))
    return compare_sample("electrons", f"Electrons of a star of {grid.bright_mag:.2f} mag", "e-", sample)


def compare_noise(prediction: CameraPrediction, grid: StarGridFrames, key: str = "nea") -> FrameComparison:
    """Scatter of the bright stars over the readouts against the NEA."""
    rate = prediction.config.slew.rate_deg_per_s
    label = f"NEA of a star of {grid.bright_mag:.2f} mag" + (f" at {rate:.3g} °/s" if rate else "")
    sample = centroid_scatter(*bright_stars(grid), prediction.stars, prediction.processing)
    return compare_sample(key, label, "arcsec", sample, prediction.state.pixel_arcsec)


def _compare_limiting_magnitude(prediction: CameraPrediction, rendered: Rendered) -> FrameComparison:
    """Limiting magnitude from the faint stars of the grid."""
    grid = rendered.star_grid
    faint = grid.magnitude != grid.bright_mag
    detected = grid.detected[:, faint].mean(axis=0)
    shift, error = limit_shift(detected, grid.electrons[faint], grid.radius_px[faint], prediction.stars)
    limit = prediction.value("limiting_magnitude_mag")
    sample = MeasuredAgainst(
        measured=limit + shift, predicted=limit, error=error, n=int(detected.size * len(grid.detected))
    )
    return compare_sample("limiting_magnitude", "Limiting magnitude, half detected", "mag", sample)


def _compare_false_alarms(prediction: CameraPrediction, rendered: Rendered) -> FrameComparison:
    """Detections without a star in all frames, star grid and sky."""
    counts = np.concatenate([rendered.star_grid.false_alarms, rendered.sky.false_alarms])
    expected = prediction.value("false_alarms_per_frame")
    sample = false_alarms_against(counts, expected, prediction.config.dark_frames)
    return compare_sample("false_alarms", f"False alarms in {len(counts)} frames", "", sample)


def _compare_star_counts(prediction: CameraPrediction, rendered: Rendered) -> Iterator[FrameComparison]:
    """Detected and usable stars, summed over the frames; the detections are independent Bernoulli trials."""
    forecast = prediction.attitude
    frames = len(rendered.sky.detected)
    variance = float(forecast.detected_variance[:frames].sum())
    for name, label, counts, expected, unusable in (
        ("stars", f"Stars detected in {frames} frames of the sky", rendered.sky.detected, forecast.detected, 0.0),
        ("usable_stars", "Stars usable for an attitude", rendered.sky.usable, forecast.stars, UNUSABLE_FRACTION),
    ):
        predicted = float(expected[:frames].sum())
        error = math.sqrt(variance + COUNT_FLOOR + (unusable * predicted) ** 2)
        sample = MeasuredAgainst(measured=float(counts.sum()), predicted=predicted, error=error, n=frames)
        yield compare_sample(name, label, "", sample)


def _compare_attitudes(prediction: CameraPrediction, rendered: Rendered) -> Iterator[FrameComparison]:
    """RMS of the errors against the RMS of the standard deviations predicted for the same attitudes."""
    error = rendered.sky.error_arcsec
    solved = np.isfinite(error).all(axis=1)
    sigma = prediction.attitude.total_arcsec[: len(error)][solved]
    for name, columns, direction in (("cross", slice(0, 2), "across"), ("roll", slice(2, 3), "roll")):
        if solved.any():
            sample = rms_against_sigma(error[solved][:, columns], sigma[:, columns])
            label = f"Attitude {direction}, RMS of {int(solved.sum())} frames"
            yield compare_sample(f"attitude_{name}", label, "arcsec", sample)


def _comparison_axis(q: Quantities, comparisons: list[FrameComparison]) -> None:
    keys = np.array([row.comparison for row in comparisons], dtype=object)
    q.axis("comparison", keys, "Quantity", names=[row.label for row in comparisons])


def draw_sky_frame(outcome: Outcome) -> Figure:
    """The first frame of the sky, with its detections."""
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
    "limiting_magnitude": "fraction of chart stars detected against prediction",
    "false_alarms": "counted against predicted",
    "stars": "counted against predicted",
}
ADVICE = {"nea": "the centroider does not follow its linear response: too faint a star, too small a window"}
FRAMES = Section(
    record=FrameComparison,
    dim="comparison",
    axes=_comparison_axis,
    hidden="comparison",
    rows="comparison",
    columns="label measured predicted unit error n deviation_sigma",
    caption="Rendered frames against the prediction for the same stars and attitudes.",
    note="Standard deviation: predicted, of measured minus predicted. Difference: in units of this standard deviation.",
    verdicts=[
        agree(
            "deviation_sigma",
            0.0,
            at={"comparison": key},
            title=title,
            of="relative_error_scale_sigma",
            advice=ADVICE.get(key, ""),
        )
        for key, title in JUDGED.items()
    ],
)
SOLVED = Section(
    record=SolvedFrames,
    figures={"frame": draw_sky_frame},
    verdicts=[
        ratio_near(
            "attitude_ratio",
            within=0.05,
            title="attitudes across and roll: errors of solved frames over predicted ones, RMS",
            advice="centroids are worse than predicted, or the camera model of the solver is not that of the lens",
        ),
        below("frames_unsolved", 0.0, title=f"frames of the sky with {MIN_SOLVABLE_STARS} stars or more, not solved"),
    ],
)
