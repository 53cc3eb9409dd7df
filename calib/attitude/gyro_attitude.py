"""Attitude by integration of gyro rates, and attitudes of a camera linked by it.

A gyro gives the mean rate of each interval in body axes. With the rotation vector p of an interval, the body at its end
seen from its start is ``exp(-p)`` (a body that turns forward sees the world turn back), and the attitudes are the exact
products of these, later ones on the left:

    R(t_k, t_0) = exp(-p_k) ... exp(-p_2) exp(-p_1).

For a rotation about a fixed direction p is the increment ``d = rate * step``, and the result is exact to rounding.
Where the direction moves within a step (coning), Bortz's equation (1971, IEEE Trans. AES 7, 61) adds
``1/2 int d x w dt``. For a rate that is linear in time over two intervals this is

    p_k = d_k + h_k^3 / 12 * (w_(k-1) x w_k) / ((h_(k-1) + h_k) / 2),

which is Savage's ``d_(k-1) x d_k / 12`` (1998, J. Guid. Control Dyn. 21, 19) for equal steps; the first interval uses
its follower. The error left is of the fourth order in the step where the plain sum has the second.

Link (ACF17 eq. 6). The gyro tells how its body turned, G_k = C_b1_to_bk; with the installation A (camera from gyro
body) and the attitude R_1 of the camera in the first frame, R_k = (A G_k A^T) R_1. The printed text calls C_i_to_S the
matrix "from S to i"; eq. 1 says what is meant.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import DomainError

HOUR_S = 3600.0
SLACK_S = 1e-9


class _Quaternions(NamedTuple):
    """Unit quaternions as four arrays of one shape: products run over contiguous memory."""

    x: FloatArray
    y: FloatArray
    z: FloatArray
    w: FloatArray

    def __matmul__(self, earlier: _Quaternions) -> _Quaternions:
        """The rotation ``earlier`` followed by this one."""
        (ax, ay, az, aw), (bx, by, bz, bw) = self, earlier
        return _Quaternions(
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        )

    def at(self, index: NDArray[np.int64] | slice) -> _Quaternions:
        """Quaternions of some intervals (last axis)."""
        return _Quaternions(*(part[..., index] for part in self))


def _from_turns(turn: FloatArray) -> _Quaternions:
    """Quaternions (...,) of ``exp(-turn)`` for rotation vectors (..., 3)."""
    x, y, z = -0.5 * turn[..., 0], -0.5 * turn[..., 1], -0.5 * turn[..., 2]
    half = np.sqrt(x * x + y * y + z * z)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(half > 0, np.sin(half) / half, 1.0)
    return _Quaternions(scale * x, scale * y, scale * z, np.cos(half))


def _running_products(q: _Quaternions) -> _Quaternions:
    """Products of the first 1, 2, ... n rotations along the last axis, later ones on the left; rounding grows as
    log2(n)."""
    n = q.x.shape[-1]
    if n == 1:
        return q
    pairs = _running_products(q.at(slice(1, None, 2)) @ q.at(slice(0, n - 1, 2)))
    filled = q.at(slice(2, None, 2)) @ pairs.at(slice(0, (n - 1) // 2))
    out = _Quaternions(*(np.empty_like(part) for part in q))
    for product, first, odd, even in zip(out, q, pairs, filled, strict=True):
        product[..., 0] = first[..., 0]
        product[..., 1::2] = odd
        product[..., 2::2] = even
    return out


def _turns(step: FloatArray, rate: FloatArray, coning: bool) -> FloatArray:
    """Rotation vectors (..., n, 3) of the intervals."""
    turn = rate * step[:, None]
    if coning and len(step) > 1:
        distance = 0.5 * (step[1:] + step[:-1])
        bend = np.cross(rate[..., :-1, :], rate[..., 1:, :]) / distance[:, None]
        turn[..., 1:, :] += (step[1:] ** 3 / 12.0)[:, None] * bend
        turn[..., 0, :] += step[0] ** 3 / 12.0 * bend[..., 0, :]
    return turn


def _checked(time_s: ArrayLike, rate: ArrayLike, axes: int) -> tuple[FloatArray, FloatArray]:
    time, rates = np.asarray(time_s, float), np.asarray(rate, float)
    wanted = "(n, 3)" if axes == 2 else "(r, n, 3)"
    if rates.ndim != axes or rates.shape[-1] != 3 or rates.shape[-2] < 1:
        raise DomainError(f"rate_rad_per_s has shape {rates.shape}; rates of n intervals, {wanted}, are needed")
    if time.shape != (rates.shape[-2] + 1,):
        raise DomainError(
            f"time_s has shape {time.shape} for {rates.shape[-2]} rates; a rate is the mean over an interval, so the "
            f"{rates.shape[-2] + 1} ends of the intervals are needed"
        )
    if not (np.isfinite(time).all() and (np.diff(time) > 0).all()):
        raise DomainError("time_s must be finite and increasing [s]")
    if not np.isfinite(rates).all():
        bad = np.argwhere(~np.isfinite(rates))[0].tolist()
        raise DomainError(
            f"rate_rad_per_s: value at index {bad} is not finite; fill gaps of the gyro before integrating"
        )
    largest = np.abs(rates).max() * np.diff(time).max()
    if largest > np.pi:
        raise DomainError(
            f"the body turns by up to {largest:.3g} rad per axis within one interval; less than pi is needed: "
            "rates are in rad/s, times in s"
        )
    return time, rates


def _requested(time: FloatArray, at_s: ArrayLike | None) -> FloatArray:
    if at_s is None:
        return time
    at = np.asarray(at_s, float)
    if at.ndim != 1:
        raise DomainError(f"at_s has shape {at.shape}; times of shape (f,) are needed")
    slack = SLACK_S + 1e-12 * max(abs(time[0]), abs(time[-1]))
    wrong = ~((at >= time[0] - slack) & (at <= time[-1] + slack))
    if wrong.any():
        raise DomainError(
            f"at_s = {at[wrong][0]:g} s lies outside of the record, which runs from {time[0]:g} to {time[-1]:g} s"
        )
    return np.clip(at, time[0], time[-1])


def _integrated(time: FloatArray, rate: FloatArray, at_s: ArrayLike | None, coning: bool) -> FloatArray:
    """Quaternions (..., f, 4), scalar last, of the body at the requested times from the body at the first sample."""
    at = _requested(time, at_s)
    step = np.diff(time)
    turn = _turns(step, rate, coning)
    products = _running_products(_from_turns(turn))
    # The interval of each requested time, and how much of it has passed; its rate is taken as constant there.
    interval = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(step) - 1)
    part = (at - time[interval]) / step[interval]
    rest = _from_turns(part[:, None] * turn[..., interval, :])
    before = products.at(np.maximum(interval - 1, 0))
    first = interval == 0
    before = _Quaternions(*(np.where(first, unit, p) for p, unit in zip(before, (0.0, 0.0, 0.0, 1.0), strict=True)))
    return np.stack(rest @ before, axis=-1)


def integrate_rates(
    time_s: ArrayLike, rate_rad_per_s: ArrayLike, at_s: ArrayLike | None = None, *, coning: bool = True
) -> Rotation:
    """Attitude of the body relative to the first time.

    Shapes: ``time_s`` (n + 1,), ``rate_rad_per_s`` (n, 3), ``at_s`` (f,).
    """
    time, rate = _checked(time_s, rate_rad_per_s, 2)
    return Rotation.from_quat(_integrated(time, rate, at_s, coning))


def integrate_rates_many(
    time_s: ArrayLike, rate_rad_per_s: ArrayLike, at_s: ArrayLike | None = None, *, coning: bool = True
) -> tuple[Rotation, ...]:
    """As `integrate_rates`, for r records on the same times.

    Shapes: ``time_s`` (n + 1,), ``rate_rad_per_s`` (r, n, 3).
    """
    time, rates = _checked(time_s, rate_rad_per_s, 3)
    return tuple(Rotation.from_quat(q) for q in _integrated(time, rates, at_s, coning))


def link_attitudes(first: Rotation, installation: Rotation, gyro_rotation: Rotation) -> Rotation:
    """Attitudes of all frames from the first one (eq. 6): ``R_k = A G_k A^T R_1``."""
    return installation * gyro_rotation * installation.inv() * first
