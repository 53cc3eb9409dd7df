"""Figures of the turntable calibration: what was measured, and how far it is from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from experiments.harness.plotting import INK, PALETTE, new_figure
from experiments.turntable.result import Case, Result

__all__ = ["error_maps", "residual_arrows", "star_windows", "visited_places"]


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


def visited_places(result: Result) -> Figure:
    """Where the image went, in the order it went, on both tables."""
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


def star_windows(result: Result) -> Figure:
    """One frame of the window at nine places of the field."""
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
        axis.grid(visible=False)
        axis.set_title(f"{place[at, 0]:.0f}, {place[at, 1]:.0f}", fontsize=7, pad=3)
    return figure


def residual_arrows(result: Result) -> Figure:
    """Residuals of the fit on the two-axis table, the axes taken as square and their angle estimated."""
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
        chi2 = case.reductions[name].calibration.solution.reduced_chi2
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


def error_maps(result: Result, cases: Sequence[Case]) -> Figure:
    """Line-of-sight error after the best rotation, and its predicted standard deviation, on one scale."""
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
