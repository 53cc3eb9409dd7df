"""A sensor file is the sensor that its keys describe."""

import numpy as np
import pytest

from optics.rays.paraxial import axial_paraxial
from render.sensor_file.load import load_star_sensor

FILE = """
[instrument]
lens = "star_tracker_26mm"
detector = "cmv4000"
f_number = 3.0
width_px = 512
height_px = 256
exposure_s = 0.3
chip_temperature_c = -10.0
gain_dn_per_e = 0.5
defocus_mm = {defocus}
coating_nm = 0.0
[passband]
range_nm = [500, 800]
"""


def test_everything_of_the_file_is_in_the_sensor(tmp_path):
    (tmp_path / "sensor.toml").write_text(FILE.format(defocus=0.02))
    sensor = load_star_sensor(tmp_path / "sensor.toml")
    camera = sensor.camera
    assert axial_paraxial(camera.lens, camera.lens.design_wavelength_nm).f_number == pytest.approx(3.0)
    assert (camera.width_px, camera.height_px, camera.defocus_mm) == (512, 256, 0.02)
    assert (sensor.exposure_s, sensor.temperature_c, sensor.detector.gain_dn_per_e) == (0.3, -10.0, 0.5)
    assert list(sensor.band.breakpoints_nm) == [490.0, 510.0, 790.0, 810.0]  # half maximum at the ends of range_nm
    open_stop = load_star_sensor("star_tracker_26mm", "cmv4000", window_px=(512, 256), defocus_mm=0.02)
    wave = np.array([600.0])
    assert camera.response_at(wave) < open_stop.camera.response_at(wave)  # bare glass reflects more
    # dark charge halves with every doubling step; the exposure is three tenths of a second
    dark_e = sensor.detector.dark_current_e_per_s * sensor.detector.dark_factor(-10.0) * 0.3
    assert sensor.pixel_noise().dark_e == pytest.approx(dark_e)


def test_the_best_focus_of_the_pass_band(tmp_path):
    """A key that is left out is the best focus of another lens than the usual one."""
    (tmp_path / "best.toml").write_text(FILE.format(defocus='"best"'))
    (tmp_path / "left_out.toml").write_text(FILE.replace("defocus_mm = {defocus}", ""))
    best, left_out = (load_star_sensor(tmp_path / f"{name}.toml") for name in ("best", "left_out"))
    assert best.camera.defocus_mm == left_out.camera.defocus_mm
    assert 0.0 < abs(best.camera.defocus_mm) < 0.2
