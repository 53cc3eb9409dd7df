"""The error by pixel phase against stars that the tests draw themselves: erf integrals, shot and read noise."""

import numpy as np
import pytest
from star_images import gaussian_stars, noisy, sampled_stars, star_field

from calib import find_stars, get_centroider
from calib.flags import UNFIT, StarFlag, has_flag

MOMENTS = ("cog", "tcog", "windowed")
STARS = 300


@pytest.fixture(scope="module")
def measured(noise):
    """Pulls of x by noise alone and with the error by pixel phase, and the table, for stars of one width and flux."""
    kept = {}

    def measure(name, sigma_px, flux_e):
        if (name, sigma_px, flux_e) not in kept:
            rng = np.random.default_rng(round(100 * sigma_px))
            x, _, stamps = sampled_stars(lambda x, y: flux_e * gaussian_stars(x, y, sigma_px), rng, STARS, 4.0)
            table = get_centroider(name).measure(stamps, noise)
            good = np.isfinite(table.sigma_x_px)
            assert good.mean() > 0.98
            pull = (table.x_px - x)[good] / np.stack([table.sigma_x_px, table.position_sigma_px])[:, good]
            kept[name, sigma_px, flux_e] = (*np.sqrt(np.mean(pull**2, axis=1)), table.select(good))
        return kept[name, sigma_px, flux_e]

    return measure


@pytest.mark.parametrize("name", MOMENTS)
@pytest.mark.parametrize("sigma_px", [0.3, 0.5, 0.7, 1.0, 2.0])
def test_pulls_are_covered_or_flagged(measured, name, sigma_px):
    """Bright stars (1e5 e-): by noise alone the pulls reach 400. With the error by pixel phase, which is that of all
    widths and phases that look alike, they must be 1 within a third; whoever is off by noise alone carries the flag."""
    by_noise, covered, table = measured(name, sigma_px, 1e5)
    assert 0.65 < covered < 1.33
    assert by_noise < 1.5 or has_flag(table.flags, StarFlag.PIXEL_PHASE).mean() > 0.95


@pytest.mark.parametrize(("name", "sigma_px"), [("cog", 0.7), ("tcog", 0.7), ("windowed", 1.0), ("windowed", 1.5)])
def test_well_sampled_stars_inside_their_window_carry_no_flag(measured, name, sigma_px):
    by_noise, covered, table = measured(name, sigma_px, 1e5)
    assert by_noise == pytest.approx(1.0, abs=0.13)
    assert covered == pytest.approx(by_noise, rel=0.02)
    assert not has_flag(table.flags, StarFlag.PIXEL_PHASE).any()


@pytest.mark.parametrize("name", MOMENTS)
def test_the_width_is_that_of_the_star(measured, name):
    for sigma_px in (0.5, 0.7, 1.0, 1.5):
        table = measured(name, sigma_px, 1e5)[2]
        assert np.median(table.width_px) == pytest.approx(sigma_px, rel=0.06)


def test_faint_stars_are_noise_and_carry_no_flag(measured):
    by_noise, covered, table = measured("cog", 0.6, 3e3)
    assert by_noise == pytest.approx(1.0, abs=0.12)
    assert covered == pytest.approx(1.0, abs=0.12)
    assert not has_flag(table.flags, StarFlag.PIXEL_PHASE).any()


def test_the_flag_keeps_no_star_out_of_an_attitude_and_is_seen_on_use():
    light = star_field([20.3, 40.1], [30.2, 12.4], 1e5, 0.45, (64, 64))
    stars = find_stars(noisy(light + 100.0, 3.0, np.random.default_rng(1)))
    assert has_flag(stars.flags, StarFlag.PIXEL_PHASE).all()
    assert not has_flag(stars.flags, UNFIT).any()
    assert np.all(stars.phase_error_px > 5 * stars.sigma_x_px)
    assert {"width_px", "phase_error_px"} <= set(stars.to_table().colnames)
