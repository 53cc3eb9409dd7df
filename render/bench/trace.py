"""Particle tracing of the sun simulator's light through the bench, with Mitsuba's shapes and BSDFs.

Paths started at the camera would not find the tiny sun through a small aperture and a mirror. Particles therefore start
in the simulator, as in Mitsuba's ``ptracer``; at every scattering surface the contribution to the camera's pixel is
added (Veach 1997, sec. 10.1). Differences to ``ptracer``: the sun has an angular radius, and only particles that can
pass the aperture are started; all others would end on the back of the screen. Start point and slope are points of one
Sobol net.

Images are radiances per unit irradiance of the beam. A matt screen of reflectance rho in the full beam has rho / pi.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from optics.errors import DomainError
from render.bench.camera import BenchCamera
from render.bench.scene import BenchGeometry
from render.engine import Engine
from render.engine.jit import dr

OVERSCAN = 1.03
SEGMENTS = 2  # simulator to face (or sheet), face to screen
FIXED = 2.0**40
STEP_MM = 0.05
LOG2_LIMITS = (8, 24)


@lru_cache(maxsize=4)
def sobol_net(log2_points: int) -> NDArray[np.uint32]:
    """Scrambled Sobol points (4, n) as 32-bit fractions (SciPy's direction numbers and matrix scrambling)."""
    points = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(log2_points)).random_base2(log2_points)
    return np.ascontiguousarray((points * 2.0**32).astype(np.uint32).T)


def phase_points(*, log2_points: int, seed: int, index: Any) -> tuple[Any, Any, Any, Any]:
    """Two points of the unit disk: x, y of a start point and x, y of a slope.

    A Sobol net in four dimensions under a random digital shift: the net stays a net, and every seed is another one.
    """
    types = Engine.active().mitsuba
    shift = np.random.SeedSequence([seed, 0xBE4C]).generate_state(4).tolist()
    words = [
        dr.gather(types.UInt32, types.UInt32(row), index) ^ dr.opaque(types.UInt32, word)
        for row, word in zip(sobol_net(log2_points), shift, strict=True)
    ]
    return (*_disk_point(types, *words[:2]), *_disk_point(types, *words[2:]))


