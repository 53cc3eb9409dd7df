"""TRIAD: attitude from two directions, with its covariance.

The first direction is met exactly, the second defines the plane (Black 1964, AIAA Journal 2, 1350; Shuster and Oh 1981,
J. Guid. Control 4, 70). With the orthonormal columns M = [a b c], a along the first direction, b along the cross
product of both, c = a x b, the attitude is ``M_reference M_observed^T``. Directions that enclose another angle in both
frames do no harm: only the plane of the second one counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from calib.fitting.rotation_vectors import skew
from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.records import freeze
from optics.units import RAD_DEG

PARALLEL_RAD = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class TriadAttitude:
    """Attitude from two directions."""

    rotation: Rotation  # Reference frame from observed frame
    covariance_rad2: FloatArray  # (3, 3) Of the error's rotation vector in the reference frame
    # Angle of the two observed directions minus that of the references [rad]; far from zero: wrong directions
    angle_error_rad: float

    def __post_init__(self) -> None:
        freeze(self, "covariance_rad2", shape=(3, 3))


def angle_between_rad(first: ArrayLike, second: ArrayLike) -> float:
    """Angle of two vectors, accurate at any size."""
    u, v = np.asarray(first, float), np.asarray(second, float)
    return float(np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v))


def triad(
    reference: Sequence[ArrayLike], observed: Sequence[ArrayLike], *, covariance_rad2: ArrayLike = ((0.0,),)
) -> TriadAttitude:
    """Attitude that takes the observed frame to the reference frame (CUBE09 eq. 1-5).

    Parameters
    ----------
    reference, observed : (2, 3)
        The same two directions in both frames; the first is met exactly.
    covariance_rad2 : (2, 3, 3), optional
        Covariance of each observed unit vector, in the observed frame; nothing along the vector. By default zero.

    Raises
    ------
    DomainError
        If the two directions are parallel within 0.01 rad, or there are not two.
    """
    if len(reference) != 2 or len(observed) != 2:
        raise DomainError(f"TRIAD takes two directions; {len(reference)} and {len(observed)} were given")
    matrix = _columns(*reference) @ _columns(*observed).T
    spread = np.broadcast_to(np.asarray(covariance_rad2, float), (2, 3, 3))
    unit = np.asarray(observed, float) / np.linalg.norm(np.asarray(observed, float), axis=1, keepdims=True)
    return TriadAttitude(
        rotation=Rotation.from_matrix(matrix),
        covariance_rad2=_covariance(matrix, unit, spread),
        angle_error_rad=angle_between_rad(*observed) - angle_between_rad(*reference),
    )


def _columns(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """[a b c] of CUBE09 eq. 1 and 3."""
    u, v = np.asarray(first, float), np.asarray(second, float)
    angle = angle_between_rad(u, v)
    if min(angle, np.pi - angle) < PARALLEL_RAD:
        raise DomainError(
            f"the two directions enclose {angle * RAD_DEG:.4f} deg; two that are not parallel are needed (at least "
            f"{PARALLEL_RAD * RAD_DEG:.2f} deg apart)"
        )
    a = u / np.linalg.norm(u)
    b = np.cross(u, v)
    b /= np.linalg.norm(b)
    return np.column_stack([a, b, np.cross(a, b)])


def _covariance(matrix: FloatArray, observed: FloatArray, spread: FloatArray) -> FloatArray:
    """First-order covariance of the error e in the reference frame: ``e x b1 = -db1``; about b1 the second is turned
    into the plane of the reference, ``n . (db2 + e x b2) = 0`` with n = b1 x b2 / |.|."""
    b1, b2 = (matrix @ observed.T).T
    normal = np.cross(b1, b2)
    sine = np.linalg.norm(normal)
    normal = normal / sine
    by_first = -skew(b1)
    about = -np.outer(b1, normal @ (-skew(b2) @ by_first)) / sine
    by_second = -np.outer(b1, normal) / sine
    total = np.zeros((3, 3))
    for jacobian, covariance in zip((by_first + about, by_second), spread, strict=True):
        by_observed = jacobian @ matrix
        total += by_observed @ covariance @ by_observed.T
    return total
