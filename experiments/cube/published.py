"""The trims that CUBE09 prints (Table 1), and what they say of the size of its pixels."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from optics.arrays import FloatArray

__all__ = ["LEAST_MOVE_DEG", "PUBLISHED_TRIMS", "published_rates"]

PUBLISHED_TRIMS = {
    "XY": (
        (181.400, 0.550, 4.912, 19.429),
        (181.390, 0.540, 5.282, 12.243),
        (181.390, 0.532, 6.307, 5.181),
        (181.395, 0.531, 2.385, 3.558),
        (181.398, 0.530, 0.034, 2.404),
        (181.398, 0.528, 0.057, 0.771),
        (181.398, 0.528, 0.057, 0.771),
    ),
    "YZ": (
        (91.400, -0.070, 12.575, 20.226),
        (91.380, -0.050, 11.729, 2.557),
        (91.385, -0.050, 1.326, 1.323),
        (91.386, -0.050, 0.857, 1.897),
        (91.386, -0.048, 0.320, 0.442),
    ),
}
"""CUBE09 Table 1: large angle, small angle [deg], offsets x, y [px] without their signs."""

LEAST_MOVE_DEG = 0.005
"""Angles are printed to 0.001 deg: a rate from a smaller move means little."""


def published_rates() -> FloatArray:
    """Motion of the spot per 0.001 deg (n, 2) [px], for every move of an angle in Table 1 of at least `LEAST_MOVE_DEG`.

    The offsets have no signs: the first column takes both on one side of the aperture, the second on opposite sides.
    """
    rates = []
    for trims in PUBLISHED_TRIMS.values():
        for before, after in pairwise(trims):
            for axis in (0, 1):
                steps = abs(after[axis] - before[axis]) / 0.001
                if steps > LEAST_MOVE_DEG / 0.001 - 0.1:
                    old, new = before[2 + axis], after[2 + axis]
                    rates.append((abs(old - new) / steps, (old + new) / steps))
    return np.array(rates)
