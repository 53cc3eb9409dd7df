"""Slew and life: mechanics of a slew, rates and ages at which requirements are missed, light and dark at the end."""

import numpy as np
import pytest
from small_sensors import ideal_lens, sensor

from experiments.camera.answer import limits
from experiments.camera.operation import in_motion, life_line, over_life
from experiments.camera.settings import CameraReportConfig
from experiments.harness.range import with_value
from experiments.laboratory.sensor_prediction import predict_camera
from experiments.laboratory.settings.prediction import aged_config
from optics.validate import parse_model

IDEAL = {
    **sensor(lens=ideal_lens()),
    "sky": {"attitudes": 40},
    "timing": {"readout_s": 0.05, "processing_s": 0.25},
}
LIFE = {"years": 8.0, "darkened_glass": 0.2, "contamination": 0.1, "ionising_dark_e_per_s": 60.0}


def predicted(**tables):
    return predict_camera(parse_model(CameraReportConfig, {**IDEAL, **tables}, "test"))


def test_the_slowest_step_sets_the_update_rate_and_all_of_them_the_age_of_an_attitude():
    overlapped = predicted()
    assert overlapped.value("update_rate_hz") == pytest.approx(4.0)
    assert overlapped.value("latency_s") == pytest.approx(0.1 + 0.05 + 0.25)
    sequential = predicted(timing={**IDEAL["timing"], "overlapped": False})
    assert sequential.value("update_rate_hz") == pytest.approx(2.0)


@pytest.mark.slow
def test_a_slew_to_where_the_first_requirement_is_missed():
    prediction = predicted(
        requirements={"attitude_cross_arcsec": 0.4, "update_rate_hz": 1.0, "slew_rate_deg_per_s": 0.01}
    )
    found = in_motion(prediction, limits(prediction.config))
    assert found.first_failure == "attitude_cross_arcsec"
    for fraction, met in ((0.96, True), (1.04, False)):
        turned = with_value(prediction.config, "slew.rate_deg_per_s", fraction * found.slew_rate_deg_per_s)
        assert (predict_camera(turned).value("attitude_cross_arcsec") <= 0.4) is met
    assert np.all(np.diff(found.attitude_cross_arcsec) > 0.0)
    pixel_deg = np.degrees(0.0055 / 25.0)
    assert found.trail_px == pytest.approx(found.rate_deg_per_s * 0.2 / pixel_deg, rel=1e-3)
    # three frames 0.25 s apart: the extrapolated rotation misses the star by half the window of 13 px
    angle = 0.5 * found.acceleration_deg_per_s2 * (0.25 * np.arange(3)) ** 2
    assert angle[2] - (2.0 * angle[1] - angle[0]) == pytest.approx(6.0 * pixel_deg, rel=1e-3)


def test_a_star_leaves_its_window_first_where_nothing_is_required():
    found = in_motion(predicted(motion={"points": 2}), {})
    assert found.first_failure == "window_px"
    assert found.slew_rate_deg_per_s == pytest.approx(found.rate_deg_per_s[-1])
    assert found.trail_px[-1] < 13.0


@pytest.mark.slow
def test_age_at_which_the_first_requirement_is_missed():
    new = predicted(life=LIFE).value("limiting_magnitude_mag")
    prediction = predicted(life=LIFE, requirements={"limiting_magnitude_mag": new - 0.2, "nea_arcsec": 100.0})
    required = limits(prediction.config)
    found = over_life(prediction, required)
    assert (found.requirements_missed_at_end, found.requirements_at_end, found.first_failure) == (
        1,
        2,
        "limiting_magnitude_mag",
    )
    for years, met in ((0.97, True), (1.03, False)):
        old = aged_config(prediction.config, years * found.lifetime_years / 8.0)
        assert (predict_camera(old).value("limiting_magnitude_mag") >= new - 0.2) is met
    assert found.transmission[-1] == pytest.approx(0.8 * 0.9)
    factor = 2.0 ** ((0.0 - 25.0) / 6.5)  # the data sheet's doubling, chip at 0 C
    assert found.dark_e[[0, -1]] == pytest.approx([125.0 * factor * 0.2, 185.0 * factor * 0.2], rel=1e-6)
    assert "1 of 2 met; first missed: limiting_magnitude_mag after" in life_line(found)


def test_darkened_glass_costs_limiting_magnitude():
    """The electrons of the faintest star follow from the noise of a dark pixel, which transmission does not change."""
    found = over_life(predicted(life={"years": 5.0, "darkened_glass": 0.28}), {})
    loss_mag = found.limiting_magnitude_mag[0] - found.limiting_magnitude_mag[-1]
    assert loss_mag == pytest.approx(-2.5 * np.log10(0.72), abs=0.02)


def test_displacement_damage_adds_its_mean_dark_current():
    """K V D of Srour & Lo, whatever the number of centres: 0.19 e-/s per um^3 and TeV/g at 300 K after a week."""
    dose = {"years": 1.0, "displacement_dose_tev_per_g": 100.0, "depleted_volume_um3": 60.0}
    warm = {**IDEAL["instrument"], "chip_temperature_c": 26.85}
    found = over_life(predicted(life=dose, instrument=warm), {})
    growth = (found.dark_e[-1] - found.dark_e[0]) / 0.2
    assert growth == pytest.approx(0.19 * 60.0 * 100.0, rel=0.02)
    assert found.damaged_percent[-1] == pytest.approx(100.0 * (1.0 - np.exp(-0.0971794 / 4100.0 * 6000.0)), rel=1e-4)


def test_no_life_and_no_motion_without_settings():
    assert over_life(predicted(), {}) is None
    assert in_motion(predicted(motion={"points": 0}), {}) is None
