"""Figures of the step test."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.harness.plotting import INK, PALETTE, new_figure
from experiments.harness.quantities import Outcome
from experiments.hsfe.tables import axes_rms
from experiments.laboratory import point_figures
from experiments.laboratory.step_statistics import common_removed

__all__ = ["cause_bars", "error_tracks", "s_curves", "step_path", "step_residuals"]


def step_path(outcome: Outcome) -> Figure:
    """ACC18 Fig. 2: the path of one star over the pixels: commanded and gone."""
    result, measured = outcome.result, outcome.result.measured
    star = measured.photon_px.shape[1] // 2
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


def s_curves(outcome: Outcome) -> Figure:
    """Error of noiseless centroids across a pixel."""
    figure, axis = new_figure(width="half", aspect_ratio=1.0)
    axis.axhline(0.0, color="#8a9099", linewidth=0.8)
    curves = outcome.result.curves
    for method, colour in zip(outcome.config.methods, PALETTE, strict=False):
        axis.plot(curves.phase_px, curves.error_px[method], color=colour, label=outcome.label("method", method))
    axis.set(xlabel="place of the star in its pixel [px]", ylabel="centroid − truth [px]", xlim=(-0.5, 0.5))
    axis.legend(loc="best")
    return figure


def step_residuals(outcome: Outcome) -> Figure:
    """ACC18 Fig. 6: residuals of all stars and steps, and 3 sigma, the published one beside ours."""
    residual = outcome.values("residual_px") * outcome.result.instrument.pixel_arcsec
    here = outcome.values("document_arcsec", method=outcome.config.methods[0])
    ellipses = {"3 σ, here": here}
    if "published_arcsec" in outcome.data:
        ellipses["3 σ, published"] = outcome.values("published_arcsec")
    return point_figures.step_residuals(residual, ellipses)


def cause_bars(outcome: Outcome) -> Figure:
    """Every cause in every centroider: alone, switched off, predicted."""
    methods = outcome.config.methods
    figure, axes = new_figure(1, len(methods), aspect_ratio=0.36, sharey=True, squeeze=False)
    causes = [name.partition(" (")[0] for name in outcome.names("cause")]
    labels = [*causes, "temporal / √N", "quadrature", "together"]
    place = -np.arange(len(labels))
    for panel, method, colour in zip(axes[0], methods, PALETTE, strict=False):

        def size(name: str, *more: str, method: str = method) -> np.ndarray:
            rest = [axes_rms(outcome.values(f"{one}_arcsec", method=method)) for one in more]
            return np.array([*axes_rms(outcome.values(f"{name}_arcsec", method=method)), *rest])

        alone = size("alone", "temporal", "quadrature", "document")
        panel.barh(place, alone, height=0.62, color=colour, alpha=0.85)
        panel.plot(size("off"), place[: len(causes)], "|", color=INK, markersize=11, markeredgewidth=1.4)
        predicted = size("cause_predicted", "temporal_predicted", "predicted", "predicted")
        panel.plot(predicted, place, "o", color=INK, markerfacecolor="white", markersize=4.5)
        panel.set_yticks(place, labels)
        panel.grid(visible=False, axis="y")
        panel.set(title=outcome.label("method", method), xlabel="3 σ [″]")
        panel.set_xlim(0, None)
        panel.locator_params(axis="x", nbins=3)
    return figure


def error_tracks(outcome: Outcome) -> Figure:
    """Error of every star along the path: neighbouring positions err alike."""
    result, config = outcome.result, outcome.config
    methods = dict.fromkeys(m for m in (config.methods[0], "epsf") if m in config.methods)
    figure, axes = new_figure(1, len(methods), aspect_ratio=0.36, squeeze=False)
    way = np.arange(config.steps.positions) * config.steps.step_px
    for panel, method in zip(axes[0], methods, strict=True):
        error = common_removed(result.measured.mean_px["all"][method] - result.measured.photon_px)
        curve = common_removed(result.after.method[method].s_curve_px)
        panel.plot(way, error[..., 0], color="#c3c8ce", linewidth=0.8)
        for star, colour in zip(range(0, error.shape[1], max(1, error.shape[1] // 3)), PALETTE, strict=False):
            panel.plot(way, error[:, star, 0], "o", color=colour, markersize=3.5)
            panel.plot(way, curve[:, star, 0], color=colour, linewidth=1.0)
        panel.set(title=outcome.label("method", method), xlabel="commanded way along the path [px]")
    axes[0, 0].set_ylabel("error in x [px]")
    return figure
