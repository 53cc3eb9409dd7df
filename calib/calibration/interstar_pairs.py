"""Mathematics of `calib.calibration.interstar_angles`: angles between the stars of a frame, as least squares.

Frames are padded to the longest one, a missing star being the zero vector: every product with it vanishes, so that no
mask is needed. With u_i the direction of the measured star i by the present camera and r_i its catalogue direction, the
misclosure of a pair is

    y_ij = u_i . u_j - r_i . r_j.

Errors e_i of the positions, in units of their sigma, enter it as y_ij = P_ij . e_i + P_ji . e_j with P_ij = T_i^T u_j,
T_i = d u_i / d pixel times the root of the covariance. In short y = G e: pairs that share a star are correlated, and of
the n (n - 1) / 2 pairs of a frame only 2 n - 3 are independent.

Full weighting. The covariance G G^T of all pairs is singular; the weighted sum of squares is that of its
pseudo-inverse,

    y^T (G G^T)^+ y = |z|^2,     z = G^+ y = (G^T G)^+ G^T y,

with one 2-vector z_i per star: the smallest position errors that explain all misclosures. The null vectors of G^T G are
the three turns of the frame as a whole, N: z = (G^T G + c N N^T)^-1 G^T y. With M the sum of u u^T over the frame,

    (G^T G)_ii = T_i^T M T_i,     (G^T G)_ij = T_i^T u_j u_i^T T_j = A_i S A_j^T,

A_i the nine products of T_i and u_i, and S the exchange of their two factors: two-by-two blocks D plus F K F^T of rank
12, F = [A, N], whose inverse is Woodbury's, D^-1 - D^-1 F (K^-1 + F^T D^-1 F)^-1 F^T D^-1. The full weighting of all
pairs costs one (12, 12) system per frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.calibration.observations import Observations
from calib.calibration.stages import free_names
from calib.calibration.star_problem import rank_in_frame
from calib.cameras.base import CameraModel, unproject_jacobian
from calib.fitting.block_arrow import ArrowSystem, GaussNewtonStep
from calib.fitting.least_squares import covariance_of
from optics.arrays import BoolArray, FloatArray, IntArray
from optics.errors import DomainError

Pairs = Literal["all", "consecutive"]

LARGEST_TABLE = 30_000_000  # entries of frames x stars x stars
SWAP = np.arange(9).reshape(3, 3).T.ravel()  # (k, l) -> (l, k)
FLOOR = 1e-10  # of the mean eigenvalue: what is flatter than this is no angle but a line of stars


@dataclass(frozen=True, slots=True)
class Directions:
    """Padded directions by one camera: u (f, n, 3), by parameter (f, n, q, 3), by unit error (f, n, 2, 3)."""

    unit: FloatArray
    by_parameter: FloatArray
    by_error: FloatArray


class StarFrames:
    """Stars of frames in padded tables."""

    def __init__(self, observations: Observations, pairs: Pairs) -> None:
        count = np.bincount(observations.frame, minlength=observations.frames)
        occupied = np.flatnonzero(count)
        self.observations = observations
        self.frames, self.longest = len(occupied), int(count.max(initial=0))
        if self.frames * self.longest**2 > LARGEST_TABLE:
            raise DomainError(
                f"{self.frames} frames of up to {self.longest} stars give too many pairs; keep the brightest "
                f"{int(np.sqrt(LARGEST_TABLE / self.frames))} stars of each frame"
            )
        self.rank = rank_in_frame(observations.frame, count)
        self.table = np.searchsorted(occupied, observations.frame)
        self.error_root = np.linalg.cholesky(observations.covariance_px2)
        reference = self.padded(observations.direction)
        self.cosine = reference @ reference.swapaxes(1, 2)
        size = count[occupied]
        self.every = pairs == "all"
        i, j = np.triu_indices(self.longest, 1)
        if pairs == "all":
            frame, which = np.nonzero(j[None, :] < size[:, None])
            self.pair = (frame, i[which], j[which])
        else:
            rank = np.arange(self.longest)
            frame, first = np.nonzero((rank < np.where(size > 2, size, 1)[:, None]) & (size > 1)[:, None])
            self.pair = (frame, first, (first + 1) % size[frame])

    def padded(self, values: FloatArray) -> FloatArray:
        """Values (m, ...) of the stars in a table (f, n, ...), zero where there is no star."""
        out = np.zeros((self.frames, self.longest, *values.shape[1:]))
        out[self.table, self.rank] = values
        return out

    def directions(self, model: CameraModel, free: BoolArray) -> Directions | None:
        """Directions by a camera, with derivatives; None where a pixel has no direction."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # a camera on its way may fold the image
            at = unproject_jacobian(model, self.observations.pixel_px, self.observations.band)
        if not (np.isfinite(at.direction).all() and np.isfinite(at.by_parameter).all()):
            return None
        return Directions(
            self.padded(at.direction),
            self.padded(at.by_parameter[:, :, free].swapaxes(1, 2)),
            self.padded((at.by_pixel @ self.error_root).swapaxes(1, 2)),
        )

    def misclosure(self, unit: FloatArray) -> FloatArray:
        """y (f, n, n)."""
        return unit @ unit.swapaxes(1, 2) - self.cosine

    def pair_rows(self, directions: Directions) -> FloatArray:
        """Derivatives of the misclosures of the chosen pairs by the parameters (m, q)."""
        f, i, j = self.pair
        first, second = f * self.longest + i, f * self.longest + j
        q = directions.by_parameter.shape[2]
        out = np.zeros((len(f), q))
        for k in range(3):
            moved = np.ascontiguousarray(directions.by_parameter[..., k]).reshape(-1, q)
            unit = np.ascontiguousarray(directions.unit[..., k]).ravel()
            out += moved[first] * unit[second, None]
            out += moved[second] * unit[first, None]
        return out

    def normal_equations(self, directions: Directions) -> tuple[FloatArray, FloatArray]:
        """J^T J (q, q) and J^T y (q,) of the chosen pairs.

        With X_ijq = (d u_i / d q) . u_j, the row of a pair is X_ijq + X_jiq, and the sum over all pairs is that of
        X_ijq (X_ijr + X_jir) over all (i, j), in which the sums over j are (3, 3) matrices.
        """
        y = self.misclosure(directions.unit)
        if not self.every:
            rows = self.pair_rows(directions)
            return rows.T @ rows, rows.T @ y[self.pair]
        by_parameter, cross = directions.by_parameter, _crossed(directions)
        normal = np.tensordot(by_parameter, _onto_partners(directions), axes=([0, 1, 3], [0, 1, 3]))
        normal += np.tensordot(cross, cross, axes=([0, 2, 3], [0, 3, 2]))
        return normal, np.tensordot(by_parameter, y @ directions.unit, axes=([0, 1, 3], [0, 1, 2]))

    def gradient_by_error(self, directions: Directions) -> FloatArray:
        """J^T G (q, 2 f n): how unit position errors move the gradient."""
        unit, (frames, n, q, _) = directions.unit, directions.by_parameter.shape
        if self.every:
            crossed = np.einsum("fqkl,fil->fiqk", _crossed(directions).swapaxes(2, 3), unit)
            by_direction = _onto_partners(directions) + crossed
        else:
            f, i, j = self.pair
            chosen = np.zeros((frames, n, n))
            np.add.at(chosen, (np.tile(f, 2), np.concatenate([i, j]), np.concatenate([j, i])), 1.0)
            half = (directions.by_parameter.reshape(frames, n * q, 3) @ unit.swapaxes(1, 2)).reshape(frames, n, q, n)
            both = (half + half.transpose(0, 3, 2, 1)) * chosen[:, :, None, :]
            by_direction = (both.reshape(frames, n * q, n) @ unit).reshape(frames, n, q, 3)
        by_error = by_direction @ directions.by_error.swapaxes(2, 3)  # (f, n, q, 2)
        return np.asarray(by_error.transpose(2, 0, 1, 3).reshape(q, -1))


