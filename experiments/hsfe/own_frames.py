"""High spatial frequency error of a laboratory's own frames (ACC18 eq. 3-12): every series is a position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.summary import Measured
from experiments.laboratory import point_figures
from experiments.laboratory.own_frames.experiment import FramesTest
from experiments.laboratory.own_frames.figures import POINTS, cloud
from experiments.laboratory.own_frames.folder import FrameFolder
from experiments.laboratory.own_frames.series import SeriesFrames, reduce_series
from experiments.laboratory.own_frames.settings import Layout
from experiments.laboratory.own_frames.tables import add_points, points_table
from experiments.laboratory.step_statistics import (
    PositionError,
    document_rms_px,
    jackknife_px,
    position_error,
    step_residual_px,
)
from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = ["StepFrames", "own_frames", "reduce", "said"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StepFrames:
    """High spatial frequency error of m positions."""

    pixel_arcsec: float  # Angle of a pixel
    series: tuple[SeriesFrames, ...]  # Positions, in the order of the steps
    shift_px: FloatArray  # (m, 2) Commanded shift since the start; NaN where not stated

    def mean_px(self, method: str) -> FloatArray:
        """Mean centroids (m, j, 2)."""
        return np.stack([one.points.mean_px(method) for one in self.series])

    def document_arcsec(self, method: str) -> tuple[Measured, Measured]:
        """HSFE as printed, 3 sigma, x and y; uncertainty by the jackknife over the stars (none for two stars)."""
        mean, scale = self.mean_px(method), 3.0 * self.pixel_arcsec
        value, error = document_rms_px(mean), jackknife_px(mean)
        count = mean.shape[1] * (mean.shape[0] - 1)
        x, y = (
            Measured(
                value=float(value[a] * scale),
                unit="arcsec",
                uncertainty=float(error[a] * scale) if np.isfinite(error[a]) else None,
                n=count,
            )
            for a in range(2)
        )
        return x, y

    def position_error(self, method: str) -> PositionError:
        """Error of one position, temporal noise taken away (`experiments.laboratory.step_statistics`)."""
        sigma = np.stack([one.points.sigma_px(method) for one in self.series])
        return position_error(self.mean_px(method), sigma, np.array([one.frames for one in self.series]))

    def common_px(self, method: str) -> FloatArray:
        """Shift of the whole image since the first position (m, 2), as measured."""
        mean = self.mean_px(method)
        return np.asarray((mean - mean[0]).mean(1))


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any = None) -> StepFrames:
    """High spatial frequency error of a folder."""
    if len(folder.series) < 2:
        raise DomainError(f"frames of {len(folder.series)} position; at least 2 [[series]] are needed for steps")
    if len(folder.series[0].found_px) < 2:
        raise DomainError("1 target point; at least 2 are needed, the mean over them is taken away")
    missing = (float("nan"), float("nan"))
    return StepFrames(
        pixel_arcsec=folder.settings.pixel_arcsec,
        series=tuple(reduce_series(folder, one, methods) for one in folder.series),
        shift_px=np.array([one.settings.shift_px or missing for one in folder.series], float),
    )


def said(error: PositionError, axis: int, scale: float) -> str:
    """An estimate in words: with its interval, or as consistent with zero."""
    low, high, upper = (float(one[axis]) * scale for one in (error.low_px, error.high_px, error.upper_px))
    value = float(error.value_px[axis]) * scale
    if not low > 0.0:
        return f"consistent with zero, upper limit {upper:.3f} at {error.level:.0%}"
    return f"{value:.3f} ({low:.3f} to {high:.3f} at {error.level:.0%})"


def _describe(q: Quantities, reduced: StepFrames, methods: Sequence[str]) -> None:
    angle, scale = {"unit": "arcsec", "dims": "method axis"}, 3.0 * reduced.pixel_arcsec
    q.add(
        "hsfe_arcsec", [reduced.document_arcsec(m) for m in methods], "As printed", **angle, json="hsfe_arcsec_3sigma"
    )
    errors, place = [reduced.position_error(m) for m in methods], "single_position_arcsec_3sigma[method][axis]"
    for name, label, values in (
        ("estimate", "One position", [one.value_px for one in errors]),
        ("low", "from", [one.low_px for one in errors]),
        ("high", "to", [np.where(one.low_px > 0, one.high_px, np.nan) for one in errors]),
        ("upper", "at most", [one.upper_px for one in errors]),
    ):
        q.add(f"single_{name}_arcsec", scale * np.array(values), label, **angle, format=".4f", json=f"{place}.{name}")
    q.add(
        "single_degrees",
        [one.degrees for one in errors],
        "Degrees of freedom",
        dims="method axis",
        format=".0f",
        json="",
    )
    words = [[said(one, axis, scale) for axis in range(2)] for one in errors]
    q.add("single_said", words, "One position", unit="arcsec", dims="method axis", json=f"{place}.said")
    shift = {"unit": "px", "dims": "series axis", "format": ".4f"}
    q.add("seen_px", reduced.common_px(methods[0]), "Seen", **shift, key="seen_{axis}_px", json="common_shift_px")
    q.add("commanded_px", reduced.shift_px, "Commanded", **shift, key="commanded_{axis}_px", json="")
    add_points(q, reduced.series[-1], methods[0])


def _headline(outcome: Outcome) -> Mapping[str, Any]:
    first = outcome.result.methods[0]
    return {
        f"High spatial frequency error, {axis} (3 σ)": outcome.quantity("hsfe_arcsec", method=first, axis=axis)
        for axis in "xy"
    }


def _tables(outcome: Outcome) -> Mapping[str, Pivot]:
    steps = Pivot(
        rows="method axis",
        columns="hsfe_arcsec single_said",
        caption="High spatial frequency error (ACC18 eq. 3-12, 3 σ) from "
        f"{len(outcome.result.reduced.series)} positions.",
        note="*As printed*: RMS of differences of consecutive positions. *One position*: error of the mean centroid at "
        "a position about its mean over the path, temporal noise taken away, by an analysis of variance.",
    )
    return {"hsfe": steps, "positions": _POSITIONS, "points": points_table(outcome)}


_POSITIONS = Pivot(
    rows="series",
    across="axis",
    columns="frames seen_px commanded_px",
    caption="Shift of the whole image since the first position, as measured and as commanded.",
)


def _residuals(outcome: Outcome) -> Figure:
    """Residuals of the steps."""
    reduced, first = outcome.result.reduced, outcome.result.methods[0]
    residual = step_residual_px(reduced.mean_px(first)) * reduced.pixel_arcsec
    return point_figures.step_residuals(residual, {"3 σ": outcome.values("hsfe_arcsec", method=first)})


own_frames = FramesTest(
    title="High spatial frequency error",
    layout=Layout(),
    reduce=reduce,
    describe=_describe,
    headline=_headline,
    tables=_tables,
    figures={
        "residuals": (_residuals, "Differences of consecutive positions without their mean over the points."),
        "cloud": (cloud, POINTS),
    },
    show=("hsfe",),
    series="Position",
)
