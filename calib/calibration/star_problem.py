"""Least-squares problem of stars seen by one camera in many attitudes.

The measured position of star j in frame k is that of ``v = R_k r_j`` through the camera. All unknowns of the attitudes
enter through rotations R_k (cam from reference); how R_k depends on them is known to `FrameRotations` (free in every
frame, linked by a gyro, set by a turntable), which only says by which rotation vector w, in cam, R_k turns when an
unknown changes. With ``g`` a row of the camera's derivative by direction,

    g . (w x v) = w . (v x g),

so each star has one row of derivatives by the rotation of its frame, in every family. All that the normal equations
need of the stars are then the Gram matrices of [camera derivatives, rotation derivatives, residual] of each frame, one
batched product; the family's unknowns follow from small products per frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.calibration.observations import Observations
from calib.calibration.stages import free_names
from calib.cameras.base import CameraModel
from calib.fitting.block_arrow import ArrowSystem, GaussNewtonStep
from optics.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """Normal equations of prior knowledge; their frame part is added to the frames' blocks."""

    common: FloatArray  # (a, a) Information on the common unknowns
    gradient: FloatArray  # (a,) Its gradient
    block: FloatArray  # (f, b, b) Information on the frames' unknowns
    block_gradient: FloatArray  # (f, b) Its gradient
    coupling: FloatArray | None = None  # Between neighbouring frames


