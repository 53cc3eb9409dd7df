"""Samples of light and the kernel of a pixel, against the integral of a wave in closed form."""

import numpy as np
import pytest

from render.tracing.waves.pixel_kernel import FieldSampling, window_samples

SIGMA_PX = 0.18


@pytest.mark.parametrize("highest", [3.4, 27.6])
def test_a_pixel_integrates_every_wave_of_the_light(highest: float) -> None:
    """1 + cos(2 pi f x) over a pixel after diffusion: 1 + sinc(f) exp(-2 (pi sigma f)^2), whatever samples mistake."""
    field = FieldSampling.of(highest, SIGMA_PX)
    kernel = field.pixel(1.0, SIGMA_PX)
    x = window_samples(field, 1.0, kernel.reach_px) - 0.5
    f = np.linspace(0.0, highest, 400)
    light = 1.0 + np.cos(2.0 * np.pi * f[:, None] * x)
    pixel = light @ kernel(x) * field.light_step
    wanted = 1.0 + np.sinc(f) * np.exp(-2.0 * (np.pi * SIGMA_PX * f) ** 2)
    assert np.abs(pixel - wanted).max() < 1e-7
    if highest > 20.0:
        assert field.light_step > 1.5 / (2.0 * highest)  # 2 f would be asked for by Nyquist
