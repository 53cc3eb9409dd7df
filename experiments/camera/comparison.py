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
from experiments.harness.plotting import new_figure
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.sections import Section, agree, below, col, ratio_near
from experiments.harness.summary import Measured
from experiments.laboratory.sensor_prediction import CameraPrediction
from optics.arrays import FloatArray
from optics.figures import draw_image


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartFrames:
    """n artificial stars in k readouts."""

    bright_mag: float  # Magnitude of the stars whose scatter is measured
    magnitude: FloatArray  # (n,)
    radius_px: FloatArray  # (n,) From the middle of the detector
    electrons: FloatArray  # (n,) On the detector, also beyond the stamps of diffraction images
    detected: NDArray[np.bool_]  # (k, n)
    error_px: FloatArray  # (k, n, 2) Centroid minus photocentre of the star; NaN: none
    false_alarms: NDArray[np.int64]  # (frames,) Detections without a star that are not flagged as too sharp


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyFrames:
    """m frames of the real sky; frame k has attitude k of the prediction."""

    detected: NDArray[np.int64]  # (m,) Stars
    fit: NDArray[np.int64]  # (m,) Detected stars that are fit for an attitude
    false_alarms: NDArray[np.int64]  # (m,) As of the chart
    error_arcsec: FloatArray  # (m, 3) Attitude minus truth about x, y (across) and z (roll); NaN: not solved


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendered:
    """Measurements from the rendered frames."""

    chart: ChartFrames
    slewing: tuple[CameraPrediction, ChartFrames] | None  # Chart during a slew, and its prediction
    sky: SkyFrames
    example_e: NDArray[np.float32]  # (h, w) First frame of the sky, electrons above the dark
    example_px: FloatArray  # (n, 2) Its centroids


UNFIT_FRACTION = 0.05
"""Relative uncertainty of the number of stars by fits that do not converge or are flagged as too sharp."""
FEWEST_STARS = 8
"""Stars from which an identification is certain."""
MAG = 2.5 / math.log(10.0)
"""Magnitudes per relative error of the light."""


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
    predicted_over_sigma: float = col(
        "Predicted over its standard deviation", "sigma", shown=False
    )  # Scale of a relative error


