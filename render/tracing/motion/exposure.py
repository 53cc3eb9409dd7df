"""Motion of the camera during an exposure, as a few attitudes with weights; global and rolling shutter.

Time is integrated by Gauss-Legendre nodes over the exposure of a row. Their number is found by trial: the image of a
star that moves is convolved with its path, and the first number is taken whose damped characteristic function of the
path (`render.tracing.convergence`), at the centre and the corners of the detector, agrees with the next one's to the
tolerance. The spot is taken for a point, as some are nearly: about 4 nodes per pixel of the path with a diffusion of
0.18 px. Directions of stars at these nodes: `render.tracing.motion.paths`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import ConvergenceError, DomainError
from optics.rays.paraxial import axial_paraxial
from optics.records import freeze
from render.camera import Camera
from render.motion.trajectory import Trajectory
from render.tracing.convergence import (
    HIGHEST_FREQUENCY,
    MOTION_TOLERANCE,
    damped_frequencies,
    frequencies_up_to,
    transfer,
)

PANEL = 24
"""Nodes of each panel of a composite rule."""
NODE_LADDER = (
    *(1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 22, 27, 33, 40, 49, 59, 72, 88, 107, 131, 160, 195, 238, 290),
    *(PANEL * panels for panels in (15, 18, 22, 27, 33, 40, 49, 59, 72, 88)),
)
"""Numbers of time nodes that are tried, in this order; the last one is only compared with."""
PATH_ERROR_PX = 1e-4
"""Of the spline that carries the attitude between its knots (rolling shutter)."""
MOST_KNOTS = 1 << 14


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExposureMotion:
    """Attitudes of a camera during an exposure; made by `exposure_motion`."""

    start_s: float  # When the exposure of row 0 starts, on the trajectory
    exposure_s: float  # How long every row is exposed
    line_time_s: float  # How much later than its neighbour the next row starts; 0 for a global shutter
    time_s: FloatArray  # (t,) Nodes from a row's start on
    weight: FloatArray  # (t,) Sum 1
    rotation_cam_from_world: FloatArray  # (t, 3, 3) At the nodes, with a rolling shutter those of the middle row
    rotation_mid: FloatArray  # (3, 3) In the middle of the exposure (of the middle row)
    length_px: float  # Longest path of a star at the centre or a corner of the detector during the exposure of a row
    # Rotation vectors (n, 3) from ``rotation_mid`` at times (n,) [s] of the trajectory; None: global shutter
    path: Callable[[FloatArray], FloatArray] | None

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        freeze(self, "time_s", shape=("t",), sizes=sizes)
        freeze(self, "weight", shape=("t",), sizes=sizes)
        freeze(self, "rotation_cam_from_world", shape=("t", 3, 3), sizes=sizes)
        freeze(self, "rotation_mid", shape=(3, 3))


@cache
def gauss_times(count: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights on (0, 1); above 300 nodes in panels of `PANEL`."""
    panels = count // PANEL if count > 300 else 1
    node, weight = np.polynomial.legendre.leggauss(count // panels)
    places = (np.arange(panels)[:, None] + 0.5 * (1.0 + node)).ravel() / panels
    return places, np.tile(0.5 * weight / panels, panels)


def _probes(camera: Camera, ideal: IdealLens) -> FloatArray:
    """Directions (5, 3) in cam of the centre and the corners of the detector."""
    right, below = camera.width_px - 1.0, camera.height_px - 1.0
    x, y = np.array([right / 2, 0, right, 0, right]), np.array([below / 2, 0, 0, below, below])
    return camera.nominal_direction(x, y, ideal.focal_px * camera.pixel_pitch_mm)


def exposure_motion(
    trajectory: Trajectory,
    *,
    start_s: float,
    exposure_s: float,
    camera: Camera,
    line_time_s: float = 0.0,
    tolerance: float = MOTION_TOLERANCE,
) -> ExposureMotion:
    """Attitudes at which an exposure is sampled; the trajectory, camera from icrs, lasts for the exposure of all rows.

    ``start_s`` is that of row 0, ``line_time_s`` the delay of the next row (0: global shutter), ``tolerance`` that of
    the damped characteristic function of the path.

    Raises
    ------
    DomainError
        Exposure not positive, line time negative, a trajectory that is too short, or an image that moves as fast as the
        rolling shutter.
    ConvergenceError
        A path too long or too wild for `NODE_LADDER`.
    """
    if not (exposure_s > 0 and math.isfinite(exposure_s)):
        raise DomainError(f"exposure_s = {exposure_s} s; it must be positive and finite")
    if not (line_time_s >= 0 and math.isfinite(line_time_s)):
        raise DomainError(f"line_time_s = {line_time_s} s; it must be 0 (global shutter) or positive")
    if not math.isfinite(start_s):
        raise DomainError(f"start_s = {start_s} s; a finite time is needed")
    middle_s = start_s + 0.5 * (camera.height_px - 1) * line_time_s
    mid = trajectory.attitude(middle_s + 0.5 * exposure_s)
    ideal = IdealLens.of(camera)
    probes = mid.inv().apply(_probes(camera, ideal))
    rows = np.array([0.5, 0.0, 0.0, 1.0, 1.0]) * (camera.height_px - 1)
    begins = start_s + rows * line_time_s if line_time_s > 0 else np.full(len(rows), start_s)

    def path_px(nodes: FloatArray) -> FloatArray:
        times = begins[:, None] + nodes * exposure_s
        if line_time_s == 0.0:
            matrix = trajectory.attitude(times[0]).as_matrix()
            return ideal.px(np.einsum("tij,nj->nti", matrix, probes))
        turned = trajectory.attitude(times.ravel()).apply(np.repeat(probes, len(nodes), axis=0))
        return ideal.px(turned.reshape(len(probes), len(nodes), 3))

    count, length_px = _converged_count(path_px, camera, tolerance)
    nodes, weight = gauss_times(count)
    last_s = start_s + exposure_s + (camera.height_px - 1) * line_time_s
    path = _spline(trajectory, mid, ideal.focal_px, start_s, last_s) if line_time_s > 0 else None
    return ExposureMotion(
        start_s=start_s,
        exposure_s=exposure_s,
        line_time_s=line_time_s,
        time_s=nodes * exposure_s,
        weight=weight,
        rotation_cam_from_world=trajectory.attitude(middle_s + nodes * exposure_s).as_matrix(),
        rotation_mid=mid.as_matrix(),
        length_px=length_px,
        path=path,
    )


def _converged_count(
    path_px: Callable[[FloatArray], FloatArray], camera: Camera, tolerance: float
) -> tuple[int, float]:
    """Number of time nodes for paths (n, t, 2) [px] at nodes (t,) on (0, 1), and the length of the longest path."""
    diffusion_px = camera.least_blur_px
    frequency = damped_frequencies(diffusion_px, tolerance)
    if frequency is None:
        frequency, diffusion_px = frequencies_up_to(HIGHEST_FREQUENCY), 0.0
    transfer_function = transfer(frequency, diffusion_px)
    coarse = path_px(np.linspace(0.0, 1.0, 9))
    length = float(np.linalg.norm(np.diff(coarse, axis=1), axis=2).sum(1).max())

    def spectrum(count: int) -> FloatArray:
        nodes, weight = gauss_times(count)
        points = path_px(nodes)
        phase = np.exp(2j * np.pi * (points @ frequency.T)) * transfer_function
        values = np.einsum("t,ntf->nf", weight, phase)
        return np.concatenate([values.real, values.imag, np.einsum("t,ntx->nx", weight, points)], axis=1)

    # a uniform path of this length takes about pi f L / 2 nodes at the highest frequency f that is left
    resolved = 0.5 * math.pi * float(np.abs(frequency).max(initial=0.0)) * length
    start = max((i for i, count in enumerate(NODE_LADDER) if count <= 0.5 * resolved), default=0)
    previous = spectrum(NODE_LADDER[start])
    for count, following in pairwise(NODE_LADDER[start:]):
        current = spectrum(following)
        if np.abs(current - previous).max() < tolerance:
            return count, length
        previous = current
    raise ConvergenceError(
        f"stars move by {length:.4g} px during the exposure, on a path that {NODE_LADDER[-2]} time nodes do not "
        "resolve; shorten the exposure or lower the rate"
    )


def _spline(trajectory: Trajectory, mid: Rotation, focal_px: float, start_s: float, end_s: float) -> CubicSpline:
    """Spline of rotation vectors from the middle attitude against time, accurate to `PATH_ERROR_PX`."""
    inverse, count = mid.inv(), 9

    def turned(times: FloatArray) -> FloatArray:
        return np.asarray((trajectory.attitude(times) * inverse).as_rotvec())

    while count <= MOST_KNOTS:
        times = np.linspace(start_s, end_s, count)
        spline = CubicSpline(times, turned(times))
        between = 0.5 * (times[1:] + times[:-1])
        if np.abs(spline(between) - turned(between)).max() * focal_px < PATH_ERROR_PX:
            return spline
        count = 2 * count - 1
    raise ConvergenceError(
        f"the attitude between {start_s:g} and {end_s:g} s changes too fast for {MOST_KNOTS} samples to resolve it"
    )


@dataclass(frozen=True, slots=True)
class IdealLens:
    """An ideal lens of the focal length of a camera's."""

    centre_px: FloatArray
    focal_px: float

    @classmethod
    def of(cls, camera: Camera) -> IdealLens:
        """Ideal lens of a camera."""
        focal_mm = abs(axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).efl_mm)
        return cls(camera.centre_px, focal_mm / camera.pixel_pitch_mm)

    def px(self, direction: FloatArray) -> FloatArray:
        """Columns and rows (..., 2) of directions in cam."""
        return np.asarray(self.centre_px + self.focal_px * direction[..., :2] / np.maximum(direction[..., 2:], 1e-3))
