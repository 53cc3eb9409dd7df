"""Figures of the attitude-correlated-frames experiment: the document's Fig. 2 to 5, and what stands beside them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.acf import rendered
from experiments.acf.published import FIG4_LARGEST_PX, FIG4_RMS_PX, TABLE2_CALIBRATED
from experiments.acf.statistics import (
    correlation_of,
    distortion_map,
    expected_sight_map,
    pulls,
    sight_map,
    table2_errors,
)
from experiments.harness.plotting import INK, MARKERS, PALETTE, log_ticks, new_figure
from experiments.harness.quantities import Outcome
from experiments.laboratory import sketches
from optics.arrays import FloatArray

__all__ = [
    "camera_sketch",
    "coefficient_cloud",
    "correlation_map",
    "count_curves",
    "fig3_curves",
    "fig4_scatter",
    "fig5_curves",
    "gain_curves",
    "gain_map",
    "inference_curves",
    "pull_figure",
    "rendered_map",
    "sight_maps",
    "sky_path",
    "star_tracks",
    "table2_sizes",
]

FAINT = "#8a9099"
PUBLISHED = PALETTE[1]
METHOD_STYLES = {
    "acc": (PALETTE[0], "o"),
    "linked": (PALETTE[5], "D"),
    "free": (PALETTE[2], "^"),
    "iac": (PALETTE[1], "s"),
    "iac_full": (PALETTE[3], "v"),
}
SYMBOLS = (
    r"$x_0$", r"$y_0$", r"$f$", r"$q_1$", r"$q_2$", r"$q_3$", r"$p_1$", r"$p_2$",
    r"$\varphi_1$", r"$\varphi_2$", r"$\varphi_3$", r"$\theta_1$", r"$\theta_2$", r"$\theta_3$",
)  # fmt: skip


def camera_sketch(outcome: Outcome) -> Figure:
    """What ACF17 Fig. 1 shows, drawn anew: the camera model."""
    return sketches.camera_model()


def star_tracks(outcome: Outcome) -> Figure:
    """ACF17 Fig. 2 with real numbers: the stars of all frames on one detector, later frames lighter."""
    result = outcome.result
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


def sky_path(outcome: Outcome) -> Figure:
    """Where the boresight goes, as seen from the first frame, and how the body turns."""
    scene = outcome.result.scene
    figure, axes = new_figure(2, 1, width="half", aspect_ratio=1.2, height_ratios=(2.0, 1.0))
    seen = scene.attitude[0].apply(scene.attitude.inv().apply([0.0, 0.0, 1.0]))

    def degrees(direction: FloatArray) -> FloatArray:
        return np.degrees(np.arctan2(direction[:, :2], direction[:, 2:])).T

    edges = scene.camera.unproject(scene.camera.geometry.corners_px[[0, 1, 2, 3, 0]])
    for k, colour in ((0, "#cfd4da"), (len(seen) // 3, "#aab1ba"), (2 * len(seen) // 3, "#87909b")):
        turned = (scene.attitude[0] * scene.attitude[k].inv()).apply(edges)
        axes[0].plot(*degrees(turned), color=colour, linewidth=0.9)
    axes[0].scatter(*degrees(seen), c=scene.time_s, s=9, cmap="cividis", linewidths=0)
    axes[0].set(aspect="equal", xlabel="[deg]", ylabel="[deg]", title="boresight, and the field at three times")
    axes[0].invert_yaxis()
    time = np.linspace(scene.time_s[0], scene.time_s[-1], 241)
    for k, rate in enumerate(np.degrees(scene.motion.rate(time)).T):
        axes[1].plot(time, rate, color=PALETTE[k], label="xyz"[k])
    axes[1].set(xlabel="time [s]", title="rate about the body's axes [deg/s]")
    axes[1].legend(ncols=3, loc="upper right", fontsize=7, columnspacing=1.0)
    axes[1].margins(y=0.28)
    return figure


def fig3_curves(outcome: Outcome) -> Figure:
    """ACF17 Fig. 3: reprojection error against star noise, for biases and for random walks."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.44, sharey=True)
    noise, highest = outcome.config.noise_px, 0.0
    for axis, part, gyro, title in (
        (axes[0], "fig3a", "bias", "(a) constant bias"),
        (axes[1], "fig3b", "walk", "(b) angle random walk"),
    ):
        found, expected = outcome.quantity(f"{part}_rms_px"), outcome.values(f"{part}_expected_px")
        for k, size in enumerate(outcome.data.coords[gyro].values):
            colour, marker = PALETTE[k % len(PALETTE)], MARKERS[k % len(MARKERS)]
            one = found.at(**{gyro: k})
            axis.plot(noise, expected[:, k], color=colour, linewidth=1.0)
            axis.errorbar(
                noise,
                one.values,
                one.error,
                fmt=marker,
                color=colour,
                markerfacecolor="none",  # hollow and of falling size, for they lie together
                markersize=max(8.0 - 1.6 * k, 3.0),
                elinewidth=0.8,
                label=f"{size:g} {outcome.data.coords[gyro].attrs['units']}" if k else "perfect gyro",
            )
        highest = max(highest, float(found.values.max()), float(expected.max()))
        axis.set(xlabel="star noise, per axis [px]", title=title, xlim=(0, None))
        axis.legend(loc="upper left")
    axes[0].set_ylim(0, 1.06 * highest)
    axes[0].set_ylabel(outcome.heading("fig3a_rms_px"))
    return figure


