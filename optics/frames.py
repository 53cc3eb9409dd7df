"""Frames and pixel conventions; all conversions between them.

* ``cam``: right-handed, +Z boresight into the sky, +X along increasing column, +Y along increasing row.
* ``lens``: right-handed, light travels towards +z; x_lens = -X_cam, y_lens = +Y_cam, z_lens = -Z_cam.
* ``pix``: (x, y) = (column, row), an integer is a pixel centre, the centre of the image is ((W-1)/2, (H-1)/2).

The lens inverts the image, and the lens frame is turned by 180 deg about Y_cam: a star towards +X_cam is imaged at a
larger column, a star towards +Y_cam at a larger row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from optics.arrays import FloatArray
from optics.errors import DomainError
from optics.units import DEG_RAD, RAD_DEG

Pair = tuple[FloatArray, FloatArray]


def field_direction(field_x_deg: ArrayLike, field_y_deg: ArrayLike) -> FloatArray:
    """Unit vector in cam towards a star at field angles: tan(field_x) = X/Z, tan(field_y) = Y/Z.

    Parameters
    ----------
    field_x_deg, field_y_deg : array
        Field angles [deg], broadcastable; positive towards increasing column and row.

    Returns
    -------
    (..., 3)
        Unit vectors in cam.

    Raises
    ------
    DomainError
        At 90 deg or more, or for values that are not finite.
    """
    fx, fy = np.broadcast_arrays(np.asarray(field_x_deg, float), np.asarray(field_y_deg, float))
    if not np.all((np.abs(fx) < 90) & (np.abs(fy) < 90)):
        raise DomainError("a field angle is not between -90 and 90 deg; the star would not be in front of the camera")
    v = np.stack([np.tan(fx * DEG_RAD), np.tan(fy * DEG_RAD), np.ones(fx.shape)], axis=-1)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def field_angles_deg(v_cam: ArrayLike) -> Pair:
    """Field angles [deg] of directions (..., 3) in cam; the inverse of `field_direction`."""
    v = np.asarray(v_cam, float)
    if not np.all(v[..., 2] > 0):
        raise DomainError("a direction points behind the camera: its Z_cam must be positive")
    return np.arctan2(v[..., 0], v[..., 2]) * RAD_DEG, np.arctan2(v[..., 1], v[..., 2]) * RAD_DEG


def equatorial_deg(v_icrs: ArrayLike) -> Pair:
    """Right ascension, 0 to 360, and declination [deg] of directions (..., 3) along icrs."""
    x, y, z = np.moveaxis(np.asarray(v_icrs, dtype=np.float64), -1, 0)
    return np.degrees(np.arctan2(y, x)) % 360.0, np.degrees(np.arctan2(z, np.hypot(x, y)))


def polar_direction(angle_deg: ArrayLike, azimuth_deg: ArrayLike = 0.0) -> FloatArray:
    """Unit vectors (..., 3) in cam at angles from the boresight and azimuths from columns towards rows [deg]."""
    a, p = np.broadcast_arrays(np.radians(angle_deg), np.radians(azimuth_deg))
    return np.stack([np.sin(a) * np.cos(p), np.sin(a) * np.sin(p), np.cos(a)], axis=-1)


def perpendicular(v: FloatArray) -> FloatArray:
    """Unit vectors (2, 3) perpendicular to a unit vector and each other, right-handed with it third."""
    first = np.cross(v, np.eye(3)[np.argmin(np.abs(v))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(v, first)])


def light_direction(v_cam: ArrayLike) -> FloatArray:
    """Direction of travel in the lens frame of the light of stars at ``v_cam`` (..., 3): (X, -Y, Z)."""
    return np.asarray(v_cam, float) * np.array([1.0, -1.0, 1.0])


def star_direction(d_lens: ArrayLike) -> FloatArray:
    """Direction in cam (..., 3) of the star whose light travels along ``d_lens`` in the lens frame."""
    return np.asarray(d_lens, float) * np.array([1.0, -1.0, 1.0])


def pixel_from_lens(x_mm: ArrayLike, y_mm: ArrayLike, *, pitch_mm: float, size_px: tuple[int, int]) -> Pair:
    """Pixel (column, row) of points of the image plane, of an image of ``size_px`` (width, height)."""
    width, height = size_px
    column = (width - 1) / 2 + np.asarray(x_mm, float) / pitch_mm
    return column, (height - 1) / 2 - np.asarray(y_mm, float) / pitch_mm


def _shifted(x: ArrayLike, y: ArrayLike, by: float) -> Pair:
    return np.asarray(x, float) + by, np.asarray(y, float) + by


def pixel_to_mitsuba(x_px: ArrayLike, y_px: ArrayLike) -> Pair:
    """Film position of a pixel: Mitsuba counts from the corner, pixel centres lie at +0.5."""
    return _shifted(x_px, y_px, 0.5)


def pixel_to_fits(x_px: ArrayLike, y_px: ArrayLike) -> Pair:
    """FITS image coordinates: the first pixel's centre is (1, 1) (FITS standard 4.0, sec. 8.1)."""
    return _shifted(x_px, y_px, 1.0)


def pixel_from_fits(x_fits: ArrayLike, y_fits: ArrayLike) -> Pair:
    """Pixel of FITS image coordinates."""
    return _shifted(x_fits, y_fits, -1.0)


def pixel_to_tetra3(x_px: ArrayLike, y_px: ArrayLike) -> Pair:
    """tetra3 / cedar-solve centroids: (y, x), the corner of the first pixel is (0, 0)."""
    x, y = _shifted(x_px, y_px, 0.5)
    return y, x


def pixel_to_tetra3rs(x_px: ArrayLike, y_px: ArrayLike, *, size_px: tuple[int, int]) -> Pair:
    """tetra3rs centroids: (x, y) from the centre of the image, y down."""
    width, height = size_px
    return np.asarray(x_px, float) - (width - 1) / 2, np.asarray(y_px, float) - (height - 1) / 2