def _disk_point(types: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """Two 32-bit fractions to a point of the unit disk."""
    radius = dr.sqrt((types.Float64(u) + 0.5) * 2.0**-32)
    sine, cosine = dr.sincos((types.Float64(v) + 0.5) * (2.0 * np.pi * 2.0**-32))
    return types.Float(radius * cosine), types.Float(radius * sine)


def beam_rays(geometry: BenchGeometry, log2_particles: int, seed: int, *, inner_mm: float = 0.0) -> Any:
    """Rays from the simulator that fall on the aperture and a narrow ring around it: points of a disk in its plane,
    slopes of a disk about the axis, both uniform.

    Without the rays that a mirror square to the beam would send to within ``inner_mm`` of the centre of the aperture:
    light that a nearly square face returns into the aperture is invisible.
    """
    mi = Engine.active().mitsuba
    low, high = LOG2_LIMITS
    if not low <= log2_particles <= high:
        raise DomainError(f"log2_particles = {log2_particles}; it must be {low} to {high}")

    def rays(index: Any, start_mm: float) -> tuple[Any, Any]:
        x, y, slope_x, slope_y = phase_points(log2_points=log2_particles, seed=seed, index=index)
        radius = dr.opaque(mi.Float, OVERSCAN * geometry.aperture_mm / 2)
        spread = dr.opaque(mi.Float, float(np.tan(geometry.half_angle_rad)))
        direction = mi.Vector3f(slope_x * spread, slope_y * spread, -1.0)
        origin = mi.Point3f(x * radius, y * radius, 0.0) - direction * dr.opaque(mi.Float, start_mm)
        return origin, dr.normalize(direction)

    index = dr.arange(mi.UInt32, 1 << log2_particles)
    if inner_mm > 0:
        point, direction = rays(index, 0.0)
        path = dr.opaque(mi.Float, geometry.path_mm) / dr.abs(direction.z)
        x, y = point.x + path * direction.x, point.y + path * direction.y
        index = dr.compress(x * x + y * y > dr.opaque(mi.Float, inner_mm**2))
    origin, direction = rays(index, geometry.simulator_gap_mm)
    return mi.Ray3f(origin, direction)


def to_fixed(light: Any) -> Any:
    """Light as integer multiples of 2^-40: sums of integers do not depend on the order in which threads add."""
    types = Engine.active().mitsuba
    return types.UInt64(types.Float64(light) * FIXED)


def from_fixed(total: Any) -> NDArray[np.float32]:
    """The light in a sum of `to_fixed`."""
    return (np.array(total).astype(np.float64) / FIXED).astype(np.float32)


def continued(hit: Any, sample: Any) -> Any:
    """Ray on from a hit, started a little way *along* itself.

    Mitsuba's ``spawn_ray`` steps along the normal instead, by 0.03 mm in a scene of this size: the light would be
    reflected in front of the mirror and land 5e-5 of its displacement short.
    """
    mi = Engine.active().mitsuba
    direction = hit.to_world(sample.wo)
    return mi.Ray3f(hit.p + direction * STEP_MM, direction)


def trace_screen(
    scene: Any,
    sensor: Any,
    camera: BenchCamera,
    geometry: BenchGeometry,
    *,
    covered: bool,
    log2_particles: int,
    seed: int,
    inner_mm: float = 0.0,
) -> NDArray[np.float32]:
    """Image (height, width) that the camera takes of the screen: radiance per unit irradiance of the beam [1/sr].

    Particles that a mirror square to the beam would send to within ``inner_mm`` of the middle of the aperture are not
    started. With the radius of the aperture less the displacement of the spot nothing visible is lost.
    """
    mi = Engine.active().mitsuba
    ray = beam_rays(geometry, log2_particles, seed, inner_mm=inner_mm)
    area = np.pi * (OVERSCAN * geometry.aperture_mm / 2) ** 2
    pixels = camera.width_px * camera.height_px
    image = dr.zeros(mi.UInt64, pixels)
    throughput = dr.opaque(mi.Float, area * pixels / (1 << log2_particles)) * dr.abs(ray.d.z)
    context, middle, active = mi.BSDFContext(), mi.Point2f(0.5), mi.Bool(True)
    for segment in range(1 if covered else SEGMENTS):
        hit = scene.ray_intersect(ray, active)
        active &= hit.is_valid()
        bsdf = hit.bsdf()
        if covered or segment > 0:  # without the sheet, light meets mirrors first, or is lost
            _connect(scene, sensor, camera, hit, bsdf, throughput, active, image)
        if segment == 0 and not covered:
            sample, weight = bsdf.sample(context, hit, 0.5, middle, active)
            active &= mi.has_flag(sample.sampled_type, mi.BSDFFlags.DeltaReflection)
            throughput = throughput * weight[0]
            ray = continued(hit, sample)
    return from_fixed(image).reshape(camera.height_px, camera.width_px)


def _connect(
    scene: Any,
    sensor: Any,
    camera: BenchCamera,
    hit: Any,
    bsdf: Any,
    throughput: Any,
    active: Any,
    image: Any,
) -> None:
    """Add the light scattered at ``hit`` into the camera to the image, in place."""
    mi = Engine.active().mitsuba
    toward, importance = sensor.sample_direction(hit, mi.Point2f(0.5), active)
    scattered = bsdf.eval(mi.BSDFContext(), hit, hit.to_local(toward.d), active)[0]
    visible = active & (importance[0] > 0) & (scattered > 0)
    visible &= ~scene.ray_test(hit.spawn_ray_to(toward.p), visible)
    column, row = mi.UInt32(toward.uv.x), mi.UInt32(toward.uv.y)
    visible &= (column < camera.width_px) & (row < camera.height_px)
    light = dr.select(visible, throughput * scattered * importance[0], 0.0)
    dr.scatter_reduce(dr.ReduceOp.Add, image, to_fixed(light), row * camera.width_px + column, visible)
