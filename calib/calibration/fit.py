"""What all calibrations have in common: checks before, stages of the fit, judgement after.

Stages. A robust loss with a poor start would throw good stars away, so its scale starts at the typical residual of the
start and comes down as the fit improves; the last fit is at the stated sigma. Two-step calibrations (ACF17, sec. 2.2)
first fit without distortion.

Judgement. A calibration is refused, with its reason, when there are fewer measurements than unknowns, when the typical
residual is far above the stated sigma, when too many stars do not fit, or when the sky is mirrored. The numbers stay in
the record, for whoever wants to see what went wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.attitude.wahba import rotation_svd
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.star_problem import StarState
from calib.cameras.base import CameraModel
from calib.fitting.least_squares import Fit, Problem, solve
from calib.fitting.robust_loss import Loss
from calib.fitting.solution import Solution
from optics.arrays import BoolArray, FloatArray
from optics.errors import DomainError

__all__ = [
    "LARGEST_RMS",
    "LARGEST_WRONG_PART",
    "SAME_SPREAD",
    "WRONG_PULL",
    "Selection",
    "few_left",
    "fit_stages",
    "frames_with",
    "free_stages",
    "mirrored",
    "packed",
    "refused",
    "start_attitudes",
    "too_few_left",
    "typical_pull",
    "verdict",
    "wahba",
]


LARGEST_RMS = 10.0  # typical residual over the stated sigma above which a fit is refused
LARGEST_WRONG_PART = 0.4  # part of the stars beyond WRONG_PULL above which a robust fit is refused
SAME_SPREAD = 1.2  # a typical residual this close to the stated sigma is the stated sigma
WRONG_PULL = 6.0  # length of a star's residual [sigma] beyond which it counts as a wrong match
# median length of a unit normal vector in one dimension (of a pair's angle) and two (of a star's position)
MEDIAN_LENGTH = {1: 0.6744897501960817, 2: float(np.sqrt(2.0 * np.log(2.0)))}


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Stars that a method can use.

    Attributes
    ----------
    observations : Observations
        Those stars, frame numbers as before.
    used : (n,) bool
        Which of all stars they are.
    note : str
        What was left out, for the message; empty if nothing was.
    """

    observations: Observations
    used: BoolArray
    note: str


def frames_with(observations: Observations, model: CameraModel, least: int) -> Selection:
    """Stars of frames that hold at least ``least`` of them.

    Raises
    ------
    DomainError
        If more than 1 % of the stars lie outside the detector: then the list is in another convention.
    """
    size = np.array([model.geometry.width_px, model.geometry.height_px])
    position = observations.pixel_px
    outside = np.any((position < -1.0) | (position > size), axis=1)
    if np.count_nonzero(outside) > 0.01 * len(position):
        raise DomainError(
            f"{np.count_nonzero(outside)} of {len(position)} star positions lie outside the detector of {size[0]} x "
            f"{size[1]} px (columns {position[:, 0].min():.1f} to {position[:, 0].max():.1f}, rows "
            f"{position[:, 1].min():.1f} to {position[:, 1].max():.1f}); (column, row) from the centre of the first "
            "pixel is needed, optics.frames converts other tools' lists"
        )
    count = np.bincount(observations.frame, minlength=observations.frames)
    used = ~outside & (count >= least)[observations.frame]
    few = int(np.count_nonzero((count < least) & (count > 0)))
    notes = []
    if few:
        notes.append(f"{few} frames with fewer than {least} stars tell nothing and were left out")
    if outside.any():
        notes.append(f"{np.count_nonzero(outside)} stars outside the detector were left out")
    return Selection(
        observations=observations.select(used) if not used.all() else observations, used=used, note="; ".join(notes)
    )


def free_stages(model: CameraModel, free: BoolArray, *, two_step: bool) -> list[BoolArray]:
    """Masks of the camera parameters that move, stage by stage: without distortion first, if wanted and possible."""
    ideal = np.array([name in model.pinhole_names for name in model.parameter_names]) & free
    return [ideal, free] if two_step and ideal.any() and not np.array_equal(ideal, free) else [free]


