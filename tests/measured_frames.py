"""Measured frames without an image: detections at given places."""

from typing import Any

import numpy as np

from calib.measure.reduced_frame import MeasuredFrame
from calib.records import StarTable


def measured_frame(pixel_px: Any, *, flux_e: Any = 1000.0, flags: Any = 0, sigma_px: float = 0.1) -> MeasuredFrame:
    """Detections (n, 2), of which those with a flag are not fit."""
    x, y = np.reshape(np.asarray(pixel_px, float), (-1, 2)).T
    n = len(x)
    bits = np.broadcast_to(np.asarray(flags, np.uint32), n).copy()
    stars = StarTable(
        x_px=x,
        y_px=y,
        flux_e=np.broadcast_to(np.asarray(flux_e, float), n).copy(),
        background_e=np.zeros(n),
        covariance=np.tile(np.diag([sigma_px**2, sigma_px**2, 1.0]), (n, 1, 1)),
        chi2=np.full(n, np.nan),
        iterations=np.zeros(n, np.int64),
        flags=bits,
    )
    return MeasuredFrame(stars=stars, fit=bits == 0, detected_px=np.column_stack([x, y]))
