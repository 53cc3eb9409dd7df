"""Stars under a rolling shutter: times of their rows, shear of their spots, light of a star that the shutter follows.

Row y is exposed from ``start_s + y line_time_s`` on. A star's image that is at row Y(t) at time t is recorded at the
times t = start_s + s + Y(t) line_time_s, 0 < s < exposure_s: every node s of every star has a time of its own, the
fixed point of this equation. Light that lands d rows from Y is recorded d line times later, when the image has moved
on; that is followed to first order, by a shear of the spot with the velocity v of the image [px/s] there:

    d' = d / (1 - v_y line_time),   dx' = dx + v_x line_time d',   light per s: 1 / (1 - v_y line_time)

The last factor makes a star brighter that the shutter follows. v is that of an ideal lens of the same focal length,
turned and scaled like the path between the chief rays at its ends. A relative error e of it costs e v line_time of the
spot's height, and as large a fraction of the light; e is the change of the lens's scale along the path, some 1e-3. Rows
are treated as a continuum, though a pixel keeps the time of its centre: some 3 % of v line_time [px] of the star's
light, at most, appear in a neighbouring pixel (1e-4 at 0.003 px per line).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import DomainError
from render.camera import Camera
from render.tracing.motion.exposure import ExposureMotion, IdealLens
from render.tracing.motion.paths import StarPaths, offset_range

FASTEST_SHEAR = 0.2
"""Rows per line time beyond which the image outruns a rolling shutter."""
FIXED_POINT_STEPS = 6


def rolling_paths(
    motion: ExposureMotion,
    direction: FloatArray,
    camera: Camera,
    chief_row_px: FloatArray | None = None,
    scale: NDArray[np.complex128] | None = None,
) -> StarPaths:
    """Apparent directions of stars (n, 3) at the times of their rows.

    Rows of chief rays (n,), and scale and turn (n,) of the paths relative to an ideal lens, which is the default.
    """
    assert motion.path is not None
    n, path, line, last_row = len(direction), motion.path, motion.line_time_s, camera.height_px - 1.0
    ideal, start = IdealLens.of(camera), direction @ motion.rotation_mid.T
    offsets = np.concatenate([motion.time_s, [0.5 * motion.exposure_s]])
    first_s, last_s = motion.start_s, motion.start_s + motion.exposure_s + last_row * line
    middle = ideal.px(start)[:, None]
    turn = np.ones(n, complex) if scale is None else np.where(np.isfinite(scale), scale, 1.0)

    def directions_at(times: FloatArray) -> FloatArray:
        turned = Rotation.from_rotvec(path(times.ravel())).apply(np.repeat(start, times.shape[1], axis=0))
        return np.asarray(turned).reshape(*times.shape, 3)

    def positions_px(times: FloatArray) -> FloatArray:
        moved = ((ideal.px(directions_at(times)) - middle) @ np.array([1.0, 1j])) * turn[:, None]
        return np.asarray(middle + np.stack([moved.real, moved.imag], axis=-1))

    correction = np.zeros((n, 1))
    times = motion.start_s + offsets + 0.5 * last_row * line + np.zeros((n, 1))
    for _ in range(FIXED_POINT_STEPS):
        position_px = positions_px(times)
        if chief_row_px is not None:
            correction = np.where(np.isfinite(chief_row_px), chief_row_px - position_px[:, -1, 1], 0.0)[:, None]
        times = motion.start_s + offsets + np.clip(position_px[..., 1] + correction, 0.0, last_row) * line
    step = 1e-3 * motion.exposure_s
    early, late = np.maximum(times - step, first_s), np.minimum(times + step, last_s)
    per_line = (positions_px(late) - positions_px(early)) / (late - early)[..., None] * line
    fastest = np.abs(per_line[..., 1]).max(initial=0.0)
    if fastest > FASTEST_SHEAR:
        raise DomainError(
            f"star images move by {fastest:.3g} rows per line time ({line:g} s); a rolling "
            f"shutter is rendered up to {FASTEST_SHEAR:g}; lower the rate or the line time"
        )
    directions, position_px = directions_at(times), positions_px(times)
    rows = position_px[..., 1:] + correction[..., None]
    per_line = np.where((rows > 0.0) & (rows < last_row), per_line, 0.0)  # outside the detector no row is exposed
    shear = np.concatenate([np.clip(rows, 0.0, last_row), per_line], axis=-1)
    return StarPaths(
        mid=directions[:, -1],
        nodes=np.ascontiguousarray(directions[:, :-1]),
        weight=motion.weight * (1.0 / (1.0 - per_line[..., 1]))[:, :-1],
        shear=np.ascontiguousarray(shear[:, :-1]),
        shift_px=offset_range(position_px[:, :-1] - position_px[:, -1:]),
    )


def recorded(x: Any, y: Any, row: Any, along_x: Any, along_y: Any) -> tuple[Any, Any]:
    """Columns and rows where light that lands at (x, y) is recorded; see `StarPaths.shear`."""
    below = (y - row) / (1.0 - along_y)
    return x + along_x * below, row + below


def recorded_gaussians(mean: FloatArray, covariance: FloatArray, shear: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gaussians with means (..., 2) and covariances (..., 3: xx, yy, xy) as they are recorded; shear (..., 3)."""
    row, along_x, along_y = np.moveaxis(shear, -1, 0)
    xx, yy, xy = np.moveaxis(covariance, -1, 0)
    gain = 1.0 / (1.0 - along_y)
    slope = along_x * gain
    sheared = [xx + slope * (2.0 * xy + slope * yy), gain**2 * yy, gain * (xy + slope * yy)]
    return np.stack(recorded(mean[..., 0], mean[..., 1], row, along_x, along_y), axis=-1), np.stack(sheared, axis=-1)