def start_attitudes(
    observations: Observations, model: CameraModel, *, group: NDArray[np.int64] | None = None, robust: bool = False
) -> FloatArray:
    """Attitudes by Wahba's problem with a start camera, all frames at once.

    Parameters
    ----------
    observations : Observations
        Measured stars.
    model : CameraModel
        Start camera.
    group : (n,) int, optional
        What the stars belong to, if not their frame.
    robust : bool
        Least lengths instead of least squares, by reweighting, so that wrong matches do not turn the attitude away.

    Returns
    -------
    (f, 3, 3)
        cam from reference; frames without stars get the identity.
    """
    seen = model.unproject(observations.pixel_px, observations.band)
    return wahba(seen, observations.direction, observations.frame, observations.frames, robust=robust)


def wahba(
    seen: FloatArray, reference: FloatArray, group: NDArray[np.int64], groups: int, *, robust: bool
) -> FloatArray:
    """Rotations (g, 3, 3) with ``seen = R reference`` in groups of directions; identity where a group is empty."""
    good = np.all(np.isfinite(seen), axis=1)
    seen = np.where(good[:, None], seen, 0.0)
    products = (seen[:, :, None] * reference[:, None, :]).reshape(-1, 9)
    weight = good.astype(np.float64)
    rotation = np.broadcast_to(np.eye(3), (groups, 3, 3))
    for _ in range(20 if robust else 1):
        columns = [np.bincount(group, weight * products[:, i], minlength=groups) for i in range(9)]
        profile = np.asarray(np.stack(columns, axis=1).reshape(-1, 3, 3), np.float64)
        empty = ~np.any(profile, axis=(1, 2))
        profile[empty] = np.eye(3)
        rotation = rotation_svd(profile)
        miss = np.linalg.norm(seen - np.einsum("nij,nj->ni", rotation[group], reference), axis=1)
        weight = good / np.maximum(miss, 1e-5)
    return rotation


def fit_stages(
    make: Callable[[BoolArray], Problem], start: Any, stages: Sequence[BoolArray], loss: Loss
) -> tuple[Fit, float]:
    """Fit stage by stage, the last one to the end.

    Returns
    -------
    fit : Fit
        The last fit.
    spread : float
        Typical residual over the stated sigma, at least 1.
    """
    state, steps, scale = start, 0, 1.0
    for stage in stages[:-1]:
        problem = make(stage)
        if loss.redescending:
            state, _, count = _lower_scale(problem, state, loss)
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
    spread = max(1.0, typical_pull(residual)) if np.isfinite(residual).all() else 1.0
    return replace(fit, solution=replace(fit.solution, iterations=fit.solution.iterations + steps)), spread


def typical_pull(residual: FloatArray) -> float:
    """Median length of the residuals over that of a unit normal vector: 1 where the sigma is right.

    Residuals beyond ``WRONG_PULL`` times the value itself do not count, so that a clear minority has no say.
    """
    length = np.sqrt(np.einsum("ni,ni->n", residual, residual))
    value = 1.0
    for _ in range(5):
        if not len(length):
            break
        value = float(np.median(length)) / MEDIAN_LENGTH[residual.shape[1]]
        kept = length[length <= WRONG_PULL * value]
        if len(kept) == len(length):
            break
        length = kept
    return value


def _lower_scale(problem: Problem, state: Any, loss: Loss) -> tuple[Any, float, int]:
    """Lower the scale of a robust loss to the typical residual, as far as the residuals follow."""
    residual = problem.evaluate(state).residual
    scale = typical_pull(residual) if np.all(np.isfinite(residual)) else 1.0
    steps = 0
    for _ in range(30):
        if scale <= 1.0:
            break
        fit = solve(problem, state, loss=loss, scale=scale, tolerance=0.1 * scale, slack=0.01, max_iterations=30)
        state, steps = fit.state, steps + fit.solution.iterations
        now = typical_pull(fit.evaluation.residual)
        if now > 0.9 * scale:
            scale = now
            break
        scale = now
    return state, scale if scale > SAME_SPREAD else 1.0, steps


