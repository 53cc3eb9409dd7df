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

from optics.arrays import BoolArray, FloatArray

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
            border = self.border.swapaxes(1, 2).reshape(-1, len(right))
            eliminated = border.T @ solved.reshape(len(border), -1)
            damped = damped - eliminated[:, :-1]
            right = right - eliminated[:, -1]
        common = -_solve_scaled(damped, right)
        block = None if solved is None else -(solved[:, :, :-1] @ common + solved[:, :, -1])
        slope = float(self.gradient @ common)
        damped_square = damping * float(common_scale @ common**2)
        if block is not None and self.block_gradient is not None and block_scale is not None:
            slope += float(np.sum(self.block_gradient * block))
            damped_square += damping * float(np.sum(block_scale * block**2))
        # from H step = -g - damping D step; the model falls by -2 slope - step^T H step
        curvature = max(-slope - damped_square, 0.0)
        return GaussNewtonStep(
            common=common, block=block, decrease=-2.0 * slope - curvature, length=float(np.sqrt(curvature))
        )

    def reduce(self) -> Reduced:
        """Eliminate the frames, undamped."""
        scale = np.sqrt(np.maximum(np.diagonal(self.common), 0.0))
        if self.border is None or self.block is None:
            return Reduced(information=self.common, scale=scale, border=None)
        right = self.border.swapaxes(1, 2)
        diagonal = np.einsum("fii->fi", self.block)
        floor = np.where(diagonal > 0, 1e-14 * diagonal, 1.0)  # frames without stars keep a solvable block
        border = self._eliminate(right, floor)
        common = right.shape[2]
        information = self.common - right.reshape(-1, common).T @ border.reshape(-1, common)
        return Reduced(information=0.5 * (information + information.T), scale=scale, border=border)

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
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    eigenvalues, eigenvectors, determined = _scaled_spectrum(matrix, scale)
    coordinates = (eigenvectors.T @ (right / scale)) * determined / np.where(determined, eigenvalues, 1.0)
    return np.asarray(eigenvectors @ coordinates / scale)


def spectrum(reduced: Reduced) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Eigenvalues (p,), eigenvectors (p, p) of the scaled information, and which of them carry information."""
    return _scaled_spectrum(reduced.information, np.where(reduced.scale > 0, reduced.scale, 1.0))


def _scaled_spectrum(matrix: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    eigenvalues, eigenvectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return eigenvalues, eigenvectors, eigenvalues > NULL_PART * max(float(eigenvalues[-1]), 0.0)
