"""Figures of a sweep: curves over one key, maps over two."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.camera.sweep.quantities import PLACES
from experiments.camera.sweep.study import SweepStudy
from experiments.camera.verdicts import AT_LEAST
from experiments.harness.plotting import INK, PALETTE, new_figure, spaced_axis
from experiments.harness.quantities import Outcome
from optics.arrays import FloatArray

__all__ = ["curves", "maps"]


ACROSS = 2
_NOW = "#8a9099"
_MISSED = "#d55e00"


def curves(outcome: Outcome) -> Figure:
    """Main quantities against the swept key; what is required, and where it is crossed; frames with 3 sigma."""
    result: SweepStudy = outcome.result
    figure, axes = _panels(len(result.shown), 0.22)
    at, now = np.array(result.axes[0].values), _value_now(result, 0)
    for panel, name in zip(axes, result.shown, strict=False):
        one = outcome.quantity(name)
        panel.plot(at, one.values, color=PALETTE[0], marker="o", markersize=3)
        _required(panel, result, name, one.values)
        for crossing in (c for c in result.crossings if c.name == name):
            panel.axvline(crossing.at, color=_MISSED, linewidth=0.9)
        if f"measured_{name}" in outcome.data:
            seen, error = outcome.values(f"measured_{name}"), outcome.errors(f"measured_{name}")
            panel.errorbar(at, seen, 3.0 * error, fmt="s", color=INK, markersize=3.5, label="frames, 3σ")
            panel.legend(fontsize=7)
        if now is not None and min(at) <= now <= max(at):
            panel.axvline(now, color=_NOW, linewidth=1.0, dashes=(1, 2))
        panel.set_title(one.heading)
        if np.isfinite(one.values).any() and np.nanmin(one.values) > 0 and name.endswith(("_arcsec", "_px")):
            panel.set_ylim(0, None)
        panel.set_xlabel(outcome.quantity(PLACES[0]).heading)
        spaced_axis(panel, "x", result.axes[0].values)
    return figure


def maps(outcome: Outcome) -> Figure:
    """Main quantities over two keys; the line is what is required, points that miss any requirement are crossed out."""
    result: SweepStudy = outcome.result
    figure, axes = _panels(len(result.shown), 0.33)
    first, second = (np.array(axis.values) for axis in result.axes)
    missed = ~result.met if result.required else np.zeros(len(result.points), dtype=bool)
    places = np.array([point.at for point in result.points])
    for panel, name in zip(axes, result.shown, strict=False):
        one = outcome.quantity(name)
        values = result.grid(name).T
        drawn = panel.pcolormesh(first, second, np.ma.masked_invalid(values), shading="nearest", cmap="cividis")
        figure.colorbar(drawn, ax=panel, pad=0.02)
        required = result.required.get(name)
        if required is not None and np.nanmin(values) < required < np.nanmax(values) and min(values.shape) > 1:
            panel.contour(first, second, values, levels=[required], colors=_MISSED, linewidths=1.4)
        for colour, thickness in ((INK, 2.2), ("white", 0.9)):  # seen on every ground
            panel.plot(*places[missed].T, "x", color=colour, markersize=3.5, markeredgewidth=thickness)
        panel.set_title(one.heading)
        panel.set(xlabel=outcome.quantity(PLACES[0]).heading, ylabel=outcome.quantity(PLACES[1]).heading)
        panel.grid(visible=False)
        spaced_axis(panel, "x", result.axes[0].values)
        spaced_axis(panel, "y", result.axes[1].values)
    return figure


def _panels(count: int, height: float) -> tuple[Figure, list[Any]]:
    rows = -(-count // ACROSS)
    figure, axes = new_figure(rows, ACROSS, aspect_ratio=height * rows + 0.05, squeeze=False)
    flat = list(axes.ravel())
    for panel in flat[count:]:
        panel.set_visible(False)
    return figure, flat


def _required(panel: Any, result: SweepStudy, name: str, values: FloatArray) -> None:
    """The limit as a line, the side that misses it shaded."""
    required = result.required.get(name)
    if required is None:
        return
    panel.axhline(required, color=_MISSED, linewidth=0.9, dashes=(4, 3))
    low, high = panel.get_ylim()
    known = values[np.isfinite(values)]
    span = max(high - low, 1e-12) if known.size else 1.0
    low, high = min(low, required - 0.06 * span), max(high, required + 0.06 * span)
    panel.set_ylim(low, high)
    edge = low - span if name in AT_LEAST else high + span
    panel.axhspan(*sorted((required, edge)), color=_MISSED, alpha=0.07, linewidth=0, zorder=0)
    panel.set_ylim(low, high)


def _value_now(result: SweepStudy, axis: int) -> float | None:
    """Value of the swept key in the sensor as it is; None where its file leaves that open."""
    from experiments.harness.range import value_at

    value = value_at(result.config, result.axes[axis].key)
    return None if value is None else float(value)
