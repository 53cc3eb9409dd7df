"""The image of stars as a differentiable function of lens, focus, directions and rates (Dr.Jit).

The rays of `render.tracing.tracer` are traced once more in arrays with derivatives. Pixel values are sums over rays, so
that their derivatives are exact for the quadrature itself. The quadrature moves with the lens too: for a stop inside
the lens, the chief ray and the outline of the beam are zeros of a function of lens and direction, and one Newton step
from the known zero has its derivative. A beam cut by other apertures (arcs, or Sobol points lost at an edge) has no
derivative by sampling, and is refused.

Diffraction images are sums of plane waves over windows (`render.tracing.waves.adjoint`). Stamps, pixels and motion are
those of `render.tracing.waves.images`, in double precision; images that the renderer interpolates between rays or
between field points are summed ray by ray.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from optics.arrays import BoolArray, FloatArray, IntArray
from optics.errors import ConfigError
from optics.rays.entrance_pupil import EntrancePupil
from optics.rays.program import LensProgram, compile_lens
from optics.rays.ray_aiming import up_to_surface, without_apertures
from optics.rays.trace import Rays, trace_program
from render.camera import Camera
from render.engine.arrays import DrJitArrays
from render.engine.jit import dr
from render.engine.upload import uploaded
from render.records import StarField
from render.tracing.motion.paths import NodeLight, StarPaths, at_rest, pick_times
from render.tracing.pupil.outlines import ARMS, Arcs, Outlines, outline_series
from render.tracing.pupil.planning import Group
from render.tracing.pupil.points import OutlinePoints, PupilPoints, TablePoints
from render.tracing.rays.kernel import PIXEL_REACH, StarKernel, gaussian_weights
from render.tracing.tracer import Tracer
from render.tracing.waves.adjoint import WaveLanes, Window, summed_waves
from render.tracing.waves.direct_sums import DirectSums, Probe
from render.tracing.waves.images import WaveImages
from render.tracing.waves.pixel_kernel import FieldSampling
from render.tracing.waves.plane_waves import DIFFERENCE

AIM, RIM = 1e-4, 1e-5
"""Differences by which the slopes of Newton's last step are taken, in radii of the launch disk."""
PASS_RAYS, WAVE_PASS_RAYS = 1 << 22, 1 << 19


@dataclass(frozen=True, slots=True)
class LensNumbers:
    """Camera parameters of the trace as one vector: lens, lens up to the stop, launch disk, stop's radius."""

    program: LensProgram  # The lens
    front: LensProgram  # The lens up to its stop without apertures, of the same parameters
    stop: int  # Number of the stop
    values: FloatArray  # (m,) The parameters, then centre and radius of the launch disk (4) and the radius of the stop


def lens_numbers(camera: Camera, pupil: EntrancePupil) -> LensNumbers:
    """Numbers of a camera, in one structure for all its perturbed copies.

    The launch disk is the camera's or, where the stop lies inside, that of one that it is a perturbed copy of: the
    aimed ray does not depend on its start.
    """
    lens = camera.focused_lens
    program, theta = compile_lens(lens, general=True)
    stop = lens.surfaces[lens.stop_index]
    disk = [pupil.x_mm, pupil.y_mm, pupil.z_mm, pupil.radius_mm]
    if pupil.exact:
        disk = [*stop.position_mm.tolist(), stop.semi_diameter_mm]
    front = up_to_surface(without_apertures(program), lens.stop_index)
    return LensNumbers(program, front, lens.stop_index, np.concatenate([theta, disk, [stop.semi_diameter_mm]]))


@dataclass(frozen=True, slots=True)
class AttachedPaths:
    """Directions of n stars in cam at t times, with derivatives; a global shutter."""

    plain: StarPaths  # The same without
    middle: list[Any]  # (n,) In the middle of the exposure
    nodes: list[Any]  # (n t,) At the time nodes
    length_px: float = 0.0  # Length of the paths


class _LaneParameters:
    """One array, element by element, as wide as the rays: derivatives of all of them are then one vector.

    Elements without derivatives are single numbers.
    """

    def __init__(self, scene: AttachedTrace, width: int, start: int = 0) -> None:
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
    """Input of one bundle of lanes; see `AttachedTrace.bundle`."""

    theta: _LaneParameters
    disk: list[Any]
    stop: Any


