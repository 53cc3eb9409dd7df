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


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendered:
    """Measurements from the rendered frames."""

    chart: ChartFrames  # Artificial stars
    moving: tuple[CameraPrediction, ChartFrames] | None  # The same of the camera that turns
    sky: SkyFrames  # Real sky
    example_e: NDArray[np.float32]  # (h, w) First frame of the sky, electrons above the dark
    example_px: FloatArray  # (n, 2) Where its stars were measured


UNFIT_SHARE = 0.05
"""Stars whose fit does not converge, or that look too sharp: relative uncertainty of their number."""
FEWEST_STARS = 8
"""Fewer are not always told from chance."""
MAG = 2.5 / math.log(10.0)
"""Magnitudes that stand for a relative error of the light."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """One quantity, measured in frames and predicted for the same stars and attitudes."""

    comparison: str = col("Quantity")
    label: str = col("Quantity")
    measured: float = col("Measured", format=".4g")
    predicted: float = col("Predicted", format=".4g")
    unit: str = col("Unit")
    error: float = col("Standard deviation", format=".2g")
    n: int = col("Samples")
    pull: Measured = col("Difference", "sigma", ".1f")
    # In standard deviations what an error of the whole would be
    whole: float = col("Predicted over its standard deviation", "sigma", shown=False)


def compared(comparison: str, label: str, unit: str, found: MeasuredAgainst, scale: float = 1.0) -> Compared:
    """A comparison with its difference in standard deviations; ``scale`` converts to the unit."""
    pull = whole = math.nan
    if found.error > 0:
        pull = (found.measured - found.predicted) / found.error
        whole = abs(MAG if unit == "mag" else found.predicted) / found.error
    return Compared(
        comparison=comparison,
        label=label,
        measured=scale * found.measured,
        predicted=scale * found.predicted,
        unit=unit,
        error=scale * found.error,
        n=found.n,
        pull=Measured(value=pull, unit="sigma", uncertainty=1.0),
        whole=whole,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Solved:
    """Frames of the sky, and their attitudes."""

    chart_stars: int = col("Chart stars")
    frames_unsolved: int = col(f"Frames with {FEWEST_STARS} stars or more that are not solved")
    # None where no frame was solved
    attitude_ratio: Measured | None = col("Attitude errors over predicted ones, RMS of three axes", default=None)
    rendered: Rendered


def solved_frames(prediction: CameraPrediction, rendered: Rendered) -> Solved:
    """Solution statistics of the frames of the sky."""
    error = rendered.sky.error_arcsec
    enough = prediction.attitude.stars[: len(error)] >= FEWEST_STARS
    known = np.isfinite(error).all(axis=1)
    ratio = None
    if known.any():
        sigma = prediction.attitude.total_arcsec[: len(error)][known]
        found = rms_against_sigma(error[known] / sigma, np.ones_like(sigma))
        ratio = Measured(value=found.measured, uncertainty=found.error, n=found.n)
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
        noise_of_chart(prediction, rendered.chart),
        *([] if rendered.moving is None else [noise_of_chart(*rendered.moving, key="nea_moving")]),
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
    """Light of the renderer, against lens area times throughput by another trace with other rays."""
    chart = rendered.chart
    bright = chart.magnitude == chart.bright_mag
    kelvin = prediction.config.star.temperature_k
    predicted = float(prediction.electrons(chart.magnitude[bright], kelvin, chart.radius_px[bright]).mean())
    measured = float(chart.electrons[bright].mean())
    # both are quadratures of the pupil: a part in a thousand is what they promise
    found = MeasuredAgainst(measured=measured, predicted=predicted, error=1e-3 * predicted, n=int(bright.sum()))
    return compared("electrons", f"Electrons of a star of {chart.bright_mag:.2f} mag", "e-", found)


def noise_of_chart(prediction: CameraPrediction, chart: ChartFrames, key: str = "nea") -> Compared:
    """Scatter of the bright stars over the readouts against the NEA."""
    rate = prediction.config.slew.rate_deg_per_s
    label = f"NEA of a star of {chart.bright_mag:.2f} mag" + (f" at {rate:.3g} °/s" if rate else "")
    found = centroid_scatter(*bright_stars(chart), prediction.stars, prediction.processing)
    return compared(key, label, "arcsec", found, prediction.state.pixel_arcsec)


def _limit(prediction: CameraPrediction, rendered: Rendered) -> Compared:
    """Limit of detection by the chart's faint stars."""
    chart = rendered.chart
    faint = chart.magnitude != chart.bright_mag
    detected = chart.found[:, faint].mean(axis=0)
    shift, error = limit_shift(detected, chart.electrons[faint], chart.radius_px[faint], prediction.stars)
    limit = prediction.value("limiting_magnitude_mag")
    found = MeasuredAgainst(
        measured=limit + shift, predicted=limit, error=error, n=int(detected.size * len(chart.found))
    )
    return compared("limiting_magnitude", "Limiting magnitude, half detected", "mag", found)


def _alarms(prediction: CameraPrediction, rendered: Rendered) -> Compared:
    counts = np.concatenate([rendered.chart.false_alarms, rendered.sky.false_alarms])
    expected = prediction.value("false_alarms_per_frame")
    found = false_alarms_against(counts, expected, prediction.config.dark_frames)
    return compared("false_alarms", f"False alarms in {len(counts)} frames", "", found)


def _stars(prediction: CameraPrediction, rendered: Rendered) -> Iterator[Compared]:
    forecast, frames = prediction.attitude, len(rendered.sky.found)
    variance = float(forecast.detected_variance[:frames].sum())
    for name, words, counts, expected, unfit in (
        ("stars", f"Stars detected in {frames} frames of the sky", rendered.sky.found, forecast.detected, 0.0),
        ("fit_stars", "Stars fit for an attitude", rendered.sky.fit, forecast.stars, UNFIT_SHARE),
    ):
        predicted = float(expected[:frames].sum())
        error = math.sqrt(variance + 1.0 + (unfit * predicted) ** 2)
        yield compared(
            name, words, "", MeasuredAgainst(measured=float(counts.sum()), predicted=predicted, error=error, n=frames)
        )


def _attitude(prediction: CameraPrediction, rendered: Rendered) -> Iterator[Compared]:
    """Root mean square of the errors, against that of the standard deviations predicted for the same attitudes."""
    error = rendered.sky.error_arcsec
    solved = np.isfinite(error).all(axis=1)
    sigma = prediction.attitude.total_arcsec[: len(error)][solved]
    for name, columns, words in (("cross", slice(0, 2), "across"), ("roll", slice(2, 3), "roll")):
        if solved.any():
            found = rms_against_sigma(error[solved][:, columns], sigma[:, columns])
            label = f"Attitude {words}, RMS of {int(solved.sum())} frames"
            yield compared(f"attitude_{name}", label, "arcsec", found)


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
    "limiting_magnitude": "fraction of chart stars detected against prediction",
    "false_alarms": "counted against predicted",
    "stars": "counted against predicted",
}
ADVICE = {"nea": "the centroider does not follow its linear response: too faint a star, too small a window"}
FRAMES = Section(
    record=Compared,
    dim="comparison",
    axes=_comparisons,
    table="frames",
    hidden="comparison",
    rows="comparison",
    columns="label measured predicted unit error n pull",
    caption="Rendered frames against the prediction for the same stars and attitudes.",
    note="Standard deviation: predicted, of measured minus predicted. Difference: in units of this standard deviation.",
    verdicts=[
        agree(
            "pull",
            0.0,
            at={"comparison": key},
            title=title,
            of="whole",
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
