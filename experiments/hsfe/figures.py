"""Figures of the step test."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure
from experiments.hsfe.evaluate import three_sigma
from experiments.hsfe.result import PUBLISHED_ARCSEC
from experiments.hsfe.tables import CAUSE_NAMES
from experiments.laboratory.high_frequency import CAUSES
from experiments.laboratory.point_settings import METHOD_NAMES
from experiments.laboratory.step_statistics import common_removed, step_residual_px

if TYPE_CHECKING:
    from experiments.hsfe.result import Result

__all__ = ["cause_bars", "error_tracks", "residual_cloud", "s_curve_plot", "step_path_plot"]


def step_path_plot(result: Result) -> Figure:
    """ACC18 Fig. 2: the path of one star over the pixels: commanded and gone."""
    measured, star = result.measured, result.measured.photon_px.shape[1] // 2
    gone, asked = measured.photon_px[:, star], result.before.place_px[:, star]
    origin = np.floor(asked.min(0) + 0.5)
    figure, axis = new_figure(width="half", aspect_ratio=1.0)
    axis.plot(
        *(asked - origin).T, "-", color=PALETTE[1], linewidth=1.0, marker="o", markersize=6, markerfacecolor="white"
    )
    axis.plot(*(gone - origin).T, "-", color=PALETTE[0], linewidth=1.0, marker="o")
    reach = np.concatenate([gone, asked]) - origin
    axis.set(
        xlim=(reach[:, 0].min() - 0.3, reach[:, 0].max() + 0.3), ylim=(reach[:, 1].max() + 0.3, reach[:, 1].min() - 0.3)
    )
    axis.grid(visible=False)
    for edge in np.arange(-3.5, 20.0):
        axis.axvline(edge, color="#c3c8ce", linewidth=0.8, zorder=0)
        axis.axhline(edge, color="#c3c8ce", linewidth=0.8, zorder=0)
    axis.set(aspect="equal", xlabel="column [px]", ylabel="row [px]")
    axis.legend(
        handles=[
            Line2D([], [], color=PALETTE[1], marker="o", markerfacecolor="white", label="commanded"),
            Line2D([], [], color=PALETTE[0], marker="o", label="gone"),
        ],
        loc="lower left",
    )
    return figure


def s_curve_plot(result: Result) -> Figure:
    """Error of noiseless centroids across a pixel."""
    figure, axis = new_figure(width="half", aspect_ratio=1.0)
    axis.axhline(0.0, color="#8a9099", linewidth=0.8)
    for method, colour in zip(result.config.methods, PALETTE, strict=False):
        axis.plot(result.curves.phase_px, result.curves.error_px[method], color=colour, label=METHOD_NAMES[method])
    axis.set(xlabel="place of the star in its pixel [px]", ylabel="centroid − truth [px]", xlim=(-0.5, 0.5))
    axis.legend(loc="best")
    return figure


def residual_cloud(result: Result) -> Figure:
    """ACC18 Fig. 6: residuals of all stars and steps, and the published 3 sigma beside ours."""
    first = result.config.methods[0]
    left = step_residual_px(result.measured.mean_px["all"][first]) * result.instrument.pixel_arcsec
    figure, axes = new_figure(1, 2, aspect_ratio=0.42, width_ratios=(1.7, 1.0))
    steps, stars = left.shape[:2]
    number = np.arange(steps * stars)
    for axis, colour, marker in zip(range(2), PALETTE, MARKERS, strict=False):
        axes[0].plot(number, left[..., axis].ravel(), marker, color=colour, markersize=2.2, label="xy"[axis])
    for edge in range(1, steps):
        axes[0].axvline(edge * stars - 0.5, color="#e3e5e8", linewidth=0.8)
    axes[0].set_xticks((np.arange(steps) + 0.5) * stars, [f"{k + 1}" for k in range(steps)])
    axes[0].grid(visible=False, axis="x")
    axes[0].set(xlabel="step", ylabel="residual [″]", xlim=(-1, steps * stars))
    axes[0].legend(loc="upper right", ncols=2)
    axes[1].plot(*left.reshape(-1, 2).T, ".", color="#8a9099", markersize=2.5)
    turn = np.linspace(0, 2 * np.pi, 181)
    ours = three_sigma(result, result.measured.document_px(first))
    for values, colour, label in ((ours, PALETTE[0], "3 σ, here"), (PUBLISHED_ARCSEC, INK, "3 σ, published")):
        axes[1].plot(values[0] * np.cos(turn), values[1] * np.sin(turn), color=colour, label=label)
    axes[1].set(xlabel="x [″]", ylabel="y [″]", aspect="equal")
    axes[1].legend(loc="upper center", bbox_to_anchor=(0.5, 1.16), ncols=2, columnspacing=1.0)
    return figure


def cause_bars(result: Result) -> Figure:
    """Every cause in every centroider: alone, switched off, predicted."""
    methods = result.config.methods
    figure, axes = new_figure(1, len(methods), aspect_ratio=0.36, sharey=True, squeeze=False)
    labels = [*(CAUSE_NAMES[c].partition(" (")[0] for c in CAUSES), "temporal / √N", "quadrature", "together"]
    for axis, method, colour in zip(axes[0], methods, PALETTE, strict=False):
        measured, model = result.measured, result.after.method[method]
        alone = [measured.cause_px(method, c) for c in CAUSES]
        off = [measured.cause_px(method, c, alone=False) for c in CAUSES]
        rest = (measured.temporal_px(method), measured.quadrature_px(method), measured.document_px(method))
        predicted = [*(model.cause_px[c] for c in CAUSES), model.temporal_px, model.document_px, model.document_px]
        place = -np.arange(len(labels))

        def size(values: list[np.ndarray]) -> np.ndarray:
            return np.sqrt((three_sigma(result, np.array(values)) ** 2).mean(1))

        axis.barh(place, size([*alone, *rest]), height=0.62, color=colour, alpha=0.85)
        axis.plot(size(off), place[: len(off)], "|", color=INK, markersize=11, markeredgewidth=1.4)
        axis.plot(size(predicted), place, "o", color=INK, markerfacecolor="white", markersize=4.5)
        axis.set_yticks(place, labels)
        axis.grid(visible=False, axis="y")
        axis.set(title=METHOD_NAMES[method], xlabel="3 σ [″]")
        axis.set_xlim(0, None)
        axis.locator_params(axis="x", nbins=3)
    return figure


def error_tracks(result: Result) -> Figure:
    """Error of every star along the path: neighbouring positions err alike."""
    methods = [m for m in (result.config.methods[0], "epsf") if m in result.config.methods]
    figure, axes = new_figure(1, len(methods), aspect_ratio=0.36, squeeze=False)
    way = np.arange(result.config.steps.positions) * result.config.steps.step_px
    for axis, method in zip(axes[0], dict.fromkeys(methods), strict=False):
        error = common_removed(result.measured.mean_px["all"][method] - result.measured.photon_px)
        curve = common_removed(result.after.method[method].s_curve_px)
        axis.plot(way, error[..., 0], color="#c3c8ce", linewidth=0.8)
        for star, colour in zip(range(0, error.shape[1], max(1, error.shape[1] // 3)), PALETTE, strict=False):
            axis.plot(way, error[:, star, 0], "o", color=colour, markersize=3.5)
            axis.plot(way, curve[:, star, 0], color=colour, linewidth=1.0)
        axis.set(title=METHOD_NAMES[method], xlabel="commanded way along the path [px]")
    axes[0, 0].set_ylabel("error in x [px]")
    return figure