def fig4_scatter(outcome: Outcome) -> Figure:
    """ACF17 Fig. 4: the reprojection errors of all stars and runs, and their lengths over direction."""
    result = outcome.result
    away = result.trials[result.plan.table2.name].of("acc", "reprojected_px")
    one, every = away[0], away.reshape(-1, 2)
    figure, axes = new_figure(1, 2, aspect_ratio=0.5)
    reach = 1.25 * FIG4_LARGEST_PX
    axis = axes[0]
    axis.hexbin(*every.T, gridsize=55, extent=(-reach, reach, -reach, reach), cmap="Greys", bins="log", linewidths=0.1)
    axis.plot(*one.T, ".", color=PALETTE[0], markersize=2.0, label="one run")
    circle = np.stack([np.cos(angle := np.linspace(0, 2 * np.pi, 181)), np.sin(angle)])
    axis.plot(*FIG4_LARGEST_PX * circle, color=PUBLISHED, linewidth=1.0, linestyle="--")
    axis.text(0, -1.03 * FIG4_LARGEST_PX, "0.04 px", color=PUBLISHED, ha="center", va="bottom", fontsize=7.5)
    axis.plot(*FIG4_RMS_PX[:, None] * circle, color=PUBLISHED, label="RMS, published")
    found = outcome.values("fig4_rms_px", case="assumed")
    axis.plot(*found[:, None] * circle, color="white", linewidth=1.4, label="RMS, here")
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


