"""Charge diffusion on pixels: flux, centroid and second moments."""

import numpy as np
import pytest

from render.detector.diffusion import diffuse, diffusion_kernel


@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.18, 0.5, 1.0, 3.0])
def test_kernel_moments(sigma: float) -> None:
    kernel = diffusion_kernel(sigma)
    k = np.arange(len(kernel)) - len(kernel) // 2
    assert kernel.sum() == pytest.approx(1, abs=1e-14)
    assert (kernel * k**2).sum() == pytest.approx(sigma**2, abs=1e-12)
    assert kernel.min() >= 0


def test_two_in_a_row_are_one_of_the_summed_variance() -> None:
    image = np.zeros((31, 31))
    image[15, 14] = 1000
    twice = diffuse(diffuse(image, 0.3), 0.4)
    assert np.allclose(twice, diffuse(image, 0.5), atol=1e-4)


def test_flux_centroid_and_variance_of_a_star() -> None:
    row, column = np.mgrid[0:41, 0:41]
    star = 1e4 * np.exp(-((row - 20.3) ** 2 + (column - 19.6) ** 2) / (2 * 0.9**2))
    kept = star.copy()
    after = diffuse(star, 0.18).astype(float)
    assert np.array_equal(star, kept)
    for axis in (row, column):
        before_mean, after_mean = (star * axis).sum() / star.sum(), (after * axis).sum() / after.sum()
        assert after_mean == pytest.approx(before_mean, abs=1e-5)  # float32 output
        before = (star * (axis - before_mean) ** 2).sum() / star.sum()
        assert (after * (axis - after_mean) ** 2).sum() / after.sum() == pytest.approx(before + 0.18**2, abs=1e-4)
    assert after.sum() == pytest.approx(star.sum(), rel=1e-6)


def test_nothing_is_lost_at_the_border() -> None:
    image = np.zeros((9, 9))
    image[0, 0] = image[8, 4] = 500
    assert diffuse(image, 0.6).sum() == pytest.approx(1000, rel=1e-6)
