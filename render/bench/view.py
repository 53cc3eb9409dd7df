"""A picture of the whole bench: marble plate, turntable with sensor and cube, screen, simulator, camera, and the beam.

The bodies are rendered by Mitsuba's path integrator under room light. The beam shows as it would in faintly dusty air:
the traced particles scatter once on their way, and the camera gets that light (single scattering of thin air,
isotropic).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray
from render.bench.camera import BenchCamera
from render.bench.scene import BenchGeometry, CubePose, frame_around, screen_and_mirrors
from render.bench.trace import continued, start_rays
from render.engine import Engine
from render.engine.jit import dr

DUST_LOG2 = 21


def _matrix(centre: Any, size: Any, rotation: Any = None) -> Any:
    """Transformation of Mitsuba's cube or sphere: half sizes, turned, put at a centre."""
    mi = Engine.active().mitsuba
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) if rotation is None else np.asarray(rotation)) * np.asarray(size, float)
    matrix[:3, 3] = centre
    return mi.ScalarTransform4f(matrix)


def _tube(first: Any, second: Any, radius: float, grey: float) -> dict[str, Any]:
    """A cylinder between two points, with a lid at each end."""
    mi = Engine.active().mitsuba
    start, along = np.asarray(first, float), np.asarray(second, float) - np.asarray(first, float)
    length = float(np.linalg.norm(along))
    helper = np.eye(3)[np.argmin(np.abs(along))]
    matrix = np.eye(4)
    matrix[:3, :3] = frame_around(along / length, helper) * np.array([radius, radius, length])
    matrix[:3, 3] = start
    return {"type": "cylinder", "to_world": mi.ScalarTransform4f(matrix), "bsdf": _paint(grey)}


def _paint(grey: float) -> dict[str, Any]:
    return {"type": "twosided", "b": {"type": "diffuse", "reflectance": grey}}


def overview_scene(geometry: BenchGeometry, pose: CubePose, table: FloatArray, camera: BenchCamera) -> Any:
    """Everything on the bench as Mitsuba shapes."""
    # table (3, 3)
    mi = Engine.active().mitsuba
    content: dict[str, Any] = {
        "type": "scene",
        "room": {"type": "constant", "radiance": 0.35},
        "lamp": {
            "type": "rectangle",
            "to_world": _matrix([300, 700, -500], [250, 250, 1], frame_around(_unit([-0.4, -1, 0.2]), np.eye(3)[2])),
            "light": {"type": "area", "radiance": 6.0},
        },
        "floor": {
            "type": "cube",
            "to_world": _matrix([0, -195, -330], [330, 15, 620]),
            "bsdf": _paint(0.32),
        },
        **screen_and_mirrors(geometry, pose),
    }
    content |= _stands(geometry, camera)
    content |= _payload(geometry, pose, table)
    content["ccd"] = {
        "type": "cube",
        "to_world": _matrix(camera.position_mm - 35 * camera.axes[2], [18, 18, 28], camera.axes.T),
        "bsdf": _paint(0.05),
    }
    content["lens"] = _tube(
        camera.position_mm - 10 * camera.axes[2], camera.position_mm + 14 * camera.axes[2], 12, 0.04
    )
    return mi.load_dict(content, optimize=False)


def _unit(v: Any) -> FloatArray:
    return np.asarray(v, float) / np.linalg.norm(v)


def _stands(geometry: BenchGeometry, camera: BenchCamera) -> dict[str, Any]:
    """Simulator, posts of screen and camera, the fork of the outer axis."""
    half, gap = geometry.simulator_mm / 2, geometry.simulator_gap_mm
    _, y, z = geometry.crossing_mm
    shapes = {
        "simulator": _tube([0, 0, gap], [0, 0, gap + 220], half + 14, 0.75),
        "simulator_post": _tube([0, -half - 10, gap + 120], [0, -180, gap + 120], 14, 0.2),
        "screen_post": _tube([0, -geometry.screen_mm / 2, 3], [0, -180, 3], 6, 0.2),
        "camera_post": _tube(
            camera.position_mm - 35 * camera.axes[2] - [0, 18, 0],
            (camera.position_mm - 35 * camera.axes[2]) * [1, 0, 1] - [0, 180, 0],
            6,
            0.2,
        ),
    }
    reach = 4.6 * geometry.cube_mm
    for side in (-1, 1):
        shapes[f"fork{side}"] = _tube([side * reach, -180, z], [side * reach, y, z], 12, 0.3)
        shapes[f"axle{side}"] = _tube([side * 0.82 * reach, y, z], [side * (reach + 16), y, z], 9, 0.55)
    return shapes