def count_curves(outcome: Outcome) -> Figure:
    """Reprojection error at 0.1 px against stars per frame: which number gives the published value."""
    figure, axis = new_figure(aspect_ratio=0.44)
    matching, config = outcome.result.expected.matching, outcome.config
    for one, colour in zip(matching, (PALETTE[0], PALETTE[2]), strict=True):
        low, high = one.mean_px - one.scatter_px, one.mean_px + one.scatter_px
        axis.fill_between(one.stars, low, high, color=colour, alpha=0.13, linewidth=0)
        axis.plot(one.stars, one.mean_px, color=colour, label=f"{one.pixel_um:g} µm pixel, Table 1's gyro")
    stars = matching[0].stars
    closed = config.table_noise_px * np.sqrt(14 / ((config.frames + 1) // 2 * stars))
    axis.plot(stars, closed, color=FAINT, linestyle="--", label=r"perfect gyro: $\sigma\,\sqrt{14\,/\,n}$")
    for gyro, colour, marker in (("perfect", FAINT, "s"), ("table1", PALETTE[0], "o")):
        found = outcome.quantity("counts_rms_px", count_gyro=gyro)
        axis.errorbar(config.counts, found.values, found.error, fmt=marker, color=colour)
    there = outcome.value("fig4_length_px", case="inferred")
    stars_there = outcome.value("fig4_stars", case="inferred")
    axis.errorbar([stars_there], [there.value], [there.uncertainty], fmt="D", color=PALETTE[2])
    published = float(np.linalg.norm(FIG4_RMS_PX))
    axis.axhline(published, color=PUBLISHED, linewidth=1.3)
    axis.text(stars[-1], published, "published", color=PUBLISHED, ha="right", va="bottom", fontsize=8)
    axis.set(xscale="log", xlabel="stars per frame", ylabel=outcome.heading("counts_rms_px"), ylim=(0, None))
    log_ticks(axis, "x", (5, 10, 20, 40, 80, 120))
    axis.legend(loc="upper right")
    return figure


def fig5_curves(outcome: Outcome) -> Figure:
    """ACF17 Fig. 5, and the line of sight: errors of the methods against star noise."""
    figure, axes = new_figure(2, 3, aspect_ratio=0.66, sharex=True)
    panels = (
        ("(a) principal point x0 [px]", "x0_px", 1.0),
        ("(b) principal point y0 [px]", "y0_px", 1.0),
        ("(c) focal length [µm]", "focal_length_mm", 1e3),
        ("(d) largest residual distortion [px]", "distortion_px", 1.0),
        ("(e) line of sight [″]", "sight_arcsec", 1.0),
    )
    noise, names = outcome.config.noise_px, dict(zip(METHOD_STYLES, outcome.names("method"), strict=True))
    for axis, (title, name, scale) in zip(axes.flat, panels, strict=False):
        for method in reversed(METHOD_STYLES):
            colour, marker = METHOD_STYLES[method]
            found, expected = (scale * outcome.values(one, method=method) for one in (name, f"expected_{name}"))
            axis.plot(noise, found, marker, color=colour, markersize=3.4, label=names[method])
            if method != "iac_full":  # expected to be as good as free attitudes
                axis.plot(noise, expected, color=colour, linewidth=0.9)
        axis.set(title=title, ylim=(0, None), xlim=(0, None))
    for axis in (axes[0, 2], axes[1, 0], axes[1, 1]):
        axis.set_xlabel("star noise [px]")
        axis.tick_params(labelbottom=True)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    axes[1, 2].axis("off")
    axes[1, 2].legend(handles[::-1], labels[::-1], loc="center left", title="lines: expected", title_fontsize=8)
    return figure


def inference_curves(outcome: Outcome) -> Figure:
    """The pixel from Table 2: reprojection of the printed values, and the likelihood of pixel and star count."""
    guess, assumed_um = outcome.result.inference, outcome.config.camera.pixel_um
    figure, axes = new_figure(1, 2, aspect_ratio=0.44)
    axis = axes[0]
    for letter, values, colour in zip("xy", guess.reprojected_px.T, (PALETTE[0], PALETTE[2]), strict=True):
        axis.plot(guess.pixel_um, values, color=colour, label=f"{letter}, printed values")
    axis.axhline(float(FIG4_RMS_PX.mean()), color=PUBLISHED, linewidth=1.2, label="Fig. 4")
    axis.axvline(assumed_um, color=FAINT, linewidth=0.9, linestyle=":")
    axis.text(assumed_um, 4.2e-3, " assumed", color=FAINT, fontsize=7.5, va="bottom")
    axis.set(yscale="log", ylim=(4e-3, 2), xlabel="pixel [µm]", ylabel="RMS reprojection [px]")
    axis.set_title("(a) Table 2 against itself")
    axis.legend(loc="upper left", fontsize=7)
    axis = axes[1]
    axis.contourf(
        guess.tried_um,
        guess.tried_stars,
        np.exp(guess.likelihood).T,
        levels=(0.011, 0.135, 0.607, 1.001),
        colors=("#dbe9f4", "#9cc4e4", "#3b8bc6"),
    )
    axis.plot(guess.best_um, guess.best_stars, "+", color="white", markersize=9, markeredgewidth=1.5)
    axis.set(yscale="log", xlabel="pixel [µm]", ylabel="stars per frame", ylim=(3, 120))
    log_ticks(axis, "y", (3, 5, 10, 20, 40, 80))
    axis.set_title("(b) likelihood, levels of 1, 2 and 3 σ")
    return figure


def table2_sizes(outcome: Outcome) -> Figure:
    """Printed errors of Table 2 in units of one run's standard deviation, beside runs of our own."""
    figure, axis = new_figure(aspect_ratio=0.33)
    sigma = outcome.values("table2_bound_with_gyro_error")
    runs = table2_errors(outcome.result) / sigma
    place = np.arange(14)
    spread = np.random.default_rng(1).uniform(-0.2, 0.2, runs.shape)
    axis.plot(
        (place + spread).ravel(), runs.ravel(), ".", color="#b9c0c8", markersize=2.4, zorder=1, label="one run each"
    )
    axis.errorbar(
        place,
        runs.mean(0),
        runs.std(0, ddof=1) / np.sqrt(len(runs)),
        fmt="o",
        color=PALETTE[0],
        label=f"mean of {len(runs)}",
    )
    axis.plot(
        place, outcome.values("table2_published_error") / sigma, "D", color=PUBLISHED, markersize=5, label="published"
    )
    axis.set_xticks(place, SYMBOLS)
    axis.grid(visible=False, axis="x")
    axis.set(ylabel="error / σ of one run", ylim=(-7.2, 4.2))
    axis.legend(loc="lower left", ncols=3)
    return figure


def pull_figure(outcome: Outcome) -> Figure:
    """Pulls of the 14 unknowns: RMS of each, and the distribution of all."""
    found, n = pulls(outcome.result), outcome.value("pull_n")
    figure, axes = new_figure(1, 2, aspect_ratio=0.4, width_ratios=(2.1, 1.0))
    axis, place = axes[0], np.arange(14)
    axis.axhspan(0.9, 1.1, color="#eef1f4", linewidth=0)
    axis.axhline(1.0, color=FAINT, linewidth=0.8)
    series = (
        ("own", "ACC, its own covariance", PALETTE[1], "s", -0.2),
        ("carried", "ACC, gyro error carried through", PALETTE[0], "o", 0.0),
        ("linked", "gyro of stated noise, own covariance", PALETTE[2], "^", 0.2),
    )
    for which, label, colour, marker, shift in series:
        rms = outcome.values(f"pull_{which}")
        axis.errorbar(place + shift, rms, rms / np.sqrt(2 * n), fmt=marker, color=colour, label=label)
    axis.set_xticks(place, SYMBOLS)
    axis.grid(visible=False, axis="x")
    axis.set(ylabel="RMS pull", title=f"each unknown, {n} runs")
    axis.set_ylim(0.8, max(1.4, 1.25 * float(outcome.values("pull_own").max())))
    axis.legend(loc="upper left", fontsize=7.5)
    edges = np.linspace(-4, 4, 49)
    for which, _, colour, _, _ in series[::-1]:
        density = density_of(found[which], edges)
        axes[1].stairs(density, edges, color=colour, linewidth=1.2)
    x = np.linspace(-4, 4, 161)
    axes[1].plot(x, np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi), color=INK, linewidth=1.0, linestyle="--")
    axes[1].set(xlabel="pull", title="all of them", yticks=[], xlim=(-4, 4), ylim=(0, None))
    axes[1].grid(visible=False, axis="y")
    axes[1].spines["left"].set_visible(False)
    return figure


def correlation_map(outcome: Outcome) -> Figure:
    """Correlations of the 14 unknowns, as the design predicts them."""
    correlation = correlation_of(outcome.result.expected.table2.perfect)
    figure, axis = new_figure(width="half", aspect_ratio=1.0)
    image = axis.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1)
    for i in range(14):
        for j in range(14):
            if i != j and abs(correlation[i, j]) > 0.85:
                text = f"{100 * abs(correlation[i, j]):.0f}"
                axis.text(j, i, text, ha="center", va="center", color="white", fontsize=5.5)
    axis.set_xticks(range(14), SYMBOLS, fontsize=7)
    axis.set_yticks(range(14), SYMBOLS, fontsize=7)
    axis.tick_params(length=0)
    axis.grid(visible=False)
    for side in axis.spines.values():
        side.set_visible(False)
    bar = figure.colorbar(image, ax=axis, fraction=0.046, pad=0.03)
    bar.outline.set_visible(False)
    return figure


