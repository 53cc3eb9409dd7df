"""Residuals of the step test, step by step and as a cloud."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.plotting import INK, MARKERS, PALETTE, new_figure
from optics.arrays import FloatArray

__all__ = ["draw_cloud", "step_residuals"]

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
