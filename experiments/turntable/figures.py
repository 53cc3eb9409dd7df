"""Figures of the turntable calibration."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from experiments.harness.plotting import INK, MARKERS, PALETTE, log_ticks, new_figure, scale_bar
from experiments.harness.quantities import Outcome
from experiments.laboratory.single_star.sketch import bench_sketch
from experiments.turntable.quantities import UNKNOWNS
from experiments.turntable.result import Result

__all__ = [
    "bench",
    "correlations",
    "error_maps",
    "field_curves",
    "lean_curves",
    "pull_bars",
    "reading_curves",
    "residual_arrows",
    "star_windows",
    "visited_places",
]


_FAINT = "#c3c8ce"


def _detector(axis: Any, result: Result) -> None:
    """Outline of the detector and the seams between its chips."""
    width, height = result.instrument.camera.width_px, result.instrument.camera.height_px
    left, right, upper, lower = -0.5, width - 0.5, -0.5, height - 0.5
    axis.plot([left, right, right, left, left], [upper, upper, lower, lower, upper], color="#8a9099", linewidth=0.8)
    for seam in range(1, result.instrument.detector.chips):
        column = seam * width / result.instrument.detector.chips - 0.5
        axis.plot([column, column], [upper, lower], color="#d6dade", linewidth=0.7, zorder=0)
    axis.grid(visible=False)
    pad = 0.03 * max(width, height)
    axis.set(xlim=(left - pad, right + pad), ylim=(lower + pad, upper - pad), aspect="equal")
    axis.set(xticks=range(0, width + 1, max(512, width // 4)), yticks=range(0, height + 1, max(512, height // 2)))


def bench(outcome: Outcome) -> Figure:
    """The bench seen from the side."""
    return bench_sketch(outcome.config.two_axis.axes)


def visited_places(outcome: Outcome) -> Figure:
    """Where the image went, in the order it went, on both tables."""
    result = outcome.result
    figure, axes = new_figure(1, len(result.cases), aspect_ratio=0.33, sharey=True, squeeze=False)
    for axis, case in zip(axes[0], result.cases, strict=True):
        place, angle = case.measurement.bundle_px, np.degrees(case.measurement.visits.true_rad)
        axis.plot(*place.T, color=_FAINT, linewidth=0.7, zorder=1)
        if angle.shape[1] == 3:
            rolls = np.round(angle[:, 2]).astype(int)
            for roll, colour in zip(np.unique(rolls), PALETTE, strict=False):
                axis.plot(*place[rolls == roll].T, "o", markersize=3, color=colour, label=f"{roll}°")
            axis.legend(
                loc="lower right",
                bbox_to_anchor=(1.02, 0.98),
                ncols=4,
                fontsize=7,
                handletextpad=0.1,
                columnspacing=0.8,
            )
        else:
            axis.plot(*place.T, "o", markersize=3, color=PALETTE[0])
        spans = "   ".join(
            f"{name} {_degrees(low)} … {_degrees(high)}"
            for name, low, high in zip(case.measurement.bench.table.axis_names, angle.min(0), angle.max(0), strict=True)
        )
        _detector(axis, result)
        axis.set_title(f"{case.name} table")
        axis.set_xlabel(f"column [px]\n{spans}", fontsize=7.5)
    axes[0, 0].set_ylabel("row [px]")
    return figure


def _degrees(value: float) -> str:
    return f"{round(value, 1) + 0.0:.1f}°".replace("-", "−")


def star_windows(outcome: Outcome) -> Figure:
    """One frame of the window at nine places of the field."""
    result = outcome.result
    measurement = result.cases[0].measurement
    stack, place = measurement.readings.windows, measurement.bundle_px
    camera = result.instrument.camera
    targets = [(x * camera.width_px, y * camera.height_px) for y in (0.02, 0.5, 0.98) for x in (0.02, 0.5, 0.98)]
    chosen = [int(np.argmin(np.hypot(*(place - target).T))) for target in targets]
    figure, axes = new_figure(3, 3, width="half", aspect_ratio=1.0)
    size = stack.dn.shape[-1]
    for axis, at in zip(axes.ravel(), chosen, strict=True):
        electrons = (stack.dn[0, at].astype(float) - stack.offset_dn) / stack.gain_dn_per_e
        column, row = (int(v) for v in stack.corner_px[at])
        extent = (column - 0.5, column + size - 0.5, row + size - 0.5, row - 0.5)
        axis.imshow(np.where(stack.defect[at], np.nan, electrons), extent=extent, vmin=-40)
        axis.plot(*place[at], "+", color="white", markersize=7, markeredgewidth=0.9)
        axis.set(xticks=[], yticks=[])
        scale_bar(axis)
        axis.grid(visible=False)
        axis.set_title(f"{place[at, 0]:.0f}, {place[at, 1]:.0f}", fontsize=7, pad=3)
    return figure


def residual_arrows(outcome: Outcome) -> Figure:
    """Residuals of the fit on the two-axis table, the axes taken as square and their angle estimated."""
    result = outcome.result
    case = result.cases[0]
    panels = (("ignored", "axes taken as square"), ("estimated", "non-orthogonality estimated"))
    figure, axes = new_figure(1, len(panels), aspect_ratio=0.33, sharey=True)
    place = case.measurement.bundle_px
    residuals = [case.reductions[name].residual_px for name, _ in panels]
    longest = max(float(np.linalg.norm(r, axis=1).max()) for r in residuals)
    spacing = place[:, 0].max() / max(result.config.grid.columns, 2)
    scale = 0.9 * spacing / longest
    key = float(f"{longest / 2:.0e}")
    for axis, (name, title), residual in zip(axes, panels, residuals, strict=True):
        _detector(axis, result)
        axis.quiver(
            *place.T,
            *residual.T,
            angles="xy",
            scale_units="xy",
            scale=1 / scale,
            color=PALETTE[name != "ignored"],
            width=0.003,
            headwidth=4,
        )
        chi2 = float(outcome.values("reduced_chi2", table="two_axis", reduction=name))
        axis.set_title(f"{title}, χ²/dof = {chi2:.2f}")
        axis.set_xlabel("column [px]")
    axis = axes[0]
    width = result.instrument.camera.width_px
    axis.quiver(
        0.02 * width, -0.028 * width, key, 0, angles="xy", scale_units="xy", scale=1 / scale, color=INK, width=0.003
    )
    axis.text(0.03 * width + key * scale, -0.028 * width, f"{key:g} px", fontsize=7.5, va="center")
    for one in axes:
        low, high = one.get_ylim()
        one.set_ylim(low, high - 0.03 * width)
    axes[0].set_ylabel("row [px]")
    return figure


def error_maps(outcome: Outcome) -> Figure:
    """Line-of-sight error after the best rotation, and its predicted standard deviation, on one scale."""
    result = outcome.result
    cases = result.cases
    figure, axes = new_figure(len(cases), 2, aspect_ratio=0.31 * len(cases), sharex=True, sharey=True, squeeze=False)
    for row, case in zip(axes, cases, strict=True):
        line = case.reductions["estimated"].line_of_sight
        error = np.linalg.norm(line.error_arcsec, axis=1)
        sigma = np.linalg.norm(line.predicted_sigma_arcsec, axis=1)
        scale = Normalize(0.0, float(np.quantile(np.concatenate([error, sigma]), 0.98)))
        place = result.traced.pixel_px
        for axis, values, title in zip(
            row, (error, sigma), ("error against the traced lens", "predicted 1 σ"), strict=True
        ):
            mesh = axis.tripcolor(*place.T, values, shading="gouraud", norm=scale, rasterized=True)
            _detector(axis, result)
            axis.set_title(f"{case.name} table: {title}")
        step = slice(None, None, 7)
        longest = float(error.max())
        size = 0.08 * result.instrument.camera.width_px / max(longest, 1e-300)
        row[0].quiver(
            *place[step].T,
            *line.error_arcsec[step].T,
            angles="xy",
            scale_units="xy",
            scale=1 / size,
            color="white",
            width=0.0025,
            headwidth=4,
        )
        figure.colorbar(mesh, ax=list(row), label="arcsec", shrink=0.9, pad=0.01, extend="max")
        row[0].set_ylabel("row [px]")
    for axis in axes[-1]:
        axis.set_xlabel("column [px]")
    return figure


def correlations(outcome: Outcome, table: int) -> Figure:
    """Correlations of all unknowns on a table, of the estimator's own covariance."""
    case = outcome.result.cases[table]
    matrix = case.reductions["estimated"].correlation
    names = [UNKNOWNS[name] for name in case.monte_carlo.names]
    figure, axis = new_figure(width="half", aspect_ratio=1.05)
    axis.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
    for i, row in enumerate(matrix):
        for j, value in enumerate(row):
            if i != j and abs(value) >= 0.3:
                colour = "white" if abs(value) > 0.75 else INK
                text = f"{abs(value):.2f}".lstrip("0") if abs(value) < 0.995 else "1"
                axis.text(j, i, text, ha="center", va="center", fontsize=4.6, color=colour)
    axis.set_xticks(range(len(names)), names, rotation=90, fontsize=6.5)
    axis.set_yticks(range(len(names)), names, fontsize=6.5)
    axis.grid(visible=False)
    axis.spines[:].set_visible(False)
    axis.tick_params(length=0)
    axis.set_title(f"{case.name} table")
    return figure


