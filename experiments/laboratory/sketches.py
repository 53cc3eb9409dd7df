"""Sketches of benches and of the camera model for reports: drawn anew, by what the documents say of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, FancyArrowPatch, Polygon, Rectangle
from numpy.typing import ArrayLike

from experiments.harness.plotting import INK, PALETTE, new_figure

__all__ = ["camera_model", "collimator_bench"]

FILL, FAINT, LIGHT = "#eef0f2", "#8a9099", "#e6a817"


def _canvas(width: float, height: float) -> tuple[Figure, Any]:
    """Empty sheet in units of its own, y upwards."""
    figure, sheet = new_figure(aspect_ratio=height / width)
    sheet.set(xlim=(0, width), ylim=(0, height), aspect="equal")
    sheet.axis("off")
    return figure, sheet


def _word(sheet: Any, place: ArrayLike, text: str, **options: Any) -> None:
    sheet.text(*np.asarray(place), text, **{"ha": "center", "va": "center", "fontsize": 7.5, "color": INK} | options)


def _box(sheet: Any, x: float, y: float, width: float, height: float, colour: str = FILL) -> None:
    sheet.add_patch(Rectangle((x, y), width, height, facecolor=colour, edgecolor=INK, linewidth=0.8))


def _arrow(sheet: Any, start: Any, end: Any, colour: str = INK, **options: Any) -> None:
    drawn: dict[str, Any] = {
        "arrowstyle": "-|>",
        "mutation_scale": 7,
        "linewidth": 0.8,
        "shrinkA": 0,
        "shrinkB": 0,
    } | options
    sheet.add_patch(FancyArrowPatch(tuple(start), tuple(end), color=colour, **drawn))


def collimator_bench(*, filters: bool = False) -> Figure:
    """The bench of ACC18 (section 1.2): lamp, target, collimator, camera on a hexapod, all on one isolated table."""
    figure, sheet = _canvas(20.0, 7.4)
    axis = 4.6
    _box(sheet, 0.4, 0.9, 19.2, 0.55)
    _word(sheet, (10.0, 1.17), "optical table")
    for x in (2.0, 10.0, 18.0):
        _box(sheet, x - 0.5, 0.15, 1.0, 0.75, "#ffffff")
    _word(sheet, (14.0, 0.45), "vibration isolation", color=FAINT)
    sheet.add_patch(Circle((1.3, axis), 0.42, facecolor=LIGHT, edgecolor=INK, linewidth=0.8))
    _word(sheet, (1.3, axis + 0.85), "lamp")
    target = 3.1
    _box(sheet, target - 0.1, axis - 0.75, 0.2, 1.5, "#ffffff")
    for y in np.linspace(-0.5, 0.5, 5):
        sheet.plot(target, axis + y, ".", color=LIGHT, markersize=4, markeredgewidth=0)
    _word(sheet, (2.3, axis - 1.3), "points in the\nfocal plane", va="top")
    if filters:
        _box(sheet, 3.75, axis - 0.85, 0.14, 1.7, PALETTE[5])
        _word(sheet, (4.2, axis + 1.35), "filter", color=PALETTE[0])
    lens = 9.4
    sheet.add_patch(Polygon([(2.6, axis - 1.05), (lens + 0.5, axis - 1.25), (lens + 0.5, axis + 1.25),
                             (2.6, axis + 1.05)], closed=True, fill=False, edgecolor=FAINT, linewidth=0.8))  # fmt: skip
    sheet.add_patch(Ellipse((lens, axis), 0.42, 2.2, facecolor=FILL, edgecolor=INK, linewidth=0.8))
    _word(sheet, (6.6, axis + 1.65), "collimator")
    for x in (4.6, 8.4):
        _box(sheet, x - 0.2, 1.45, 0.4, axis - 1.15 - 1.45 - 0.02 * x)
    front, back = 13.4, 16.4
    for offset, colour in ((0.0, PALETTE[0]), (0.45, PALETTE[1])):
        for edge in (-0.75, 0.0, 0.75):
            tilt = -0.11 * offset * (front - lens) / 4.0
            height = (offset, edge, edge + tilt, -0.9 * offset)
            sheet.plot((target, lens, front, back), np.add(axis, height), color=colour, linewidth=0.6)
    _box(sheet, front - 0.5, axis - 1.15, 4.1, 2.3, "none")
    sheet.add_patch(Ellipse((front, axis), 0.36, 2.0, facecolor=FILL, edgecolor=INK, linewidth=0.8))
    _box(sheet, back, axis - 0.9, 0.16, 1.8, PALETTE[0])
    _word(sheet, (15.0, axis + 1.55), "star camera")
    _word(sheet, (back + 0.75, axis), "detector", rotation=90)
    _word(sheet, (11.4, axis + 1.25), "parallel light,\na direction per point", color=FAINT)
    top, foot = 3.0, 1.75
    _box(sheet, 12.7, top, 4.5, 0.25)
    sheet.plot([14.95, 14.95], [top + 0.25, axis - 1.15], color=INK, linewidth=3)
    _box(sheet, 12.4, 1.45, 5.1, 0.3)
    for x in np.linspace(12.8, 16.0, 3):
        for a, b in ((x, x + 0.55), (x + 1.1, x + 0.55)):
            sheet.plot([a, b], [foot, top], color=INK, linewidth=1.6, solid_capstyle="round")
    _word(sheet, (18.0, 2.4), "hexapod", ha="left")
    return figure


def camera_model() -> Figure:
    """The camera model of ACF17 (section 2): projection centre, focal length, principal point, distorted image."""
    figure, sheet = _canvas(16.0, 8.6)
    centre = np.array([2.6, 4.1])
    across, up, along = np.array([-1.15, -0.8]), np.array([0.0, 1.8]), np.array([1.0, 0.0])
    plane = centre + 5.6 * along
    corners = [plane + a * across * 1.6 + b * up * 1.35 for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    sheet.add_patch(Polygon(corners, closed=True, facecolor=FILL, edgecolor=INK, linewidth=0.8))
    _word(sheet, np.add(corners[3], (0.0, 0.3)), "detector")
    for name, step, where in (("$X_s$", 1.35 * across, (-0.3, -0.15)), ("$Y_s$", 0.85 * up, (0.0, 0.3))):
        _arrow(sheet, centre, centre + step)
        _word(sheet, centre + step + where, name)
    _arrow(sheet, centre, centre + 10.6 * along, linestyle="--", linewidth=0.7)
    _word(sheet, np.add(centre, (10.95, 0.0)), "$Z_s$")
    _word(sheet, np.add(centre, (-0.35, 0.3)), "O")
    middle = plane - 0.7 * across + 0.12 * up
    for name, at, where, colour in (
        ("principal point", plane, (0.15, -0.35), PALETTE[0]),
        ("middle of the detector", middle, (0.2, -0.05), FAINT),
    ):
        sheet.plot(*at, "+", color=colour, markersize=8, markeredgewidth=1.2)
        _word(sheet, at + where, name, ha="left", color=colour, fontsize=6.8)
    _arrow(sheet, middle, plane, PALETTE[0])
    _word(sheet, (plane[0] + 0.75, plane[1] + 0.2), "$(x_0, y_0)$", ha="left", fontsize=6.8, color=PALETTE[0])
    ideal = plane + 0.55 * across + 0.72 * up
    real = plane + 0.55 * 1.55 * across + 0.72 * 1.55 * up
    ray = ideal - centre
    _arrow(sheet, centre, centre + 2.0 * ray, PALETTE[4], linewidth=1.0)
    star = centre + 2.0 * ray
    sheet.plot(*star, "*", color=PALETTE[4], markersize=11, markeredgewidth=0)
    _word(sheet, np.add(star, (0.35, 0.25)), "star P", ha="left")
    sheet.plot(*ideal, "o", color=PALETTE[2], markersize=4)
    sheet.plot(*real, "o", color=PALETTE[1], markersize=4)
    _arrow(sheet, ideal, real, PALETTE[1])
    _word(sheet, np.add(ideal, (0.25, -0.3)), "Q, ideal", ha="left", color=PALETTE[2], fontsize=6.8)
    _word(sheet, np.add(real, (-0.3, 0.2)), "Q′, imaged: (dx, dy)", ha="right", color=PALETTE[1], fontsize=6.8)
    low = centre[1] - 3.8
    _arrow(sheet, (centre[0], low), (plane[0], low), arrowstyle="<|-|>")
    for x in (centre[0], plane[0]):
        sheet.plot([x, x], [low - 0.15, low + 0.15], color=INK, linewidth=0.8)
    _word(sheet, ((centre[0] + plane[0]) / 2, low + 0.3), "f + Δf")
    return figure
