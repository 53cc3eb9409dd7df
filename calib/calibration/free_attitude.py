"""Calibration with a free attitude in every frame: bundle adjustment with rotations alone.

    minimise  sum over frames k, stars j of |W_kj (project(camera, R_k r_j) - measured_kj)|^2

over the camera and one rotation R_k per frame, eliminated frame by frame (`calib.fitting.arrow`). Nothing is assumed
about how the camera moves. A frame of n stars gives 2 n - 3 measurements of the camera; a frame with a single star
gives none and is left out (its attitude in the result is one of the many that fit).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.link import exponential
from calib.calibration.fit import (
    Selection,
    fit_stages,
    frames_with,
    free_stages,
    mirrored,
    packed,
    refused,
    start_attitudes,
    verdict,
)
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.star_problem import Prior, StarProblem, StarState, free_mask
from calib.cameras.base import CameraModel
from calib.fitting.robust_loss import Loss, get_loss
from optics.arrays import FloatArray
from optics.errors import DomainError

__all__ = ["FreeAttitudes", "calibrate_free_attitude"]

METHOD = "free_attitude"
LOST_PART = 0.5  # of a frame's stars without weight, above which its attitude is looked for again


@dataclass(frozen=True, slots=True)
class FreeAttitudes:
    """Pose family of free rotations; the state is the array (f, 3, 3) of attitudes.

    Parameters
    ----------
    seen : (f,) bool
        Frames that hold stars.
    """

    seen: NDArray[np.bool_]

    @property
    def names(self) -> tuple[str, ...]:
        """No common unknowns."""
        return ()

    @property
    def block_size(self) -> int:
        """A rotation vector."""
        return 3

    @property
    def block_unknowns(self) -> int:
        """Three for every frame with stars."""
        return 3 * int(self.seen.sum())

    @property
    def prior_terms(self) -> int:
        """None."""
        return 0

    def rotations(self, state: FloatArray) -> FloatArray:
        """The state itself."""
        return state

    def rates(self, state: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """A frame turns by its own rotation vector."""
        frames = len(rotation)
        return np.zeros((frames, 3, 0)), np.broadcast_to(np.eye(3), (frames, 3, 3))

    def move(self, state: FloatArray, common: FloatArray, block: FloatArray | None) -> FloatArray:
        """Turn every frame."""
        assert block is not None
        return exponential(block) @ state

    def penalty(self, state: FloatArray) -> float:
        """Nothing is known before."""
        return 0.0

    def prior(self, state: FloatArray) -> Prior | None:
        """Nothing is known before."""
        return None

    def reported(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """No common unknowns."""
        return np.zeros(0), np.zeros((0, 0))


def calibrate_free_attitude(
    observations: Observations,
    start_model: CameraModel,
    *,
    start_attitude: Rotation | None = None,
    two_step: bool = True,
    loss: str | Loss = "linear",
    free: Sequence[str] | None = None,
) -> Calibration:
    """Calibrate a camera from identified stars, with a free attitude in every frame.

    Parameters
    ----------
    observations : Observations
        Measured stars.
    start_model : CameraModel
        Start of the camera; fixed parameters keep their value.
    start_attitude : Rotation, optional
        f attitudes, cam from reference; by default Wahba's problem with the start camera.
    two_step : bool
        Fit without distortion first, then all.
    loss : str or Loss
        Robust loss; "tukey" survives wrong matches.
    free : sequence of str, optional
        Camera parameters to fit; all by default.

    Returns
    -------
    Calibration
        ``solution`` holds the free camera parameters, its covariance is what is left when the attitudes are unknown.

    Raises
    ------
    DomainError
        If the star list is in another pixel convention, or the number of start attitudes is wrong.
    ConfigError
        On an unknown parameter or loss.
    """
    chosen, mask = get_loss(loss), free_mask(start_model, free)
    selection = frames_with(observations, start_model, 2)
    stars = selection.observations
    if start_attitude is None:
        attitude = start_attitudes(observations, start_model, robust=chosen.name != "linear")
    else:
        attitude = np.atleast_3d(start_attitude.as_matrix()).reshape(-1, 3, 3)
        if len(attitude) != observations.frames:
            raise DomainError(
                f"{len(attitude)} start attitudes for {observations.frames} frames; one for each is needed"
            )
    family = FreeAttitudes(np.bincount(stars.frame, minlength=stars.frames) > 0)
    names = tuple(n for n, moves in zip(start_model.parameter_names, mask, strict=True) if moves)
    unknowns = len(names) + family.block_unknowns
    if 2 * len(stars.frame) <= unknowns:
        return refused(
            METHOD,
            names,
            start_model,
            message=_too_few(len(stars.frame), unknowns, selection),
            selection=selection,
            unknowns=unknowns,
            attitude=attitude,
        )
    stages = free_stages(start_model, mask, two_step=two_step)
    fit, spread = fit_stages(
        lambda stage: StarProblem(stars, start_model, stage, family),
        StarState(np.array(start_model.parameters), attitude),
        stages,
        chosen,
    )
    if chosen.redescending:
        again = _lost_frames_found(stars, start_model, fit.state, fit.solution.robust_weight)
        if again is not None:
            fit, spread = fit_stages(
                lambda stage: StarProblem(stars, start_model, stage, family), again, stages[-1:], chosen
            )

    def hint() -> str:
        seen = start_model.unproject(stars.pixel_px, stars.band)
        return mirrored(seen, stars.direction, stars.frame, stars.frames)

    status, message = verdict(fit, spread, chosen, hint)
    attitude = np.where(family.seen[:, None, None], fit.state.pose, attitude)
    return packed(
        METHOD, fit, start_model, mask, selection=selection, status=status, message=message, attitude=attitude
    )


def _lost_frames_found(
    stars: Observations, model: CameraModel, state: StarState, weight: FloatArray
) -> StarState | None:
    """A new start for frames most of whose stars were thrown away; None if there is none.

    With a poor start camera wrong matches may turn a single frame so far away that its good stars look like the wrong
    ones. By the camera that the other frames have given, they no longer do.
    """
    total = np.maximum(np.bincount(stars.frame, minlength=stars.frames), 1)
    lost = np.bincount(stars.frame, weight <= 0, minlength=stars.frames) > LOST_PART * total
    if not lost.any():
        return None
    found = start_attitudes(stars, model.with_parameters(state.camera), robust=True)
    return StarState(state.camera, np.where(lost[:, None, None], found, state.pose))


def _too_few(stars: int, unknowns: int, selection: Selection) -> str:
    note = f"; {selection.note}" if selection.note else ""
    return (
        f"{stars} usable stars give {2 * stars} measurements for {unknowns} unknowns; more per frame are needed{note}"
    )
