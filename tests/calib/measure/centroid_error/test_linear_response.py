"""The linear response of centroiders, and what it makes of the noise of pixels."""

from dataclasses import replace

import numpy as np
import pytest

from calib.measure.centroid_error.linear_response import centroid_covariance, centroid_variance, linear_response
from calib.measure.centroiding.registry import get_centroider
from calib.records import NoiseModel, Stamps
from render.records import EffectivePsf


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


CLOSED_FORM = {"ePSF": {}, "sky": {"fit_background": True}, "widths": {"name": "gaussian"}, "moment": {"name": "cog"}}


@pytest.mark.parametrize("options", CLOSED_FORM.values(), ids=CLOSED_FORM)
def test_response_in_closed_form_is_the_derivative_by_the_pixels(options: dict) -> None:
    """Of stars that are no image of the PSF: windows with one pixel changed to both sides, pixel by pixel."""
    size, name = 9, options.get("name", "epsf")
    wide: dict = {"fit_background": options.get("fit_background", False), "tolerance": 1e-9, "max_iterations": 200}
    if name == "cog":
        wide = {}
    if name == "epsf":
        grid = (np.arange(61) - 30.0) / 4.0
        samples = np.exp(-(np.add.outer(grid**2, grid**2)) / (2.0 * 0.7**2))  # the stars have 0.9 px
        wide["epsf"] = EffectivePsf(values=16.0 * samples / samples.sum(), oversampling=4)
    centroider, told = get_centroider(name, **wide), NoiseModel(read_noise_e=5.0)
    light = np.stack([_spot(4.3, 3.8, size, 5000.0), _spot(3.9, 4.1, size, 800.0)])
    valid = np.ones_like(light, bool)
    valid[0, 2, 3] = False
    stars = Stamps(
        electrons=light,
        valid=valid,
        corner_px=np.array([[20, 10], [0, 0]]),
        background_e=np.zeros(2),
        start_px=np.array([[24.3, 13.8], [3.9, 4.1]]),
        flags=np.zeros(2, np.uint32),
        psf_index=np.zeros(2, np.int64),
    )
    gain = linear_response(centroider, stars, told, light)
    for star, (row, column) in [(0, (3, 5)), (0, (4, 4)), (1, (4, 3)), (1, (1, 7)), (0, (2, 3))]:
        pair = []
        for step_e in (0.1, -0.1):
            changed = light.copy()
            changed[star, row, column] += step_e
            table = centroider.measure(replace(stars, electrons=changed), told)
            pair.append([table.x_px[star], table.y_px[star]])
        slope = np.subtract(*pair) / 0.2
        np.testing.assert_allclose(gain[star, :, row, column], slope, rtol=1e-4, atol=1e-5 * np.abs(gain[star]).max())
