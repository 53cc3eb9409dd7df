"""Measured and ideal lenses: file, camera model, PSF tables, vignetting, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from lens_texts import measured

from optics import chief_ray_points, distortion_map, load_lens, spot_moments, vignetting
from optics.export.write import write_measured_lens
from optics.lens.ideal_lens import ideal_lens, measured_lens
from optics.lens.measured import measured_table
from optics.rays.paraxial import paraxial, stopped_down


def test_file_comes_back(tmp_path):
    lens = measured()
    again = load_lens(write_measured_lens(lens, tmp_path / "camera.toml"))
    for name in ("distortion", "principal_point_mm", "colour_shift_mm", "relative_light", "vignetting_mm"):
        np.testing.assert_allclose(getattr(again.measured, name), getattr(lens, name), rtol=1e-15)
    np.testing.assert_allclose(again.measured.psf.covariance_mm2, lens.psf.covariance_mm2, rtol=1e-14)
    assert measured_table(again.measured)["component"][0]["share"] == 0.75
    assert again.wavelength_range_nm == (400.0, 900.0)


@pytest.mark.reference
def test_places_are_those_of_opencv():
    cv2 = pytest.importorskip("cv2")
    lens, f, pitch = measured(), 35.0, 0.0069
    q1, q2, q3, p1, p2 = lens.distortion
    v = np.random.default_rng(1).uniform([-0.15, -0.12, 1.0], [0.15, 0.12, 1.0], (50, 3))
    camera = np.array([[f / pitch, 0.0, 12e-3 / pitch], [0.0, f / pitch, -7e-3 / pitch], [0.0, 0.0, 1.0]])
    coefficients = np.array([q1 * f**2, q2 * f**4, p2 * f, p1 * f, q3 * f**6])
    expected = cv2.projectPoints(v, np.zeros(3), np.zeros(3), camera, coefficients)[0][:, 0]
    np.testing.assert_allclose(lens.position_mm(v) / pitch, expected, atol=1e-9)
    x, y = chief_ray_points(measured_lens(lens), *(np.degrees(np.arctan(v[:, i])) for i in range(2)))
    np.testing.assert_allclose(np.stack([x, -y], -1) / pitch, expected, atol=1e-9)


def test_colour_scales_about_the_principal_point_and_no_place_behind_the_fold():
    lens, v = measured(), np.array([0.1, -0.05, 1.0])
    middle = lens.position_mm(v, 600.0)
    moved = lens.position_mm(v, 700.0) - middle  # half way from 600 to 800 nm
    expected = -1.5e-5 * (middle - [12e-3, -7e-3]) + [-0.05e-3, -0.15e-3]
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    np.testing.assert_array_equal(lens.position_mm(v, 2000.0), lens.position_mm(v, 800.0))
    lens = measured(max_field_deg=5.0, camera={"focal_length_mm": 35.0, "q1_per_mm2": -1e-3})
    assert np.isnan(lens.position_mm(np.array([1.0, 0.0, 1.0]))).all()
    assert lens.relative(lens.position_mm(np.array([1.0, 0.0, 1.0]))) == 0.0


def test_mixture_is_linear_between_nodes_and_constant_beyond():
    psf = measured().psf
    _, _, covariance = psf.at(np.array([0.0, 9.0]), np.array([1.0, 1.0]), np.array([600.0, 400.0]))
    np.testing.assert_allclose(covariance[0, 0, 0], np.mean([4.0**2, 5.0**2, 4.4**2, 5.4**2]) * 1e-6)
    np.testing.assert_allclose(covariance[1, 0], [25e-6, 20.25e-6, 0.3 * 5.0 * 4.5e-6])
    mean, total = psf.moments(np.array(-4.0), np.array(0.0), np.array(500.0))
    np.testing.assert_allclose(mean, [0.25e-3, 0.0], atol=1e-18)
    np.testing.assert_allclose(total[0], (0.75 * 16 + 0.25 * 81 + 0.75 * 0.25) * 1e-6)


def test_spot_moments_are_those_of_the_mixture():
    lens = measured()
    system = measured_lens(lens)
    spot = spot_moments(system, [8.0], [-3.0], [650.0])
    position = lens.position_mm(np.array([np.tan(np.radians(8.0)), np.tan(np.radians(-3.0)), 1.0]), 650.0)
    mean, covariance = lens.psf.moments(position[0], position[1], np.array(650.0))
    np.testing.assert_allclose([spot.x_mm[0, 0], -spot.y_mm[0, 0]], position + mean, atol=1e-13)
    moments = [spot.xx_mm2[0, 0], spot.yy_mm2[0, 0], -spot.xy_mm2[0, 0]]
    np.testing.assert_allclose(moments, covariance, rtol=1e-9)


def test_vignetting_is_all_causes_together():
    lens = measured_lens(measured())
    cosine = 1.0 / np.sqrt(1.0 + np.tan(np.radians(8.0)) ** 2)
    radius = np.hypot(*(lens.measured.position_mm(np.array([np.tan(np.radians(8.0)), 0, 1.0])) - [12e-3, -7e-3]))
    light = vignetting(lens, [8.0], [0.0])[0] * cosine  # of the beam's cross-section: flux is that times the cosine
    from scipy.interpolate import PchipInterpolator

    np.testing.assert_allclose(light, PchipInterpolator([0, 3, 7], [1, 0.9, 0.5])(radius), rtol=1e-6)


def test_ideal_lens_images_by_the_tangent_in_air_with_a_blur_per_axis():
    lens = ideal_lens(focal_length_mm=50.0, f_number=2.5, max_field_deg=15.0)
    assert paraxial(lens).efl_mm == pytest.approx(50.0, rel=1e-14)
    assert paraxial(lens).f_number == pytest.approx(2.5, rel=1e-14)
    assert np.abs(distortion_map(lens, focal_length_mm=50.0).relative).max() < 1e-13
    assert spot_moments(lens, [0.0, 15.0], [0.0, 0.0], [400.0, 900.0]).rms_radius_mm.max() < 1e-13
    assert paraxial(stopped_down(lens, 5.0)).entrance_pupil_radius_mm == pytest.approx(5.0)
    lens = ideal_lens(focal_length_mm=50.0, f_number=2.0, spot_um=3.0)
    assert replace(lens).blur_um == pytest.approx(3.0 / np.sqrt(2.0))
