"""Calibration with frames linked by a gyro of known noise: everything between ACC and free attitudes.

ACF17 takes the gyro as perfect. Here its errors are unknowns with prior knowledge. The gyro measures the rate plus a
constant bias b plus white noise (angle random walk N [rad/sqrt(s)]). If G_k is what the measured rates integrate to,
the body turned by G_k exp([z_k]x), where the vector z_k, in the frame of the body at the first frame, obeys

    dz/dt = G^T (b + noise),       z_k = B_k b + e_k,     B_k = integral of G^T dt,

so that e_k is a plain random walk whose steps have the variance N^2 dt in every direction. The attitudes are

    R_k = A G_k exp([B_k b + e_k]x) A^T R_1,      e_1 = 0,

with the residuals (e_k - e_(k-1)) / (N sqrt(dt)) and b / sigma_b beside those of the stars. The walk couples
neighbouring frames only: the frames' part of the normal equations is a band. N -> 0 is ACC
(`calib.calibration.attitude_correlated`); N -> infinity is a free attitude in every frame
(`calib.calibration.free_attitude`), where the installation is no longer seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.attitude.link import exponential, right_jacobian
from calib.calibration.attitude_correlated import (
    ANGLE_NAMES,
    GyroLink,
    LinkState,
    linked_parity,
    start_link,
    without_rounding,
)
from calib.calibration.fit import (
    fit_stages,
    frames_with,
    free_stages,
    packed,
    refused,
    verdict,
)
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.star_problem import Prior, StarProblem, StarState, free_mask
from calib.cameras.base import CameraModel
from calib.fitting.robust_loss import Loss, get_loss
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import DEG_RAD

__all__ = ["BIAS_NAMES", "GyroNoise", "GyroWalk", "WalkState", "calibrate_gyro_linked"]

METHOD = "gyro_linked"
BIAS_NAMES = ("bias1_rad_per_s", "bias2_rad_per_s", "bias3_rad_per_s")
LEAST_WALK = 1e-12  # rad/sqrt(s): 3e-9 deg/sqrt(h), far below any gyro; keeps the prior finite


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroNoise:
    """What is known about a gyro's errors.

    Attributes
    ----------
    angle_random_walk_rad_per_sqrt_s : float
        Angle random walk N, the same about all axes; 0 or more.
    bias_sigma_rad_per_s : float
        Prior standard deviation of the bias about each axis; 0 where it is known to vanish (or was taken off).

    Raises
    ------
    DomainError
        On a negative value or one that is not finite.
    """

    angle_random_walk_rad_per_sqrt_s: float
    bias_sigma_rad_per_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("angle_random_walk_rad_per_sqrt_s", "bias_sigma_rad_per_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise DomainError(f"GyroNoise.{name} = {value}; it must be finite and not negative")

    @classmethod
    def from_data_sheet(cls, *, angle_random_walk_deg_per_sqrt_h: float, bias_deg_per_h: float = 0.0) -> GyroNoise:
        """From the units of data sheets: deg/sqrt(h) is deg/60 per sqrt(s), deg/h is deg/3600 per s."""
        return cls(
            angle_random_walk_rad_per_sqrt_s=angle_random_walk_deg_per_sqrt_h * DEG_RAD / 60.0,
            bias_sigma_rad_per_s=bias_deg_per_h * DEG_RAD / 3600.0,
        )


@dataclass(frozen=True, slots=True)
class WalkState:
    """First attitude, installation, bias (3,) [rad/s] and walk (f, 3) [rad]."""

    link: LinkState
    bias: FloatArray
    walk: FloatArray


class GyroWalk:
    """Pose family of frames linked by a gyro with random walk and bias.

    Parameters
    ----------
    turn : (f, 3, 3)
        Measured turns of the body from the first frame.
    time_s : (f,)
        Times of the frames, increasing.
    noise : GyroNoise
        Prior knowledge; without a bias sigma the bias is no unknown.
    """

    def __init__(self, turn: FloatArray, time_s: FloatArray, noise: GyroNoise) -> None:
        self._link = GyroLink(turn)
        self._frames = len(turn)
        self._with_bias = noise.bias_sigma_rad_per_s > 0
        self._bias_information = noise.bias_sigma_rad_per_s**-2 if self._with_bias else 0.0
        walk = max(noise.angle_random_walk_rad_per_sqrt_s, LEAST_WALK)
        self._step_information = 1.0 / (walk**2 * np.diff(time_s))
        self.lever = _bias_levers(turn, time_s)
        self.names = ANGLE_NAMES + (BIAS_NAMES if self._with_bias else ())
        self.block_size = 3
        self.block_unknowns = 3 * (self._frames - 1)
        self.prior_terms = 3 * (self._frames - 1) + (3 if self._with_bias else 0)

    def start(self, link: LinkState) -> WalkState:
        """State without gyro errors."""
        return WalkState(link, np.zeros(3), np.zeros((self._frames, 3)))

    def rotations(self, state: WalkState) -> FloatArray:
        """Eq. 6 with the corrected gyro."""
        a = state.link.installation
        return np.asarray(a @ self._body(state) @ (a.T @ state.link.first))

    def _error(self, state: WalkState) -> FloatArray:
        return np.asarray(self.lever @ state.bias + state.walk)

    def _body(self, state: WalkState) -> FloatArray:
        return np.asarray(self._link.turn @ exponential(self._error(state)))

    def rates(self, state: WalkState, rotation: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Those of ACC, then the bias; the walk of each frame."""
        linked = rotation @ state.link.first.T
        block = state.link.installation @ self._body(state) @ right_jacobian(self._error(state))
        parts = [linked, without_rounding(np.eye(3) - linked)]
        if self._with_bias:
            parts.append(block @ self.lever)
        block[0] = 0.0  # the walk begins at the first frame
        return np.concatenate(parts, axis=2), block

    def move(self, state: WalkState, common: FloatArray, block: FloatArray | None) -> WalkState:
        """Turn first attitude and installation, change bias and walk."""
        assert block is not None
        walk = state.walk + block
        walk[0] = 0.0
        bias = state.bias + common[6:] if self._with_bias else state.bias
        return WalkState(self._link.move(state.link, common[:6], None), bias, walk)

    def penalty(self, state: WalkState) -> float:
        """Squares of the gyro's steps and of its bias over their variances."""
        steps = np.sum(np.diff(state.walk, axis=0) ** 2, axis=1)
        return float(self._step_information @ steps + self._bias_information * (state.bias @ state.bias))

    def prior(self, state: WalkState) -> Prior | None:
        """A tridiagonal chain for the walk, a diagonal for the bias."""
        q = self._step_information
        inside = np.concatenate([[1.0], q])  # the first frame's walk is no unknown: any positive number
        inside[1:-1] += q[1:]
        flow = q[:, None] * np.diff(state.walk, axis=0)
        gradient = np.zeros((self._frames, 3))
        gradient[1:] += flow
        gradient[1:-1] -= flow[1:]
        coupling = -q[:, None, None] * np.eye(3)
        coupling[:1] = 0.0
        size = len(self.names)
        common = np.zeros((size, size))
        common[6:, 6:] = self._bias_information * np.eye(size - 6)
        common_gradient = np.zeros(size)
        common_gradient[6:] = self._bias_information * state.bias[: size - 6]
        return Prior(
            common=common,
            gradient=common_gradient,
            block=inside[:, None, None] * np.eye(3),
            block_gradient=gradient,
            coupling=coupling,
        )

    def reported(self, state: WalkState) -> tuple[FloatArray, FloatArray]:
        """Angles, then the bias."""
        value, derivative = self._link.reported(state.link)
        size = len(self.names)
        full = np.eye(size)
        full[:6, :6] = derivative
        return np.concatenate([value, state.bias[: size - 6]]), full


