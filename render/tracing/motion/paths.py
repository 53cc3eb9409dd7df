"""Where stars are seen during an exposure (`render.tracing.motion.exposure`), with a global and with a rolling shutter.

With a rolling shutter row y is exposed from ``start_s + y line_time_s`` on. A star's image that is at row Y(t) at time
t is then recorded at the times t = start_s + s + Y(t) line_time_s, 0 < s < exposure_s: every node s of every star has a
time of its own, found as a fixed point. What lands d rows from Y is recorded d line times later, when the image has
moved on; that is followed to first order, by a shear of the spot with the velocity v of the image [px/s] there:

    d' = d / (1 - v_y line_time),   dx' = dx + v_x line_time d',   light per s: 1 / (1 - v_y line_time)

The last factor makes a star brighter that the shutter follows. v is that of an ideal lens of the same focal length,
turned and scaled as the chief rays at both ends of the path tell. A relative error e of it costs e v line_time of the
spot's height, and as much of the light in parts; e is the change of the lens's scale along the path, some 1e-3. Rows
are taken for a continuum, though a pixel keeps the time of its centre: some 3 % of v line_time [px] of the star's
light, at most, come to stand in a neighbouring pixel (1e-4 at 0.003 px per line).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray, IntArray
from optics.errors import DomainError
from optics.light.collimation import Collimation
from render.camera import Camera
from render.tracing.motion.exposure import ExposureMotion, IdealLens, gauss_times

FASTEST_SHEAR = 0.2
"""Rows per line time beyond which the image outruns a rolling shutter."""
STILL_RAD, SHORT_RAD = 1e-9, 2e-3
"""Paths along which the outlines of beams are constant, or linear."""


@dataclass(frozen=True, slots=True)
class StarPaths:
    """Directions of n stars in cam during an exposure."""

    mid: FloatArray  # (n, 3) In the middle of it
    nodes: FloatArray  # (n, t, 3) At the time nodes
    # (n, t) Weights of the nodes; their sum is 1, with a rolling shutter what the star's motion makes of it
    weight: FloatArray
    # (n, t, 3) Rolling shutter: reference row [px], and the image's motion (columns, rows) per line time [px] there
    shear: FloatArray | None
    # (n, 2, 2) Lowest and highest offset (column, row) of the image from where it is in the middle, nearly
    shift_px: FloatArray
    collimation: Collimation | None = None  # Error of the light of a collimator; None for stars

    def take(self, stars: IntArray) -> StarPaths:
        """Some of the stars."""
        shear = None if self.shear is None else self.shear[stars]
        parts = self.mid[stars], self.nodes[stars], self.weight[stars], shear, self.shift_px[stars]
        return StarPaths(*parts, self.collimation)


@dataclass(frozen=True, slots=True)
class Light:
    """Light of n stars: wavelengths (b, k), shares of nodes (n, b, t k), electrons in the launch disk (n, b)."""

    wavelength_nm: FloatArray
    share: FloatArray
    electrons: FloatArray

    def take(self, stars: IntArray) -> Light:
        """Some of the stars."""
        return Light(self.wavelength_nm, self.share[stars], self.electrons[stars])


def at_rest(direction: FloatArray) -> StarPaths:
    """Stars (n, 3) in cam that do not move."""
    n = len(direction)
    return StarPaths(direction, direction[:, None], np.ones((n, 1)), None, np.zeros((n, 2, 2)))


def star_paths(
    motion: ExposureMotion,
    direction: FloatArray,
    camera: Camera,
    chief_row_px: FloatArray | None = None,
    scale: NDArray[np.complex128] | None = None,
) -> StarPaths:
    """Apparent directions of stars during an exposure."""
    # direction (n, 3), chief_row_px (n,), scale (n,)
    n, t = len(direction), len(motion.weight)
    ideal = IdealLens.of(camera)
    if motion.path is None:
        mid = direction @ motion.rotation_mid.T
        nodes = np.ascontiguousarray(np.einsum("tij,nj->nti", motion.rotation_cam_from_world, direction))
        weight = np.broadcast_to(motion.weight, (n, t))
        return StarPaths(mid, nodes, weight, None, _shift(ideal.px(nodes) - ideal.px(mid)[:, None]))
    return _rolling_paths(motion, direction, ideal, camera.height_px - 1.0, chief_row_px, scale)


def _shift(offset_px: FloatArray) -> FloatArray:
    """Lowest and highest of offsets (n, t, 2); (n, 2, 2)."""
    return np.stack([offset_px.min(1), offset_px.max(1)], axis=1)


def _rolling_paths(
    motion: ExposureMotion,
    direction: FloatArray,
    ideal: IdealLens,
    last_row: float,
    chief_row_px: FloatArray | None,
    scale: NDArray[np.complex128] | None,
) -> StarPaths:
    """As `star_paths`, every node at a time of its own."""
    assert motion.path is not None
    n, path, line = len(direction), motion.path, motion.line_time_s
    start = direction @ motion.rotation_mid.T
    offsets = np.concatenate([motion.time_s, [0.5 * motion.exposure_s]])
    first_s, last_s = motion.start_s, motion.start_s + motion.exposure_s + last_row * line

    middle = ideal.px(start)[:, None]
    turn = np.ones(n, complex) if scale is None else np.where(np.isfinite(scale), scale, 1.0)

    def seen(times: FloatArray) -> FloatArray:
        turned = Rotation.from_rotvec(path(times.ravel())).apply(np.repeat(start, times.shape[1], axis=0))
        return np.asarray(turned).reshape(*times.shape, 3)

    def placed(times: FloatArray) -> FloatArray:
        place = ideal.px(seen(times))
        moved = ((place - middle) @ np.array([1.0, 1j])) * turn[:, None]
        return np.asarray(middle + np.stack([moved.real, moved.imag], axis=-1))

    correction = np.zeros((n, 1))
    times = motion.start_s + offsets + 0.5 * last_row * line + np.zeros((n, 1))
    for _ in range(6):
        place = placed(times)
        if chief_row_px is not None:
            known = np.isfinite(chief_row_px)
            correction = np.where(known, chief_row_px - place[:, -1, 1], 0.0)[:, None]
        rows = place[..., 1] + correction
        times = motion.start_s + offsets + np.clip(rows, 0.0, last_row) * line
    step = 1e-3 * motion.exposure_s
    early, late = np.maximum(times - step, first_s), np.minimum(times + step, last_s)
    per_line = (placed(late) - placed(early)) / (late - early)[..., None] * line
    if np.abs(per_line[..., 1]).max(initial=0.0) > FASTEST_SHEAR:
        raise DomainError(
            f"star images move by {np.abs(per_line[..., 1]).max():.3g} rows per line time ({line:g} s); a rolling "
            f"shutter is rendered up to {FASTEST_SHEAR:g}; lower the rate or the line time"
        )
    directions, place = seen(times), placed(times)
    rows = place[..., 1:] + correction[..., None]
    per_line = np.where((rows > 0.0) & (rows < last_row), per_line, 0.0)  # beside the detector no row is exposed
    gain = 1.0 / (1.0 - per_line[..., 1])
    shear = np.concatenate([np.clip(rows, 0.0, last_row), per_line], axis=-1)
    return StarPaths(
        mid=directions[:, -1],
        nodes=np.ascontiguousarray(directions[:, :-1]),
        weight=motion.weight * gain[:, :-1],
        shear=np.ascontiguousarray(shear[:, :-1]),
        shift_px=_shift(place[:, :-1] - place[:, -1:]),
    )


def pick_times(paths: StarPaths) -> tuple[FloatArray, FloatArray]:
    """A few directions that span paths, and the factors by which they lead to all of their nodes.

    Results at these directions are interpolated linearly (paths below `SHORT_RAD`) or quadratically in the coordinate
    along the line between the middle of a path and its farthest node.
    """
    # -> (n, p, 3), (n, t, p)
    offset = paths.nodes - paths.mid[:, None]
    far = np.linalg.norm(offset, axis=2)
    at = far.argmax(1)[:, None, None]
    reach = np.maximum(np.take_along_axis(far[..., None], at, 1), 1e-12)  # (n, 1, 1)
    along = np.take_along_axis(offset, at, 1) / reach
    coordinate = (offset * along).sum(2) / reach[..., 0]
    longest = float(far.max(initial=0.0))
    if longest < STILL_RAD:
        return paths.mid[:, None], np.ones((*far.shape, 1))
    if longest < SHORT_RAD:
        ends, factor = [-1.0, 1.0], np.stack([0.5 - 0.5 * coordinate, 0.5 + 0.5 * coordinate], axis=2)
    else:
        c = coordinate
        ends, factor = [-1.0, 0.0, 1.0], np.stack([0.5 * c * (c - 1.0), 1.0 - c * c, 0.5 * c * (c + 1.0)], axis=2)
    direction = paths.mid[:, None] + np.array(ends)[:, None] * reach * along
    return direction / np.linalg.norm(direction, axis=2, keepdims=True), factor


def uniform_paths(direction: FloatArray, count: int, angle_rad: float) -> StarPaths:
    """Stars (n, 3) in cam seen from a camera that turns by an angle at a constant rate, at a number of time nodes."""
    nodes, weight = gauss_times(count)
    axis = np.array([math.cos(0.6), math.sin(0.6), 0.0])
    turned = [Rotation.from_rotvec((s - 0.5) * angle_rad * axis).apply(direction) for s in nodes]
    n = len(direction)
    return StarPaths(
        direction, np.stack(turned, axis=1), np.broadcast_to(weight, (n, count)), None, np.zeros((n, 2, 2))
    )
