"""Focus, tilt and decentre of a detector behind a known lens, against the values set."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.calibration.camera_order import as_calibrated
from calib.cameras.fit import camera_model
from calib.psf.focus_tilt import gaussian_widths
from experiments.harness.summary import Measured
from experiments.twin.prescription import LensPose, fit_lens_pose, write_prescription
from experiments.twin.settings import TwinConfig
from optics.lens.perturb import refocus, tilt_image
from optics.lens_file import load_lens
from render.psf_lattice import render_psf_grid
from render.sensor_file.file import SensorFile, complete_sensor
from render.sensor_file.instrument import build_instrument, configured_lens
from render.sensor_file.tables import InstrumentConfig
from render.sky.star_light import star_light

CONFIG = InstrumentConfig(
    lens="star_tracker_26mm", detector="cmv4000", width_px=1024, height_px=1024, defocus_mm=0.0, diffraction="rays"
)
DEFOCUS_MM, TILT_DEG, DECENTRE_MM = 0.03, (0.25, -0.15), (0.1, 0.04)
START = '[instrument]\nlens = "star_tracker_26mm"\ndetector = "cmv4000"\ndefocus_mm = 0.0\ndiffraction = "rays"\n'


@pytest.fixture
def start(tmp_path):
    file = tmp_path / "start.toml"
    file.write_text(START)
    return file


def moved_lens():
    lens = tilt_image(refocus(configured_lens(CONFIG), DEFOCUS_MM), *TILT_DEG)
    return replace(lens, image_position_mm=lens.image_position_mm + np.array([*DECENTRE_MM, 0.0]))


def test_the_written_lens_stands_where_its_pose_says(start, tmp_path):
    settings = TwinConfig.of_sensor(start)
    assert settings["camera"] == {"pixel_pitch_um": 5.5, "exposure_s": 0.1}
    assert settings["prescription"] == str(start)
    names = ("defocus_mm", "tilt_x_deg", "tilt_y_deg", "decentre_x_mm", "decentre_y_mm", "added_width_px")
    values = (DEFOCUS_MM, *TILT_DEG, *DECENTRE_MM, 0.2)
    pose = LensPose(
        stars=100,
        focal_length_ratio=1.0,
        residual_percent=4.0,
        stated_residual_percent=20.0,
        **{name: Measured(value=value) for name, value in zip(names, values, strict=True)},
    )
    lens_file, sensor_file = write_prescription(start, pose, tmp_path)
    lens, moved = load_lens(lens_file), moved_lens()
    np.testing.assert_allclose(lens.image_position_mm[:2], moved.image_position_mm[:2], atol=1e-3)
    np.testing.assert_allclose(lens.image_rotation, moved.image_rotation, atol=1e-6)
    written = SensorFile.model_validate(complete_sensor(sensor_file)).instrument
    assert written.lens == str(lens_file)
    assert written.defocus_mm == pytest.approx(DEFOCUS_MM)


@pytest.mark.slow
def test_pose_from_the_widths_of_a_camera(start):
    """A finer grid of positions than the fit's own, each width 4 % off: within 4 of the stated standard deviations."""
    moved = build_instrument(CONFIG, lens=moved_lens())
    light = star_light([moved.passband()], nodes=4, magnitude_system="G")
    grid = render_psf_grid(moved, light, temperature_k=5000.0, window_px=22)
    rng = np.random.default_rng(4)
    position, width = np.repeat(grid.place_px, 3, axis=0), np.repeat(gaussian_widths(grid.psfs), 3)
    camera = as_calibrated(camera_model(moved), "radial_1", focal_length_mm=moved.focal_length_mm)
    fit = SimpleNamespace(
        order="radial_1",
        camera=camera,
        psf=SimpleNamespace(size_px=(1024, 1024)),
        calibration=SimpleNamespace(covariance=1e-6 * np.eye(len(camera.parameter_names))),
        gaussian=SimpleNamespace(
            magnitude=np.zeros(len(width)),
            width_px=width * (1.0 + 0.04 * rng.standard_normal(len(width))),
            observations=SimpleNamespace(pixel_px=position),
        ),
    )
    pose = fit_lens_pose(start, fit, 6.0)
    for value, true in (
        (pose.defocus_mm, DEFOCUS_MM),
        (pose.tilt_x_deg, TILT_DEG[0]),
        (pose.tilt_y_deg, TILT_DEG[1]),
    ):
        assert abs(value.value - true) < 4.0 * value.uncertainty + 0.02 * abs(true)
        assert value.uncertainty < 0.1 * abs(true)
    assert pose.residual_percent == pytest.approx(4.0, rel=0.2)
    assert pose.stated_residual_percent > 5.0 * pose.residual_percent
    assert [pose.decentre_x_mm.value, pose.decentre_y_mm.value] == pytest.approx(DECENTRE_MM, abs=0.01)
    assert pose.focal_length_ratio == pytest.approx(1.0, abs=2e-3)
