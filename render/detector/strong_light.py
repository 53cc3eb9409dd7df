"""What bright light does beyond its own pixels: smear of a frame transfer, lag, blooming.

All three act on expected charge, before it is drawn.

* **Smear.** A frame-transfer CCD without a shutter shifts the image under the light, ``transfer_line_us`` per row:
  every pixel passes all rows of its column and collects their light for that time, on its way in and out.
* **Lag.** A share ``lag`` of the charge of the frame before stays in its pixel and is read with the next one.
* **Blooming.** Charge beyond the full well goes into the drain of an anti-blooming structure, but for a share
  ``blooming``, which runs along the column in equal parts up and down and fills wells there; what reaches the ends of
  the column is lost.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from render.detector.spec import Detector

SURELY_FULL_SIGMA = 6.0
"""Standard deviations above the full well from which it is full in every draw."""


def column_effects(detector: Detector) -> bool:
    """Whether light in one row of a detector changes others."""
    return bool(detector.blooming or detector.transfer_line_us)


def with_smear(light_e: NDArray[np.float64], detector: Detector, exposure_s: float) -> NDArray[np.float64]:
    """Light (h, w) [e-] with the light collected during the transfer of the frame."""
    share = detector.transfer_line_us * 1e-6 / exposure_s
    return light_e + share * light_e.sum(0) if share else light_e


def with_lag(charge_e: NDArray[np.float64], detector: Detector, before_e: NDArray[np.float64]) -> NDArray[np.float64]:
    """Charge (h, w) [e-] with the residual charge of the previous frame ``before_e``."""
    return charge_e + detector.lag * np.minimum(before_e, detector.full_well_e)


def bloomed(charge_e: NDArray[np.float64], detector: Detector) -> NDArray[np.float64]:
    """Charge (h, w) [e-] after the excess over full wells has spread along the columns."""
    well = detector.full_well_e
    excess = np.maximum(charge_e - well, 0.0)
    columns = np.flatnonzero(excess.any(0))
    if not detector.blooming or not len(columns):
        return charge_e
    held = np.minimum(charge_e[:, columns], well)
    running = 0.5 * detector.blooming * excess[:, columns]
    for rows in (range(len(held)), range(len(held) - 1, -1, -1)):
        carried = np.zeros(len(columns))
        for row in rows:
            taken = np.minimum(carried, well - held[row])
            held[row] += taken
            carried += running[row] - taken
    result = charge_e.copy()
    full = held >= well * (1.0 - 1e-12)
    sure = well + SURELY_FULL_SIGMA * np.sqrt(well)
    result[:, columns] = np.where(full, np.maximum(charge_e[:, columns], sure), held)
    return result
