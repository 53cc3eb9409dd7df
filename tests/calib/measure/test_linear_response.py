"""The linear response of centroiders, and what it makes of the noise of pixels."""

from dataclasses import replace

import numpy as np
import pytest

from calib.measure.centroid import get_centroider
from calib.measure.linear_response import centroid_covariance, centroid_variance, linear_response
from calib.records import NoiseModel, Stamps


def _spot(x: float, y: float, size: int, flux_e: float) -> np.ndarray:
    grid = np.arange(size)
    shape = np.exp(-0.5 * (((grid - x)[None, :] / 0.9) ** 2 + ((grid - y)[:, None] / 0.9) ** 2))
    return flux_e * shape / shape.sum()


@pytest.mark.parametrize("method", ["cog", "windowed", "gaussian"])
def test_covariance_of_noisy_windows(method: str) -> None:
    """20000 noisy copies of a window, the noise of a pixel growing to one corner: x and y are correlated.

    A variance over N is known to sqrt(2 / N) = 1 %, a correlation to 0.7 %; four of these are allowed, and 2 % for what
    is not linear.
    """
    copies, size = 20000, 9
    light = _spot(4.3, 3.8, size, 5000.0)[None]
    sigma = 2.0 + 0.08 * np.add.outer(np.arange(size), np.arange(size)) ** 1.5
    one = Stamps(
        electrons=light,
        valid=np.ones_like(light, bool),
        corner_px=np.array([[0, 0]]),
        background_e=np.zeros(1),
        start_px=np.array([[4.3, 3.8]]),
        flags=np.zeros(1, np.uint32),
        psf_index=np.zeros(1, np.int64),
    )
    centroider, told = get_centroider(method), NoiseModel(read_noise_e=5.0)
    gain = linear_response(centroider, one, told, light)
    covariance = centroid_covariance(gain, sigma[None] ** 2)[0]
    np.testing.assert_allclose(centroid_variance(gain, sigma[None] ** 2)[0], np.diagonal(covariance), rtol=1e-12)
    noisy = light + sigma * np.random.default_rng(5).standard_normal((copies, size, size))
    many = replace(one.select(np.zeros(copies, np.int64)), electrons=noisy)
    table = centroider.measure(many, told)
    found = np.cov(np.column_stack([table.x_px, table.y_px]).T)
    np.testing.assert_allclose(np.diagonal(found), np.diagonal(covariance), rtol=0.06)
    scale = np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert abs(found[0, 1] - covariance[0, 1]) < 0.05 * scale
