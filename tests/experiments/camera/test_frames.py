"""A few small frames of an ideal lens: everything that is compared, and what wrong frames do."""

import math

import numpy as np
import pytest

from experiments.camera.comparison import FEWEST_STARS, compare, compared, solved_frames
from experiments.camera.frames import render_frames, rendered_lenses
from experiments.camera.manufacture import CHOSEN
from experiments.camera.settings import Config
from experiments.laboratory.sensor_prediction import predict_camera


@pytest.fixture(scope="module")
def prediction():
    lens = {"kind": "ideal", "focal_length_mm": 12.0, "f_number": 1.6, "spot_um": 5.0}
    chip = {"detector": "cmv4000", "width_px": 320, "height_px": 320, "exposure_s": 0.2, "diffraction": "rays"}
    return predict_camera(
        Config(
            instrument={"lens": lens, **chip},
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
    found = {one.comparison: one for one in compare(prediction, rendered)}
    assert {"electrons", "nea", "nea_moving", "limiting_magnitude", "false_alarms", "stars", "fit_stars"} <= set(found)
    assert found["electrons"].measured == pytest.approx(found["electrons"].predicted, rel=2e-3)
    for name in ("nea", "nea_moving", "limiting_magnitude", "false_alarms", "stars"):
        assert abs(found[name].pull.value) < 4.0, name
    solved = solved_frames(prediction, rendered)
    assert solved.frames_unsolved == 0
    assert solved.chart_stars == len(rendered.chart.magnitude)
    if solved.attitude_ratio is not None:
        assert 0.2 < solved.attitude_ratio.value < 3.0
    assert (prediction.attitude.stars >= FEWEST_STARS).any()


def test_frames_of_drawn_lenses_are_those_of_the_lens(prediction, engine):
    """Nothing changed: noise of the nominal lens, three times."""
    lens = prediction.state.sensor.camera.focused_lens
    made = type("Made", (), {"chosen": ((lens, 1.0),) * len(CHOSEN)})
    for one in rendered_lenses(prediction, made):
        assert abs(one.measured_arcsec.value - one.predicted_arcsec) < 5.0 * one.measured_arcsec.uncertainty


def test_a_comparison_without_error_has_no_pull():
    from calib.accuracy.frame_check import MeasuredAgainst

    none = compared("nea", "NEA", "arcsec", MeasuredAgainst(measured=1.0, predicted=1.0, error=math.nan, n=0), 2.0)
    assert np.isnan(none.pull.value)
    assert none.measured == 2.0
