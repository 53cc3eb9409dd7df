"""Focus, tilt and decentre of a detector behind a known lens, against those it was given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.laboratory.bench.readout.psf_grid import render_psf_grid
from experiments.twin.prescription import _as_calibrated, _widths, fit_lens_pose, pose_of_widths, write_prescription
from optics.errors import DomainError
from optics.lens.perturb import refocus, tilt_image
from optics.lens_file import load_lens
from render.sensor_file.file import SensorFile, whole_sensor
from render.sensor_file.instrument import build_instrument, configured_lens
from render.sensor_file.tables import InstrumentConfig
from render.sky.star_light import star_light

CONFIG = InstrumentConfig(
    lens="star_tracker_26mm", detector="cmv4000", width_px=1024, height_px=1024, defocus_mm=0.0, diffraction="rays"
)
DEFOCUS_MM, TILT_DEG, AWAY_MM = 0.03, (0.25, -0.15), (0.1, 0.04)


class Fit:
    """What the fit reads of a measured camera."""

    order = "radial_1"


@pytest.fixture(scope="module")
def moved():
    lens = tilt_image(refocus(configured_lens(CONFIG), DEFOCUS_MM), *TILT_DEG)
    lens = replace(lens, image_position_mm=lens.image_position_mm + np.array([*AWAY_MM, 0.0]))
    return build_instrument(CONFIG, lens=lens)


@pytest.mark.slow
def test_focus_and_tilt_come_back_from_widths(moved):
    """A finer grid of places than the fit's own, each width 4 % off: within 4 of the stated standard deviations."""
    light = star_light([moved.passband()], nodes=4, magnitude_system="G")
    grid = render_psf_grid(moved, light, temperature_k=5000.0, window_px=22, long_side=9)
    rng = np.random.default_rng(4)
    place, width = np.repeat(grid.place_px, 3, axis=0), np.repeat(_widths(grid), 3)
    found = pose_of_widths(build_instrument(CONFIG), place, width * (1.0 + 0.04 * rng.standard_normal(len(width))))
    for value, true in (
        (found.defocus_mm, DEFOCUS_MM),
        (found.tilt_x_deg, TILT_DEG[0]),
        (found.tilt_y_deg, TILT_DEG[1]),
    ):
        assert abs(value.value - true) < 4.0 * value.uncertainty + 0.02 * abs(true)
        assert value.uncertainty < 0.1 * abs(true)
    assert found.residual_percent == pytest.approx(4.0, rel=0.2)
    assert found.before_percent > 5.0 * found.residual_percent
    with pytest.raises(DomainError, match="need 30"):
        pose_of_widths(build_instrument(CONFIG), place[:9], width[:9])


@pytest.mark.slow
def test_the_written_lens_stands_where_the_frames_put_it(moved, tmp_path):
    """Decentre by the camera model of the frames; read again, the lens puts stars where the moved one does."""
    light = star_light([moved.passband()], nodes=4, magnitude_system="G")
    grid = render_psf_grid(moved, light, temperature_k=5000.0, window_px=22, long_side=9)
    camera = _as_calibrated(moved, Fit())
    count = len(grid.place_px)
    stars = type("Stars", (), {})()
    stars.magnitude, stars.width_px = np.zeros(count), _widths(grid)
    stars.observations = type("Observations", (), {"pixel_px": grid.place_px})()
    fit = Fit()
    fit.gaussian, fit.camera, fit.psf = stars, camera, type("Psf", (), {"size_px": (1024, 1024)})()
    names = len(camera.parameter_names)
    fit.calibration = type("Calibration", (), {"covariance": 1e-6 * np.eye(names)})()
    start = tmp_path / "start.toml"
    start.write_text(
        '[instrument]\nlens = "star_tracker_26mm"\ndetector = "cmv4000"\ndefocus_mm = 0.0\ndiffraction = "rays"\n'
    )
    pose = fit_lens_pose(start, fit, 6.0)
    assert pose.decentre_x_mm.value == pytest.approx(AWAY_MM[0], abs=0.01)
    assert pose.decentre_y_mm.value == pytest.approx(AWAY_MM[1], abs=0.01)
    assert pose.focal_ratio == pytest.approx(1.0, abs=2e-3)
    write_prescription(start, pose, tmp_path)
    again = load_lens(tmp_path / "glass.toml")
    back = build_instrument(CONFIG.model_copy(update={"defocus_mm": pose.defocus_mm.value}), lens=again)
    assert again.image_position_mm[:2] == pytest.approx(moved.camera.lens.image_position_mm[:2], abs=0.01)
    ratio = _widths(render_psf_grid(back, light, temperature_k=5000.0, window_px=22, long_side=9)) / stars.width_px
    assert np.abs(ratio - 1.0).max() < 0.03
    written = SensorFile.model_validate(whole_sensor(tmp_path / "glass_sensor.toml")).instrument
    assert written.lens == str(tmp_path / "glass.toml")
    assert written.defocus_mm == pytest.approx(DEFOCUS_MM, abs=2e-3)