def compared(comparison: str, label: str, unit: str, sample: MeasuredAgainst, scale: float = 1.0) -> FrameComparison:
    """A comparison with its difference in standard deviations; ``scale`` converts to the unit."""
    deviation = predicted_over_sigma = math.nan
    if sample.error > 0:
        deviation = (sample.measured - sample.predicted) / sample.error
        predicted_over_sigma = abs(MAG if unit == "mag" else sample.predicted) / sample.error
    return FrameComparison(
        comparison=comparison,
        label=label,
        measured=scale * sample.measured,
        predicted=scale * sample.predicted,
        unit=unit,
        error=scale * sample.error,
        n=sample.n,
        deviation_sigma=Measured(value=deviation, unit="sigma", uncertainty=1.0),
        predicted_over_sigma=predicted_over_sigma,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SolvedFrames:
    """Frames of the sky, and their attitudes."""

    chart_stars: int = col("Chart stars")
    frames_unsolved: int = col(f"Frames with {FEWEST_STARS} stars or more that are not solved")
    # None: no frame solved
    attitude_ratio: Measured | None = col("Attitude errors over predicted ones, RMS of three axes", default=None)
    rendered: Rendered


def solved_frames(prediction: CameraPrediction, rendered: Rendered) -> SolvedFrames:
    """Solution statistics of the frames of the sky."""
    error = rendered.sky.error_arcsec
    enough = prediction.attitude.stars[: len(error)] >= FEWEST_STARS
    solved = np.isfinite(error).all(axis=1)
    ratio = None
    if solved.any():
        sigma = prediction.attitude.total_arcsec[: len(error)][solved]
        sample = rms_against_sigma(error[solved] / sigma, np.ones_like(sigma))
        ratio = Measured(value=sample.measured, uncertainty=sample.error, n=sample.n)
    return SolvedFrames(
        chart_stars=len(rendered.chart.magnitude),
        frames_unsolved=int(np.count_nonzero(enough & ~solved)),
        attitude_ratio=ratio,
        rendered=rendered,
    )


def compare(prediction: CameraPrediction, rendered: Rendered) -> list[FrameComparison]:
    """All comparisons of a run."""
    return [
        _electrons(prediction, rendered),
        noise_of_chart(prediction, rendered.chart),
        *([] if rendered.slewing is None else [noise_of_chart(*rendered.slewing, key="nea_moving")]),
        _limit(prediction, rendered),
        _alarms(prediction, rendered),
        *_stars(prediction, rendered),
        *_attitude(prediction, rendered),
    ]


def bright_stars(chart: ChartFrames) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Errors (k, n, 2) [px], electrons and radii (n,) [px] of the bright stars with a valid fit in all readouts."""
    good = (chart.magnitude == chart.bright_mag) & np.isfinite(chart.error_px).all(axis=(0, 2))
    return chart.error_px[:, good], chart.electrons[good], chart.radius_px[good]


def _electrons(prediction: CameraPrediction, rendered: Rendered) -> FrameComparison:
    """Electrons of the renderer, against aperture area times throughput from an independent trace."""
    chart = rendered.chart
    bright = chart.magnitude == chart.bright_mag
    kelvin = prediction.config.star.temperature_k
    predicted = float(prediction.electrons(chart.magnitude[bright], kelvin, chart.radius_px[bright]).mean())
    measured = float(chart.electrons[bright].mean())
    # both integrate over the pupil numerically, to 1e-3
    sample = MeasuredAgainst(measured=measured, predicted=predicted, error=1e-3 * predicted, n=int(bright.sum()))
    return compared("electrons", f"Electrons of a star of {chart.bright_mag:.2f} mag", "e-", sample)


def noise_of_chart(prediction: CameraPrediction, chart: ChartFrames, key: str = "nea") -> FrameComparison:
    """Scatter of the bright stars over the readouts against the NEA."""
    rate = prediction.config.slew.rate_deg_per_s
    label = f"NEA of a star of {chart.bright_mag:.2f} mag" + (f" at {rate:.3g} °/s" if rate else "")
    sample = centroid_scatter(*bright_stars(chart), prediction.stars, prediction.processing)
    return compared(key, label, "arcsec", sample, prediction.state.pixel_arcsec)


def _limit(prediction: CameraPrediction, rendered: Rendered) -> FrameComparison:
    """Limiting magnitude from the faint stars of the chart."""
    chart = rendered.chart
    faint = chart.magnitude != chart.bright_mag
    detected = chart.detected[:, faint].mean(axis=0)
    shift, error = limit_shift(detected, chart.electrons[faint], chart.radius_px[faint], prediction.stars)
    limit = prediction.value("limiting_magnitude_mag")
    sample = MeasuredAgainst(
        measured=limit + shift, predicted=limit, error=error, n=int(detected.size * len(chart.detected))
    )
    return compared("limiting_magnitude", "Limiting magnitude, half detected", "mag", sample)


def _alarms(prediction: CameraPrediction, rendered: Rendered) -> FrameComparison:
    counts = np.concatenate([rendered.chart.false_alarms, rendered.sky.false_alarms])
    expected = prediction.value("false_alarms_per_frame")
    sample = false_alarms_against(counts, expected, prediction.config.dark_frames)
    return compared("false_alarms", f"False alarms in {len(counts)} frames", "", sample)


def _stars(prediction: CameraPrediction, rendered: Rendered) -> Iterator[FrameComparison]:
    forecast, frames = prediction.attitude, len(rendered.sky.detected)
    variance = float(forecast.detected_variance[:frames].sum())
    for name, label, counts, expected, unfit in (
        ("stars", f"Stars detected in {frames} frames of the sky", rendered.sky.detected, forecast.detected, 0.0),
        ("fit_stars", "Stars fit for an attitude", rendered.sky.fit, forecast.stars, UNFIT_FRACTION),
    ):
        predicted = float(expected[:frames].sum())
        error = math.sqrt(variance + 1.0 + (unfit * predicted) ** 2)
        sample = MeasuredAgainst(measured=float(counts.sum()), predicted=predicted, error=error, n=frames)
        yield compared(name, label, "", sample)


def _attitude(prediction: CameraPrediction, rendered: Rendered) -> Iterator[FrameComparison]:
    """RMS of the errors against the RMS of the standard deviations predicted for the same attitudes."""
    error = rendered.sky.error_arcsec
    solved = np.isfinite(error).all(axis=1)
    sigma = prediction.attitude.total_arcsec[: len(error)][solved]
    for name, columns, direction in (("cross", slice(0, 2), "across"), ("roll", slice(2, 3), "roll")):
        if solved.any():
            sample = rms_against_sigma(error[solved][:, columns], sigma[:, columns])
            label = f"Attitude {direction}, RMS of {int(solved.sum())} frames"
            yield compared(f"attitude_{name}", label, "arcsec", sample)


def _comparisons(q: Quantities, compared: list[FrameComparison]) -> None:
    keys = np.array([row.comparison for row in compared], dtype=object)
    q.axis("comparison", keys, "Quantity", names=[row.label for row in compared])


def frames_drawn(outcome: Outcome) -> Figure:
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
    axes=_comparisons,
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
            of="predicted_over_sigma",
            advice=ADVICE.get(key, ""),
        )
        for key, title in JUDGED.items()
    ],
)
SOLVED = Section(
    record=SolvedFrames,
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
