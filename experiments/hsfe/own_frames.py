"""High spatial frequency error of a laboratory's own frames (ACC18 eq. 3-12): every series is a position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.harness.drawings import cloud
from experiments.harness.sections import Section, below, col
from experiments.harness.summary import Measured
from experiments.laboratory.step_statistics import (
    PositionError,
    document_arcsec,
    position_error,
    step_residual_px,
)
from experiments.laboratory.temporal_error import scatter_interval
from experiments.reduce.folder import FrameFolder
from experiments.reduce.frames_toml import Layout
from experiments.reduce.pipeline import POINTS, POINTS_CAPTION, FramesTest, Reduced, points_of
from experiments.reduce.series import SeriesFrames, reduce_series
from optics.arrays import FloatArray
from optics.errors import DomainError

FEWEST_POSITIONS = 5
"""Positions below which the fit of the commands follows two that are exchanged."""
LEFT = 0.25
"""Two positions are exchanged where that lowers the squares to this part."""
INTERVAL = "interval_arcsec_3sigma[method][axis]"
SINGLE = "single_position_arcsec_3sigma[method][axis]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Steps:
    """High spatial frequency error (3 sigma) by method and axis."""

    hsfe_arcsec: Sequence[Sequence[Measured]] = col(
        "As printed", "arcsec", dims="method axis", json="hsfe_arcsec_3sigma"
    )
    low_arcsec: FloatArray = col("95 % from", "arcsec", dims="method axis", json=f"{INTERVAL}.low")
    high_arcsec: FloatArray = col("to", "arcsec", dims="method axis", json=f"{INTERVAL}.high")
    single_text: Sequence[Sequence[str]] = col(
        "Single position", "arcsec", "", "method axis", json=f"{SINGLE}.said", key="single_said"
    )
    single_estimate_arcsec: FloatArray = col("Estimate", "arcsec", ".4f", "method axis", json=f"{SINGLE}.estimate")
    single_low_arcsec: FloatArray = col("from", "arcsec", ".4f", "method axis", json=f"{SINGLE}.low")
    single_high_arcsec: FloatArray = col("to", "arcsec", ".4f", "method axis", json=f"{SINGLE}.high")
    single_upper_arcsec: FloatArray = col("at most", "arcsec", ".4f", "method axis", json=f"{SINGLE}.upper")
    single_degrees: FloatArray = col("Degrees of freedom", "", ".0f", "method axis", json="")
    residual_arcsec: FloatArray = col("Residual of a step", "arcsec", ".3f", "step point axis", json="")


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """Two interchanged positions."""

    said: Sequence[str]  # In words
    misplaced: int = col("Pairs of positions that are exchanged", json="")


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Shift of the whole image since the first position."""

    seen_px: FloatArray = col("Measured", "px", ".4f", "axis", json="common_shift_px", key="seen_{axis}_px")
    commanded_px: FloatArray = col("Commanded", "px", ".4f", "axis", json="", key="commanded_{axis}_px")


def interval_text(error: PositionError, axis: int, scale: float) -> str:
    """An estimate with its interval, or as consistent with zero."""
    low, high, upper = (float(one[axis]) * scale for one in (error.low_px, error.high_px, error.upper_px))
    value = float(error.value_px[axis]) * scale
    if not low > 0.0:
        return f"consistent with zero, upper limit {upper:.3f} at {error.level:.0%}"
    return f"{value:.3f} ({low:.3f} to {high:.3f} at {error.level:.0%})"


