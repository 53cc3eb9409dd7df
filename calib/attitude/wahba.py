"""Wahba's problem for many profile matrices at once: singular values, and the quaternion of the largest root.

The problem (Wahba 1965, SIAM Review 7, 409): find the rotation that makes ``sum w |v_cam - R v_ref|^2 / 2`` smallest,
which is the rotation that makes ``tr(R B^T)`` largest, with the profile matrix ``B = sum w v_cam v_ref^T``.

* `rotation_svd`: ``B = U diag(s1, s2, s3) V^T``, ``R = U diag(1, 1, det U det V) V^T`` (Markley 1988, J. Astronaut.
  Sci. 36, 245). Safe everywhere.
* `rotation_quest`: the largest root of the characteristic equation of Davenport's matrix by Newton's method from
  above, in the form that Markley gives for it (1993, J. Astronaut. Sci. 41, 261),

      (x^2 - |B|^2)^2 - 8 x det B - 4 |adj B|^2 = 0,

  then the quaternion as a column of the adjugate of ``K - x I``. QUEST (Shuster and Oh 1981, J. Guid. Control 4, 70)
  takes one column, which vanishes for a rotation by 180 deg, and turns the reference axes where that happens; its four
  turned axes are the four columns of the adjugate, so the largest of the four is taken and no rotation is special.
  The quartic has two roots close together when the field is narrow, which costs digits; one Newton step on the loss
  itself brings them back. Frames where the root is not found fall back to the eigenvectors of K.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from optics.arrays import FloatArray, IntArray

NEWTON_STEPS = 60
ROBUST_STEPS = 20
LEAST_DISTANCE_RAD = 1e-5
"""Reweighting of `rotations_of_groups`: steps, and the distance [rad] below which a star counts no more."""


def rotation_svd(profile: FloatArray) -> FloatArray:
    """Rotation matrices (f, 3, 3) that maximise ``tr(R B^T)`` for profile matrices B (f, 3, 3)."""
    u, _, vt = np.linalg.svd(profile)
    parity = np.linalg.det(u) * np.linalg.det(vt)
    u = u.copy()
    u[:, :, 2] *= np.sign(parity)[:, None]
    return np.asarray(u @ vt)


def rotations_of_groups(
    measured: FloatArray, reference: FloatArray, group: IntArray, groups: int, *, robust: bool
) -> FloatArray:
    """Rotations R with ``measured = R reference`` of groups of directions, all groups at once.

    Shapes: ``measured`` (n, 3), ``reference`` (n, 3), ``group`` (n,).
    """
    finite = np.all(np.isfinite(measured), axis=1)
    measured = np.where(finite[:, None], measured, 0.0)
    products = (measured[:, :, None] * reference[:, None, :]).reshape(-1, 9)
    weight = finite.astype(np.float64)
    rotation = np.broadcast_to(np.eye(3), (groups, 3, 3))
    for _ in range(ROBUST_STEPS if robust else 1):
        columns = [np.bincount(group, weight * products[:, i], minlength=groups) for i in range(9)]
        profile = np.asarray(np.stack(columns, axis=1).reshape(-1, 3, 3), np.float64)
        empty = ~np.any(profile, axis=(1, 2))
        profile[empty] = np.eye(3)
        rotation = rotation_svd(profile)
        distance = np.linalg.norm(measured - np.einsum("nij,nj->ni", rotation[group], reference), axis=1)
        weight = finite / np.maximum(distance, LEAST_DISTANCE_RAD)
    return rotation


def adjugate3(m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Adjugates (f, 3, 3) and determinants (f,) of matrices (f, 3, 3): ``m @ adjugate = determinant I``."""
    a, b = m[:, [1, 2, 0]], m[:, [2, 0, 1]]
    cofactors = a[:, :, [1, 2, 0]] * b[:, :, [2, 0, 1]] - a[:, :, [2, 0, 1]] * b[:, :, [1, 2, 0]]
    return np.asarray(cofactors.swapaxes(1, 2)), np.einsum("fi,fi->f", m[:, 0], cofactors[:, 0])


def rotation_quest(profile: FloatArray) -> FloatArray:
    """Rotation matrices (f, 3, 3) that maximise ``tr(R B^T)``; profiles (f, 3, 3) of weights that add up to 1."""
    davenport = _davenport(profile)
    root, converged = _largest_root(profile)
    quat, large = _adjugate_column(davenport - root[:, None, None] * np.eye(4))
    trusted = converged & large
    if not trusted.all():
        quat[~trusted] = np.linalg.eigh(davenport[~trusted])[1][:, :, 3]
    return _polished(_matrix(quat), profile)