def coefficient_cloud(outcome: Outcome) -> Figure:
    """q2 and q3 of the runs: a line, not a point."""
    table, true = table2_errors(outcome.result), outcome.values("table2_true")
    covariance = outcome.result.expected.table2.acc[4:6, 4:6]
    figure, axis = new_figure(width="half", aspect_ratio=1.0)
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(correlation_of(covariance))
    angle = np.linspace(0, 2 * np.pi, 181)
    ring = (vectors * np.sqrt(values)) @ np.stack([np.cos(angle), np.sin(angle)])
    for k, style in ((1, "-"), (2, "--")):
        axis.plot(
            1e7 * (true[4] + k * size[0] * ring[0]),
            1e8 * (true[5] + k * size[1] * ring[1]),
            color=FAINT,
            linestyle=style,
            linewidth=0.9,
            label=f"expected, {k} σ",
        )
    axis.plot(1e7 * (true[4] + table[:, 4]), 1e8 * (true[5] + table[:, 5]), ".", color=PALETTE[0], label="runs")
    axis.plot(1e7 * true[4], 1e8 * true[5], "+", color=INK, markersize=10, markeredgewidth=1.6, label="truth")
    axis.plot(1e7 * TABLE2_CALIBRATED[4], 1e8 * TABLE2_CALIBRATED[5], "D", color=PUBLISHED, label="published")
    axis.set(xlabel=r"$q_2$ [$10^{-7}$ mm$^{-4}$]", ylabel=r"$q_3$ [$10^{-8}$ mm$^{-6}$]")
    axis.legend(loc="lower left", fontsize=7)
    return figure


