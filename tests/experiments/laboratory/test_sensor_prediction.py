"""Numbers of a predicted sensor put together again: star by star, from mechanics of a filter, in limits."""

import numpy as np
import pytest

from calib.accuracy.star_errors import colour_distance
from calib.measure.centroid_prediction import phase_windows
from experiments.camera.settings import Config
from experiments.harness.range import with_value
from experiments.laboratory.sensor_prediction import predict_camera
from optics.units import RAD_ARCSEC

WINDOW, DARK_FRAMES, BACKGROUND_E, KELVIN = 11, 4, 30.0, 5800.0


@pytest.fixture(scope="module")
def sensor():
    chip = {"lens": "star_tracker_26mm", "detector": "cmv4000", "width_px": 800, "height_px": 800, "exposure_s": 0.2}
    config = Config(
        instrument={**chip, "defocus_mm": 0.0, "diffraction": "rays"},
        passband={"range_nm": [500.0, 800.0]},
        background_e_per_s=BACKGROUND_E / 0.2,
        dark_frames=DARK_FRAMES,
        window_px=WINDOW,
        detector={"hot_fraction": 1e-3},
        sky={"attitudes": 60},
    )
    return predict_camera(config)


def test_attitudes_star_by_star(sensor):
    """Fit: found, alone, whole in its window, not saturated, on 121 good pixels; errors add in squares."""
    view, stars, forecast = sensor.view, sensor.stars, sensor.attitude
    place, radius, kelvin = view.sample.pixel_px, view.radius_px, view.temperature_k
    electrons = 0.2 * sensor.state.electrons_per_s(view.magnitude, kelvin, radius)
    shown = stars.effective(electrons, kelvin, radius)
    chance = np.where(view.brighter_px < 1.2 * sensor.state.fwhm_px, 0.0, stars.detected_at(shown, radius))
    np.testing.assert_allclose(forecast.found, np.bincount(view.sample.frame, chance), rtol=0.01)
    scatter = np.bincount(view.sample.frame, chance * (1.0 - chance))
    np.testing.assert_allclose(forecast.found_variance, scatter, rtol=0.05)
    first = np.rint(place) - WINDOW // 2
    whole = ((first >= 0) & (first + WINDOW <= 800)).all(axis=1)
    brightest = electrons * np.interp(radius, stars.radius_px, stars.centroid.peak)
    chip = sensor.detector
    full = min(chip.full_well_e, (chip.largest_dn - chip.offset_dn) / chip.gain_dn_per_e)
    top = full - BACKGROUND_E - sensor.pixel.dark_e
    other = electrons * 10.0 ** ((view.magnitude - view.neighbour_mag) / 2.5)
    good = (1.0 - 1e-3 - chip.dead_fraction) ** (WINDOW * WINDOW)
    fit = good * chance * whole * (brightest <= top) * (1.0 - stars.detected_at(other, radius))
    np.testing.assert_allclose(forecast.stars, np.bincount(view.sample.frame, fit), rtol=0.02)
    radial = (place - 399.5) / radius[:, None]
    colour2 = ((radial * sensor.state.colour_shift_px(kelvin, radius)[:, None]) ** 2).mean(1)
    noise, pattern, phase, spot = (
        stars.sigma_at(table, shown if n == 0 else electrons, radius)
        for n, table in enumerate(
            (stars.centroid.noise_px, stars.centroid.pattern_px, stars.centroid.phase_px, stars.colour_px)
        )
    )
    towards = 1.0 / kelvin - 1.0 / KELVIN
    spot = spot * np.abs(towards) / np.where(towards > 0.0, 1.0 / 3500.0 - 1.0 / KELVIN, 1.0 / KELVIN - 1e-4)
    static2 = pattern**2 + phase**2 + colour2 + spot**2
    assert colour2.max() > 0.05 * (noise**2).min()
    pixel_rad = 0.0055 / sensor.state.sensor.focal_length_mm
    for which, square in ((forecast.noise_arcsec, noise**2), (forecast.total_arcsec, noise**2 + static2)):
        for frame in range(0, 60, 6):
            here = np.flatnonzero(view.sample.frame == frame)
            v = view.sample.direction[here]
            weight = fit[here] / (square[here] * pixel_rad**2)
            information = sum(w * (np.eye(3) - np.outer(one, one)) for w, one in zip(weight, v, strict=True))
            expected = np.sqrt(np.diag(np.linalg.inv(information))) * RAD_ARCSEC
            np.testing.assert_allclose(which[frame], expected, rtol=0.03)
    across = np.sqrt((forecast.total_arcsec[:, 0] ** 2 + forecast.total_arcsec[:, 1] ** 2) / 2.0)
    assert sensor.value("attitude_cross_arcsec") == pytest.approx(np.sort(across)[29], rel=1e-9)
    assert sensor.value("attitude_roll_worst_arcsec") == pytest.approx(forecast.total_arcsec[:, 2].max(), rel=1e-9)


