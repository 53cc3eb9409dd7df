"""Diffraction images of stars as a function that Dr.Jit differentiates: lens, focus, directions and rates.

The plane waves of `render.tracing.plane_waves` are traced in arrays with derivatives, with the pupils, motion and
windows of `render.tracing.gradient` and `render.tracing.wave_images`; `render.tracing.wave_adjoint` sums them. Images
that the renderer interpolates, between few rays or between few places of the field, are summed ray by ray here.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from optics.arrays import BoolArray, FloatArray, IntArray
from optics.errors import ConfigError
from render.engine.jit import dr
from render.records import StarField
from render.tracing.gradient import (
    AttachedPaths,
    LensNumbers,
    Sample,
    Scene,
    attached_chiefs,
    outline_points,
    refused,
    table_points,
)
from render.tracing.passes import Light
from render.tracing.paths import at_rest
from render.tracing.plane_waves import DIFFERENCE
from render.tracing.pupil_points import OutlinePoints, PupilPoints, TablePoints
from render.tracing.tracer import Tracer
from render.tracing.wave_adjoint import WaveLanes, Window, summed_waves
from render.tracing.wave_images import Probe, WaveImages
from render.tracing.wave_stars import WaveStars
from render.tracing.wave_windows import FieldSampling

__all__ = ["wave_image"]

PASS_RAYS = 1 << 19


def wave_image(
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
    """Electrons of every pixel and band (h w b,) as an array with derivatives.

    Parameters and errors as `render.tracing.gradient.star_image`.
    """
    if stars.collimation is not None:
        raise ConfigError("derivatives of stars behind a collimator are not known; leave collimation out")
    F, camera, planner = mi.Float64, tracer.camera, tracer.planner
    light = tracer.light(stars, paths.plain, exposure_s)
    seen = planner.seen(paths.plain, stars.wavelength_nm, paths.length_px)
    chiefs = planner.chiefs(seen.mid, stars.wavelength_nm)
    waves = WaveStars(planner)
    few, still, images = waves.summed(light, seen, chiefs)
    rest = AttachedPaths(at_rest(paths.plain.mid), paths.middle, paths.middle)
    scene = Scene(mi, tracer, numbers, vector, moves, rest)
    moving = Scene(mi, tracer, numbers, vector, moves, paths) if images.trail is not None else scene
    outlines = None if planner.pupil.exact else planner.shapes(still, chiefs).outlines
    bands, colours = stars.wavelength_nm.shape
    each = np.broadcast_to(np.eye(colours)[:, None], (colours, bands, colours))
    mixed = waves.condensed(Light(stars.wavelength_nm, each, light.electrons), seen).share  # (k, b, q)
    response = camera.response_at(stars.wavelength_nm) * (math.pi * exposure_s)
    image = dr.zeros(F, camera.height_px * camera.width_px * bands)
    near = waves.near(planner.groups(seen, stars.wavelength_nm, chiefs)[1])
    for group in planner.wave_groups(still, few.wavelength_nm, chiefs, near):
        if group.points is None or group.mode != "quadrature" or (outlines is not None and outlines.shadow is not None):
            raise refused(group.members[0], group.mode)
        for probe in images.probes(group):
            if probe.group.points is None:
                raise refused(probe.stars[0], probe.group.mode)
            for part, radius, fields, order in _alike(images, probe):
                points = probe.group.points(order, part)
                if isinstance(points, OutlinePoints):
                    assert outlines is not None
                    sample = outline_points(scene, outlines, part, points, few.wavelength_nm)
                    chief = attached_chiefs(scene, outlines.chief, part, stars.wavelength_nm.mean(1))
                else:
                    assert isinstance(points, TablePoints)
                    sample, chief = table_points(scene, points), [dr.zeros(F, len(part) * bands)] * 2
                offset, weight = _motion(moving, part, stars.wavelength_nm.mean(1), chief, images)
                windows = _windows(images, probe, part, radius, fields)
                energy = _energy(scene, part, rate, response[..., None] * np.swapaxes(mixed, 0, 1))
                lanes = _plane_waves(scene, part, few.wavelength_nm, points, sample, windows)
                stamps = summed_waves(F, windows, lanes, energy, offset, weight)
                _add(scene, image, windows, stamps, bands)
    return image


def _alike(
    images: WaveImages, probe: Probe
) -> list[tuple[IntArray, float, tuple[FieldSampling, ...], tuple[int, int]]]:
    """Stars of a probe with the same window and the same rays, not too many of them at a time."""
    radius, highest, order = images.needs(probe)
    keys = list(zip(radius.tolist(), map(tuple, highest.tolist()), map(tuple, order.max((1, 2)).tolist()), strict=True))
    found = []
    for key in sorted(set(keys)):
        stars = probe.stars[[one == key for one in keys]]
        step = max(1, PASS_RAYS // (math.prod(key[2]) * images.wavelength_nm.size))
        for i in range(0, len(stars), step):
            found.append((stars[i : i + step], key[0], tuple(map(FieldSampling, key[1])), key[2]))
    return found


def _windows(
    images: WaveImages, probe: Probe, part: IntArray, radius: float, fields: tuple[FieldSampling, ...]
) -> list[Window]:
    """Windows of some stars of a probe, band by band."""
    mean, _ = images.means(part, probe.waves.take(np.searchsorted(probe.stars, part)))
    size, trail = 2 * int(radius) + 1, images.trail
    mean = np.nan_to_num(mean)
    corner = np.rint(mean) - 0.5 * size
    first, stamp = np.zeros_like(corner), size
    if trail is not None:
        offset = trail.offset_px[part]
        first = np.floor(offset.min(2))
        stamp = size + int((np.ceil(offset.max(2)) - first).max(initial=0.0))
    sigma, moving = images.camera.charge_diffusion_px, trail is not None
    return [
        Window(corner[s, b], mean[s, b], size, fields[b], sigma, first[s, b], stamp, moving)
        for s, b in np.ndindex(*corner.shape[:2])
    ]


def _energy(scene: Scene, part: IntArray, rate: Any, mixed: FloatArray) -> Any:
    """Light (s b q,) of the wavelengths that have images [e-], but for the slant of the launch disk.

    ``mixed`` (b, k, q) leads from photon rates to it, for a disk of radius 1 / sqrt(pi).
    """
    F, U = scene.F, scene.U
    bands, colours, few = mixed.shape
    lane = dr.arange(U, len(part) * bands * few)
    band, star = lane // few % bands, dr.gather(U, U(part.astype(np.uint32)), lane // (few * bands))
    total = dr.zeros(F, 1)
    for k in range(colours):
        factor = dr.gather(F, F(np.ascontiguousarray(mixed[:, k].ravel())), band * few + lane % few)
        total = total + factor * dr.gather(F, rate, (star * bands + band) * colours + k)
    return total * dr.square(scene.bundle(len(part) * bands * few).disk[3])


def _motion(
    scene: Scene, part: IntArray, wavelength_nm: FloatArray, chief: list[Any], images: WaveImages
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
    there, here = (
        scene.trace(bundle, light, which, px, py, wave) for light, which in ((scene.light, at), (scene.middle, star))
    )
    return ((there.x - here.x) * (1.0 / pitch), (here.y - there.y) * (1.0 / pitch)), weight


def _plane_waves(
    scene: Scene, part: IntArray, wavelength_nm: FloatArray, points: PupilPoints, sample: Sample, windows: list[Window]
) -> WaveLanes:
    """Plane waves of some stars, as `render.tracing.plane_waves.trace_waves` traces them."""
    F, U, program = scene.F, scene.U, scene.numbers.program
    bands, colours = wavelength_nm.shape
    total = len(part) * bands * colours * points.count
    members, waves = U(part.astype(np.uint32)), F(np.ascontiguousarray(wavelength_nm.ravel()))

    def numbered(lane: Any) -> tuple[Any, ...]:
        """Slot, node and point of a lane; its star and wavelength."""
        point, node, slot = lane % points.count, lane // points.count % colours, lane // (points.count * colours)
        star = dr.gather(U, members, slot // bands)
        return slot, node, point, star, dr.gather(F, waves, slot % bands * colours + node)

    # a ray and two beside it are lanes of one trace: three traces would be compiled one by one, with their derivatives
    every = dr.arange(U, 3 * total)
    slot, node, point, star, wave = numbered(every // 3)
    px, py, _ = sample(slot, node, point)
    dx, dy = (F(dr.select(every % 3 == k, DIFFERENCE, 0.0)) for k in (1, 2))
    rays = scene.trace(scene.bundle(3 * total), scene.light, star, px + dx, py + dy, wave)
    dr.eval(rays.x, rays.y, rays.opl_mm, rays.dx, rays.dy)
    lane = dr.arange(U, total)
    x, y, opl_mm = (dr.gather(F, v, 3 * lane) for v in (rays.x, rays.y, rays.opl_mm))
    (ox, rx, ux), (oy, ry, uy) = ([dr.gather(F, v, 3 * lane + k) for k in range(3)] for v in (rays.dx, rays.dy))
    slot, node, point, star, wave = numbered(lane)
    bundle = scene.bundle(total)
    px, py, share = sample(slot, node, point)
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
    middle = np.stack([one.mean_px for one in windows])
    x = float(cx) + x * (1.0 / pitch) - dr.gather(F, F(np.ascontiguousarray(middle[:, 0])), slot)
    y = float(cy) - y * (1.0 / pitch) - dr.gather(F, F(np.ascontiguousarray(middle[:, 1])), slot)
    fx, fy = ox * per_px, -oy * per_px
    return WaveLanes(path * (1e6 / wave) - fx * x - fy * y, fx, fy, share * dr.sqrt(jacobian) * per_px)


def _add(scene: Scene, image: Any, windows: list[Window], stamps: Any, bands: int) -> None:
    """Add stamps to the image."""
    F, integer, U, camera, size = scene.F, scene.I, scene.U, scene.camera, windows[0].stamp_px
    lane = dr.arange(U, len(windows) * size**2)
    slot = lane // size**2
    corner = np.stack([one.corner_px + one.first_px + 0.5 for one in windows]).astype(np.int32)
    first = [dr.gather(integer, integer(np.ascontiguousarray(corner[:, axis])), slot) for axis in (0, 1)]
    column, row = first[0] + integer(lane % size), first[1] + integer(lane // size % size)
    inside = (row >= 0) & (row < camera.height_px) & (column >= 0) & (column < camera.width_px)
    sensitive = camera.sensitive_columns
    if sensitive is not None:
        open_ = F(np.asarray(sensitive, np.float64))
        inside &= dr.gather(F, open_, U(dr.maximum(column, 0)), inside) > 0.0
    index = (U(row) * camera.width_px + U(column)) * bands + slot % bands
    dr.scatter_add(image, stamps, index, inside)
