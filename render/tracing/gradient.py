"""The image of stars as a function that Dr.Jit differentiates: lens, focus, directions and rates.

The same rays as those of `render.tracing.tracer` are traced once more, in arrays with derivatives: pixel values are
sums over rays of what diffusion leaves on a pixel, so their derivatives are exact, of the quadrature itself. What
quadrature and lens have in common moves too: where the stop lies inside, the chief ray and the outline of the beam are
where a function of lens and direction is zero, and one Newton step from the point that is known there has its
derivative. A beam that other apertures cut (arcs, or Sobol points that are lost at an edge) has none that sampling can
tell, and is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import BoolArray, FloatArray, IntArray
from optics.errors import ConfigError
from optics.rays.aim import front_of, without_apertures
from optics.rays.program import LensProgram, compile_lens
from optics.rays.pupil import EntrancePupil
from optics.rays.trace import Rays, trace_program
from render.camera import Camera
from render.engine.arrays import DrJitArrays
from render.engine.jit import dr
from render.records import StarField
from render.tracing.kernel import PIXEL_REACH
from render.tracing.outlines import ARMS, Outlines, outline_series
from render.tracing.paths import StarPaths, pick_times
from render.tracing.pupil_points import OutlinePoints, TablePoints
from render.tracing.tracer import Tracer

__all__ = [
    "AttachedPaths",
    "LensNumbers",
    "Sample",
    "Scene",
    "attached_chiefs",
    "lens_numbers",
    "outline_points",
    "refused",
    "star_image",
    "table_points",
]

AIM, RIM = 1e-4, 1e-5
"""Differences by which the slopes of Newton's last step are taken, in radii of the launch disk."""
PASS_RAYS = 1 << 22


@dataclass(frozen=True, slots=True)
class LensNumbers:
    """What the trace reads of a camera, as one vector: lens, lens up to the stop, launch disk, stop's radius."""

    # program, front: The lens, and the lens up to its stop without apertures; both read the same parameters
    program: LensProgram
    front: LensProgram
    stop: int  # Number of the stop
    values: FloatArray  # (m,) The parameters, then centre and radius of the launch disk (4) and the radius of the stop


def lens_numbers(camera: Camera, pupil: EntrancePupil) -> LensNumbers:
    """Numbers of a camera, in a structure that its perturbed copies share.

    The launch disk is the camera's or, where the stop lies inside, that of one that it is a perturbed copy of: what is
    aimed does not depend on where it starts.
    """
    lens = camera.focused_lens
    program, theta = compile_lens(lens, general=True)
    stop = lens.surfaces[lens.stop_index]
    disk = [pupil.x_mm, pupil.y_mm, pupil.z_mm, pupil.radius_mm]
    if pupil.exact:
        disk = [*stop.position_mm.tolist(), stop.semi_diameter_mm]
    front = front_of(without_apertures(program), lens.stop_index)
    return LensNumbers(program, front, lens.stop_index, np.concatenate([theta, disk, [stop.semi_diameter_mm]]))


@dataclass(frozen=True, slots=True)
class AttachedPaths:
    """Directions of n stars in cam at t times, with derivatives; a global shutter."""

    plain: StarPaths  # The same without
    middle: list[Any]  # (n,) In the middle of the exposure
    nodes: list[Any]  # (n t,) At the time nodes
    length_px: float = 0.0  # Length of the paths


class _Numbers:
    """One array, element by element, as wide as the rays: derivatives of all of them are then one vector.

    Elements that nothing moves are single numbers.
    """

    def __init__(self, scene: Scene, width: int, start: int = 0) -> None:
        self.scene, self.start = scene, start
        self.base = dr.arange(scene.U, width) * dr.opaque(scene.U, 0)

    def __getitem__(self, at: int | slice) -> Any:
        if isinstance(at, slice):
            return [self[i] for i in range(at.start, at.stop)]
        scene, index = self.scene, self.start + at
        if scene.moves[index]:
            return dr.gather(scene.F, scene.vector, self.base + index)
        return dr.gather(scene.F, scene.still, dr.opaque(scene.U, index))


