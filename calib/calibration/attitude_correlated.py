"""Attitude-correlated frames (ACC): a perfect gyro links the attitudes of all frames (ACF17, sec. 2.2).

With the gyro's rotation G_k from the first frame to frame k, the installation A (camera from gyro body) and the
attitude R_1 of the camera in the first frame, eq. 6 is R_k = M_k R_1 with M_k = A G_k A^T. The unknowns are the camera,
R_1 and A: 14 for the camera of ACF17, for any number of frames, so that a single star per frame is enough.

Steps are rotation vectors, w_R of R_1 and w_A of A; frame k turns by (`calib.calibration.star_problem`)

    w_k = M_k w_R + (I - M_k) w_A.

No angle is singular inside. The results are the document's angles phi of R_1 and theta of A
(`calib.attitude.euler_angles`), with the covariance carried over. If the body turns about a single axis, the turn of A
about that axis does not show in any star, and A is "singular"; the camera is not.

The start of ACF17 is 0 px, 20 mm, no distortion, phi = 0 and theta = 0. With phi = 0 the stars stand 62 deg from where
they should be, and it still converges as long as none of them falls behind the camera (else the start is "refused"). By
default phi comes from the identified stars by Wahba's problem, and theta from the turns between frames.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from calib.attitude.euler_angles import angle_per_increment, angles_of_rotation
from calib.attitude.wahba import rotations_of_groups
from calib.calibration.attitude_family import RotationFamily
from calib.calibration.free_attitudes import frame_parity
from calib.calibration.observations import Observations
from calib.calibration.verdict import parity_hint
from calib.cameras.base import CameraModel
from calib.fitting.rotation_vectors import exponential
from optics.arrays import FloatArray
from optics.records import locked

ANGLE_NAMES = ("phi1_rad", "phi2_rad", "phi3_rad", "theta1_rad", "theta2_rad", "theta3_rad")
LEAST_TURN_RAD = 1e-3  # between frames, from which the installation follows from turns of camera and body
LEAST_ASPECT = 0.02  # of the second to the first principal turn, below which the turns span one direction only


@dataclass(frozen=True, slots=True)
class LinkState:
    """First attitude (3, 3), cam from reference, and installation (3, 3), cam from gyro body."""

    first: FloatArray
    installation: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeCorrelated(RotationFamily):
    """Frames linked by a perfect gyro.

    Attributes
    ----------
    gyro_rotation : Rotation
        f rotations, gyro body at frame k from gyro body at the first frame (C_b1_to_bk).
    first_attitude : Rotation or None
        Attitude of the first frame, cam from reference, where a fit starts or where a bound is taken; by default by
        Wahba's problem.
    installation : Rotation or None
        Installation, cam from gyro body, likewise; by default from the turns between frames, or the identity where
        they span one direction only.
    turn : (f, 3, 3)
        Matrices of ``gyro_rotation``.
    """

    gyro_rotation: Rotation
    first_attitude: Rotation | None = None
    installation: Rotation | None = None
    turn: FloatArray = field(init=False, repr=False)

    method: ClassVar[str] = "attitude_correlated"
    per_frame: ClassVar[str] = "gyro rotations"

    def __post_init__(self) -> None:
        object.__setattr__(self, "turn", locked(self.gyro_rotation.as_matrix().reshape(-1, 3, 3)))

    @property
    def frames(self) -> int:
        """Number of gyro rotations."""
        return len(self.turn)

    def names(self, stars: Observations) -> tuple[str, ...]:
        """The document's angles."""
        return ANGLE_NAMES

    def start_pose(self, stars: Observations, model: CameraModel, *, robust: bool) -> LinkState:
        """Given values unchanged; the first attitude from all stars, each turned back to the first frame."""
        measured = model.unproject(stars.pixel_px, stars.band)
        installation = np.eye(3)
        if self.installation is not None:
            installation = self.installation.as_matrix().reshape(3, 3)
        else:
            installation = self._installation_from_turns(stars, measured, robust=robust)
        if self.first_attitude is not None:
            return LinkState(self.first_attitude.as_matrix().reshape(3, 3), installation)
        linked = installation @ self.turn @ installation.T
        in_first_frame = np.einsum("nji,nj->ni", linked[stars.frame], measured)
        return LinkState(_one_rotation(in_first_frame, stars.direction, robust=robust), installation)

    def _installation_from_turns(self, stars: Observations, measured: FloatArray, *, robust: bool) -> FloatArray:
        """Installation (3, 3) from the turns between frames, the identity where they do not determine it.

        The turn of the camera between two frames is that of the body seen in cam, R_k R_1^T = A G_k A^T; so are the
        rotation vectors, and A solves Wahba's problem on them.
        """
        frames = np.flatnonzero(np.bincount(stars.frame, minlength=stars.frames) >= 3)
        if len(frames) < 3:
            return np.eye(3)
        attitude = rotations_of_groups(measured, stars.direction, stars.frame, stars.frames, robust=robust)[frames]
        body = self.turn[frames]
        camera_turn = Rotation.from_matrix(attitude @ attitude[0].T).as_rotvec()
        body_turn = Rotation.from_matrix(body @ body[0].T).as_rotvec()
        size = np.linalg.svd(body_turn, compute_uv=False)
        if not (size[0] > LEAST_TURN_RAD and size[1] > LEAST_ASPECT * size[0]):
            return np.eye(3)
        return _one_rotation(camera_turn, body_turn, robust=robust)

    def rotations(self, pose: LinkState) -> FloatArray:
        """Rotations of all frames by eq. 6."""
        return np.asarray(pose.installation @ self.turn @ (pose.installation.T @ pose.first))

    def rates(self, pose: LinkState, rotation: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """M_k and I - M_k."""
        linked = rotation @ pose.first.T
        rates = np.eye(3) - linked
        # an unknown without effect must not be scaled up to one: what is rounding is set to zero
        return np.concatenate([linked, np.where(np.abs(rates) < 1e-13, 0.0, rates)], axis=2), None

    def move(self, pose: LinkState, common: FloatArray, block: FloatArray | None) -> LinkState:
        """Turn the first attitude and the installation."""
        turn = exponential(common.reshape(2, 3))
        return LinkState(turn[0] @ pose.first, turn[1] @ pose.installation)

    def reported(self, pose: LinkState) -> tuple[FloatArray, FloatArray]:
        """Angles phi and theta, and their derivatives by the rotation vectors."""
        angle = angles_of_rotation(Rotation.from_matrix(np.stack([pose.first, pose.installation])))
        derivative = np.zeros((6, 6))
        for i, value in enumerate(angle):
            derivative[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = angle_per_increment(value)
        return angle.ravel(), derivative

    def installation_of(self, pose: LinkState) -> Rotation:
        """cam from gyro body."""
        return Rotation.from_matrix(pose.installation)

    def parity(self, stars: Observations, model: CameraModel) -> str:
        """Frame by frame; frames with fewer than three stars are judged together, turned back by the gyro."""
        if np.bincount(stars.frame, minlength=1).max() >= 3:
            return frame_parity(stars, model)
        in_first_frame = np.einsum("nji,nj->ni", self.turn[stars.frame], model.unproject(stars.pixel_px, stars.band))
        return parity_hint(in_first_frame, stars.direction, np.zeros(len(in_first_frame), dtype=np.int64), 1)


def _one_rotation(measured: FloatArray, reference: FloatArray, *, robust: bool) -> FloatArray:
    """Rotation (3, 3) of all vectors together."""
    return rotations_of_groups(measured, reference, np.zeros(len(measured), dtype=np.int64), 1, robust=robust)[0]
