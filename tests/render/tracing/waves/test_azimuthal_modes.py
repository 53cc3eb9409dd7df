"""Components that turn, against spots whose turned images are known in closed form."""

import math

import numpy as np

from render.tracing.waves.azimuthal_modes import azimuthal_modes
from render.tracing.waves.pixel_kernel import FieldSampling

FIELD = FieldSampling(3.0)
BLUR_PX = 0.2


def spot(samples: np.ndarray, phi: float, part: float) -> np.ndarray:
    """Gaussian spots that lie symmetrically about the column axis, turned by phi."""
    x, y = np.meshgrid(samples, samples)
    image = np.zeros_like(x)
    for x0, y0, sigma, light in (
        (3.0 * part, 0.0, 0.3, 0.5),
        (part - 2.0, 1.5 * part + 0.2, 0.35, 0.2),
        (5.0 * part, 0.0, 0.28, 0.1),
    ):
        for sign in (1.0, -1.0):
            u, v = x0 * math.cos(phi) - sign * y0 * math.sin(phi), x0 * math.sin(phi) + sign * y0 * math.cos(phi)
            distance2 = (x - u) ** 2 + (y - v) ** 2
            image += 0.5 * light / (2.0 * math.pi * sigma**2) * np.exp(-0.5 * distance2 / sigma**2)
    return image


def test_turned_images_are_those_of_turned_spots() -> None:
    samples = (np.arange(140) - 69.5) * FIELD.light_step
    parts = np.linspace(0.0, 1.0, 6)
    images = np.stack([spot(samples, 0.0, part) for part in parts]).astype(np.float32)
    modes = azimuthal_modes(images, samples, FIELD, BLUR_PX, 1e-5)
    distance = (samples[:, None] - samples) / 0.34  # diffusion of 0.18 px, and a pixel as a Gaussian
    pixel = np.exp(-0.5 * distance**2) * FIELD.light_step / (0.34 * math.sqrt(2.0 * math.pi))
    for phi in (0.0, 0.7, -2.4):
        turn = np.concatenate([modes.coefficient * f(modes.order * phi) for f in (np.cos, np.sin)], axis=1)
        turned = np.tensordot(turn, modes.shape.reshape(-1, 140, 140), axes=1)
        wanted = np.stack([spot(samples, phi, part) for part in parts])
        assert np.abs(pixel @ wanted @ pixel).max() > 0.2
        assert np.abs(pixel @ (turned - wanted) @ pixel).max() < 2e-5
