"""Rotation vectors: exponential map (Rodrigues' formula) and right Jacobian of SO(3), for arrays of them."""

from __future__ import annotations

import numpy as np

from optics.arrays import FloatArray


def skew(v: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) with ``skew(v) @ w = v x w``."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def exponential(vector: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]; Rodrigues' formula, for the hot path."""
    cross = skew(vector)
    angle2 = np.einsum("...i,...i->...", vector, vector)
    first, second, _ = _series(angle2)
    return np.asarray(np.eye(3) + first[..., None, None] * cross + second[..., None, None] * (cross @ cross))


def right_jacobian(vector: FloatArray) -> FloatArray:
    """Matrices J (..., 3, 3) with ``exp(v + dv) = exp(v) exp(J dv)`` to first order (Chirikjian 2012, eq. 10.86)."""
    cross = skew(vector)
    angle2 = np.einsum("...i,...i->...", vector, vector)
    _, second, third = _series(angle2)
    return np.asarray(np.eye(3) - second[..., None, None] * cross + third[..., None, None] * (cross @ cross))


def _series(angle2: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """sin a / a, (1 - cos a) / a^2, (a - sin a) / a^3 of squared angles."""
    small = angle2 < 1e-4
    a2 = np.where(small, 1.0, angle2)
    a = np.sqrt(a2)
    return (
        np.where(small, 1.0 - angle2 / 6.0 + angle2**2 / 120.0, np.sin(a) / a),
        np.where(small, 0.5 - angle2 / 24.0 + angle2**2 / 720.0, (1.0 - np.cos(a)) / a2),
        np.where(small, 1.0 / 6.0 - angle2 / 120.0 + angle2**2 / 5040.0, (a - np.sin(a)) / (a * a2)),
    )
