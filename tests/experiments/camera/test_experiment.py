"""The camera report as a user runs it."""

import json
import re

import pytest

from experiments.camera.settings import main


@pytest.fixture(scope="module")
def sensor(sensor_file):
    return sensor_file("limiting_magnitude_mag = 4.0\nattitude_roll_arcsec = 0.001")


def run(sensor, folder, *options):
    status = main(["--sensor", str(sensor), "--quick", *options, "--out", str(folder / "out")], own_process=False)
    return (
        status,
        json.loads((folder / "out" / "summary.json").read_text()),
        (folder / "out" / "report.html").read_text(),
    )


@pytest.mark.slow
def test_frames_confirm_the_prediction(quick_run_of):
    """Every criterion of a healthy sensor holds."""
    summary = json.loads((quick_run_of("camera") / "summary.json").read_text())
    assert [criterion["name"] for criterion in summary["criteria"] if criterion["passed"] is False] == []
    frames = summary["results"]["frames"]
    nea = {name: frames[name]["value"]["nea"] for name in ("measured", "predicted")}
    assert nea["measured"] == pytest.approx(nea["predicted"], rel=0.15)


@pytest.mark.slow
def test_frames_of_a_sensor_that_turns(sensor, tmp_path, engine):
    """Stars that trail over 6 px: noise, detection and attitudes are still what is predicted."""
    slew = ("--set", "slew.rate_deg_per_s=0.25", "--set", "slew.direction_deg=30", "--set", "window_px=13")
    status, summary, page = run(sensor, tmp_path, *slew, "--set", "tornado.parameters=[]")
    assert status == 0
    assert len(summary["criteria"]) == 6  # the frames turn already: none turn for a criterion of their own
    assert "trail" in page


@pytest.mark.slow
def test_a_sensor_that_detects_too_few_stars(sensor, tmp_path, engine):
    """Fields of 0.4 degrees and 20 ms: no attitude in most of the sky, and no traceback."""
    narrow = {"lens": "star_camera_206mm", "width_px": 300, "height_px": 200, "exposure_s": 0.02, "defocus_mm": 0.01}
    changes = [word for key, value in narrow.items() for word in ("--set", f"instrument.{key}={value}")]
    status, summary, page = run(sensor, tmp_path, *changes)
    assert status == 0
    assert "too few" in page
    assert "nan" not in re.sub("<[^>]*>", " ", page.partition("<footer")[0])
    assert not [one for one in summary["criteria"] if one["name"].startswith("attitude") and one["passed"]]


@pytest.mark.slow
def test_criteria_fail_on_a_wrong_prediction(sensor, tmp_path, engine, monkeypatch):
    """Read noise half of what the frames have: noise, false alarms and attitudes are noticed."""
    from dataclasses import replace

    from experiments.laboratory import sensor_prediction as prediction

    true = prediction.detection_limit

    def quieter(config, detector, fwhm_px):
        return true(config, replace(detector, read_noise_e=detector.read_noise_e / 2.0), fwhm_px)

    monkeypatch.setattr(prediction, "detection_limit", quieter)
    status, summary, _ = run(sensor, tmp_path)
    assert status == 1
    failed = " ".join(one["name"] for one in summary["criteria"] if one["passed"] is False)
    assert "NEA" in failed
    assert "Limiting magnitude" in failed
