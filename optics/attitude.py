"""Attitudes: conversion between angles and rotations, attitude errors, directions of stars for a moving observer.

An attitude is a `scipy.spatial.transform.Rotation`, cam from icrs: ``v_cam = R v_icrs``. Roll is the position angle of
*up* in the image (towards smaller rows) at the boresight, from north through east. At roll 0 north is up and east, as
seen on the sky, is to the left.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import DEG_RAD, RAD_ARCSEC, RAD_DEG


def attitude_from_angles(ra_deg: ArrayLike, dec_deg: ArrayLike, roll_deg: ArrayLike = 0.0) -> Rotation:
    """Attitude of a camera from right ascension, declination and roll.

    Parameters
    ----------
    ra_deg, dec_deg : float or (n,)
        Right ascension and declination of the boresight, icrs [deg].
    roll_deg : float or (n,)
        Position angle of up in the image, from north through east [deg].

    Returns
    -------
    Rotation
        cam from icrs, single or n of them.

    Raises
    ------
    DomainError
        A declination beyond the poles, or a value that is not finite.
    """
    ra, dec, roll = np.broadcast_arrays(*(np.asarray(value, float) for value in (ra_deg, dec_deg, roll_deg)))
    if not (np.isfinite(ra).all() and np.isfinite(dec).all() and np.isfinite(roll).all()):
        raise DomainError("right ascension, declination and roll must be finite numbers")
    if dec.size and float(np.abs(dec).max()) > 90.0:
        raise DomainError(f"declination {float(dec.flat[np.abs(dec).argmax()]):g} deg is outside -90 ... 90 deg")
    boresight, north, east = _triad(ra * DEG_RAD, dec * DEG_RAD)
    angle = (roll * DEG_RAD)[..., None]
    up = np.cos(angle) * north + np.sin(angle) * east
    return Rotation.from_matrix(np.stack([np.cross(boresight, up), -up, boresight], axis=-2))


def angles_from_attitude(attitude: Rotation) -> tuple[float, float, float]:
    """Right ascension (0 ... 360), declination and roll (0 ... 360) [deg] of one attitude cam from icrs.

    Parameters
    ----------
    attitude : Rotation
        cam from icrs, a single one.

    Returns
    -------
    (float, float, float)
        Right ascension, declination and roll [deg].
    """
    _, down, boresight = attitude.as_matrix()
    ra = np.arctan2(boresight[1], boresight[0])
    dec = np.arctan2(boresight[2], np.hypot(boresight[0], boresight[1]))
    _, north, east = _triad(ra, dec)
    roll = np.arctan2(-down @ east, -down @ north)
    return _wrapped_deg(float(ra * RAD_DEG)), float(dec * RAD_DEG), _wrapped_deg(float(roll * RAD_DEG))


def _wrapped_deg(angle_deg: float) -> float:
    """The same angle from 0 to below 360; a tiny negative one modulo 360 rounds to 360."""
    wrapped = angle_deg % 360.0
    return wrapped if wrapped < 360.0 else 0.0


def quat_xyzw(attitude: Rotation) -> FloatArray:
    """Quaternion (..., 4) as files hold it: scalar last and not negative."""
    return np.asarray(attitude.as_quat(canonical=True))


def _triad(ra: Any, dec: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Boresight, north and east (..., 3) of angles [rad]."""
    ra, dec = np.asarray(ra, float), np.asarray(dec, float)
    cos_ra, sin_ra, cos_dec, sin_dec = np.cos(ra), np.sin(ra), np.cos(dec), np.sin(dec)
    zero = np.zeros_like(cos_ra)
    return (
        np.stack([cos_ra * cos_dec, sin_ra * cos_dec, sin_dec], axis=-1),
        np.stack([-cos_ra * sin_dec, -sin_ra * sin_dec, cos_dec], axis=-1),
        np.stack([-sin_ra, cos_ra, zero], axis=-1),
    )


def attitude_error_arcsec(estimated: Rotation, truth: Rotation) -> FloatArray:
    """Rotation vector in cam that turns the true attitude into the estimated one: ``estimated = exp(error) truth``.

    Parameters
    ----------
    estimated, truth : Rotation
        cam from reference, one or f of them.

    Returns
    -------
    (3,) or (f, 3)
        Errors about cam x, y (cross-boresight) and z (roll) [arcsec].
    """
    return np.asarray((estimated * truth.inv()).as_rotvec() * RAD_ARCSEC)