class AttachedTrace:
    """Arrays with derivatives, common to all passes."""

    def __init__(
        self, mi: Any, tracer: Tracer, numbers: LensNumbers, vector: Any, moves: BoolArray, paths: AttachedPaths
    ) -> None:
        self.still, self.moves = dr.detach(vector), moves
        self.F, self.U, self.I, self.B = mi.Float64, mi.UInt32, mi.Int32, mi.Bool
        self.xp = DrJitArrays(self.F)
        self.camera, self.numbers, self.vector = tracer.camera, numbers, vector
        self.middle, self.light = ([x, -y, z] for x, y, z in (paths.middle, paths.nodes))
        self.times, self.weight = paths.plain.weight.shape[1], uploaded(self.F, paths.plain.weight)
        self.picked, self.factors = _picked(self, paths.plain)

    def bundle(self, width: int) -> _Bundle:
        """Numbers of the lens for a number of lanes."""
        tail = _LaneParameters(self, width, self.numbers.program.size)
        return _Bundle(_LaneParameters(self, width), tail[0:4], tail[4])

    def trace(
        self, bundle: _Bundle, light: list[Any], star: Any, px: Any, py: Any, wave: Any, *, to_stop: bool = False
    ) -> Rays:
        """Rays of light's directions through points of the launch disk, on the image plane or at the stop."""
        x0, y0, z0, radius = bundle.disk
        direction = [dr.gather(self.F, component, star) for component in light]
        start = (x0 + px * radius, y0 + py * radius, z0 + 0.0 * px)
        rays = self.xp.rays(start, direction, wave, dr.width(star))
        if not to_stop:
            return trace_program(self.numbers.program, bundle.theta, rays, self.xp)
        at_stop: list[Rays] = []

        def visit(number: int, surface_rays: Rays) -> None:
            if number == self.numbers.stop:
                at_stop.append(surface_rays)

        trace_program(self.numbers.front, bundle.theta, rays, self.xp, visit)
        return at_stop[0]


def _picked(scene: AttachedTrace, plain: StarPaths) -> tuple[list[Any], list[Any]]:
    """`render.tracing.motion.paths.pick_times` with derivatives: directions of (n p,) rays, p weights (n t,)."""
    F, U, times = scene.F, scene.U, scene.times
    count = pick_times(plain)[1].shape[2]
    if count == 1:
        return scene.middle, [dr.full(F, 1.0, len(plain.mid) * times)]
    farthest = np.linalg.norm(plain.nodes - plain.mid[:, None], axis=2).argmax(1) + times * np.arange(len(plain.mid))
    star = dr.arange(U, len(plain.mid) * times) // times
    offset = [a - dr.gather(F, m, star) for a, m in zip(scene.light, scene.middle, strict=True)]
    reach = [dr.gather(F, a, uploaded(U, farthest.astype(np.uint32))) for a in offset]
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
    # vector (m,): values of ``numbers``, with derivatives where ``moves`` (m,); rate (n b k,) with derivatives
    if tracer.camera.scatter is not None:
        raise ConfigError("derivatives of halos are not available; leave Camera.scatter out")
    if stars.collimation is not None:
        raise ConfigError("derivatives of stars behind a collimator are not available; leave collimation out")
    trace_of = partial(AttachedTrace, mi, tracer, numbers, vector, moves)
    image_of = _ray_image if tracer.camera.diffraction == "rays" else _wave_image
    return image_of(trace_of, tracer, stars, paths, exposure_s, rate)


TraceOf = Callable[[AttachedPaths], AttachedTrace]


