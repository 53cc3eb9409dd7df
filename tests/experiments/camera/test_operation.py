"""In motion and over life: mechanics of a slew by hand, ages where requirements cross, light and dark at the end."""

import numpy as np
import pytest

from experiments.camera.answer import limits
from experiments.camera.operation import in_motion, life_line, over_life
from experiments.camera.settings import Config
from experiments.harness.range import with_value
from experiments.laboratory.sensor_prediction import predict_camera
from experiments.laboratory.settings.prediction import aged_config
from optics.errors import ConfigError
from optics.validate import parse_model

IDEAL = {
    "instrument": {
        "lens": {"kind": "ideal", "focal_length_mm": 25.0, "f_number": 2.0, "spot_um": 4.0},
        "detector": "cmv4000", "width_px": 800, "height_px": 800, "exposure_s": 0.2,
    },
    "passband": {"range_nm": [500.0, 800.0]},
    "sky": {"attitudes": 40},
    "timing": {"readout_s": 0.05, "processing_s": 0.25},
}  # fmt: skip
LIFE = {"years": 8.0, "darkened_glass": 0.2, "contamination": 0.1, "ionising_dark_e_per_s": 60.0}


def sensor(**tables):
    return predict_camera(parse_model(Config, {**IDEAL, **tables}, "test"))


def test_the_slowest_step_sets_the_update_rate_and_all_of_them_the_age_of_an_attitude():
    found = sensor()
    assert found.value("update_rate_hz") == pytest.approx(4.0)
    assert found.value("latency_s") == pytest.approx(0.1 + 0.05 + 0.25)
    one_by_one = sensor(timing={**IDEAL["timing"], "overlapped": False})
    assert one_by_one.value("update_rate_hz") == pytest.approx(2.0)


@pytest.mark.slow
def test_a_slew_to_where_the_first_requirement_is_missed():
    prediction = sensor(requirements={"attitude_cross_arcsec": 0.4, "update_rate_hz": 1.0, "slew_rate_deg_per_s": 0.01})
    found = in_motion(prediction, limits(prediction.config))
    assert found.slew_fails == "attitude_cross_arcsec"
    for part, met in ((0.96, True), (1.04, False)):
        turned = with_value(prediction.config, "slew.rate_deg_per_s", part * found.slew_rate_deg_per_s)
        assert (predict_camera(turned).value("attitude_cross_arcsec") <= 0.4) is met
    assert np.all(np.diff(found.motion_attitude_cross_arcsec) > 0.0)
    pixel_deg = np.degrees(0.0055 / 25.0)
    assert found.motion_trail_px == pytest.approx(found.rate_deg_per_s * 0.2 / pixel_deg, rel=1e-3)
    # three frames 0.25 s apart: the last turn carried on misses the star by half the window of 13 px
    angle = 0.5 * found.acceleration_deg_per_s2 * (0.25 * np.arange(3)) ** 2
    assert angle[2] - (2.0 * angle[1] - angle[0]) == pytest.approx(6.0 * pixel_deg, rel=1e-3)


def test_a_star_leaves_its_window_first_where_nothing_is_required():
    found = in_motion(sensor(motion={"points": 2}), {})
    assert found.slew_fails == "window_px"
    assert found.slew_rate_deg_per_s == pytest.approx(found.rate_deg_per_s[-1])
    assert found.motion_trail_px[-1] < 13.0


@pytest.mark.slow
def test_age_at_which_the_first_requirement_is_missed():
    new = sensor(life=LIFE).value("limiting_magnitude_mag")
    prediction = sensor(life=LIFE, requirements={"limiting_magnitude_mag": new - 0.2, "nea_arcsec": 100.0})
    required = limits(prediction.config)
    found = over_life(prediction, required)
    assert (found.life_missed, found.life_of, found.life_fails) == (1, 2, "limiting_magnitude_mag")
    for years, met in ((0.97, True), (1.03, False)):
        old = aged_config(prediction.config, years * found.life_lasts_years / 8.0)
        assert (predict_camera(old).value("limiting_magnitude_mag") >= new - 0.2) is met
    assert found.life_light[-1] == pytest.approx(0.8 * 0.9)
    factor = 2.0 ** ((0.0 - 25.0) / 6.5)  # the data sheet's doubling, chip at 0 C
    assert found.life_dark_e[[0, -1]] == pytest.approx([125.0 * factor * 0.2, 185.0 * factor * 0.2], rel=1e-6)
    assert "1 of 2 met; first missed: limiting_magnitude_mag after" in life_line(found)


def test_lost_light_is_lost_magnitudes():
    """Against the noise of a pixel without light the faintest star needs so many electrons."""
    found = over_life(sensor(life={"years": 5.0, "darkened_glass": 0.28}), {})
    lost = found.life_limiting_magnitude_mag[0] - found.life_limiting_magnitude_mag[-1]
    assert lost == pytest.approx(-2.5 * np.log10(0.72), abs=0.02)


def test_displacement_damage_adds_its_mean_dark_current():
    """K V D of Srour & Lo, whatever the number of centres: 0.19 e-/s per um^3 and TeV/g at 300 K after a week."""
    dose = {"years": 1.0, "displacement_dose_tev_per_g": 100.0, "depleted_volume_um3": 60.0}
    warm = {**IDEAL["instrument"], "chip_temperature_c": 26.85}
    found = over_life(sensor(life=dose, instrument=warm), {})
    grown = (found.life_dark_e[-1] - found.life_dark_e[0]) / 0.2
    assert grown == pytest.approx(0.19 * 60.0 * 100.0, rel=0.02)
    assert found.life_damaged_percent[-1] == pytest.approx(
        100.0 * (1.0 - np.exp(-0.0971794 / 4100.0 * 6000.0)), rel=1e-4
    )
    with pytest.raises(ConfigError, match="depleted_volume_um3 is needed"):
        parse_model(Config, {"life": {"years": 1.0, "displacement_dose_tev_per_g": 1.0}}, "test")


def test_no_life_and_no_motion_where_none_is_asked_for():
    assert over_life(sensor(), {}) is None
    assert in_motion(sensor(motion={"points": 0}), {}) is None
