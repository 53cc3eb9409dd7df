"""Triangle meshes: strips between polygons that stand for circles, and Mitsuba shapes of vertices and faces."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray, IntArray
from render.engine import Engine


def equal_area_scale(sides: int) -> float:
    """Circumradius of a regular polygon over the radius of the circle of the same area."""
    return math.sqrt(2.0 * math.pi / sides / math.sin(2.0 * math.pi / sides))


def strip_faces(first: int, sides: int) -> IntArray:
    """Triangles (2 sides, 3) between two closed rings of vertices that follow each other from number ``first`` on."""
    a = first + np.arange(sides)
    b = first + (np.arange(sides) + 1) % sides
    return np.concatenate([np.stack([a, b, a + sides], 1), np.stack([b, b + sides, a + sides], 1)])


def mitsuba_mesh(name: str, vertex: FloatArray, face: ArrayLike, bsdf: dict[str, Any]) -> Any:
    """A shape of vertices (n, 3) and triangles (m, 3)."""
    mi, faces = Engine.active().mitsuba, np.asarray(face)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh(name, len(vertex), len(faces), props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertex.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh
