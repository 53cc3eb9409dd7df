"""No attitude: calibration from the angles between stars (IAC).

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

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.attitude_family import AttitudeFamily, Outcome, frames_with_stars
from calib.calibration.free_attitudes import frame_parity, start_attitudes
from calib.calibration.interstar_pairs import (
    PairProblem,
    Pairs,
    StarFrames,
    WeightedPairProblem,
    pair_covariance,
)
from calib.calibration.observations import Observations
from calib.calibration.stages import fit_stages, free_stages
from calib.calibration.verdict import LARGEST_RMS, WRONG_PULL, verdict
from calib.cameras.base import CameraModel
from calib.fitting.least_squares import Fit, Problem, solve
from calib.fitting.robust_loss import Loss, get_loss
from optics.arrays import BoolArray, FloatArray
from optics.errors import ConfigError

__all__ = ["NoAttitude"]

OUTER_STEPS = 8  # renewals of the weights; two are usual
SAME_WEIGHTS = 1e-3  # sigma: a step this short does not change the weights


@dataclass(frozen=True, slots=True)
class _PairFit:
    """A fit, the stars it used, which of all they are, and the typical pair of the robust fit over its sigma."""

    fit: Fit
    stars: StarFrames
    kept: BoolArray
    spread: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NoAttitude(AttitudeFamily):
    """Angles between the stars of each frame.

    Attributes
    ----------
    weighting : {"none", "full"}
        As the document does it, or with the covariance of the pairs.
    pairs : {"all", "consecutive"}
        Pairs of the unweighted fit.

    Raises
    ------
    ConfigError
        On an unknown weighting or choice of pairs.
    """

    weighting: Literal["none", "full"] = "none"
    pairs: Pairs = "all"

    method: ClassVar[str] = "interstar"
    least_stars: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if self.weighting not in ("none", "full") or self.pairs not in ("all", "consecutive"):
            raise ConfigError(
                f"NoAttitude: weighting {self.weighting!r}, pairs {self.pairs!r}; 'none' or 'full', 'all' or "
                "'consecutive'"
            )

    def frame_unknowns(self, stars: Observations) -> int:
        """Three turns per frame, which no angle shows."""
        return 3 * frames_with_stars(stars)

    def obstacle(self, stars: Observations, model: CameraModel) -> str:
        """A start camera that is not invertible at some pixel."""
        if np.isfinite(model.unproject(stars.pixel_px, stars.band)).all():
            return ""
        return "pixels have no direction by the start camera: its distortion folds the image over"

    def start(self, stars: Observations, model: CameraModel, *, robust: bool = False) -> FloatArray:
        """Camera parameters (p,)."""
        return np.array(model.parameters)

    def problem(self, stars: Observations, model: CameraModel, free: BoolArray) -> Problem:
        """Pairs with the weights at this camera."""
        if self.weighting == "full":
            return WeightedPairProblem(StarFrames(stars, self.pairs), model, free)
        return PairProblem.at(StarFrames(stars, self.pairs), model, free)

    def scatter(self, problem: Problem, evaluation: Any, covariance: FloatArray) -> FloatArray:
        """Without weights larger than the inverse information, since pairs are correlated."""
        if not isinstance(problem, PairProblem):
            return covariance
        return pair_covariance(problem, evaluation, np.ones(len(evaluation.residual)))

    def fit(
        self, stars: Observations, model: CameraModel, free: BoolArray, start: Any, *, two_step: bool, loss: Loss
    ) -> Outcome:
        """Pairs with equal weights, then with full ones if wanted; the judgement of the residuals and of the parity."""
        found = self._fit_pairs(stars, model, free, two_step, loss)
        if self.weighting == "full":
            found = _fit_weighted(found, model, free)
        solution, fitted = found.fit.solution, stars.select(found.kept)
        spread = found.spread
        if not spread > LARGEST_RMS:
            spread = float(np.sqrt(solution.chi2 / max(solution.degrees_of_freedom, 1)))
        status, message = verdict(
            solution,
            lambda: "",
            spread=spread,
            degrees_of_freedom=self.independent(fitted) - int(free.sum()),
            wrong=None if loss.name == "linear" else ~found.kept,
            left_out=int(np.count_nonzero(~found.kept)),
        )
        parity = frame_parity(fitted, model.with_parameters(found.fit.state))
        if parity:
            status, message = "refused", f"{parity}; {message}"
        return Outcome(
            state=found.fit.state, solution=replace(solution, status=status, message=message), kept=found.kept
        )

    def attitudes(self, state: Any, stars: Observations, camera: CameraModel) -> tuple[FloatArray, Rotation | None]:
        """Wahba's for each frame with the camera found; no installation."""
        return start_attitudes(stars, camera), None

    def _fit_pairs(
        self, observations: Observations, model: CameraModel, free: BoolArray, two_step: bool, loss: Loss
    ) -> _PairFit:
        """Equally weighted pairs; with a robust loss first to find the wrong stars, then without them."""
        stars, kept, spread = StarFrames(observations, self.pairs), np.ones(len(observations), bool), 1.0
        state, stages, steps = np.array(model.parameters), free_stages(model, free, two_step=two_step), 0
        if loss.name != "linear":
            every = StarFrames(observations, "all")
            sigma = PairProblem.at(stars, model, free).sigma
            fit, spread = fit_stages(lambda stage: PairProblem(every, model, stage, sigma), state, stages, loss)
            state, steps, stages = fit.state, fit.solution.iterations, [free]
            kept = _fitting_stars(every, model.with_parameters(state), free, WRONG_PULL * spread)
            lonely = np.bincount(observations.frame[kept], minlength=observations.frames) < 2
            kept &= ~lonely[observations.frame]
            if spread > LARGEST_RMS or np.count_nonzero(kept) * 2 <= len(kept):
                return _PairFit(fit, every, kept, spread)
            stars = StarFrames(observations.select(kept), self.pairs)
        sigma = PairProblem.at(stars, model.with_parameters(state), free).sigma
        fit, _ = fit_stages(lambda stage: PairProblem(stars, model, stage, sigma), state, stages, get_loss("linear"))
        problem = PairProblem.at(stars, model.with_parameters(fit.state), free)
        evaluation = problem.evaluate(fit.state)
        solution = fit.solution
        if evaluation.seen is not None:
            solution = replace(
                solution,
                covariance=self.scatter(problem, evaluation, solution.covariance),
                chi2=float(np.sum(evaluation.residual**2)),
                residual_pulls=evaluation.residual.ravel(),
                iterations=solution.iterations + steps,
            )
        return _PairFit(replace(fit, evaluation=evaluation, solution=solution), stars, kept, spread)


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


def _fit_weighted(found: _PairFit, model: CameraModel, free: BoolArray) -> _PairFit:
    """All pairs with full weights, the weights renewed until they no longer matter."""
    if found.fit.solution.status not in ("converged", "singular"):
        return found
    state, steps = found.fit.state, found.fit.solution.iterations
    last = found.fit
    for outer in range(OUTER_STEPS):
        problem = WeightedPairProblem(found.stars, model.with_parameters(state), free)
        fit = solve(problem, state, tolerance=1e-4, max_iterations=30)
        moved = (fit.state - state)[free]
        steps += fit.solution.iterations
        state, last = fit.state, fit
        if outer and float(moved @ fit.system.common @ moved) < SAME_WEIGHTS**2:
            break
    else:
        solution = replace(last.solution, status="iteration_limit", message="the weights do not come to rest")
        last = replace(last, solution=solution)
    return replace(found, fit=replace(last, solution=replace(last.solution, iterations=steps)))