def field_curves(outcome: Outcome) -> Figure:
    """Error of the principal point against that of the line of sight, over the field of view."""
    figure, axis = new_figure(aspect_ratio=0.5)
    field = outcome.values("field_deg")
    per_axis = 1.0 / np.sqrt(2.0)  # a length over two axes
    for name, scale, label, style in (
        ("field_x0_arcsec", 1.0, "principal point, two axes", {"marker": "o", "color": PALETTE[1]}),
        ("field_rolled_x0_arcsec", 1.0, "principal point, three axes", {"marker": "s", "color": PALETTE[4]}),
        (
            "field_plain_x0_arcsec",
            1.0,
            "principal point, only x₀, y₀, f, M unknown",
            {"marker": "^", "color": PALETTE[3]},
        ),
        ("field_closed_arcsec", 1.0, "its closed form", {"color": INK, "linewidth": 0.9, "linestyle": "--"}),
        (
            "field_map_arcsec",
            per_axis,
            "line of sight, two axes",
            {"marker": "o", "color": PALETTE[0], "linewidth": 2.0},
        ),
        (
            "field_rolled_map_arcsec",
            per_axis,
            "line of sight, three axes",
            {"marker": "o", "color": PALETTE[5], "linewidth": 2.0},
        ),
        ("field_image_arcsec", 1.0, "a single image", {"color": "#9aa1a9", "linestyle": ":"}),
    ):
        axis.plot(field, scale * outcome.values(name), label=label, **style)
    axis.set(xscale="log", yscale="log", xlabel=outcome.heading("field_deg"), ylabel="1 σ per axis [″]")
    axis.set_xticks(field, [f"{f:g}" for f in field])
    axis.minorticks_off()
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7.5)
    return figure


