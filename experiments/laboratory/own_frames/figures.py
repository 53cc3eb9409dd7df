"""Figures of frames from outside that several experiments show."""

from __future__ import annotations

from matplotlib.figure import Figure

from experiments.harness.quantities import Outcome
from experiments.laboratory import point_figures

__all__ = ["POINTS", "cloud"]

POINTS = "All frames of all points about each point's mean, last series."
"""Caption of `cloud`."""


def cloud(outcome: Outcome) -> Figure:
    """Centroids of all frames of all points about their means, last series."""
    reduced, first = outcome.result.reduced, outcome.result.methods[0]
    scale = outcome.result.folder.settings.pixel_arcsec
    return point_figures.centroid_cloud(reduced.series[-1].points.position_px[first], scale)
