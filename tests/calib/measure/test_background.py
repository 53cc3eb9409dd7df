import numpy as np
import pytest
from star_images import gaussian_stars, image_of, noisy

from calib.measure.background import estimate_background
from calib.records import NoiseModel


def test_flat_sky_level_and_noise():
    """Mean and standard deviation of N normal numbers: standard errors sigma/sqrt(N), sigma/sqrt(2N) (5 sigma)."""
    electrons = noisy(np.full((512, 512), 20.0), 5.0, np.random.default_rng(1))
    background = estimate_background(image_of(electrons))
    true_sigma, n = np.sqrt(45.0), electrons.size
    assert background.level_e.mean() == pytest.approx(20.0, abs=5 * true_sigma / np.sqrt(n))
    # clipping at 3 sigma and the skewness of Poisson noise cost a little more than the plain standard error
    assert background.sigma_e.mean() == pytest.approx(true_sigma, rel=0.01)


def test_level_is_the_expectation_where_dn_are_coarse():
    """With 0.1 DN/e- the noise is 0.7 DN: a median would be wrong by up to half a DN = 5 e-."""
    noise = NoiseModel(read_noise_e=5.0, gain_dn_per_e=0.1, offset_dn=100.0, quantised=True)
    electrons = noisy(np.full((256, 256), 23.0), 5.0, np.random.default_rng(2))
    background = estimate_background(image_of(np.rint(100.0 + 0.1 * electrons), noise))
    assert background.level_e.mean() == pytest.approx(23.0, abs=0.3)


def test_gradient_is_followed():
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:300, :400]
    truth = 50.0 + 0.05 * x - 0.02 * y
    background = estimate_background(image_of(truth + rng.normal(0, 5.0, truth.shape)), box_px=50)
    inside = (slice(25, 275), slice(25, 375))
    error = (background.level_image() - truth)[inside]
    # 48 cells of 2500 pixels: 0.1 e- standard error each; 4.5 of them, spline overshoot included
    assert np.abs(error).max() < 0.45
    assert abs(error.mean()) < 5 * 5.0 / np.sqrt(error.size)


def test_stars_hardly_raise_the_level():
    rng = np.random.default_rng(4)
    electrons = np.full((256, 256), 30.0)
    for _ in range(60):
        x, y = rng.integers(10, 246, 2)
        electrons[y - 5 : y + 6, x - 5 : x + 6] += 2e4 * gaussian_stars([5.0], [5.0], 1.0)[0]
    background = estimate_background(image_of(noisy(electrons, 5.0, rng)))
    assert background.level_e.mean() == pytest.approx(30.0, abs=0.1)
    assert background.sigma_e.mean() == pytest.approx(np.sqrt(55.0), rel=0.02)


def test_nan_and_saturated_pixels_do_not_count():
    rng = np.random.default_rng(5)
    electrons = rng.normal(10.0, 2.0, (128, 128))
    saturated = np.zeros(electrons.shape, bool)
    saturated[:64, :64] = True
    electrons[saturated] = 1e5
    electrons[100:, :] = np.nan
    background = estimate_background(image_of(electrons, saturated=saturated), box_px=32)
    assert np.all(np.isfinite(background.level_image()))
    assert np.abs(background.level_e - 10.0).max() < 5 * 2.0 / np.sqrt(32 * 4)


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (9, 9), (65, 64)])
def test_small_and_odd_shapes(shape):
    background = estimate_background(image_of(np.full(shape, 7.0)))
    assert background.level_image().shape == shape
    assert np.allclose(background.level_image(), 7.0)
    assert np.allclose(background.level_at([0.0], [0.0]), 7.0)


def test_a_part_of_the_pixels_gives_the_same_mesh_where_it_belongs():
    """A gradient seen by every fourth pixel of a cell: 1024 of them, 5 standard errors, and centres within 1.5 px."""
    rng = np.random.default_rng(5)
    slope = 0.05
    ramp = 20.0 + slope * np.arange(512)[None, :] + np.zeros((400, 1))
    image = image_of(rng.normal(ramp, 3.0))
    whole, part = (estimate_background(image, box_px=128, step_px=step) for step in (1, 4))
    assert part.shape == whole.shape == (400, 512)
    assert np.abs(part.centre_x_px - whole.centre_x_px).max() <= 1.5
    spread = np.sqrt(3.0**2 + (slope * 128) ** 2 / 12)
    assert np.abs(part.level_e - whole.level_e).max() < 5 * spread / 32 + 1.5 * slope
    assert np.abs(part.sigma_e / whole.sigma_e - 1).max() < 5 / np.sqrt(2 * 1024)


@pytest.mark.parametrize(("mean", "sigma"), [(50.3, 0.25), (50.3, 0.5), (0.3, 1.0), (-1.0, 3.0)])
def test_whole_numbers_cut_off_at_zero(mean, sigma):
    """Level and noise are those of the numbers as they are: 4 statistical errors, and 2.5 % for what is left out."""
    dn = np.clip(np.rint(np.random.default_rng(1).normal(mean, sigma, (256, 256))), 0.0, 255.0)
    sky = estimate_background(image_of(dn, NoiseModel(read_noise_e=1.0, quantised=True)))
    assert sky.sigma_e.mean() == pytest.approx(dn.std(), rel=0.025 + 4.0 / np.sqrt(2.0 * dn.size))
    assert sky.level_e.mean() == pytest.approx(dn.mean(), abs=0.05 * max(dn.std(), 0.5) + 0.08 * (sigma < 0.4))


def test_a_slope_is_no_noise():
    """Twilight that changes by 8 times the noise within a cell; what is left of it is a tenth of the noise."""
    rng = np.random.default_rng(6)
    slope = np.linspace(0.0, 1.0, 512)[None, :] * 4800.0 + np.linspace(0.0, 1.0, 512)[:, None] * 1500.0
    found = estimate_background(image_of(rng.normal(3000.0, 75.0, (512, 512)) + slope))
    inner = found.sigma_e[1:-1, 1:-1]
    assert np.median(inner) == pytest.approx(75.0, rel=0.12)
