"""Full well: charge beyond the saturation capacity of a pixel is drained, or blooms along its column."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.detector.spec import Detector

SURELY_FULL_SIGMA = 6.0
"""Standard deviations above the full well from which it is full in every draw."""


def filled_wells(charge: Any, full_well_e: Any) -> tuple[Any, Any]:
    """Dr.Jit arrays (n,): charge up to the full well, and whether a pixel is saturated."""
    from render.engine.jit import dr

    return dr.minimum(charge, full_well_e), charge >= full_well_e


def bloomed(charge_e: NDArray[np.float64], detector: Detector) -> NDArray[np.float64]:
    """Expected charge (h, w) [e-] after the excess over full wells has spread along the columns.

    A fraction ``blooming`` of the excess goes in equal parts up and down and fills wells there; the anti-blooming drain
    takes the rest. Charge that reaches the ends of the column is lost.
    """
    well = detector.full_well_e
    excess = np.maximum(charge_e - well, 0.0)
    columns = np.flatnonzero(excess.any(0))
    if not detector.blooming or not len(columns):
        return charge_e
    filled = np.minimum(charge_e[:, columns], well)
    running = 0.5 * detector.blooming * excess[:, columns]
    for rows in (range(len(filled)), range(len(filled) - 1, -1, -1)):
        carried = np.zeros(len(columns))
        for row in rows:
            taken = np.minimum(carried, well - filled[row])
            filled[row] += taken
            carried += running[row] - taken
    result = charge_e.copy()
    full = filled >= well * (1.0 - 1e-12)
    certain = well + SURELY_FULL_SIGMA * np.sqrt(well)
    result[:, columns] = np.where(full, np.maximum(charge_e[:, columns], certain), filled)
    return result
