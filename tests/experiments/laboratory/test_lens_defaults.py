"""What a lens file says beside the lens reaches experiments, beneath all that the user says."""

import numpy as np
import pytest

from experiments.camera.settings import CameraReportConfig as Camera
from experiments.chromatic.settings import ChromaticConfig
from experiments.harness.config import load_config
from experiments.skycal.settings import SkycalConfig
from render.sensor_file.instrument import build_instrument

SINGLET = """UNIT MM X W X CM MR CPMM
NAME singlet
ENPD 20
FTYP 0 0 2 3 0 0 0
XFLN 0 0
YFLN 0 4
WAVM 1 0.52 1
WAVM 2 0.60 2
WAVM 3 0.95 0
WAVM 4 0.4 1
PWAV 2
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  CURV 0.02
  DISZ 5
  GLAS N-BK7 0 0 1.5168 64.17
  DIAM 10.1 1
SURF 2
  CURV 0
  DISZ 93
  DIAM 10.1 1
SURF 3
  DISZ 0
"""


@pytest.fixture
def lens(tmp_path):
    path = tmp_path / "singlet.zmx"
    path.write_text(SINGLET)
    return path


def test_band_and_window_are_those_of_the_file_unless_the_user_says_others(lens):
    """Three wavelengths are in use (FTYP), the third has no weight; 4 deg at f = 96.7 mm are 6.8 mm of radius."""
    setting, chip = f"instrument.lens={lens}", "instrument.detector=cmv4000"
    plain = load_config(ChromaticConfig)
    config = load_config(ChromaticConfig, settings=[setting, chip])
    assert config.passband.range_nm == (520.0, 600.0)
    assert config.filters == plain.filters  # the bench has filters of its own
    camera = build_instrument(config.instrument).camera
    radius_mm = np.hypot(camera.width_px, camera.height_px) / 2 * camera.pixel_pitch_mm
    assert np.degrees(np.arctan(radius_mm / 96.7)) == pytest.approx(4.0, abs=0.05)
    said = load_config(
        ChromaticConfig, settings=["passband.range_nm=[500, 700]", setting, chip, "instrument.width_px=300"]
    )
    assert said.passband.range_nm == (500.0, 700.0)
    assert (said.instrument.width_px, said.instrument.height_px) == (300, 0)
    assert load_config(ChromaticConfig, settings=["instrument.lens=petzval_100mm"]).passband == plain.passband


def test_a_sensor_file_takes_them_too_and_reports_say_so(lens, tmp_path):
    sensor = tmp_path / "sensor.toml"
    sensor.write_text(f'[instrument]\nlens = "{lens.name}"\ndetector = "cmv4000"\n')
    camera = load_config(Camera, sensor=sensor)
    assert camera.passband.range_nm == (520.0, 600.0)
    assert camera.instrument.width_px > 0
    sky = load_config(SkycalConfig, sensor=sensor)
    assert (sky.passband, sky.own.instrument) == (camera.passband, camera.instrument)
    for config in (camera, sky):
        (said,) = (remark for remark in config.remarks() if "singlet.zmx" in remark)
        assert all(
            word in said for word in ("singlet.zmx", "F/4.8", "600 nm", "4°", "520 to 600 nm", " px that its field")
        )
    assert not [remark for remark in load_config(Camera).remarks() if "lens" in remark]
    sensor.write_text(f'[instrument]\nlens = "{lens.name}"\n[passband]\nrange_nm = [480, 640]\n')
    assert load_config(Camera, sensor=sensor).passband.range_nm == (480.0, 640.0)


@pytest.mark.parametrize("passband", ["[450, 650]", pytest.param("[600, 900]", marks=pytest.mark.slow)])
def test_the_best_focus_is_one_number_for_setting_report_and_remark(passband, tmp_path):
    """Another lens stands in its best focus unless a focus is stated; the report finds none better, to 1 um."""
    from experiments.laboratory.sensor_prediction import optical_state

    sensor = tmp_path / "sensor.toml"
    chosen = 'lens = "cooke_triplet_50mm"\ndetector = "cmv4000"\nabsorption = false\n'
    sensor.write_text(f"[instrument]\n{chosen}[passband]\nrange_nm = {passband}\n")
    camera = load_config(Camera, sensor=sensor)
    assert 0.02 < camera.instrument.defocus_mm < 0.2
    assert any(f"defocus_mm = {camera.instrument.defocus_mm:g} mm" in one for one in camera.remarks())
    assert optical_state(camera).performance.best_focus_mm == pytest.approx(0.0, abs=1e-3)
    assert load_config(SkycalConfig, sensor=sensor).own.instrument == camera.instrument
    assert load_config(Camera, sensor=sensor, settings=["instrument.defocus_mm=0.05"]).instrument.defocus_mm == 0.05
