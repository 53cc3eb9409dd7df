"""Fit of camera models to noiseless maps: one family in another, and a traced lens."""

import numpy as np
import pytest
from calibration_scene import CAMERA, GEOMETRY
from scipy.spatial.transform import Rotation

from calib.cameras import BrownConrady, PerBand, Polynomial, SensorGeometry
from calib.cameras.fit import fit_camera, fit_to_map
from optics import chief_ray_points, load_lens, plate_scale_mm
from optics.frames import field_direction, pixel_from_lens
from render.records import PixelMap


def traced(lens_name, geometry, count=11, wavelength_nm=None):
    """Directions and pixels of chief rays over the detector, and the plate scale."""
    lens = load_lens(lens_name)
    f = plate_scale_mm(lens)
    half = 0.5 * geometry.pixel_pitch_mm * geometry.width_px / f
    a, b = np.meshgrid(*2 * [np.linspace(-half, half, count)])
    fx, fy = np.degrees(np.arctan(a)).ravel(), np.degrees(np.arctan(b)).ravel()
    size = (geometry.width_px, geometry.height_px)
    x, y = chief_ray_points(lens, fx, fy, wavelength_nm)
    pixel = pixel_from_lens(x, y, pitch_mm=geometry.pixel_pitch_mm, size_px=size)
    return field_direction(fx, fy), np.stack(pixel, axis=1), f


def test_the_true_family_is_found_from_a_poor_start():
    pixel = GEOMETRY.grid_px(15)
    direction = CAMERA.unproject(pixel)
    direction.setflags(write=False)  # as the arrays of records are
    fit = fit_to_map(BrownConrady.create(GEOMETRY, focal_length_mm=20.0), direction, pixel, turn=False)
    assert fit.solution.converged
    assert fit.max_px < 1e-10
    np.testing.assert_allclose(fit.model.parameters, CAMERA.parameters, rtol=1e-9)
    assert fit.rotation.magnitude() == 0.0


def test_the_simplest_model_that_is_good_enough_is_taken():
    """A pinhole, its pixels off by 1e-3 px: polynomials come closer, Brown-Conrady is enough; to 1e-9 px it is not."""
    pixel = GEOMETRY.grid_px(15)
    direction = BrownConrady.create(GEOMETRY, focal_length_mm=25.6).unproject(pixel)
    noisy = pixel + 1e-3 * np.random.default_rng(1).standard_normal(pixel.shape)
    known = PixelMap(
        direction=direction, pixel_px=noisy, width_px=1024, height_px=1024, pixel_pitch_mm=0.01, focal_length_mm=25.0
    )
    assert isinstance(fit_camera(known, good_px=0.01).model, BrownConrady)
    assert isinstance(fit_camera(known, good_px=1e-9).model, Polynomial)


def test_a_polynomial_follows_a_turned_brown_conrady_camera():
    """The polynomial's axis is fixed by its anchor; the turn absorbs the roll and where the boresight is."""
    pixel = GEOMETRY.grid_px(15)
    turn = Rotation.from_rotvec([0.003, -0.002, 0.3])
    fit = fit_to_map(
        Polynomial.create(GEOMETRY, focal_length_mm=25.0, degree=7), turn.apply(CAMERA.unproject(pixel)), pixel
    )
    assert fit.solution.converged
    assert fit.rms_px < 1e-4
    assert fit.line_of_sight.rms_arcsec < 1e-4 * np.degrees(0.01 / 25.6) * 3600  # the same, as an angle
    assert abs((fit.rotation * turn).as_rotvec()[2]) < 2e-3


def test_a_fit_of_bands_finds_the_focal_length_of_each():
    pixel = np.tile(GEOMETRY.grid_px(9), (2, 1))
    band = np.repeat([0, 1], 81)
    true = PerBand.create(GEOMETRY, focal_length_mm=[25.6, 25.61], x0_px=[1.0, 1.5], q1_per_mm2=2e-4)
    start = PerBand.create(GEOMETRY, focal_length_mm=[25.0, 25.0])
    fit = fit_to_map(start, true.unproject(pixel, band), pixel, band=band, turn=False)
    np.testing.assert_allclose(fit.model.parameters, true.parameters, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize(
    ("lens", "geometry", "limits_px"),
    [
        ("star_tracker_26mm", GEOMETRY, {"pinhole": 1.0, "brown_conrady": 1e-3, 5: 0.02, 7: 2e-3}),
        (
            "star_camera_206mm",
            SensorGeometry(width_px=2048, height_px=2048, pixel_pitch_mm=0.0055),
            {"pinhole": 0.02, "brown_conrady": 1e-6, 3: 1e-3, 5: 1e-5},
        ),
    ],
)
def test_a_traced_lens_is_followed_and_better_by_richer_models(lens, geometry, limits_px):
    direction, pixel, f = traced(lens, geometry)
    left = []
    for family, limit in limits_px.items():
        if isinstance(family, int):
            model, free = Polynomial.create(geometry, focal_length_mm=f, degree=family), None
        else:
            model = BrownConrady.create(geometry, focal_length_mm=f)
            free = model.pinhole_names if family == "pinhole" else None
        fit = fit_to_map(model, direction, pixel, free=free)
        assert fit.solution.converged
        assert fit.rms_px < limit
        left.append(fit.rms_px)
        np.testing.assert_allclose(
            fit.line_of_sight.rms_arcsec, fit.rms_px * np.degrees(geometry.pixel_pitch_mm / f) * 3600, rtol=0.1
        )
    assert left[0] > 10 * left[1]
    assert left[2] > 5 * left[3]
