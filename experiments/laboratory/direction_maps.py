"""Figures of vectors over the detector: length as colour, direction as arrows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.harness.plotting import new_figure
from optics.arrays import FloatArray

__all__ = ["VectorPanel", "pixel_axes", "vector_maps"]

ARROWS = 11
"""Along the longer side."""
SHOWN_PERCENT = 99.5
"""Of the lengths, the colours reach."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VectorPanel:
    """One map of `vector_maps`."""

    title: str  # Above it
    vector: FloatArray  # (r, c, 2) At every place of the grid
    arrows: bool = True  # Whether directions mean something; those of standard deviations do not


def pixel_axes(axis: Any, size_px: tuple[int, int], *, labels: bool = True) -> None:
    """Limits of the detector (width, height), rows downwards, framed."""
    width, height = size_px
    axis.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    axis.grid(visible=False)
    for spine in axis.spines.values():
        spine.set_visible(True)
    if labels:
        axis.set(xlabel="column [px]", ylabel="row [px]")
    else:
        axis.set(xticks=[], yticks=[])


def vector_maps(panels: Sequence[VectorPanel], place_px: FloatArray, *, size_px: tuple[int, int], label: str) -> Figure:
    """Maps two in a row with one scale of colour, each with its own length of arrows."""
    rows = math.ceil(len(panels) / 2)
    figure, axes = new_figure(rows, 2, aspect_ratio=rows * (0.08 + 0.43 * size_px[1] / size_px[0]), squeeze=False)
    lengths = [np.linalg.norm(panel.vector, axis=-1) for panel in panels]
    high = max(float(np.nanpercentile(length, SHOWN_PERCENT)) for length in lengths)
    mesh: Any = None
    for axis, panel, length in zip(axes.ravel(), panels, lengths, strict=False):
        x, y = place_px[..., 0], place_px[..., 1]
        mesh = axis.pcolormesh(x, y, length, shading="gouraud", vmin=0.0, vmax=high, cmap="magma_r", rasterized=True)
        if panel.arrows and np.nanmax(length) > 0:
            _draw_arrows(axis, place_px, panel.vector, size_px[0])
        pixel_axes(axis, size_px, labels=False)
        axis.set_title(panel.title)
    figure.colorbar(mesh, ax=axes, label=label, shrink=0.9, aspect=30)
    return figure


def _draw_arrows(axis: Any, place_px: FloatArray, vector: FloatArray, width_px: int) -> None:
    """Some of the vectors; long ones are cut to the length of most."""
    length, columns = np.linalg.norm(vector, axis=-1), vector.shape[1]
    step = max(1, round(columns / ARROWS))
    some = (slice(step // 2, None, step), slice(step // 2, None, step))
    typical = np.nanpercentile(length, 85)
    shown = (vector * np.minimum(1.0, typical / np.maximum(length, 1e-300))[..., None])[some]
    axis.quiver(
        *np.moveaxis(place_px[some], -1, 0),
        *np.moveaxis(shown, -1, 0),
        angles="xy",
        scale_units="xy",
        scale=typical / (0.9 * step * width_px / columns),
        width=0.005,
        color="#2b6ca3",
    )