def steps(series: Sequence[SeriesFrames], methods: Sequence[str], scale: float) -> Steps:
    """As printed, and of one position (analysis of variance), in units of ``scale`` [arcsec/px]."""
    mean = {m: np.stack([one.points.mean_px(m) for one in series]) for m in methods}
    frames = np.array([one.frames for one in series])
    errors = [position_error(mean[m], np.stack([one.points.sigma_px(m) for one in series]), frames) for m in methods]
    printed = [document_arcsec(mean[m], scale / 3.0) for m in methods]
    value, error = (
        np.array([[getattr(one, part) or np.nan for one in pair] for pair in printed], float)
        for part in ("value", "uncertainty")
    )
    low, high = scatter_interval(value, error / value)
    return Steps(
        hsfe_arcsec=printed,
        low_arcsec=low,
        high_arcsec=high,
        single_text=[[interval_text(one, axis, scale) for axis in range(2)] for one in errors],
        single_estimate_arcsec=scale * np.array([one.value_px for one in errors]),
        single_low_arcsec=scale * np.array([one.low_px for one in errors]),
        single_high_arcsec=scale * np.array([np.where(one.low_px > 0, one.high_px, np.nan) for one in errors]),
        single_upper_arcsec=scale * np.array([one.upper_px for one in errors]),
        single_degrees=np.array([one.degrees for one in errors]),
        residual_arcsec=scale / 3.0 * step_residual_px(mean[methods[0]]),
    )


def misplaced(seen_px: FloatArray, commanded_px: FloatArray, names: Sequence[str]) -> list[str]:
    """The two of m positions (m, 2) that are exchanged, in words; scale and axes of the commands are fitted."""
    count = len(seen_px)
    if count < FEWEST_POSITIONS or not np.isfinite(commanded_px).all():
        return []

    def misfit(order: NDArray[np.int64]) -> float:
        terms = np.column_stack([np.ones(count), commanded_px[order]])
        return float(((seen_px - terms @ np.linalg.lstsq(terms, seen_px, rcond=None)[0]) ** 2).sum())

    tried = {}
    for one, other in combinations(range(count), 2):
        order = np.arange(count)
        order[[one, other]] = other, one
        tried[one, other] = misfit(order)
    best, before = min(tried, key=tried.__getitem__), misfit(np.arange(count))
    if tried[best] > LEFT * before:
        return []
    far = float(np.linalg.norm(commanded_px[best[0]] - commanded_px[best[1]]))
    return [
        f"{names[best[0]]} and {names[best[1]]} are interchanged: each lies at the commanded position of the "
        f"other, {far:.2g} px away"
    ]


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any = None) -> Reduced:
    """High spatial frequency error of a folder."""
    if len(folder.series) < 2:
        raise DomainError(f"{len(folder.series)} position; at least 2 [[series]] are needed")
    if len(folder.series[0].found_px) < 2:
        raise DomainError("1 target point; at least 2 are needed, because the mean over the points is removed")
    series = [reduce_series(folder, one, methods) for one in folder.series]
    mean = np.stack([one.points.mean_px(methods[0]) for one in series])
    missing = (float("nan"), float("nan"))
    seen, commanded = (mean - mean[0]).mean(1), np.array([one.settings.shift_px or missing for one in series])
    said = misplaced(seen, commanded, [one.name for one in series])
    return series, {
        "steps": steps(series, methods, 3.0 * folder.settings.pixel_arcsec),
        "positions": [Position(seen_px=one, commanded_px=other) for one, other in zip(seen, commanded, strict=True)],
        "order": Order(said=said, misplaced=len(said)) if np.isfinite(commanded).all() else None,
        **points_of(folder, series[-1], methods[0]),
    }


own_frames = FramesTest(
    title="High spatial frequency error",
    layout=Layout(),
    reduce=reduce,
    sections={
        "steps": Section(
            record=Steps,
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
            record=Position,
            dim="series",
            across="axis",
            columns="frames seen_px commanded_px",
            caption="Shift of the whole image since the first position, as measured and as commanded.",
        ),
        "order": Section(
            record=Order,
            verdicts=[
                below(
                    "misplaced",
                    0,
                    title="exchanged pairs of positions",
                    advice=lambda outcome: (
                        "; ".join(outcome.result["order"].said) + ": files or shift_px are in the wrong order"
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
