"""Noise of circles from pixels: quadrature, scaling, and fits to drawn pictures."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from calib.measure.targets import circle_noise
from calib.measure.targets.screen_circles import (
    EDGE_HALF_WIDTH_PX,
    RAYS,
    RIM_LEVEL,
    RIM_PX,
    SPOKES,
    ScreenPicture,
    fit_aperture,
    fit_hole,
    fit_spot,
    measure_offset,
)


class PlainScreen:
    """A camera square to the screen, 0.01 mm per pixel, 201 x 201 px."""

    pitch_mm = 0.01

    def to_pixel(self, screen_mm):
        return np.asarray(screen_mm, float) / self.pitch_mm + 100.0

    def to_screen(self, pixel_px):
        return (np.asarray(pixel_px, float) - 100.0) * self.pitch_mm


def disk(centre_px, radius_px, soft_px):
    """Brightness 1 within a radius, with a soft edge."""
    row, column = np.mgrid[:201, :201] - 100.0
    return norm.cdf(radius_px - np.hypot(column - centre_px[0], row - centre_px[1]), scale=soft_px)


def test_variance_of_a_centre_by_pixels():
    """Falls with the square of the slope; interpolation between two pixels leaves the mean of t^2 + (1 - t)^2."""
    flat, steep = (
        circle_noise.centre_variance_px2(
            circle_noise.Contour(radius=200.0, slope=slope, brightness=0.5, half=4.0), 1e4, 270, 25.0, 0.0, RIM_PX
        )
        for slope in (0.1, 0.2)
    )
    assert steep == pytest.approx(flat / 4.0)
    part = np.linspace(0.0, 1.0, 10_001)
    assert pytest.approx(np.mean(part**2 + (1.0 - part) ** 2), rel=1e-3) == circle_noise.ACROSS


def test_lines_through_profiles():
    offset = np.linspace(-5.0, 5.0, 2001)
    assert np.trapezoid(circle_noise.line_weight(offset, 2.0), offset) == pytest.approx(1.0, rel=1e-4)
    assert circle_noise.line_slope(3.0 - 0.7 * offset, offset, 2.0) == pytest.approx(-0.7)
    # a step blurred by much less than the window: 15 / (16 h)
    assert circle_noise.blurred_step_slope(0.01, 2.0) == pytest.approx(15.0 / 32.0, rel=0.01)


@pytest.mark.parametrize("offset", [-1.0, 0.4, 3.0, 6.5])
def test_response_of_the_hole_s_edge_is_the_blurred_window_less_half_the_line(offset):
    """SciPy's quadrature of the weights against a normal density; the line has integral 1 and no first moment."""
    blur, (near, far) = 0.58, RIM_PX
    line = np.linalg.solve(
        [[far - near, (far**2 - near**2) / 2], [(far**2 - near**2) / 2, (far**3 - near**3) / 3]], [1, 0]
    )
    window = quad(lambda u: 0.375 * (1.0 - (u / 2.0) ** 2) * norm.pdf(offset, u, blur), -2.0, 2.0)[0]
    rim = quad(lambda u: (line[0] + line[1] * u) * norm.pdf(offset, u, blur), near, far)[0]
    found = circle_noise.hole_response(np.array([offset]), 2.0, blur, RIM_PX)[0]
    assert found == pytest.approx(window - 0.5 * rim, abs=2e-3)


def test_circles_of_a_screen_and_their_noise():
    """A glowing aperture, and a spot around its dark hole, 16 noisy pictures: centres, and their scatter to 4 sigma."""
    rng, full, noise = np.random.default_rng(4), 1e4, 100.0
    glow, hole = disk([0.3, -0.2], 40.0, 0.6), disk([0.3, -0.2], 40.0, 0.6)
    light = disk([2.1, 1.4], 62.0, 5.0) * (1.0 - hole)
    offsets, centres = [], []
    for _ in range(16):
        pictures = [full * part + noise * rng.standard_normal((201, 201)) for part in (glow, light)]
        first, second = (ScreenPicture(electrons=one, camera=PlainScreen()) for one in pictures)
        aperture = fit_aperture(first, 0.4)
        spot = fit_spot(second, aperture, 0.75)
        offsets.append([measure_offset(one, spot, 0.01).offset_px for one in (aperture, fit_hole(second, aperture))])
        centres.append(aperture.centre / 0.01)
    assert np.mean(centres, axis=0) == pytest.approx([0.3, -0.2], abs=0.02)
    assert np.mean(offsets, axis=0) == pytest.approx(np.array([[1.8, 1.6]] * 2), abs=0.1)
    radius = np.arange(20.0, 100.0, 0.25)
    profile = norm.cdf(62.0 - radius, scale=5.0)
    contour = circle_noise.rim_contour(profile, radius, 40.0, EDGE_HALF_WIDTH_PX["spot"], RIM_LEVEL)
    assert contour.brightness == pytest.approx(norm.cdf(62.0 - contour.radius, scale=5.0), rel=0.02)
    edge = circle_noise.Contour(radius=40.0, slope=circle_noise.blurred_step_slope(0.7, 1.5), brightness=0.5, half=1.5)
    expected = np.sqrt(
        sum(
            circle_noise.centre_variance_px2(one, full, SPOKES * RAYS, noise**2, 0.0, RIM_PX) for one in (edge, contour)
        )
    )
    scatter = np.sqrt(np.var(offsets, axis=0, ddof=1)[0].mean())
    assert scatter == pytest.approx(expected, rel=4.0 / np.sqrt(2 * 30) + 0.15)


def test_even_light_moves_no_centre():
    """Particles at every angle alike, on the rim; one more on one side moves the spot to that side."""
    angle = (np.arange(720) + 0.5) * np.pi / 360
    spot = circle_noise.Contour(radius=60.0, slope=-0.05, brightness=0.3, half=14.0)
    hole = circle_noise.Contour(radius=40.0, slope=0.3, brightness=0.5, half=1.5, rim=1.0)
    x, y = 60.0 * np.cos(angle), 60.0 * np.sin(angle)
    even = circle_noise.light_offsets_px(x, y, 100.0, spot, hole, 0.6, 270, RIM_PX)
    assert np.abs(even).max() < 1e-10
    more = circle_noise.light_offsets_px(np.append(x, 60.0), np.append(y, 0.0), 100.0, spot, hole, 0.6, 270, RIM_PX)
    assert more[0, 0] > 0.0
    assert abs(more[0, 1]) < 1e-3 * more[0, 0]