@dataclass(frozen=True, slots=True)
class _Bundle:
    """What one bundle of lanes needs; see `Scene.bundle`."""

    theta: _Numbers
    disk: list[Any]
    stop: Any


class Scene:
    """Arrays with derivatives that all passes share."""

    def __init__(
        self, mi: Any, tracer: Tracer, numbers: LensNumbers, vector: Any, moves: BoolArray, paths: AttachedPaths
    ) -> None:
        self.still, self.moves = dr.detach(vector), moves
        self.F, self.U, self.I = mi.Float64, mi.UInt32, mi.Int32
        self.xp = DrJitArrays(self.F)
        self.camera, self.numbers, self.vector = tracer.camera, numbers, vector
        self.middle, self.light = ([x, -y, z] for x, y, z in (paths.middle, paths.nodes))
        self.times, self.weight = paths.plain.weight.shape[1], self.F(np.ravel(paths.plain.weight))
        self.picked, self.factors = _picked(self, paths.plain)

    def bundle(self, width: int) -> _Bundle:
        """Numbers of the lens for so many lanes."""
        tail = _Numbers(self, width, self.numbers.program.size)
        return _Bundle(_Numbers(self, width), tail[0:4], tail[4])

    def trace(
        self, bundle: _Bundle, light: list[Any], star: Any, px: Any, py: Any, wave: Any, *, to_stop: bool = False
    ) -> Rays:
        """Rays of light's directions through points of the launch disk, on the image plane or at the stop."""
        x0, y0, z0, radius = bundle.disk
        dx, dy, dz = (dr.gather(self.F, component, star) for component in light)
        zero = dr.zeros(self.I, dr.width(star))
        rays = Rays(
            x=x0 + px * radius, y=y0 + py * radius, z=z0 + 0.0 * px, dx=dx, dy=dy, dz=dz,
            wavelength_nm=wave, opl_mm=self.F(0.0), status=zero, failed_at=zero - 1,
        )  # fmt: skip
        if not to_stop:
            return trace_program(self.numbers.program, bundle.theta, rays, self.xp)
        found: list[Rays] = []

        def visit(number: int, there: Rays) -> None:
            if number == self.numbers.stop:
                found.append(there)

        trace_program(self.numbers.front, bundle.theta, rays, self.xp, visit)
        return found[0]


