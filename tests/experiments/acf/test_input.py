"""Whatever a user can get wrong in the attitude-correlated-frames experiment: one clear line, exit code 2."""

import re

import pytest

SETTINGS = [
    # settings, what the line has to say
    (["frames=0"], "frames = 0: .*at least 4"),
    (["runs=1"], "runs = 1: .*at least 4"),
    (["sky.stars_per_frame=1"], "sky.stars_per_frame = 1: .*at least 2"),
    (["frames=6", "sky.stars_per_frame=3"], "3 frames calibrate and give 18 equations for 14 unknowns"),
    (["frames=10", "counts=[2,4]"], "counts = 2, frames = 10: .* 20 equations for 14 unknowns"),
    (["frames=14", "sweep.stars=[2,4]"], "sweep.stars = 2, frames = 14: 56 measurements for 50 unknowns"),
    (["sweep.stars=[1,4]"], "sweep.stars.* = 1: .*at least 2"),
    (["sweep.stars=[8,4]"], "increasing values"),
    (["sweep.gyro_factor=[-1,1]"], "sweep.gyro_factor.* = -1: .*at least 0"),
    (["noise_px=[nan]"], r"nan: a finite number is needed [^;]*$"),
    (["noise_px=[0.2]"], "1 given; at least 2"),
    (["bias_deg_per_h=[]"], "0 given; at least 1"),
    (["noise_px=[0,0.2]"], "noise_px.* = 0: .*above 0"),
    (["noise_px=[0.2,0.1]"], "increasing values"),
    (["bias_deg_per_h=[-1]"], "bias_deg_per_h.* = -1: .*at least 0"),
    (["gyro.rate_hz=0.5"], "gyro.rate_hz = 0.5 Hz: at least frame_rate_hz = 1 Hz"),
    (["gyro.installation_deg=[2,2]"], "gyro.installation_deg"),
    (["camera.focal_length_mm=1"], "the field is 164 deg across the diagonal; at most 120 deg"),
    (["camera.pixel_pitch_um=1000"], "the field is .* deg across the diagonal"),
    (["camera.x0_px=900"], r"principal point \(900, -10\) px: at most a quarter"),
]


@pytest.mark.parametrize(("settings", "expected"), SETTINGS, ids=[" ".join(s) for s, _ in SETTINGS])
def test_wrong_setting(refused_by, settings, expected):
    said = refused_by("acf", settings=settings, within_s=5.0)
    assert re.search(expected, said), said


DESIGNS = [
    (
        ["gyro.motion=fixed_axis"],
        "rotation of the installation about this axis is not observable, 13 of the 14 unknowns",
    ),
    (
        ["gyro.angular_speed_deg_per_s=0.001"],
        r"the installation would be determined to 3\.\d deg only \(the body turns by 0\.034 deg",
    ),
    (["sky.phi_deg=[150,0,0]"], r"phi = 0, \d+ of \d+ stars are behind the camera; set start.phi_from_stars=true"),
    (["camera.q1_per_mm2=1"], r"distortion moves the image by \d+ % .* at most 30 %"),
    (["camera.q1_per_mm2=-0.02"], "this distortion folds the image over 2.* mm from the principal point"),
]


@pytest.mark.parametrize(("settings", "expected"), DESIGNS, ids=[" ".join(s) for s, _ in DESIGNS])
def test_night_that_cannot_determine_everything(refused_by, settings, expected):
    said = refused_by("acf", settings=settings, within_s=15.0)
    assert re.search(expected, said), said