def sight_maps(outcome: Outcome) -> Figure:
    """Residual distortion, and line-of-sight error found and expected, over the detector, at the noise of Table 2."""
    from matplotlib.colors import LogNorm

    result = outcome.result
    table = result.trials[result.plan.table2.name].of("acc", "error")
    found, expected = sight_map(result, table), expected_sight_map(result, result.expected.table2.acc)
    bent = distortion_map(result, table)
    geometry = result.scene.camera.geometry
    figure, axes = new_figure(1, 3, aspect_ratio=0.37, sharey=True)
    extent = (-0.5, geometry.width_px - 0.5, geometry.height_px - 0.5, -0.5)
    inner = (0, geometry.width_px - 1, 0, geometry.height_px - 1)
    sight = LogNorm(vmin=float(min(found.min(), expected.min())), vmax=float(max(found.max(), expected.max())))
    panels = (
        (bent, "residual distortion [px]", LogNorm(vmin=0.003, vmax=float(bent.max())), (0.01, 0.03, 0.1, 0.3), "%g"),
        (found, f"line of sight, {len(table)} runs [″]", sight, (0.25, 0.5, 1.0, 2.0, 4.0), "%g″"),
        (expected, "line of sight, expected [″]", sight, (0.25, 0.5, 1.0, 2.0, 4.0), "%g″"),
    )
    for axis, (values, title, norm, levels, text) in zip(axes, panels, strict=True):
        axis.imshow(np.maximum(values, 1e-6), extent=extent, norm=norm, interpolation="bilinear")
        lines = axis.contour(values, levels=levels, colors="white", linewidths=0.7, extent=inner)
        axis.clabel(lines, fmt=text, fontsize=6.5)
        axis.set(title=title, xlabel="column [px]", aspect="equal")
        axis.grid(visible=False)
    axes[0].set_ylabel("row [px]")
    return figure


