"""The least-squares core of all calibrations: Levenberg-Marquardt on block-arrow normal equations, with robust losses.

A problem hands in whitened residuals (unit variance) and its normal equations (`calib.fitting.block_arrow`); unknowns
may live on a curved space (rotations), so the solver only uses "this state moved by that step". It minimises

    cost = sum over groups of rho(|r|^2) + penalty,

a group being what is kept or thrown away together (the two coordinates of a star), the penalty a sum of squares of
prior knowledge. Steps solve (H + lambda D) step = -g with H = J^T W J, W the weights of the loss, and D the diagonal of
H (Marquardt 1963, J. SIAM 11, 431), so that the units of the unknowns do not matter; lambda follows the ratio of the
true to the predicted decrease (Nielsen 1999, IMM-REP-1999-05). A step that leaves the domain (a star behind the
camera) has infinite cost and is not taken.

It has converged when the next step is shorter than ``tolerance`` in the metric of the information, that is, when no
unknown would move by more than that part of its own sigma, in any units; or when a full step of less than 1e-3 sigma no
longer lowers the cost, which is rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from calib.fitting.block_arrow import ArrowSystem, GaussNewtonStep, Reduced, spectrum
from calib.fitting.determined import Determined, covariance_of_spectrum, transformed_covariance
from calib.fitting.misfit import joined
from calib.fitting.robust_loss import Loss, get_loss
from calib.fitting.solution import Solution
from optics.arrays import FloatArray
from optics.errors import DomainError, unknown_name

DAMPING_START = 1e-4
DAMPING_LEAST = 1e-14
ROUNDING_STEP = 1e-3  # sigma: a full step this short that does not lower the cost says that rounding has been reached


class Evaluation(Protocol):
    """Residuals and derivatives of a problem at one state."""

    @property
    def residual(self) -> FloatArray:
        """Whitened residuals (n, g); not finite outside the domain."""
        ...

    @property
    def penalty(self) -> float:
        """Sum of squares of prior residuals."""
        ...


class Problem(Protocol):
    """Interface between the solver and a problem."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the common unknowns, as reported."""
        ...

    @property
    def unknowns(self) -> int:
        """Number of all unknowns, including the frames' unknowns."""
        ...

    @property
    def prior_terms(self) -> int:
        """Number of prior residuals."""
        ...

    def evaluate(self, state: Any) -> Evaluation:
        """Residuals at a state, and intermediate results for `system`."""
        ...

    def system(self, evaluation: Any, weight: FloatArray) -> ArrowSystem:
        """Normal equations with weights (n,) of the groups."""
        ...

    def move(self, state: Any, step: GaussNewtonStep) -> Any:
        """The state moved by a step."""
        ...

    def reported(self, state: Any) -> tuple[FloatArray, FloatArray]:
        """Values (p,) as reported, and their derivatives (p, p) by the step."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Result of the core."""

    state: Any  # State of the problem
    evaluation: Any  # Residuals there
    system: ArrowSystem  # Normal equations there, with the weights of the loss
    reduced: Reduced  # Frames eliminated
    solution: Solution  # Values of the common unknowns, covariance, status, statistics


@dataclass(slots=True)
class _Walk:
    """State of the iteration."""

    state: Any
    evaluation: Any
    cost: float
    status: str
    message: str
    iterations: int

    def ended(self, status: str, message: str) -> _Walk:
        """The same, with its end noted."""
        self.status, self.message = status, message
        return self


def solve(
    problem: Problem,
    start: Any,
    *,
    loss: str | Loss = "linear",
    scale: float = 1.0,
    tolerance: float = 1e-6,
    slack: float = 0.0,
    max_iterations: int = 100,
) -> Fit:
    """Minimise the loss of a problem from a start.

    Shapes: returns (their variance is infinite, the message names them). Linear algebra runs on one thread meanwhile:
    the matrices are small, and threads that wait for each other make a polynomial camera ten times as slow.
    """
    with _blas().limit(limits=1, user_api="blas"):
        return _solve(problem, start, get_loss(loss), scale, (tolerance, max(slack, 1e-15)), max_iterations)


