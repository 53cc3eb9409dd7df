"""Flag bits for faults of a star; flagged stars stay in the data."""

from __future__ import annotations

from enum import IntFlag

import numpy as np
from numpy.typing import NDArray


class StarFlag(IntFlag):
    """Bit values of ``StarTable.flags``.

    SATURATED
        A pixel of the window reached full well or the end of the converter (left out of the measurement).
    EDGE
        The window reaches beyond the image.
    BLEND
        Another detected star lies inside the window.
    DEFECT
        A pixel of the window is defective or not finite (left out of the measurement).
    SPIKE
        Sharper than any star: nearly all light is in a single pixel (hot pixel, cosmic ray).
    NOT_CONVERGED
        The iteration ended without reaching its tolerance; the values are from the last step.
    NO_DATA
        No usable pixel or no light: position and flux are NaN.
    PIXEL_PHASE
        The error that depends on the position within the pixel exceeds half the stated standard deviation, which does
        not include it: the star is too narrow for this centroider, or reaches beyond its window
        (``StarTable.width_px`` and ``phase_error_px``). The star may be used; its error is larger than stated.
    WIDTH_UNKNOWN
        Gaussian fit with free widths: so much of the light is in single pixels that the width along an axis, and with
        it the position, is not determined (`calib.measure.centroiding.gaussian.WIDTH_PRIOR_PX`). The covariance
        includes this for stars down to a sigma of a quarter of a pixel, and is too small for narrower ones. The star
        may be used; it is measured better with the width of the other stars, ``sigma_px=``.
    TRAIL
        Part of a line of light (satellite, aeroplane): light lies between this detection and others in a row.
    UNDETERMINED
        The pixels do not determine the star: the fit diverged (impossible flux, or position outside the window).
        Position and flux are the moments of the light in the window, with the covariance of a matched filter.
    """

    SATURATED = 1
    EDGE = 2
    BLEND = 4
    DEFECT = 8
    SPIKE = 16
    NOT_CONVERGED = 32
    NO_DATA = 64
    PIXEL_PHASE = 128
    WIDTH_UNKNOWN = 256
    TRAIL = 512
    UNDETERMINED = 1024


UNFIT = (
    StarFlag.SATURATED
    | StarFlag.EDGE
    | StarFlag.BLEND
    | StarFlag.DEFECT
    | StarFlag.SPIKE
    | StarFlag.NOT_CONVERGED
    | StarFlag.NO_DATA
    | StarFlag.TRAIL
    | StarFlag.UNDETERMINED
)
"""Flags that keep a star out of an attitude."""


def has_flag(flags: NDArray[np.uint32], flag: StarFlag) -> NDArray[np.bool_]:
    """Whether any bit of ``flag`` is set, element by element."""
    return (np.asarray(flags) & np.uint32(int(flag))) != 0


def describe_flags(value: int) -> str:
    """Names of the bits set in ``value``, joined by ``|``; an empty string for none."""
    return "|".join(flag.name or "" for flag in StarFlag if int(value) & flag)
