"""Guide stars counted star by star; lost in space with many stars and with too few."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from small_sensors import ideal_lens, sensor

from experiments.camera.guides import GUIDE_COUNTS, coverage, fraction_measured, lost_in_space
from experiments.camera.settings import CameraReportConfig
from experiments.laboratory.sensor_prediction import predict_camera
from optics.validate import parse_model
from render.catalogue.temperature import star_temperature
from render.sensor_file.catalogue import load_catalogue

TRACKER = {**sensor(lens=ideal_lens()), "sky": {"attitudes": 60}, "lost": {"attitudes": 10}}


@pytest.fixture(scope="module")
def tracker():
    return predict_camera(parse_model(CameraReportConfig, TRACKER, "test"))


def test_guide_stars_are_counted_one_by_one(tracker):
    """Guide stars: half a window inside the detector, alone in their window, between both magnitudes."""
    found, view, config = coverage(tracker), tracker.view, tracker.config
    catalogue = load_catalogue(config.catalogue)
    stars = catalogue.select(np.flatnonzero(catalogue.magnitude <= view.depth_mag))
    rate = tracker.state.electrons_per_s(stars.magnitude, star_temperature(stars), np.zeros(len(stars)))
    magnitude = -2.5 * np.log10(rate * config.instrument.exposure_s / tracker.electrons(np.array([0.0]), 5800.0)[0])
    window_rad, tree = 13.0 * 0.0055 / 25.0, cKDTree(stars.direction)
    counts = np.zeros(60)
    for star, frame, (x, y) in zip(view.sample.row, view.sample.frame, view.sample.pixel_px, strict=True):
        near = tree.query_ball_point(stars.direction[star], window_rad)
        alone = np.count_nonzero(magnitude[near] < magnitude[star] + 3.0) == 1
        inside = min(x, y) > 5.5 and max(x, y) < 793.5
        counts[frame] += inside and alone and found.guide_brightest_mag <= magnitude[star] <= found.guide_faintest_mag
    assert found.guide_stars_mean_per_frame == pytest.approx(counts.mean())
    sky_percent = [100.0 * np.mean(counts >= least) for least in GUIDE_COUNTS]
    assert found.sky_percent == pytest.approx(sky_percent)
    assert found.guide_faintest_mag < tracker.value("limiting_magnitude_mag")


@pytest.mark.reference
def test_lost_in_space_identification_and_a_field_that_is_too_narrow(tracker):
    pytest.importorskip("tetra3rs")
    found = lost_in_space(tracker)
    assert found.attitudes == 10
    assert found.lost_success_percent >= 90.0
    assert found.wrong_percent == 0.0
    assert fraction_measured(0, 10).uncertainty == pytest.approx(0.1)
    small = parse_model(CameraReportConfig, TRACKER | sensor(100, ideal_lens()), "test")
    assert "too narrow" in lost_in_space(predict_camera(small)).reason_skipped