MAP_ERROR = "map error, RMS length [″]"


def reading_curves(outcome: Outcome) -> Figure:
    """Map error against the reading noise of the table."""
    figure, axis = new_figure(width="half", aspect_ratio=0.85)
    noise = outcome.values("reading_arcsec")
    shown = noise > 0
    bound, measured = outcome.values("reading_bound_arcsec"), outcome.values("reading_map_arcsec")
    error = 3 * outcome.errors("reading_map_arcsec")
    axis.plot(noise[shown], bound[shown], color=INK, linewidth=1.0, label="Cramér-Rao bound")
    axis.errorbar(noise[shown], measured[shown], error[shown], fmt="o", color=PALETTE[0], label="measured, 3 σ")
    equal = float(outcome.values("reading_noise_equal_to_centroids_arcsec"))
    if np.isfinite(equal):
        label = f"as much as centroids: {equal:.3f}″"
        axis.axvline(equal, color=PALETTE[1], linewidth=1.0, linestyle="--", label=label)
    axis.set(xscale="log", yscale="log", xlabel=outcome.heading("reading_arcsec"), ylabel=MAP_ERROR)
    log_ticks(axis, "x")
    log_ticks(axis, "y")
    axis.legend(loc="upper left")
    return figure


def lean_curves(outcome: Outcome) -> Figure:
    """Map error against the non-orthogonality of the axes."""
    figure, axis = new_figure(width="half", aspect_ratio=0.85)
    lean = outcome.values("lean_arcsec")
    for name, colour, marker in (
        ("lean_ignored_arcsec", PALETTE[1], "s"),
        ("lean_estimated_arcsec", PALETTE[0], "o"),
    ):
        label = outcome.quantity(name).label.lower()
        error = 3 * outcome.errors(name)
        axis.errorbar(lean, outcome.values(name), error, marker=marker, color=colour, label=label)
    axis.set(xlabel=outcome.heading("lean_arcsec"), ylabel=MAP_ERROR, ylim=(0, None))
    axis.legend(loc="upper left")
    return figure


def pull_bars(outcome: Outcome) -> Figure:
    """RMS of the pulls of every unknown over the Monte-Carlo, with the spread that chance allows."""
    figure, axis = new_figure(aspect_ratio=0.3)
    pulls = np.array([outcome.values(f"{name}_rms_pull") for name in UNKNOWNS])
    place = np.arange(len(UNKNOWNS))
    for k, (name, runs) in enumerate(zip(outcome.names("table"), outcome.values("runs"), strict=True)):
        axis.errorbar(
            place + 0.18 * (2 * k - 1),
            pulls[:, k],
            np.full(len(place), 1 / np.sqrt(2 * runs)),
            fmt=MARKERS[k],
            color=PALETTE[k],
            label=f"{name} table, {runs} runs",
        )
    axis.axhspan(0.9, 1.1, color=PALETTE[0], alpha=0.1, linewidth=0)
    axis.axhline(1.0, color=INK, linewidth=0.8)
    axis.set_xticks(place, [label.replace("lean, axis", "lean") for label in UNKNOWNS.values()])
    axis.set(ylabel="RMS pull")
    axis.grid(visible=False, axis="x")
    axis.legend(ncols=2, loc="upper center", bbox_to_anchor=(0.5, 1.22))
    return figure
