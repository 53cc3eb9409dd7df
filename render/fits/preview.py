"""Small grey pictures of frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from render.records import Frame

DARKEST_SIGMA = 3.0
SOFT_SIGMA, BRIGHTEST_SIGMA = 3.0, 150.0
GLOW_PX = 0.9
"""Stars of a single pixel are hard to see: small pictures are blurred by this much, and scaled to keep the peaks."""


def stretched(image: NDArray[np.float32], darkest_sigma: float = -2.0) -> NDArray[np.float32]:
    """Brightness 0 ... 1 of an image of digital numbers: inverse hyperbolic sine above the sky, in units of its noise.

    Black is ``darkest_sigma`` above the sky. Linear for what is as faint as the noise, logarithmic for what is bright
    (R. Lupton et al., PASP 116, 133 (2004)).
    """
    low, sky, high = np.percentile(image, (15.9, 50.0, 84.1))
    sigma = max(0.5 * (high - low), 0.5)
    above = ((image - sky) / sigma - darkest_sigma) / SOFT_SIGMA
    return np.asarray(np.clip(np.arcsinh(above) / np.arcsinh(BRIGHTEST_SIGMA / SOFT_SIGMA), 0.0, 1.0), np.float32)


def preview(frame: Frame, longer_px: int = 300) -> NDArray[np.uint8]:
    """Grey picture of about a size; of every block of pixels the brightest is kept, so that no star goes under."""
    image = stretched(frame.dn.astype(np.float32), DARKEST_SIGMA)
    step = max(1, -(-max(image.shape) // longer_px))
    height, width = (side - side % step for side in image.shape)
    brightest = image[:height, :width].reshape(height // step, step, width // step, step).max((1, 3))
    glow = gaussian_filter(brightest - np.median(brightest), GLOW_PX) * (2.0 * np.pi * GLOW_PX**2)
    return np.asarray(np.rint(255.0 * np.clip(glow, 0.0, 1.0)), np.uint8)