def _bias_levers(turn: FloatArray, time_s: FloatArray) -> FloatArray:
    """B_k (f, 3, 3) [s], the integral of G^T from the first frame, exact for a constant rate between frames."""
    step = Rotation.from_matrix(turn[1:] @ turn[:-1].swapaxes(1, 2)).as_rotvec()
    # G(t) = exp(step s) G_k; the integral of exp(-step s) over s is the right Jacobian of the step
    pieces = turn[:-1].swapaxes(1, 2) @ right_jacobian(step) * np.diff(time_s)[:, None, None]
    return np.concatenate([np.zeros((1, 3, 3)), np.cumsum(pieces, axis=0)])


def calibrate_gyro_linked(
    observations: Observations,
    gyro_rotation: Rotation,
    start_model: CameraModel,
    *,
    time_s: ArrayLike,
    noise: GyroNoise,
    start_attitude: Rotation | None = None,
    start_installation: Rotation | None = None,
    two_step: bool = True,
    loss: str | Loss = "linear",
    free: Sequence[str] | None = None,
) -> Calibration:
    """Calibrate a camera, its first attitude and its installation with a gyro of stated noise.

    Parameters
    ----------
    observations : Observations
        Measured stars; frame numbers in the order of time.
    gyro_rotation : Rotation
        f rotations, gyro body at frame k from gyro body at the first frame.
    start_model : CameraModel
        Start of the camera; fixed parameters keep their value.
    time_s : (f,)
        Times of the frames [s].
    noise : GyroNoise
        The gyro's angle random walk and the prior of its bias.
    start_attitude, start_installation, two_step, loss, free
        As in `calib.calibration.attitude_correlated.calibrate_attitude_correlated`.

    Returns
    -------
    Calibration
        ``solution`` holds the free camera parameters, the angles, and the bias [rad/s] if it has a prior sigma.

    Raises
    ------
    DomainError
        If gyro rotations or times do not match the frames, or times do not increase.
    ConfigError
        On an unknown parameter or loss.
    """
    chosen, mask = get_loss(loss), free_mask(start_model, free)
    turn = gyro_rotation.as_matrix().reshape(-1, 3, 3)
    time = checked_times(time_s, turn, observations.frames)
    selection = frames_with(observations, start_model, 1)
    stars = selection.observations
    link = start_link(
        stars,
        turn,
        start_model,
        start_attitude=start_attitude,
        start_installation=start_installation,
        robust=chosen.name != "linear",
    )
    family = GyroWalk(turn, time, noise)
    start = family.start(link)
    names = (*(n for n, moves in zip(start_model.parameter_names, mask, strict=True) if moves), *family.names)
    surplus = 2 * len(stars.frame) + family.prior_terms - len(names) - family.block_unknowns
    if surplus <= 0:
        return refused(
            METHOD,
            names,
            start_model,
            message=f"{len(stars.frame)} stars give {2 * len(stars.frame)} measurements for {len(names)} unknowns",
            selection=selection,
            unknowns=len(names),
            attitude=family.rotations(start),
            installation=Rotation.from_matrix(link.installation),
        )
    fit, spread = fit_stages(
        lambda stage: StarProblem(stars, start_model, stage, family),
        StarState(np.array(start_model.parameters), start),
        free_stages(start_model, mask, two_step=two_step),
        chosen,
    )

    status, message = verdict(fit, spread, chosen, lambda: linked_parity(stars, turn, start_model))
    return packed(
        METHOD,
        fit,
        start_model,
        mask,
        selection=selection,
        status=status,
        message=message,
        attitude=family.rotations(fit.state.pose),
        installation=Rotation.from_matrix(fit.state.pose.link.installation),
    )


def checked_times(time_s: ArrayLike, turn: FloatArray, frames: int) -> FloatArray:
    """Times (f,) that match the gyro's rotations and the frames.

    Raises
    ------
    DomainError
        If they do not.
    """
    time = np.asarray(time_s, dtype=np.float64)
    if len(turn) != frames or time.shape != (frames,):
        raise DomainError(
            f"{len(turn)} gyro rotations and {time.size} times for {frames} frames; one of each is needed"
        )
    if not (np.all(np.isfinite(time)) and np.all(np.diff(time) > 0)):
        raise DomainError("the times of the frames must be finite and increase [s]; number the frames in their order")
    return time
