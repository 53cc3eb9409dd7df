"""Stages of a fit, and the scale of a robust loss.

Two-step calibrations (ACF17, sec. 2.2) first fit without distortion. With poor start values a robust loss would leave
good stars out, so that its scale starts at the typical residual and decreases with the fit; the last fit uses the
stated sigma.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib.calibration.verdict import WRONG_PULL
from calib.cameras.base import CameraModel
from calib.fitting.least_squares import Fit, Problem, solve
from calib.fitting.misfit import SAME_SPREAD
from calib.fitting.robust_loss import Loss
from optics.arrays import BoolArray, FloatArray
from optics.errors import unknown_name

# median length of a unit normal vector in one dimension (of a pair's angle) and two (of a star's position)
MEDIAN_LENGTH = {1: 0.6744897501960817, 2: float(np.sqrt(2.0 * np.log(2.0)))}


def free_mask(model: CameraModel, free: Sequence[str] | None) -> BoolArray:
    """Mask of the free camera parameters (p,)."""
    for name in free or ():
        if name not in model.parameter_names:
            raise unknown_name("camera parameter", name, model.parameter_names)
    return np.array([free is None or name in free for name in model.parameter_names])


def free_names(model: CameraModel, free: BoolArray) -> tuple[str, ...]:
    """Names of the camera parameters that may move."""
    return tuple(name for name, moves in zip(model.parameter_names, free, strict=True) if moves)


def free_stages(model: CameraModel, free: BoolArray, *, two_step: bool) -> list[BoolArray]:
    """Masks of the camera parameters that move, stage by stage: without distortion first, if wanted and possible."""
    ideal = np.array([name in model.pinhole_names for name in model.parameter_names]) & free
    return [ideal, free] if two_step and ideal.any() and not np.array_equal(ideal, free) else [free]


def fit_stages(
    make: Callable[[BoolArray], Problem], start: Any, stages: Sequence[BoolArray], loss: Loss
) -> tuple[Fit, float]:
    """Fit stage by stage, the last one to the end."""
    state, steps, scale = start, 0, 1.0
    for stage in stages[:-1]:
        problem = make(stage)
        if loss.redescending:
            state, _, count = _descended(problem, state, loss)
        else:
            fit = solve(problem, state, loss=loss, tolerance=1.0, slack=0.02, max_iterations=60)
            state, count = fit.state, fit.solution.iterations
        steps += count
    problem = make(stages[-1])
    if loss.redescending:
        state, scale, count = _lower_scale(problem, state, loss)
        steps += count
    fit = solve(problem, state, loss=loss, scale=scale)
    residual = fit.evaluation.residual
    spread = max(1.0, _typical_pull(residual)) if np.isfinite(residual).all() else 1.0
    return replace(fit, solution=replace(fit.solution, iterations=fit.solution.iterations + steps)), spread


def _typical_pull(residual: FloatArray) -> float:
    """Median length of the residuals over that of a unit normal vector, 1 where the sigma is right; residuals beyond
    ``WRONG_PULL`` times the value itself do not count, so that a clear minority has no say."""
    length = np.sqrt(np.einsum("ni,ni->n", residual, residual))
    value = 1.0
    for _ in range(5):
        if not len(length):
            break
        value = float(np.median(length)) / MEDIAN_LENGTH[residual.shape[1]]
        inliers = length[length <= WRONG_PULL * value]
        if len(inliers) == len(length):
            break
        length = inliers
    return value


def _lower_scale(problem: Problem, state: Any, loss: Loss) -> tuple[Any, float, int]:
    """Lower the scale of a robust loss to the typical residual, as far as the residuals follow.

    Wrong stars that are all shifted alike can hold the scale up: a fit between them and the right ones makes all
    residuals large. Where that may be, the descent is tried again from a fit by absolute values (Huber's loss at the
    stated sigma), which sides with the majority, and is kept if it comes lower.
    """
    state, scale, steps = _descended(problem, state, loss)
    if scale <= SAME_SPREAD:
        return state, 1.0, steps
    sided = solve(problem, state, loss="huber", tolerance=0.1, slack=1e-4, max_iterations=60)
    sided_state, lower, more = _descended(problem, sided.state, loss)
    steps += sided.solution.iterations + more
    if lower < 0.9 * scale:
        state, scale = sided_state, lower
    return state, scale if scale > SAME_SPREAD else 1.0, steps


def _descended(problem: Problem, state: Any, loss: Loss) -> tuple[Any, float, int]:
    """State, scale and steps of one descent."""
    residual = problem.evaluate(state).residual
    scale = _typical_pull(residual) if np.all(np.isfinite(residual)) else 1.0
    steps = 0
    for _ in range(30):
        if scale <= 1.0:
            break
        fit = solve(problem, state, loss=loss, scale=scale, tolerance=0.1 * scale, slack=0.01, max_iterations=30)
        state, steps = fit.state, steps + fit.solution.iterations
        now = _typical_pull(fit.evaluation.residual)
        if now > 0.9 * scale:
            scale = now
            break
        scale = now
    return state, scale, steps