def _davenport(profile: FloatArray) -> FloatArray:
    """Davenport's matrix K (f, 4, 4), scalar last: ``q^T K q = tr(R(q) B^T)`` (Lerner 1978, in Wertz, sec. 12.2.3)."""
    k = np.empty((len(profile), 4, 4))
    trace = np.trace(profile, axis1=1, axis2=2)
    k[:, :3, :3] = profile + profile.swapaxes(1, 2) - trace[:, None, None] * np.eye(3)
    for axis, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        k[:, axis, 3] = k[:, 3, axis] = profile[:, i, j] - profile[:, j, i]
    k[:, 3, 3] = trace
    return k


def _largest_root(profile: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Largest root (f,) of the characteristic equation, and whether Newton's method converged."""
    square = np.einsum("fij,fij->f", profile, profile)
    adjugate, determinant = adjugate3(profile)
    constant = 4.0 * np.einsum("fij,fij->f", adjugate, adjugate)
    x = np.ones(len(profile))
    converged = np.zeros(len(profile), bool)
    for _ in range(NEWTON_STEPS):
        value = (x * x - square) ** 2 - 8.0 * x * determinant - constant
        slope = 4.0 * x * (x * x - square) - 8.0 * determinant
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.where(converged, 0.0, value / slope)
        # Above the largest root value and slope are positive; where rounding turns a sign, the root is reached.
        converged |= ~(step > 4e-16)
        if converged.all():
            break
        x = np.where(converged, x, x - step)
    return x, converged & (x > 0)


def _adjugate_column(m: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Longest column (f, 4) of the adjugates of symmetric (f, 4, 4), as unit vectors, and whether it can be trusted."""
    # Cofactors by the six 2 x 2 minors of the upper and of the lower two rows.
    pairs = list(combinations(range(4), 2))
    upper = {(i, j): m[:, 0, i] * m[:, 1, j] - m[:, 0, j] * m[:, 1, i] for i, j in pairs}
    lower = {(i, j): m[:, 2, i] * m[:, 3, j] - m[:, 2, j] * m[:, 3, i] for i, j in pairs}

    def cofactors(row: int, minors: dict[tuple[int, int], FloatArray], sign: int) -> list[FloatArray]:
        out = []
        for column in range(4):
            a, b, c = (k for k in range(4) if k != column)
            value = m[:, row, a] * minors[b, c] - m[:, row, b] * minors[a, c] + m[:, row, c] * minors[a, b]
            out.append(sign * (-1) ** column * value)
        return out

    adjugate = np.stack(
        [
            np.stack(cofactors(1, lower, 1), axis=-1),
            np.stack(cofactors(0, lower, -1), axis=-1),
            np.stack(cofactors(3, upper, 1), axis=-1),
            np.stack(cofactors(2, upper, -1), axis=-1),
        ],
        axis=1,
    )
    best = np.argmax(np.abs(np.einsum("fii->fi", adjugate)), axis=1)
    column = adjugate[np.arange(len(m)), best]
    length = np.linalg.norm(column, axis=1)
    large = length > 1e-10
    return column / np.where(length > 0, length, 1.0)[:, None], large


def _matrix(quat: FloatArray) -> FloatArray:
    """Rotation matrices (f, 3, 3) of unit quaternions (f, 4), scalar last, with ``v_cam = R v_ref``."""
    vector, scalar = quat[:, :3], quat[:, 3]
    x, y, z = vector.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    square = scalar**2 - np.einsum("fi,fi->f", vector, vector)
    outer = vector[:, :, None] * vector[:, None, :]
    return np.asarray(square[:, None, None] * np.eye(3) + 2 * outer + 2 * scalar[:, None, None] * cross)


def _polished(rotation: FloatArray, profile: FloatArray) -> FloatArray:
    """One Newton step on ``tr(R B^T)``, and the result made orthogonal again."""
    s = profile @ rotation.swapaxes(1, 2)
    torque = np.stack([s[:, 2, 1] - s[:, 1, 2], s[:, 0, 2] - s[:, 2, 0], s[:, 1, 0] - s[:, 0, 1]], axis=1)
    hessian = np.trace(s, axis1=1, axis2=2)[:, None, None] * np.eye(3) - 0.5 * (s + s.swapaxes(1, 2))
    adjugate, determinant = adjugate3(hessian)
    regular = determinant > 1e-14 * np.abs(np.trace(adjugate, axis1=1, axis2=2))
    inverse = adjugate / np.where(regular, determinant, 1.0)[:, None, None]
    step = np.einsum("fij,fj->fi", inverse, torque)
    regular &= np.linalg.norm(step, axis=1) < 1e-2
    step = np.where(regular[:, None], step, 0.0)
    quat = np.concatenate([0.5 * step, np.ones((len(step), 1))], axis=1)
    return _matrix(quat / np.linalg.norm(quat, axis=1, keepdims=True)) @ rotation
