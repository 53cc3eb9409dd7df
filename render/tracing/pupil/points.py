"""Points of the launch disk for a kernel: from a table, inside outlines, or computed in place.

Sobol points are computed from their index, so that the memory of a render does not grow with the number of rays: bit
reversal and the second Sobol dimension (Sobol 1967; its matrix is Pascal's triangle modulo 2), each under a nested
uniform scrambling (Owen 1995) by hashing (Laine & Karras 2011; Burley 2020, JCGT 9(4), 1; constants by N. Vegdahl,
"Building a better LK hash", 2021).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray
from render.engine.jit import dr
from render.engine.upload import uploaded

BOUNDING_RINGS = (1.0 - 1e-6, 0.8, 0.5, 0.2)


class PupilPoints(Protocol):
    """Start points of rays in the launch disk (of radius 1), for every node."""

    @property
    def count(self) -> int:
        """Points per node."""

    @property
    def weight(self) -> FloatArray:
        """Weights, fractions of the disk's area; an array that broadcasts against (s, b, k, count)."""

    def sample(self, types: Any, slot: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        """Coordinates and weight of point ``point`` of node ``node``, in Dr.Jit arrays of a module of types.

        Slots are the pairs of stars and bands of a call, in this order.
        """


@dataclass(frozen=True, slots=True, eq=False)
class TablePoints:
    """Pupil points from a table."""

    points: FloatArray  # (k, p, 2) Unit-disk points of every wavelength node
    weight: FloatArray  # (p,) Weights, sum 1

    @property
    def count(self) -> int:
        """Points per wavelength node."""
        return self.points.shape[1]

    def sample(self, types: Any, slot: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        """Look the point up."""
        F, U = types.Float64, types.UInt32
        at = node * dr.opaque(U, self.count) + point
        x, y = (uploaded(F, self.points[..., axis]) for axis in (0, 1))
        return dr.gather(F, x, at), dr.gather(F, y, at), dr.gather(F, F(self.weight), point)


@dataclass(frozen=True, slots=True, eq=False)
class OutlinePoints:
    """Points ``centre + ring * radius (cos, sin)(azimuth)`` inside the outlines of s stars in b bands.

    With a dark shadow in the middle they move out: the squares of their distances divide the annulus as ``ring**2``
    divides the disk.
    """

    centre: FloatArray  # (s, b, 2) Centre of the azimuths
    azimuth: FloatArray  # (..., k, a) Azimuths of every node, or of every node of every star
    radius: FloatArray  # (s, b, k, a) The outline there
    area: FloatArray  # (s, b, k, a) Area of the sector of every azimuth, as a fraction of the disk's
    # arm, ring, ring_weight: (p,) Azimuth of every point, its part of the radius, and its weight in the sector, sum 1
    # over the rings of an arm
    arm: NDArray[np.uint32]
    ring: FloatArray
    ring_weight: FloatArray
    shadow: FloatArray | None = None  # (s, b, k, a) The outline of the shadow

    @property
    def count(self) -> int:
        """Points per node."""
        return len(self.ring)

    @property
    def weight(self) -> FloatArray:
        """Weights (s, b, k, count)."""
        return np.asarray(self.area[..., self.arm] * self.ring_weight)

    @property
    def inside(self) -> FloatArray:
        """Share of the disk that lies inside the outline (s, b, k): the sum of the weights."""
        return np.asarray(self.area @ np.bincount(self.arm, self.ring_weight, self.area.shape[-1]))

    def sample(self, types: Any, slot: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        """Compute the point."""
        F, U = types.Float64, types.UInt32
        nodes, arms = self.radius.shape[-2:]
        at = (slot * dr.opaque(U, nodes) + node) * dr.opaque(U, arms) + dr.gather(U, U(self.arm), point)
        ring = dr.gather(F, F(self.ring), point)
        if self.shadow is None:
            length = self.radius
        else:
            length, dark = np.ones_like(self.radius), dr.gather(F, uploaded(F, self.shadow**2), at)
            lit = dr.gather(F, uploaded(F, self.radius**2 - self.shadow**2), at)
            ring = dr.sqrt(dark + ring * ring * lit)
        along = [length * np.cos(self.azimuth), length * np.sin(self.azimuth)]
        px, py = (
            dr.gather(F, uploaded(F, self.centre[..., axis]), slot) + ring * dr.gather(F, uploaded(F, along[axis]), at)
            for axis in (0, 1)
        )
        return px, py, dr.gather(F, uploaded(F, self.area), at) * dr.gather(F, F(self.ring_weight), point)


def bounding_outline(
    centre: FloatArray,
    azimuth: FloatArray,
    radius: FloatArray,
    arms: Sequence[IntArray],
    shadow: FloatArray | None = None,
) -> OutlinePoints:
    """Points that bound where the light inside outlines lands: on the rim, and on three rings inside."""
    ring = np.repeat(BOUNDING_RINGS, [len(arm) for arm in arms])
    weight = np.full(len(ring), 1.0 / len(ring))
    arm = np.concatenate(arms).astype(np.uint32)
    return OutlinePoints(centre, azimuth, radius, radius**2, arm, ring, weight, shadow)


def covered_points(order: tuple[int, int], nodes: int, lattice: tuple[int, int] = (1, 1)) -> TablePoints:
    """Middles of polar cells of equal area, rings x azimuths, or a rank-1 lattice of points in each, these last.

    ``lattice`` is their number and generator: Fibonacci numbers that follow each other spread them evenly (Niederreiter
    1992, sec. 5). No two lie at the same radius or azimuth, so that an edge along either is resolved to the spacing of
    all points.
    """
    rings, arms = order
    i = np.arange(lattice[0])
    part, turn = ((v % lattice[0] + 0.5) / lattice[0] for v in (i, i * lattice[1]))
    r2 = (np.arange(rings)[:, None, None] + part) / rings
    angle = 2.0 * np.pi * (np.arange(arms)[:, None] + turn) / arms
    r, angle = np.broadcast_arrays(np.sqrt(r2), angle)
    points = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1).reshape(-1, 2)
    return TablePoints(np.broadcast_to(points, (nodes, *points.shape)), np.full(len(points), 1.0 / len(points)))


@dataclass(frozen=True, slots=True)
class SobolPoints:
    """Scrambled Sobol points: node j has points j 2^n ... (j+1) 2^n - 1 of one sequence, each of these sets a net."""

    log2_count: int  # n
    seed: int  # Of the scrambling

    @property
    def count(self) -> int:
        """Points per wavelength node."""
        return 1 << self.log2_count

    @property
    def weight(self) -> FloatArray:
        """Equal weights (count,)."""
        return np.full(self.count, 1.0 / self.count)

    def square(self, types: Any, index: Any) -> tuple[Any, Any]:
        """Points ``index`` of the scrambled sequence in the unit square."""
        F, U = types.Float64, types.UInt32
        seeds = np.random.SeedSequence([self.seed, 0x50B01]).generate_state(2)
        reverse = dr.brev(index)
        second = reverse
        for shift, mask in ((16, 0xFFFF), (8, 0xFF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
            second = second ^ ((second & U(mask)) << shift)
        u = dr.brev(_nested(U, index, dr.opaque(U, int(seeds[0]))))
        v = dr.brev(_nested(U, dr.brev(second), dr.opaque(U, int(seeds[1]))))
        return (F(u) + 0.5) * 2.0**-32, (F(v) + 0.5) * 2.0**-32

    def sample(self, types: Any, slot: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        """Compute the point."""
        U = types.UInt32
        u, v = self.square(types, (node << dr.opaque(U, self.log2_count)) + point)
        radius, (sine, cosine) = dr.sqrt(u), dr.sincos(2.0 * np.pi * v)
        return radius * cosine, radius * sine, dr.opaque(types.Float64, 1.0 / self.count)


@dataclass(frozen=True, slots=True, eq=False)
class DiskPoints:
    """Points of the unit disk, moved to the disk of each of s stars in b bands."""

    points: PupilPoints  # Of the unit disk
    centre: FloatArray  # (s, b, 2) Centres, in radii of the launch disk
    radius: FloatArray  # (s, b) Radii

    @property
    def count(self) -> int:
        """Points per node."""
        return self.points.count

    @property
    def weight(self) -> FloatArray:
        """Weights (s, b, 1, count)."""
        return np.asarray(self.radius[:, :, None, None] ** 2 * self.points.weight)

    def sample(self, types: Any, slot: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        """Compute the point."""
        F = types.Float64
        x, y, weight = self.points.sample(types, slot, node, point)
        radius, cx, cy = (
            dr.gather(F, uploaded(F, v), slot) for v in (self.radius, self.centre[..., 0], self.centre[..., 1])
        )
        return cx + radius * x, cy + radius * y, weight * radius * radius


def _nested(U: Any, x: Any, seed: Any) -> Any:
    """Hash in which a bit depends on the bits below it only: on reversed digits, a nested uniform scrambling."""
    x = x ^ (x * U(0x3D20ADEA))
    x = x + seed
    x = x * ((seed >> 16) | 1)
    x = x ^ (x * U(0x05526C56))
    return x ^ (x * U(0x53A22864))
