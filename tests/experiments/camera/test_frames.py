"""Small frames of an ideal lens against the prediction."""

import math

import numpy as np
import pytest
from small_sensors import ideal_lens, sensor

from experiments.camera.comparison import MIN_SOLVABLE_STARS, compare, compare_sample, solved_frames
from experiments.camera.frames import render_frames, rendered_lenses
from experiments.camera.manufacture import RANKS
from experiments.camera.settings import CameraReportConfig
from experiments.laboratory.sensor_prediction import predict_camera


@pytest.fixture(scope="module")
def prediction():
    return predict_camera(
        CameraReportConfig(
            **sensor(320, ideal_lens(12.0, 1.6, 5.0), diffraction="rays"),
            window_px=9,
            centroid="windowed",
            dark_frames=4,
            sky={"attitudes": 10},
            motion={"points": 2},
            frames={"sky": 2, "chart_stars": 60, "readouts": 3},
        )
    )


@pytest.fixture(scope="module")
def rendered(prediction, engine):
    return render_frames(prediction)


def test_frames_are_what_is_predicted(prediction, rendered):
    rows = {row.comparison: row for row in compare(prediction, rendered)}
    judged = ("nea", "nea_moving", "limiting_magnitude", "false_alarms", "stars")
    assert {"electrons", "usable_stars", *judged} <= set(rows)
    assert rows["electrons"].measured == pytest.approx(rows["electrons"].predicted, rel=2e-3)
    for name in judged:
        assert abs(rows[name].deviation_sigma.value) < 4.0, name
    solved = solved_frames(prediction, rendered)
    assert solved.frames_unsolved == 0
    assert solved.chart_stars == len(rendered.star_grid.magnitude)
    if solved.attitude_ratio is not None:
        assert 0.2 < solved.attitude_ratio.value < 3.0
    assert (prediction.attitude.stars >= MIN_SOLVABLE_STARS).any()


def test_drawn_lenses_without_changes_have_the_nominal_noise(prediction, engine):
    lens = prediction.state.sensor.camera.focused_lens
    lenses = type("Lenses", (), {"ranked": ((lens, 1.0),) * len(RANKS)})
    for lens in rendered_lenses(prediction, lenses):
        assert abs(lens.measured_arcsec.value - lens.predicted_arcsec) < 5.0 * lens.measured_arcsec.uncertainty


def test_a_comparison_without_error_has_no_deviation():
    from calib.accuracy.frame_check import MeasuredAgainst

    none = compare_sample(
        "nea", "NEA", "arcsec", MeasuredAgainst(measured=1.0, predicted=1.0, error=math.nan, n=0), 2.0
    )
    assert np.isnan(none.deviation_sigma.value)
    assert none.measured == 2.0
