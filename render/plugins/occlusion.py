"""Bodies of a Mitsuba scene between the sky and a lens, tested ray by ray (`render.tracing.rays.kernel.Shade`).

A star's ray leaves the plane of the first vertex towards its star; any hit of `Scene.ray_test`, of transparent bodies
too, hides the star, as it hides lights from ``path``. Mitsuba's rays are float32, so that an edge at the distance L is
accurate to some 1e-7 L. The limb of a sphere is less accurate: its equation is solved from the origin of the ray, and
at 200 radii its roots are off by 3e-3 of the radius. A ray is therefore tested in parts that start close to distant
bodies.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from optics.arrays import BoolArray, FloatArray
from optics.rays.entrance_pupil import EntrancePupil
from optics.rays.trace import Rays
from render.engine import Engine
from render.engine.jit import dr
from render.engine.upload import uploaded

MOST = 3e38
CLOSE = 20.0
"""Distance over size above which a body is tested by a separate part of the ray."""


class SceneShade:
    """The bodies of a scene in front of a camera."""

    def __init__(
        self, scene: Any, direction: FloatArray, rotation: FloatArray, position: Sequence[float], scene_unit_mm: float
    ) -> None:
        self.scene, self.direction, self.scene_unit_mm = scene, direction, scene_unit_mm
        self.position = np.array(position, float)
        F, xp = Engine.active().types.Float64, Engine.active().arrays
        self._toward = [uploaded(F, direction[:, axis]) for axis in range(3)]
        self._turn = xp.parameters(rotation.ravel() / scene_unit_mm)
        self._from = xp.parameters(self.position)
        self._bodies = [self._bounds(shape) for shape in scene.shapes()]
        distances = [(float(np.linalg.norm(centre)), size) for centre, size in self._bodies]
        self._starts = sorted(
            {0.0, *(distance - 3.0 * size for distance, size in distances if distance > CLOSE * size)}
        )

    def _bounds(self, shape: Any) -> tuple[FloatArray, float]:
        """Centre of a body from the camera and radius of a sphere around it, infinite where it has no bounds."""
        box = shape.bbox()
        low, high = np.array(box.min, float), np.array(box.max, float)
        if not np.isfinite([low, high]).all():
            return np.zeros(3), np.inf
        return 0.5 * (low + high) - self.position, 0.5 * float(np.linalg.norm(high - low))

    def near(self, pupil: EntrancePupil) -> BoolArray:
        """Stars (n,) of which a body's bounding sphere may meet the beam."""
        near = np.zeros(len(self.direction), np.bool_)
        beam = (np.hypot(pupil.x_mm, pupil.y_mm) + 3.0 * abs(pupil.z_mm) + pupil.radius_mm) / self.scene_unit_mm
        for centre, size in self._bodies:
            along, reach = self.direction @ centre, size + beam
            across = np.linalg.norm(centre - along[:, None] * self.direction, axis=1)
            near |= (along > -reach) & (across < reach)
        return near

    def hides(self, rays: Rays, star: Any) -> Any:
        """Whether a body blocks rays in the lens frame towards their stars."""
        mi, types = Engine.active().mitsuba, Engine.active().types
        distance, turn = -rays.z / rays.dz, self._turn  # to z = 0
        x, y = -(rays.x + distance * rays.dx), rays.y + distance * rays.dy  # in cam
        origin = [self._from[k] + turn[k] * x + turn[3 + k] * y for k in range(3)]
        toward = [dr.gather(types.Float64, component, star) for component in self._toward]
        direction = dr.normalize(mi.Vector3f(*(mi.Float(mi.Float64(v)) for v in toward)))
        hidden = types.Bool(False)
        for start, end in pairwise([*self._starts, np.inf]):
            begin = dr.opaque(types.Float64, start)
            point = mi.Point3f(*(mi.Float(mi.Float64(o + begin * d)) for o, d in zip(origin, toward, strict=True)))
            ray = mi.Ray3f(point, direction)
            ray.maxt = dr.opaque(mi.Float, min(end - start, MOST))
            hidden |= types.Bool(dr.detach(self.scene.ray_test(ray)))
        return hidden
