"""Normal equations of block-arrow form, and how they are solved.

Many calibrations have a few unknowns common to all frames (camera, installation) and a few of each frame alone (its
attitude). With the common ones c first, the normal matrix is an arrow,

        [ C    B_1   B_2  ...]
    H = [ B_1^T  A_1  U_1     ]         C (p, p), B_k (p, b), A_k (b, b), U_k (b, b) between frame k and k + 1
        [ B_2^T  U_1^T A_2 ...]

and the frames are eliminated exactly by the Schur complement S = C - sum over frames of B A^-1 B^T. Without neighbours
(U = 0) this costs one (b, b) solution per frame, all frames at once; with neighbours, a random walk, the frame part is
a band matrix of 2 b - 1 side diagonals. S is the information on the common unknowns when the frames' own are not known;
its inverse is their covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray

# Eigenvalues of the scaled information below this part of the largest one are rounding, not information.
NULL_PART = 1e-13


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussNewtonStep:
    """A damped Gauss-Newton step."""

    common: FloatArray  # (p,) Change of the common unknowns
    block: FloatArray | None  # (f, b) Change of the frames' unknowns
    decrease: float  # What the quadratic model says the sum of squares falls by
    length: float  # Length of the step in the metric of the information: how many sigma it goes


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduced:
    """Normal equations with the unknowns of the frames eliminated."""

    information: FloatArray  # (p, p) Schur complement S
    scale: FloatArray  # (p,) Square roots of the diagonal of C: the effect of each common unknown with all others fixed
    border: FloatArray | None  # (f, b, p) A^-1 B^T
    block_covariance: FloatArray | None  # (f, b, b) Diagonal blocks of A^-1; None as well where they are not asked for


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrowSystem:
    """Normal equations ``H step = -gradient`` in arrow form; see the module."""

    common: FloatArray  # (p, p) C
    gradient: FloatArray  # (p,) Gradient of half the sum of squares by the common unknowns
    border: FloatArray | None = None  # (f, p, b) B; None where no frame has unknowns of its own
    block: FloatArray | None = None  # (f, b, b) A
    block_gradient: FloatArray | None = None  # (f, b) Gradient by the frames' unknowns
    coupling: FloatArray | None = None  # U; None for independent frames

    def diagonal(self) -> tuple[FloatArray, FloatArray | None]:
        """Diagonals (p,) of C and (f, b) of A."""
        block = None if self.block is None else np.einsum("fii->fi", self.block)
        return np.diagonal(self.common), block

    def step(self, damping: float, common_scale: FloatArray, block_scale: FloatArray | None) -> GaussNewtonStep:
        """Solve (H + damping diag(scale)) step = -gradient.

        Shapes: ``common_scale`` (p,), ``block_scale`` (p,).
        """
        damped = self.common + np.diag(damping * common_scale)
        right = self.gradient
        solved = None
        if self.border is not None and self.block is not None and self.block_gradient is not None:
            assert block_scale is not None
            solved = self._eliminate(
                np.concatenate([self.border.swapaxes(1, 2), self.block_gradient[:, :, None]], axis=2),
                # a frame that sees too little keeps a solvable block; 1e-14 is below its rounding
                (damping + 1e-14) * block_scale,
            )
            flat = self.border.swapaxes(1, 2).reshape(-1, len(right))
            pulled = flat.T @ solved.reshape(len(flat), -1)
            damped = damped - pulled[:, :-1]
            right = right - pulled[:, -1]
        common = -_solve_scaled(damped, right)
        block = None if solved is None else -(solved[:, :, :-1] @ common + solved[:, :, -1])
        slope = float(self.gradient @ common)
        size = damping * float(common_scale @ common**2)
        if block is not None and self.block_gradient is not None and block_scale is not None:
            slope += float(np.sum(self.block_gradient * block))
            size += damping * float(np.sum(block_scale * block**2))
        # H step = -g - damping D step: step^T H step = -slope - size, the model falls by -2 slope - step^T H step
        curvature = max(-slope - size, 0.0)
        return GaussNewtonStep(
            common=common, block=block, decrease=-2.0 * slope - curvature, length=float(np.sqrt(curvature))
        )

    def reduce(self, *, with_blocks: bool = False) -> Reduced:
        """Eliminate the frames, undamped; ``with_blocks`` also inverts their blocks."""
        scale = np.sqrt(np.maximum(np.diagonal(self.common), 0.0))
        if self.border is None or self.block is None:
            return Reduced(information=self.common, scale=scale, border=None, block_covariance=None)
        right = self.border.swapaxes(1, 2)
        diagonal = np.einsum("fii->fi", self.block)
        floor = np.where(diagonal > 0, 1e-14 * diagonal, 1.0)  # frames without stars keep a solvable block
        border = self._eliminate(right, floor)
        frames, size, common = right.shape
        information = self.common - right.reshape(-1, common).T @ border.reshape(-1, common)
        covariance = None
        if with_blocks:
            if self.coupling is None:
                covariance = np.asarray(np.linalg.inv(self.block), np.float64)
            else:
                full = self._eliminate(np.eye(frames * size).reshape(frames, size, frames * size), floor)
                k = np.arange(frames)
                covariance = full.reshape(frames, size, frames, size)[k, :, k]
        return Reduced(
            information=0.5 * (information + information.T), scale=scale, border=border, block_covariance=covariance
        )

    def _eliminate(self, right: FloatArray, extra: FloatArray) -> FloatArray:
        """A^-1 ``right`` (f, b, m), with ``extra`` (f, b) on the diagonal of A."""
        assert self.block is not None
        block = self.block + extra[:, :, None] * np.eye(self.block.shape[1])
        if self.coupling is None:
            return np.asarray(np.linalg.solve(block, right), np.float64)
        from scipy.linalg import solveh_banded

        frames, size, columns = right.shape
        band = np.zeros((2 * size, frames * size))  # lower form: band[i - j, j] = A[i, j]
        for j in range(size):
            for i in range(j, size):
                band[i - j, j::size] = block[:, i, j]
            for i in range(size):
                band[size + i - j, j : (frames - 1) * size : size] = self.coupling[:, j, i]
        solution = solveh_banded(band, right.reshape(frames * size, columns), lower=True, check_finite=False)
        return np.asarray(solution).reshape(frames, size, columns)


def _solve_scaled(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of a symmetric system, scaled; directions without information stay where they are."""
    diagonal = np.diagonal(matrix)
    inverse = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    value, vector = np.linalg.eigh(matrix * inverse[:, None] * inverse)
    known = value > NULL_PART * max(float(value[-1]), 0.0)
    part = (vector.T @ (right * inverse)) * known / np.where(known, value, 1.0)
    return np.asarray(vector @ part * inverse)


def spectrum(reduced: Reduced) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Eigenvalues (p,), eigenvectors (p, p) of the scaled information, and which of them carry information."""
    inverse = 1.0 / np.where(reduced.scale > 0, reduced.scale, 1.0)
    value, vector = np.linalg.eigh(reduced.information * inverse[:, None] * inverse)
    return value, vector, value > NULL_PART * max(float(value[-1]), 0.0)
