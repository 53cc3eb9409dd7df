"""Figures of the attitude-correlated-frames experiment on covariances, the inferred pixel, and the gain of the gyro."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from experiments.acf.evaluate import distortion_rms, gains, map_expected, map_rms, pulls, table2_runs
from experiments.acf.figures import density_of
from experiments.acf.judge import degrees_of
from experiments.acf.published import (
    FIG4_RMS_PX,
    TABLE2_CALIBRATED,
    TABLE2_TRUE,
)
from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure

if TYPE_CHECKING:
    from experiments.acf.result import Result

__all__ = [
    "coefficient_cloud",
    "correlation_map",
    "gain_curves",
    "gain_map",
    "inference_curves",
    "pull_figure",
    "sight_maps",
    "table2_sizes",
]


FAINT = "#8a9099"
PUBLISHED = PALETTE[1]
SYMBOLS = (
    r"$x_0$", r"$y_0$", r"$f$", r"$q_1$", r"$q_2$", r"$q_3$", r"$p_1$", r"$p_2$",
    r"$\varphi_1$", r"$\varphi_2$", r"$\varphi_3$", r"$\theta_1$", r"$\theta_2$", r"$\theta_3$",
)  # fmt: skip


def inference_curves(result: Result) -> Figure:
    """The pixel from Table 2: reprojection of the printed values, and the likelihood of pixel and star count."""
    guess = result.inference
    figure, axes = new_figure(1, 2, aspect_ratio=0.44)
    axis = axes[0]
    for k, letter in enumerate("xy"):
        axis.plot(
            guess.pixel_um, guess.reprojected_px[:, k], color=PALETTE[(0, 2)[k]], label=f"{letter}, printed values"
        )
    axis.axhline(float(FIG4_RMS_PX.mean()), color=PUBLISHED, linewidth=1.2, label="Fig. 4")
    axis.axvline(result.config.camera.pixel_um, color=FAINT, linewidth=0.9, linestyle=":")
    axis.text(result.config.camera.pixel_um, 4.2e-3, " assumed", color=FAINT, fontsize=7.5, va="bottom")
    axis.set(yscale="log", ylim=(4e-3, 2), xlabel="pixel [µm]", ylabel="RMS reprojection [px]")
    axis.set_title("(a) Table 2 against itself")
    axis.legend(loc="upper left", fontsize=7)
    axis = axes[1]
    tried = np.exp(guess.likelihood)
    axis.contourf(
        guess.tried_um,
        guess.tried_stars,
        tried.T,
        levels=(0.011, 0.135, 0.607, 1.001),
        colors=("#dbe9f4", "#9cc4e4", "#3b8bc6"),
    )
    axis.plot(guess.best_um, guess.best_stars, "+", color="white", markersize=9, markeredgewidth=1.5)
    axis.set(yscale="log", xlabel="pixel [µm]", ylabel="stars per frame", ylim=(3, 120))
    ticks = (3, 5, 10, 20, 40, 80)
    axis.set_yticks(ticks, [str(t) for t in ticks])
    axis.minorticks_off()
    axis.set_title("(b) likelihood, levels of 1, 2 and 3 σ")
    return figure


def table2_sizes(result: Result) -> Figure:
    """Printed errors of Table 2 in units of one run's standard deviation, beside runs of our own."""
    figure, axis = new_figure(aspect_ratio=0.33)
    sigma = degrees_of(np.sqrt(np.diag(result.forecast.table2.acc)))
    runs = table2_runs(result) / sigma
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
    axis.plot(place, (TABLE2_CALIBRATED - TABLE2_TRUE) / sigma, "D", color=PUBLISHED, markersize=5, label="published")
    axis.set_xticks(place, SYMBOLS)
    axis.grid(visible=False, axis="x")
    axis.set(ylabel="error / σ of one run", ylim=(-7.2, 4.2))
    axis.legend(loc="lower left", ncols=3)
    return figure


