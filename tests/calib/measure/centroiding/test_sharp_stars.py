"""Stars that a Gaussian does not fit: sharp cores sampled too coarsely, ramps and pixels that are no stars."""

import numpy as np
import pytest
from star_images import NOISE, gaussian_stars, sampled_stars, stamps_of

from calib import find_stars, get_centroider, sensor_image
from calib.flags import StarFlag, has_flag
from calib.measure.epsf.build import build_epsf

SHARP = [(0.12, 0.25), (0.74, 0.68), (0.14, 2.2)]
"""The PSF of eight real frames."""


def mixture(x, y, components):
    """Sums of pixel-integrated Gaussians (weight, sigma)."""
    return sum(weight * gaussian_stars(x, y, sigma) for weight, sigma in components)


def measured(components, flux_e, *, count=300, seed=1):
    """Pulls (2 n,) of Gaussian fits to sums of pixel-integrated Gaussians (weight, sigma), and the table."""
    rng = np.random.default_rng(seed)
    x, y, stamps = sampled_stars(lambda x, y: flux_e * mixture(x, y, components), rng, count, 100.0)
    table = get_centroider("gaussian", fit_background=True).measure(stamps, NOISE)
    return np.concatenate([(table.x_px - x) / table.sigma_x_px, (table.y_px - y) / table.sigma_y_px]), table


@pytest.mark.parametrize("sigma_px", [0.4, 0.5, 0.58, 0.8])
def test_pixel_integrated_gaussian_has_no_s_curve(sigma_px):
    """Pulls of 1 within 4 / sqrt(2 N) at SNR 550, where an S-curve of 0.01 px would make them 3, and no flag."""
    pull, table = measured([(1.0, sigma_px)], 3e5)
    assert np.sqrt(np.mean(pull**2)) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * len(pull)))
    assert has_flag(table.flags, StarFlag.PIXEL_PHASE).mean() < 0.01
    assert np.isnan(table.phase_error_px).all()


@pytest.mark.parametrize("flux_e", [3e4, 3e5])
def test_sharp_core_is_flagged(flux_e):
    pull, table = measured(SHARP, flux_e)
    assert np.sqrt(np.mean(pull**2)) > 1.7
    assert has_flag(table.flags, StarFlag.PIXEL_PHASE).mean() > 0.95
    assert table.fit.mean() > 0.95


def test_nothing_has_no_flux_of_1e11():
    """Ramps, single pixels, noise, stars next to the window: a flux or place that the pixels do not hold has a flag."""
    rng = np.random.default_rng(3)
    count = 400
    electrons = rng.poisson(100.0, (count, 11, 11)) + rng.normal(0.0, 5.0, (count, 11, 11))
    row = np.arange(11)
    electrons[:100] += (row**2 * rng.uniform(0.0, 30.0, (100, 1)))[:, None, :]
    electrons[100:200, 5, 5] += rng.uniform(50.0, 3000.0, 100)
    electrons[200:300] += 3e4 * gaussian_stars(rng.uniform(10.5, 14.0, 100), rng.uniform(-3.0, 14.0, 100), 1.5, 11, 11)
    stamps = stamps_of(electrons, np.full(count, 5.0), np.full(count, 5.0), background_e=100.0)
    for options in ({}, {"fit_background": True}, {"sigma_px": 0.6, "fit_background": True}):
        table = get_centroider("gaussian", **options).measure(stamps, NOISE)
        held = np.maximum(electrons - 100.0, 0.0).sum(axis=(1, 2))
        assert np.all(np.abs(table.flux_e) < 10.0 * (held + 5.0 * np.sqrt(125.0 * 121)))
        assert np.all((table.x_px > -0.5) & (table.x_px < 10.5) & (table.y_px > -0.5) & (table.y_px < 10.5))
        astray = has_flag(table.flags, StarFlag.UNDETERMINED)
        assert not table.fit[astray].any()
        assert np.all(np.isfinite(table.covariance[astray]))


def test_frames_with_structure_stay_within_the_frame():
    """A frame with a bright border, a gradient and single pixels: every flux is of its light, every place inside."""
    rng = np.random.default_rng(5)
    row, column = np.indices((200, 240))
    frame = rng.normal(300.0, 6.0, (200, 240)) + 0.02 * (row - 100.0) ** 2 + 4000.0 * (column > 236)
    frame[rng.integers(0, 200, 60), rng.integers(0, 240, 60)] += rng.uniform(60.0, 4000.0, 60)
    table = find_stars(sensor_image(frame), "gaussian", fit_background=True)
    assert len(table) > 30
    assert np.nanmax(table.flux_e) < 1e7
    outside = (table.x_px < -1) | (table.x_px > 240) | (table.y_px < -1) | (table.y_px > 200)
    assert not outside.any()


def test_psf_of_known_places_has_no_s_curve_and_says_why_it_did_not_converge():
    """Sharp cores, no dithers: without places the S-curve of the Gaussian fit stays; with them pulls are 1."""
    rng = np.random.default_rng(2)
    flux = 1e5 * 10 ** rng.uniform(-1.0, 0.0, (300, 1, 1))
    x, y, stamps = sampled_stars(lambda x, y: flux * mixture(x, y, SHARP), rng, 300, 100.0)
    held = build_epsf(stamps, NOISE, oversampling=4, roughness=0.1, position_px=np.column_stack([x, y]))
    free = build_epsf(stamps, NOISE, oversampling=4, roughness=0.1)
    pull = [np.std((found.stars.x_px - x) / found.stars.sigma_x_px) for found in (held, free)]
    assert pull[0] == pytest.approx(1.0, abs=4.0 / np.sqrt(600.0))
    assert pull[1] > 2.0
    assert held.converged
    assert not held.message
    _, _, stamps = sampled_stars(lambda x, y: 1e4 * gaussian_stars(x, y, 0.6), np.random.default_rng(3), 40, 100.0)
    found = build_epsf(stamps, NOISE, oversampling=2, max_iterations=1, tolerance=1e-6)
    assert "after 1 rounds: 40 stars for 4 phases" in found.message