def gain_curves(outcome: Outcome) -> Figure:
    """Gain over free attitudes against stars per frame: ACC, which trusts the gyro, and the gyro of stated noise."""
    sweep = outcome.config.sweep
    figure, axes = new_figure(1, 2, aspect_ratio=0.46, sharey=True)
    for axis, method, title in (
        (axes[0], "acc", "(a) ACC: the gyro is trusted"),
        (axes[1], "linked", "(b) gyro of stated noise"),
    ):
        for k, factor in enumerate(sweep.gyro_factor):
            colour, marker = PALETTE[k % len(PALETTE)], MARKERS[k % len(MARKERS)]
            label = "perfect gyro" if factor == 0 else f"{factor:g} × Table 1"
            found, bound = (outcome.quantity(f"gain_{method}{end}", factor=factor) for end in ("", "_bound"))
            axis.plot(sweep.stars, bound.values, color=colour, linewidth=1.0)
            axis.errorbar(sweep.stars, found.values, found.error, fmt=marker, color=colour, label=label)
        axis.axhline(1.0, color=INK, linewidth=0.8)
        axis.set(xscale="log", yscale="log", xlabel="stars per frame", title=title)
    axes[0].set_ylabel("gain over free attitudes")
    axes[1].legend(loc="upper right", fontsize=7.5)
    every = [outcome.values(f"gain_{name}").ravel() for name in ("acc", "acc_bound", "linked_bound")]
    reach = np.concatenate([*every, [0.5, 2.0]])
    reach = reach[np.isfinite(reach) & (reach > 0)]
    axes[0].set_ylim(0.8 * float(reach.min()), 1.4 * float(reach.max()))
    for axis in axes:
        log_ticks(axis, "x", sweep.stars)
        log_ticks(axis, "y", (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20))
    return figure


def gain_map(outcome: Outcome) -> Figure:
    """Where the gyro gains: bound of the weighted adjustment and of ACC, stars against gyro noise."""
    sweep = outcome.config.sweep
    figure, axes = new_figure(1, 2, aspect_ratio=0.34, sharey=True)
    for axis, values, title in (
        (axes[0], outcome.values("gain_acc_bound"), "ACC over free attitudes (expected)"),
        (axes[1], outcome.values("gain_linked_bound"), "gyro of stated noise over free attitudes (bound)"),
    ):
        axis.imshow(np.log(values.T), cmap="RdBu", vmin=-np.log(4), vmax=np.log(4), aspect="auto", origin="lower")
        for i in range(values.shape[0]):
            for j in range(values.shape[1]):
                _number(axis, i, j, float(values[i, j]))
        axis.set_xticks(range(len(sweep.stars)), [str(n) for n in sweep.stars])
        axis.set_yticks(range(len(sweep.gyro_factor)), ["perfect" if f == 0 else f"{f:g} ×" for f in sweep.gyro_factor])
        axis.tick_params(length=0)
        axis.grid(visible=False)
        axis.set(xlabel="stars per frame", title=title)
        for side in axis.spines.values():
            side.set_visible(False)
    axes[0].set_ylabel("gyro noise")
    return figure


def _number(axis: Any, i: int, j: int, value: float) -> None:
    strong = abs(np.log(value)) > np.log(2.6)
    text = f"{value:.0f}" if value >= 10 else f"{value:.2g}" if value < 0.95 else f"{value:.2f}"
    axis.text(i, j, text, ha="center", va="center", fontsize=7.5, color="white" if strong else INK)


def rendered_map(outcome: Outcome, camera: str) -> Figure:
    """Error of the line of sight of a rendered camera, and its predicted uncertainty, over the detector."""
    figure: Figure = rendered.draw(outcome.result.rendered)("error_and_uncertainty", camera)
    return figure
