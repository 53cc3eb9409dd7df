"""Stars of a Gaussian PSF: centroid errors and detection in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest
from star_images import gaussian_epsf

from calib.accuracy.frame_check import centroid_scatter, false_alarms_against, limit_shift, rms_against_sigma
from calib.accuracy.star_errors import DetectionLimit, FrameNoise, StarErrors, colour_distance, mean_snr, star_errors
from calib.records import NoiseModel

SIGMA_PX, FWHM_PX, READ_E, DARK_FRAMES, BACKGROUND_E = 1.6, 1.6 * 2.3548, 20.0, 4, 30.0


FRAME = FrameNoise(
    pixel=NoiseModel(read_noise_e=READ_E),
    spread_e4=100.0,
    prnu=0.01,
    background_e=BACKGROUND_E,
    dark_frames=DARK_FRAMES,
    saturation_e=1e4,
    clipped_ratio=0.9,
)
LIMIT = DetectionLimit(frame=FRAME, pixels=10**6, fwhm_px=FWHM_PX, threshold_sigma=6.0)


@pytest.fixture(scope="module")
def stars():
    usual, wider, sharper = ((gaussian_epsf(sigma, 8, 10),) * 2 for sigma in (SIGMA_PX, 2.0, 1.28))
    return star_errors(usual, LIMIT, radius_px=(0.0, 500.0), window_px=15, other_psfs=(wider, sharper))


def test_noise_of_frames_and_a_limit_for_false_alarms():
    empty_e2 = READ_E**2 * (1.0 + 1.0 / DARK_FRAMES) + BACKGROUND_E
    assert FRAME.empty_e2 == pytest.approx(empty_e2)
    assert FRAME.noise.floor_e2 == pytest.approx(empty_e2 - BACKGROUND_E)
    assert FRAME.spread == pytest.approx(10.0 / empty_e2)
    assert FRAME.dark_pattern_e == pytest.approx(READ_E / 2.0)
    limit = DetectionLimit.of_false_alarms(0.01, frame=FRAME, pixels=10**6, fwhm_px=FWHM_PX)
    assert limit.false_alarms == pytest.approx(0.01, rel=1e-3)
    assert limit.threshold_sigma == pytest.approx(limit.true_sigma / 0.9)


def test_noise_and_pattern_of_a_faint_star(stars):
    """sigma_x = sqrt(8 pi s^4 B) / N in an even noise B per pixel (Thompson et al. 2002); a pattern the same."""
    flux = stars.centroid.electrons[0]  # 20 e-: photon noise counts for nothing
    scale = np.sqrt(8.0 * np.pi) * (SIGMA_PX**2 + 1.0 / 12.0) / flux
    assert stars.centroid.noise_px[0, 0] == pytest.approx(scale * np.sqrt(READ_E**2 + BACKGROUND_E), rel=0.03)
    assert stars.centroid.pattern_px[0, 0] == pytest.approx(scale * READ_E / 2.0, rel=0.03)
    at = stars.sigma_at(stars.centroid.noise_px, np.array([2.0 * flux]), np.array([250.0]))
    assert at[0] == pytest.approx(0.5 * scale * np.sqrt(READ_E**2 + BACKGROUND_E), rel=0.05)
    assert stars.rms_at(stars.centroid.noise_px, np.full(3, 2.0 * flux), np.zeros(3)) == pytest.approx(at[0], rel=1e-6)


def test_signal_to_noise_with_matched_weights():
    """Faint: N / sqrt(B) times the root of the sum of squares of the PSF, 1 / (2 sqrt(pi) s)."""
    expected = 50.0 / np.sqrt(FRAME.empty_e2) / (2.0 * np.sqrt(np.pi) * np.sqrt(SIGMA_PX**2 + 1.0 / 12.0))
    assert mean_snr(gaussian_epsf(SIGMA_PX, 8, 10), 50.0, FRAME, 15) == pytest.approx(expected, rel=0.04)


def test_half_of_the_stars_are_detected_where_the_filtered_light_is_the_threshold(stars):
    """A Gaussian filtered with its own width peaks at N / (4 pi s^2) in a noise of sqrt(B / (4 pi s^2))."""
    half = 6.0 * 0.9 * np.sqrt(FRAME.empty_e2 * 4.0 * np.pi) * SIGMA_PX
    assert np.interp(0.5, stars.detection[0], stars.detection_electrons) == pytest.approx(half, rel=0.1)
    assert stars.detected_at(np.array([0.1 * half, 5.0 * half]), np.zeros(2)).tolist() == [0.0, 1.0]


def test_sharper_spots_count_for_more_light(stars):
    """Root of the sum of squares of a Gaussian: 1 / s."""
    kelvin = np.array([3500.0, 10_000.0, 5800.0])
    found = stars.effective(np.full(3, 1000.0), kelvin, np.zeros(3))
    width = np.sqrt(np.array([2.0, 1.28, SIGMA_PX]) ** 2 + 1.0 / 12.0)
    np.testing.assert_allclose(found, 1000.0 * width[2] / width, rtol=0.01)


def test_a_single_psf_is_that_of_the_whole_field(stars):
    alone = star_errors((gaussian_epsf(SIGMA_PX, 8, 10),), LIMIT, window_px=15)
    np.testing.assert_allclose(alone.centroid.noise_px[0], stars.centroid.noise_px[0])
    assert not alone.colour_px.any()


def test_magnitude_limits_are_where_the_fraction_of_stars_passes():
    """Detected from 100 e- on in the middle, from 400 e- on at the edge: half at 100, nine tenths at 400 e-."""
    step = SimpleNamespace(detected_at=lambda e, radius: (e >= np.where(radius > 0.5, 400.0, 100.0)) * 1.0)
    for fraction, electrons in ((0.5, 100.0), (0.9, 400.0)):
        limit = StarErrors.limiting_magnitude(step, np.full(2, 1e6), np.array([0.0, 1.0]), fraction)
        assert limit == pytest.approx(2.5 * np.log10(1e6 / electrons), abs=0.06)


def test_colour_distance_by_hand():
    """1/T of 3500, 5800 and 10 000 K: 2.857e-4, 1.724e-4, 1e-4."""
    found = colour_distance(np.array([3500.0, 5800.0, 10_000.0, 4365.0]), 5800.0)
    np.testing.assert_allclose(found, [1.0, 0.0, 1.0, 0.5], atol=2e-3)
    assert colour_distance(np.array([5000.0]), 3500.0)[0] == pytest.approx((1 / 3500 - 1 / 5000) / (1 / 3500 - 1e-4))


# --- Frames against the prediction, with errors that are drawn from it


READOUTS, STARS = 4, 60


def drawn(stars, rng, worse=1.0, fainter_mag=0.0):
    """Pulls of scatter and limit of frames as predicted, or with more noise, or fainter stars."""
    radius = np.linspace(10.0, 490.0, STARS)
    bright, faint = np.full(STARS, 5e3), 900.0 * 10.0 ** np.linspace(-0.25, 0.25, STARS)
    sigma = stars.sigma_at(stars.centroid.noise_px, bright, radius)
    error = worse * sigma[:, None] * rng.standard_normal((READOUTS, STARS, 2))
    noise = centroid_scatter(error, bright, radius, stars, LIMIT)
    found = rng.random((READOUTS, STARS)) < stars.detected_at(faint * 10.0 ** (-0.4 * fainter_mag), radius)
    return noise, limit_shift(found.mean(axis=0), faint, radius, stars)


def test_right_frames_scatter_as_their_stated_errors(stars):
    """Stated errors count the prediction's own too: pulls scatter by less than 1, not by much less."""
    rng = np.random.default_rng(7)
    runs = [drawn(stars, rng) for _ in range(200)]
    noise = np.array([(one.measured - one.predicted) / one.error for one, _ in runs])
    limit = np.array([shift / error for _, (shift, error) in runs])
    assert runs[0][0].n == 2 * STARS * (READOUTS - 1)
    for pull in (noise, limit):
        assert abs(pull.mean()) < 0.3
        assert 0.6 < np.sqrt((pull**2).mean()) < 1.12


