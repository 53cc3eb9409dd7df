r"""Image of a sphere in sunlight by quadrature, without random numbers.

A pixel collects, of every ray n of the beams at every wavelength (`render.bodies.ray_maps`),

.. math:: N = \sum_n \int L(v_n(x, y))\, E_n(x, y)\, dx\, dy\, dt

over its area and its exposure. If the direction v meets the sphere, its scattering law gives the radiance in closed
form. The pixel is divided into cells. The light of a cell is integrated over the depth below the limb, between the
terminator and the limb, which is taken as straight within the cell: a thin crescent is not missed between points.
Pixels whose sum changes too much when cells are halved get finer cells. Rays of a beam are distributed over the times
of a moving camera, so that a trail is sampled by rays and times together.

Charge diffusion is applied to pixels afterwards (`render.detector.diffusion.diffuse`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from optics.arrays import FloatArray
from render.bodies.disk_edge import Edge, cosine_and_sine2
from render.bodies.earth_air import Air
from render.bodies.ray_maps import RayMaps, TileMap, powers
from render.engine import Engine
from render.engine.jit import dr
from render.engine.upload import uploaded

CELLS = (1, 2, 4, 8, 16, 32, 64)
"""Cells along each side of a pixel; the next number for the pixels that need it."""
ACROSS = 2.0
"""Cells along the radius of the disk to begin with."""
TURN_PX = 6.0
"""Path of a star during the exposure for which every ray has one time of its own."""
GAUSS = (-math.sqrt(1.0 / 3.0), math.sqrt(1.0 / 3.0))
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True, slots=True)
class DirectionalLight:
    """Light that falls on a sphere: unit vector to its source, irradiance over that of the Sun."""

    towards: FloatArray
    irradiance: float = 1.0


@dataclass(frozen=True, slots=True)
class Cover:
    """A sphere in front: unit vector to its centre, sine of its angular radius."""

    direction: FloatArray
    sine: float


@dataclass(frozen=True, slots=True)
class SunlitSphere:
    """A sphere seen along a direction; vectors along icrs."""

    direction: FloatArray  # (3,) Unit vector to the centre
    sine: float  # Of the angular radius
    law: str  # "lambert" or "lunar"
    lights: tuple[DirectionalLight, ...]  # What shines on it
    # Factor on the albedo: rows from south to north, columns from -180 deg of longitude on, centres of cells
    albedo_map: NDArray[np.float32] | None
    rotation_icrs_from_body: FloatArray  # (3, 3) Attitude of the map
    covers: tuple[Cover, ...] = ()  # What hides it
    air: Air | None = None
    # (b k,) Vertical thickness of the air at the wavelengths of all bands
    thickness: FloatArray = field(default_factory=lambda: np.zeros(0))
    air_unit: FloatArray = field(default_factory=lambda: np.zeros(0))  # (b k,) One over the sphere's albedo


@dataclass(frozen=True, slots=True)
class BodyExposure:
    """Times and attitudes of the camera."""

    # (m, 4) Quaternions cam from icrs at equal steps, neighbours on the same side; one for a camera at rest
    attitudes: FloatArray
    # exposure_s, duration_s, line_time_s: Of a row; of the table; how much later a row starts than the one before
    exposure_s: float
    duration_s: float
    line_time_s: float
    path_px: float  # How far the body moves over the detector during a row's exposure


def sphere_image(
    maps: RayMaps,
    sphere: SunlitSphere,
    exposed: BodyExposure,
    light_e: FloatArray,
    window: tuple[slice, slice],
    *,
    noise_share: float,
    ceiling_e: float,
) -> tuple[FloatArray, FloatArray]:
    """Expected electrons of a window, before charge diffusion."""
    # light_e (b, k), window (slice, slice) -> (h, w, b)
    columns, rows = window
    shape = (rows.stop - rows.start, columns.stop - columns.start, len(light_e))
    image, error = np.zeros(shape), np.zeros(shape)
    for tile_map in maps.tiles(columns, rows):
        tile = tile_map.tile
        part = (
            slice(max(tile.first_row, rows.start) - rows.start, min(tile.end_row, rows.stop) - rows.start),
            slice(
                max(tile.first_column, columns.start) - columns.start,
                min(tile.end_column, columns.stop) - columns.start,
            ),
        )
        row, column = np.mgrid[part]
        pixel = column + columns.start, row + rows.start
        for band, light in enumerate(light_e):
            nodes = slice(band * len(light), (band + 1) * len(light))
            rays = _BandRays(tile_map, nodes, light * exposed.exposure_s, sphere)
            if rays.count:
                kernel = _Kernel(rays, sphere, exposed)
                start = _first(sphere, kernel)
                image[(*part, band)], error[(*part, band)] = _converged(kernel, pixel, noise_share, ceiling_e, start)
    return image, error


def _first(sphere: SunlitSphere, kernel: _Kernel) -> int:
    """Number in `CELLS` to begin with."""
    needed = ACROSS * kernel.pixel_rad / sphere.sine
    return int(np.clip(np.searchsorted(CELLS, needed), 0, len(CELLS) - 2))


class _BandRays:
    """Polynomials of the rays of one band in one tile that carry light, with the light in the third."""

    def __init__(self, tile_map: TileMap, nodes: slice, light: FloatArray, sphere: SunlitSphere) -> None:
        coefficient = tile_map.coefficient[nodes].copy()
        coefficient[:, :, 2] *= light[:, None, None]
        flat = coefficient.reshape(-1, *coefficient.shape[2:])
        lit = np.abs(flat[:, 2]).max(1) > 0.0
        self.coefficient = np.ascontiguousarray(flat[lit])
        self.air = None
        if sphere.air is not None:
            both = (sphere.thickness[nodes] * sphere.air.slant, sphere.air_unit[nodes])
            self.air = [np.repeat(v, coefficient.shape[1])[lit] for v in both]
        self.count = len(self.coefficient)
        self.centre_px, self.half_px = tile_map.tile.centre_px, tile_map.tile.half_px


def _converged(
    kernel: _Kernel,
    pixel: tuple[NDArray[np.int64], NDArray[np.int64]],
    noise_share: float,
    ceiling_e: float,
    start: int,
) -> tuple[FloatArray, FloatArray]:
    """Image of pixels (h, w) and its error, with finer cells where they are needed."""
    unconverged = (
        maximum_filter(kernel(pixel[0].ravel(), pixel[1].ravel(), 1, flat=True).reshape(pixel[0].shape), 3) > 0.0
    )
    image, error = np.zeros(unconverged.shape), np.zeros(unconverged.shape)
    if unconverged.any():
        image[unconverged] = kernel(pixel[0][unconverged], pixel[1][unconverged], CELLS[start])
    for cells in CELLS[start + 1 :]:
        if not unconverged.any():
            break
        finer = kernel(pixel[0][unconverged], pixel[1][unconverged], cells)
        error[unconverged] = finer - image[unconverged]
        image[unconverged] = finer
        unsaturated = image < 2.0 * ceiling_e
        noise_fraction = np.where(unsaturated, error**2 / np.clip(image, 1e-12, ceiling_e), 0.0)
        unconverged &= (
            maximum_filter(noise_fraction, 3) > noise_share
        ) & unsaturated  # a pixel may change little by chance, not all around
    return image, error


class _Kernel:
    """The sum over rays, times and cells, pixels side by side; numbers are read, not compiled in."""

    def __init__(self, rays: _BandRays, sphere: SunlitSphere, exposed: BodyExposure) -> None:
        types = Engine.active().types
        self.F, self.U, self.B = types.Float64, types.UInt32, types.Bool
        self.rays, self.sphere, self.exposed = rays, sphere, exposed
        self.coefficient = uploaded(self.F, rays.coefficient)
        self.air = None if rays.air is None else [uploaded(self.F, v) for v in rays.air]
        self.albedo = None if sphere.albedo_map is None else uploaded(self.F, sphere.albedo_map.astype(float))
        self.attitude = [uploaded(self.F, v) for v in exposed.attitudes.T]
        steps = rays.coefficient[:, :2, 1:3].mean(0) / rays.half_px[::-1]
        self.pixel_rad = float(np.sqrt(abs(np.linalg.det(steps))))
        self.times = 1 if len(exposed.attitudes) == 1 else max(1, math.ceil(exposed.path_px / TURN_PX))

    def number(self, value: float) -> Any:
        """One value as an array."""
        return dr.opaque(self.F, float(value))

    def vector(self, values: FloatArray) -> list[Any]:
        """Several numbers."""
        return [self.number(v) for v in np.ravel(values)]

    def __call__(
        self, column: NDArray[np.int64], row: NDArray[np.int64], cells: int, *, flat: bool = False
    ) -> FloatArray:
        """Electrons of pixels (p,); ``flat``: of a disk that is lit evenly."""
        F, U = self.F, self.U
        rows, half = uploaded(F, row.astype(float)), self.vector(self.rays.half_px)
        centre = self.vector(self.rays.centre_px)
        x, y = (uploaded(F, column.astype(float)) - centre[0]) / half[0], (rows - centre[1]) / half[1]
        look, cell, times = self._look(), self._cell(flat), self.number(self.times)
        side, sides = self.number(1.0 / cells), dr.opaque(U, cells)
        count, ray_times = dr.opaque(U, self.rays.count), dr.opaque(U, self.rays.count * self.times)

        def step(i: Any, total: Any) -> tuple[Any, Any]:
            turn = i // count
            ray = i - turn * count
            shift = F(ray) * GOLDEN
            time = (F(turn) + shift - dr.floor(shift)) / times
            tx, ty, light, *slope = self._polynomials(ray, x, y)
            slope = [v / half[k % 2] for k, v in enumerate(slope)]
            axes = look(time, rows)
            air_of_ray = None if self.air is None else [dr.gather(F, v, ray) for v in self.air]

            def one(k: Any, part: Any) -> tuple[Any, Any]:
                down = k // sides
                dx, dy = (F(k - down * sides) + 0.5) * side - 0.5, (F(down) + 0.5) * side - 0.5
                at = tx + slope[0] * dx + slope[1] * dy, ty + slope[2] * dx + slope[3] * dy
                return k + 1, part + cell(axes, *at, slope, side, air_of_ray)

            inner = dr.while_loop((U(0), dr.zeros(F, dr.width(x))), lambda k, part: k < sides * sides, one)[1]
            return i + 1, total + dr.maximum(light, 0.0) * inner * side * side

        start = (U(0), dr.zeros(F, dr.width(x)))
        total = dr.while_loop(start, lambda i, total: i < ray_times, step, label="sphere_image")[1]
        return np.array(total) / self.times

    def _polynomials(self, ray: Any, x: Any, y: Any) -> list[Any]:
        """X/Z, Y/Z, light per pixel; slopes of the first by x and y, then of the second."""
        exponents = powers()
        of_x, of_y = [self.F(1.0)], [self.F(1.0)]
        for _ in range(max(i for i, _ in exponents)):
            of_x.append(of_x[-1] * x)
            of_y.append(of_y[-1] * y)
        first = ray * (3 * len(exponents))
        values = [self.F(0.0) for _ in range(7)]
        for k, (i, j) in enumerate(exponents):
            monomial = of_x[i] * of_y[j]
            by_x = None if i == 0 else of_x[i - 1] * of_y[j] * float(i)
            by_y = None if j == 0 else of_x[i] * of_y[j - 1] * float(j)
            for axis in range(3):
                c = dr.gather(self.F, self.coefficient, first + (axis * len(exponents) + k))
                values[axis] = dr.fma(c, monomial, values[axis])
                for slot, slope in ((3 + 2 * axis, by_x), (4 + 2 * axis, by_y)):
                    if axis < 2 and slope is not None:
                        values[slot] = dr.fma(c, slope, values[slot])
        return values

    def _look(self) -> Any:
        """Rotation icrs from cam, as nine numbers, at a time and row."""
        F, last = self.F, len(self.exposed.attitudes) - 1
        if last == 0:
            still = _transposed(*(dr.gather(F, component, self.U(0)) for component in self.attitude))
            return lambda time, row: still
        exposed = self.exposed
        per_s = self.number(last / exposed.duration_s)
        exposure, line = self.number(exposed.exposure_s), self.number(exposed.line_time_s)
        end = self.number(last)

        def look(time: Any, row: Any) -> list[Any]:
            at = dr.clip((time * exposure + row * line) * per_s, 0.0, end)
            low = dr.minimum(dr.floor(at), end - 1.0)
            index, part = self.U(low), at - low
            return _transposed(
                *(dr.lerp(dr.gather(F, c, index), dr.gather(F, c, index + 1), part) for c in self.attitude)
            )

        return look

    def _cell(self, flat: bool) -> Any:
        """Light of a cell: radiance over that of a white surface lit square on, over pi, times the part that is lit."""
        sphere = self.sphere
        c, sine = self.vector(sphere.direction), self.number(sphere.sine)
        covers = [(self.vector(cover.direction), self.number(cover.sine)) for cover in sphere.covers]
        surface, air = self._surface(c, sine), self._air(c, sine)

        def cell(axes: list[Any], tx: Any, ty: Any, slope: list[Any], side: Any, air_of_ray: Any) -> Any:
            inverse = dr.rsqrt(1.0 + tx * tx + ty * ty)
            cam = (tx * inverse, ty * inverse, inverse)
            v = _turned(axes, *cam)
            # how v moves from one side of the cell to the other
            moves = []
            for a, b in ((slope[0], slope[2]), (slope[1], slope[3])):
                along = (cam[0] * a + cam[1] * b) * inverse
                steps = (a * inverse - along * cam[0], b * inverse - along * cam[1], -along * cam[2])
                moves.append(_turned(axes, *(m * side for m in steps)))
            edge = Edge.of(c, sine, v, moves)
            inside = edge.inside()
            value = inside if flat else surface(edge)
            if air is not None:
                value += (1.0 - inside) * air(v, *air_of_ray)
            for direction, size in covers:
                value *= 1.0 - Edge.of(direction, size, v, moves).inside()
            return value / math.pi

        return cell

    def _surface(self, c: list[Any], sine: Any) -> Any:
        """Light of the part of a cell that the disk takes: where limb or terminator cross the cell, between them.

        The light of a limb changes as the square root of the depth, so that it is smooth in the cosine of emission mu;
        equal areas of the disk have equal parts of its square.
        """
        sphere, turn = self.sphere, self.vector(self.sphere.rotation_icrs_from_body)
        lights = [(self.vector(light.towards), self.number(light.irradiance)) for light in sphere.lights]
        cut = self._cut_surface(c, sine)

        def smooth(edge: Edge) -> Any:
            ends = [dr.safe_sqrt(1.0 - dr.square(1.0 - (edge.d + t) * edge.size / sine)) for t in (-0.5, 0.5)]
            middle, half = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
            value, weight = self.F(0.0), self.F(0.0)
            for node in GAUSS:
                mu = dr.fma(half, node, middle)
                n = edge.normal(c, sine, dr.safe_sqrt(1.0 - mu * mu), mu)
                value += mu * sum(irradiance * self._lit(n, mu, towards, turn) for towards, irradiance in lights)
                weight += mu
            return value / dr.maximum(weight, 1e-300)

        def surface(edge: Edge) -> Any:
            above = [1.0 - depth / sine for depth in (edge.ends()[0], edge.ends()[3])]
            crossed = (above[0] > 1.0) | (above[1] < 0.0)
            for towards, _ in lights:
                heights = [_dot(edge.normal(c, sine, r, dr.safe_sqrt(1.0 - r * r)), towards) for r in above]
                crossed |= heights[0] * heights[1] < 0.0
            numbers = (edge.outwards, edge.d, edge.a, edge.b, edge.size)
            ahead = edge.ahead & (above[1] < 1.0)
            return dr.if_stmt(
                numbers,
                crossed & ahead,
                lambda *at: cut(Edge(self.B(True), *at)),
                lambda *at: dr.select(ahead, smooth(Edge(self.B(True), *at)), 0.0),
                arg_labels=("outwards", "d", "a", "b", "size"),
                label="disk",
            )

        return surface

    def _cut_surface(self, c: list[Any], sine: Any) -> Any:
        """Light of a cell that limb or terminator cross: exact along the normal of the limb.

        The integral over the depth is taken in the angle of emission e, depth = sine (1 - sin e). Along a radius of the
        disk a source is above the horizon on one side of one e; every source's light is integrated on its own side.
        """
        turn = self.vector(self.sphere.rotation_icrs_from_body)
        lights = [(self.vector(light.towards), self.number(light.irradiance)) for light in self.sphere.lights]
        quarter = 0.5 * math.pi

        def cut(edge: Edge) -> Any:
            total = self.F(0.0)
            ends = [dr.safe_asin(1.0 - dr.clip(depth / sine, 0.0, 2.0)) for depth in edge.ends()]
            for towards, irradiance in lights:
                sun, across = -_dot(c, towards), _dot(edge.outwards, towards)
                scale = dr.rsqrt(dr.maximum(sun * sun + across * across, 1e-300))
                dusk = dr.clip(dr.atan2(sun * scale, dr.abs(across) * scale - sine), -quarter, quarter)
                low, high = dr.select(across > 0.0, -dusk, -quarter), dr.select(across > 0.0, quarter, dusk)
                part = self.F(0.0)
                for upper, lower in itertools.pairwise(dr.clip(end, low, high) for end in ends):
                    middle, half = 0.5 * (upper + lower), 0.5 * (upper - lower)
                    for node in GAUSS:
                        above, mu = dr.sincos(dr.fma(half, node, middle))
                        light = self._lit(edge.normal(c, sine, above, mu), mu, towards, turn)
                        part += half * mu * light * edge.density(sine * (1.0 - above))
                total += part * irradiance
            return total * sine

        return cut

    def _lit(self, n: list[Any], mu: Any, towards: list[Any], turn: list[Any]) -> Any:
        """Light that a place with the normal n, seen under an angle of cosine mu, throws back of a source."""
        mu0 = dr.maximum(_dot(n, towards), 0.0)
        light = 2.0 * mu0 / dr.maximum(mu0 + mu, 1e-300) if self.sphere.law == "lunar" else mu0
        if self.albedo is None:
            return light
        return light * self._factor([sum(turn[3 * k + j] * n[k] for k in range(3)) for j in range(3)])

    def _air(self, c: list[Any], sine: Any) -> Any:
        """Light of the air in a direction that passes the sphere (`render.bodies.earth_air`); None without air."""
        air = self.sphere.air
        if air is None:
            return None
        lights = [(self.vector(light.towards), self.number(light.irradiance)) for light in self.sphere.lights]
        scale, slant, ground = (self.number(v) for v in (air.height, air.slant, 0.5 * air.ground))

        def halo(v: list[Any], thickness: Any, albedo_inverse: Any) -> Any:
            along, off2 = cosine_and_sine2(c, v)
            off = dr.sqrt(off2)
            above = dr.maximum(off / sine - 1.0, 0.0)
            slant_depth = thickness * dr.exp(-above / scale)
            value = self.F(0.0)
            for towards, irradiance in lights:
                mu0 = sum((along * a - m) * t for a, m, t in zip(v, c, towards, strict=True)) / off
                grazing = dr.rsqrt(mu0 * mu0 + 4.0 / dr.square(slant))  # Chapman's function up to 90 deg
                lowest = (1.0 + above) * dr.safe_sqrt(1.0 - mu0 * mu0) - 1.0  # of a ray that comes from below
                beyond = dr.exp(-dr.clip((lowest - above) / scale, -40.0, 0.0)) * slant - grazing
                transmitted = dr.exp(-dr.minimum(slant_depth, 1.0) / slant * dr.select(mu0 > 0.0, grazing, beyond))
                transmitted = dr.select((mu0 > 0.0) | (lowest > 0.0), transmitted, 0.0)
                phase = 0.1875 * (1.0 + dr.square(_dot(v, towards)))
                value += (phase * transmitted + ground * dr.maximum(mu0, 0.0)) * irradiance
            return dr.select(along > 0.0, value * albedo_inverse * (1.0 - dr.exp(-slant_depth)), 0.0)

        return halo

    def _factor(self, n: list[Any]) -> Any:
        """The map at a point of the sphere, linear between the centres of its cells."""
        assert self.sphere.albedo_map is not None
        albedo = self.albedo
        rows, columns = self.sphere.albedo_map.shape
        u = (dr.atan2(n[1], n[0]) / (2.0 * math.pi) + 0.5) * columns - 0.5
        v = dr.clip((dr.safe_asin(n[2]) / math.pi + 0.5) * rows - 0.5, 0.0, rows - 1.0)
        column, row = dr.floor(u), dr.minimum(dr.floor(v), rows - 2.0)
        x0 = self.U(dr.select(column < 0.0, column + columns, column))
        x1 = dr.select(x0 + 1 >= columns, self.U(0), x0 + 1)
        first = self.U(row) * columns
        below, above = (
            dr.lerp(dr.gather(self.F, albedo, start + x0), dr.gather(self.F, albedo, start + x1), u - column)
            for start in (first, first + columns)
        )
        return dr.lerp(below, above, v - row)


def _dot(a: list[Any], b: list[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _transposed(x: Any, y: Any, z: Any, w: Any) -> list[Any]:
    """Nine numbers of the inverse of a rotation given as a quaternion of any length."""
    s = 2.0 / (x * x + y * y + z * z + w * w)
    return [
        1.0 - s * (y * y + z * z), s * (x * y + z * w), s * (x * z - y * w),
        s * (x * y - z * w), 1.0 - s * (x * x + z * z), s * (y * z + x * w),
        s * (x * z + y * w), s * (y * z - x * w), 1.0 - s * (x * x + y * y),
    ]  # fmt: skip


def _turned(matrix: list[Any], x: Any, y: Any, z: Any) -> list[Any]:
    return [matrix[3 * k] * x + matrix[3 * k + 1] * y + matrix[3 * k + 2] * z for k in range(3)]
