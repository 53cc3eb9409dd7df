import numpy as np
import pytest
from star_images import gaussian_stars

from calib.measure.centroiding import moments


def test_moments_are_those_of_two_lone_pixels():
    """Values 2 and 3 at (x, y) = (1, -2) and (-1, 4) from the origin: sums by hand."""
    values = np.zeros((1, 7, 3))
    values[0, 0, 2], values[0, 6, 0] = 2.0, 3.0
    rows, columns = np.arange(-2.0, 5.0)[None], np.arange(-1.0, 2.0)[None]
    found = moments.Moments.of(values, moments.powers(rows), moments.powers(columns))
    assert [float(one[0]) for one in found] == [5.0, -1.0, 8.0, 5.0, -16.0, 56.0]  # 1, x, y, xx, xy, yy


def test_half_light_radius_and_full_width_of_gaussians():
    """Half the light of a Gaussian lies within 1.1774 sigma (sigma 2 px: the pixel adds 1/12 px^2)."""
    light = gaussian_stars([15.0], [15.3], 2.0, height=31, width=31)
    found = moments.half_light_radius(light, np.array([15.0]), np.array([15.3]))[0]
    assert found == pytest.approx(1.1774 * np.sqrt(4.0 + 1.0 / 12.0), rel=0.02)
    assert np.exp(-0.5 * (0.5 * moments.FWHM_PER_SIGMA) ** 2) == pytest.approx(0.5, abs=1e-9)
    # around a whole pixel many distances are equal: mirrored and turned stamps gave radii 1 % apart
    k = np.arange(15) - 7.0
    light = np.outer(np.exp(-0.5 * (k / 0.9) ** 2), np.exp(-0.5 * ((k - 0.3) / 0.9) ** 2))
    turned = np.stack([light, light[:, ::-1], light[::-1], light.T])
    found = moments.half_light_radius(turned, np.full(4, 7.0), np.full(4, 7.0))
    np.testing.assert_allclose(found, found[0], rtol=1e-12)


def test_noise_of_a_centre_of_light_is_that_of_drawn_windows():
    """A disk of even light in 3000 windows of drawn pixels. The columns move x alone."""
    side, radius, level, frames = 48, 14.3, 1e4, 2
    rng, row, column = np.random.default_rng(6), *(np.mgrid[:48, :48] - 23.5)
    light = level * np.clip(radius + 0.5 - np.hypot(row, column), 0.0, 1.0)
    found = []
    for _ in range(30):
        windows = light * (1.0 + 0.01 * rng.standard_normal((100, side, side)))
        temporal2 = (light + 150.0) / frames
        windows += np.sqrt(temporal2 + 8.0**2) * rng.standard_normal(windows.shape)
        windows += 5.0 * rng.standard_normal((100, 1, side))
        found.append(moments.centre_of_light(windows + 77.0) - (side - 1) / 2)
    expected = moments.disk_centre_variance_px2(
        [level], radius, side, frames=frames, floor_e2=150.0, offset_e=8.0, column_e=5.0, prnu=0.01
    )
    assert np.mean(np.square(found)) == pytest.approx(expected[0], rel=0.07)