def test_wrong_frames_show(stars):
    rng = np.random.default_rng(3)
    runs = [drawn(stars, rng, worse=1.3, fainter_mag=0.3) for _ in range(30)]
    assert np.mean([one.measured / one.predicted for one, _ in runs]) == pytest.approx(1.3, rel=0.03)
    assert np.mean([shift for _, (shift, _) in runs]) == pytest.approx(-0.3, abs=0.05)


def test_errors_of_unlike_size_against_their_sigma():
    rng = np.random.default_rng(5)
    sigma = rng.uniform(0.5, 2.0, 50)
    found = [rms_against_sigma(sigma * rng.standard_normal(50), sigma) for _ in range(400)]
    pull = np.array([(one.measured - one.predicted) / one.error for one in found])
    assert abs(pull.mean()) < 0.2
    assert np.sqrt((pull**2).mean()) == pytest.approx(1.0, abs=0.15)


def test_false_alarms_of_a_dark_frame_repeat():
    """Poisson, the mean dark frame of 9 in all 5 frames: 1 + 5 / 10; an alarm more, and a tenth of all."""
    found = false_alarms_against(np.array([3, 1, 0, 2, 4]), 2.0, 9)
    assert (found.measured, found.predicted, found.n) == (10.0, 10.0, 10)
    assert found.error == pytest.approx(np.sqrt(15.0 + 1.0 + 1.0))
