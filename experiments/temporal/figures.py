"""Figures of the temporal-error test."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.harness.plotting import INK, MARKERS, PALETTE, log_ticks, new_figure, scale_bar
from experiments.harness.quantities import Outcome
from experiments.laboratory import sketches
from experiments.laboratory.point_figures import centroid_cloud
from experiments.laboratory.temporal_error import small_sample_factor

__all__ = ["bench_sketch", "frame_cloud", "level_curves", "ratio_plot", "star_scatter", "target_frame"]


def bench_sketch(outcome: Outcome) -> Figure:
    """What ACC18 Fig. 1 shows, drawn anew: the bench."""
    return sketches.collimator_bench()


def level_curves(outcome: Outcome) -> Figure:
    """ACC18 Fig. 5: scatter against signal, both axes, every centroider; curves are predictions."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.52, sharey=True)
    c4, signal = small_sample_factor(outcome.result.measured.frames), outcome.values("level_signal_e")
    styles = list(zip(outcome.config.methods, PALETTE, MARKERS, strict=False))
    for panel, axis in zip(axes, "xy", strict=True):
        bound = outcome.values("level_bound_arcsec", axis=axis)
        panel.fill_between(signal, 1e-3, bound, color="#eef0f2", linewidth=0, zorder=0)
        panel.plot(signal, bound, color=INK, linewidth=1.0)
        for method, colour, marker in styles:
            panel.plot(
                signal, outcome.values("level_drawn_arcsec", method=method, axis=axis), color=colour, linewidth=1.1
            )
            found = outcome.values("level_dark_arcsec", method=method, axis=axis) / c4
            panel.plot(signal, found, marker, color=colour, markerfacecolor="white")
        if "published_arcsec" in outcome.data:
            published = float(outcome.values("published_arcsec", axis=axis))
            panel.axhline(published, color="#8a9099", linewidth=0.9, dashes=(5, 3))
            panel.text(signal[-1], published * 1.05, f"published {published}″", ha="right")
        panel.set(xscale="log", yscale="log", xlabel="signal [e⁻ per star and frame]", title=axis)
        panel.set_ylim(0.75 * min(bound), None)
        log_ticks(panel, "x")
        log_ticks(panel, "y")
        _magnitudes(outcome, panel)
    axes[0].set_ylabel("temporal error, 3 σ [″]")
    handles = [
        Line2D([], [], color=colour, marker=marker, markerfacecolor="white", label=outcome.label("method", method))
        for method, colour, marker in styles
    ]
    handles.append(Line2D([], [], color=INK, linewidth=1.0, label="Cramér-Rao bound"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _magnitudes(outcome: Outcome, panel: Axes) -> None:
    """A second axis above: V magnitude of the star that gives a signal."""
    signal_e, magnitude = float(outcome.value("signal_e")), float(outcome.value("signal_magnitude_mag"))
    low, high = panel.get_xlim()
    whole = np.arange(-10.0, 25.0)
    reached = signal_e * 10.0 ** (-0.4 * (whole - magnitude))
    shown = (reached >= low) & (reached <= high)
    top = panel.secondary_xaxis("top")
    top.set_xticks(reached[shown], [f"{one:g}" for one in whole[shown]])
    top.minorticks_off()
    top.set_xlabel(f"V of a star of {outcome.value('signal_star_k'):.0f} K [mag]")


def ratio_plot(outcome: Outcome) -> Figure:
    """Measured over predicted at every level."""
    methods = outcome.config.methods
    figure, axes = new_figure(1, 2, aspect_ratio=0.34, sharey=True)
    offsets = np.linspace(-0.04, 0.04, len(methods)) if len(methods) > 1 else np.zeros(1)
    for panel, axis in zip(axes, "xy", strict=True):
        panel.axhline(1.0, color=INK, linewidth=0.8)
        panel.axhspan(0.9, 1.1, color="#eef0f2", linewidth=0, zorder=0)
        for method, colour, marker, offset in zip(methods, PALETTE, MARKERS, offsets, strict=False):
            where = {"method": method, "axis": axis}
            panel.errorbar(
                outcome.values("level_signal_e") * np.exp(offset),
                outcome.values("level_ratio", **where),
                outcome.errors("level_ratio", **where),
                fmt=marker,
                color=colour,
                markerfacecolor="white",
                linewidth=0.9,
            )
        panel.set(xscale="log", xlabel="signal [e⁻]", title=axis)
        log_ticks(panel, "x")
    axes[0].set_ylabel("measured / predicted")
    return figure


def target_frame(outcome: Outcome) -> Figure:
    """Windows of one frame, laid out as the target."""
    result = outcome.result
    target = result.config.target
    stack = result.nominal.windows
    size = stack.dn.shape[2]
    light = (stack.dn[0].astype(float) - stack.offset_dn) / stack.gain_dn_per_e
    mosaic = light.reshape(target.rows, target.columns, size, size)
    gap = np.full((target.rows, target.columns, size + 1, size + 1), np.nan)
    gap[:, :, :size, :size] = mosaic
    image = gap.transpose(0, 2, 1, 3).reshape(target.rows * (size + 1), target.columns * (size + 1))[:-1, :-1]
    figure, axis = new_figure(width="half", aspect_ratio=1.0)
    axis.imshow(np.arcsinh(image / 60.0), vmin=-1.0, interpolation="nearest")
    axis.set(xticks=[], yticks=[])
    scale_bar(axis)
    axis.grid(visible=False)
    for side in axis.spines.values():
        side.set_visible(False)
    return figure


def frame_cloud(outcome: Outcome) -> Figure:
    """Centroids of all frames of all stars about their means, with the predicted 3 sigma ellipse."""
    result, first = outcome.result, outcome.config.methods[0]
    ellipses = {
        "predicted 3 σ": outcome.values("drawn_arcsec", method=first),
        "Cramér-Rao 3 σ": outcome.values("bound_arcsec"),
    }
    return centroid_cloud(result.nominal.position_px[first], result.instrument.pixel_arcsec, ellipses)


def star_scatter(outcome: Outcome) -> Figure:
    """Standard deviation of every star: measured with its uncertainty, and predicted."""
    result = outcome.result
    first = result.config.methods[0]
    sigma, expected = result.nominal.sigma_px["dark"][first][0], result.predicted_nominal.linear_px[first][0]
    c4 = small_sample_factor(result.nominal.frames)
    scale = 3.0 * result.instrument.pixel_arcsec
    number = np.arange(len(sigma)) + 1
    figure, axes = new_figure(2, 1, aspect_ratio=0.46, sharex=True)
    for axis, letter in enumerate("xy"):
        error = expected[:, axis] * np.sqrt(1.0 - c4**2) / c4
        axes[axis].errorbar(
            number, scale * sigma[:, axis] / c4, scale * error, fmt="o", color=PALETTE[0], linewidth=0.9
        )
        axes[axis].step(number, scale * expected[:, axis], where="mid", color=PALETTE[1])
        axes[axis].set_ylabel(f"{letter}, 3 σ [″]")
    axes[1].set_xlabel("star")
    axes[0].set_title("points: measured; line: predicted by the influence function")
    return figure
