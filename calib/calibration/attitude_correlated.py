"""Calibration with attitude-correlated frames (ACC): a gyro links the attitudes of all frames (ACF17, sec. 2.2).

With the gyro's rotation G_k from the first frame to frame k, the installation A (camera from gyro body) and the
attitude R_1 of the camera in the first frame, eq. 6 is R_k = M_k R_1 with M_k = A G_k A^T. The unknowns are the camera,
R_1 and A: 14 for the camera of ACF17, whatever the number of frames, so that a single star per frame is enough.

Steps are rotation vectors, w_R of R_1 and w_A of A; frame k turns by (`calib.calibration.star_problem`)

    w_k = M_k w_R + (I - M_k) w_A.

No angle is singular inside. What is reported are the document's angles phi of R_1 and theta of A
(`calib.attitude.link`), with the covariance carried over. If the body turns about a single axis, the turn of A about
that axis does not show in any star, and A is "singular"; the camera is not.

The start of ACF17 is 0 px, 20 mm, no distortion, phi = 0 and theta = 0. With phi = 0 the stars stand 62 deg from where
they should be, and it still converges as long as none of them falls behind the camera (else the start is "refused"). By
default phi comes from the identified stars by Wahba's problem, and theta from the turns between
frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.attitude.link import angles_of_rotation, exponential, increment_per_angle
from calib.calibration.fit import (
    fit_stages,
    frames_with,
    free_stages,
    mirrored,
    packed,
    refused,
    verdict,
    wahba,
)
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.star_problem import Prior, StarProblem, StarState, free_mask
from calib.cameras.base import CameraModel
from calib.fitting.robust_loss import Loss, get_loss
from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = [
    "ANGLE_NAMES",
    "GyroLink",
    "LinkState",
    "calibrate_attitude_correlated",
    "linked_parity",
    "start_link",
    "without_rounding",
]

METHOD = "attitude_correlated"
ANGLE_NAMES = ("phi1_rad", "phi2_rad", "phi3_rad", "theta1_rad", "theta2_rad", "theta3_rad")


@dataclass(frozen=True, slots=True)
class LinkState:
    """First attitude (3, 3), cam from reference, and installation (3, 3), cam from gyro body."""

    first: FloatArray
    installation: FloatArray


@dataclass(frozen=True, slots=True)
class GyroLink:
    """Pose family of frames linked by a perfect gyro.

    Parameters
    ----------
    turn : (f, 3, 3)
        Gyro body at frame k from gyro body at the first frame.
    """

    turn: FloatArray

    @property
    def names(self) -> tuple[str, ...]:
        """The document's angles."""
        return ANGLE_NAMES

    @property
    def block_size(self) -> int:
        """No frame has unknowns of its own."""
        return 0

    @property
    def block_unknowns(self) -> int:
        """None."""
        return 0

    @property
    def prior_terms(self) -> int:
        """None."""
        return 0

    def rotations(self, state: LinkState) -> FloatArray:
        """Eq. 6."""
        return np.asarray(state.installation @ self.turn @ (state.installation.T @ state.first))

    def rates(self, state: LinkState, rotation: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """M_k and I - M_k."""
        linked = rotation @ state.first.T
        return np.concatenate([linked, without_rounding(np.eye(3) - linked)], axis=2), None

    def move(self, state: LinkState, common: FloatArray, block: FloatArray | None) -> LinkState:
        """Turn the first attitude and the installation."""
        turn = exponential(common.reshape(2, 3))
        return LinkState(turn[0] @ state.first, turn[1] @ state.installation)

    def penalty(self, state: LinkState) -> float:
        """The gyro is taken as perfect."""
        return 0.0

    def prior(self, state: LinkState) -> Prior | None:
        """The gyro is taken as perfect."""
        return None

    def reported(self, state: LinkState) -> tuple[FloatArray, FloatArray]:
        """Angles phi and theta, and their derivatives by the rotation vectors."""
        angle = angles_of_rotation(Rotation.from_matrix(np.stack([state.first, state.installation])))
        derivative = np.zeros((6, 6))
        for i, value in enumerate(angle):
            derivative[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = np.linalg.pinv(increment_per_angle(value))
        return angle.ravel(), derivative


def without_rounding(rates: FloatArray) -> FloatArray:
    """Rates with what is rounding set to zero: an unknown without effect must not be scaled up to one."""
    return np.where(np.abs(rates) < 1e-13, 0.0, rates)


def start_link(
    observations: Observations,
    turn: FloatArray,
    model: CameraModel,
    *,
    start_attitude: Rotation | None,
    start_installation: Rotation | None,
    robust: bool,
) -> LinkState:
    """Start of the first attitude and the installation, what is given taken as it is.

    The turn of the camera between two frames is that of the body seen in cam, R_k R_1^T = A G_k A^T; so are the
    rotation vectors, and A solves Wahba's problem on them. It is used where the turns span two directions, else A
    starts at the identity. The first attitude then follows from all stars, each turned back to the first frame.
    """
    seen = model.unproject(observations.pixel_px, observations.band)
    frames = observations.frames
    installation = np.eye(3)
    if start_installation is not None:
        installation = start_installation.as_matrix()
    else:
        count = np.bincount(observations.frame, minlength=frames)
        several = np.flatnonzero(count >= 3)
        if len(several) >= 3:
            attitude = wahba(seen, observations.direction, observations.frame, frames, robust=robust)[several]
            body = turn[several]
            camera_turn = Rotation.from_matrix(attitude @ attitude[0].T).as_rotvec()
            body_turn = Rotation.from_matrix(body @ body[0].T).as_rotvec()
            size = np.linalg.svd(body_turn, compute_uv=False)
            if size[0] > 1e-3 and size[1] > 0.02 * size[0]:
                group = np.zeros(len(several), dtype=np.int64)
                installation = wahba(camera_turn, body_turn, group, 1, robust=robust)[0]
    if start_attitude is not None:
        return LinkState(start_attitude.as_matrix(), installation)
    linked = installation @ turn @ installation.T
    back = np.einsum("nji,nj->ni", linked[observations.frame], seen)
    group = np.zeros(len(back), dtype=np.int64)
    return LinkState(wahba(back, observations.direction, group, 1, robust=robust)[0], installation)


def linked_parity(observations: Observations, turn: FloatArray, model: CameraModel) -> str:
    """Hint on a mirrored sky; frames with fewer than three stars are judged together, turned back by the gyro."""
    seen = model.unproject(observations.pixel_px, observations.band)
    if np.bincount(observations.frame, minlength=1).max() >= 3:
        return mirrored(seen, observations.direction, observations.frame, observations.frames)
    back = np.einsum("nji,nj->ni", turn[observations.frame], seen)
    return mirrored(back, observations.direction, np.zeros(len(back), dtype=np.int64), 1)


def calibrate_attitude_correlated(
    observations: Observations,
    gyro_rotation: Rotation,
    start_model: CameraModel,
    *,
    start_attitude: Rotation | None = None,
    start_installation: Rotation | None = None,
    two_step: bool = True,
    loss: str | Loss = "linear",
    free: Sequence[str] | None = None,
) -> Calibration:
    """Calibrate a camera, its first attitude and its installation from frames linked by a gyro.

    Parameters
    ----------
    observations : Observations
        Measured stars.
    gyro_rotation : Rotation
        f rotations, gyro body at frame k from gyro body at the first frame (C_b1_to_bk).
    start_model : CameraModel
        Start of the camera; fixed parameters keep their value.
    start_attitude : Rotation, optional
        First attitude, cam from reference; by default by Wahba's problem.
    start_installation : Rotation, optional
        cam from gyro body; by default from the turns between frames, or the identity where they span one direction
        only.
    two_step : bool
        As in the document: without distortion first (9 unknowns), then all (14).
    loss : str or Loss
        Robust loss; "tukey" survives wrong matches.
    free : sequence of str, optional
        Camera parameters to fit; all by default. The six angles are always fitted.

    Returns
    -------
    Calibration
        ``solution`` holds the free camera parameters and the angles phi1..3, theta1..3 [rad].

    Raises
    ------
    DomainError
        If the number of gyro rotations is not the number of frames, or the star list is in another pixel convention.
    ConfigError
        On an unknown parameter or loss.
    """
    chosen, mask = get_loss(loss), free_mask(start_model, free)
    turn = gyro_rotation.as_matrix().reshape(-1, 3, 3)
    if len(turn) != observations.frames:
        raise DomainError(f"{len(turn)} gyro rotations for {observations.frames} frames; one for each is needed")
    selection = frames_with(observations, start_model, 1)
    stars = selection.observations
    start = start_link(
        stars,
        turn,
        start_model,
        start_attitude=start_attitude,
        start_installation=start_installation,
        robust=chosen.name != "linear",
    )
    family = GyroLink(turn)
    names = (*(n for n, moves in zip(start_model.parameter_names, mask, strict=True) if moves), *ANGLE_NAMES)
    if 2 * len(stars.frame) <= len(names):
        return refused(
            METHOD,
            names,
            start_model,
            message=f"{len(stars.frame)} stars give {2 * len(stars.frame)} measurements for {len(names)} unknowns",
            selection=selection,
            unknowns=len(names),
            attitude=family.rotations(start),
            installation=Rotation.from_matrix(start.installation),
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
        installation=Rotation.from_matrix(fit.state.pose.installation),
    )
