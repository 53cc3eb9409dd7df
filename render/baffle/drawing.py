"""Section through a baffle in front of its lens (`optics.figures.draw_lens`), with the paths of most light."""

from __future__ import annotations

from typing import Any

import numpy as np

from render.baffle.light import WorstPaths
from render.baffle.mesh import Mesh
from render.baffle.vaned_baffle import VanedBaffle

WIDTH_IN = 7.6
INK, WARM, SUN = "#222222", "#d55e00", "#b07000"


def draw_baffle(panel: Any, baffle: VanedBaffle | Mesh, *, first_mm: float, entrance_mm: float) -> tuple[float, float]:
    """Draw walls and vanes, or the vertices of a mesh, in front of the first surface at z; length and radius [mm]."""
    if isinstance(baffle, Mesh):
        z, height = baffle.vertex_mm[:, 2], np.hypot(*baffle.vertex_mm[:, :2].T)
        for side in (1.0, -1.0):
            panel.plot(first_mm - z, side * height, ",", color=INK)
        return float(z.max()), float(height.max())
    front = first_mm - baffle.length_mm
    for side in (-1.0, 1.0):
        wall = side * baffle.tube_mm
        panel.plot([front, first_mm, first_mm], [wall, wall, side * entrance_mm], color=INK, linewidth=1.4)
        for z, tip in zip(baffle.vane_z_mm, baffle.vane_mm, strict=True):
            panel.plot([first_mm - z, first_mm - z], [side * tip, wall], color=INK, linewidth=1.2)
    return baffle.length_mm, baffle.tube_mm


def draw_paths(panel: Any, paths: WorstPaths, *, first_mm: float) -> None:
    """Lines from the first surfaces to the entrance, rotated into the plane of the drawing; width by their light."""
    for point, start, fraction in zip(paths.point_mm, paths.entrance_mm, paths.fraction, strict=True):
        height = float(np.hypot(*point[:2]))
        side = np.sign(point[0]) or 1.0
        width = 0.3 + 1.2 * fraction / paths.fraction.max()
        ends = [side * height, side * float(start[:2] @ point[:2]) / max(height, 1e-9)]
        panel.plot([first_mm - point[2], first_mm], ends, color=WARM, linewidth=width, alpha=0.6)


def frame_section(panel: Any, length_mm: float, radius_mm: float, *, first_mm: float, sun_deg: float) -> None:
    """Limits of the drawing about lens and baffle, and an arrow from the Sun."""
    angle, front, left = np.radians(sun_deg), first_mm - length_mm, first_mm - 1.4 * length_mm
    start = front - 0.3 * length_mm * np.cos(angle), 0.3 * length_mm * np.sin(angle)
    arrow = {"arrowstyle": "->", "color": "#f0a000"}
    panel.annotate(
        f"Sun, {sun_deg:.0f}°", xy=(front, 0.0), xytext=start, ha="center", arrowprops=arrow, fontsize=8, color=SUN
    )
    right = panel.get_xlim()[1]
    panel.set_xlim(left, right)
    panel.set_ylim(-1.35 * radius_mm, 1.35 * radius_mm)
    panel.figure.set_size_inches(WIDTH_IN, max(WIDTH_IN * 2.7 * radius_mm / (right - left), 2.2))
