"""A free attitude in every frame: bundle adjustment with rotations alone.

    minimise  sum over frames k, stars j of |W_kj (project(camera, R_k r_j) - measured_kj)|^2

over the camera and one rotation R_k per frame, eliminated frame by frame (`calib.fitting.block_arrow`). Nothing is
assumed about how the camera moves. A frame of n stars gives 2 n - 3 measurements of the camera; a frame with a single
star gives none and is left out (its attitude in the result is one of the many that fit).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from calib.attitude.wahba import rotations_of_groups
from calib.calibration.attitude_family import RotationFamily, frames_with_stars
from calib.calibration.observations import Observations
from calib.calibration.star_problem import StarState
from calib.calibration.verdict import parity_hint
from calib.cameras.base import CameraModel
from calib.fitting.least_squares import Fit
from calib.fitting.rotation_vectors import exponential
from optics.arrays import FloatArray

LOST_PART = 0.5  # of a frame's stars without weight, above which its attitude is looked for again


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeAttitudes(RotationFamily):
    """An independent attitude in every frame.

    Attributes
    ----------
    attitude : Rotation or None
        f attitudes, cam from reference, where a fit starts or where a bound is taken; by default Wahba's problem with
        the start camera.
    """

    attitude: Rotation | None = None

    method: ClassVar[str] = "free_attitude"
    least_stars: ClassVar[int] = 2

    @property
    def frames(self) -> int | None:
        """Number of attitudes, if any are given."""
        return None if self.attitude is None else len(_matrices(self.attitude))

    def frame_unknowns(self, stars: Observations) -> int:
        """A rotation vector for every frame with stars."""
        return 3 * frames_with_stars(stars)

    def start_pose(self, stars: Observations, model: CameraModel, *, robust: bool) -> FloatArray:
        """Attitudes (f, 3, 3)."""
        return start_attitudes(stars, model, robust=robust) if self.attitude is None else _matrices(self.attitude)

    def rotations(self, pose: FloatArray) -> FloatArray:
        """The state itself."""
        return pose

    def rates(self, pose: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """A frame turns by its own rotation vector."""
        frames = len(rotation)
        return np.zeros((frames, 3, 0)), np.broadcast_to(np.eye(3), (frames, 3, 3))

    def move(self, pose: FloatArray, common: FloatArray, block: FloatArray | None) -> FloatArray:
        """Turn every frame."""
        assert block is not None
        return exponential(block) @ pose

    def parity(self, stars: Observations, model: CameraModel) -> str:
        """Parity of the axes, frame by frame."""
        return frame_parity(stars, model)

    def restart(self, stars: Observations, model: CameraModel, fit: Fit) -> StarState | None:
        """A new start for frames most of whose stars were left out.

        With a poor start camera wrong matches may turn a single frame so far away that its good stars look like the
        wrong ones. By the camera that the other frames have given, they no longer do.
        """
        state, weight = fit.state, fit.solution.robust_weight
        total = np.maximum(np.bincount(stars.frame, minlength=stars.frames), 1)
        lost = np.bincount(stars.frame, weight <= 0, minlength=stars.frames) > LOST_PART * total
        if not lost.any():
            return None
        attitudes = start_attitudes(stars, model.with_parameters(state.camera), robust=True)
        return StarState(state.camera, np.where(lost[:, None, None], attitudes, state.pose))


def _matrices(attitude: Rotation) -> FloatArray:
    return np.asarray(attitude.as_matrix()).reshape(-1, 3, 3)


def start_attitudes(stars: Observations, model: CameraModel, *, robust: bool = False) -> FloatArray:
    """Attitudes by Wahba's problem with a start camera, all frames at once."""
    measured = model.unproject(stars.pixel_px, stars.band)
    return rotations_of_groups(measured, stars.direction, stars.frame, stars.frames, robust=robust)


def frame_parity(stars: Observations, model: CameraModel) -> str:
    """Hint on a mirrored sky, judged frame by frame; nothing if there is none."""
    return parity_hint(model.unproject(stars.pixel_px, stars.band), stars.direction, stars.frame, stars.frames)
