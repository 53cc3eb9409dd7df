"""Cramer-Rao bounds of the calibrations: the covariance at the truth, without noise in the data.

For normal errors of known covariance the Fisher information is J^T J of the whitened residuals at the true unknowns;
its inverse bounds the covariance of every unbiased estimator. Frames' own unknowns are eliminated exactly. The bounds
need the stars' directions and frames, the noise, and the truth; measured positions do not enter (those of
`bound_interstar` should be the true ones).

Two of the methods do not reach the bound of what they are given, by construction. What they should scatter by is also
here: `predicted_attitude_correlated` for a gyro taken as perfect that is not, and ``weighting="none"`` of
`bound_interstar`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from calib.calibration.attitude_correlated import GyroLink, LinkState
from calib.calibration.free_attitude import FreeAttitudes
from calib.calibration.gyro_linked import GyroNoise, GyroWalk, WalkState, checked_times
from calib.calibration.interstar import Weighting
from calib.calibration.interstar_pairs import (
    PairProblem,
    Pairs,
    StarFrames,
    WeightedPairProblem,
    pair_covariance,
    typical_sigma,
)
from calib.calibration.observations import Observations
from calib.calibration.star_problem import StarProblem, StarState, free_mask
from calib.calibration.turntable import TableErrors, TableLink, TableState
from calib.cameras.base import CameraModel
from calib.fitting.least_squares import Problem, covariance_of, transformed_covariance
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze

__all__ = [
    "Bound",
    "bound_attitude_correlated",
    "bound_free_attitude",
    "bound_gyro_linked",
    "bound_interstar",
    "bound_turntable",
    "predicted_attitude_correlated",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """Predicted covariance of a calibration.

    Attributes
    ----------
    names : tuple of str
        Common unknowns, as in ``Calibration.solution.names``.
    covariance : (p, p)
        Their covariance; infinite on the diagonal for what is not determined.
    camera_covariance : (P, P)
        Covariance of all camera parameters, zero rows for fixed ones: what `calib.cameras.line_of_sight` needs.
    condition : float
        Condition number of the scaled Jacobian, frames eliminated.
    """

    names: tuple[str, ...]
    covariance: FloatArray
    camera_covariance: FloatArray
    condition: float

    def __post_init__(self) -> None:
        freeze(self, "covariance", shape=(len(self.names), len(self.names)), finite=False)
        freeze(self, "camera_covariance", shape=("P", "P"), finite=False, sizes={})

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (p,)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


def bound_free_attitude(
    observations: Observations, model: CameraModel, attitude: Rotation, *, free: Sequence[str] | None = None
) -> Bound:
    """Bound with a free attitude in every frame.

    Parameters
    ----------
    observations : Observations
        Stars; positions do not enter.
    model : CameraModel
        True camera.
    attitude : Rotation
        f true attitudes, cam from reference.
    free : sequence of str, optional
        Camera parameters that are unknown; all by default.
    """
    mask = free_mask(model, free)
    count = np.bincount(observations.frame, minlength=observations.frames)
    stars = observations.select((count >= 2)[observations.frame])
    problem = StarProblem(stars, model, mask, FreeAttitudes(count >= 2))
    return _bound(problem, StarState(np.array(model.parameters), attitude.as_matrix().reshape(-1, 3, 3)), mask)


def bound_attitude_correlated(
    observations: Observations,
    gyro_rotation: Rotation,
    model: CameraModel,
    attitude: Rotation,
    installation: Rotation,
    *,
    free: Sequence[str] | None = None,
) -> Bound:
    """Bound of ACC with a perfect gyro.

    Parameters
    ----------
    observations : Observations
        Stars; positions do not enter.
    gyro_rotation : Rotation
        f true turns of the gyro body from the first frame.
    model : CameraModel
        True camera.
    attitude : Rotation
        True attitude of the first frame, cam from reference.
    installation : Rotation
        True installation, cam from gyro body.
    free : sequence of str, optional
        Camera parameters that are unknown; all by default.
    """
    mask = free_mask(model, free)
    problem = StarProblem(observations, model, mask, GyroLink(_matrices(gyro_rotation)))
    return _bound(problem, _link_state(model, attitude, installation), mask)


def bound_gyro_linked(
    observations: Observations,
    gyro_rotation: Rotation,
    model: CameraModel,
    attitude: Rotation,
    installation: Rotation,
    *,
    time_s: ArrayLike,
    noise: GyroNoise,
    free: Sequence[str] | None = None,
) -> Bound:
    """Bound with a gyro of known noise (`calib.calibration.gyro_linked`); else as `bound_attitude_correlated`."""
    problem, state, _, mask = _walk_problem(
        observations, gyro_rotation, model, attitude, installation, time_s, noise, free
    )
    return _bound(problem, state, mask)


def predicted_attitude_correlated(
    observations: Observations,
    gyro_rotation: Rotation,
    model: CameraModel,
    attitude: Rotation,
    installation: Rotation,
    *,
    time_s: ArrayLike,
    noise: GyroNoise,
    free: Sequence[str] | None = None,
) -> Bound:
    """Covariance of ACC, which takes the gyro as perfect, when it has noise and bias.

    The estimate is linear in the errors e of stars and z of the gyro: H^-1 (J^T e + B z), so that its covariance is
    H^-1 + H^-1 B P B^T H^-1, with the walk P_kl = N^2 min(t_k, t_l) + sigma_b^2 L_k L_l^T. A bias counts with its prior
    sigma: for a gyro with one fixed bias that is the mean over its directions.
    """
    problem, state, family, mask = _walk_problem(
        observations, gyro_rotation, model, attitude, installation, time_s, noise, free
    )
    bare = StarProblem(observations, model, mask, GyroLink(_matrices(gyro_rotation)))
    bare_state = StarState(state.camera, state.pose.link)
    evaluation = bare.evaluate(bare_state)
    ones = np.ones(len(evaluation.residual))
    inverse, condition, _ = covariance_of(bare.system(evaluation, ones).reduce(), bare.names)
    border = problem.system(problem.evaluate(state), ones).border
    assert border is not None
    size = len(bare.names)
    elapsed = np.asarray(time_s, dtype=np.float64) - np.min(time_s)
    walk = noise.angle_random_walk_rad_per_sqrt_s**2 * np.minimum.outer(elapsed, elapsed)
    lever = family.lever.reshape(-1, 3)
    gyro = np.kron(walk, np.eye(3)) + noise.bias_sigma_rad_per_s**2 * lever @ lever.T
    gain = _finite(inverse) @ border[:, :size].transpose(1, 0, 2).reshape(size, -1)
    _, derivative = bare.reported(bare_state)
    return _packed(bare.names, transformed_covariance(inverse + gain @ gyro @ gain.T, derivative), condition, mask)


def bound_interstar(
    observations: Observations,
    model: CameraModel,
    *,
    weighting: Weighting = "full",
    pairs: Pairs = "all",
    free: Sequence[str] | None = None,
) -> Bound:
    """Bound of interstar angles with full weights, or the covariance of the unweighted ones.

    Parameters
    ----------
    observations : Observations
        Stars at their true positions.
    model : CameraModel
        True camera.
    weighting, pairs
        As in `calib.calibration.interstar.calibrate_interstar`.
    free : sequence of str, optional
        Camera parameters that are unknown; all by default.
    """
    mask = free_mask(model, free)
    count = np.bincount(observations.frame, minlength=observations.frames)
    stars = StarFrames(observations.select((count >= 2)[observations.frame]), pairs)
    state = np.array(model.parameters)
    if weighting == "full":
        return _bound(WeightedPairProblem(stars, model, mask), state, mask)
    seen = stars.directions(model, mask)
    if seen is None:
        raise DomainError("bound of interstar angles: a pixel has no direction by this camera")
    problem = PairProblem(stars, model, mask, typical_sigma(stars, seen))
    evaluation = problem.evaluate(state)
    plain = _bound(problem, state, mask)
    covariance = pair_covariance(problem, evaluation, np.ones(len(evaluation.residual)))
    return _packed(plain.names, covariance, plain.condition, mask)


def bound_turntable(
    observations: Observations,
    table_rotation: Rotation,
    model: CameraModel,
    installation: Rotation,
    *,
    errors: TableErrors | None = None,
    free: Sequence[str] | None = None,
) -> Bound:
    """Bound of the joint calibration on a turntable.

    Parameters
    ----------
    observations : Observations
        Positions of the table; ``direction`` is the *true* direction of the star in the laboratory.
    table_rotation : Rotation
        f true attitudes of the table top, laboratory from table.
    model : CameraModel
        True camera.
    installation : Rotation
        True installation, cam from table.
    errors : TableErrors, optional
        Unknown errors of the table, zero in truth.
    free : sequence of str, optional
        Camera parameters that are unknown; all by default.
    """
    mask = free_mask(model, free)
    nominal = observations.direction[0]
    single = bool(np.all(np.abs(observations.direction - nominal) < 1e-9))
    family = TableLink(
        _matrices(table_rotation), nominal if single else None, (errors or TableErrors()).checked(observations.frames)
    )
    state: TableState = family.start(installation.as_matrix())
    problem = StarProblem(observations, model, mask, family)
    return _bound(problem, StarState(np.array(model.parameters), state), mask)


def _matrices(rotation: Rotation) -> FloatArray:
    return np.asarray(rotation.as_matrix()).reshape(-1, 3, 3)


def _link_state(model: CameraModel, attitude: Rotation, installation: Rotation) -> StarState:
    pose = LinkState(_matrices(attitude)[0], _matrices(installation)[0])
    return StarState(np.array(model.parameters), pose)


def _walk_problem(
    observations: Observations,
    gyro_rotation: Rotation,
    model: CameraModel,
    attitude: Rotation,
    installation: Rotation,
    time_s: ArrayLike,
    noise: GyroNoise,
    free: Sequence[str] | None,
) -> tuple[StarProblem, StarState, GyroWalk, NDArray[np.bool_]]:
    mask = free_mask(model, free)
    turn = _matrices(gyro_rotation)
    family = GyroWalk(turn, checked_times(time_s, turn, observations.frames), noise)
    link = _link_state(model, attitude, installation)
    pose: WalkState = family.start(link.pose)
    return StarProblem(observations, model, mask, family), StarState(link.camera, pose), family, mask


def _finite(covariance: FloatArray) -> FloatArray:
    return np.where(np.isfinite(covariance), covariance, 0.0)


def _bound(problem: Problem, state: Any, mask: NDArray[np.bool_]) -> Bound:
    evaluation = problem.evaluate(state)
    if not np.isfinite(evaluation.residual).all():
        raise DomainError("bound of a calibration: the truth puts stars behind the camera")
    reduced = problem.system(evaluation, np.ones(len(evaluation.residual))).reduce()
    covariance, condition, _ = covariance_of(reduced, problem.names)
    _, derivative = problem.reported(state)
    return _packed(problem.names, transformed_covariance(covariance, derivative), condition, mask)


def _packed(names: tuple[str, ...], covariance: FloatArray, condition: float, mask: NDArray[np.bool_]) -> Bound:
    count = int(mask.sum())
    camera = np.zeros((len(mask), len(mask)))
    camera[np.ix_(mask, mask)] = covariance[:count, :count]
    return Bound(names=names, covariance=covariance, camera_covariance=camera, condition=condition)
