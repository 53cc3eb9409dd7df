"""Prediction without frames: closed forms, saturation, tornado, requirements."""

import numpy as np
import pytest
from small_sensors import RAYS, sensor

from experiments.camera.answer import ThermalRange, answer_rows, limits, swings
from experiments.camera.experiment import predicted
from experiments.camera.guides import Coverage, LostInSpace
from experiments.camera.operation import SlewPrediction
from experiments.camera.run import MANUFACTURED_LENS_REQUIREMENTS
from experiments.camera.settings import CameraReportConfig
from experiments.harness.range import with_value
from experiments.harness.sections import numbers_of
from experiments.harness.what_if import judge, missed_words
from experiments.laboratory.sensor_prediction import predict_camera, summarise_star_accuracy
from render.sensor_file.requirements import RequirementsConfig

TRACKER = {**sensor(1024, **RAYS), "sky": {"attitudes": 120}}


@pytest.fixture(scope="module")
def config():
    return CameraReportConfig(**TRACKER)


@pytest.fixture(scope="module")
def tracker(config):
    return predict_camera(config)


def test_a_star_that_saturates_has_no_accuracy_and_meets_no_requirement(config):
    """The brightest pixel of the star of [star] holds more than the full well: nothing is quoted."""
    long = predict_camera(with_value(config, "instrument.exposure_s", 20.0))
    assert long.value("electrons_e") * float(long.stars.centroid.peak.max()) > long.detector.full_well_e
    assert long.saturated
    for name in ("nea_arcsec", "single_star_arcsec", "snr"):
        assert np.isnan(long.value(name)), name
    assert not judge({"nea_arcsec": (100.0, False)}, numbers_of(summarise_star_accuracy(long)))[0].met


def test_saturation_and_sum_of_the_errors(tracker):
    """The brightest pixel of the star that just saturates is full; errors of a star add in squares."""
    full_e = min(tracker.detector.full_well_e, tracker.detector.converter_top_e) - tracker.pixel.dark_e
    brightest = tracker.electrons(np.array([tracker.value("saturation_mag")]), 5800.0)[0]
    assert brightest * tracker.stars.centroid.peak.max() == pytest.approx(full_e, rel=1e-6)
    parts = [tracker.value(f"{name}_arcsec") for name in ("nea", "pattern", "phase", "colour")]
    assert tracker.value("single_star_arcsec") == pytest.approx(np.linalg.norm(np.nan_to_num(parts)), rel=1e-9)
    assert tracker.value("colour_arcsec") > 0.0


def test_twice_the_light_is_three_quarters_of_a_magnitude(config, tracker):
    """Faint stars: the limit of half the throughput is brighter by 2.5 log 2."""
    half = predict_camera(with_value(config, "throughput_fraction", 0.5))
    shift = tracker.value("limiting_magnitude_mag") - half.value("limiting_magnitude_mag")
    assert shift == pytest.approx(2.5 * np.log10(2.0), abs=0.01)


def test_false_alarms_that_were_asked_for(config):
    asked = predict_camera(with_value(config, "false_alarms_per_frame", 0.01))
    assert asked.value("false_alarms_per_frame") == pytest.approx(0.01, rel=1e-3)
    assert asked.value("threshold_sigma") > 5.0


def test_tornado_and_verdicts(config, tracker):
    few = config.model_copy(
        update={
            "tornado": config.tornado.model_copy(
                update={"parameters": ("detector.prnu", "instrument.exposure_s", "throughput_fraction")}
            )
        }
    )
    found = swings(few, tracker)
    assert [swing.key for swing in found][0::2] == ["instrument.exposure_s", "throughput_fraction"]
    assert found[-1].gain == 0.0 < found[1].gain < found[-1].size  # transmission of 1: light can only be lost
    lines = list(answer_rows(tracker, [], found).values())
    assert len(lines) == 10
    assert max(map(len, lines)) <= 80
    assert f"G = {tracker.value('limiting_magnitude_mag'):.2f} mag" in lines[4]
    light = {swing.key: swing for swing in found}["throughput_fraction"]
    assert light.limiting_magnitude_change_mag[0] == pytest.approx(2.5 * np.log10(0.8), abs=0.01)
    required = {"limiting_magnitude_mag": 3.0, "nea_arcsec": 0.01, "field_deg": 10.0}
    asked = config.model_copy(update={"requirements": RequirementsConfig(**required)})
    verdicts = predicted(predict_camera(asked))["requirements"]
    assert {verdict.key: verdict.met for verdict in verdicts} == dict.fromkeys(required, True) | {"nea_arcsec": False}
    excess = {verdict.key: verdict.excess for verdict in verdicts}["limiting_magnitude_mag"]
    assert excess == pytest.approx(tracker.value("limiting_magnitude_mag") - 3.0)
    assert missed_words(verdicts) == "The sensor misses 1 of 3 requirements: NEA."


@pytest.mark.slow
def test_focus_gains_what_the_best_focus_gives(config):
    blurred = with_value(config, "instrument.defocus_mm", config.instrument.defocus_mm + 0.06)
    only = blurred.model_copy(
        update={"tornado": config.tornado.model_copy(update={"parameters": ("instrument.defocus_mm",)})}
    )
    (focus,) = swings(only, predict_camera(blurred))
    at_best = predict_camera(with_value(blurred, "instrument.defocus_mm", focus.best_value))
    assert abs(at_best.value("best_focus_um")) < 0.5
    assert focus.gain > 0.2


def test_every_requirement_has_its_prediction(tracker):
    records = (ThermalRange, Coverage, LostInSpace, SlewPrediction)
    names = set(tracker.numbers).union(
        MANUFACTURED_LENS_REQUIREMENTS, *(record.__dataclass_fields__ for record in records)
    )
    assert set(RequirementsConfig.model_fields) - {"sun_exclusion_deg"} <= names  # that: experiment straylight
    assert limits(CameraReportConfig()) == {}
