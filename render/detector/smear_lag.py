"""Smear of a frame transfer and lag, on expected charge.

Smear: a frame-transfer CCD without a shutter shifts the image under the light, ``transfer_line_us`` per row; every
pixel passes all rows of its column and collects their light for that time, on its way in and out. Lag: a fraction
``lag`` of the charge of the frame before stays in its pixel and is read with the next frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from render.detector.spec import Detector


def with_smear(light_e: NDArray[np.float64], detector: Detector, exposure_s: float) -> NDArray[np.float64]:
    """Light (h, w) [e-] with the light collected during the transfer of the frame."""
    fraction = detector.transfer_line_us * 1e-6 / exposure_s
    return light_e + fraction * light_e.sum(0) if fraction else light_e


def with_lag(charge_e: NDArray[np.float64], detector: Detector, before_e: NDArray[np.float64]) -> NDArray[np.float64]:
    """Charge (h, w) [e-] with the residual charge of the previous frame ``before_e``."""
    return charge_e + detector.lag * np.minimum(before_e, detector.full_well_e)
