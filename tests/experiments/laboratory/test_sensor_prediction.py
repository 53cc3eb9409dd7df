"""Numbers of a predicted sensor put together again: star by star, from mechanics of a filter, in limits."""

import numpy as np
import pytest

from calib.accuracy.star_errors import colour_distance
from experiments.camera.settings import Config
from experiments.harness.range import with_value
from experiments.laboratory.sensor_prediction import predict_camera

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
