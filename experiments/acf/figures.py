"""Figures of the attitude-correlated-frames experiment: the document's Fig. 3 to 5, and what stands beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from experiments.acf.evaluate import Comparison, Runs, comparison, counts, fig3, fig4
from experiments.acf.published import FIG4_LARGEST_PX, FIG4_RMS_PX
from experiments.harness.plotting import MARKERS, PALETTE, new_figure
from optics.arrays import FloatArray

if TYPE_CHECKING:
    from experiments.acf.result import Result

__all__ = [
    "METHOD_LABELS",
    "METHOD_STYLES",
    "count_curves",
    "density_of",
    "fig3_curves",
    "fig4_scatter",
    "fig5_curves",
    "sky_path",
    "star_tracks",
]


FAINT = "#8a9099"
PUBLISHED = PALETTE[1]
METHOD_LABELS = {
    "acc": "ACC (as published)",
    "linked": "gyro of stated noise",
    "free": "free attitudes",
    "iac": "IAC, equal weights (as published)",
    "iac_full": "IAC, full weights",
}
METHOD_STYLES = {
    "acc": (PALETTE[0], "o"),
    "linked": (PALETTE[5], "D"),
    "free": (PALETTE[2], "^"),
    "iac": (PALETTE[1], "s"),
    "iac_full": (PALETTE[3], "v"),
}


def star_tracks(result: Result) -> Figure:
    """ACF17 Fig. 2 with real numbers: the stars of all frames on one detector, later frames lighter."""
    stars, geometry = result.stars, result.scene.camera.geometry
    figure, axis = new_figure(width="half", aspect_ratio=1.2)
    order = np.lexsort((stars.frame, stars.star))
    x, y, star, frame = (v[order] for v in (*stars.pixel_px.T, stars.star, stars.frame))
    breaks = np.flatnonzero((np.diff(star) != 0) | (np.diff(frame) != 1)) + 1
    for part in np.split(np.arange(len(x)), breaks):
        axis.plot(x[part], y[part], color="#d5d9de", linewidth=0.7, zorder=1)
    marks = axis.scatter(x, y, c=result.scene.time_s[frame], s=3.5, cmap="cividis", linewidths=0, zorder=2)
    centre = geometry.centre_px + result.scene.camera.parameters[:2]
    axis.plot(*centre, "+", color=PALETTE[1], markersize=9, markeredgewidth=1.4)
    _detector(axis, geometry.width_px, geometry.height_px)
    bar = figure.colorbar(marks, ax=axis, location="bottom", fraction=0.05, pad=0.02, aspect=35, shrink=0.85)
    bar.set_label("time [s]")
    bar.outline.set_visible(False)
    return figure


def _detector(axis: Any, width: int, height: int) -> None:
    axis.plot(
        np.array([0, 1, 1, 0, 0]) * width - 0.5, np.array([0, 0, 1, 1, 0]) * height - 0.5, color=FAINT, linewidth=0.8
    )
    axis.grid(visible=False)
    axis.set(xlim=(-0.03 * width, 1.03 * width), ylim=(1.03 * height, -0.03 * height), aspect="equal")
    axis.set(xlabel="column [px]", ylabel="row [px]")


def sky_path(result: Result) -> Figure:
    """Where the boresight goes, as seen from the first frame, and how the body turns."""
    scene = result.scene
    figure, axes = new_figure(2, 1, width="half", aspect_ratio=1.2, height_ratios=(2.0, 1.0))
    boresight = scene.attitude.inv().apply([0.0, 0.0, 1.0])
    seen = scene.attitude[0].apply(boresight)
    x, y = np.degrees(np.arctan2(seen[:, 0], seen[:, 2])), np.degrees(np.arctan2(seen[:, 1], seen[:, 2]))
    edges = scene.camera.unproject(scene.camera.geometry.corners_px[[0, 1, 2, 3, 0]])
    for k, colour in ((0, "#cfd4da"), (len(seen) // 3, "#aab1ba"), (2 * len(seen) // 3, "#87909b")):
        turned = (scene.attitude[0] * scene.attitude[k].inv()).apply(edges)
        axes[0].plot(
            np.degrees(np.arctan2(turned[:, 0], turned[:, 2])),
            np.degrees(np.arctan2(turned[:, 1], turned[:, 2])),
            color=colour,
            linewidth=0.9,
        )
    axes[0].scatter(x, y, c=scene.time_s, s=9, cmap="cividis", linewidths=0)
    axes[0].set(aspect="equal", xlabel="[deg]", ylabel="[deg]", title="boresight, and the field at three times")
    axes[0].invert_yaxis()
    time = np.linspace(scene.time_s[0], scene.time_s[-1], 241)
    for k, rate in enumerate(np.degrees(scene.motion.rate(time)).T):
        axes[1].plot(time, rate, color=PALETTE[k], label="xyz"[k])
    axes[1].set(xlabel="time [s]", title="rate about the body's axes [deg/s]")
    axes[1].legend(ncols=3, loc="upper right", fontsize=7, columnspacing=1.0)
    axes[1].margins(y=0.28)
    return figure


def fig3_curves(result: Result) -> Figure:
    """ACF17 Fig. 3: reprojection error against star noise, for biases and for random walks."""
    config, rows = result.config, fig3(result)
    biases, walks = config.bias_deg_per_h, config.angle_random_walk_deg_per_sqrt_h
    figure, axes = new_figure(1, 2, aspect_ratio=0.44, sharey=True)
    for axis, values, start, unit, title in (
        (axes[0], biases, 1, "°/h", "(a) constant bias"),
        (axes[1], walks, 1 + len(biases), "°/√h", "(b) angle random walk"),
    ):
        columns = [(0, "perfect gyro")] + [(start + k, f"{value:g} {unit}") for k, value in enumerate(values)]
        for style, (column, label) in enumerate(columns):
            _with_expected(axis, config.noise_px, [row[column] for row in rows], style, label)
        axis.set(xlabel="star noise, per axis [px]", title=title, xlim=(0, None))
        axis.legend(loc="upper left")
    axes[0].set_ylim(0, 1.06 * max(max(one.value, one.expected) for row in rows for one in row))
    axes[0].set_ylabel("RMS reprojection error [px]")
    return figure


def _with_expected(axis: Any, x: Any, runs: list[Runs], style: int, label: str) -> None:
    """Points with error bars on the line of their expectation; hollow and of falling size, for they lie together."""
    colour, marker = PALETTE[style % len(PALETTE)], MARKERS[style % len(MARKERS)]
    axis.plot(x, [one.expected for one in runs], color=colour, linewidth=1.0)
    axis.errorbar(
        x,
        [one.value for one in runs],
        [one.error for one in runs],
        fmt=marker,
        color=colour,
        markerfacecolor="none",
        markersize=max(8.0 - 1.6 * style, 3.0),
        elinewidth=0.8,
        label=label,
    )


def fig4_scatter(result: Result) -> Figure:
    """ACF17 Fig. 4: the reprojection errors of all stars and runs, and their lengths over direction."""
    away = result.outcome[result.plan.table2.name].of("acc", "reprojected_px")
    one, every = away[0], away.reshape(-1, 2)
    figure, axes = new_figure(1, 2, aspect_ratio=0.5)
    reach = 1.25 * FIG4_LARGEST_PX
    axis = axes[0]
    axis.hexbin(*every.T, gridsize=55, extent=(-reach, reach, -reach, reach), cmap="Greys", bins="log", linewidths=0.1)
    axis.plot(*one.T, ".", color=PALETTE[0], markersize=2.0, label="one run")
    angle = np.linspace(0, 2 * np.pi, 181)
    axis.plot(
        FIG4_LARGEST_PX * np.cos(angle), FIG4_LARGEST_PX * np.sin(angle), color=PUBLISHED, linewidth=1.0, linestyle="--"
    )
    axis.text(0, -1.03 * FIG4_LARGEST_PX, "0.04 px", color=PUBLISHED, ha="center", va="bottom", fontsize=7.5)
    found = fig4(result)
    axis.plot(FIG4_RMS_PX[0] * np.cos(angle), FIG4_RMS_PX[1] * np.sin(angle), color=PUBLISHED, label="RMS, published")
    axis.plot(
        found.rms_px[0] * np.cos(angle),
        found.rms_px[1] * np.sin(angle),
        color="white",
        linewidth=1.4,
        label="RMS, here",
    )
    axis.set(xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal", xlabel="x [px]", ylabel="y [px]")
    axis.set_title("(a) all stars, all runs (grey)")
    legend = axis.legend(
        loc="lower right", fontsize=7, frameon=True, facecolor="#b5bac1", edgecolor="none", framealpha=0.9
    )
    legend.get_frame().set_linewidth(0)
    _fig4_lengths(axes[1], every, one)
    return figure


def density_of(values: FloatArray, edges: FloatArray) -> FloatArray:
    """Density of values over bins; zero where none falls into any bin."""
    count, _ = np.histogram(values, edges)
    return np.asarray(count / (max(int(count.sum()), 1) * np.diff(edges)))


def _fig4_lengths(axis: Any, every: FloatArray, one: FloatArray) -> None:
    """Lengths of the errors: the spread of single runs and of all."""
    edges = np.linspace(0, 1.5 * FIG4_LARGEST_PX, 49)
    for sample, colour, label in ((every, "#9aa1a9", "all runs"), (one, PALETTE[0], "one run")):
        density = density_of(np.linalg.norm(sample, axis=1), edges)
        axis.stairs(density, edges, color=colour, linewidth=1.3, label=label, fill=label == "all runs", alpha=0.9)
    axis.axvline(FIG4_LARGEST_PX, color=PUBLISHED, linestyle="--", linewidth=1.0, label="published: all below")
    axis.axvline(float(np.linalg.norm(FIG4_RMS_PX)), color=PUBLISHED, linewidth=1.2, label="published RMS")
    axis.set(xlabel="length of the reprojection error [px]", yticks=[], title="(b) lengths", xlim=(0, edges[-1]))
    axis.grid(visible=False, axis="y")
    axis.spines["left"].set_visible(False)
    axis.legend(loc="upper right", fontsize=7)


def count_curves(result: Result) -> Figure:
    """Reprojection error at 0.1 px against stars per frame: which number gives the published value."""
    figure, axis = new_figure(aspect_ratio=0.44)
    tried, rows = result.config.counts, counts(result)
    published = float(np.linalg.norm(FIG4_RMS_PX))
    for k, one in enumerate(result.forecast.matching):
        colour = (PALETTE[0], PALETTE[2])[k]
        axis.fill_between(
            one.stars, one.mean_px - one.scatter_px, one.mean_px + one.scatter_px, color=colour, alpha=0.13, linewidth=0
        )
        axis.plot(one.stars, one.mean_px, color=colour, label=f"{one.pixel_um:g} µm pixel, Table 1's gyro")
    frames = (result.config.frames + 1) // 2
    n = result.forecast.matching[0].stars
    closed = result.config.table_noise_px * np.sqrt(14 / (frames * n))
    axis.plot(n, closed, color=FAINT, linestyle="--", label=r"perfect gyro: $\sigma\,\sqrt{14\,/\,n}$")
    for column, colour, marker in ((0, FAINT, "s"), (1, PALETTE[0], "o")):
        axis.errorbar(
            tried, [row[column].value for row in rows], [row[column].error for row in rows], fmt=marker, color=colour
        )
    there = fig4(result, inferred=True).runs
    axis.errorbar([result.plan.inferred.stars], [there.value], [there.error], fmt="D", color=PALETTE[2])
    axis.axhline(published, color=PUBLISHED, linewidth=1.3)
    axis.text(n[-1], published, "published", color=PUBLISHED, ha="right", va="bottom", fontsize=8)
    axis.set(xscale="log", xlabel="stars per frame", ylabel="RMS reprojection error [px]", ylim=(0, None))
    ticks = [5, 10, 20, 40, 80, 120]
    axis.set_xticks(ticks, [str(t) for t in ticks])
    axis.minorticks_off()
    axis.legend(loc="upper right")
    return figure


def fig5_curves(result: Result) -> Figure:
    """ACF17 Fig. 5, and the line of sight: errors of the methods against star noise."""
    found = comparison(result)
    noise = np.array(result.config.noise_px)
    figure, axes = new_figure(2, 3, aspect_ratio=0.66, sharex=True)
    panels = (
        ("(a) principal point x0 [px]", lambda one: one.camera[:, 0], lambda one: one.expected_camera, 0),
        ("(b) principal point y0 [px]", lambda one: one.camera[:, 1], lambda one: one.expected_camera, 1),
        ("(c) focal length [µm]", lambda one: 1e3 * one.camera[:, 2], lambda one: one.expected_camera, 2),
        ("(d) largest residual distortion [px]", lambda one: one.distortion_px, None, 0),
        ("(e) line of sight [″]", lambda one: one.sight_arcsec, None, 0),
    )
    for axis, (title, value, expected, column) in zip(axes.flat, panels, strict=False):
        for method in ("iac", "iac_full", "free", "linked", "acc"):
            colour, marker = METHOD_STYLES[method]
            axis.plot(noise, value(found[method]), marker, color=colour, markersize=3.4, label=METHOD_LABELS[method])
            line = _expected_line(found[method], expected, column, title)
            if line is not None and method != "iac_full":
                axis.plot(noise, line, color=colour, linewidth=0.9)
        axis.set(title=title, ylim=(0, None), xlim=(0, None))
    for axis in (axes[0, 2], axes[1, 0], axes[1, 1]):
        axis.set_xlabel("star noise [px]")
        axis.tick_params(labelbottom=True)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    axes[1, 2].axis("off")
    axes[1, 2].legend(handles[::-1], labels[::-1], loc="center left", title="lines: expected", title_fontsize=8)
    return figure


def _expected_line(one: Comparison, expected: Any, column: int, title: str) -> FloatArray | None:
    if expected is not None:
        return np.asarray(expected(one)[:, column] * (1e3 if "µm" in title else 1.0))
    return one.expected_distortion_px if "distortion" in title else one.expected_sight_arcsec
