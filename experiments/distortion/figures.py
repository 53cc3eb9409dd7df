"""Figures of the distortion test."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from experiments.distortion.evaluate import noise_removed_arcsec
from experiments.distortion.result import PUBLISHED_ARCSEC
from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure

if TYPE_CHECKING:
    from experiments.distortion.result import Result

__all__ = ["forecast_plot", "map_panels", "point_arrows", "survey_histogram"]


def _frame(result: Result, axis: Any) -> None:
    """Outline of the detector and its seams."""
    camera, chip = result.instrument.camera, result.instrument.detector
    axis.plot(
        [-0.5, camera.width_px - 0.5, camera.width_px - 0.5, -0.5, -0.5],
        [-0.5, -0.5, camera.height_px - 0.5, camera.height_px - 0.5, -0.5],
        color="#8a9099",
        linewidth=0.8,
    )
    for seam in range(1, chip.chips):
        axis.axvline(seam * (chip.chip_width_px + chip.gap_px) - 0.5, color="#c3c8ce", linewidth=0.8)
    axis.set(xlim=(-150, camera.width_px + 150), ylim=(camera.height_px + 150, -150), aspect="equal")
    axis.grid(visible=False)


def point_arrows(result: Result) -> Figure:
    """Residuals at the target's points: found, and left by the polynomial."""
    first, light = result.config.methods[0], result.measured.light
    figure, axes = new_figure(2, 2, aspect_ratio=0.68, sharex=True, sharey=True)
    panels = []
    for row, reference in enumerate(("aligned", "calibrated")):
        s = result.measured.statistics(first, reference)  # type: ignore[arg-type]
        panels += [
            (axes[row, 0], s.d_px, f"d, {reference}"),
            (axes[row, 1], s.left_px, f"left by the polynomial, {reference}"),
        ]
    for axis, values, title in panels:
        arcsec = values * result.instrument.pixel_arcsec
        length = float(np.sqrt((arcsec**2).sum(1).max()))
        scale = 300.0 / length
        axis.quiver(
            *light.nominal_px.T,
            *arcsec.T,
            angles="xy",
            scale_units="xy",
            scale=1 / scale,
            color=PALETTE[0],
            width=0.005,
        )
        _frame(result, axis)
        axis.set_title(f"{title}; longest {length:.2f}″")
    for axis in axes[:, 0]:
        axis.set_ylabel("row [px]")
    for axis in axes[1]:
        axis.set_xlabel("column [px]")
    return figure


def map_panels(result: Result) -> Figure:
    """ACC18 Fig. 8 on a dense grid: distortion, and what the correction leaves."""
    one = result.maps[result.config.reference].first
    figure, axes = new_figure(1, 2, aspect_ratio=0.36, sharey=True)
    rows, columns = one.shape
    step = max(1, rows // 8)
    for axis, values, title in (
        (axes[0], one.uncorrected_px, "distortion"),
        (axes[1], one.corrected_px, "left by the correction"),
    ):
        arcsec = values * result.instrument.pixel_arcsec
        size = np.linalg.norm(arcsec, axis=1).reshape(rows, columns)
        camera = result.instrument.camera
        image = axis.imshow(
            size,
            extent=(-0.5, camera.width_px - 0.5, camera.height_px - 0.5, -0.5),
            cmap="YlGnBu",
            vmin=0.0,
            interpolation="bilinear",
        )
        some = np.zeros((rows, columns), bool)
        some[::step, ::step] = True
        keep = some.ravel()
        axis.quiver(
            *one.nominal_px[keep].T,
            *arcsec[keep].T,
            angles="xy",
            scale_units="xy",
            scale=float(size.max()) / 420.0,
            color=INK,
            width=0.0028,
        )
        _frame(result, axis)
        axis.set(title=title, xlabel="column [px]")
        bar = figure.colorbar(image, ax=axis, orientation="horizontal", shrink=0.7, aspect=30)
        bar.set_label("length [″]")
        bar.outline.set_visible(False)
    axes[0].plot(*result.measured.light.nominal_px.T, "+", color=PALETTE[1], markersize=4)
    axes[0].set_ylabel("row [px]")
    return figure


def survey_histogram(result: Result) -> Figure:
    """sigma_C1 of many surveys of one target, the published values, and what marking error alone gives."""
    first, reference = result.config.methods[0], result.config.reference
    every = result.scale * result.measured.over_surveys(first, reference)[:, 2]
    figure, axis = new_figure(aspect_ratio=0.34)
    bins = np.linspace(0.0, max(1.15 * float(every.max()), 0.6), 40)
    for number, letter in enumerate("xy"):
        axis.hist(
            every[:, number],
            bins=bins.tolist(),
            color=PALETTE[number],
            alpha=0.55,
            label=f"{letter}, {len(every)} surveys",
        )
        axis.axvline(PUBLISHED_ARCSEC[number], color=PALETTE[number], linewidth=1.4, dashes=(4, 2))
        axis.annotate(
            f"published, {letter}",
            (PUBLISHED_ARCSEC[number], 0.97),
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            va="top",
        )
    axis.axvline(noise_removed_arcsec(result), color=INK, linewidth=1.2, label="marking error alone, RMS")
    axis.set(xlabel="σC1, 3 σ [″]", ylabel="surveys", xlim=(0, bins[-1]))
    axis.legend(loc="center right")
    return figure


def forecast_plot(result: Result) -> Figure:
    """Map error against the number of points, for several orders."""
    figure, axis = new_figure(aspect_ratio=0.42)
    orders = sorted({one.order for one in result.forecast})
    for order, colour, marker in zip(orders, PALETTE, MARKERS, strict=False):
        mine = [one for one in result.forecast if one.order == order]
        points = [one.points for one in mine]
        total = [float(np.sqrt(((result.scale * one.rms_px) ** 2).mean())) for one in mine]
        bias = [float(np.sqrt(((result.scale * one.bias_px) ** 2).mean())) for one in mine]
        axis.plot(points, total, color=colour, marker=marker, markerfacecolor="white", label=f"order {order}")
        axis.plot(points, bias, color=colour, linewidth=0.9, dashes=(1.5, 2))
    seen = np.sqrt((result.maps["aligned"].rms_px ** 2).mean())
    here = result.config.target.rows * result.config.target.columns
    axis.plot([here], [result.scale * seen], "*", color=INK, markersize=10, label="seen in this test")
    axis.set(xscale="log", yscale="log", xlabel="points of the grid", ylabel="map error, 3 σ [″]")
    ticks = sorted({one.points for one in result.forecast})
    axis.set_xticks(ticks, [str(t) for t in ticks])
    axis.set_xticks([], minor=True)
    low = min(0.02, 0.8 * float(result.scale * seen))
    axis.set_ylim(low, None)
    shown = [t for t in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5) if low <= t <= axis.get_ylim()[1]]
    axis.set_yticks(shown, [f"{t:g}" for t in shown])
    axis.set_yticks([], minor=True)
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
