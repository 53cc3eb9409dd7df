"""Attitudes star by star: which are fit, and the sum of their information."""

import numpy as np
import pytest

from calib.accuracy.attitude_forecast import Sightings, attitude_forecast, draw_star_list, with_noise_scaled
from calib.accuracy.star_errors import DetectionLimit, FrameNoise, StarErrors, colour_distance
from calib.measure.centroid_error.prediction import CentroidErrors
from calib.records import NoiseModel
from optics.units import RAD_ARCSEC

WINDOW, SIZE, STARS, FRAMES, KELVIN, PIXEL_ARCSEC, BAD = 11, (800, 600), 200, 5, 5800.0, 20.0, 1e-3
LIMIT = DetectionLimit(
    frame=FrameNoise(pixel=NoiseModel(read_noise_e=10.0), saturation_e=1e4), pixels=1, fwhm_px=2.0, threshold_sigma=5.0
)
# noise falls as 1 / electrons, patterns and spots of other colours are constant; detected from 300 e- on
ERRORS = StarErrors(
    radius_px=np.array([0.0, 500.0]),
    reference_k=KELVIN,
    centroid=CentroidErrors(
        electrons=np.array([10.0, 1e6]),
        noise_px=np.array([[10.0, 1e-4], [20.0, 2e-4]]),
        bound_px=np.ones((2, 2)),
        pattern_px=np.full((2, 2), 0.03),
        phase_px=np.full((2, 2), 0.04),
        peak=np.array([0.3, 0.3]),
    ),
    colour_px=np.full((2, 2), 0.02),
    sharpness=np.array([[0.9, 0.9], [1.1, 1.1]]),
    detection_electrons=np.array([200.0, 400.0]),
    detection=np.array([[0.0, 1.0], [0.0, 1.0]]),
)


@pytest.fixture(scope="module")
def seen():
    rng = np.random.default_rng(2)
    pixel = rng.uniform(0.0, 1.0, (STARS, 2)) * SIZE
    direction = np.column_stack([(pixel - np.array(SIZE) / 2.0) * PIXEL_ARCSEC / RAD_ARCSEC, np.ones(STARS)])
    return Sightings(
        frames=FRAMES,
        frame=np.arange(STARS) % FRAMES,
        direction=direction / np.linalg.norm(direction, axis=1, keepdims=True),
        pixel_px=pixel,
        radius_px=np.hypot(*(pixel - (np.array(SIZE) - 1.0) / 2.0).T),
        temperature_k=rng.uniform(3000.0, 20_000.0, STARS),
        electrons=np.geomspace(50.0, 1e5, STARS),
        neighbour_e=np.where(np.arange(STARS) % 7 == 0, 350.0, 0.0),
        brighter_px=np.where(np.arange(STARS) % 11 == 0, 1.5, np.inf),
        colour_shift_px=rng.normal(0.0, 0.05, STARS),
    )


def test_attitudes_star_by_star(seen):
    """Fit: detected, alone, whole in its window, not saturated, on 121 good pixels; errors add in squares."""
    forecast = attitude_forecast(
        seen, ERRORS, LIMIT, pixel_arcsec=PIXEL_ARCSEC, size_px=SIZE, window_px=WINDOW, bad_fraction=BAD
    )
    apart = np.minimum(colour_distance(seen.temperature_k, KELVIN), 2.0)
    shown = seen.electrons * np.where(seen.temperature_k < KELVIN, 0.9, 1.1) ** apart
    detected = np.interp(np.log(shown), np.log([200.0, 400.0]), [0.0, 1.0])
    merged = seen.brighter_px < 1.2 * 2.0  # 2 sqrt(2) standard deviations of a filter of 2 px
    np.testing.assert_allclose(forecast.chance, np.where(merged, 0.0, detected))
    np.testing.assert_allclose(forecast.detected, np.bincount(seen.frame, forecast.chance))
    scatter = np.bincount(seen.frame, forecast.chance * (1.0 - forecast.chance))
    np.testing.assert_allclose(forecast.detected_variance, scatter, atol=1e-12)
    first = np.rint(seen.pixel_px) - WINDOW // 2
    whole = ((first >= 0) & (first + WINDOW <= SIZE)).all(axis=1)
    alone = 1.0 - np.interp(np.log(np.maximum(seen.neighbour_e, 1.0)), np.log([200.0, 400.0]), [0.0, 1.0])
    fit = detected * whole * alone * (0.3 * seen.electrons <= 1e4) * (1.0 - BAD) ** (WINDOW * WINDOW)
    np.testing.assert_allclose(forecast.stars, np.bincount(seen.frame, fit), rtol=1e-9)
    noise2 = (100.0 / shown * 2.0 ** (seen.radius_px / 500.0)) ** 2  # a power between the fields
    spot = 0.02 * colour_distance(seen.temperature_k, KELVIN)
    static2 = 0.03**2 + 0.04**2 + 0.5 * seen.colour_shift_px**2 + spot**2
    np.testing.assert_allclose(forecast.sigma_px, np.sqrt(noise2 + static2), rtol=1e-6)
    for which, square in ((forecast.noise_arcsec, noise2), (forecast.total_arcsec, noise2 + static2)):
        for frame in range(FRAMES):
            here = seen.frame == frame
            weight = fit[here] / (square[here] * (PIXEL_ARCSEC / RAD_ARCSEC) ** 2)
            information = sum(
                w * (np.eye(3) - np.outer(v, v)) for w, v in zip(weight, seen.direction[here], strict=True)
            )
            expected = np.sqrt(np.diag(np.linalg.inv(information))) * RAD_ARCSEC
            np.testing.assert_allclose(which[frame], expected, rtol=1e-6)
    np.testing.assert_allclose(forecast.across_arcsec, np.hypot(*forecast.total_arcsec[:, :2].T) / np.sqrt(2.0))


def test_a_list_has_its_stars_with_their_errors_and_its_false_alarms():
    place, rng = np.full((4000, 2), 100.0), np.random.default_rng(1)
    sure, never = np.arange(4000) < 1000, np.arange(4000) >= 3000
    chance = np.where(sure, 1.0, np.where(never, 0.0, 0.5))
    drawn, light = draw_star_list(
        place, np.geomspace(1.0, 9.0, 4000), np.full(4000, 0.1), chance, false_alarms=50.0, size_px=(800, 600), rng=rng
    )
    stars = np.abs(drawn - 100.0).max(axis=1) < 1.0
    assert np.count_nonzero(stars) == pytest.approx(2000, abs=5 * np.sqrt(500))
    assert drawn[stars].std() == pytest.approx(0.1, rel=0.05)
    assert np.count_nonzero(~stars) == pytest.approx(50, abs=5 * np.sqrt(50))
    assert light[~stars].max() == pytest.approx(0.5)


def test_noise_alone_is_scaled():
    np.testing.assert_allclose(with_noise_scaled(5.0, 3.0, np.array([0.0, 1.0, 4.0])), [4.0, 5.0, np.hypot(4.0, 12.0)])