def _payload(geometry: BenchGeometry, pose: CubePose, table: FloatArray) -> dict[str, Any]:
    """What the table carries: inner ring, sun sensor, body of the cube."""
    x, centre = geometry.crossing_mm, pose.centre_mm
    side, reach = geometry.cube_mm, 3.7 * geometry.cube_mm
    toward = np.asarray(table)
    ring = {
        f"ring{i}": {
            "type": "cube",
            "to_world": _matrix(x + toward @ np.array(place), np.array(size), toward),
            "bsdf": _paint(0.45),
        }
        for i, (place, size) in enumerate(
            [
                ([0, reach, 0], [reach, 6, 8]),
                ([0, -reach, 0], [reach, 6, 8]),
                ([reach, 0, 0], [6, reach, 8]),
                ([-reach, 0, 0], [6, reach, 8]),
            ]
        )
    }
    box = centre + toward @ np.array([0.0, 0.0, side / 2 + 16])
    return {
        **ring,
        "inner_axle": _tube(x + toward @ [0, -reach, 0], x + toward @ [0, -0.9 * side, 14], 5, 0.5),
        "inner_axle2": _tube(x + toward @ [0, reach, 0], x + toward @ [0, 0.9 * side, 14], 5, 0.5),
        "housing": {
            "type": "cube",
            "to_world": _matrix(box, [1.3 * side, 1.0 * side, 16], toward),
            "bsdf": _paint(0.12),
        },
        "body": {
            "type": "cube",
            "to_world": _matrix(centre, np.full(3, side / 2 - 0.2), pose.rotation),
            "bsdf": {"type": "diffuse", "reflectance": 0.15},
        },
    }


def overview_sensor(geometry: BenchGeometry, *, width_px: int, height_px: int, close: bool = False) -> Any:
    """Camera of the overview, from beside and above; ``close``: on the cube."""
    mi = Engine.active().mitsuba
    distance, crossing = geometry.distance_mm, geometry.crossing_mm
    if close:
        middle = crossing + np.array([0.0, 0.0, 0.8 * geometry.cube_mm])
        place, fov = crossing + geometry.cube_mm * np.array([7.5, 5.5, 12.5]), 24.0
    else:
        middle = np.array([0.0, -55.0, 0.40 * crossing[2]])
        place, fov = distance * np.array([1.30, 0.80, -1.05]), 50.0
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": fov,
            "fov_axis": "x",
            "to_world": mi.ScalarTransform4f().look_at(origin=place, target=middle, up=[0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": width_px,
                "height": height_px,
                "pixel_format": "luminance",
                "component_format": "float32",
                "rfilter": {"type": "gaussian"},
            },
        }
    )


def render_overview(
    scene: Any, sensor: Any, geometry: BenchGeometry, *, spp: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Radiance of the bodies, and of the beam in dust in its own unit, both (h, w)."""
    mi = Engine.active().mitsuba
    image = np.array(
        mi.render(scene, sensor=sensor, integrator=mi.load_dict({"type": "path", "max_depth": 8}), spp=spp)
    )
    height, width = image.shape[:2]
    beam = beam_in_dust(scene, sensor, geometry, width, height)
    return image.reshape(height, width).astype(np.float32), beam


def beam_in_dust(scene: Any, sensor: Any, geometry: BenchGeometry, width: int, height: int) -> Any:
    """Light that particles of the beam scatter into a camera on their way, (h, w), arbitrary unit.

    Particles start over the whole aperture of the simulator within five apertures of the axis, so that what the screen
    stops shows too; every segment scatters at one random point.
    """
    mi = Engine.active().mitsuba
    index = dr.arange(mi.UInt32, 1 << DUST_LOG2)
    origin, direction = start_rays(
        log2_particles=DUST_LOG2,
        seed=7,
        index=index,
        hole_mm=geometry.aperture_mm,
        start_mm=geometry.simulator_gap_mm,
        half_angle_rad=geometry.half_angle_rad,
    )
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, 1 << DUST_LOG2)
    ray, active = mi.Ray3f(origin, direction), mi.Bool(True)
    image = dr.zeros(mi.Float, width * height)
    for _ in range(2):
        hit = scene.ray_intersect(ray, active)
        active &= hit.is_valid()
        length = dr.select(active, hit.t, 0.0)
        point = dr.zeros(mi.Interaction3f, 1 << DUST_LOG2)
        point.p = ray(length * sampler.next_1d())
        toward, importance = sensor.sample_direction(point, mi.Point2f(0.5), active)
        sight = mi.Ray3f(point.p, toward.d, toward.dist * 0.999, 0.0, [])
        seen = active & (importance[0] > 0) & ~scene.ray_test(sight, active)
        column, row = mi.UInt32(toward.uv.x), mi.UInt32(toward.uv.y)
        seen &= (column < width) & (row < height)
        light = dr.select(seen, length * importance[0], 0.0)
        dr.scatter_reduce(dr.ReduceOp.Add, image, light, row * width + column, seen)
        sample, weight = hit.bsdf().sample(mi.BSDFContext(), hit, 0.5, mi.Point2f(0.5), active)
        active &= mi.has_flag(sample.sampled_type, mi.BSDFFlags.DeltaReflection) & (weight[0] > 0)
        ray = continued(hit, sample)
    return np.array(image, dtype=np.float32).reshape(height, width)
