"""Spots, colour, vignetting, focus: symmetric lenses, known bundles, convergence."""

from dataclasses import replace

import numpy as np
import pytest

from optics import chief_ray_points, decentre, distortion_map, gauss_disk, load_lens, refocus, sobol_disk, vignetting
from optics.rays.lateral_colour import lateral_colour
from optics.rays.spots import spot_moments

CAMERA, TRACKER = load_lens("star_camera_206mm"), load_lens("star_tracker_26mm")


def test_defocused_spot_grows_as_geometry_says():
    """A defocus d adds d tan(u) to every ray; for a sharp lens the variance is d^2 <tan^2 u>, about (d / 2 N)^2 / 2."""
    defocus = 1.0
    spot = spot_moments(refocus(CAMERA, defocus), 0.0, 0.0, 700.0)
    assert float(spot.rms_radius_mm[0, 0]) == pytest.approx(defocus / (2 * 2.947) / np.sqrt(2.0), rel=0.02)
    assert float(spot.xx_mm2[0, 0]) == pytest.approx(float(spot.yy_mm2[0, 0]), rel=1e-12)
    assert abs(float(spot.xy_mm2[0, 0])) < 1e-15


def test_quadrature_converges_to_rounding_and_sobol_to_it():
    fine = spot_moments(CAMERA, 2.5, 1.0, 600.0, samples=gauss_disk(24, 64))
    default = spot_moments(CAMERA, 2.5, 1.0, 600.0)
    sobol = spot_moments(CAMERA, 2.5, 1.0, 600.0, samples=sobol_disk(1 << 14, seed=1))
    assert abs(fine.x_mm - default.x_mm).max() < 1e-12
    assert abs(fine.rms_radius_mm - default.rms_radius_mm).max() < 1e-12
    assert abs(fine.x_mm - sobol.x_mm).max() < 5e-7


def test_shift_between_colours_of_a_lens_with_holes():
    """By symmetry a lens of revolution shifts a star on the diagonal along it; sixteen times the points agree."""
    lens, waves = load_lens("maksutov_1300mm"), np.array([500.0, 600.0, 800.0])
    found, dense = (
        spot_moments(lens, [0.11], [0.11], waves, samples=samples) for samples in (None, sobol_disk(2**16, seed=3))
    )
    x, y, dense_x = (np.diff(v[0]) for v in (found.x_mm, found.y_mm, dense.x_mm))
    np.testing.assert_allclose(x, -y, atol=5e-4 * 0.0055)
    np.testing.assert_allclose(x, dense_x, atol=1e-3 * 0.0055)


def test_vignetting_by_a_small_rear_aperture_against_counting_rays():
    field = [0.0, 5.0, 10.0, 16.5]
    fraction = vignetting(TRACKER, field, np.zeros(4))
    assert fraction[0] == 1.0
    fine = spot_moments(TRACKER, field, np.zeros(4), 650.0, samples=sobol_disk(1 << 16, seed=5)).transmitted_mm2[:, 0]
    np.testing.assert_allclose(fraction, fine / fine[0], atol=3e-3)
    assert 0.9 < fraction[-1] < 0.97


def test_lateral_colour_of_chief_and_bundle_vanish_at_the_reference_and_the_axis():
    for of in ("chief", "bundle"):
        dx, dy = lateral_colour(CAMERA, [0.0, 3.0], [0.0, 0.0], [600.0, 800.0], of=of)
        assert abs(dx[:, 0]).max() == 0.0
        assert abs(dx[0, 1]) < 1e-13
        assert abs(dy).max() < 1e-13
        assert dx[1, 1] > 1e-4
        _, upwards = lateral_colour(CAMERA, [0.0, 0.0], [0.0, 3.0], [600.0, 800.0], of=of)
        np.testing.assert_allclose(np.abs(upwards), np.abs(dx), rtol=1e-6, atol=1e-12)


def test_chief_ray_is_the_middle_of_a_pencil_through_a_perturbed_stop():
    """Far behind the focus the pencil through a small decentred stop is wide apart from one through a centred stop."""
    stop = TRACKER.stop_index
    small = TRACKER.with_surfaces({stop: replace(TRACKER.surfaces[stop], semi_diameter_mm=0.1)})
    lens = refocus(decentre(small, stop, 0.2, -0.1), 5.0)
    fields = [3.0, -8.0], [2.0, 5.0]
    x, y = chief_ray_points(lens, *fields, 600.0)
    centred_x, _ = chief_ray_points(refocus(small, 5.0), *fields, 600.0)
    assert np.abs(x - centred_x).min() > 0.02
    spots = spot_moments(lens, *fields, 600.0, samples=sobol_disk(1 << 15, seed=2))
    np.testing.assert_allclose(spots.x_mm[:, 0], x, atol=1e-3)
    np.testing.assert_allclose(spots.y_mm[:, 0], y, atol=1e-3)


def test_distortion_map_has_the_symmetry_of_the_lens():
    grid = distortion_map(TRACKER, count=5)
    assert grid.relative[2, 2] == 0.0
    np.testing.assert_allclose(grid.relative, grid.relative.T, atol=1e-9)
    np.testing.assert_allclose(grid.relative, grid.relative[::-1], atol=1e-9)
    assert 100 * grid.relative[0, 0] == pytest.approx(0.96, abs=0.01)
    corner = np.hypot(np.tan(np.radians(grid.field_x_deg[0, 0])), np.tan(np.radians(grid.field_y_deg[0, 0])))
    assert corner == pytest.approx(np.tan(np.radians(16.5)))


def test_a_field_without_light_is_data():
    lens = load_lens("double_gauss_50mm")
    spots = spot_moments(lens, [0.0, 40.0], [0.0, 0.0], 600.0)
    assert spots.transmitted_mm2[1, 0] == 0.0
    assert np.isnan(spots.x_mm[1, 0])
    assert np.isfinite(spots.x_mm[0, 0])


@pytest.mark.parametrize("stop_mm", [(1.0, -0.5), (5.0, -3.0)])
def test_light_of_a_collimator_is_bent_about_the_middle_of_the_pupil(stop_mm):
    """A slope moves the image by f times its angle, a vergence only widens it: by whole beams, and by cut ones."""
    lens = decentre(CAMERA, CAMERA.stop_index, *stop_mm)
    focal_mm, error = 206.0, 1e-5
    plain, sloped, spread = (
        spot_moments(lens, 0.0, 0.0, 600.0, collimation=None if one is None else np.array([one]))
        for one in (None, (error, 0.0, 0.0), (0.0, 0.0, error))
    )
    assert abs(float(sloped.x_mm[0, 0] - plain.x_mm[0, 0])) == pytest.approx(focal_mm * error, rel=0.01)
    lost = 1.0 - float(plain.transmitted_mm2[0, 0]) / (np.pi * 35.0**2)  # on one side, at the rim
    moved = [float((getattr(spread, name) - getattr(plain, name))[0, 0]) for name in ("x_mm", "y_mm")]
    assert np.hypot(*moved) < focal_mm * error * (0.02 * np.hypot(*stop_mm) + 35.0 * lost)
    assert float(spread.rms_radius_mm[0, 0]) == pytest.approx(focal_mm * error * 35.0 / 2**0.5, rel=0.05 + lost)
