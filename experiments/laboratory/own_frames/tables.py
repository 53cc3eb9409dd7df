"""The table of single points that several experiments show of frames from outside."""

from __future__ import annotations

import numpy as np

from experiments.harness.pivot import Pivot
from experiments.harness.quantities import Outcome, Quantities
from experiments.laboratory.own_frames.series import SeriesFrames

__all__ = ["add_points", "points_table"]


def add_points(q: Quantities, series: SeriesFrames, method: str) -> None:
    """Describe the points of a series: mean centroid and scatter of a frame."""
    mean = series.points.mean_px(method)
    q.axis("point", np.arange(len(mean)) + 1, "Point")
    for name, label, values in (("mean", "Mean", mean), ("sigma", "σ", series.points.sigma_px(method))):
        key = f"{name}_{{axis}}_px"
        q.add(f"{name}_px", values, label, unit="px", dims="point axis", format=".4f", key=key, json="")


def points_table(outcome: Outcome) -> Pivot:
    """Points of the last series."""
    last = outcome.result.reduced.series[-1].name
    return Pivot(
        rows="point",
        across="axis",
        columns="mean_px sigma_px",
        caption=f"Centroids of {last}, {outcome.names('method')[0]}; σ of a single frame.",
    )
