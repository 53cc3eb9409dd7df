"""The linear response of centroiders, and what it makes of the noise of pixels."""

from dataclasses import replace

import numpy as np
import pytest
from star_images import NOISE, gaussian_epsf, stamps_of

from calib.measure.centroid_error.linear_response import centroid_covariance, centroid_variance, linear_response
from calib.measure.centroiding.registry import get_centroider


def _spot(x: float, y: float, size: int, flux_e: float) -> np.ndarray:
    grid = np.arange(size)
    shape = np.exp(-0.5 * (((grid - x)[None, :] / 0.9) ** 2 + ((grid - y)[:, None] / 0.9) ** 2))
    return flux_e * shape / shape.sum()


@pytest.mark.parametrize("method", ["cog", "windowed", "gaussian"])
def test_covariance_of_noisy_windows(method: str) -> None:
    """20000 noisy copies of a window, the noise of a pixel growing to one corner: x and y are correlated.
    A variance over N is known to sqrt(2 / N) = 1 %, a correlation to 0.7 %; four of these are allowed, and 2 % for what
    is not linear."""
    copies, size = 20000, 9
    light = _spot(4.3, 3.8, size, 5000.0)[None]
    sigma = 2.0 + 0.08 * np.add.outer(np.arange(size), np.arange(size)) ** 1.5
    star, centroider = stamps_of(light, [4.3], [3.8]), get_centroider(method)
    gain = linear_response(centroider, star, NOISE, light)
    covariance = centroid_covariance(gain, sigma[None] ** 2)[0]
    np.testing.assert_allclose(centroid_variance(gain, sigma[None] ** 2)[0], np.diagonal(covariance), rtol=1e-12)
    noisy = light + sigma * np.random.default_rng(5).standard_normal((copies, size, size))
    stamps = replace(star.select(np.zeros(copies, np.int64)), electrons=noisy)
    measured = np.cov(centroider.measure(stamps, NOISE).pixel_px.T)
    scale = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(np.diagonal(measured), scale**2, rtol=0.06)
    assert abs(measured[0, 1] - covariance[0, 1]) < 0.05 * scale[0] * scale[1]


CLOSED_FORM = {"ePSF": {}, "sky": {"fit_background": True}, "widths": {"name": "gaussian"}, "moment": {"name": "cog"}}


@pytest.mark.parametrize("options", CLOSED_FORM.values(), ids=CLOSED_FORM)
def test_response_in_closed_form_is_the_derivative_by_the_pixels(options: dict) -> None:
    """Of stars that are no image of the PSF: windows with one pixel changed to both sides, pixel by pixel."""
    name = options.get("name", "epsf")
    fit = {} if name == "cog" else {"tolerance": 1e-9, "max_iterations": 200}
    psf = {"epsf": gaussian_epsf(0.7)} if name == "epsf" else {}  # the stars have 0.9 px
    centroider = get_centroider(**{"name": name} | fit | psf | options)
    light = np.stack([_spot(4.3, 3.8, 9, 5000.0), _spot(3.9, 4.1, 9, 800.0)])
    valid = np.ones_like(light, bool)
    valid[0, 2, 3] = False
    stars = stamps_of(light, [4.3, 3.9], [3.8, 4.1], valid=valid, corner=[[20, 10], [0, 0]])
    gain = linear_response(centroider, stars, NOISE, light)
    for star, (row, column) in [(0, (3, 5)), (0, (4, 4)), (1, (4, 3)), (1, (1, 7)), (0, (2, 3))]:
        step = np.zeros_like(light)
        step[star, row, column] = 0.1
        sides = (centroider.measure(replace(stars, electrons=light + k * step), NOISE).pixel_px[star] for k in (1, -1))
        slope = np.subtract(*sides) / 0.2
        np.testing.assert_allclose(gain[star, :, row, column], slope, rtol=1e-4, atol=1e-5 * np.abs(gain[star]).max())
