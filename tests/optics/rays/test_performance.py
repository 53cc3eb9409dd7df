"""Summary of a lens against the single functions, paraxial optics and spots traced at a shifted image plane."""

import numpy as np
import pytest

from optics import best_focus_shift_mm, distortion_map, lateral_colour, load_lens, refocus, spot_moments, vignetting
from optics.rays.paraxial import axial_colour_mm, paraxial, stopped_down
from optics.rays.performance import lens_performance

WAVES = np.array([520.0, 650.0, 800.0])


@pytest.fixture(scope="module")
def lens():
    return load_lens("star_camera_206mm")


@pytest.fixture(scope="module")
def found(lens):
    return lens_performance(lens, [0.0, 1.5, 3.0], WAVES)


def test_scale_distortion_and_f_number(lens, found):
    first = paraxial(lens)
    assert found.focal_length_mm == pytest.approx(first.efl_mm)
    assert found.f_number == pytest.approx(first.efl_mm / 70.0, rel=1e-9)  # its stop is a disk of 70 mm
    grid = distortion_map(lens, count=3, max_field_deg=3.0)
    assert found.distortion[-1] == pytest.approx(grid.relative[0, 0], rel=1e-6)  # the corners are at 3 deg
    assert found.distortion[0] == 0.0


@pytest.mark.parametrize("shift_mm", [-0.05, 0.02])
def test_through_focus_curve_is_what_a_shifted_image_plane_shows(lens, found, shift_mm):
    moved = spot_moments(refocus(lens, shift_mm), [0.0, 1.5, 3.0], np.zeros(3), WAVES)
    np.testing.assert_allclose(found.single.rms_mm(shift_mm), moved.rms_radius_mm, rtol=1e-9)
    x = moved.x_mm - moved.x_mm.mean(1, keepdims=True)
    white = np.sqrt((moved.rms_radius_mm**2 + x**2).mean(1))
    np.testing.assert_allclose(found.white.rms_mm(shift_mm), white, rtol=1e-9)


def test_best_focus_and_colour(lens, found):
    best = best_focus_shift_mm(lens, [0.0, 1.5, 3.0], np.zeros(3), WAVES)
    assert found.best_focus_mm == pytest.approx(best, rel=1e-9)
    dx, _ = lateral_colour(lens, [0.0, 1.5, 3.0], np.zeros(3), WAVES)
    np.testing.assert_allclose(np.diff(found.lateral_colour_mm, axis=1), np.diff(dx, axis=1), atol=1e-10)
    narrow = lens_performance(stopped_down(lens, 40.0), [0.0], WAVES)
    np.testing.assert_allclose(np.diff(narrow.axial_colour_mm), np.diff(axial_colour_mm(lens, WAVES)), rtol=0.02)


def test_vignetting_of_a_lens_whose_apertures_cut():
    lens = load_lens("double_gauss_50mm")
    fields = np.array([0.0, 10.0, 20.0])
    found = lens_performance(lens, fields, [587.6])
    cut = vignetting(lens, fields, np.zeros(3))
    np.testing.assert_allclose(found.vignetting, cut * np.cos(np.radians(fields)), rtol=1e-6)
    assert found.vignetting[-1] < 0.8
