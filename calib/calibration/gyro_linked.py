"""Calibration with frames linked by a gyro of known noise: everything between ACC and free attitudes.

ACF17 takes the gyro as perfect. Here its errors are unknowns with prior knowledge. The gyro measures the rate plus a
constant bias b plus white noise (angle random walk N [rad/sqrt(s)]). If G_k is what the measured rates integrate to,
the body turned by G_k exp([z_k]x), where the vector z_k, in the frame of the body at the first frame, obeys

    dz/dt = G^T (b + noise),       z_k = B_k b + e_k,     B_k = integral of G^T dt,

so that e_k is a plain random walk whose steps have the variance N^2 dt in every direction. The attitudes are

    R_k = A G_k exp([B_k b + e_k]x) A^T R_1,      e_1 = 0,

with the residuals (e_k - e_(k-1)) / (N sqrt(dt)) and b / sigma_b in addition to the stars' residuals. The walk couples
neighbouring frames only: the frames' part of the normal equations is a band. N -> 0 is ACC
(`calib.calibration.attitude_correlated`); N -> infinity is a free attitude in every frame
(`calib.calibration.free_attitudes`), where the installation is no longer seen.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.attitude_correlated import AttitudeCorrelated, LinkState
from calib.calibration.attitude_family import RotationFamily
from calib.calibration.observations import Observations
from calib.calibration.star_problem import Prior
from calib.cameras.base import CameraModel
from calib.fitting.rotation_vectors import exponential, right_jacobian
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze, locked
from optics.units import DEG_RAD

BIAS_NAMES = ("bias1_rad_per_s", "bias2_rad_per_s", "bias3_rad_per_s")
LEAST_WALK = 1e-12  # rad/sqrt(s): 3e-9 deg/sqrt(h), far below any gyro; keeps the prior finite


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroNoise:
    """Error model of a gyro.

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


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroLinked(RotationFamily):
    """Frames linked by a gyro with angle random walk and bias.

    Attributes
    ----------
    gyro_rotation : Rotation
        f measured rotations, gyro body at frame k from gyro body at the first frame.
    time_s : (f,)
        Times of the frames [s], increasing: frames are numbered in the order of time.
    noise : GyroNoise
        The gyro's angle random walk and the prior of its bias; without a bias sigma the bias is no unknown.
    first_attitude, installation : Rotation or None
        As in `AttitudeCorrelated`.
    link : AttitudeCorrelated
        The same frames with the gyro taken as perfect.
    lever_s : (f, 3, 3)
        B_k, rotation of the body per unit of bias.

    Raises
    ------
    DomainError
        If there is not one time per gyro rotation, or times do not increase.
    """

    gyro_rotation: Rotation
    time_s: FloatArray
    noise: GyroNoise
    first_attitude: Rotation | None = None
    installation: Rotation | None = None
    link: AttitudeCorrelated = field(init=False, repr=False)
    lever_s: FloatArray = field(init=False, repr=False)
    _step_information: FloatArray = field(init=False, repr=False)
    _bias_information: float = field(init=False, repr=False)

    method: ClassVar[str] = "gyro_linked"
    per_frame: ClassVar[str] = "gyro rotations"

    def __post_init__(self) -> None:
        link = AttitudeCorrelated(
            gyro_rotation=self.gyro_rotation, first_attitude=self.first_attitude, installation=self.installation
        )
        time = freeze(self, "time_s", shape=("f",), finite=False)
        if len(time) != len(link.turn):
            raise DomainError(
                f"GyroLinked: {len(link.turn)} gyro rotations and {len(time)} times; one of each per frame is needed"
            )
        if not (np.all(np.isfinite(time)) and np.all(np.diff(time) > 0)):
            raise DomainError("GyroLinked.time_s: times must be finite and increase [s]; number the frames in order")
        walk = max(self.noise.angle_random_walk_rad_per_sqrt_s, LEAST_WALK)
        bias = self.noise.bias_sigma_rad_per_s
        for name, value in (
            ("link", link),
            ("lever_s", locked(_bias_levers(link.turn, time))),
            ("_step_information", 1.0 / (walk**2 * np.diff(time))),
            ("_bias_information", bias**-2 if bias > 0 else 0.0),
        ):
            object.__setattr__(self, name, value)

    @property
    def _bias_names(self) -> tuple[str, ...]:
        return BIAS_NAMES if self._bias_information else ()

    @property
    def frames(self) -> int:
        """Number of gyro rotations."""
        return len(self.time_s)

    def names(self, stars: Observations) -> tuple[str, ...]:
        """The document's angles, and the bias if it is an unknown."""
        return self.link.names(stars) + self._bias_names

    def frame_unknowns(self, stars: Observations) -> int:
        """The walk of every frame but the first."""
        return 3 * (self.frames - 1)

    @property
    def prior_terms(self) -> int:
        """Steps of the walk, and the bias."""
        return 3 * (self.frames - 1) + len(self._bias_names)

    def start_pose(self, stars: Observations, model: CameraModel, *, robust: bool) -> WalkState:
        """No gyro errors."""
        link = self.link.start_pose(stars, model, robust=robust)
        return WalkState(link, np.zeros(3), np.zeros((self.frames, 3)))

    def rotations(self, pose: WalkState) -> FloatArray:
        """Eq. 6 with the corrected gyro."""
        a = pose.link.installation
        return np.asarray(a @ self._body(pose) @ (a.T @ pose.link.first))

    def _error(self, pose: WalkState) -> FloatArray:
        return np.asarray(self.lever_s @ pose.bias + pose.walk)

    def _body(self, pose: WalkState) -> FloatArray:
        return np.asarray(self.link.turn @ exponential(self._error(pose)))

    def rates(self, pose: WalkState, rotation: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Rates of ACC, then of the bias; of the walk of each frame."""
        common, _ = self.link.rates(pose.link, rotation)
        block = pose.link.installation @ self._body(pose) @ right_jacobian(self._error(pose))
        if self._bias_names:
            common = np.concatenate([common, block @ self.lever_s], axis=2)
        block[0] = 0.0  # the walk begins at the first frame
        return common, block

    def move(self, pose: WalkState, common: FloatArray, block: FloatArray | None) -> WalkState:
        """Turn first attitude and installation, change bias and walk."""
        assert block is not None
        walk = pose.walk + block
        walk[0] = 0.0
        bias = pose.bias + common[6:] if self._bias_names else pose.bias
        return WalkState(self.link.move(pose.link, common[:6], None), bias, walk)

    def penalty(self, pose: WalkState) -> float:
        """Squares of the gyro's steps and of its bias over their variances."""
        steps = np.sum(np.diff(pose.walk, axis=0) ** 2, axis=1)
        return float(self._step_information @ steps + self._bias_information * (pose.bias @ pose.bias))

    def prior(self, pose: WalkState) -> Prior | None:
        """A tridiagonal chain for the walk, a diagonal for the bias."""
        q = self._step_information
        inside = np.concatenate([[1.0], q])  # the first frame's walk is no unknown: any positive number
        inside[1:-1] += q[1:]
        flow = q[:, None] * np.diff(pose.walk, axis=0)
        gradient = np.zeros((self.frames, 3))
        gradient[1:] += flow
        gradient[1:-1] -= flow[1:]
        coupling = -q[:, None, None] * np.eye(3)
        coupling[:1] = 0.0
        biases = len(self._bias_names)
        common = np.zeros((6 + biases, 6 + biases))
        common[6:, 6:] = self._bias_information * np.eye(biases)
        common_gradient = np.zeros(6 + biases)
        common_gradient[6:] = self._bias_information * pose.bias[:biases]
        return Prior(
            common=common,
            gradient=common_gradient,
            block=inside[:, None, None] * np.eye(3),
            block_gradient=gradient,
            coupling=coupling,
        )

    def reported(self, pose: WalkState) -> tuple[FloatArray, FloatArray]:
        """Angles, then the bias."""
        value, derivative = self.link.reported(pose.link)
        biases = len(self._bias_names)
        full = np.eye(6 + biases)
        full[:6, :6] = derivative
        return np.concatenate([value, pose.bias[:biases]]), full

    def installation_of(self, pose: WalkState) -> Rotation:
        """cam from gyro body."""
        return self.link.installation_of(pose.link)

    def parity(self, stars: Observations, model: CameraModel) -> str:
        """As with a perfect gyro."""
        return self.link.parity(stars, model)


def _bias_levers(turn: FloatArray, time_s: FloatArray) -> FloatArray:
    """B_k (f, 3, 3) [s], the integral of G^T from the first frame, exact for a constant rate between frames."""
    step = Rotation.from_matrix(turn[1:] @ turn[:-1].swapaxes(1, 2)).as_rotvec()
    # G(t) = exp(step s) G_k; the integral of exp(-step s) over s is the right Jacobian of the step
    pieces = turn[:-1].swapaxes(1, 2) @ right_jacobian(step) * np.diff(time_s)[:, None, None]
    return np.concatenate([np.zeros((1, 3, 3)), np.cumsum(pieces, axis=0)])
