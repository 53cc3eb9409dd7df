"""Convergence of sums over rays: frequencies that a pixel value can contain, and their damping by charge diffusion."""

from __future__ import annotations

import math

import numpy as np

from optics.arrays import FloatArray

TOLERANCE = 3e-5
"""Largest error of a converged pixel, in the light of its star."""
MOTION_TOLERANCE = 1e-4
"""Largest change of a damped characteristic function for paths and for spots that move along them; a pixel of a
trail is then right to 7e-5 of the light."""
HIGHEST_FREQUENCY = 8.0
"""Cycles per pixel beyond which a spot is not followed; diffusion below 0.09 px lets more through."""


def damped_frequencies(diffusion_px: float, tolerance: float) -> FloatArray | None:
    """Frequencies (f, 2) [cycles/px] up to the one at which diffusion leaves less than the tolerance.

    From `frequencies_up_to`. None where diffusion lets more than `HIGHEST_FREQUENCY` through.
    """
    if diffusion_px <= 0.0:
        return None
    highest = math.sqrt(0.5 * math.log(1.0 / tolerance)) / (math.pi * diffusion_px)
    return None if highest > HIGHEST_FREQUENCY else frequencies_up_to(highest)


def frequencies_up_to(highest: float) -> FloatArray:
    """Frequencies (f, 2) at steps of half a cycle on four lines through the origin."""
    radii = np.arange(1, math.ceil(2 * highest) + 1) * 0.5
    along = np.array([(1.0, 0.0), (0.0, 1.0), (np.sqrt(0.5), np.sqrt(0.5)), (np.sqrt(0.5), -np.sqrt(0.5))])
    return np.asarray((radii[:, None, None] * along).reshape(-1, 2))


def transfer(frequency: FloatArray, diffusion_px: float) -> FloatArray:
    """Transfer of the pixel (its envelope) and of the diffusion Gaussian at frequencies (f, 2), (f,)."""
    pixel = np.minimum(1.0, 1.0 / (np.pi * np.maximum(np.abs(frequency), 1e-9))).prod(1)
    return np.asarray(pixel * np.exp(-2 * (np.pi * diffusion_px) ** 2 * (frequency**2).sum(1)))
