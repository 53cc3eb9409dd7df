"""Forward tracing of stars on Dr.Jit: star -> pupil -> lens -> fine cells of a small stamp per star and band.

One ray is one lane of a fused kernel; nothing per ray is kept. Its light, a Gaussian of the charge-diffusion width
around the landing point, is integrated exactly over cells of a fraction of a pixel, so a stamp is the integral of (ray
density convolved with the diffusion kernel), with no other blur.

Sums are 64-bit integers (2^-50 of the star's light): their order does not matter, so the result is the same to the last
bit whatever the number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from optics.frames import light_direction
from optics.program import LensProgram
from optics.trace import Rays, trace_program
from render.arrays import DrJitArrays

__all__ = ["KERNEL_REACH", "Geometry", "StarKernel", "oversampling"]

FloatArray = NDArray[np.float64]

KERNEL_REACH = 6.0
"""Half-width of the diffusion kernel in standard deviations; what lies beyond (2e-9) goes to the outermost cell."""

_SCALE = 2.0**50
_MAGIC = 1.5 * 2.0**52
_MASK = (1 << 51) - 1
_MOMENTS = 7
"""Sums kept per star and band: light arrived, lost, outside the stamp, x, y, x^2, y^2."""


def oversampling(diffusion_px: float) -> int:
    """Cells per pixel such that their first moment is the centroid of the light, to 1.5e-4 px times the spot's transfer.

    A sum over cells of width 1/m aliases the light's spectrum at m cycles per pixel into the moment, with weight
    ``exp(-2 (pi m sigma)^2) / (pi m)`` after the diffusion kernel.
    """
    for cells in (2, 4):
        if np.exp(-2.0 * (np.pi * cells * diffusion_px) ** 2) / (np.pi * cells) < 1.5e-4:
            return cells
    return 8


@dataclass(frozen=True, slots=True)
class Geometry:
    """What a camera looks like to the kernel; numbers only."""

    rotation: FloatArray
    pitch_mm: float
    centre_px: FloatArray
    pupil_mm: tuple[float, float, float]
    pupil_radius_mm: float
    diffusion_px: float


class StarKernel:
    """Traces a set of stars through one compiled lens.

    Parameters
    ----------
    mi : module
        Mitsuba with an active variant.
    program, theta
        From `optics.program.compile_lens`.
    geometry : Geometry
        Camera.
    direction : (n, 3)
        Unit vectors towards the stars.
    """

    def __init__(
        self, mi: Any, program: LensProgram, theta: FloatArray, geometry: Geometry, direction: FloatArray
    ) -> None:
        self.F, self.U, self.I, self.U64 = mi.Float64, mi.UInt32, mi.Int32, mi.UInt64
        self.xp = DrJitArrays(self.F)
        self.program, self.geometry = program, geometry
        self.theta = self.xp.parameters(theta.tolist())
        self.numbers = self.xp.parameters(
            [geometry.pitch_mm, *geometry.centre_px, *geometry.pupil_mm, geometry.pupil_radius_mm]
        )
        light = light_direction(direction @ geometry.rotation.T)
        self.light = [self.F(np.ascontiguousarray(light[:, i])) for i in range(3)]
        self.count = len(direction)

    def _launch(self, star: Any, px: Any, py: Any, wavelength_nm: Any) -> tuple[Any, Any, Any, Any]:
        """Column, row [px], obliquity (cosine at the pupil) and arrival of rays through unit-disk points."""
        pitch, cx, cy, x0, y0, z0, radius = self.numbers
        dx, dy, dz = (dr.gather(self.F, component, star) for component in self.light)
        zero = dr.zeros(self.I, 1)
        rays = Rays(
            x=x0 + px * radius,
            y=y0 + py * radius,
            z=z0,
            dx=dx,
            dy=dy,
            dz=dz,
            wavelength_nm=wavelength_nm,
            opl_mm=self.F(0.0),
            status=zero,
            failed_at=zero - 1,
        )
        out = trace_program(self.program, self.theta, rays, self.xp)
        return cx + out.x / pitch, cy - out.y / pitch, dz, out.status == 0

    def _pupil_points(self, pupil: FloatArray, point: Any, node: Any) -> tuple[Any, Any]:
        """Unit-disk coordinates of (node, point)."""
        at = node * pupil.shape[1] + point
        x, y = (self.F(np.ascontiguousarray(pupil[..., axis].ravel())) for axis in (0, 1))
        return dr.gather(self.F, x, at), dr.gather(self.F, y, at)

    def land(
        self, pupil: FloatArray, wavelength_nm: FloatArray, stars: slice | None = None
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Landing points of a few rays per star and band.

        Parameters
        ----------
        pupil : (k, m, 2)
            Points in the unit disk for each wavelength node.
        wavelength_nm : (b, k)
            Wavelengths.
        stars : slice, optional
            Consecutive stars; all if left out.

        Returns
        -------
        x_px, y_px : (n, b, k, m)
            Column and row.
        arrived : (n, b, k, m)
            Whether the ray reaches the image plane.
        """
        (bands, nodes), points = wavelength_nm.shape, pupil.shape[1]
        first, last = (0, self.count) if stars is None else (stars.start, stars.stop)
        shape = (last - first, bands, nodes, points)
        i = dr.arange(self.U, math.prod(shape))
        point, node = i % points, i // points
        wavelength = dr.gather(self.F, self.F(wavelength_nm.ravel()), node % (bands * nodes))
        px, py = self._pupil_points(pupil, point, node % nodes)
        x, y, _, ok = self._launch(node // (bands * nodes) + dr.opaque(self.U, first), px, py, wavelength)
        dr.eval(x, y, ok)
        return x.numpy().reshape(shape), y.numpy().reshape(shape), ok.numpy().astype(bool).reshape(shape)

    def _cells(self, position: Any, fine: int) -> tuple[Any, list[Any]]:
        """First cell and share of each cell of 1/``fine`` pixel along one axis; ``position`` [px] from the stamp's edge."""
        sigma = self.geometry.diffusion_px * fine
        cells = position * fine
        reach = KERNEL_REACH * sigma
        first = dr.floor(cells - reach)
        taps = math.ceil(2 * reach) + 1
        if taps == 1:
            return self.I(first), [self.F(1.0)]
        scale = dr.opaque(self.F, 1.0 / (math.sqrt(2.0) * sigma))
        shares, below = [], self.F(-1.0)
        for tap in range(1, taps + 1):
            up_to = dr.erf((first + tap - cells) * scale) if tap < taps else self.F(1.0)
            shares.append(0.5 * (up_to - below))
            below = up_to
        return self.I(first), shares

    def _add(self, target: Any, value: Any, index: Any, active: Any) -> None:
        """Fixed-point accumulation; ``value`` is already scaled to 2^50."""
        fixed = dr.reinterpret_array(self.U64, value + _MAGIC) & self.U64(_MASK)
        dr.scatter_add(target, fixed, index, active, mode=dr.ReduceMode.Direct)

    def splat(
        self,
        *,
        stars: NDArray[np.uint32],
        pupil: FloatArray,
        pupil_weight: FloatArray,
        wavelength_nm: FloatArray,
        node_share: FloatArray,
        corner_px: FloatArray,
        stamp_px: int,
        cells_per_px: int,
    ) -> tuple[FloatArray, FloatArray]:
        """Stamps and moments of some of the stars.

        Parameters
        ----------
        stars : (s,)
            Indices of the stars.
        pupil : (k, p, 2)
            Unit-disk points for each wavelength node.
        pupil_weight : (p,)
            Their weights, sum 1.
        wavelength_nm : (b, k)
            Wavelengths.
        node_share : (s, b, k)
            Share of each wavelength node in the star's light, sum 1.
        corner_px : (s, b, 2)
            Outer corner of the stamp's first pixel (column, row).
        stamp_px : int
            Stamp size.
        cells_per_px : int
            Cells along a pixel.

        Returns
        -------
        cells : (s, b, stamp_px * cells_per_px, stamp_px * cells_per_px)
            Share of the star's light per cell.
        moments : (s, b, 7)
            Shares arrived, lost in the lens, outside the stamp; then first and second moments of the arrived rays from
            the corner in units of the stamp size.
        """
        F, U = self.F, self.U
        (bands, nodes), points = wavelength_nm.shape, pupil.shape[1]
        size = stamp_px * cells_per_px
        i = dr.arange(U, len(stars) * bands * nodes * points)
        point, rest = i % points, i // points
        node, slot = rest % nodes, rest // nodes
        px, py = self._pupil_points(pupil, point, node)
        weight = dr.gather(F, F(pupil_weight), point) * dr.gather(F, F(node_share.ravel()), rest) * _SCALE
        wavelength = dr.gather(F, F(wavelength_nm.ravel()), (slot % bands) * nodes + node)
        x, y, _, ok = self._launch(dr.gather(U, U(stars), slot // bands), px, py, wavelength)
        x = x - dr.gather(F, F(np.ascontiguousarray(corner_px[..., 0].ravel())), slot)
        y = y - dr.gather(F, F(np.ascontiguousarray(corner_px[..., 1].ravel())), slot)
        (column, share_x), (row, share_y) = self._cells(x, cells_per_px), self._cells(y, cells_per_px)
        limit = dr.opaque(self.I, size)
        inside = ok & (column >= 0) & (row >= 0) & (column + len(share_x) <= limit) & (row + len(share_y) <= limit)
        moments = dr.zeros(self.U64, len(stars) * bands * _MOMENTS)
        base = slot * _MOMENTS
        u, v = x / dr.opaque(F, stamp_px), y / dr.opaque(F, stamp_px)
        self._add(moments, weight, base + dr.select(inside, U(0), dr.select(ok, U(2), U(1))), dr.mask_t(F)(True))
        for k, value in enumerate((u, v, u * u, v * v)):
            self._add(moments, weight * value, base + (3 + k), inside)
        cells = dr.zeros(self.U64, len(stars) * bands * size * size)
        origin = (slot * limit + U(row)) * limit + U(column)
        for r, along_y in enumerate(share_y):
            line = origin + r * U(limit)
            part = weight * along_y
            for c, along_x in enumerate(share_x):
                self._add(cells, part * along_x, line + c, inside)
        dr.eval(cells, moments)
        scaled = dr.opaque(F, 1.0 / _SCALE)
        return (
            (F(cells) * scaled).numpy().reshape(len(stars), bands, size, size),
            (F(moments) * scaled).numpy().reshape(len(stars), bands, _MOMENTS),
        )