def test_a_star_is_found_when_its_filtered_light_is_the_threshold(sensor):
    """Half of the stars: light times a Gaussian filter over the noise that it lets through."""
    chip, light = sensor.processing, phase_windows(sensor.state.psfs[:1], 9, phases=3).light
    at = np.arange(9) - 4.0
    kernel = np.exp(-np.add.outer(at**2, at**2) / (2.0 * (chip.fwhm_px / 2.3548) ** 2))
    kernel /= np.sqrt((kernel**2).sum())
    signal = max((light * np.roll(kernel, (y, x), (0, 1))).sum((1, 2)).mean() for y in (-1, 0, 1) for x in (-1, 0, 1))
    half = chip.true_sigma * np.sqrt(chip.frame.empty_e2) / signal
    assert np.interp(0.5, sensor.stars.detection[0], sensor.stars.detection_electrons) == pytest.approx(half, rel=0.1)
    for share, name in ((0.5, "limiting_magnitude_mag"), (0.9, "complete_magnitude_mag")):
        radius = 400.0 * np.sqrt(np.linspace(0.01, 0.99, 50))  # evenly over a disk, nearly the detector
        electrons = sensor.electrons(np.full(50, sensor.value(name)), KELVIN, radius)
        assert sensor.stars.detected_at(electrons, radius).mean() == pytest.approx(share, abs=0.05)


def test_sharper_spots_count_for_more_light(sensor):
    """In white noise: root of the sum of squares over the pixels of a window, for stars of 3500 and 10 000 K."""
    state, fields = sensor.state, sensor.stars.radius_px
    windows = [phase_windows(psfs, WINDOW).light for psfs in (state.psfs, state.cold_psfs, state.hot_psfs)]
    own, cold, hot = (np.sqrt((light**2).sum((1, 2)).reshape(len(fields), -1).mean(1)) for light in windows)
    for kelvin, other in ((3500.0, cold), (10_000.0, hot)):
        found = sensor.stars.effective(np.full(len(fields), 1000.0), np.full(len(fields), kelvin), fields)
        np.testing.assert_allclose(np.log(found / 1000.0), np.log(other / own), rtol=0.1, atol=1e-4)  # up to 0.7 %


def test_noise_of_pixels_dark_frames_and_background(sensor):
    """Faint stars: noise is that of the pixels, patterns that of the mean of four dark frames, half as large."""
    faint, chip = sensor.stars.centroid, sensor.processing.frame
    floor = sensor.pixel.floor_e2
    ratio2 = (faint.pattern_px[0, 0] / faint.noise_px[0, 0]) ** 2
    assert ratio2 == pytest.approx(floor / DARK_FRAMES / (floor + BACKGROUND_E), rel=0.1)
    assert chip.empty_e2 == pytest.approx(floor * (1.0 + 1.0 / DARK_FRAMES) + BACKGROUND_E, rel=1e-9)
    told = chip.noise.read_noise_e**2 + 1.0 / (12.0 * sensor.detector.gain_dn_per_e**2)
    assert told == pytest.approx(floor * (1.0 + 1.0 / DARK_FRAMES), rel=1e-9)
    assert chip.spread == pytest.approx(np.sqrt(sensor.pixel.floor_e4) / chip.empty_e2, rel=1e-9)


def test_single_numbers_of_the_page(sensor):
    radius, state, view = np.zeros(1), sensor.state, sensor.view
    full = min(sensor.detector.full_well_e, sensor.detector.converter_top_e) - BACKGROUND_E - sensor.pixel.dark_e
    brightest = sensor.electrons(np.array([sensor.value("saturation_mag")]), KELVIN, radius)[0]
    assert brightest * sensor.stars.centroid.peak.max() == pytest.approx(full, rel=1e-6)
    parts = [sensor.value(f"{name}_arcsec") for name in ("nea", "pattern", "phase", "colour")]
    assert sensor.value("single_star_arcsec") == pytest.approx(np.linalg.norm(np.nan_to_num(parts)), rel=1e-9)
    half = predict_camera(with_value(sensor.config, "throughput_fraction", 0.5))
    assert half.value("electrons_e") == pytest.approx(0.5 * sensor.value("electrons_e"), rel=1e-9)
    tangent = 400 * 0.0055 / state.sensor.focal_length_mm
    assert sensor.value("field_width_deg") == pytest.approx(2.0 * np.degrees(np.arctan(tangent)), rel=3e-3)
    # shift by colour along the radius, half of its square along an axis; and by spots of other colours than the PSF's
    seen = view.magnitude <= sensor.value("limiting_magnitude_mag")
    kelvin, away = view.temperature_k[seen], view.radius_px[seen]
    along = state.colour_shift_px(kelvin, away)[:, None] * (view.sample.pixel_px[seen] - 399.5) / away[:, None]
    x, y = np.meshgrid(np.linspace(-390.0, 390.0, 40), np.linspace(-390.0, 390.0, 40))
    far = np.hypot(x, y).ravel()
    electrons = sensor.electrons(np.full(1600, sensor.config.star.magnitude_mag), KELVIN, far)
    noise, spot = (
        np.sqrt((sensor.stars.sigma_at(table, electrons, far) ** 2).mean())
        for table in (sensor.stars.centroid.noise_px, sensor.stars.colour_px)
    )
    assert sensor.value("nea_arcsec") == pytest.approx(sensor.value("pixel_arcsec") * noise, rel=0.01)
    expected = np.hypot(np.sqrt((along**2).mean()), spot * np.sqrt((colour_distance(kelvin, KELVIN) ** 2).mean()))
    assert sensor.value("colour_arcsec") == pytest.approx(sensor.value("pixel_arcsec") * expected, rel=0.01)
