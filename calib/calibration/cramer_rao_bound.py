"""Cramer-Rao bound of a calibration: the covariance at the truth, without noise in the data.

For normal errors of known covariance the Fisher information is J^T J of the whitened residuals at the true unknowns;
its inverse bounds the covariance of every unbiased estimator. Unknowns of single frames are eliminated exactly. The
truth is the camera and the numbers of the attitude family (attitudes, installation); the family's gyro or table errors
are zero.

``NoAttitude(weighting="none")`` does not reach the bound of its data by construction; its expected scatter is returned
instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.calibration.attitude_family import AttitudeFamily
from calib.calibration.observations import Observations
from calib.calibration.stages import free_mask
from calib.cameras.base import CameraModel
from calib.fitting.determined import transformed_covariance
from calib.fitting.least_squares import Problem, covariance_of
from optics.arrays import BoolArray, FloatArray
from optics.errors import DomainError
from optics.records import freeze


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """Predicted covariance of a calibration."""

    names: tuple[str, ...]  # Common unknowns, as in ``Calibration.solution.names``
    covariance: FloatArray  # (p, p) Their covariance; infinite on the diagonal for what is not determined
    # (P, P) Covariance of all camera parameters, zero rows for those that are held: what
    # `calib.cameras.line_of_sight` needs
    camera_covariance: FloatArray
    condition: float  # Condition number of the scaled Jacobian, frames eliminated

    def __post_init__(self) -> None:
        freeze(self, "covariance", shape=(len(self.names), len(self.names)), finite=False)
        freeze(self, "camera_covariance", shape=("P", "P"), finite=False, sizes={})

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (p,)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


def bound(
    observations: Observations,
    model: CameraModel,
    attitude_family: AttitudeFamily,
    *,
    free: Sequence[str] | None = None,
) -> Bound:
    """Cramer-Rao bound of `calib.calibration.calibrate.calibrate`; for unweighted interstar angles their covariance.

    Parameters
    ----------
    observations : Observations
        Stars. Measured positions do not enter, except for `NoAttitude`, where they are the true ones, and for what the
        family does not hold and takes from the stars.
    model : CameraModel
        True camera.
    attitude_family : AttitudeFamily
        The family with the true attitudes and installation, true turns of the gyro or the table.
    free : sequence of str, optional
        Camera parameters that are unknown; all by default.

    Returns
    -------
    Bound
        Covariance of the unknowns that all frames share, and of all camera parameters.

    Raises
    ------
    DomainError
        If the truth puts stars behind the camera, or the family's data do not match the frames.
    ConfigError
        On an unknown parameter.
    """
    mask = free_mask(model, free)
    stars = _enough(observations, attitude_family)
    problem = attitude_family.problem(stars, model, mask)
    state = attitude_family.start(stars, model)
    evaluation, covariance, condition = _inverse_information(problem, state)
    _, derivative = problem.reported(state)
    covariance = attitude_family.scatter(problem, evaluation, transformed_covariance(covariance, derivative))
    return _bound(problem.names, covariance, condition, mask)


def _enough(observations: Observations, family: AttitudeFamily) -> Observations:
    """Stars of frames that hold information."""
    family.check(observations)
    count = np.bincount(observations.frame, minlength=observations.frames)
    return observations.select((count >= family.least_stars)[observations.frame])


def _inverse_information(problem: Problem, state: Any) -> tuple[Any, FloatArray, float]:
    """Evaluation at a state, covariance of the steps of the common unknowns, condition number."""
    evaluation = problem.evaluate(state)
    if not np.isfinite(evaluation.residual).all():
        raise DomainError(
            "bound of a calibration: with the given truth, stars lie behind the camera or pixels have no direction"
        )
    reduced = problem.system(evaluation, np.ones(len(evaluation.residual))).reduce()
    covariance, condition, *_ = covariance_of(reduced, problem.names)
    return evaluation, covariance, condition


def _bound(names: tuple[str, ...], covariance: FloatArray, condition: float, mask: BoolArray) -> Bound:
    count = int(mask.sum())
    camera = np.zeros((len(mask), len(mask)))
    camera[np.ix_(mask, mask)] = covariance[:count, :count]
    return Bound(names=names, covariance=covariance, camera_covariance=camera, condition=condition)