def _onto_partners(directions: Directions) -> FloatArray:
    """(d u_i / d q)^T times the sum of u u^T over the stars of the frame, (f, n, q, 3)."""
    frames, n, q, _ = directions.by_parameter.shape
    square = directions.unit.swapaxes(1, 2) @ directions.unit
    return np.asarray((directions.by_parameter.reshape(frames, n * q, 3) @ square).reshape(frames, n, q, 3))


def _crossed(directions: Directions) -> FloatArray:
    """K (f, q, 3, 3), the sum over stars of (d u / d q) u^T."""
    frames, n, q, _ = directions.by_parameter.shape
    flat = directions.by_parameter.reshape(frames, n, 3 * q).swapaxes(1, 2) @ directions.unit
    return np.asarray(flat.reshape(frames, q, 3, 3))


def _inverse2(matrix: FloatArray) -> FloatArray:
    """Inverses of (..., 2, 2)."""
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    determinant = a * d - b * c
    out = np.empty_like(matrix)
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = d, -b, -c, a
    return np.asarray(out / determinant[..., None, None])


@dataclass(frozen=True, slots=True)
class PairEvaluation:
    """Residuals with what the normal equations need."""

    residual: FloatArray
    directions: Directions | None
    penalty: float = 0.0


class _CameraProblem:
    """What both problems share: the state is the vector of all camera parameters, of which the free ones move."""

    prior_terms = 0

    def __init__(self, stars: StarFrames, model: CameraModel, free: BoolArray) -> None:
        self.stars, self.model, self.free = stars, model, free
        self.names = free_names(model, free)
        self.unknowns = len(self.names)

    def directions(self, state: FloatArray) -> Directions | None:
        """Directions by the camera of a state; None where it is not finite or a pixel has no direction."""
        return self.stars.directions(self.model.with_parameters(state), self.free) if np.isfinite(state).all() else None

    def move(self, state: FloatArray, step: GaussNewtonStep) -> FloatArray:
        """Parameters after a step."""
        out = state.copy()
        out[self.free] += step.common
        return out

    def reported(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The free parameters."""
        return state[self.free], np.eye(len(self.names))


class PairProblem(_CameraProblem):
    """Misclosures of pairs with equal weights."""

    def __init__(self, stars: StarFrames, model: CameraModel, free: BoolArray, sigma: float) -> None:
        super().__init__(stars, model, free)
        self.sigma = sigma

    @classmethod
    def at(cls, stars: StarFrames, model: CameraModel, free: BoolArray) -> PairProblem:
        """The problem with the typical sigma at a camera."""
        directions = stars.directions(model, free)
        return cls(stars, model, free, 1.0 if directions is None else typical_sigma(stars, directions))

    def evaluate(self, state: FloatArray) -> PairEvaluation:
        """Misclosures over the typical sigma (m, 1)."""
        directions = self.directions(state)
        if directions is None:
            return PairEvaluation(np.full((len(self.stars.pair[0]), 1), np.nan), None)
        return PairEvaluation(self.stars.misclosure(directions.unit)[self.stars.pair][:, None] / self.sigma, directions)

    def system(self, evaluation: PairEvaluation, weight: FloatArray) -> ArrowSystem:
        """Normal equations at a state; pairs are fitted by plain least squares, their weights are one."""
        assert evaluation.directions is not None
        normal, gradient = self.stars.normal_equations(evaluation.directions)
        return ArrowSystem(common=normal / self.sigma**2, gradient=gradient / self.sigma**2)


def typical_sigma(stars: StarFrames, directions: Directions) -> float:
    """Root mean variance of the misclosures of the chosen pairs, from the position errors."""
    f, i, j = stars.pair
    if stars.every:  # the sum over partners is a (3, 3) matrix
        square = directions.unit.swapaxes(1, 2) @ directions.unit
        variance = float(np.sum((directions.by_error @ square[:, None]) * directions.by_error)) / len(f)
        return float(np.sqrt(variance)) if variance > 0 else 1.0
    by_first = np.einsum("mak,mk->ma", directions.by_error[f, i], directions.unit[f, j])
    by_second = np.einsum("mak,mk->ma", directions.by_error[f, j], directions.unit[f, i])
    return float(np.sqrt(np.mean(np.sum(by_first**2 + by_second**2, axis=1)))) or 1.0


def pair_covariance(problem: PairProblem, evaluation: PairEvaluation) -> FloatArray:
    """Covariance of the parameters from equally weighted pairs, correlations between pairs included.

    The estimate is (J^T J)^-1 J^T y, and y = G e with unit e, so that its covariance is S S^T, S = (J^T J)^-1 J^T G.
    Equal weights are not the right ones; the inverse normal matrix alone would be too small, since it counts every pair
    as new information.
    """
    directions = evaluation.directions
    assert directions is not None
    normal, gradient = problem.stars.normal_equations(directions)
    inverse = covariance_of(ArrowSystem(common=normal, gradient=gradient).reduce(), problem.names).covariance
    lost = np.isinf(np.diagonal(inverse))
    root = np.where(lost[:, None] | lost, 0.0, inverse) @ problem.stars.gradient_by_error(directions)
    covariance = np.asarray(root @ root.T)
    covariance[lost, lost] = np.inf
    return covariance


class WeightedPairProblem(_CameraProblem):
    """All pairs of every frame, weighted by the pseudo-inverse of their covariance, taken at one camera and kept."""

    def __init__(self, stars: StarFrames, model: CameraModel, free: BoolArray) -> None:
        super().__init__(stars, model, free)
        directions = stars.directions(model, free)
        if directions is None:
            raise DomainError("weights of interstar angles: a pixel has no direction in this camera model")
        frames = len(directions.unit)
        size = np.bincount(stars.table, minlength=frames)
        # turns of the frames are unknowns in disguise: a frame of n stars gives 2 n - 3 measurements
        self.unknowns += 3 * frames
        self._frozen = directions
        self._blocks, self._low, self._core = self._weights(directions, size)

    def _weights(self, directions: Directions, size: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """D^-1 (f, n, 2, 2), D^-1 F (f, 2n, 12) and (K^-1 + F^T D^-1 F)^-1 (f, 12, 12)."""
        frames, n, _ = directions.unit.shape
        tangent = directions.by_error
        square = directions.unit.swapaxes(1, 2) @ directions.unit
        blocks = tangent @ square[:, None] @ tangent.swapaxes(2, 3)
        mean = np.einsum("fiaa->f", blocks) / np.maximum(2 * size, 1)
        absent = np.arange(n)[None, :] >= size[:, None]
        blocks = blocks + np.where(absent, 1.0, FLOOR * mean[:, None])[:, :, None, None] * np.eye(2)
        metric = tangent @ tangent.swapaxes(2, 3)
        metric[absent] = np.eye(2)
        # null vectors: the position errors that look like a turn w, e = T^+ (w x u)
        turn = np.cross(np.eye(3)[None, None], directions.unit[:, :, None, :])
        null = _inverse2(metric) @ (tangent @ turn.swapaxes(2, 3))
        product = (tangent[:, :, :, :, None] * directions.unit[:, :, None, None, :]).reshape(frames, n, 2, 9)  # A
        factor = np.concatenate([product, null], axis=3)
        inverse = _inverse2(blocks)
        low = (inverse @ factor).reshape(frames, 2 * n, 12)
        core = factor.reshape(frames, 2 * n, 12).swapaxes(1, 2) @ low
        core[:, np.arange(9), SWAP] += 1.0
        flat = null.reshape(frames, 2 * n, 3)
        core[:, 9:, 9:] += flat.swapaxes(1, 2) @ flat / mean[:, None, None]
        return inverse, low, np.asarray(np.linalg.inv(core), np.float64)

    def _weighted(self, right: FloatArray) -> FloatArray:
        """(G^T G + c N N^T)^-1 times ``right`` (f, n, 2, m), as (f, 2n, m)."""
        frames, n, _, columns = right.shape
        corrected = self._low @ (self._core @ (self._low.swapaxes(1, 2) @ right.reshape(frames, 2 * n, columns)))
        return np.asarray((self._blocks @ right).reshape(frames, 2 * n, columns) - corrected)

    def evaluate(self, state: FloatArray) -> PairEvaluation:
        """z (m, 2), one row per star."""
        stars, directions = self.stars, self.directions(state)
        if directions is None:
            return PairEvaluation(np.full((len(stars.table), 2), np.nan), None)
        across = stars.misclosure(directions.unit) @ self._frozen.unit  # misclosures themselves: no digits are lost
        z = self._weighted(self._frozen.by_error @ across[:, :, :, None]).reshape(stars.frames, stars.longest, 2)
        return PairEvaluation(z[stars.table, stars.rank], directions)

    def rows(self, directions: Directions) -> FloatArray:
        """Derivatives of z by the parameters (f, 2n, q)."""
        frames, n, q, _ = directions.by_parameter.shape
        unit = self._frozen.unit
        by_star = directions.by_parameter.reshape(frames, n * q, 3) @ (directions.unit.swapaxes(1, 2) @ unit)
        by_partners = directions.by_parameter.reshape(frames, n, 3 * q).swapaxes(1, 2) @ unit
        by_partners = directions.unit @ by_partners.reshape(frames, q, 3, 3).transpose(0, 2, 1, 3).reshape(
            frames, 3, 3 * q
        )
        across = by_star.reshape(frames, n, q, 3) + by_partners.reshape(frames, n, q, 3)
        return self._weighted(self._frozen.by_error @ across.swapaxes(2, 3))

    def system(self, evaluation: PairEvaluation, weight: FloatArray) -> ArrowSystem:
        """Normal equations; see `PairProblem.system` on the weights."""
        assert evaluation.directions is not None
        rows = self.rows(evaluation.directions).reshape(-1, self.free.sum())
        return ArrowSystem(common=rows.T @ rows, gradient=rows.T @ self.stars.padded(evaluation.residual).reshape(-1))