def pull_figure(result: Result) -> Figure:
    """Pulls of the 14 unknowns: RMS of each, and the distribution of all."""
    found = pulls(result)
    figure, axes = new_figure(1, 2, aspect_ratio=0.4, width_ratios=(2.1, 1.0))
    axis, place = axes[0], np.arange(14)
    error = 1.0 / np.sqrt(2 * len(found.own))
    axis.axhspan(0.9, 1.1, color="#eef1f4", linewidth=0)
    axis.axhline(1.0, color=FAINT, linewidth=0.8)
    series = (
        ("own", "ACC, its own covariance", PALETTE[1], "s", -0.2),
        ("carried", "ACC, gyro error carried through", PALETTE[0], "o", 0.0),
        ("linked", "gyro of stated noise, own covariance", PALETTE[2], "^", 0.2),
    )
    for which, label, colour, marker, shift in series:
        axis.errorbar(place + shift, found.rms(which), error * found.rms(which), fmt=marker, color=colour, label=label)
    axis.set_xticks(place, SYMBOLS)
    axis.grid(visible=False, axis="x")
    axis.set(ylabel="RMS pull", title=f"each unknown, {len(found.own)} runs")
    axis.set_ylim(0.8, max(1.4, 1.25 * float(found.rms("own").max())))
    axis.legend(loc="upper left", fontsize=7.5)
    edges = np.linspace(-4, 4, 49)
    for which, _, colour, _, _ in series[::-1]:
        density = density_of(getattr(found, which), edges)
        axes[1].stairs(density, edges, color=colour, linewidth=1.2)
    x = np.linspace(-4, 4, 161)
    axes[1].plot(x, np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi), color=INK, linewidth=1.0, linestyle="--")
    axes[1].set(xlabel="pull", title="all of them", yticks=[], xlim=(-4, 4), ylim=(0, None))
    axes[1].grid(visible=False, axis="y")
    axes[1].spines["left"].set_visible(False)
    return figure


def correlation_map(result: Result) -> Figure:
    """Correlations of the 14 unknowns, as the design predicts them."""
    covariance = result.forecast.table2.perfect
    size = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(size, size)
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


def coefficient_cloud(result: Result) -> Figure:
    """q2 and q3 of the runs: a line, not a point."""
    table = table2_runs(result)
    true = result.scene.camera.parameters
    covariance = result.forecast.table2.acc[4:6, 4:6]
    figure, axis = new_figure(width="half", aspect_ratio=1.0)
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
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


def sight_maps(result: Result) -> Figure:
    """Residual distortion, and line-of-sight error found and expected, over the detector, at the noise of Table 2."""
    from matplotlib.colors import LogNorm

    table = result.outcome[result.plan.table2.name].of("acc", "error")
    found, expected = map_rms(result, table), map_expected(result, result.forecast.table2)
    bent = distortion_rms(result, table)
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


def gain_curves(result: Result) -> Figure:
    """Gain over free attitudes against stars per frame: ACC, which trusts the gyro, and the gyro of stated noise."""
    found, sweep = gains(result), result.config.sweep
    figure, axes = new_figure(1, 2, aspect_ratio=0.46, sharey=True)
    for axis, method, title in (
        (axes[0], "acc", "(a) ACC: the gyro is trusted"),
        (axes[1], "linked", "(b) gyro of stated noise"),
    ):
        value, error, bound = (getattr(found, f"{method}{end}") for end in ("", "_error", "_bound"))
        for k, factor in enumerate(sweep.gyro_factor):
            colour, marker = PALETTE[k % len(PALETTE)], MARKERS[k % len(MARKERS)]
            label = "perfect gyro" if factor == 0 else f"{factor:g} × Table 1"
            axis.plot(sweep.stars, bound[:, k], color=colour, linewidth=1.0)
            axis.errorbar(sweep.stars, value[:, k], error[:, k], fmt=marker, color=colour, label=label)
        axis.axhline(1.0, color=INK, linewidth=0.8)
        axis.set(xscale="log", yscale="log", xlabel="stars per frame", title=title)
        axis.set_xticks(sweep.stars, [str(n) for n in sweep.stars])
        axis.minorticks_off()
        ticks = (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20)
        axis.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes[0].set_ylabel("gain over free attitudes")
    axes[1].legend(loc="upper right", fontsize=7.5)
    reach = np.concatenate([found.acc_bound.ravel(), found.linked_bound.ravel(), found.acc.ravel(), [0.5, 2.0]])
    reach = reach[np.isfinite(reach) & (reach > 0)]
    axes[0].set_ylim(0.8 * float(reach.min()), 1.4 * float(reach.max()))
    return figure


def gain_map(result: Result) -> Figure:
    """Where the gyro gains: bound of the weighted adjustment and of ACC, stars against gyro noise."""
    found, sweep = gains(result), result.config.sweep
    figure, axes = new_figure(1, 2, aspect_ratio=0.34, sharey=True)
    for axis, values, title in (
        (axes[0], found.acc_bound, "ACC over free attitudes (expected)"),
        (axes[1], found.linked_bound, "gyro of stated noise over free attitudes (bound)"),
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
