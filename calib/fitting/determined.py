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
    value: FloatArray,
    vector: FloatArray,
    known: BoolArray,
    scale: FloatArray,
    names: tuple[str, ...],
    *,
    factor: float = 1.0,
) -> Determined:
    """Covariance from the eigenvalues of the scaled information.

    Shapes: ``value`` (p,), ``vector`` (p,), ``known`` (p,), ``scale`` (p,).
    """
    inverse = 1.0 / np.where(scale > 0, scale, 1.0)
    part = vector[:, known] * inverse[:, None]
    covariance = factor * (part / value[known]) @ part.T
    condition = float(np.sqrt(value[-1] / value[0])) if known.all() and len(value) else float("inf")
    lost = np.sum(vector[:, ~known] ** 2, axis=1) > TAKES_PART
    covariance[lost, :] = 0.0
    covariance[:, lost] = 0.0
    covariance[lost, lost] = np.inf
    unknown = [name for name, gone in zip(names, lost, strict=True) if gone]
    return Determined(covariance, condition, unknown, _message(unknown, vector[:, ~known] * inverse[:, None], names))


def covariance_of_jacobian(jacobian: FloatArray, names: tuple[str, ...], *, factor: float = 1.0) -> Determined:
    """Covariance ``factor (J^T J)^-1`` from whitened derivatives (m, p) of the residuals, by singular values."""
    scale = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(scale > 0, scale, 1.0)
    if len(scaled) < len(names):
        scaled = np.concatenate([scaled, np.zeros((len(names) - len(scaled), len(names)))])
    _, size, vt = np.linalg.svd(scaled, full_matrices=False)
    known = size > NULL_RATIO * size[0]
    return covariance_of_spectrum(size[::-1] ** 2, vt[::-1].T, known[::-1], scale, names, factor=factor)


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
    turned = np.where(np.isfinite(derivative), derivative, 0.0)
    out = turned @ finite @ turned.T
    touched = np.any((np.abs(derivative) > 1e-12) & lost | ~np.isfinite(derivative), axis=1)
    out[touched, :] = 0.0
    out[:, touched] = 0.0
    out[touched, touched] = np.inf
    return np.asarray(0.5 * (out + out.T))