def verdict(fit: Fit, spread: float, loss: Loss, hint: Callable[[], str]) -> tuple[str, str]:
    """Status and message of a finished fit.

    Parameters
    ----------
    fit : Fit
        The fit.
    spread : float
        Typical residual at which the robust loss settled.
    loss : Loss
        The loss.
    hint : callable
        What could be wrong; asked only when the fit is refused.
    """
    solution = fit.solution
    if solution.status == "refused":
        return solution.status, f"{solution.message}{_also(hint())}"
    free = max(solution.degrees_of_freedom, 1)
    if loss.name == "linear":
        spread = float(np.sqrt(solution.chi2 / free))
    reason, note = _too_far_off(spread) if loss.name == "linear" else _too_many_wrong(solution, spread)
    if reason:
        return "refused", f"{reason}{_also(hint())}"
    if solution.status in ("stalled", "iteration_limit"):
        return solution.status, f"{solution.message}{_also(hint())}"
    if spread > 1.0 + 5.0 / np.sqrt(2.0 * free) and spread > SAME_SPREAD:
        note += f"; residuals are {spread:.2f} times the stated sigma, which the covariance does not include"
    return solution.status, solution.message + note


def _too_far_off(spread: float) -> tuple[str, str]:
    """Reason to refuse a least-squares fit, or nothing; and nothing to note."""
    if not spread > LARGEST_RMS:
        return "", ""
    return (
        f"residuals are {spread:.3g} times the stated sigma, more than {LARGEST_RMS:g}: wrong matches (take the loss "
        '"tukey"), a wrong camera model or too small a sigma'
    ), ""


def _too_many_wrong(solution: Solution, spread: float) -> tuple[str, str]:
    """Reason to refuse a robust fit, or nothing; and what to note if it is not refused."""
    residual = solution.residual_pulls.reshape(-1, 2)
    wrong = np.einsum("ni,ni->n", residual, residual) > (WRONG_PULL * spread) ** 2
    thrown = int(np.count_nonzero(solution.robust_weight == 0))
    reason = ""
    if spread > LARGEST_RMS:
        reason = (
            f"the typical residual is {spread:.3g} times the stated sigma, more than {LARGEST_RMS:g}: about half of "
            "the matches are wrong, or the camera model or the sigma is"
        )
    elif np.mean(wrong) > LARGEST_WRONG_PART:
        percent, limit = 100 * np.mean(wrong), 100 * LARGEST_WRONG_PART
        reason = f"{percent:.0f} % of the stars do not fit, more than {limit:g} %"
    elif too_few_left(solution.degrees_of_freedom, thrown):
        reason = few_left(solution.degrees_of_freedom, thrown)
    return reason, f"; {np.count_nonzero(wrong)} stars do not fit" if wrong.any() else ""


def too_few_left(degrees_of_freedom: int, thrown: int) -> bool:
    """Whether the stars left hardly test themselves: fewer degrees of freedom than measurements thrown away.

    Every wrong star that is found costs two degrees of freedom; without a surplus as large as what was thrown away,
    almost any stars can be made to fit by throwing away the right ones.
    """
    return degrees_of_freedom < 1 or (thrown > 0 and degrees_of_freedom < 2 * thrown)


def few_left(degrees_of_freedom: int, thrown: int) -> str:
    """Message for `too_few_left`."""
    return (
        f"{thrown} stars do not fit, and the rest has only {max(degrees_of_freedom, 0)} degrees of freedom, too few to "
        "tell wrong stars from right ones"
    )


def _also(text: str) -> str:
    return f"; {text}" if text else ""


