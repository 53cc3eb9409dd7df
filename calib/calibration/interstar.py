"""Calibration from the angles between stars (IAC): no attitude at all.

The angle between two stars of a frame does not depend on the attitude, so that for every pair

    cos(angle from the two pixels, by the camera) = cos(angle in the catalogue)

is an equation in the camera alone (ACF17, sec. 3.2, after its refs. 14-16). Mathematics:
`calib.calibration.interstar_pairs`.

* ``weighting="none"`` is the document's: all equations count the same, least squares. The stated covariance allows for
  the unequal and correlated errors that the method ignores. ``chi2`` is the sum of squares over the typical variance;
  its terms are correlated, so it is no chi-square.
* ``weighting="full"`` weights with the full covariance of all pairs. Nothing of the 2 n - 3 measurements that a frame
  of n stars holds is then lost: it is as good as a free attitude in every frame, and no better.

Choice of pairs. The document does not say which pairs it takes. ``"all"`` takes every pair of a frame;
``"consecutive"`` takes each star with the next one in the list, n pairs per frame. Full weighting always takes all.

Angles are blind to a mirrored sky: the same angles, another camera. The parity is therefore tested at the end, with the
attitudes of the frames, and a mirrored one is refused.

Wrong matches. A wrong star spoils its n - 1 pairs. With a robust loss the pairs are fitted first; a star most of whose
pairs do not fit (lower median over its partners) is left out, and the stars that are left are fitted by plain least
squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.calibration.fit import (
    LARGEST_RMS,
    LARGEST_WRONG_PART,
    SAME_SPREAD,
    WRONG_PULL,
    Selection,
    few_left,
    fit_stages,
    frames_with,
    free_stages,
    mirrored,
    packed,
    refused,
    start_attitudes,
    too_few_left,
)
from calib.calibration.interstar_pairs import (
    PairProblem,
    Pairs,
    StarFrames,
    WeightedPairProblem,
    pair_covariance,
    typical_sigma,
)
from calib.calibration.observations import Observations
from calib.calibration.record import Calibration
from calib.calibration.star_problem import free_mask
from calib.cameras.base import CameraModel
from calib.fitting.least_squares import Fit, solve
from calib.fitting.robust_loss import Loss, get_loss
from optics.arrays import BoolArray
from optics.errors import ConfigError

__all__ = ["calibrate_interstar"]

Weighting = Literal["none", "full"]
METHOD = "interstar"
OUTER_STEPS = 8  # renewals of the weights; two are usual
SAME_WEIGHTS = 1e-3  # sigma: a step this short does not change the weights


@dataclass(frozen=True, slots=True)
class _PairFit:
    """A fit, the stars it used, and the part of the stars that it left out."""

    fit: Fit
    stars: StarFrames
    kept: BoolArray
    spread: float


def calibrate_interstar(
    observations: Observations,
    start_model: CameraModel,
    *,
    weighting: Weighting = "none",
    pairs: Pairs = "all",
    two_step: bool = True,
    loss: str | Loss = "linear",
    free: Sequence[str] | None = None,
) -> Calibration:
    """Calibrate a camera from the angles between the stars of each frame.

    Parameters
    ----------
    observations : Observations
        Measured stars.
    start_model : CameraModel
        Start of the camera; fixed parameters keep their value.
    weighting : {"none", "full"}
        As the document does it, or with the covariance of the pairs.
    pairs : {"all", "consecutive"}
        Pairs of the unweighted fit.
    two_step : bool
        Fit without distortion first, then all.
    loss : str or Loss
        Robust loss to find wrong matches with; "linear" takes all stars as they are.
    free : sequence of str, optional
        Camera parameters to fit; all by default.

    Returns
    -------
    Calibration
        ``solution`` holds the free camera parameters; ``attitude`` is Wahba's for each frame with the camera found.

    Raises
    ------
    DomainError
        If the star list is in another pixel convention, or too long for tables of pairs.
    ConfigError
        On an unknown weighting, choice of pairs, parameter or loss.
    """
    if weighting not in ("none", "full") or pairs not in ("all", "consecutive"):
        raise ConfigError(
            f"interstar angles with weighting {weighting!r}, pairs {pairs!r}; 'none' or 'full', 'all' or 'consecutive'"
        )
    chosen, mask = get_loss(loss), free_mask(start_model, free)
    selection = frames_with(observations, start_model, 2)
    names = tuple(n for n, moves in zip(start_model.parameter_names, mask, strict=True) if moves)
    independent = _independent(selection.observations)
    message = ""
    if independent <= len(names):
        message = f"{independent} independent angles for {len(names)} unknowns; more stars per frame are needed"
    elif not np.isfinite(start_model.unproject(selection.observations.pixel_px, selection.observations.band)).all():
        message = "pixels have no direction by the start camera: its distortion folds the image over"
    if message:
        return refused(
            METHOD,
            names,
            start_model,
            message=message,
            selection=selection,
            unknowns=len(names) + 2 * len(selection.observations) - independent,
            attitude=start_attitudes(observations, start_model),
        )
    found = _fit_pairs(selection.observations, start_model, mask, pairs, two_step, chosen)
    if weighting == "full":
        found = _fit_weighted(found, start_model, mask)
    return _judged(found, observations, selection, start_model, mask)


def _independent(observations: Observations) -> int:
    """Number of independent angles: 2 n - 3 in a frame of n stars."""
    count = np.bincount(observations.frame, minlength=1)
    return int(np.sum(np.maximum(2 * count[count > 0] - 3, 0)))


def _fit_pairs(
    observations: Observations, model: CameraModel, mask: BoolArray, pairs: Pairs, two_step: bool, loss: Loss
) -> _PairFit:
    """Equally weighted pairs; with a robust loss first to find the wrong stars, then without them."""
    stars, kept, spread = StarFrames(observations, pairs), np.ones(len(observations), bool), 1.0
    state, stages, steps = np.array(model.parameters), free_stages(model, mask, two_step=two_step), 0
    if loss.name != "linear":
        sigma = _sigma(stars, model, mask)
        every = StarFrames(observations, "all")
        fit, spread = fit_stages(lambda stage: PairProblem(every, model, stage, sigma), state, stages, loss)
        state, steps, stages = fit.state, fit.solution.iterations, [mask]
        kept = _fitting_stars(every, model.with_parameters(state), mask, WRONG_PULL * spread)
        lonely = np.bincount(observations.frame[kept], minlength=observations.frames) < 2
        kept &= ~lonely[observations.frame]
        if spread > LARGEST_RMS or np.count_nonzero(kept) * 2 <= len(kept):
            return _PairFit(fit, every, kept, spread)
        stars = StarFrames(observations.select(kept), pairs)
    sigma = _sigma(stars, model.with_parameters(state), mask)
    fit, _ = fit_stages(lambda stage: PairProblem(stars, model, stage, sigma), state, stages, get_loss("linear"))
    problem = PairProblem(stars, model, mask, _sigma(stars, model.with_parameters(fit.state), mask))
    evaluation = problem.evaluate(fit.state)
    solution = replace(
        fit.solution,
        covariance=pair_covariance(problem, evaluation, np.ones(len(evaluation.residual))),
        chi2=float(np.sum(evaluation.residual**2)),
        residual_pulls=evaluation.residual.ravel(),
        iterations=fit.solution.iterations + steps,
    )
    return _PairFit(replace(fit, evaluation=evaluation, solution=solution), stars, kept, spread)


def _sigma(stars: StarFrames, model: CameraModel, mask: BoolArray) -> float:
    seen = stars.directions(model, mask)
    return 1.0 if seen is None else typical_sigma(stars, seen)


def _fitting_stars(stars: StarFrames, model: CameraModel, mask: BoolArray, limit: float) -> BoolArray:
    """Stars (m,) at least half of whose pairs fit within ``limit`` sigma."""
    seen = stars.directions(model, mask)
    if seen is None:
        return np.zeros(len(stars.table), bool)
    frames, n, _ = seen.unit.shape
    part = (seen.by_error.reshape(frames, 2 * n, 3) @ seen.unit.swapaxes(1, 2)).reshape(frames, n, 2, n)
    variance = np.einsum("fiaj,fiaj->fij", part, part)
    variance = variance + variance.swapaxes(1, 2)
    size = np.bincount(stars.table, minlength=frames)
    partner = np.arange(n)[None, None, :] < size[:, None, None]
    partner = partner & ~np.eye(n, dtype=bool)
    pull2 = np.where(partner, stars.misclosure(seen.unit) ** 2 / np.where(variance > 0, variance, 1.0), np.inf)
    middle = (size - 2) // 2  # lower median of size - 1 partners
    median = np.take_along_axis(np.sort(pull2, axis=2), np.maximum(middle, 0)[:, None, None], axis=2)[:, :, 0]
    return np.asarray(median[stars.table, stars.rank] <= limit**2)


def _fit_weighted(found: _PairFit, model: CameraModel, mask: BoolArray) -> _PairFit:
    """All pairs with full weights, the weights renewed until they no longer matter."""
    if found.fit.solution.status not in ("converged", "singular"):
        return found
    state, steps = found.fit.state, found.fit.solution.iterations
    last = found.fit
    for outer in range(OUTER_STEPS):
        problem = WeightedPairProblem(found.stars, model.with_parameters(state), mask)
        fit = solve(problem, state, tolerance=1e-4, max_iterations=30)
        moved = (fit.state - state)[mask]
        steps += fit.solution.iterations
        state, last = fit.state, fit
        if outer and float(moved @ fit.system.common @ moved) < SAME_WEIGHTS**2:
            break
    else:
        solution = replace(last.solution, status="iteration_limit", message="the weights do not come to rest")
        last = replace(last, solution=solution)
    return replace(found, fit=replace(last, solution=replace(last.solution, iterations=steps)))


def _judged(
    found: _PairFit, observations: Observations, selection: Selection, model: CameraModel, mask: BoolArray
) -> Calibration:
    """Status, message and record."""
    solution = found.fit.solution
    camera = model.with_parameters(found.fit.state)
    used = selection.used.copy()
    used[selection.used] = found.kept
    fitted = observations.select(used)
    status, message = solution.status, solution.message
    rms = float(np.sqrt(solution.chi2 / max(solution.degrees_of_freedom, 1)))
    wrong = 1.0 - float(np.mean(found.kept))
    surplus = _independent(fitted) - int(mask.sum())
    parity = ""
    if len(fitted):
        seen = camera.unproject(fitted.pixel_px, fitted.band)
        parity = mirrored(seen, fitted.direction, fitted.frame, fitted.frames)
    if found.spread > LARGEST_RMS:
        status = "refused"
        message = (
            f"the typical pair is {found.spread:.3g} times its sigma off, more than {LARGEST_RMS:g}: too many matches "
            "are wrong, or the camera model or the sigma is"
        )
    elif wrong > LARGEST_WRONG_PART:
        status = "refused"
        message = f"{100 * wrong:.0f} % of the stars do not fit, more than {100 * LARGEST_WRONG_PART:g} %"
    elif wrong and too_few_left(surplus, int(np.count_nonzero(~found.kept))):
        status = "refused"
        message = few_left(surplus, int(np.count_nonzero(~found.kept)))
    elif rms > LARGEST_RMS:
        status = "refused"
        message = (
            f"angles are {rms:.3g} times the stated sigma off, more than {LARGEST_RMS:g}: wrong matches (take a robust "
            "loss), a wrong camera model or too small a sigma"
        )
    elif wrong:
        message += f"; {np.count_nonzero(~found.kept)} stars do not fit and were left out"
    if status != "refused" and rms > 1.0 + 5.0 / np.sqrt(2.0 * max(_independent(fitted), 1)) and rms > SAME_SPREAD:
        message += f"; angles are {rms:.2f} times the stated sigma off, which the covariance does not include"
    if parity:
        status, message = "refused", f"{parity}; {message}"
    attitude = start_attitudes(fitted, camera) if len(fitted) else np.tile(np.eye(3), (observations.frames, 1, 1))
    return packed(
        METHOD,
        found.fit,
        model,
        mask,
        selection=replace(selection, observations=fitted, used=used),
        status=status,
        message=message,
        attitude=attitude,
    )
