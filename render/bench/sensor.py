"""An aperture-mask sun sensor, rendered: sunlight through a round hole in a plate onto a detector.

Sensor frame (CUBE09: X'' and Y'' along the rows and columns of the detector): +Z towards the Sun, +X along increasing
column, +Y along increasing row. The hole is the origin of the render; the detector lies ``height`` behind it. Light
from (X, Y, Z) is imaged at (-X, -Y) height / Z; the detector counts its columns against X and its rows against Y, as a
camera does behind its lens, so that

    column = (W - 1)/2 + x0 + (height / pitch) X / Z,    row likewise:

a pinhole camera of focal length ``height`` (`calib.cameras.BrownConrady` without distortion).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from render.bench.scene import plate_mesh, rectangle_at
from render.bench.trace import OVERSCAN, from_fixed, phase_points, to_fixed
from render.engine import Engine
from render.engine.jit import dr

PLATE_MM = 12.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MaskSensor:
    """A mask over a detector."""

    width_px: int
    height_px: int
    pitch_mm: float  # Pixel pitch of the detector
    hole_mm: float  # Diameter of the hole
    gap_mm: float  # Distance of the mask from the detector
    offset_px: FloatArray  # (2,) Foot of the normal through the hole, from the centre of the detector: (x0, y0)

    def __post_init__(self) -> None:
        freeze(self, "offset_px", shape=(2,))
        for name in ("pitch_mm", "hole_mm", "gap_mm"):
            if not 0.0 < getattr(self, name) < 100.0:
                raise DomainError(
                    f"MaskSensor.{name} = {getattr(self, name):g} mm; it must be above 0 and below 100 mm"
                )

    @property
    def foot_px(self) -> FloatArray:
        """Pixel under the hole (2,)."""
        return np.array([self.width_px - 1, self.height_px - 1]) / 2 + self.offset_px

    def spot_px(self, sun: ArrayLike) -> FloatArray:
        """Centres (n, 2) of the spots of suns at unit vectors (n, 3), by geometry."""
        v = np.asarray(sun, float)
        return np.asarray(self.foot_px + self.gap_mm / self.pitch_mm * v[:, :2] / v[:, 2:])


def mask_scene(sensor: MaskSensor) -> Any:
    """Mask and detector as Mitsuba shapes; mm, the hole at the origin, the Sun towards +z."""
    mi = Engine.active().mitsuba
    black = {"type": "diffuse", "reflectance": 0.0}
    # Columns count against x: the point of the detector under the hole is (x0, y0) pixels from the centre.
    centre = np.array([*(sensor.offset_px * sensor.pitch_mm), -sensor.gap_mm])
    half = np.array([sensor.width_px, sensor.height_px]) * sensor.pitch_mm / 2
    matrix = rectangle_at(centre, np.eye(3), *half)
    content = {
        "type": "scene",
        "mask": plate_mesh(sensor.hole_mm, PLATE_MM, material=black),
        "detector": {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": black},
    }
    return mi.load_dict(content, optimize=False)


def trace_mask(
    scene: Any,
    sensor: MaskSensor,
    sun: ArrayLike,
    corner_px: ArrayLike,
    size_px: int,
    *,
    half_angle_rad: float,
    log2_particles: int,
    seed: int,
) -> NDArray[np.float32]:
    """Windows around the spots of many suns."""
    # sun (n, 3), corner_px (n, 2) -> (n, size, size)
    mi = Engine.active().mitsuba
    direction = np.asarray(sun, np.float64).reshape(-1, 3)
    corner = np.asarray(corner_px, np.int64)
    if not np.all(direction[:, 2] > 0.02):
        raise DomainError("a sun is not in front of the mask: its Z in the sensor frame must be above 0.02")
    count, per_sun = len(direction), 1 << log2_particles
    log2_all = log2_particles + int(np.ceil(np.log2(max(count, 2))))
    index = dr.arange(mi.UInt32, count * per_sun)
    which = index >> dr.opaque(mi.UInt32, log2_particles)
    x, y, slope_x, slope_y = phase_points(log2_points=log2_all, seed=seed, index=index)
    ray = _rays(sensor, direction, which, (x, y), (slope_x, slope_y), half_angle_rad)
    hit = scene.ray_intersect(ray)
    arrived = hit.is_valid() & (hit.p.z < -0.5 * sensor.gap_mm)
    foot = sensor.foot_px
    column = mi.Int32(dr.floor(float(foot[0]) + 0.5 - hit.p.x / dr.opaque(mi.Float, sensor.pitch_mm)))
    row = mi.Int32(dr.floor(float(foot[1]) + 0.5 - hit.p.y / dr.opaque(mi.Float, sensor.pitch_mm)))
    first = [dr.gather(mi.Int32, mi.Int32(corner[:, axis].astype(np.int32)), which) for axis in (0, 1)]
    column, row = column - first[0], row - first[1]
    size = dr.opaque(mi.Int32, size_px)
    inside = arrived & (column >= 0) & (column < size) & (row >= 0) & (row < size)
    area = np.pi * (OVERSCAN * sensor.hole_mm / 2) ** 2
    weight = dr.abs(ray.d.z) * dr.opaque(mi.Float, area / per_sun / sensor.pitch_mm**2)
    windows = dr.zeros(mi.UInt64, count * size_px * size_px)
    target = (mi.Int32(which) * size + row) * size + column
    dr.scatter_reduce(dr.ReduceOp.Add, windows, to_fixed(weight), mi.UInt32(target), inside)
    return from_fixed(windows).reshape(count, size_px, size_px)


def _rays(
    sensor: MaskSensor,
    direction: FloatArray,
    which: Any,
    position: tuple[Any, Any],
    slope: tuple[Any, Any],
    half_angle_rad: float,
) -> Any:
    """Rays through the hole, in a cone about each sun."""
    mi = Engine.active().mitsuba
    spread = float(np.tan(half_angle_rad))
    helper = np.where(np.abs(direction[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(direction, helper)
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(direction, u)

    def gathered(vectors: FloatArray) -> Any:
        parts = [dr.gather(mi.Float, mi.Float(vectors[:, i].astype(np.float32)), which) for i in range(3)]
        return mi.Vector3f(*parts)

    light = dr.normalize(gathered(-direction) + slope[0] * gathered(spread * u) + slope[1] * gathered(spread * v))
    radius = dr.opaque(mi.Float, OVERSCAN * sensor.hole_mm / 2)
    point = mi.Point3f(position[0] * radius, position[1] * radius, 0.0)
    return mi.Ray3f(point - light * 0.5, light)