def mirrored(seen: FloatArray, reference: FloatArray, group: NDArray[np.int64], groups: int) -> str:
    """Hint on parity: whether reflections fit the directions better than rotations do.

    Parameters
    ----------
    seen, reference : (n, 3)
        Directions in cam by a start camera, and in the reference frame.
    group : (n,) int
        Stars that share one rotation; groups of fewer than three stars have no parity.
    groups : int
        Number of groups.

    Returns
    -------
    str
        A line that says so, or nothing.
    """
    good = np.all(np.isfinite(seen), axis=1)
    products = (seen[good][:, :, None] * reference[good][:, None, :]).reshape(-1, 9)
    profile = np.stack([np.bincount(group[good], products[:, i], minlength=groups) for i in range(9)], axis=1)
    u, size, vt = np.linalg.svd(profile.reshape(-1, 3, 3))
    parity = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    enough = np.bincount(group[good], minlength=groups) >= 3
    total = float(np.count_nonzero(good)) - float(np.sum(size[:, :2]))  # loss without the third part
    third = float(np.sum((parity * size[:, 2])[enough]))
    if third < 0 and abs(third) > 0.5 * abs(total - abs(third)):
        return (
            "the sky is mirrored: reflections fit better than rotations; exchange the axes "
            "(row, column) -> (column, row) or turn one of them round"
        )
    return ""


def packed(
    method: str,
    fit: Fit,
    model: CameraModel,
    free: BoolArray,
    *,
    selection: Selection,
    status: str,
    message: str,
    attitude: FloatArray,
    installation: Rotation | None = None,
) -> Calibration:
    """Calibration record of a fit."""
    state = fit.state.camera if isinstance(fit.state, StarState) else fit.state
    camera = model.with_parameters(state)
    covariance = np.zeros((len(free), len(free)))
    count = int(free.sum())
    covariance[np.ix_(free, free)] = fit.solution.covariance[:count, :count]
    used = selection.used.copy()
    weight = fit.solution.robust_weight
    if len(weight) == np.count_nonzero(used):
        used[used] = weight > 0
    if not _upright(camera):
        status, message = "refused", f"the fitted camera is mirrored, the star list must be; {message}"
    notes = [part for part in (message, selection.note, _coverage(selection.observations, model)) if part]
    return Calibration(
        method=method,
        model=camera,
        covariance=covariance,
        solution=replace(fit.solution, status=status, message="; ".join(notes)),
        attitude=Rotation.from_matrix(attitude),
        installation=installation,
        used=used,
    )


def _upright(camera: CameraModel) -> bool:
    """Whether +X and +Y of cam lead to larger columns and rows without a reflection, at the boresight."""
    by_direction = camera.project_jacobian(np.array([[0.0, 0.0, 1.0]])).by_direction[0]
    return bool(np.linalg.det(by_direction[:, :2]) > 0)


def _coverage(observations: Observations, model: CameraModel) -> str:
    """A warning where the stars leave most of the detector empty."""
    size = np.array([model.geometry.width_px, model.geometry.height_px])
    cell = np.clip(np.floor((observations.pixel_px + 0.5) / size * 4.0), 0, 3).astype(np.int64)
    seen = len(np.unique(cell[:, 0] * 4 + cell[:, 1]))
    if seen >= 8:
        return ""
    return f"stars reach only {seen} of 16 parts of the detector, the calibration is extrapolated over the rest"


def refused(
    method: str,
    names: Sequence[str],
    model: CameraModel,
    *,
    message: str,
    selection: Selection,
    unknowns: int,
    attitude: FloatArray,
    installation: Rotation | None = None,
) -> Calibration:
    """Calibration record of a fit that was not begun: the start values, with infinite variances."""
    size = len(names)
    infinite = np.diag(np.full(size, np.inf))
    value = np.full(size, np.nan)
    count = len(selection.observations.pixel_px)
    solution = Solution(
        value=value,
        names=tuple(names),
        covariance=infinite,
        status="refused",
        message=message,
        iterations=0,
        chi2=float("inf"),
        degrees_of_freedom=2 * count - unknowns,
        condition=float("inf"),
        residual_pulls=np.full(2 * count, np.nan),
        robust_weight=np.ones(count),
    )
    return Calibration(
        method=method,
        model=model,
        covariance=np.diag(np.full(len(model.parameters), np.inf)),
        solution=solution,
        attitude=Rotation.from_matrix(attitude),
        installation=installation,
        used=selection.used,
    )