def _picked(scene: Scene, plain: StarPaths) -> tuple[list[Any], list[Any]]:
    """What `render.tracing.paths.pick_times` picks, with derivatives: light of (n p,) rays, p factors (n t,)."""
    F, U, times = scene.F, scene.U, scene.times
    count = pick_times(plain)[1].shape[2]
    if count == 1:
        return scene.middle, [dr.full(F, 1.0, len(plain.mid) * times)]
    farthest = np.linalg.norm(plain.nodes - plain.mid[:, None], axis=2).argmax(1) + times * np.arange(len(plain.mid))
    star = dr.arange(U, len(plain.mid) * times) // times
    offset = [a - dr.gather(F, m, star) for a, m in zip(scene.light, scene.middle, strict=True)]
    reach = [dr.gather(F, a, U(farthest.astype(np.uint32))) for a in offset]
    size = dr.gather(F, sum(a * a for a in reach), star)
    c = sum(a * dr.gather(F, b, star) for a, b in zip(offset, reach, strict=True)) / size
    lane = dr.arange(U, len(plain.mid) * count)
    end = F(lane % count) * (2.0 / (count - 1)) - 1.0
    v = [
        dr.gather(F, m, lane // count) + end * dr.gather(F, r, lane // count)
        for m, r in zip(scene.middle, reach, strict=True)
    ]
    scale = dr.rsqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    linear = [0.5 - 0.5 * c, 0.5 + 0.5 * c]
    return [a * scale for a in v], linear if count == 2 else [0.5 * c * (c - 1.0), 1.0 - c * c, 0.5 * c * (c + 1.0)]


def _newton(value: Any, slope: Any, at: Any) -> Any:
    """One Newton step from a root: the root again, with its derivative."""
    return dr.detach(at) - value / dr.detach(slope)


def star_image(
    mi: Any,
    tracer: Tracer,
    stars: StarField,
    paths: AttachedPaths,
    exposure_s: float,
    *,
    numbers: LensNumbers,
    vector: Any,
    moves: BoolArray,
    rate: Any,
) -> Any:
    """Electrons of every pixel and band (h w b,) as an array with derivatives."""
    # vector (m,): values of ``numbers``, with derivatives where it moves (m,); rate (n b k,) with derivatives
    if stars.collimation is not None:
        raise ConfigError("derivatives of stars behind a collimator are not known; leave collimation out")
    F = mi.Float64
    camera, planner = tracer.camera, tracer.planner
    seen = planner.seen(paths.plain, stars.wavelength_nm, paths.length_px)
    chiefs = planner.chiefs(seen.mid, stars.wavelength_nm)
    scene = Scene(mi, tracer, numbers, vector, moves, paths)
    response = F(np.ascontiguousarray(camera.response_at(stars.wavelength_nm).ravel()))
    bands, nodes = stars.wavelength_nm.shape
    image = dr.zeros(F, camera.height_px * camera.width_px * bands)
    outlines = None if planner.pupil.exact else planner.shapes(seen, chiefs).outlines
    groups, *_ = planner.groups(seen, stars.wavelength_nm, chiefs)
    for group in groups:
        if not len(group.members):
            continue
        if group.plan.mode != "quadrature" or (outlines is not None and outlines.shadow is not None):
            raise refused(group.members[0], group.plan.mode)
        step = max(1, PASS_RAYS // (bands * nodes * scene.times * group.plan.rays_per_node))
        for part in (group.members[i : i + step] for i in range(0, len(group.members), step)):
            points = group.points(part)
            if isinstance(points, OutlinePoints):
                assert outlines is not None
                sample = outline_points(scene, outlines, part, points, stars.wavelength_nm)
            else:
                assert isinstance(points, TablePoints)
                sample = table_points(scene, points)
            _splat(mi, scene, image, part, points.count, stars.wavelength_nm, sample, rate, response, exposure_s)
    return image


def refused(star: int, mode: str) -> ConfigError:
    """The error for a star whose pupil has no smooth outline."""
    return ConfigError(
        f"star {star} has no derivative: its beam is sampled by {mode}, as the lens or the charge diffusion leaves no "
        "smooth outline; stars whose beam only the stop limits have one"
    )


Sample = Callable[[Any, Any, Any], tuple[Any, Any, Any]]
"""(slot, node, point) -> coordinates in radii of the launch disk, and share of its area."""


def table_points(scene: Scene, points: TablePoints) -> Sample:
    types = scene  # offers Float64 and UInt32 as the engine's module of types does

    class Types:
        Float64, UInt32 = types.F, types.U

    return lambda slot, node, point: points.sample(Types, slot, node, point)


def outline_points(
    scene: Scene, outlines: Outlines, part: IntArray, points: OutlinePoints, wavelength_nm: FloatArray
) -> Sample:
    """Points inside outlines that move with lens and direction."""
    F, U = scene.F, scene.U
    centre = attached_chiefs(scene, outlines.chief, part, wavelength_nm.mean(1))
    few = _rims(scene, outlines, part, centre)
    bands, colours, picked = outlines.picks.colours.shape
    nodes, arms = points.radius.shape[-2:]  # nodes are all colours of the first time, then all of the second
    matrix = outline_series(points.azimuth)  # (nodes, arms, ARMS)
    lane = dr.arange(U, len(part) * bands * nodes * arms)
    arm, node, slot = lane % arms, lane // arms % nodes, lane // (arms * nodes)
    band, star = slot % bands, dr.gather(U, U(part.astype(np.uint32)), slot // bands)
    radius = dr.zeros(F, 1)
    for j in range(picked):
        factors = F(np.ascontiguousarray(outlines.picks.colours[:, :, j].ravel()))
        colour = dr.gather(F, factors, band * colours + node % colours)
        for m in range(ARMS):
            factor = dr.gather(F, F(np.ascontiguousarray(matrix[:, :, m].ravel())), node * arms + arm)
            for p, by_time in enumerate(scene.factors):
                seen = dr.gather(F, by_time, star * scene.times + node // colours)
                at = ((slot * len(scene.factors) + p) * picked + j) * ARMS + m
                radius = radius + seen * colour * factor * dr.gather(F, few, at)
    along = [F(np.ascontiguousarray(v.ravel())) for v in (np.cos(points.azimuth), np.sin(points.azimuth))]
    weight = F(points.ring_weight)
    part_of_turn = float((points.share / points.radius**2).flat[0])  # the same for every azimuth
    ring, which = F(points.ring), U(points.arm)

    def sample(slot: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        arm, rho = dr.gather(U, which, point), dr.gather(F, ring, point)
        rim = dr.gather(F, radius, (slot * nodes + node) * arms + arm)
        at = node * arms + arm
        x, y = (dr.gather(F, centre[axis], slot) + rho * rim * dr.gather(F, along[axis], at) for axis in (0, 1))
        return x, y, rim * rim * part_of_turn * dr.gather(F, weight, point)

    return sample


def attached_chiefs(scene: Scene, chief: FloatArray, part: IntArray, wavelength_nm: FloatArray) -> list[Any]:
    """Launch points of chief rays (s b,), in radii of the launch disk, with derivatives."""
    F, U = scene.F, scene.U
    bands = len(wavelength_nm)
    lane = dr.arange(U, len(part) * bands)
    star = dr.gather(U, U(part.astype(np.uint32)), lane // bands)
    wave = dr.gather(F, F(wavelength_nm), lane % bands)
    start = [F(np.ascontiguousarray(chief[part][..., axis].ravel())) for axis in (0, 1)]
    bundle = scene.bundle(len(part) * bands)

    def at_stop(px: Any, py: Any) -> tuple[Any, Any]:
        rays = scene.trace(bundle, scene.middle, star, px, py, wave, to_stop=True)
        return rays.x, rays.y

    with dr.suspend_grad():
        columns = []
        for dx, dy in ((AIM, 0.0), (0.0, AIM)):
            ahead, back = at_stop(start[0] + dx, start[1] + dy), at_stop(start[0] - dx, start[1] - dy)
            columns.append([(a - b) * (0.5 / AIM) for a, b in zip(ahead, back, strict=True)])
        (a, c), (b, d) = columns
        scale = 1.0 / (a * d - b * c)
        dr.eval(a, b, c, d, scale)
    u, v = at_stop(*start)
    centre = [start[0] - (d * u - b * v) * scale, start[1] - (a * v - c * u) * scale]
    dr.eval(centre)
    return centre


def _rims(scene: Scene, outlines: Outlines, part: IntArray, centre: list[Any]) -> Any:
    """Radii of outlines (s b picked `ARMS`,), at few times and wavelengths, with derivatives."""
    F, U = scene.F, scene.U
    picks = outlines.picks
    bands, picked = picks.wavelength_nm.shape
    times = len(scene.factors)
    lane = dr.arange(U, len(part) * bands * times * picked * ARMS)
    arm, pick, node = lane % ARMS, lane // ARMS % picked, lane // (ARMS * picked)
    slot = node // times
    star = dr.gather(U, U(part.astype(np.uint32)), slot // bands) * times + node % times
    wave = dr.gather(F, F(picks.wavelength_nm.ravel()), slot % bands * picked + pick)
    sine, cosine = dr.sincos(F(arm) * (2.0 * np.pi / ARMS))
    x, y = (dr.gather(F, component, slot) for component in centre)
    start = F(np.ascontiguousarray(outlines.radius[part].ravel()))
    bundle = scene.bundle(len(part) * bands * times * picked * ARMS)

    def height(radius: Any) -> Any:
        rays = scene.trace(bundle, scene.picked, star, x + radius * cosine, y + radius * sine, wave, to_stop=True)
        return dr.sqrt(rays.x * rays.x + rays.y * rays.y) / bundle.stop

    with dr.suspend_grad():
        slope = (height(start + RIM) - height(start - RIM)) * (0.5 / RIM)
        dr.eval(slope)
    return _newton(height(start) - 1.0, slope, start)


def _splat(
    mi: Any,
    scene: Scene,
    image: Any,
    part: NDArray[Any],
    count: int,
    wavelength_nm: FloatArray,
    sample: Sample,
    rate: Any,
    response: Any,
    exposure_s: float,
) -> None:
    """Add stars to the image, ray by ray, as `render.tracing.kernel.StarKernel.splat` does."""
    F, U, camera = scene.F, scene.U, scene.camera
    bands, colours = wavelength_nm.shape
    nodes = scene.times * colours
    total = len(part) * bands * nodes * count
    lane = dr.arange(U, total)
    point, node, slot = lane % count, lane // count % nodes, lane // (count * nodes)
    star, colour = dr.gather(U, U(part.astype(np.uint32)), slot // bands), slot % bands * colours + node % colours
    seen = star * scene.times + node // colours
    wave = dr.gather(F, F(wavelength_nm.ravel()), colour)
    bundle = scene.bundle(total)
    px, py, share = sample(slot, node, point)
    rays = scene.trace(bundle, scene.light, seen, px, py, wave)
    pitch, (cx, cy) = camera.pixel_pitch_mm, camera.centre_px
    x, y = float(cx) + rays.x * (1.0 / pitch), float(cy) - rays.y * (1.0 / pitch)
    toward = dr.gather(F, scene.light[2], seen) * dr.gather(F, scene.weight, seen)
    area = np.pi * exposure_s * dr.square(bundle.disk[3])
    light = dr.gather(F, rate, star * (bands * colours) + colour) * dr.gather(F, response, colour)
    light = light * toward * area * share
    sigma = camera.charge_diffusion_px
    columns, rows = (_shares(scene, v + 0.5, sigma) for v in (x, y))
    sensitive = camera.sensitive_columns
    open_ = None if sensitive is None else mi.Bool(sensitive)
    for r, along_y in enumerate(rows[1]):
        row = rows[0] + r
        for c, along_x in enumerate(columns[1]):
            column = columns[0] + c
            inside = (row >= 0) & (row < camera.height_px) & (column >= 0) & (column < camera.width_px)
            if open_ is not None:
                inside &= dr.gather(mi.Bool, open_, U(dr.maximum(column, 0)), inside)
            index = (U(row) * camera.width_px + U(column)) * bands + slot % bands
            dr.scatter_add(image, light * along_y * along_x, index, inside)


def _shares(scene: Scene, position: Any, sigma: float) -> tuple[Any, list[Any]]:
    """First pixel and shares of a Gaussian around a position counted from the image's edge."""
    F = scene.F
    width = int(np.ceil(2.0 * PIXEL_REACH * sigma))
    first = dr.detach(dr.floor(position - 0.5 * width))
    shares, below = [], F(-1.0)
    for tap in range(1, width + 2):
        up_to = dr.erf((first + tap - position) * (1.0 / (np.sqrt(2.0) * sigma))) if tap <= width else F(1.0)
        shares.append(0.5 * (up_to - below))
        below = up_to
    return scene.I(first), shares