@lru_cache(maxsize=1)
def _blas() -> Any:
    """The libraries of linear algebra that NumPy and SciPy have loaded."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _solve(problem: Problem, start: Any, chosen: Loss, scale: float, limits: tuple[float, float], most: int) -> Fit:
    walk = _walk(problem, start, chosen, scale, limits, most)
    residual = walk.evaluation.residual
    inside = bool(np.all(np.isfinite(residual)))
    if not inside:
        residual = np.zeros_like(residual)
    weight = chosen.weight(_squares(residual) / scale**2)
    system = problem.system(walk.evaluation, weight) if inside else _empty_system(len(problem.names))
    reduced = system.reduce()
    counted = weight > 0  # what a redescending loss threw away is no longer in the fit
    value, derivative = problem.reported(walk.state)
    factor = chosen.variance_factor(residual.shape[1])
    determined = covariance_of(reduced, problem.names, factor=factor)
    status, message = walk.status, walk.message
    if inside and determined.unknown:
        status, message = "singular", joined(determined.message, "" if walk.status == "converged" else message)
    solution = Solution(
        value=value,
        names=problem.names,
        covariance=transformed_covariance(determined.covariance, derivative),
        status=status,
        message=message,
        iterations=walk.iterations,
        chi2=float(np.sum(residual[counted] ** 2) + walk.evaluation.penalty) if inside else float("inf"),
        degrees_of_freedom=int(residual[counted].size + problem.prior_terms - problem.unknowns),
        condition=determined.condition,
        residual_pulls=residual.ravel(),
        robust_weight=weight,
    )
    return Fit(state=walk.state, evaluation=walk.evaluation, system=system, reduced=reduced, solution=solution)


def _squares(residual: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ni,ni->n", residual, residual))


def _cost(evaluation: Any, loss: Loss, scale: float) -> float:
    squares = _squares(evaluation.residual)
    if not np.all(np.isfinite(squares)):
        return float("inf")
    value = float(np.sum(squares)) if loss.name == "linear" else float(np.sum(loss.rho(squares / scale**2))) * scale**2
    return value + float(evaluation.penalty)


def _walk(problem: Problem, start: Any, loss: Loss, scale: float, limits: tuple[float, float], most: int) -> _Walk:
    tolerance, slack = limits
    evaluation = problem.evaluate(start)
    walk = _Walk(start, evaluation, _cost(evaluation, loss, scale), "iteration_limit", "", 0)
    if not np.isfinite(walk.cost):
        return walk.ended("refused", "the start is outside the domain (a star behind the camera, or not finite)")
    damping = DAMPING_START
    while walk.iterations < most:
        system = problem.system(walk.evaluation, loss.weight(_squares(walk.evaluation.residual) / scale**2))
        if not (np.isfinite(system.common).all() and np.isfinite(system.gradient).all()):
            return walk.ended("stalled", "the derivatives are not finite")
        scales = _positive_diagonal(system)
        moved, growth = False, 2.0
        while not moved and walk.iterations < most:
            step = system.step(damping, *scales)
            if step.length < tolerance or step.decrease <= slack * walk.cost:
                if damping <= DAMPING_LEAST:
                    return walk.ended("converged", f"next step below {tolerance:g} sigma")
                if growth > 2.0:  # short because longer ones were of no use
                    return walk.ended("stalled", "no step lowers the cost, the gradient is not zero")
                damping = DAMPING_LEAST  # it may be short because it is damped: look at the whole step
                continue
            walk.iterations += 1
            trial = problem.move(walk.state, step)
            evaluation = problem.evaluate(trial)
            cost = _cost(evaluation, loss, scale)
            ratio = (walk.cost - cost) / step.decrease
            if ratio > 1e-4:
                walk.state, walk.evaluation, walk.cost, moved = trial, evaluation, cost, True
                damping = max(damping * max(0.1, 1.0 - (2.0 * ratio - 1.0) ** 3), DAMPING_LEAST)
            elif abs(walk.cost - cost) <= 1e-12 * walk.cost or (step.length < ROUNDING_STEP and damping <= 1e-3):
                if damping <= DAMPING_LEAST:
                    return walk.ended("converged", "the cost no longer changes within rounding")
                damping = DAMPING_LEAST
            else:
                damping, growth = max(damping, 1e-7) * growth, growth * 2.0
    return walk.ended("iteration_limit", f"not converged after {walk.iterations} steps")


def _positive_diagonal(system: ArrowSystem) -> tuple[FloatArray, FloatArray | None]:
    """Squared scales of the unknowns: their diagonals, 1 where an unknown has no effect."""
    common, block = system.diagonal()
    return np.where(common > 0, common, 1.0), None if block is None else np.where(block > 0, block, 1.0)


def covariance_of(reduced: Reduced, names: tuple[str, ...], *, factor: float = 1.0) -> Determined:
    """Covariance of the common unknowns from the reduced normal equations."""
    return covariance_of_spectrum(*spectrum(reduced), reduced.scale, names, factor=factor)


def _empty_system(size: int) -> ArrowSystem:
    return ArrowSystem(common=np.zeros((size, size)), gradient=np.zeros(size))


@dataclass(frozen=True, slots=True)
class _DenseEvaluation:
    parameters: FloatArray
    residual: FloatArray
    penalty: float = 0.0


class DenseProblem:
    """A problem of one vector of unknowns, without frames."""

    def __init__(
        self,
        residuals: Callable[[FloatArray], FloatArray],
        jacobian: Callable[[FloatArray], FloatArray],
        names: tuple[str, ...],
        start: ArrayLike,
        *,
        free: tuple[str, ...] | None = None,
    ) -> None:
        self._residuals, self._jacobian = residuals, jacobian
        self.start = np.array(start, dtype=np.float64)
        if self.start.shape != (len(names),):
            raise DomainError(f"start of shape {self.start.shape} for {len(names)} parameters")
        for name in free or ():
            if name not in names:
                raise unknown_name("parameter", name, names)
        self._free = np.array([free is None or name in free for name in names])
        self.names = tuple(name for name, is_free in zip(names, self._free, strict=True) if is_free)
        self.unknowns, self.prior_terms = len(self.names), 0

    def evaluate(self, state: FloatArray) -> _DenseEvaluation:
        """Residuals at the parameters."""
        return _DenseEvaluation(state, np.asarray(self._residuals(state), dtype=np.float64).reshape(-1, 1))

    def system(self, evaluation: _DenseEvaluation, weight: FloatArray) -> ArrowSystem:
        """Normal equations of the free parameters."""
        jacobian = np.asarray(self._jacobian(evaluation.parameters))[:, self._free]
        weighted = jacobian * weight[:, None]
        return ArrowSystem(common=jacobian.T @ weighted, gradient=weighted.T @ evaluation.residual[:, 0])

    def move(self, state: FloatArray, step: GaussNewtonStep) -> FloatArray:
        """Parameters after a step."""
        out = state.copy()
        out[self._free] += step.common
        return out

    def reported(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The free parameters themselves."""
        return state[self._free], np.eye(self.unknowns)
