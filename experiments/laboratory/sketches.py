"""Sketches of benches and of the camera model for reports: drawn anew, by what the documents say of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, Polygon, Rectangle
from numpy.typing import ArrayLike

from experiments.harness.plotting import INK, PALETTE, new_figure

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
