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

Wrong matches. A wrong star spoils its n - 1 pairs, and a robust loss on pairs is led astray where three stars of ten
are shifted by some sigma: half of all pairs are then wrong. With a robust loss the wrong stars are therefore found by a
robust fit with a free attitude in every frame, which holds the same information as all angles and takes each star by
itself (`calib.calibration.free_attitudes`); the angles of the stars that fit are then fitted by plain least squares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from calib.calibration.attitude_family import AttitudeFamily, FamilyFit, frames_with_stars
from calib.calibration.free_attitudes import FreeAttitudes, frame_parity, start_attitudes
from calib.calibration.interstar_pairs import PairProblem, Pairs, StarFrames, WeightedPairProblem, pair_covariance
from calib.calibration.observations import Observations
from calib.calibration.stages import fit_stages, free_stages
from calib.calibration.verdict import verdict
from calib.cameras.base import CameraModel
from calib.fitting.least_squares import Fit, Problem, solve
from calib.fitting.robust_loss import Loss, get_loss
from optics.arrays import BoolArray, FloatArray
from optics.errors import ConfigError

OUTER_STEPS = 8  # renewals of the weights; two are usual
SAME_WEIGHTS = 1e-3  # sigma: a step this short does not change the weights


@dataclass(frozen=True, slots=True, kw_only=True)
class NoAttitude(AttitudeFamily):
    """Angles between the stars of each frame.

    Attributes
    ----------
    weighting : {"none", "full"}
        Equal weights, as in the paper ACF17, or the covariance of the pairs.
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
        return pair_covariance(problem, evaluation)

    def fit(
        self, stars: Observations, model: CameraModel, free: BoolArray, start: Any, *, two_step: bool, loss: Loss
    ) -> FamilyFit:
        """Pairs with equal weights, then with full ones if wanted; the judgement of the residuals and of the parity."""
        kept, state, steps = np.ones(len(stars), bool), np.array(model.parameters), 0
        stages = free_stages(model, free, two_step=two_step)
        if loss.name != "linear":
            robust = _inliers(stars, model, free, two_step)
            if robust.solution.status == "refused":
                return robust
            kept, state, steps, stages = robust.kept, robust.state, robust.solution.iterations, [free]
        fitted = stars.select(kept)
        fit = self._fit_pairs(fitted, model, state, stages)
        if self.weighting == "full":
            fit = _fit_weighted(fit, StarFrames(fitted, self.pairs), model, free)
        solution = replace(
            fit.solution,
            iterations=fit.solution.iterations + steps,
            independent=self.independent(fitted) - int(free.sum()),
        )
        status, message = verdict(
            solution,
            lambda: "",
            spread=float(np.sqrt(solution.chi2 / max(solution.degrees_of_freedom, 1))),
            degrees_of_freedom=self.independent(fitted) - int(free.sum()),
            wrong=None if loss.name == "linear" else ~kept,
            left_out=int(np.count_nonzero(~kept)),
        )
        parity = frame_parity(fitted, model.with_parameters(fit.state))
        if parity:
            status, message = "refused", f"{parity}; {message}"
        return FamilyFit(state=fit.state, solution=replace(solution, status=status, message=message), kept=kept)

    def attitudes(self, state: Any, stars: Observations, camera: CameraModel) -> tuple[FloatArray, Rotation | None]:
        """Wahba's for each frame with the camera found; no installation."""
        return start_attitudes(stars, camera), None

    def _fit_pairs(
        self, observations: Observations, model: CameraModel, state: FloatArray, stages: list[BoolArray]
    ) -> Fit:
        """Equally weighted pairs by least squares; the covariance allows for the correlation of pairs."""
        stars, free = StarFrames(observations, self.pairs), stages[-1]
        sigma = PairProblem.at(stars, model.with_parameters(state), free).sigma
        fit, _ = fit_stages(lambda stage: PairProblem(stars, model, stage, sigma), state, stages, get_loss("linear"))
        problem = PairProblem.at(stars, model.with_parameters(fit.state), free)
        evaluation = problem.evaluate(fit.state)
        if evaluation.directions is None:
            return fit
        solution = replace(
            fit.solution,
            covariance=self.scatter(problem, evaluation, fit.solution.covariance),
            chi2=float(np.sum(evaluation.residual**2)),
            residual_pulls=evaluation.residual.ravel(),
        )
        return replace(fit, evaluation=evaluation, solution=solution)


def _inliers(stars: Observations, model: CameraModel, free: BoolArray, two_step: bool) -> FamilyFit:
    """Camera parameters of a robust fit with free attitudes, and the stars (n,) that fit, two or more per frame."""
    family, loss = FreeAttitudes(), get_loss("tukey")
    start = family.start(stars, model, robust=True)
    fit = family.fit(stars, model, free, start, two_step=two_step, loss=loss)
    enough = np.bincount(stars.frame[fit.kept], minlength=stars.frames) >= 2
    return replace(fit, state=fit.state.camera, kept=fit.kept & enough[stars.frame])


def _fit_weighted(start: Fit, stars: StarFrames, model: CameraModel, free: BoolArray) -> Fit:
    """All pairs with full weights, the weights renewed until they no longer matter."""
    if start.solution.status not in ("converged", "singular"):
        return start
    state, steps, last = start.state, start.solution.iterations, start
    for outer in range(OUTER_STEPS):
        problem = WeightedPairProblem(stars, model.with_parameters(state), free)
        last = solve(problem, state, tolerance=1e-4, max_iterations=30)
        moved = (last.state - state)[free]
        steps += last.solution.iterations
        state = last.state
        if outer and float(moved @ last.system.common @ moved) < SAME_WEIGHTS**2:
            break
    else:
        solution = replace(last.solution, status="iteration_limit", message="the weights do not converge")
        last = replace(last, solution=solution)
    return replace(last, solution=replace(last.solution, iterations=steps))
