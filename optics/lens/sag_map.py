r"""Measured surface error: a map of height deviations on a regular grid, added to the sag of any surface.

Between the points of the grid the map is the bicubic spline through them with not-a-knot ends, twice continuously
differentiable (de Boor 1978, *A Practical Guide to Splines*, ch. IV and XVII).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from optics.arrays import ArrayNamespace, FloatArray
from optics.errors import ConfigError, DomainError
from optics.records import freeze

LEAST_POINTS = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SagMap:
    """Height deviations of a surface; compared by identity."""

    values_mm: FloatArray  # (rows, columns) Added to the sag z(x, y) [mm]; rows along +y, columns along +x
    # (x, y) Distance between first and last column, and between first and last row [mm]; the middle is the vertex
    width_mm: tuple[float, float]
    # (rows + 2, columns + 2) Coefficients of the uniform cubic B-splines [mm]; computed from the values
    spline: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        values = freeze(self, "values_mm", shape=("r", "c"), sizes={})
        if min(values.shape) < LEAST_POINTS:
            raise DomainError(f"surface map of {values.shape} points; at least {LEAST_POINTS} x {LEAST_POINTS} needed")
        if not (self.width_mm[0] > 0 and self.width_mm[1] > 0 and np.all(np.isfinite(self.width_mm))):
            raise DomainError(f"surface map {self.width_mm} mm wide; positive widths are needed")
        object.__setattr__(self, "spline", _coefficients(_coefficients(values).T).T)
        freeze(self, "spline", shape=("r", "c"), sizes={})

    @property
    def step_mm(self) -> tuple[float, float]:
        """Distance of columns, distance of rows [mm]."""
        rows, columns = self.values_mm.shape
        return self.width_mm[0] / (columns - 1), self.width_mm[1] / (rows - 1)

    def flipped(self) -> Self:
        """The map seen from behind: z'(x, y) = -z(-x, y)."""
        return replace(self, values_mm=-self.values_mm[:, ::-1])

    def scaled(self, factor: float) -> Self:
        """The map on the surface expanded uniformly."""
        width = (factor * self.width_mm[0], factor * self.width_mm[1])
        return replace(self, values_mm=factor * self.values_mm, width_mm=width)

    def at(self, x: Any, y: Any, xp: ArrayNamespace) -> tuple[Any, Any, Any, Any]:
        """Height [mm], its slopes along x and y, and whether the map reaches the point; on every array library."""
        rows, columns = self.values_mm.shape
        (step_x, step_y), table = self.step_mm, xp.table(self.spline)
        column, wx, dx, in_x = _weights((x + 0.5 * self.width_mm[0]) * (1.0 / step_x), columns, xp)
        row, wy, dy, in_y = _weights((y + 0.5 * self.width_mm[1]) * (1.0 / step_y), rows, xp)
        height, along_x, along_y = 0.0 * x, 0.0 * x, 0.0 * x
        for j in range(4):
            line, slope = 0.0 * x, 0.0 * x
            for i in range(4):
                value = xp.take(table, (row + j) * (columns + 2) + column + i)
                line, slope = line + wx[i] * value, slope + dx[i] * value
            height, along_x, along_y = height + wy[j] * line, along_x + wy[j] * slope, along_y + dy[j] * line
        return height, along_x * (1.0 / step_x), along_y * (1.0 / step_y), in_x & in_y


def read_map(path: Path) -> FloatArray:
    """Values (rows, columns) of a map: NumPy's .npy, or numbers in lines of text."""
    if path.exists() and not path.is_file():  # reading a pipe would wait for ever
        raise ConfigError(f"{path}: map cannot be read (not a file)")
    try:
        return np.asarray(np.load(path, mmap_mode="r") if path.suffix == ".npy" else np.loadtxt(path, ndmin=2))
    except OSError as error:
        raise ConfigError(f"{path}: map cannot be read ({error.strerror or 'not a file'})") from None
    except Exception as error:  # a damaged header of NumPy's raises many kinds
        raise ConfigError(f"{path}: not a table of numbers ({error})") from None


def _weights(u: Any, count: int, xp: ArrayNamespace) -> tuple[Any, list[Any], list[Any], Any]:
    """First of four splines at grid coordinate u, their values and slopes, whether u lies on the grid."""
    inside = (u >= 0.0) & (u <= count - 1.0)
    u = xp.where(inside, u, 0.0)
    first = xp.whole(xp.minimum(u, count - 2.0))
    t = u - first
    s = 1.0 - t
    values = [
        s * s * s / 6.0,
        2.0 / 3.0 - t * t * (1.0 - 0.5 * t),
        2.0 / 3.0 - s * s * (1.0 - 0.5 * s),
        t * t * t / 6.0,
    ]
    slopes = [-0.5 * s * s, t * (1.5 * t - 2.0), -s * (1.5 * s - 2.0), 0.5 * t * t]
    return first, values, slopes, inside


def _coefficients(values: FloatArray) -> FloatArray:
    """Coefficients (n + 2, m) of the cubic splines through columns of values (n, m), with not-a-knot ends."""
    n = len(values)
    matrix = np.zeros((n + 2, n + 2))
    for i in range(n):
        matrix[i + 1, i : i + 3] = 1.0 / 6.0, 2.0 / 3.0, 1.0 / 6.0
    matrix[0, :5] = matrix[-1, -5:] = 1.0, -4.0, 6.0, -4.0, 1.0
    return np.asarray(np.linalg.solve(matrix, np.vstack([0.0 * values[:1], values, 0.0 * values[:1]])), float)
