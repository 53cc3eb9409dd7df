"""Figures of frames from outside."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.plotting import MARKERS, PALETTE, new_figure
from experiments.harness.quantities import Outcome
from experiments.laboratory import point_figures
from experiments.laboratory.step_statistics import step_residual_px
from experiments.laboratory.temporal_error import small_sample_factor

__all__ = ["cloud", "grid_residuals", "series_levels", "step_residuals"]


def cloud(outcome: Outcome) -> Figure:
    """Centroids of all frames of all points about their means, last series."""
    reduced, first = outcome.result.reduced, outcome.result.methods[0]
    return point_figures.centroid_cloud(reduced.series[-1].points.position_px[first], reduced.pixel_arcsec)


def step_residuals(outcome: Outcome) -> Figure:
    """Residuals of the steps."""
    reduced, first = outcome.result.reduced, outcome.result.methods[0]
    residual = step_residual_px(reduced.mean_px(first)) * reduced.pixel_arcsec
    return point_figures.step_residuals(residual, {"3 σ": outcome.values("hsfe_arcsec", method=first)})


def grid_residuals(outcome: Outcome) -> Figure:
    """Residuals before and after the polynomial as arrows over the detector."""
    reduced, folder = outcome.result.reduced, outcome.result.folder
    statistics = reduced.statistics(outcome.result.methods[0], reduced.references[-1])
    figure, axes = new_figure(1, 2, aspect_ratio=0.5, sharey=True)
    for panel, values, title in ((axes[0], statistics.d_px, "found"), (axes[1], statistics.left_px, "left")):
        error, reach = values * reduced.pixel_arcsec, 0.09 * folder.width_px
        longest = point_figures.arrows(
            panel, reduced.nominal_px, error, longest_px=reach, color=PALETTE[0], width=0.005
        )
        point_figures.detector_outline(panel, folder.width_px, folder.height_px)
        panel.set(xlabel="column [px]", title=f"{title}: longest {longest:.2f}″")
    axes[0].set_ylabel("row [px]")
    return figure


def series_levels(outcome: Outcome) -> Figure:
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
