"""Temporal error of a laboratory's own frames (ACC18 eq. 1-2): every series is a signal level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.pivot import Pivot
from experiments.harness.plotting import MARKERS, PALETTE, new_figure
from experiments.harness.quantities import Outcome, Quantities
from experiments.harness.summary import Measured
from experiments.laboratory.own_frames.experiment import FramesTest
from experiments.laboratory.own_frames.figures import POINTS, cloud
from experiments.laboratory.own_frames.folder import FrameFolder
from experiments.laboratory.own_frames.series import SeriesFrames, reduce_series
from experiments.laboratory.own_frames.settings import Layout
from experiments.laboratory.own_frames.tables import add_points, points_table
from experiments.laboratory.temporal_error import small_sample_factor, temporal_error_arcsec
from optics.arrays import FloatArray

__all__ = ["TemporalFrames", "own_frames", "reduce"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TemporalFrames:
    """Temporal error of l series."""

    pixel_arcsec: float  # Angle of a pixel
    series: tuple[SeriesFrames, ...]  # Levels

    def te_arcsec(self, method: str, level: int = 0) -> tuple[Measured, Measured]:
        """Temporal error of a series, x and y, 3 sigma."""
        one = self.series[level]
        return temporal_error_arcsec(one.points.sigma_px(method), self.pixel_arcsec, one.frames)

    def predicted_te_arcsec(self, method: str, level: int = 0) -> FloatArray:
        """The same from the noise model (2,), without the small-sample factor."""
        return np.asarray(3.0 * self.pixel_arcsec * self.series[level].predicted_px(method).mean(0))


def reduce(folder: FrameFolder, methods: Sequence[str], config: Any = None) -> TemporalFrames:
    """Temporal error of every series of a folder; errors as of `reduce_series`."""
    return TemporalFrames(
        pixel_arcsec=folder.settings.pixel_arcsec,
        series=tuple(reduce_series(folder, one, methods, every_model=True) for one in folder.series),
    )


def _describe(q: Quantities, reduced: TemporalFrames, methods: Sequence[str]) -> None:
    levels = range(len(reduced.series))
    found = [[reduced.te_arcsec(m, n) for m in methods] for n in levels]
    model = np.array([[reduced.predicted_te_arcsec(m, n) for m in methods] for n in levels])
    c4 = np.array([small_sample_factor(one.frames) for one in reduced.series])[:, None, None]
    value = np.array([[[one.value for one in pair] for pair in row] for row in found])
    angle = {"unit": "arcsec", "dims": "series method axis"}
    q.add("measured_arcsec", found, "Measured", **angle, json="temporal_error_arcsec_3sigma")
    q.add("noise_model_arcsec", model, "Noise model", **angle, format=".4f", json="noise_model_arcsec_3sigma")
    q.add("ratio", value / (c4 * model), "Ratio", dims="series method axis", format=".3f", json="")
    add_points(q, reduced.series[-1], methods[0])


def _headline(outcome: Outcome) -> Mapping[str, Any]:
    at = {"series": outcome.data["series"].values[-1], "method": outcome.result.methods[0]}
    return {f"Temporal error, {axis} (3 σ)": outcome.quantity("measured_arcsec", axis=axis, **at) for axis in "xy"}


def _tables(outcome: Outcome) -> Mapping[str, Pivot]:
    return {"temporal_error": _LEVELS, "points": points_table(outcome)}


_LEVELS = Pivot(
    rows="series method axis",
    columns="signal_e measured_arcsec noise_model_arcsec ratio",
    caption="Temporal error (ACC18 eq. 1-2, 3 σ) of every series, and what the stated noise of the camera gives.",
    note="Measured values carry the small-sample factor of a standard deviation; it is taken out of *Ratio*.",
)


def _levels(outcome: Outcome) -> Figure:
    """Scatter of every series beside the noise model; the centroiders stand side by side."""
    reduced, methods = outcome.result.reduced, outcome.result.methods
    figure, axes = new_figure(1, 2, aspect_ratio=0.42, sharey=True)
    number, spread = np.arange(len(reduced.series)) + 1.0, 0.6 / len(methods)
    c4 = np.array([small_sample_factor(one.frames) for one in reduced.series])
    for panel, axis in zip(axes, "xy", strict=True):
        for place, method in enumerate(methods):
            colour, marker, at = PALETTE[place], MARKERS[place], number + spread * place - 0.3 + spread / 2
            seen, error = (of("measured_arcsec", method=method, axis=axis) for of in (outcome.values, outcome.errors))
            model = c4 * outcome.values("noise_model_arcsec", method=method, axis=axis)
            label = outcome.label("method", method)
            panel.errorbar(at, seen, error, fmt=marker, color=colour, markerfacecolor="white", label=label)
            panel.hlines(model, at - 0.4 * spread, at + 0.4 * spread, color=colour, linewidth=0.9)
        panel.set_xticks(number, [f"{signal:.0f}" for signal in outcome.values("signal_e")])
        panel.set(xlabel="signal of the series [e⁻]", title=axis, xlim=(0.5, len(number) + 0.5))
    axes[0].set_ylabel("temporal error, 3 σ [″]")
    axes[1].legend()
    return figure


own_frames = FramesTest(
    title="Temporal error",
    layout=Layout(),
    reduce=reduce,
    describe=_describe,
    headline=_headline,
    tables=_tables,
    figures={
        "levels": (_levels, "Points: measured; dashes: the noise model for as many frames."),
        "cloud": (cloud, POINTS),
    },
    show=("temporal_error",),
)
