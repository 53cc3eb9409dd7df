"""Covariance of the determined unknowns, and the names of undetermined ones; for every estimator.

An eigenvalue of the scaled information at rounding level is no information. A pseudo-inverse would treat its direction
as known without error; here every unknown involved has an infinite variance and is named, with the undetermined
combination.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from optics.arrays import BoolArray, FloatArray

NULL_RATIO = 1e-10  # singular values of the scaled Jacobian below this part of the largest one are rounding
TAKES_PART = 1e-9  # squared component of an unknown in an undetermined direction above which it takes part


class Determined(NamedTuple):
    """Covariance (p, p), infinite on the diagonal and zero off it for undetermined unknowns; the condition number of
    the scaled Jacobian; the names of the unknowns that are not determined, and one line on them (or nothing)."""

    covariance: FloatArray
    condition: float
    unknown: list[str]
    message: str


def covariance_of_spectrum(
    eigenvalues: FloatArray,
    eigenvectors: FloatArray,
    determined: BoolArray,
    scale: FloatArray,
    names: tuple[str, ...],
    *,
    factor: float = 1.0,
) -> Determined:
    """Covariance from the spectrum (`calib.fitting.block_arrow.spectrum`) of the scaled information."""
    directions = eigenvectors / np.where(scale > 0, scale, 1.0)[:, None]
    known_directions = directions[:, determined]
    covariance = factor * (known_directions / eigenvalues[determined]) @ known_directions.T
    full_rank = determined.all() and len(eigenvalues) > 0
    condition = float(np.sqrt(eigenvalues[-1] / eigenvalues[0])) if full_rank else float("inf")
    lost = np.sum(eigenvectors[:, ~determined] ** 2, axis=1) > TAKES_PART
    _make_infinite(covariance, lost)
    unknown = [name for name, gone in zip(names, lost, strict=True) if gone]
    return Determined(covariance, condition, unknown, _message(unknown, directions[:, ~determined], names))


def _make_infinite(covariance: FloatArray, lost: BoolArray) -> None:
    covariance[lost, :] = 0.0
    covariance[:, lost] = 0.0
    covariance[lost, lost] = np.inf


def covariance_of_jacobian(jacobian: FloatArray, names: tuple[str, ...], *, factor: float = 1.0) -> Determined:
    """Covariance ``factor (J^T J)^-1`` from whitened derivatives (m, p) of the residuals, by singular values."""
    scale = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(scale > 0, scale, 1.0)
    if len(scaled) < len(names):
        scaled = np.concatenate([scaled, np.zeros((len(names) - len(scaled), len(names)))])
    _, singular_values, vt = np.linalg.svd(scaled, full_matrices=False)
    values, determined = singular_values[::-1], singular_values[::-1] > NULL_RATIO * singular_values[0]
    return covariance_of_spectrum(values**2, vt[::-1].T, determined, scale, names, factor=factor)


def _message(unknown: list[str], direction: FloatArray, names: tuple[str, ...]) -> str:
    """One line: the unknowns, and the combination of them that the data do not see if it is a single one."""
    if not unknown:
        return ""
    text = f"not determined by these data: {', '.join(unknown)}"
    if direction.shape[1] != 1 or len(unknown) < 2:
        return text
    along = direction[:, 0] / np.abs(direction[:, 0]).max()
    terms = [f"{part:+.3g} {name}" for part, name in zip(along, names, strict=True) if name in unknown]
    return f"{text} (free to change together by {', '.join(terms)})"


def transformed_covariance(covariance: FloatArray, derivative: FloatArray) -> FloatArray:
    """Covariance after a change of coordinates (q, p).

    Infinite variances stay infinite in every coordinate that depends on them; so is that of a coordinate whose
    derivative is not finite.
    """
    lost = ~np.isfinite(np.diagonal(covariance))
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    finite_derivative = np.where(np.isfinite(derivative), derivative, 0.0)
    out = finite_derivative @ finite @ finite_derivative.T
    _make_infinite(out, np.any((np.abs(derivative) > 1e-12) & lost | ~np.isfinite(derivative), axis=1))
    return np.asarray(0.5 * (out + out.T))
