"""Guide stars by hand, and lost in space where there is nothing to find."""

import numpy as np
import pytest

from experiments.camera.guides import LEAST, coverage, lost_in_space
from experiments.camera.settings import Config
from experiments.laboratory.sensor_prediction import predict_camera
from optics.validate import parse_model

TRACKER = {
    "instrument": {
        "lens": {"kind": "ideal", "focal_length_mm": 25.0, "f_number": 2.0, "spot_um": 4.0},
        "detector": "cmv4000", "width_px": 800, "height_px": 800, "exposure_s": 0.2,
    },
    "passband": {"range_nm": [500.0, 800.0]},
    "sky": {"attitudes": 60},
    "lost": {"attitudes": 20},
}  # fmt: skip


@pytest.fixture(scope="module")
def tracker():
    return predict_camera(parse_model(Config, TRACKER, "test"))


def test_guide_stars_are_counted_one_by_one(tracker):
    """Frame by frame: inside the detector by half a window, nobody near, not too bright and not too faint."""
    found, view = coverage(tracker), tracker.view
    zero = tracker.electrons(np.array([0.0]), tracker.config.star.temperature_k)[0]
    counts = np.zeros(60)
    for star, frame in enumerate(view.sample.frame):
        x, y = view.sample.pixel_px[star]
        light = tracker.state.electrons_per_s(
            view.magnitude[[star]], view.temperature_k[[star]], np.zeros(1)
        )[0] * tracker.config.instrument.exposure_s  # fmt: skip
        magnitude = -2.5 * np.log10(light / zero)
        inside = min(x, y) > 5.5 and max(x, y) < 793.5
        alone = view.neighbour_mag[star] == np.inf
        counts[frame] += inside and alone and found.guide_brightest_mag <= magnitude <= found.guide_faintest_mag
    assert found.guides_mean_per_frame == pytest.approx(counts.mean())
    shares = [100.0 * np.mean(counts >= least) for least in LEAST]
    assert found.coverage_percent == pytest.approx(shares)
    assert found.guide_faintest_mag < tracker.value("limiting_magnitude_mag")


@pytest.mark.slow
@pytest.mark.reference
def test_a_good_tracker_is_not_lost_and_one_that_sees_nothing_is(tracker):
    pytest.importorskip("tetra3rs")
    found = lost_in_space(tracker)
    assert found.lost_attitudes == 20
    assert found.lost_success_percent >= 95.0
    assert found.lost_wrong_percent == 0.0
    short = parse_model(Config, {**TRACKER, "instrument": {**TRACKER["instrument"], "exposure_s": 2e-4}}, "test")
    blind = lost_in_space(predict_camera(short))
    assert blind.lost_success_percent < 50.0
    narrow = parse_model(
        Config, {**TRACKER, "instrument": {**TRACKER["instrument"], "width_px": 100, "height_px": 100}}, "test"
    )
    assert "too narrow" in lost_in_space(predict_camera(narrow)).lost_refusal
