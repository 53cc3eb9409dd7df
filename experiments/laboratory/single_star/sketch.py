"""Drawing of the bench: single-star simulator, turntable, camera; what is known and what is sought."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrowPatch, FancyBboxPatch, Polygon, Rectangle

from experiments.harness.plotting import INK, PALETTE, new_figure

_STONE, _METAL, _DARK, _BEAM = "#d9dce0", "#b9c0c8", "#5b636d", "#ffe9a8"
_BLUE, _RED, _GREEN = PALETTE[0], PALETTE[1], PALETTE[2]


def bench_sketch(axes: str) -> Figure:
    """The bench seen from the side, with the unknowns in colour."""
    figure, axis = new_figure(aspect_ratio=0.40)
    axis.set(xlim=(0, 19), ylim=(0, 7.6), aspect="equal")
    axis.axis("off")
    axis.add_patch(FancyBboxPatch((0.3, 0.25), 18.4, 0.7, boxstyle="round,pad=0.05", fc=_STONE, ec=_METAL))
    axis.text(9.5, 0.6, "optical bench", ha="center", va="center", fontsize=7.5, color=_DARK)
    _simulator(axis)
    _table(axis, axes)
    _camera(axis)
    _unknowns(axis)
    return figure


def _simulator(axis: Any) -> None:
    for x in (1.5, 4.3):
        axis.add_patch(Rectangle((x, 0.95), 0.5, 2.1, fc=_METAL, ec="none"))
    axis.add_patch(FancyBboxPatch((0.8, 3.0), 4.6, 1.7, boxstyle="round,pad=0.06", fc="#eef0f2", ec=_METAL, lw=1.0))
    axis.add_patch(Polygon([(1.35, 3.85), (5.2, 4.45), (5.2, 3.25)], fc=_BEAM, ec="none"))
    axis.add_patch(Polygon([(5.2, 4.45), (12.6, 4.45), (12.6, 3.25), (5.2, 3.25)], fc=_BEAM, ec="none", alpha=0.75))
    half = np.linspace(-0.68, 0.68, 40)
    bulge = 0.16 * (1 - (half / 0.68) ** 2)
    axis.fill(np.r_[5.2 - bulge, 5.2 + bulge[::-1]], 3.85 + np.r_[half, half[::-1]], fc="#cfe3f2", ec=_BLUE, lw=0.9)
    axis.plot([1.35], [3.85], "*", color="#c98a00", markersize=9)
    axis.text(3.1, 5.0, "single-star simulator", ha="center", fontsize=8.5)
    axis.text(1.35, 3.3, "lamp,\npinhole", ha="center", va="center", fontsize=6.5, color=_DARK)


def _table(axis: Any, axes: str) -> None:
    axis.add_patch(Rectangle((11.4, 0.95), 5.0, 0.5, fc=_METAL, ec=_DARK, lw=0.6))
    axis.add_patch(Polygon([(13.2, 1.45), (14.6, 1.45), (14.3, 2.2), (13.5, 2.2)], fc=_METAL, ec=_DARK, lw=0.6))
    axis.add_patch(Rectangle((12.0, 2.2), 3.9, 0.35, fc=_DARK, ec="none"))
    axis.plot([13.95, 13.95], [1.2, 6.4], color=_DARK, lw=0.8, ls=(0, (7, 2, 1, 2)), zorder=1)
    axis.add_patch(Arc((13.95, 6.25), 1.5, 0.5, theta1=200, theta2=520, color=_DARK, lw=1.0))
    axis.add_patch(_arrow((14.55, 6.42), (14.28, 6.5), _DARK))
    square = axes in ("xy", "xyz")  # the drawing is of these; others are only named
    inner, outer = ("Y′", "X′") if square else ("carried", "outer")
    axis.text(14.9, 6.35, f"axis {inner}" + (", carried" if square else ""), fontsize=7.5, color=_DARK, va="center")
    axis.add_patch(Circle((13.95, 3.85), 0.42, fc="white", ec=_DARK, lw=1.0, zorder=6))
    axis.add_patch(Circle((13.95, 3.85), 0.09, fc=_DARK, ec="none", zorder=7))
    axis.text(
        16.7,
        2.35,
        f"axis {outer}" + (", outer\n(towards the reader)" if square else ""),
        fontsize=7.5,
        color=_DARK,
        va="center",
    )
    axis.plot([14.3, 16.6], [3.6, 2.5], color=_DARK, lw=0.6, zorder=5)


def _camera(axis: Any) -> None:
    axis.add_patch(FancyBboxPatch((12.9, 3.0), 2.5, 1.7, boxstyle="round,pad=0.04", fc="#e6ebf1", ec=_BLUE, lw=1.1))
    axis.add_patch(Polygon([(12.9, 3.15), (12.35, 3.05), (12.35, 4.65), (12.9, 4.55)], fc="#e6ebf1", ec=_BLUE, lw=1.1))
    axis.add_patch(Rectangle((13.3, 2.55), 1.7, 0.4, fc="#c6ccd4", ec=_DARK, lw=0.6))
    axis.plot([14.95, 14.95], [3.35, 4.35], color=_BLUE, lw=2.6, solid_capstyle="butt")
    axis.text(15.7, 4.75, "star camera", fontsize=8.5, color=INK)


def _unknowns(axis: Any) -> None:
    axis.add_patch(_arrow((11.2, 5.15), (7.4, 5.35), _RED, width=1.5))
    axis.text(7.3, 5.6, "star direction  s: 2 unknowns", fontsize=8, color=_RED)
    axis.text(
        15.7, 4.05, "intrinsics: 8 unknowns\n(principal point, f, distortion)", fontsize=7.5, color=_BLUE, va="center"
    )
    axis.annotate(
        "installation  M: 3 unknowns",
        xy=(13.25, 2.75),
        xytext=(6.6, 2.25),
        fontsize=8,
        color=_GREEN,
        va="center",
        arrowprops={"arrowstyle": "-", "color": _GREEN, "lw": 0.9},
    )
    for tip, label, place in (((1.0, 6.3), "Z", (0.7, 6.3)), ((1.9, 7.2), "Y", (1.9, 7.4))):
        axis.add_patch(_arrow((1.9, 6.3), tip, INK))
        axis.text(*place, label, fontsize=7.5, ha="center", va="center")
    axis.add_patch(Circle((1.9, 6.3), 0.12, fc="white", ec=INK, lw=0.8))
    axis.add_patch(Circle((1.9, 6.3), 0.03, fc=INK))
    axis.text(2.15, 6.15, "X", fontsize=7.5, va="center")
    axis.text(2.7, 6.6, "laboratory = table at zero angles", fontsize=7.5, color=_DARK, va="center")


def _arrow(start: tuple[float, float], end: tuple[float, float], colour: str, width: float = 1.0) -> FancyArrowPatch:
    return FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=8, color=colour, lw=width, shrinkA=0, shrinkB=0)
