"""False alarms and detections, against images of noise and stars drawn with NumPy and given to the detection itself."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from star_images import gaussian_stars, image_of, noisy, star_field

from calib.measure.background import Background, estimate_background
from calib.measure.detection.false_alarms import (
    _probability_of_maximum,
    clipped_noise,
    detection_probability,
    false_alarms,
    threshold_for_false_alarms,
)
from calib.measure.detection.matched_filter import detect

SIDE = 1024


@pytest.mark.parametrize(("one", "two"), [(0.6, 0.2), (0.8, 0.5), (0.2, 0.1)])
def test_both_neighbours_below(one, two):
    height, below = _probability_of_maximum(one, two)
    law = multivariate_normal(cov=[[1.0 - one**2, two - one**2], [two - one**2, 1.0 - one**2]])
    assert below == pytest.approx(law.cdf(np.stack([height, height], -1) * (1.0 - one)), abs=1e-12)


def known_background(size, sigma_e):
    one = np.array([[1.0]])
    middle = np.array([size / 2.0])
    return Background(
        level_e=0.0 * one, sigma_e=sigma_e * one, centre_x_px=middle, centre_y_px=middle, shape=(size, size)
    )


@pytest.mark.parametrize("spread", [0.0, 0.5])
def test_false_alarms_of_noise(spread):
    """Counts above 3.5 sigma are Poisson; with some 1200 of them, 4 sigma are 12 %; 3 % for what is left out.
    With pixels of different noise the same image makes more: the prediction without the spread must fail then."""
    rng, threshold, fwhm = np.random.default_rng(3), 3.5, 1.8
    variance = 100.0 * rng.lognormal(-0.5 * np.log1p(spread**2), np.sqrt(np.log1p(spread**2)), (2, SIDE, SIDE))
    count = 0
    for square in variance:
        noise = np.sqrt(square) * rng.standard_normal((SIDE, SIDE))
        count += len(detect(image_of(noise), known_background(SIDE, 10.0), threshold_sigma=threshold, fwhm_px=fwhm))
    expected = 2 * float(false_alarms(threshold, SIDE**2, fwhm_px=fwhm, noise_spread=spread))
    limit = 4.0 * np.sqrt(expected) + 0.03 * expected
    assert abs(count - expected) < limit
    if spread:
        assert abs(count - 2 * float(false_alarms(threshold, SIDE**2, fwhm_px=fwhm))) > limit


def test_threshold_gives_the_alarms_that_were_asked_for():
    threshold = threshold_for_false_alarms(0.1, 4_000_000, fwhm_px=2.0, noise_spread=0.2)
    assert float(false_alarms(threshold, 4_000_000, fwhm_px=2.0, noise_spread=0.2)) == pytest.approx(0.1, rel=1e-4)


@pytest.mark.parametrize("flux", [140.0, 175.0])
def test_share_of_stars_that_are_found(flux):
    """400 stars near the limit, at random phases: a share of n stars is known to sqrt(p (1 - p) / n) = 2.5 %."""
    rng, fwhm, limit, pitch = np.random.default_rng(5), 2.0, 5.0, 40
    grid = pitch * (np.arange(20) + 0.5)
    x, y = (np.concatenate(axis) + rng.uniform(-0.5, 0.5, 400) for axis in np.meshgrid(grid, grid))
    size = int(20 * pitch)
    image = noisy(star_field(x, y, flux, 0.8, (size, size)), 10.0, rng)
    stars = detect(image_of(image), known_background(size, 10.0), threshold_sigma=limit, fwhm_px=fwhm)
    distance = np.hypot(stars.x_px[:, None] - x, stars.y_px[:, None] - y)
    found = float((distance.min(axis=0) < 2.0).mean())
    step = (np.arange(5) - 2) / 5
    px, py = (v.ravel() for v in np.meshgrid(step, step))
    unit = gaussian_stars(7.0 + px, 7.0 + py, 0.8, 15, 15)
    expected = float(detection_probability(unit, flux, empty_e2=100.0, threshold_sigma=limit, fwhm_px=fwhm).mean())
    assert 0.1 < expected < 0.95
    assert abs(found - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / 400) + 0.01


@pytest.mark.parametrize(("spread", "hot"), [(0.0, 0.0), (0.6, 0.0), (0.3, 0.04)])
def test_noise_that_clipping_finds(spread, hot):
    """A clipped standard deviation of 262144 pixels is known to 0.2 %; four of it, and no stars to be left out."""
    rng, size = np.random.default_rng(6), 512
    variance = 100.0 * rng.lognormal(-0.5 * np.log1p(spread**2), np.sqrt(np.log1p(spread**2)), (size, size))
    variance += 3000.0 * (rng.uniform(size=variance.shape) < hot)
    found = estimate_background(image_of(np.sqrt(variance) * rng.standard_normal((size, size))), box_px=128)
    ratio = found.sigma_e.mean() / np.sqrt(100.0 + 3000.0 * hot)
    assert ratio == pytest.approx(clipped_noise(spread, [0.0, 30.0], [1.0 - hot, hot]), abs=0.012)
    assert clipped_noise(0.6) < 0.97
    assert clipped_noise(0.0) == pytest.approx(1.0, abs=1e-6)
