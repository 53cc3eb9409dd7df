"""Forward tracing of stars on Dr.Jit: star -> pupil -> lens -> pixels of a small stamp per star and band.

One ray is one lane of a fused kernel; nothing per ray is stored. The light of a ray, a Gaussian of the charge-diffusion
width around the landing point, is integrated exactly over pixels, so that a stamp is the pixel integral of (ray density
convolved with the diffusion kernel), without other blur. The same light is integrated over narrow strips along columns
and rows, fine enough that their first moment is the centroid of the light. Inside outlines and under motion that moment
has a closed form.

Sums are 64-bit integers (2^-50 of the star's light), independent of order, so that the result is bit-identical for any
number of threads. Counts that change between calls are read from memory, so that one compiled kernel serves every star
field and every sampling of the pupil.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from optics.frames import light_direction
from optics.light.collimation import Collimation, decollimated
from optics.rays.entrance_pupil import EntrancePupil
from optics.rays.program import LensProgram
from optics.rays.trace import OK, Rays, trace_program
from render.engine import Engine
from render.engine.jit import dr
from render.engine.upload import uploaded
from render.tracing.motion.rolling_shutter import recorded
from render.tracing.pupil.points import OutlinePoints, PupilPoints
from render.tracing.pupil.transmission import PupilTransmission

PIXEL_REACH, STRIP_REACH = 5.0, 4.0
"""Least half-width of the diffusion kernel in standard deviations; its tails (6e-7 of the light, 6e-5 for the strips)
go to the outermost pixel or strip."""

STRIP_ALIASING_PX = 2e-5
MOST_STRIPS = 1024

ARRIVED, LOST, OUTSIDE = 0, 1, 2
FIRST, SECOND, STRIPS = slice(3, 5), slice(5, 7), slice(7, 9)
HIDDEN, CLEAR = 9, 10
"""Columns of `StampSums.moments`."""
_MOMENTS = CLEAR + 1

_SCALE = 2.0**50
# Between 2^52 and 2^53 the spacing of float64 is 1: added to this number, a value below 2^51 is rounded to an integer
# in the low 51 bits. One addition and a mask: AVX2 has no instruction from float64 to 64-bit integers, and
# LLVM's sequence is slow.
_ROUNDING = 1.5 * 2.0**52
_MASK = (1 << 51) - 1


def strips_per_pixel(diffusion_px: float) -> int:
    """Strips per pixel such that their first moment is the centroid of the light, to `STRIP_ALIASING_PX`.

    A sum over strips of width 1/m aliases the light's spectrum at m cycles per pixel into the moment, with weight
    ``exp(-2 (pi m sigma)^2) / (pi m)`` after the diffusion kernel; the spectrum of the spot itself lowers it further.
    Without diffusion m is `MOST_STRIPS`.
    """
    if diffusion_px * MOST_STRIPS < 0.5:
        return MOST_STRIPS
    m = 2
    while math.exp(-2.0 * (math.pi * m * diffusion_px) ** 2) / (math.pi * m) > STRIP_ALIASING_PX:
        m += 1
    return m


def reach_px(diffusion_px: float) -> float:
    """Radius [px] over which the light of a ray is spread."""
    return 0.5 * math.ceil(2.0 * PIXEL_REACH * diffusion_px)


def gaussian_weights(F: Any, integer: Any, position: Any, sigma: float, reach: float) -> tuple[Any, list[Any]]:
    """First cell of a Gaussian about a position, in cells, and the weight of each; the outermost hold the tails."""
    width = math.ceil(2 * reach * sigma)
    first = dr.detach(dr.floor(position - 0.5 * width))
    if width == 0:
        return integer(first), [F(1.0)]
    scale = dr.opaque(F, 1.0 / (math.sqrt(2.0) * sigma))
    shares, below = [], F(-1.0)
    for tap in range(1, width + 2):
        up_to = dr.erf((first + tap - position) * scale) if tap <= width else F(1.0)
        shares.append(0.5 * (up_to - below))
        below = up_to
    return integer(first), shares


@dataclass(frozen=True, slots=True)
class Geometry:
    """Camera numbers of the kernel."""

    pitch_mm: float
    centre_px: FloatArray
    pupil_mm: tuple[float, float, float]
    pupil_radius_mm: float
    diffusion_px: float

    @property
    def strips(self) -> int:
        """Strips per pixel."""
        return strips_per_pixel(self.diffusion_px)


@dataclass(frozen=True, slots=True)
class StampSums:
    """Sums of a pass for s stars in b bands; light as fractions of what the star sends into the pupil."""

    pixels: FloatArray  # (s, b, m, m) Light per pixel of the stamp
    # (s, b, 11) Light on the stamp (`ARRIVED`), lost in the lens (`LOST`), beside the stamp (`OUTSIDE`); `FIRST` and
    # `SECOND` moments of the landing points on the stamp, and first moments of the light over `STRIPS` of columns and
    # of rows (not of cells), from the stamp's corner in units of its size; light stopped in front of the lens
    # (`HIDDEN`); light that apertures let through, before losses in surfaces and glasses beyond those of the axis
    # (`CLEAR`)
    moments: FloatArray

    def take(self, keep: NDArray[np.bool_]) -> StampSums:
        """Some of the stars."""
        return StampSums(self.pixels[keep], self.moments[keep])


Transmission = Callable[[FloatArray], PupilTransmission | None]
"""Of every ray over that of the axis, for wavelengths (b, k)."""


class Shade(Protocol):
    """Bodies between the sky and the lens."""

    def near(self, pupil: EntrancePupil) -> NDArray[np.bool_]:
        """Stars (n,) that may have a body in their beam, as wide as a launch disk."""

    def hides(self, rays: Rays, star: Any) -> Any:
        """Whether rays in the lens frame (`StarKernel.rays`) do not get from their stars (UInt32) to the lens."""


class StarKernel:
    """Traces a set of stars through one compiled lens.

    Nodes of a call are all wavelengths of the first time, then all of the second, ... A ``shear`` (n, t, 3) is that of
    a rolling shutter: a row, and by how many columns and rows the image moves per line time there.
    """

    def __init__(
        self,
        program: LensProgram,
        theta: FloatArray,
        geometry: Geometry,
        direction: FloatArray,
        shear: FloatArray | None = None,
        collimation: Collimation | None = None,
        transmission: Transmission | None = None,
    ) -> None:
        engine = Engine.active()
        self.types = types = engine.types
        self.F, self.U, self.I, self.U64 = types.Float64, types.UInt32, types.Int32, types.UInt64
        self.xp = engine.arrays
        self.program, self.geometry = program, geometry
        self.theta = self.xp.parameters(theta.tolist())
        self.pixels = self.xp.parameters([geometry.pitch_mm, *geometry.centre_px])
        self.disk = self.xp.parameters([*geometry.pupil_mm, geometry.pupil_radius_mm])
        self.direction = direction[:, None] if direction.ndim == 2 else direction
        self.count, self.times = self.direction.shape[:2]
        self.collimation, self.transmission = collimation, transmission
        light = light_direction(self.direction).reshape(-1, 3)
        self.light = [uploaded(self.F, light[:, i]) for i in range(3)]
        self.shear = None
        if shear is not None:
            self.shear = [uploaded(self.F, shear[..., i]) for i in range(3)]

    def rays(self, star: Any, px: Any, py: Any, wavelength_nm: Any, error: Any = None) -> Rays:
        """Rays of stars through points of the launch disk; ``error`` as `optics.light.collimation.decollimated`."""
        x0, y0, z0, radius = self.disk
        direction = [dr.gather(self.F, component, star) for component in self.light]
        if error is not None:
            direction = decollimated(tuple(direction), px * radius, py * radius, error, dr.sqrt)
        return self.xp.rays((x0 + px * radius, y0 + py * radius, z0), direction, wavelength_nm)

    def launch(
        self, star: Any, px: Any, py: Any, wavelength_nm: Any, error: Any = None, program: LensProgram | None = None
    ) -> tuple[Any, Any, Any]:
        """Column, row [px] and status of rays through points of the launch disk; ``star`` counts times too."""
        pitch, cx, cy = self.pixels
        out = trace_program(program or self.program, self.theta, self.rays(star, px, py, wavelength_nm, error), self.xp)
        x, y = cx + out.x / pitch, cy - out.y / pitch
        if self.shear is not None:
            x, y = recorded(x, y, *(dr.gather(self.F, values, star) for values in self.shear))
        return x, y, out.status

    def numbered(self, total: int, *sizes: int) -> list[Any]:
        """Indices of lane 0 ... total-1 along axes of the given sizes, last axis first, and the quotient."""
        remaining = dr.arange(self.U, total)
        indices = []
        for size in reversed(sizes):
            divisor = dr.opaque(self.U, size)
            quotient = remaining // divisor
            indices.append(remaining - quotient * divisor)
            remaining = quotient
        return [*indices, remaining]

    def land(
        self, pupil: PupilPoints, wavelength_nm: FloatArray, stars: NDArray[np.uint32] | None = None
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Landing points of a few rays per star and band."""
        # wavelength_nm (b, k), stars (s,) -> (s, b, t k, m), (s, b, t k, m)
        bands, nodes = len(wavelength_nm), wavelength_nm.shape[1] * self.times
        shape = (self.count if stars is None else len(stars), bands, nodes, pupil.count)
        point, node, slot = self.numbered(math.prod(shape), nodes, pupil.count)
        star, wavelength = self.light_of(slot, node, wavelength_nm, stars)
        px, py, _ = pupil.sample(self.types, slot, node, point)
        x, y, status = self.launch(star, px, py, wavelength, self.error_of(slot, node, wavelength_nm))
        ok = status == OK
        dr.eval(x, y, ok)
        return x.numpy().reshape(shape), y.numpy().reshape(shape), ok.numpy().astype(bool).reshape(shape)

    def transmitted(
        self, pupil: PupilPoints, wavelength_nm: FloatArray, stars: NDArray[np.uint32]
    ) -> FloatArray | float:
        """Transmission (s, b, t k, m) of rays over that of the axis, where `land` lets them arrive."""
        bands, nodes = len(wavelength_nm), wavelength_nm.shape[1] * self.times
        shape = (len(stars), bands, nodes, pupil.count)
        point, node, slot = self.numbered(math.prod(shape), nodes, pupil.count)
        px, py, _ = pupil.sample(self.types, slot, node, point)
        transmission = self.ray_transmission(px, py, slot, node, wavelength_nm, stars)
        return 1.0 if transmission is None else np.asarray(transmission.numpy()).reshape(shape)

    def ray_transmission(
        self, px: Any, py: Any, slot: Any, node: Any, wavelength_nm: FloatArray, stars: NDArray[np.uint32] | None
    ) -> Any:
        """Transmission over that of the axis of rays from points of the launch disk; None where it is 1."""
        fit = None if self.transmission is None else self.transmission(wavelength_nm)
        if fit is None:
            return None
        F, U = self.F, self.U
        middle = self.direction[:, self.times // 2]  # in the middle of the exposure, along whose path it hardly changes
        light = light_direction(middle if stars is None else middle[stars])
        table = fit.table(light)
        bands, colours, terms = (dr.opaque(U, size) for size in (*wavelength_nm.shape, table.shape[2]))
        position = slot // bands
        at = (slot * colours + node % colours) * terms
        flat = uploaded(F, table)
        dx, dy = (dr.gather(F, uploaded(F, light[:, i]), position) for i in (0, 1))
        return fit.value([dr.gather(F, flat, at + q) for q in range(table.shape[2])], *fit.coordinates(px, py, dx, dy))

    def hidden_fraction(self, shade: Shade, pupil: PupilPoints, stars: NDArray[np.uint32]) -> FloatArray:
        """Fraction (s,) of the launch disk from which some stars are hidden, by equal weights of its points."""
        point, position = self.numbered(len(stars) * pupil.count, pupil.count)
        px, py, _ = pupil.sample(self.types, position, dr.zeros(self.U, 1), point)
        star = dr.gather(self.U, self.U(stars), position)
        counts = dr.zeros(self.U, len(stars))
        hidden = shade.hides(self.rays(star, px, py, self.F(0.0)), star)
        dr.scatter_add(counts, self.U(1), position, hidden)
        return np.asarray(counts.numpy() / pupil.count)

    def light_of(
        self, slot: Any, node: Any, wavelength_nm: FloatArray, stars: NDArray[np.uint32] | None
    ) -> tuple[Any, Any]:
        """Star (with its time) and wavelength of a slot's node."""
        F, U = self.F, self.U
        bands, colours = (dr.opaque(U, size) for size in wavelength_nm.shape)
        position, time = slot // bands, node // colours
        colour = (slot - position * bands) * colours + (node - time * colours)
        star = position if stars is None else dr.gather(U, U(stars), position)
        return star * dr.opaque(U, self.times) + time, dr.gather(F, uploaded(F, wavelength_nm), colour)

    def error_of(self, slot: Any, node: Any, wavelength_nm: FloatArray) -> tuple[Any, ...] | None:
        """Error of the collimation of a slot's node; None for the light of stars."""
        if self.collimation is None:
            return None
        bands, colours = (dr.opaque(self.U, size) for size in wavelength_nm.shape)
        colour = (slot % bands) * colours + node % colours
        table = self.collimation.at(wavelength_nm).reshape(-1, 3)
        return tuple(dr.gather(self.F, uploaded(self.F, table[:, i]), colour) for i in range(3))

    def _cell_weights(self, position_px: Any, per_pixel: int, reach: float) -> tuple[Any, list[Any]]:
        """`gaussian_weights` along one axis, of ``per_pixel`` cells per pixel from the stamp's corner."""
        return gaussian_weights(self.F, self.I, position_px * per_pixel, self.geometry.diffusion_px * per_pixel, reach)

    def _strip_centre(self, position_px: Any) -> Any:
        """First moment over strips of a Gaussian around a position: the first term of their alias (`strips_per_pixel`).

        floor(u) + 1/2 = u + sum_k sin(2 pi k u) / (pi k), and a Gaussian damps the k-th wave.
        """
        m, sigma = self.geometry.strips, self.geometry.diffusion_px
        if sigma * m < 0.5:
            return (dr.floor(position_px * m) + 0.5) / m
        alias = math.exp(-2.0 * (math.pi * m * sigma) ** 2) / (math.pi * m)
        return position_px + alias * dr.sin(2.0 * math.pi * m * position_px)

    def _add(self, target: Any, value: Any, index: Any, active: Any, together: bool = False) -> None:
        """Fixed-point accumulation of a ``value`` scaled to 2^50; ``together``: neighbouring rays have one index."""
        llvm = dr.backend_v(self.F) == dr.JitBackend.LLVM
        mode = dr.ReduceMode.Local if together and llvm else dr.ReduceMode.Direct
        fixed = dr.reinterpret_array(self.U64, value + _ROUNDING) & self.U64(_MASK)
        dr.scatter_add(target, fixed, index, active, mode=mode)

    def _numpy(self, fixed: Any, *shape: int) -> FloatArray:
        """Fixed-point sums as numbers."""
        values: FloatArray = fixed.numpy().reshape(shape) * (1.0 / _SCALE)
        return values

    def splat(
        self,
        *,
        stars: NDArray[np.uint32],
        pupil: PupilPoints,
        wavelength_nm: FloatArray,
        node_weight: FloatArray,
        corner_px: FloatArray,
        stamp_px: int,
        cells_per_px: int = 1,
        shade: Shade | None = None,
    ) -> StampSums:
        """Stamps and moments of some of the stars; of cells in place of pixels there are no strips."""
        # stars (s,), wavelength_nm (b, k), node_weight (s, b, t k), corner_px (s, b, 2)
        F, U = self.F, self.U
        bands, nodes = len(wavelength_nm), wavelength_nm.shape[1] * self.times
        point, node, slot = self.numbered(len(stars) * bands * nodes * pupil.count, nodes, pupil.count)
        px, py, weight = pupil.sample(self.types, slot, node, point)
        weight = weight * dr.gather(F, uploaded(F, node_weight), slot * dr.opaque(U, nodes) + node) * _SCALE
        transmission = self.ray_transmission(px, py, slot, node, wavelength_nm, stars)
        star, wavelength = self.light_of(slot, node, wavelength_nm, stars)
        error = self.error_of(slot, node, wavelength_nm)
        x, y, status = self.launch(star, px, py, wavelength, error)
        ok, hidden = status == OK, None
        if shade is not None:
            hidden = ok & shade.hides(self.rays(star, px, py, wavelength, error), star // self.times)
        x = x - dr.gather(F, uploaded(F, corner_px[..., 0]), slot)
        y = y - dr.gather(F, uploaded(F, corner_px[..., 1]), slot)
        strips = cells_per_px == 1 and self.times == 1 and not isinstance(pupil, OutlinePoints)
        shape = (len(stars), bands)
        return self._collect(x, y, ok, hidden, weight, transmission, slot, shape, stamp_px, cells_per_px, strips)

    def _collect(
        self,
        x: Any,
        y: Any,
        ok: Any,
        hidden: Any,
        weight: Any,
        transmission: Any,
        slot: Any,
        shape: tuple[int, int],
        stamp_px: int,
        cells_per_px: int,
        by_strips: bool,
    ) -> StampSums:
        """Add the light of every ray to its star's pixels (or cells) and moments."""
        F, U, slots = self.F, self.U, math.prod(shape)
        arrived, ok = ok, ok if hidden is None else ok & ~hidden
        size, strips = stamp_px * cells_per_px, stamp_px * self.geometry.strips
        cells = [self._cell_weights(v, cells_per_px, PIXEL_REACH) for v in (x, y)]
        marginals = [self._cell_weights(v, self.geometry.strips, STRIP_REACH) for v in (x, y)] if by_strips else []
        inside = ok
        for limit, parts in ((size, cells), (strips, marginals)):
            for first, weights in parts:  # not &=, which would change ``ok`` too
                inside = inside & (first >= 0) & (first + len(weights) <= dr.opaque(self.I, limit))
        moments = dr.zeros(self.U64, slots * _MOMENTS)
        base = slot * _MOMENTS
        if transmission is not None:
            self._add(moments, weight, base + CLEAR, arrived, together=True)
            weight = weight * dr.select(arrived, transmission, 1.0)
        kind = dr.select(inside, U(ARRIVED), dr.select(ok, U(OUTSIDE), U(LOST)))
        if hidden is not None:
            kind = dr.select(hidden, U(HIDDEN), kind)
        self._add(moments, weight, base + kind, dr.mask_t(F)(True), together=True)
        u, v = x / dr.opaque(F, stamp_px), y / dr.opaque(F, stamp_px)
        centres = []
        for first, weights in marginals:  # ray by ray
            centre = F(first) + 0.5
            for s, part in enumerate(weights[1:], 1):
                centre = centre + s * part
            centres.append(centre / dr.opaque(F, strips))
        if cells_per_px == 1 and not by_strips:  # the sum over strips in closed form
            centres = [self._strip_centre(v) / dr.opaque(F, stamp_px) for v in (x, y)]
        for k, value in enumerate((u, v, u * u, v * v, *centres)):
            self._add(moments, weight * value, base + (FIRST.start + k), inside, together=True)
        (column, along_x), (row, along_y) = cells
        pixels, edge = dr.zeros(self.U64, slots * size**2), dr.opaque(U, size)
        origin = (slot * edge + U(row)) * edge + U(column)
        for r, weight_y in enumerate(along_y):
            line = weight * weight_y
            for c, weight_x in enumerate(along_x):
                self._add(pixels, line * weight_x, origin + r * edge + c, inside)
        dr.eval(pixels, moments)
        sums = self._numpy(moments, *shape, _MOMENTS)
        if transmission is None:
            sums[..., CLEAR] = sums[..., ARRIVED] + sums[..., OUTSIDE] + sums[..., HIDDEN]
        return StampSums(self._numpy(pixels, *shape, size, size), sums)
