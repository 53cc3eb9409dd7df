"""Euler angles of attitudes as ACF17 has them (eq. 1-2), and their rates.

An attitude C from frame i to frame S, ``v_S = C v_i``, is

    C = R_y(a2) R_x(a1) R_z(a3),

    R_x(a) = [[1, 0, 0], [0, cos a, sin a], [0, -sin a, cos a]]
    R_y(a) = [[cos a, 0, -sin a], [0, 1, 0], [sin a, 0, cos a]]
    R_z(a) = [[cos a, sin a, 0], [-sin a, cos a, 0], [0, 0, 1]]

which turn the frame, not the vector. At a1 = +-90 deg only a3 -+ a2 is defined. The initial attitude has the angles
phi, the installation (camera from gyro body, C_b_to_S) the angles theta.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import DomainError

LOCKED_COSINE = 1e-9
"""Cosine of a1 below which a2 and a3 are no longer separable: a change of 1e-9 rad moves them by a radian."""


def rotation_of_angles(angle_rad: ArrayLike) -> Rotation:
    """Rotation R_y(a2) R_x(a1) R_z(a3) of angles (3,) or (n, 3) [rad]."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    if angle.ndim not in (1, 2) or angle.shape[-1] != 3 or not np.all(np.isfinite(angle)):
        raise DomainError(f"attitude angles of shape {angle.shape}: three finite angles [rad] are needed")
    # the matrices turn frames: R_x(a) is the rotation of vectors by -a
    return Rotation.from_euler("YXZ", -angle[..., [1, 0, 2]])


def angles_of_rotation(rotation: Rotation) -> FloatArray:
    """Angles (3,) or (n, 3) [rad] of a rotation: a1 in [-90, 90] deg, a2 and a3 in (-180, 180] deg.

    At a1 = +-90 deg, where only their sum or difference is defined, a3 is what is left when a2 = 0.
    """
    c = rotation.as_matrix()
    a1 = np.arcsin(np.clip(c[..., 1, 2], -1.0, 1.0))
    locked = np.hypot(c[..., 1, 0], c[..., 1, 1]) < 1e-12
    a2 = np.where(locked, 0.0, np.arctan2(-c[..., 0, 2], c[..., 2, 2]))
    a3 = np.where(locked, np.arctan2(c[..., 0, 1], c[..., 0, 0]), np.arctan2(-c[..., 1, 0], c[..., 1, 1]))
    return np.stack([a1, a2, a3], axis=-1)


def increment_per_angle(angle_rad: ArrayLike) -> FloatArray:
    """Rotation vector, in the turned frame, per change of each angle: (3, 3), ``w = J @ d_angle``.

    C(a + da) = exp([w]x) C(a); a frame rotation by da2 about y is the vector rotation -da2 e_y, the one by da1 about x
    comes after R_y, and so on.
    """
    angle = np.asarray(angle_rad, dtype=np.float64)
    y = rotation_of_angles([0.0, angle[1], 0.0])
    yx = rotation_of_angles([angle[0], angle[1], 0.0])
    return -np.column_stack([y.apply([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0], yx.apply([0.0, 0.0, 1.0])])


def angle_per_increment(angle_rad: ArrayLike) -> FloatArray:
    """Inverse (3, 3) of `increment_per_angle`: change of each angle per rotation vector.

    At a1 = +-90 deg, where only the sum or the difference of the other two is defined, their rows are infinite: no
    data determine them.
    """
    angle = np.asarray(angle_rad, dtype=np.float64)
    if abs(np.cos(angle[0])) >= LOCKED_COSINE:
        return np.asarray(np.linalg.inv(increment_per_angle(angle)))
    out = np.linalg.pinv(increment_per_angle(angle))
    out[1:] = np.inf
    return np.asarray(out)
