"""Numerical inverse of a distortion of the plane, on the sheet that is connected with the axis.

Newton's iteration on w(x) = target. A distortion x -> x + e(x) whose derivative has |de| < 1 (spectral norm) on a
convex set is one-to-one there, so that a solution inside such a set is the solution: the caller says where that is
proven (``safe``). All other solutions are taken only if the symmetric part of the derivative stays positive definite on
the straight line from the axis to them; what fails is looked for once more along the straight line of targets from
the image of the axis, each step started where the last one ended. Where the distortion folds the plane over, this
refuses both what lies behind the fold and targets that nothing is imaged on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray

NEWTON_STEPS = 25
PATH_STEPS = 16
SEGMENT_POINTS = 32
CONVERGED = 1e-13
"""Residual over the size of the target, below which a point is solved; some 500 roundings of float64."""


class PlaneMap(NamedTuple):
    """A map of the plane at n points: image (x, y) and its derivatives, each (n,)."""

    x: FloatArray
    y: FloatArray
    xx: FloatArray
    xy: FloatArray
    yx: FloatArray
    yy: FloatArray

    def upright(self) -> NDArray[np.bool_]:
        """Mask (n,): the symmetric part of the derivative is positive definite."""
        off = 0.5 * (self.xy + self.yx)
        return np.asarray((self.xx > 0) & (self.yy > 0) & (self.xx * self.yy > off * off))


Mapping = Callable[[FloatArray, FloatArray], PlaneMap]


def invert_plane(
    mapping: Mapping,
    target_x: FloatArray,
    target_y: FloatArray,
    *,
    safe: Callable[[FloatArray, FloatArray], NDArray[np.bool_]],
) -> tuple[FloatArray, FloatArray]:
    """Points (x, y), each (n,), whose images are the targets; NaN where there is none on the sheet of the axis.

    Shapes: ``target_x`` (n,), ``target_y`` (n,).
    """
    with np.errstate(all="ignore"):  # iterates of targets without a solution overflow; they end as NaN
        x, y, solved = _newton(mapping, target_x, target_y, target_x, target_y)
        doubtful = np.flatnonzero(~(solved & safe(x, y)))
        if doubtful.size:
            connected = solved[doubtful] & _connected(mapping, x[doubtful], y[doubtful])
            lost = doubtful[~connected]
            if lost.size:
                x[lost], y[lost] = _follow(mapping, target_x[lost], target_y[lost])
    return x, y


def _newton(
    mapping: Mapping, x: FloatArray, y: FloatArray, target_x: FloatArray, target_y: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Newton's iteration until every point is solved, or no longer improves; with which are solved."""
    limit = CONVERGED * np.maximum(1e-3, np.hypot(target_x, target_y))
    steps = 0
    while True:
        at = mapping(x, y)
        ex, ey = at.x - target_x, at.y - target_y
        determinant = at.xx * at.yy - at.xy * at.yx
        # one step more than needed costs little and takes the residual down to rounding
        x = x - (at.yy * ex - at.xy * ey) / determinant
        y = y - (at.xx * ey - at.yx * ex) / determinant
        solved = np.hypot(ex, ey) <= limit
        steps += 1
        if solved.all() or steps == NEWTON_STEPS:
            return x, y, solved & np.isfinite(x) & np.isfinite(y)


def _follow(mapping: Mapping, target_x: FloatArray, target_y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solutions (n,) reached from the axis along the straight line of targets, or NaN."""
    axis = np.zeros_like(target_x)
    start = mapping(axis, axis)
    x, y = axis, axis
    for step in range(1, PATH_STEPS + 1):
        part = step / PATH_STEPS
        goal_x = start.x + part * (target_x - start.x)
        goal_y = start.y + part * (target_y - start.y)
        x, y, solved = _newton(mapping, x, y, goal_x, goal_y)
    valid = solved & _connected(mapping, x, y)
    return np.where(valid, x, np.nan), np.where(valid, y, np.nan)


def _connected(mapping: Mapping, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
    """Which points (n,) are joined with the axis by a straight line without a fold."""
    valid = np.ones(x.shape, dtype=np.bool_)
    for part in np.linspace(0.0, 1.0, SEGMENT_POINTS + 1):
        valid &= mapping(part * x, part * y).upright()
    return valid
