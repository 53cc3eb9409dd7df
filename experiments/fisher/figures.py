"""Figures of the rendered bench: star vectors on their tangent plane, quantiles, causes, streaks."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Circle, Ellipse

from calib.directional.fisher import tangent_basis, tangent_plane
from experiments.fisher.bench import Case
from experiments.fisher.evaluate import LEVEL
from experiments.fisher.result import Result
from experiments.harness.plotting import INK, PALETTE, new_figure
from optics.arrays import FloatArray
from optics.units import RAD_ARCSEC

__all__ = ["cause_bars", "error_arrows", "quantile_plots", "star_windows", "vector_scatter"]


_FAINT = "#9aa1a9"
_HELD = float(np.sqrt(-2.0 * np.log(1.0 - LEVEL)))
"""Radius in sigmas of the circle that holds 95 % of an isotropic normal distribution."""


def vector_scatter(result: Result) -> Figure:
    """Vectors w_i about their mean, with the fitted circle, its confidence band, and the ellipse."""
    cases = result.bench.cases
    figure, axes = new_figure(1, len(cases), aspect_ratio=0.56, squeeze=False)
    offsets = [_offsets(case) for case in cases]
    reach = 1.08 * max(float(np.abs(o).max()) for o in offsets)
    for axis, case, offset in zip(axes[0], cases, offsets, strict=True):
        judged, colour = case.evaluation, PALETTE[0]
        low, high = judged.interval_arcsec(LEVEL)
        sigma = judged.sigma_arcsec
        good = ~judged.outlier
        axis.scatter(*offset[good].T, s=7, color=colour, alpha=0.55, linewidths=0, zorder=2)
        if judged.outlier.any():
            axis.scatter(*offset[judged.outlier].T, s=18, marker="x", color=PALETTE[1], label="outlier")
        axis.add_patch(Annulus((0, 0), high, high - low, color=PALETTE[1], alpha=0.30, linewidth=0, zorder=3))
        axis.add_patch(Circle((0, 0), sigma, fill=False, color=PALETTE[1], linewidth=1.6, zorder=4))
        axis.add_patch(Circle((0, 0), _HELD * sigma, fill=False, color=PALETTE[1], linewidth=0.9, ls=(0, (4, 3))))
        if judged.isotropy.p_value < 1.0 - LEVEL:
            axis.add_patch(_ellipse(case))
        axis.plot([], [], color=PALETTE[1], linewidth=1.6, label=f"σ = {sigma:.3f}″ ({low:.3f} … {high:.3f})")
        axis.plot(
            [],
            [],
            color=PALETTE[1],
            linewidth=0.9,
            ls=(0, (4, 3)),
            label=f"holds {100 * LEVEL:g} %: here {100 * _inside(case):.1f} %",
        )
        if judged.isotropy.p_value < 1.0 - LEVEL:
            axis.plot([], [], color=INK, linewidth=1.0, label="its ellipse, 1 σ")
        axis.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="across the star, along X [arcsec]")
        axis.set_title(f"{case.acquisition.name}: {judged.fit.count} vectors")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), fontsize=7.5)
    axes[0, 0].set_ylabel("along Y [arcsec]")
    return figure


def _offsets(case: Case) -> FloatArray:
    return tangent_plane(case.evaluation.vectors, case.evaluation.fit.mean) * RAD_ARCSEC


def _inside(case: Case) -> float:
    """Part of the vectors within the circle that should hold 95 %."""
    radius = np.linalg.norm(_offsets(case)[~case.evaluation.outlier], axis=1)
    return float(np.mean(radius <= _HELD * case.evaluation.sigma_arcsec))


def _ellipse(case: Case) -> Ellipse:
    found = case.evaluation.isotropy
    along = tangent_basis(case.evaluation.fit.mean) @ found.direction
    turn = float(np.degrees(np.arctan2(along[1], along[0])))
    size = 2 * found.major_rad * RAD_ARCSEC, 2 * found.minor_rad * RAD_ARCSEC
    return Ellipse((0, 0), *size, angle=turn, fill=False, color=INK, linewidth=1.0, zorder=5)


def quantile_plots(result: Result) -> Figure:
    """k (1 - cos) of every vector against the exponential distribution."""
    cases = result.bench.cases
    figure, axes = new_figure(1, len(cases), aspect_ratio=0.45, squeeze=False, sharey=True)
    for axis, case in zip(axes[0], cases, strict=True):
        tails = case.evaluation.tails
        rank = np.arange(1, len(tails.found) + 1) / (len(tails.found) + 1)
        spread = np.sqrt(rank / (1 - rank) / len(tails.found))  # of an exponential quantile, to first order
        axis.fill_between(
            tails.expected,
            np.maximum(tails.expected - 1.96 * spread, 0),
            tails.expected + 1.96 * spread,
            color=_FAINT,
            alpha=0.25,
            linewidth=0,
            label="95 % of a quantile",
        )
        axis.plot(tails.expected, tails.expected, color=INK, linewidth=0.8)
        axis.plot(tails.expected, tails.found, ".", color=PALETTE[0], markersize=3.5)
        verdict = "not refused at 15 %" if tails.level == 1.0 else f"refused at {100 * tails.level:g} %"
        axis.set_title(f"{case.acquisition.name}: Kolmogorov {tails.statistic:.2f}, {verdict}")
        axis.set_xlabel("exponential quantile")
    axes[0, 0].set_ylabel("k (1 − cos θ)")
    axes[0, 0].legend(loc="upper left")
    return figure


def cause_bars(result: Result) -> Figure:
    """Expected and realised causes of the scatter."""
    cases = result.bench.cases
    figure, axes = new_figure(1, len(cases), aspect_ratio=0.36, squeeze=False, sharey=True)
    for axis, case in zip(axes[0], cases, strict=True):
        expected, realised = case.expected_arcsec, case.realised_arcsec
        table = float(np.hypot(expected["readings"], expected["clocks"]))
        rows = (
            ("centroids", expected["centroids"], realised["centroids"]),
            ("table", table, realised["table"]),
            ("calibration", expected["calibration"], realised["camera"]),
            ("all", case.predicted.sigma_arcsec, None),
        )
        for i, (_, first, second) in enumerate(rows):
            axis.bar(i - 0.18, first, 0.34, color=_FAINT, label="expected" if i == 0 else None)
            if second is not None:
                axis.bar(i + 0.18, second, 0.34, color=PALETTE[0], label="realised" if i == 0 else None)
        low, high = case.evaluation.interval_arcsec(LEVEL)
        sigma = case.evaluation.sigma_arcsec
        axis.errorbar(
            [len(rows) - 1 + 0.18],
            [sigma],
            [[sigma - low], [high - sigma]],
            fmt="o",
            color=PALETTE[1],
            label="Fisher, 95 %",
        )
        axis.set_xticks(range(len(rows)), [name for name, _, _ in rows])
        axis.grid(visible=False, axis="x")
        axis.set_title(case.acquisition.name)
    axes[0, 0].set_ylabel("per axis [arcsec]")
    axes[0, 0].legend(loc="upper left")
    return figure


def error_arrows(result: Result) -> Figure:
    """Star vectors over the detector: where the image was, and how far the vector is from their mean."""
    figure, axes = new_figure(1, len(result.bench.cases), aspect_ratio=0.32, squeeze=False, sharey=True)
    camera = result.instrument.camera
    longest = max(float(np.linalg.norm(_offsets(case), axis=1).max()) for case in result.bench.cases)
    scale = longest / (2.2 * camera.width_px / result.config.evaluation.columns)
    for axis, case in zip(axes[0], result.bench.cases, strict=True):
        place, offset = case.acquisition.position_px, _offsets(case)
        width, height = camera.width_px - 0.5, camera.height_px - 0.5
        axis.plot([-0.5, width, width, -0.5, -0.5], [-0.5, -0.5, height, height, -0.5], color="#8a9099", linewidth=0.8)
        arrows = axis.quiver(
            *place.T, *offset.T, angles="xy", scale_units="xy", scale=scale, color=PALETTE[0], width=0.0022
        )
        axis.scatter(*place.T, s=1.5, color=INK, linewidths=0)
        key = float(f"{longest / 2:.0e}")
        axis.quiverkey(arrows, 0.86, 1.04, key, f"{key:g}″", labelpos="E", fontproperties={"size": 7.5})
        axis.set(xlim=(-60, width + 60), ylim=(height + 60, -60), aspect="equal", xlabel="column [px]")
        axis.grid(visible=False)
        axis.set_title(case.acquisition.name)
    axes[0, 0].set_ylabel("row [px]")
    return figure


def star_windows(result: Result) -> Figure:
    """Single frames of four places, at rest and on the move."""
    figure, axes = new_figure(2, 5, aspect_ratio=0.42)
    for row, case in zip(axes, result.bench.cases, strict=True):
        stack = case.acquisition.windows
        chosen = np.linspace(0, stack.dn.shape[1] - 1, len(row)).astype(int)
        for axis, at in zip(row, chosen, strict=True):
            _window(axis, case, int(at))
        row[0].set_ylabel(case.acquisition.name)
    return figure


def _window(axis: Any, case: Case, at: int) -> None:
    stack = case.acquisition.windows
    size = stack.dn.shape[-1]
    electrons = (stack.dn[0, at].astype(float) - stack.offset_dn) / stack.gain_dn_per_e
    column, row = (int(v) for v in stack.corner_px[at])
    extent = (column - 0.5, column + size - 0.5, row + size - 0.5, row - 0.5)
    axis.imshow(np.where(stack.defect[at], np.nan, electrons), extent=extent, vmin=-40)
    centre = np.array([column, row]) + size / 2
    near = int(np.argmin(np.linalg.norm(case.acquisition.bundle_px - centre, axis=1)))
    axis.plot(*case.acquisition.bundle_px[near], "+", color="white", markersize=7, markeredgewidth=0.9)
    axis.plot(*case.acquisition.position_px[near], "x", color=PALETTE[1], markersize=4, markeredgewidth=0.9)
    axis.set(xticks=[], yticks=[], xlim=extent[:2], ylim=extent[2:])
    axis.grid(visible=False)
    axis.set_title(f"{centre[0]:.0f}, {centre[1]:.0f}", fontsize=7, pad=3)
