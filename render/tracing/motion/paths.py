"""Directions of stars during an exposure (`render.tracing.motion.exposure`), with a global shutter.

With a rolling shutter: `render.tracing.motion.rolling_shutter`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray, IntArray
from optics.light.collimation import Collimation
from render.camera import Camera
from render.tracing.motion.exposure import ExposureMotion, IdealLens, gauss_times

STILL_RAD, SHORT_RAD = 1e-9, 2e-3
"""Paths along which the outlines of beams are constant, or linear."""


@dataclass(frozen=True, slots=True)
class StarPaths:
    """Directions of n stars in cam during an exposure."""

    mid: FloatArray  # (n, 3) In the middle of it
    nodes: FloatArray  # (n, t, 3) At the time nodes
    weight: FloatArray  # (n, t) Weights of the nodes, sum 1; with a rolling shutter times the gain in exposure
    # (n, t, 3) Rolling shutter: reference row [px], and the image's motion (columns, rows) per line time [px] there
    shear: FloatArray | None
    shift_px: FloatArray  # (n, 2, 2) Lowest and highest offset (column, row) of the image from the middle, nearly
    collimation: Collimation | None = None  # Error of the light of a collimator; None for stars

    def take(self, stars: IntArray) -> StarPaths:
        """Some of the stars."""
        shear = None if self.shear is None else self.shear[stars]
        parts = self.mid[stars], self.nodes[stars], self.weight[stars], shear, self.shift_px[stars]
        return StarPaths(*parts, self.collimation)


@dataclass(frozen=True, slots=True)
class NodeLight:
    """Light of n stars over nodes: all k wavelengths of the first of t times, then all of the second."""

    wavelength_nm: FloatArray  # (b, k)
    weight: FloatArray  # (n, b, t k) Fractions of the light, sum 1
    electrons: FloatArray  # (n, b) In the launch disk

    def take(self, stars: IntArray) -> NodeLight:
        """Some of the stars."""
        return NodeLight(self.wavelength_nm, self.weight[stars], self.electrons[stars])


def at_rest(direction: FloatArray) -> StarPaths:
    """Stars (n, 3) in cam that do not move."""
    n = len(direction)
    return StarPaths(direction, direction[:, None], np.ones((n, 1)), None, np.zeros((n, 2, 2)))


def star_paths(motion: ExposureMotion, direction: FloatArray, camera: Camera) -> StarPaths:
    """Apparent directions of stars (n, 3) during an exposure with a global shutter."""
    ideal, mid = IdealLens.of(camera), direction @ motion.rotation_mid.T
    nodes = np.ascontiguousarray(np.einsum("tij,nj->nti", motion.rotation_cam_from_world, direction))
    weight = np.broadcast_to(motion.weight, nodes.shape[:2])
    return StarPaths(mid, nodes, weight, None, offset_range(ideal.px(nodes) - ideal.px(mid)[:, None]))


def offset_range(offset_px: FloatArray) -> FloatArray:
    """Lowest and highest (n, 2, 2) of offsets (n, t, 2)."""
    return np.stack([offset_px.min(1), offset_px.max(1)], axis=1)


def pick_times(paths: StarPaths) -> tuple[FloatArray, FloatArray]:
    """A few directions (n, p, 3) that span paths, and weights (n, t, p) that interpolate all nodes between them.

    Linear (paths below `SHORT_RAD`) or quadratic in the coordinate along the line between the middle of a path and its
    farthest node.
    """
    offset = paths.nodes - paths.mid[:, None]
    distance = np.linalg.norm(offset, axis=2)
    farthest = distance.argmax(1)[:, None, None]
    reach = np.maximum(np.take_along_axis(distance[..., None], farthest, 1), 1e-12)  # (n, 1, 1)
    along = np.take_along_axis(offset, farthest, 1) / reach
    longest = float(distance.max(initial=0.0))
    if longest < STILL_RAD:
        return paths.mid[:, None], np.ones((*distance.shape, 1))
    c = (offset * along).sum(2) / reach[..., 0]
    if longest < SHORT_RAD:
        ends, weights = [-1.0, 1.0], [0.5 - 0.5 * c, 0.5 + 0.5 * c]
    else:
        ends, weights = [-1.0, 0.0, 1.0], [0.5 * c * (c - 1.0), 1.0 - c * c, 0.5 * c * (c + 1.0)]
    direction = paths.mid[:, None] + np.array(ends)[:, None] * reach * along
    return direction / np.linalg.norm(direction, axis=2, keepdims=True), np.stack(weights, axis=2)


def uniform_paths(direction: FloatArray, count: int, angle_rad: float) -> StarPaths:
    """Stars (n, 3) in cam of a camera that turns by an angle at a constant rate, at a number of time nodes."""
    nodes, weight = gauss_times(count)
    axis = np.array([math.cos(0.6), math.sin(0.6), 0.0])
    turned = [Rotation.from_rotvec((s - 0.5) * angle_rad * axis).apply(direction) for s in nodes]
    n = len(direction)
    weights = np.broadcast_to(weight, (n, count))
    return StarPaths(direction, np.stack(turned, axis=1), weights, None, np.zeros((n, 2, 2)))
