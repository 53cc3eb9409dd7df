"""Sensor files without a prescription: what they build, refuse and sweep; an ideal lens against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fields import star_field
from refusals import refuses
from scipy.integrate import quad
from scipy.special import j0

from experiments.camera.settings import CameraReportConfig
from experiments.harness.config import load_config
from experiments.harness.range import parse_sweep, with_value
from optics.errors import ConfigError, DomainError
from optics.export.write import write_measured_lens
from optics.lens.measured import measured_from_table
from render.forward import StarRenderer
from render.sensor_file.instrument import build_instrument, configured_lens

IDEAL = """
[instrument]
detector = "cmv4000"
width_px = 64
height_px = 64
[instrument.lens]
kind = "ideal"
focal_length_mm = 50.0
f_number = 8.0
transmission = 0.5
"""
MEASURED = {
    "kind": "measured",
    "name": "my camera",
    "source": "a test",
    "date": "2026-01-01",
    "reference_wavelength_nm": 600.0,
    "max_field_deg": 12.0,
    "camera": {"focal_length_mm": 26.0, "principal_point_um": [20.0, -10.0], "q1_per_mm2": -1e-4},
    "component": [{"share": 1.0, "sigma_x_um": 4.0, "sigma_y_um": 5.0}],
    "throughput": {"aperture_mm": 18.0, "wavelength_nm": [400.0, 950.0], "transmission": [0.9, 0.9]},
}


@pytest.fixture
def ideal(tmp_path):
    (tmp_path / "ideal.toml").write_text(IDEAL)
    return tmp_path / "ideal.toml"


@pytest.fixture
def measured(tmp_path):
    write_measured_lens(measured_from_table(MEASURED, "test"), tmp_path / "my.lens.toml")
    text = '[instrument]\nlens = "my.lens.toml"\ndetector = "cmv4000"\nwidth_px = 512\nheight_px = 512\n'
    (tmp_path / "measured.toml").write_text(text)
    return tmp_path / "measured.toml"


def test_ideal_lens_is_in_focus_and_scales_by_the_tangent(ideal):
    instrument = build_instrument(load_config(CameraReportConfig, sensor=ideal).instrument)
    assert instrument.camera.defocus_mm == 0.0
    assert instrument.focal_length_mm == pytest.approx(50.0, rel=1e-12)
    truth = StarRenderer(instrument.camera).render(star_field(field(0.02, -0.01), 600.0, 1000.0)).truth
    place = np.array([31.5, 31.5]) + np.array([0.02, -0.01]) * 50.0 / 0.0055
    found = [truth.chief_x_px[0, 0], truth.chief_y_px[0, 0]]
    np.testing.assert_allclose(found, place, atol=1e-9)


def field(x, y):
    v = np.array([[x, y, 1.0]])
    return v / np.linalg.norm(v)


def test_electrons_by_hand(ideal):
    instrument = build_instrument(load_config(CameraReportConfig, sensor=ideal).instrument)
    truth = StarRenderer(instrument.camera, exposure_s=0.1).render(star_field(field(0.0, 0.0), 600.0, 1000.0)).truth
    efficiency = float(instrument.detector.quantum_efficiency.interpolate(600.0))
    area_mm2 = np.pi / 4.0 * (50.0 / 8.0) ** 2
    # photons / s mm^2 x exposure x stop x transmission x quantum efficiency
    assert truth.electrons_in[0, 0] == pytest.approx(1000.0 * 0.1 * area_mm2 * 0.5 * efficiency, rel=1e-4)


def test_diffraction_is_the_airy_pattern_blurred_by_the_spot(ideal):
    """Light of the central pixels against the Hankel transform of pupil, Gaussian spot and diffusion."""
    config = load_config(CameraReportConfig, sensor=ideal, settings=["instrument.lens.spot_um=4"]).instrument
    camera = replace(build_instrument(config).camera, charge_diffusion_px=0.0, diffraction="exact_waves")
    assert camera.blur_px == pytest.approx(4.0 / np.sqrt(2.0) / 5.5)
    image = StarRenderer(camera).render(star_field(camera.nominal_direction([31.0], [31.0], 50.0), 600.0, 1000.0))
    share = image.electrons[..., 0] / image.truth.electrons_in[0, 0]
    cut = 1.0 / (0.6 * 8.0)  # cycles per um

    def profile(r_um):
        def part(f):
            x = f / cut
            pupil = 2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x * x))
            spot = np.exp(-2.0 * (np.pi * f * 4.0 / np.sqrt(2.0)) ** 2)
            return 2.0 * np.pi * f * pupil * spot * j0(2.0 * np.pi * f * r_um)

        return quad(part, 0.0, cut, epsabs=1e-10)[0]

    radii = np.linspace(0.0, 12.0, 121)
    at = (np.arange(55) - 27) * 0.1
    values = np.array([profile(r) for r in radii])
    for row, column in ((31, 31), (31, 32), (32, 32)):
        x, y = np.meshgrid(at + (column - 31) * 5.5, at + (row - 31) * 5.5)
        expected = np.interp(np.hypot(x, y), radii, values).sum() * 0.01
        assert share[row, column] == pytest.approx(expected, rel=4e-3), (row, column)


def test_measured_camera_puts_stars_where_its_model_says(measured):
    instrument = build_instrument(load_config(CameraReportConfig, sensor=measured).instrument)
    camera = instrument.camera
    assert (camera.defocus_mm, camera.charge_diffusion_px) == (0.0, 0.0)
    known = instrument.pixel_map()
    place = camera.centre_px + camera.lens.measured.position_mm(known.direction) / camera.pixel_pitch_mm
    np.testing.assert_allclose(known.pixel_px, place, atol=1e-9)
    assert known.pixel_px.min() < 15.0


@pytest.mark.parametrize(
    ("key", "value"),
    [("defocus_mm", 0.1), ("f_number", 4.0), ("lens_temperature_c", 40.0), ("wavefront_zernike_nm", [0, 0, 0, 50])],
)
def test_measured_lens_is_used_as_it_was_measured(measured, key, value):
    with pytest.raises(DomainError, match=r"needs a prescription|was measured in focus"):
        build_instrument(
            load_config(CameraReportConfig, sensor=measured, settings=[f"instrument.{key}={value}"]).instrument
        )


def test_keys_of_the_lens_table_are_swept(ideal):
    assert parse_sweep("instrument.lens.f_number=1.4:4:3", CameraReportConfig).key == "instrument.lens.f_number"
    assert (
        parse_sweep("f_number=1.4:4:3", CameraReportConfig).key == "instrument.f_number"
    )  # the outer table's, as ever
    config = load_config(CameraReportConfig, sensor=ideal)
    lens = configured_lens(with_value(config, "instrument.lens.f_number", 4.0).instrument)
    assert lens.surfaces[lens.stop_index].semi_diameter_mm == pytest.approx(6.25)
    refuses(ConfigError, "not a table", lambda: with_value(CameraReportConfig(), "instrument.lens.f_number", 4.0))