class FrameRotations(ABC):
    """Attitudes of the frames as functions of the unknowns."""

    __slots__ = ()

    @abstractmethod
    def names(self, stars: Observations) -> tuple[str, ...]:
        """Names of the common unknowns as reported, (a,)."""

    @abstractmethod
    def frame_unknowns(self, stars: Observations) -> int:
        """Number of the unknowns of single frames, all frames together."""

    @property
    @abstractmethod
    def prior_terms(self) -> int:
        """Number of prior residuals."""

    @abstractmethod
    def rotations(self, pose: Any) -> FloatArray:
        """Attitudes (f, 3, 3), cam from reference."""

    @abstractmethod
    def rates(self, pose: Any, rotation: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Rotation vectors in cam per common unknown (f, 3, a), and per unknown of the frame (f, 3, b)."""

    @abstractmethod
    def move(self, pose: Any, common: FloatArray, block: FloatArray | None) -> Any:
        """State after a step."""

    def penalty(self, pose: Any) -> float:
        """Sum of squares of the prior residuals."""
        return 0.0

    def prior(self, pose: Any) -> Prior | None:
        """Normal equations of the prior residuals."""
        return None

    def reported(self, pose: Any) -> tuple[FloatArray, FloatArray]:
        """Common unknowns (a,) as reported, and their derivatives (a, a) by the step."""
        return np.zeros(0), np.zeros((0, 0))


@dataclass(frozen=True, slots=True)
class StarState:
    """Camera parameters (p,), all of them, and the state of the attitudes."""

    camera: FloatArray
    pose: Any


@dataclass(frozen=True, slots=True)
class StarEvaluation:
    """Residuals (n, 2) with what the normal equations need: rows (n, 2, q + 4) of [camera, rotation, residual]."""

    residual: FloatArray
    penalty: float
    state: StarState
    rotation: FloatArray
    rows: FloatArray | None


def whitening(covariance: FloatArray) -> FloatArray:
    """Matrices W (n, 2, 2) with ``W C W^T = I`` for covariances C (n, 2, 2); the inverse Cholesky factor."""
    a = np.sqrt(covariance[:, 0, 0])
    b = covariance[:, 1, 0] / a
    c = np.sqrt(covariance[:, 1, 1] - b**2)
    out = np.zeros_like(covariance)
    out[:, 0, 0], out[:, 1, 1] = 1.0 / a, 1.0 / c
    out[:, 1, 0] = -b / (a * c)
    return out


class StarProblem:
    """Stars through a camera in attitudes that are unknown; a problem of `calib.fitting.least_squares`."""

    def __init__(self, observations: Observations, model: CameraModel, free: BoolArray, family: FrameRotations) -> None:
        self.observations, self.model, self.free, self.family = observations, model, free, family
        self.names = free_names(model, free) + family.names(observations)
        self.unknowns = len(self.names) + family.frame_unknowns(observations)
        self.prior_terms = family.prior_terms
        self._white = whitening(observations.covariance_px2)
        diagonal = bool(np.all(self._white[:, 1, 0] == 0))
        self._inverse_sigma = np.einsum("nii->ni", self._white)[:, :, None] if diagonal else None
        self._all_free = bool(free.all())
        self._band = observations.band if np.any(observations.band) else None
        count = np.bincount(observations.frame, minlength=observations.frames)
        self._layout = _layout(observations.frame, count)

    def evaluate(self, state: StarState) -> StarEvaluation:
        """Whitened residuals, model minus measured, and derivatives."""
        observed = self.observations
        rotation = self.family.rotations(state.pose)
        direction = np.einsum("nij,nj->ni", rotation[observed.frame], observed.direction)
        penalty = self.family.penalty(state.pose)
        if not (np.all(direction[:, 2] > 0) and np.all(np.isfinite(state.camera))):
            return StarEvaluation(np.full((len(direction), 2), np.nan), penalty, state, rotation, None)
        camera = self.model.with_parameters(state.camera)
        projection = camera.project_jacobian(direction, self._band)
        by_parameter = projection.by_parameter if self._all_free else projection.by_parameter[:, :, self.free]
        q = by_parameter.shape[2]
        rows = np.empty((len(direction), 2, q + 4))
        rows[:, :, :q] = by_parameter
        x, y, z = (direction[:, None, i] for i in range(3))
        gx, gy, gz = (projection.by_direction[:, :, i] for i in range(3))
        rows[:, :, q] = y * gz - z * gy
        rows[:, :, q + 1] = z * gx - x * gz
        rows[:, :, q + 2] = x * gy - y * gx
        rows[:, :, q + 3] = projection.pixel_px - observed.pixel_px
        if self._inverse_sigma is not None:
            rows *= self._inverse_sigma
        else:
            rows = self._white @ rows
        return StarEvaluation(np.ascontiguousarray(rows[:, :, -1]), penalty, state, rotation, rows)

    def grams(self, evaluation: StarEvaluation, weight: FloatArray) -> FloatArray:
        """Gram matrices (f, q + 4, q + 4) of the rows of each frame."""
        rows = evaluation.rows
        assert rows is not None
        if not np.all(weight == 1.0):
            rows = rows * np.sqrt(weight)[:, None, None]
        size = rows.shape[2]
        frames = self.observations.frames
        slot, longest = self._layout
        if slot is None:  # frames of very different size: padding would waste memory
            products = np.einsum("nia,nib->nab", rows, rows).reshape(len(rows), -1)
            out = np.zeros((frames, size * size))
            np.add.at(out, self.observations.frame, products)
            return out.reshape(frames, size, size)
        padded = np.zeros((frames * longest, 2, size))
        padded[slot] = rows
        padded = padded.reshape(frames, 2 * longest, size)
        return np.asarray(padded.swapaxes(1, 2) @ padded)

    def system(self, evaluation: StarEvaluation, weight: FloatArray) -> ArrowSystem:
        """Normal equations with weights (n,)."""
        gram = self.grams(evaluation, weight)
        q = gram.shape[1] - 4
        to_common, to_block = self.family.rates(evaluation.state.pose, evaluation.rotation)
        prior = self.family.prior(evaluation.state.pose)
        turn = gram[:, q : q + 3, q : q + 3]
        across = gram[:, :q, q : q + 3]
        a = to_common.shape[2]
        common = np.empty((q + a, q + a))
        gradient = np.empty(q + a)
        common[:q, :q] = gram[:, :q, :q].sum(axis=0)
        gradient[:q] = gram[:, :q, -1].sum(axis=0)
        by_rotation = turn @ to_common
        if a:
            flat = to_common.reshape(-1, a)
            common[:q, q:] = np.tensordot(across, to_common, axes=([0, 2], [0, 1]))
            common[q:, :q] = common[:q, q:].T
            common[q:, q:] = flat.T @ by_rotation.reshape(-1, a)
            gradient[q:] = flat.T @ gram[:, q : q + 3, -1].ravel()
            if prior is not None:
                common[q:, q:] += prior.common
                gradient[q:] += prior.gradient
        if to_block is None:
            return ArrowSystem(common=common, gradient=gradient)
        border = np.concatenate([across @ to_block, by_rotation.swapaxes(1, 2) @ to_block], axis=1)
        block = to_block.swapaxes(1, 2) @ turn @ to_block
        block_gradient = np.einsum("fib,fi->fb", to_block, gram[:, q : q + 3, -1])
        if prior is not None:
            block = block + prior.block
            block_gradient = block_gradient + prior.block_gradient
        return ArrowSystem(
            common=common,
            gradient=gradient,
            border=border,
            block=block,
            block_gradient=block_gradient,
            coupling=None if prior is None else prior.coupling,
        )

    def move(self, state: StarState, step: GaussNewtonStep) -> StarState:
        """State after a step."""
        q = int(self.free.sum())
        camera = state.camera.copy()
        camera[self.free] += step.common[:q]
        return StarState(camera, self.family.move(state.pose, step.common[q:], step.block))

    def reported(self, state: StarState) -> tuple[FloatArray, FloatArray]:
        """Free camera parameters and the common unknowns."""
        value, derivative = self.family.reported(state.pose)
        q = int(self.free.sum())
        full = np.eye(q + len(value))
        full[q:, q:] = derivative
        return np.concatenate([state.camera[self.free], value]), full


def _layout(frame: IntArray, count: IntArray) -> tuple[IntArray | None, int]:
    """Row of each star in a table of frames padded to the longest, or None where that would be wasteful."""
    longest = int(count.max(initial=0))
    if longest * len(count) > 4 * len(frame) + 1000:
        return None, longest
    return frame * longest + rank_in_frame(frame, count), longest


def rank_in_frame(frame: IntArray, count: IntArray) -> IntArray:
    """Number (n,) of each star among those of its frame, frames having ``count`` (f,) of them."""
    order = np.argsort(frame, kind="stable")
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    rank = np.empty(len(frame), dtype=np.int64)
    rank[order] = np.arange(len(frame)) - first[frame[order]]
    return rank
