"""High-spatial-frequency error (HSFE) of a laboratory's own frames (ACC18 eq. 3-12): every series is a position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.accuracy.high_frequency import (
    PositionError,
    exchanged_positions,
    high_frequency_error,
    position_error,
    step_residual_px,
)
from calib.accuracy.temporal import scatter_interval
from experiments.harness.drawings import cloud
from experiments.harness.sections import Section, below, col
from experiments.harness.summary import Measured, measured
from experiments.reduce.folder import FrameFolder
from experiments.reduce.frames_toml import FolderLayout
from experiments.reduce.pipeline import POINTS, POINTS_CAPTION, FramesTest, Reduced, tabulate_points
from experiments.reduce.series import SeriesFrames, reduce_series
from optics.arrays import FloatArray
from optics.errors import DomainError


@dataclass(frozen=True, slots=True, kw_only=True)
class PathErrors:
    """High spatial frequency error (3 sigma) by method and axis."""

    hsfe_arcsec: Sequence[Sequence[Measured]] = col("As printed", "arcsec", dims="method axis")
    low_arcsec: FloatArray = col("95 % from", "arcsec", dims="method axis")
    high_arcsec: FloatArray = col("to", "arcsec", dims="method axis")
    single_text: Sequence[Sequence[str]] = col("Single position", "arcsec", "", "method axis")
    single_estimate_arcsec: FloatArray = col("Estimate", "arcsec", ".4f", "method axis")
    single_low_arcsec: FloatArray = col("from", "arcsec", ".4f", "method axis")
    single_high_arcsec: FloatArray = col("to", "arcsec", ".4f", "method axis")
    single_upper_arcsec: FloatArray = col("at most", "arcsec", ".4f", "method axis")
    single_degrees_of_freedom: FloatArray = col("Degrees of freedom", "", ".0f", "method axis")
    residual_arcsec: FloatArray = col("Residual of a step", "arcsec", ".3f", "step point axis")


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionOrder:
    """Pairs of positions whose files are interchanged."""

    descriptions: Sequence[str]
    exchanged: int = col("Pairs of positions that are exchanged")


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesShift:
    """Shift of the whole image since the first position."""

    measured_px: FloatArray = col("Measured", "px", ".4f", "axis")
    commanded_px: FloatArray = col("Commanded", "px", ".4f", "axis")


def interval_text(error: PositionError, axis: int, scale: float) -> str:
    """An estimate with its interval, or as consistent with zero."""
    low, high, upper = (scale * float(bound[axis]) for bound in (error.low_px, error.high_px, error.upper_px))
    value = float(error.value_px[axis]) * scale
    if not low > 0.0:
        return f"consistent with zero, upper limit {upper:.3f} at {error.level:.0%}"
    return f"{value:.3f} ({low:.3f} to {high:.3f} at {error.level:.0%})"


def reduce_steps(series: Sequence[SeriesFrames], methods: Sequence[str], scale: float) -> PathErrors:
    """HSFE as printed, and error of a single position (analysis of variance); ``scale``: 3 sigma, [arcsec/px]."""
    frames = np.array([position.frames for position in series])
    mean_px = {method: np.stack([position.points.mean_px(method) for position in series]) for method in methods}
    sigma_px = {method: np.stack([position.points.sigma_px(method) for position in series]) for method in methods}
    errors = [position_error(mean_px[method], sigma_px[method], frames) for method in methods]
    terms = [high_frequency_error(mean_px[method], scale / 3.0) for method in methods]
    value = np.array([term.arcsec for term in terms])
    sigma = np.array([term.uncertainty_arcsec for term in terms])
    low, high = scatter_interval(value, sigma / value)
    return PathErrors(
        hsfe_arcsec=measured(value, sigma, n=terms[0].n, unit="arcsec"),
        low_arcsec=low,
        high_arcsec=high,
        single_text=[[interval_text(single, axis, scale) for axis in range(2)] for single in errors],
        single_estimate_arcsec=scale * np.array([single.value_px for single in errors]),
        single_low_arcsec=scale * np.array([single.low_px for single in errors]),
        single_high_arcsec=scale * np.array([np.where(single.low_px > 0, single.high_px, np.nan) for single in errors]),
        single_upper_arcsec=scale * np.array([single.upper_px for single in errors]),
        single_degrees_of_freedom=np.array([single.degrees for single in errors]),
        residual_arcsec=scale / 3.0 * step_residual_px(mean_px[methods[0]]),
    )


def exchange_text(pair: tuple[int, int], commanded_px: FloatArray, names: Sequence[str]) -> str:
    """Two exchanged positions in words."""
    first, second = pair
    distance = float(np.hypot(*(commanded_px[first] - commanded_px[second])))
    return (
        f"{names[first]} and {names[second]} are interchanged: each lies at the commanded position of the other, "
        f"{distance:.2g} px away"
    )


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any = None) -> Reduced:
    """High-spatial-frequency error (HSFE) of a folder."""
    if len(folder.series) < 2:
        raise DomainError(f"{len(folder.series)} position; at least 2 [[series]] are needed")
    if len(folder.series[0].detected_px) < 2:
        raise DomainError("1 target point; at least 2 are needed, because the mean over the points is removed")
    series = [reduce_series(folder, position, methods) for position in folder.series]
    mean_px = np.stack([position.points.mean_px(methods[0]) for position in series])
    shift_px = (mean_px - mean_px[0]).mean(1)
    unknown = (float("nan"), float("nan"))
    commanded_px = np.array([position.settings.shift_px or unknown for position in series])
    pair = exchanged_positions(shift_px, commanded_px)
    names = [position.name for position in series]
    descriptions = [] if pair is None else [exchange_text(pair, commanded_px, names)]
    return series, {
        "steps": reduce_steps(series, methods, 3.0 * folder.settings.pixel_arcsec),
        "positions": [
            SeriesShift(measured_px=measured_shift_px, commanded_px=commanded_shift_px)
            for measured_shift_px, commanded_shift_px in zip(shift_px, commanded_px, strict=True)
        ],
        "order": PositionOrder(descriptions=descriptions, exchanged=len(descriptions))
        if np.isfinite(commanded_px).all()
        else None,
        **tabulate_points(folder, series[-1], methods[0]),
    }


own_frames = FramesTest(
    title="High spatial frequency error",
    layout=FolderLayout(),
    reduce=reduce,
    sections={
        "steps": Section(
            record=PathErrors,
            table="hsfe",
            rows="method axis",
            columns="hsfe_arcsec low_arcsec high_arcsec single_text",
            caption="High spatial frequency error (ACC18 eq. 3-12, 3 σ).",
            note="*As printed*: RMS of differences of consecutive positions (ACC18), its interval from the "
            "scatter over the points. *Single position*: error of the mean centroid at a position about "
            "its mean over the path, temporal noise subtracted, by an analysis of variance.",
            figures={"residuals": cloud("residual_arcsec", ellipses="hsfe_arcsec", at={"method": 0})},
        ),
        "positions": Section(
            record=SeriesShift,
            dim="series",
            across="axis",
            columns="frames measured_px commanded_px",
            caption="Shift of the whole image since the first position, as measured and as commanded.",
        ),
        "order": Section(
            record=PositionOrder,
            verdicts=[
                below(
                    "exchanged",
                    0,
                    title="exchanged pairs of positions",
                    advice=lambda outcome: (
                        "; ".join(outcome.result["order"].descriptions) + ": files or shift_px are in the wrong order"
                    ),
                )
            ],
        ),
        **POINTS,
    },
    head={"High spatial frequency error (3 σ)": ("hsfe_arcsec", {"method": 0})},
    captions={
        "residuals": "Differences of consecutive positions without their mean over the points; 3 σ.",
        **POINTS_CAPTION,
    },
    series="Position",
)
