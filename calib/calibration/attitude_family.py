"""Attitude families: the interface of assumptions on the attitudes of a calibration, and the base class of most of
them.

`calibrate` fits one camera to many frames. Assumptions on their attitudes are a record, an attitude family, with its
unknowns, their start values, residuals in addition to the stars' residuals, and the structure of the normal equations:

======================  ==============================================
`FreeAttitudes`         a rotation of its own in every frame
`AttitudeCorrelated`    frames linked by a perfect gyro (ACC of ACF17)
`GyroLinked`            frames linked by a gyro of stated noise
`NoAttitude`            angles between stars alone (IAC of ACF17)
`TurntableAttitudes`    a turntable in front of a collimated target
======================  ==============================================

A new family is one file: a record derived from `RotationFamily` with `start_pose`, `rotations`, `rates` and `move`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.observations import Observations
from calib.calibration.stages import fit_stages, free_stages
from calib.calibration.star_problem import FrameRotations, StarProblem, StarState
from calib.calibration.verdict import WRONG_PULL, verdict
from calib.cameras.base import CameraModel
from calib.fitting.least_squares import Fit, Problem
from calib.fitting.robust_loss import Loss
from calib.fitting.solution import Solution
from optics.arrays import BoolArray, FloatArray
from optics.errors import DomainError


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyFit:
    """Result of the fit of a family of attitudes."""

    state: Any  # State of its problem
    solution: Solution  # Values, covariance, status and message
    kept: BoolArray  # (n,) Stars that took part


class AttitudeFamily(ABC):
    """Assumption of a calibration about the attitudes."""

    __slots__ = ()
    method: ClassVar[str]
    """Name of the estimator, in `Calibration.method`."""
    least_stars: ClassVar[int] = 1
    """Stars from which a frame holds information."""

    per_frame: ClassVar[str] = "attitudes"
    """Fields of the record with one entry per frame."""

    @property
    def frames(self) -> int | None:
        """Number of frames that the record belongs to, None for any."""
        return None

    def check(self, observations: Observations) -> None:
        """Refuse observations of another number of frames."""
        if self.frames is not None and self.frames != observations.frames:
            raise DomainError(
                f"{self.frames} {self.per_frame} for {observations.frames} frames; one for each is needed"
            )

    def obstacle(self, stars: Observations, model: CameraModel) -> str:
        """What keeps the fit from beginning at a start camera, or nothing."""
        return ""

    def names(self, stars: Observations) -> tuple[str, ...]:
        """Names of the common unknowns other than the camera's, as reported (a,)."""
        return ()

    def frame_unknowns(self, stars: Observations) -> int:
        """Number of the unknowns of single frames, all frames together."""
        return 0

    @property
    def prior_terms(self) -> int:
        """Number of residuals in addition to the stars' residuals."""
        return 0

    def independent(self, stars: Observations) -> int:
        """Measurements left for the camera and the common unknowns: 2 per star and the prior, less the frames'."""
        return 2 * len(stars) + self.prior_terms - self.frame_unknowns(stars)

    def scatter(self, problem: Problem, evaluation: Any, covariance: FloatArray) -> FloatArray:
        """Covariance of the estimate, given the inverse information: the same, for a fit with the right weights."""
        return covariance

    @abstractmethod
    def start(self, stars: Observations, model: CameraModel, *, robust: bool = False) -> Any:
        """Start state of a fit; values of the record are unchanged, the rest comes from the stars."""

    @abstractmethod
    def problem(self, stars: Observations, model: CameraModel, free: BoolArray) -> Problem:
        """Least-squares problem of the stars with the free camera parameters (p,)."""

    @abstractmethod
    def fit(
        self, stars: Observations, model: CameraModel, free: BoolArray, start: Any, *, two_step: bool, loss: Loss
    ) -> FamilyFit:
        """Fit and judge."""

    @abstractmethod
    def attitudes(self, state: Any, stars: Observations, camera: CameraModel) -> tuple[FloatArray, Rotation | None]:
        """Attitudes (f, 3, 3), cam from reference, and the installation if the family knows one."""


class RotationFamily(AttitudeFamily, FrameRotations):
    """A family whose attitudes are unknowns or follow from unknowns: stars, pixel against pixel."""

    __slots__ = ()

    @abstractmethod
    def start_pose(self, stars: Observations, model: CameraModel, *, robust: bool) -> Any:
        """State of the attitudes where a fit begins."""

    @abstractmethod
    def parity(self, stars: Observations, model: CameraModel) -> str:
        """Hint on a mirrored sky, or nothing."""

    def installation_of(self, pose: Any) -> Rotation | None:
        """Installation of the camera, if the family knows one."""
        return None

    def restart(self, stars: Observations, model: CameraModel, fit: Fit) -> StarState | None:
        """A better start that the result of a robust fit shows, or None."""
        return None

    def objection(self, start: Any, pose: Any) -> str:
        """What speaks against the attitudes that were found, or nothing."""
        return ""

    def start(self, stars: Observations, model: CameraModel, *, robust: bool = False) -> StarState:
        """The start camera and the start of the attitudes."""
        return StarState(np.array(model.parameters), self.start_pose(stars, model, robust=robust))

    def problem(self, stars: Observations, model: CameraModel, free: BoolArray) -> StarProblem:
        """Stars through the camera, in these attitudes."""
        return StarProblem(stars, model, free, self)

    def fit(
        self, stars: Observations, model: CameraModel, free: BoolArray, start: Any, *, two_step: bool, loss: Loss
    ) -> FamilyFit:
        """Stages, robust scale, and the judgement of the residuals."""
        stages = free_stages(model, free, two_step=two_step)

        def make(stage: BoolArray) -> StarProblem:
            return self.problem(stars, model, stage)

        fit, spread = fit_stages(make, start, stages, loss)
        if loss.redescending:
            better_start = self.restart(stars, model, fit)
            if better_start is not None:
                fit, spread = fit_stages(make, better_start, stages[-1:], loss)
        solution, wrong = fit.solution, None
        kept = solution.robust_weight > 0
        if loss.name == "linear":
            spread = float(np.sqrt(solution.chi2 / max(solution.degrees_of_freedom, 1)))
        else:
            length2 = np.sum(solution.residual_pulls.reshape(-1, 2) ** 2, axis=1)
            wrong = length2 > (WRONG_PULL * spread) ** 2
            good = ~wrong & kept  # the stars that fit tell whether the noise was stated rightly
            lost = 2 * int(np.count_nonzero(kept & wrong))
            solution = replace(
                solution,
                chi2=float(np.sum(length2[good]) + fit.evaluation.penalty),
                degrees_of_freedom=solution.degrees_of_freedom - lost,
            )
        status, message = verdict(
            solution,
            lambda: self.parity(stars, model),
            spread=spread,
            degrees_of_freedom=solution.degrees_of_freedom,
            wrong=wrong,
            left_out=int(np.count_nonzero(~kept)),
        )
        objection = "" if status == "refused" else self.objection(start.pose, fit.state.pose)
        if objection:
            status, message = "refused", objection
        return FamilyFit(state=fit.state, solution=replace(solution, status=status, message=message), kept=kept)

    def attitudes(self, state: Any, stars: Observations, camera: CameraModel) -> tuple[FloatArray, Rotation | None]:
        """Attitudes of the state."""
        return self.rotations(state.pose), self.installation_of(state.pose)


def frames_with_stars(stars: Observations) -> int:
    """Number of frames that hold stars."""
    return int(np.count_nonzero(np.bincount(stars.frame, minlength=stars.frames)))
