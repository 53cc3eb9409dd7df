"""Drawings that the tests with point targets share: clouds of centroids, residuals of steps, arrows on the detector."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure
from experiments.laboratory.instrument import Instrument
from optics.arrays import FloatArray

__all__ = ["arrows", "centroid_cloud", "detector_outline", "draw_cloud", "step_residuals"]

ELLIPSES = (PALETTE[1], INK)
"""Colours of the ellipses over a cloud."""


def draw_cloud(
    panel: Any, places: FloatArray, ellipses: Mapping[str, Sequence[float] | FloatArray], **points: Any
) -> None:
    """Places (..., 2) [arcsec] as points, half-axes (x, y) [arcsec] by name as ellipses about zero."""
    panel.plot(*places.reshape(-1, 2).T, ".", **points)
    turn = np.linspace(0, 2 * np.pi, 181)
    for (label, (x, y)), colour in zip(ellipses.items(), ELLIPSES, strict=False):
        panel.plot(x * np.cos(turn), y * np.sin(turn), color=colour, label=label)
    panel.set(xlabel="x [″]", ylabel="y [″]", aspect="equal")


def centroid_cloud(
    position_px: FloatArray, pixel_arcsec: float, ellipses: Mapping[str, Sequence[float] | FloatArray] | None = None
) -> Figure:
    """Centroids (f, j, 2) of all frames of all points about the mean of each point."""
    place = (position_px - np.nanmean(position_px, axis=0)) * pixel_arcsec
    figure, panel = new_figure(width="half", aspect_ratio=1.0)
    draw_cloud(panel, place, ellipses or {}, color=PALETTE[0], markersize=1.6, alpha=0.5)
    reach = 1.15 * float(np.nanmax(np.abs(place)))
    panel.set(xlim=(-reach, reach), ylim=(-reach, reach))
    if ellipses:
        panel.legend(loc="upper right")
    return figure


def step_residuals(residual_arcsec: FloatArray, ellipses: Mapping[str, Sequence[float] | FloatArray]) -> Figure:
    """ACC18 Fig. 6: residuals (m - 1, j, 2) of all stars step by step, and as a cloud with the 3 sigma ellipses."""
    figure, axes = new_figure(1, 2, aspect_ratio=0.42, width_ratios=(1.7, 1.0))
    steps, stars = residual_arcsec.shape[:2]
    for axis, colour, marker in zip(range(2), PALETTE, MARKERS, strict=False):
        number = np.arange(steps * stars)
        axes[0].plot(number, residual_arcsec[..., axis].ravel(), marker, color=colour, markersize=2.2, label="xy"[axis])
    for edge in range(1, steps):
        axes[0].axvline(edge * stars - 0.5, color="#e3e5e8", linewidth=0.8)
    axes[0].set_xticks((np.arange(steps) + 0.5) * stars, [f"{k + 1}" for k in range(steps)])
    axes[0].grid(visible=False, axis="x")
    axes[0].set(xlabel="step", ylabel="residual [″]", xlim=(-1, steps * stars))
    axes[0].legend(loc="upper right", ncols=2)
    draw_cloud(axes[1], residual_arcsec, ellipses, color="#8a9099", markersize=2.5)
    axes[1].legend(loc="upper center", bbox_to_anchor=(0.5, 1.16), ncols=2, columnspacing=1.0)
    return figure


def detector_outline(panel: Any, width_px: int, height_px: int, instrument: Instrument | None = None) -> None:
    """Edge of a detector, and the seams between the chips of an instrument; row 0 is at the top."""
    x, y = (-0.5, width_px - 0.5), (-0.5, height_px - 0.5)
    panel.plot([x[0], x[1], x[1], x[0], x[0]], [y[0], y[0], y[1], y[1], y[0]], color="#8a9099", linewidth=0.8)
    if instrument is not None:
        chip = instrument.detector
        for seam in range(1, chip.chips):
            panel.axvline(seam * (chip.chip_width_px + chip.gap_px) - 0.5, color="#c3c8ce", linewidth=0.8)
    margin = 0.03 * max(width_px, height_px)
    panel.set(xlim=(-margin, width_px + margin), ylim=(height_px + margin, -margin), aspect="equal")
    panel.grid(visible=False)


def arrows(
    panel: Any, place_px: FloatArray, error_arcsec: FloatArray, *, longest_px: float, color: str, width: float
) -> float:
    """Errors (n, 2) [arcsec] as arrows at places (n, 2), the longest ``longest_px`` long; returns its size [arcsec]."""
    longest = float(np.linalg.norm(error_arcsec, axis=1).max())
    scale = longest / longest_px
    panel.quiver(*place_px.T, *error_arcsec.T, angles="xy", scale_units="xy", scale=scale, color=color, width=width)
    return longest
