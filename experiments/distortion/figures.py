"""Figures of the distortion test."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.plotting import INK, MARKERS, PALETTE, log_ticks, new_figure
from experiments.harness.quantities import Outcome
from experiments.laboratory import sketches
from experiments.laboratory.point_figures import arrows, detector_outline

__all__ = ["forecasts", "grid_sketch", "map_panels", "point_residuals", "survey_histogram"]


def grid_sketch(outcome: Outcome) -> Figure:
    """What ACC18 Fig. 4 shows, drawn anew and to scale: the surveyed target on the detector."""
    return sketches.grid_on_detector(outcome.values("nominal_px"), outcome.result.instrument)


def point_residuals(outcome: Outcome) -> Figure:
    """Residuals at the target's points: found, and left by the polynomial."""
    result, camera = outcome.result, outcome.result.instrument.camera
    figure, axes = new_figure(2, 2, aspect_ratio=0.68, sharex=True, sharey=True)
    for row, reference in enumerate(("aligned", "calibrated")):
        s = result.measured.statistics(outcome.config.methods[0], reference)
        for panel, values, title in (
            (axes[row, 0], s.d_px, f"d, {reference}"),
            (axes[row, 1], s.left_px, f"left by the polynomial, {reference}"),
        ):
            error = values * result.instrument.pixel_arcsec
            place = outcome.values("nominal_px")
            longest = arrows(panel, place, error, longest_px=300.0, color=PALETTE[0], width=0.005)
            detector_outline(panel, camera.width_px, camera.height_px, result.instrument)
            panel.set_title(f"{title}; longest {longest:.2f}″")
    for panel in axes[:, 0]:
        panel.set_ylabel("row [px]")
    for panel in axes[1]:
        panel.set_xlabel("column [px]")
    return figure


def map_panels(outcome: Outcome) -> Figure:
    """ACC18 Fig. 8 on a dense grid: distortion, and what the correction leaves."""
    result, camera = outcome.result, outcome.result.instrument.camera
    one = result.maps[outcome.config.reference].first
    figure, axes = new_figure(1, 2, aspect_ratio=0.36, sharey=True)
    rows, columns = one.shape
    step = max(1, rows // 8)
    some = np.zeros((rows, columns), bool)
    some[::step, ::step] = True
    for panel, values, title in (
        (axes[0], one.uncorrected_px, "distortion"),
        (axes[1], one.corrected_px, "left by the correction"),
    ):
        error = values * result.instrument.pixel_arcsec
        size = np.linalg.norm(error, axis=1)
        image = panel.imshow(
            size.reshape(rows, columns),
            extent=(-0.5, camera.width_px - 0.5, camera.height_px - 0.5, -0.5),
            cmap="YlGnBu",
            vmin=0.0,
            interpolation="bilinear",
        )
        keep = some.ravel()
        reach = 420.0 * size[keep].max() / size.max()
        arrows(panel, one.nominal_px[keep], error[keep], longest_px=reach, color=INK, width=0.0028)
        detector_outline(panel, camera.width_px, camera.height_px, result.instrument)
        panel.set(title=title, xlabel="column [px]")
        bar = figure.colorbar(image, ax=panel, orientation="horizontal", shrink=0.7, aspect=30)
        bar.set_label("length [″]")
        bar.outline.set_visible(False)
    axes[0].plot(*outcome.values("nominal_px").T, "+", color=PALETTE[1], markersize=4)
    axes[0].set_ylabel("row [px]")
    return figure


def survey_histogram(outcome: Outcome) -> Figure:
    """sigma_C1 of many surveys of one target, the published values, and what marking error alone gives."""
    every = outcome.values("survey_c1_arcsec")
    figure, panel = new_figure(aspect_ratio=0.34)
    bins = np.linspace(0.0, max(1.15 * float(every.max()), 0.6), 40)
    known = "published_arcsec" in outcome.data
    for number, (values, axis, colour) in enumerate(zip(every.T, "xy", PALETTE, strict=False)):
        panel.hist(values, bins=bins.tolist(), color=colour, alpha=0.55, label=f"{axis}, {len(every)} surveys")
        if not known:
            continue
        published = float(outcome.values("published_arcsec")[number])
        panel.axvline(published, color=colour, linewidth=1.4, dashes=(4, 2))
        panel.annotate(
            f"published, {axis}",
            (published, 0.97),
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            va="top",
        )
    alone = float(outcome.values("noise_removed_arcsec"))
    panel.axvline(alone, color=INK, linewidth=1.2, label="marking error alone, RMS")
    panel.set(xlabel=outcome.heading("survey_c1_arcsec"), ylabel="surveys", xlim=(0, bins[-1]))
    panel.legend(loc="center right")
    return figure


def forecasts(outcome: Outcome) -> Figure:
    """Map error against the number of points, for several orders."""
    figure, panel = new_figure(aspect_ratio=0.42)
    points, orders = outcome.values("forecast_points"), outcome.values("forecast_order")
    for order, colour, marker in zip(np.unique(orders), PALETTE, MARKERS, strict=False):
        mine = orders == order
        total, bias = (outcome.values(f"{name}_arcsec")[mine] for name in ("map_error", "distortion_left"))
        panel.plot(points[mine], total, color=colour, marker=marker, markerfacecolor="white", label=f"order {order}")
        panel.plot(points[mine], bias, color=colour, linewidth=0.9, dashes=(1.5, 2))
    seen = float(np.sqrt((outcome.values("map_all_surveys_arcsec", reference="aligned") ** 2).mean()))
    panel.plot(outcome.values("points"), seen, "*", color=INK, markersize=10, label="seen in this test")
    panel.set(xscale="log", yscale="log", xlabel="points of the grid", ylabel="map error, 3 σ [″]")
    panel.set_ylim(min(0.02, 0.8 * seen), None)
    log_ticks(panel, "x", sorted(set(points.tolist())))
    log_ticks(panel, "y")
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
