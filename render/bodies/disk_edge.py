"""Overlap of a small cell of the sky with the edge of a disk, in Dr.Jit arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from render.engine.jit import dr


@dataclass(frozen=True, slots=True)
class Edge:
    """Edge of a disk around c for a cell around v, taken as straight.

    Where it passes at distance d inside the middle of a unit square, its normal (a, b), the depth below it is d plus
    the sum of two uniform variates of the widths a and b, whose density is a trapezoid.
    """

    ahead: Any  # Whether the cell looks to the disk's side at all
    outwards: list[Any]  # Unit vector across c, from c to v
    # d, a, b: In cells
    d: Any
    a: Any
    b: Any
    size: Any  # Sine of the angle that a cell spans along the normal

    @classmethod
    def of(cls, c: list[Any], sine: Any, v: list[Any], moves: list[list[Any]]) -> Edge:
        along, off2 = cosine_and_sine2(c, v)
        off = dr.sqrt(off2)
        # at the very centre any direction serves
        centre = off2 < 1e-6 * sum(m * m for m in moves[0])
        across = [dr.select(centre, m, a - along * k) for m, a, k in zip(moves[0], v, c, strict=True)]
        scale = dr.rsqrt(dr.maximum(sum(m * m for m in across), 1e-300))
        across = [m * scale for m in across]
        change = [sum(m * k for m, k in zip(move, across, strict=True)) for move in moves]
        size = dr.maximum(dr.sqrt(change[0] * change[0] + change[1] * change[1]), 1e-300)
        a, b = (dr.maximum(dr.abs(m) / size, 1e-3) for m in change)  # a line along the pixels is tilted a little
        curve = size / (24.0 * dr.maximum(off, size))  # how far the edge bends away over the cell, in the mean
        return cls(along > 0.0, across, (sine - off) / size - curve, a, b, size)

    def ends(self) -> list[Any]:
        """Depths, as sines, at which the density has kinks, ascending."""
        reach, flat = 0.5 * (self.a + self.b), 0.5 * dr.abs(self.a - self.b)
        return [(self.d + t) * self.size for t in (-reach, -flat, flat, reach)]

    def density(self, depth: Any) -> Any:
        """Part of the cell per sine of depth."""
        ramp = 0.5 * (self.a + self.b) - dr.abs(depth / self.size - self.d)
        value = dr.clip(ramp, 0.0, dr.minimum(self.a, self.b)) / (self.a * self.b * self.size)
        return dr.select(self.ahead, value, 0.0)

    def normal(self, c: list[Any], sine: Any, above: Any, mu: Any) -> list[Any]:
        """Normal where a ray leaves the sphere under an angle of sine ``above`` (from its centre) and cosine mu."""
        off = sine * above
        along = dr.safe_sqrt(1.0 - off * off)
        outwards, inwards = above * along - mu * off, mu * along + above * off
        return [outwards * e - inwards * m for e, m in zip(self.outwards, c, strict=True)]

    def inside(self) -> Any:
        """Part of the cell that lies in the disk."""
        reach, flat = 0.5 * (self.a + self.b), 0.5 * (self.a - self.b)
        depth = [dr.square(dr.maximum(self.d + sign, 0.0)) for sign in (reach, flat, -flat, -reach)]
        area = (depth[0] - depth[1] - depth[2] + depth[3]) / (2.0 * self.a * self.b)
        cut = dr.select(dr.abs(self.d) < reach, dr.clip(area, 0.0, 1.0), dr.select(self.d > 0.0, 1.0, 0.0))
        return dr.select(self.ahead, cut, 0.0)


def cosine_and_sine2(c: list[Any], v: list[Any]) -> tuple[Any, Any]:
    """Cosine of the angle between unit vectors, and the square of its sine without loss of digits."""
    cross = (c[1] * v[2] - c[2] * v[1], c[2] * v[0] - c[0] * v[2], c[0] * v[1] - c[1] * v[0])
    cosine = c[0] * v[0] + c[1] * v[1] + c[2] * v[2]
    return cosine, cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]