def _ray_image(
    trace_of: TraceOf, tracer: Tracer, stars: StarField, paths: AttachedPaths, exposure_s: float, rate: Any
) -> Any:
    """The image by rays."""
    scene = trace_of(paths)
    F, camera, planner = scene.F, tracer.camera, tracer.planner
    exposure = planner.exposure(paths.plain, stars.wavelength_nm, paths.length_px)
    response = uploaded(F, camera.response_at(stars.wavelength_nm))
    bands, nodes = stars.wavelength_nm.shape
    image = dr.zeros(F, camera.height_px * camera.width_px * bands)
    for group in planner.sampled_by_rays(exposure).groups:
        if not len(group.members):
            continue
        outlines = _smooth(group)
        step = max(1, PASS_RAYS // (bands * nodes * scene.times * group.rays))
        for part in (group.members[i : i + step] for i in range(0, len(group.members), step)):
            points = group.of(part)
            sample = _sample(scene, outlines, part, points, stars.wavelength_nm)
            sample = _through(exposure.nodes, sample, part, stars.wavelength_nm)
            _splat(scene, image, part, points.count, stars.wavelength_nm, sample, rate, response, exposure_s)
    return image


def _smooth(group: Group) -> Outlines | None:
    """Outlines of a group whose stars have derivatives; None where the launch disk is the outline."""
    outlines = group.outlines
    if group.mode == "quadrature" and not isinstance(outlines, Arcs) and (outlines is None or outlines.shadow is None):
        return outlines
    raise ConfigError(
        f"star {group.members[0]} has no derivative: its beam is sampled by {group.mode}, because its beam has no "
        "smooth outline or there is no charge diffusion; only beams limited by the stop alone have a derivative"
    )


Sample = Callable[[Any, Any, Any], tuple[Any, Any, Any]]
"""(slot, node, point) -> coordinates in radii of the launch disk, and fraction of its area."""


def _sample(
    scene: AttachedTrace,
    outlines: Outlines | None,
    part: IntArray,
    points: PupilPoints,
    wavelength_nm: FloatArray,
) -> Sample:
    """Points inside outlines, with derivatives, or of a table, without."""
    if isinstance(points, OutlinePoints):
        assert outlines is not None
        return _outline_points(scene, outlines, part, points, wavelength_nm)
    assert isinstance(points, TablePoints)
    types = SimpleNamespace(Float64=scene.F, UInt32=scene.U)
    return partial(points.sample, types)


def _through(
    kernel: StarKernel,
    sample: Sample,
    part: IntArray,
    wavelength_nm: FloatArray,
    of: Callable[[Any], Any] = lambda v: v,
) -> Sample:
    """Points whose fractions are multiplied by the transmission of their rays, or by its root, without derivatives."""

    def passed(slot: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        px, py, fraction = sample(slot, node, point)
        rays = dr.detach(px), dr.detach(py)
        transmission = kernel.ray_transmission(*rays, slot, node, wavelength_nm, part.astype(np.uint32))
        return px, py, fraction if transmission is None else fraction * of(transmission)

    return passed


def _outline_points(
    scene: AttachedTrace, outlines: Outlines, part: IntArray, points: OutlinePoints, wavelength_nm: FloatArray
) -> Sample:
    """Points inside outlines that move with lens and direction."""
    F, U = scene.F, scene.U
    centre = _attached_chiefs(scene, outlines.chief, part, wavelength_nm.mean(1))
    few = _rims(scene, outlines, part, centre)
    bands, colours, picked = outlines.picks.colours.shape
    nodes, arms = points.radius.shape[-2:]  # nodes are all colours of the first time, then all of the second
    matrix = outline_series(points.azimuth)  # (nodes, arms, ARMS)
    lane = dr.arange(U, len(part) * bands * nodes * arms)
    arm, node, slot = lane % arms, lane // arms % nodes, lane // (arms * nodes)
    band, star = slot % bands, dr.gather(U, U(part.astype(np.uint32)), slot // bands)
    radius = dr.zeros(F, 1)
    for j in range(picked):
        factors = uploaded(F, outlines.picks.colours[:, :, j])
        colour = dr.gather(F, factors, band * colours + node % colours)
        for m in range(ARMS):
            factor = dr.gather(F, uploaded(F, matrix[:, :, m]), node * arms + arm)
            for p, by_time in enumerate(scene.factors):
                time_factor = dr.gather(F, by_time, star * scene.times + node // colours)
                at = ((slot * len(scene.factors) + p) * picked + j) * ARMS + m
                radius = radius + time_factor * colour * factor * dr.gather(F, few, at)
    along = [uploaded(F, v) for v in (np.cos(points.azimuth), np.sin(points.azimuth))]
    weight = F(points.ring_weight)
    part_of_turn = float((points.area / points.radius**2).flat[0])  # the same for every azimuth
    ring, which = F(points.ring), U(points.arm)

    def sample(slot: Any, node: Any, point: Any) -> tuple[Any, Any, Any]:
        arm, rho = dr.gather(U, which, point), dr.gather(F, ring, point)
        rim = dr.gather(F, radius, (slot * nodes + node) * arms + arm)
        at = node * arms + arm
        x, y = (dr.gather(F, centre[axis], slot) + rho * rim * dr.gather(F, along[axis], at) for axis in (0, 1))
        return x, y, rim * rim * part_of_turn * dr.gather(F, weight, point)

    return sample


def _attached_chiefs(scene: AttachedTrace, chief: FloatArray, part: IntArray, wavelength_nm: FloatArray) -> list[Any]:
    """Launch points of chief rays (s b,), in radii of the launch disk, with derivatives."""
    F, U = scene.F, scene.U
    bands = len(wavelength_nm)
    lane = dr.arange(U, len(part) * bands)
    star = dr.gather(U, U(part.astype(np.uint32)), lane // bands)
    wave = dr.gather(F, F(wavelength_nm), lane % bands)
    start = [uploaded(F, chief[part][..., axis]) for axis in (0, 1)]
    bundle = scene.bundle(len(part) * bands)

    def at_stop(px: Any, py: Any) -> tuple[Any, Any]:
        rays = scene.trace(bundle, scene.middle, star, px, py, wave, to_stop=True)
        return rays.x, rays.y

    with dr.suspend_grad():
        columns = []
        for dx, dy in ((AIM, 0.0), (0.0, AIM)):
            ahead, behind = at_stop(start[0] + dx, start[1] + dy), at_stop(start[0] - dx, start[1] - dy)
            columns.append([(a - b) * (0.5 / AIM) for a, b in zip(ahead, behind, strict=True)])
        (a, c), (b, d) = columns
        scale = 1.0 / (a * d - b * c)
        dr.eval(a, b, c, d, scale)
    u, v = at_stop(*start)
    centre = [start[0] - (d * u - b * v) * scale, start[1] - (a * v - c * u) * scale]
    dr.eval(centre)
    return centre


def _rims(scene: AttachedTrace, outlines: Outlines, part: IntArray, centre: list[Any]) -> Any:
    """Radii of outlines (s b picked `ARMS`,), at few times and wavelengths, with derivatives."""
    F, U = scene.F, scene.U
    picks = outlines.picks
    bands, picked = picks.wavelength_nm.shape
    times = len(scene.factors)
    lane = dr.arange(U, len(part) * bands * times * picked * ARMS)
    arm, pick, node = lane % ARMS, lane // ARMS % picked, lane // (ARMS * picked)
    slot = node // times
    star = dr.gather(U, U(part.astype(np.uint32)), slot // bands) * times + node % times
    wave = dr.gather(F, uploaded(F, picks.wavelength_nm), slot % bands * picked + pick)
    sine, cosine = dr.sincos(F(arm) * (2.0 * np.pi / ARMS))
    x, y = (dr.gather(F, component, slot) for component in centre)
    start = uploaded(F, outlines.radius[part])
    bundle = scene.bundle(len(part) * bands * times * picked * ARMS)

    def height(radius: Any) -> Any:
        rays = scene.trace(bundle, scene.picked, star, x + radius * cosine, y + radius * sine, wave, to_stop=True)
        return dr.sqrt(rays.x * rays.x + rays.y * rays.y) / bundle.stop

    with dr.suspend_grad():
        slope = (height(start + RIM) - height(start - RIM)) * (0.5 / RIM)
        dr.eval(slope)
    return start - (height(start) - 1.0) / slope  # Newton's step from a root: the root again, with its derivative


def _splat(
    scene: AttachedTrace,
    image: Any,
    part: IntArray,
    count: int,
    wavelength_nm: FloatArray,
    sample: Sample,
    rate: Any,
    response: Any,
    exposure_s: float,
) -> None:
    """Add stars to the image, ray by ray, as `render.tracing.rays.kernel.StarKernel.splat` does."""
    F, U, camera = scene.F, scene.U, scene.camera
    bands, colours = wavelength_nm.shape
    nodes = scene.times * colours
    total = len(part) * bands * nodes * count
    lane = dr.arange(U, total)
    point, node, slot = lane % count, lane // count % nodes, lane // (count * nodes)
    star, colour = dr.gather(U, U(part.astype(np.uint32)), slot // bands), slot % bands * colours + node % colours
    star_time = star * scene.times + node // colours
    wave = dr.gather(F, uploaded(F, wavelength_nm), colour)
    bundle = scene.bundle(total)
    px, py, fraction = sample(slot, node, point)
    rays = scene.trace(bundle, scene.light, star_time, px, py, wave)
    pitch, (cx, cy) = camera.pixel_pitch_mm, camera.centre_px
    x, y = float(cx) + rays.x * (1.0 / pitch), float(cy) - rays.y * (1.0 / pitch)
    toward = dr.gather(F, scene.light[2], star_time) * dr.gather(F, scene.weight, star_time)
    area = np.pi * exposure_s * dr.square(bundle.disk[3])
    light = dr.gather(F, rate, star * (bands * colours) + colour) * dr.gather(F, response, colour)
    light = light * toward * area * fraction
    sigma = camera.blur_px
    columns, rows = (gaussian_weights(scene.F, scene.I, v + 0.5, sigma, PIXEL_REACH) for v in (x, y))
    sensitive = camera.sensitive_columns
    open_ = None if sensitive is None else scene.B(sensitive)
    for r, along_y in enumerate(rows[1]):
        row = rows[0] + r
        for c, along_x in enumerate(columns[1]):
            column = columns[0] + c
            inside = (row >= 0) & (row < camera.height_px) & (column >= 0) & (column < camera.width_px)
            if open_ is not None:
                inside &= dr.gather(scene.B, open_, U(dr.maximum(column, 0)), inside)
            index = (U(row) * camera.width_px + U(column)) * bands + slot % bands
            dr.scatter_add(image, light * along_y * along_x, index, inside)


def _wave_image(
    trace_of: TraceOf, tracer: Tracer, stars: StarField, paths: AttachedPaths, exposure_s: float, rate: Any
) -> Any:
    """The image by sums of plane waves."""
    camera, planner, waves = tracer.camera, tracer.planner, WaveImages(tracer.planner)
    light = tracer.light(stars, paths.plain, exposure_s)
    exposure = planner.exposure(paths.plain, stars.wavelength_nm, paths.length_px)
    few, images = waves.summed(light, exposure)
    scene = trace_of(AttachedPaths(at_rest(paths.plain.mid), paths.middle, paths.middle))
    moving = trace_of(paths) if images.trail is not None else scene
    (bands, colours), mean_nm = stars.wavelength_nm.shape, stars.wavelength_nm.mean(1)
    each = np.broadcast_to(np.eye(colours)[:, None], (colours, bands, colours))
    mixed = waves.condensed(NodeLight(stars.wavelength_nm, each, light.electrons), exposure).weight  # (k, b, q)
    response = camera.response_at(stars.wavelength_nm) * (math.pi * exposure_s)
    F = scene.F
    image = dr.zeros(F, camera.height_px * camera.width_px * bands)
    near = waves.near(planner.sampled_by_rays(exposure).bounds)
    for probe in (p for group in planner.sampled_by_waves(images.still, near).groups for p in images.probes(group)):
        outlines = _smooth(replace(probe.group, members=probe.stars))
        for part, radius, fields, order in _batches(images, probe):
            points = probe.group.of(part, order)
            sample = _sample(scene, outlines, part, points, few.wavelength_nm)
            sample = _through(images.kernel, sample, part, few.wavelength_nm, dr.sqrt)
            chief = [dr.zeros(F, len(part) * bands)] * 2
            if outlines is not None:
                chief = _attached_chiefs(scene, outlines.chief, part, mean_nm)
            offset, weight = _motion(moving, part, mean_nm, chief, images)
            windows = _windows(images, probe, part, radius, fields)
            energy = _energy(scene, part, rate, response[..., None] * np.swapaxes(mixed, 0, 1))
            lanes = _plane_waves(scene, part, few.wavelength_nm, points, sample, windows)
            stamps = summed_waves(F, windows, lanes, energy, offset, weight, values=False)
            _add(scene, image, windows, stamps, bands)
    return image


def _batches(
    images: DirectSums, probe: Probe
) -> list[tuple[IntArray, float, tuple[FieldSampling, ...], tuple[int, int]]]:
    """Stars of a probe with the same window and the same rays, not too many of them at a time."""
    radius, highest, order = images.needs(probe)
    keys = list(zip(radius.tolist(), map(tuple, highest.tolist()), map(tuple, order.max((1, 2)).tolist()), strict=True))
    batches = []
    for key in sorted(set(keys)):
        stars = probe.stars[[other == key for other in keys]]
        step = max(1, WAVE_PASS_RAYS // (math.prod(key[2]) * images.wavelength_nm.size))
        for i in range(0, len(stars), step):
            batches.append((stars[i : i + step], key[0], tuple(map(images.sampling, key[1])), key[2]))
    return batches


def _windows(
    images: DirectSums, probe: Probe, part: IntArray, radius: float, fields: tuple[FieldSampling, ...]
) -> list[Window]:
    """Windows of some stars of a probe, band by band."""
    mean, _ = images.means(part, probe.waves.take(np.searchsorted(probe.stars, part)))
    size, trail = 2 * int(radius) + 1, images.trail
    mean = np.nan_to_num(mean)
    corner = np.rint(mean) - 0.5 * size
    first, more = (np.zeros_like(corner), 0) if trail is None else trail.room(part)
    sigma, moving = images.camera.blur_px, trail is not None
    return [
        Window(corner[s, b], mean[s, b], size, fields[b], sigma, first[s, b], size + more, moving)
        for s, b in np.ndindex(*corner.shape[:2])
    ]


def _energy(scene: AttachedTrace, part: IntArray, rate: Any, mixed: FloatArray) -> Any:
    """Light (s b q,) of the wavelengths that have images [e-], but for the slant of the launch disk.

    ``mixed`` (b, k, q) leads from photon rates to it, for a disk of radius 1 / sqrt(pi).
    """
    F, U = scene.F, scene.U
    bands, colours, few = mixed.shape
    lane = dr.arange(U, len(part) * bands * few)
    band, star = lane // few % bands, dr.gather(U, U(part.astype(np.uint32)), lane // (few * bands))
    total = dr.zeros(F, 1)
    for k in range(colours):
        factor = dr.gather(F, uploaded(F, mixed[:, k]), band * few + lane % few)
        total = total + factor * dr.gather(F, rate, (star * bands + band) * colours + k)
    return total * dr.square(scene.bundle(len(part) * bands * few).disk[3])


def _motion(
    scene: AttachedTrace, part: IntArray, wavelength_nm: FloatArray, chief: list[Any], images: DirectSums
) -> tuple[tuple[Any, Any], Any]:
    """Offsets of images [px] and parts of the light, at all times (s b t,)."""
    F, U, bands, times = scene.F, scene.U, len(wavelength_nm), scene.times
    count = len(part) * bands * times
    lane = dr.arange(U, count)
    slot = lane // times
    star = dr.gather(U, U(part.astype(np.uint32)), slot // bands)
    at = star * times + lane % times
    weight = dr.gather(F, scene.light[2], at) * dr.gather(F, scene.weight, at)
    if images.trail is None:
        return (dr.zeros(F, count), dr.zeros(F, count)), weight
    wave = dr.gather(F, F(wavelength_nm), slot % bands)
    px, py = (dr.gather(F, c, slot) for c in chief)
    bundle, pitch = scene.bundle(count), scene.camera.pixel_pitch_mm
    moved, still = (
        scene.trace(bundle, light, which, px, py, wave) for light, which in ((scene.light, at), (scene.middle, star))
    )
    return ((moved.x - still.x) * (1.0 / pitch), (still.y - moved.y) * (1.0 / pitch)), weight


def _plane_waves(
    scene: AttachedTrace,
    part: IntArray,
    wavelength_nm: FloatArray,
    points: PupilPoints,
    sample: Sample,
    windows: list[Window],
) -> WaveLanes:
    """Plane waves of some stars, as `render.tracing.waves.plane_waves.trace_waves` traces them."""
    F, U, program = scene.F, scene.U, scene.numbers.program
    bands, colours = wavelength_nm.shape
    total = len(part) * bands * colours * points.count
    members, waves = U(part.astype(np.uint32)), uploaded(F, wavelength_nm)

    def lane_indices(lane: Any) -> tuple[Any, ...]:
        """Slot, node and point of a lane; its star and wavelength."""
        point, node, slot = lane % points.count, lane // points.count % colours, lane // (points.count * colours)
        star = dr.gather(U, members, slot // bands)
        return slot, node, point, star, dr.gather(F, waves, slot % bands * colours + node)

    # a ray and its two neighbours are lanes of one trace: three traces would be compiled separately
    every = dr.arange(U, 3 * total)
    slot, node, point, star, wave = lane_indices(every // 3)
    px, py, _ = sample(slot, node, point)
    dx, dy = (F(dr.select(every % 3 == k, DIFFERENCE, 0.0)) for k in (1, 2))
    rays = scene.trace(scene.bundle(3 * total), scene.light, star, px + dx, py + dy, wave)
    dr.eval(rays.x, rays.y, rays.opl_mm, rays.dx, rays.dy)
    lane = dr.arange(U, total)
    x, y, opl_mm = (dr.gather(F, v, 3 * lane) for v in (rays.x, rays.y, rays.opl_mm))
    (ox, rx, ux), (oy, ry, uy) = ([dr.gather(F, v, 3 * lane + k) for k in range(3)] for v in (rays.dx, rays.dy))
    slot, node, point, star, wave = lane_indices(lane)
    bundle = scene.bundle(total)
    px, py, fraction = sample(slot, node, point)
    pitch, (cx, cy) = scene.camera.pixel_pitch_mm, scene.camera.centre_px
    theta: Any = bundle.theta
    before, behind = (
        program.media[medium].index(theta, wave, scene.xp)
        for medium in (program.steps[0].before, program.steps[-1].before)
    )
    per_px = behind * (pitch * 1e6) / wave
    jacobian = dr.abs((rx - ox) * (uy - oy) - (ux - ox) * (ry - oy)) * (1.0 / DIFFERENCE**2)
    dx, dy = (dr.gather(F, component, star) for component in scene.light[:2])
    path = opl_mm + before * bundle.disk[3] * (px * dx + py * dy)
    middle = np.stack([window.mean_px for window in windows])
    x = float(cx) + x * (1.0 / pitch) - dr.gather(F, uploaded(F, middle[:, 0]), slot)
    y = float(cy) - y * (1.0 / pitch) - dr.gather(F, uploaded(F, middle[:, 1]), slot)
    fx, fy = ox * per_px, -oy * per_px
    return WaveLanes(path * (1e6 / wave) - fx * x - fy * y, fx, fy, fraction * dr.sqrt(jacobian) * per_px)


def _add(scene: AttachedTrace, image: Any, windows: list[Window], stamps: Any, bands: int) -> None:
    """Add stamps to the image."""
    F, integer, U, camera, size = scene.F, scene.I, scene.U, scene.camera, windows[0].stamp_px
    lane = dr.arange(U, len(windows) * size**2)
    slot = lane // size**2
    corner = np.stack([window.corner_px + window.first_px + 0.5 for window in windows]).astype(np.int32)
    first = [dr.gather(integer, integer(np.ascontiguousarray(corner[:, axis])), slot) for axis in (0, 1)]
    column, row = first[0] + integer(lane % size), first[1] + integer(lane // size % size)
    inside = (row >= 0) & (row < camera.height_px) & (column >= 0) & (column < camera.width_px)
    sensitive = camera.sensitive_columns
    if sensitive is not None:
        open_ = F(np.asarray(sensitive, np.float64))
        inside &= dr.gather(F, open_, U(dr.maximum(column, 0)), inside) > 0.0
    index = (U(row) * camera.width_px + U(column)) * bands + slot % bands
    dr.scatter_add(image, stamps, index, inside)
