"""Paraxial optics against textbook closed forms, and against real rays near the axis."""

from dataclasses import replace

import numpy as np
import pytest
from made_lens import made_lens

from optics import VACUUM, Plane, Rays, Sphere, chief_ray_points, load_lens, plate_scale_mm, trace
from optics.rays.paraxial import (
    axial_colour_mm,
    chief_ray,
    focus_behind_mm,
    image_of,
    image_scale_mm,
    lateral_colour_mm,
    paraxial,
    refocused,
)


def thick_lens(r1, r2, thickness, stop_z):
    """Singlet of n = 1.5 in catalogue air with a stop in front (stop_z < 0) or behind."""
    faces = [(Sphere(radius_mm=r1), thickness, "n15"), (Sphere(radius_mm=r2), 100.0 - thickness, "air")]
    if stop_z < 0:
        return made_lens((Plane(), -stop_z, "air", 4.0), *faces, start_mm=stop_z)
    last = (faces[1][0], stop_z - thickness, "air")
    return made_lens(faces[0], last, (Plane(), 100.0 - stop_z, "air", 4.0), stop=2)


def test_thick_lens_formulas_and_unit_magnification():
    r1, r2, t, n = 60.0, -90.0, 12.0, 1.5
    p = paraxial(thick_lens(r1, r2, t, -10.0))
    f = 1.0 / ((n - 1.0) * (1.0 / r1 - 1.0 / r2 + (n - 1.0) * t / (n * r1 * r2)))  # lensmaker's formula
    assert p.efl_mm == pytest.approx(f, rel=1e-14)
    assert p.bfl_mm == pytest.approx(f * (1.0 - (n - 1.0) * t / (n * r1)), rel=1e-14)
    assert p.ffl_mm == pytest.approx(-f * (1.0 + (n - 1.0) * t / (n * r2)), rel=1e-14)
    assert p.front_principal_z_mm == pytest.approx(-f * (n - 1.0) * t / (n * r2), rel=1e-12)
    assert p.rear_principal_z_mm == pytest.approx(t - f * (n - 1.0) * t / (n * r1), rel=1e-12)
    assert (p.entrance_pupil_z_mm, p.entrance_pupil_radius_mm) == pytest.approx((-10.0, 4.0))
    assert p.f_number == pytest.approx(f / 8.0)
    lens = thick_lens(60.0, -90.0, 12.0, -10.0)
    p = paraxial(lens)
    z, magnification = image_of(lens, p.front_principal_z_mm - 2.0 * p.efl_mm)
    assert magnification == pytest.approx(-1.0, rel=1e-13)
    assert z == pytest.approx(p.rear_principal_z_mm + 2.0 * p.efl_mm, rel=1e-13)


def test_exit_pupil_is_the_image_of_a_stop_in_front_and_entrance_pupil_of_one_behind():
    front = thick_lens(60.0, -90.0, 12.0, -10.0)
    p = paraxial(front)
    z, magnification = image_of(front, -10.0)
    assert p.exit_pupil_z_mm == pytest.approx(z, rel=1e-12)
    assert p.exit_pupil_radius_mm == pytest.approx(4.0 * abs(magnification), rel=1e-12)
    mirrored = paraxial(thick_lens(90.0, -60.0, 12.0, 22.0))
    assert mirrored.entrance_pupil_z_mm == pytest.approx(12.0 - p.exit_pupil_z_mm, rel=1e-12)
    assert mirrored.entrance_pupil_radius_mm == pytest.approx(p.exit_pupil_radius_mm, rel=1e-12)


@pytest.mark.parametrize("name", ["star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm"])
@pytest.mark.parametrize("wavelength", [500.0, 800.0])
def test_real_rays_near_the_axis_agree(name, wavelength):
    lens = load_lens(name)
    p = paraxial(lens, wavelength)
    height = 1e-4
    out = trace(lens, Rays.create(x_mm=0.0, y_mm=height, direction=[0, 0, 1.0], wavelength_nm=wavelength))
    assert -height / (out.dy / out.dz) == pytest.approx(p.efl_mm, rel=1e-8)
    assert lens.image_position_mm[2] - out.y / out.dy * out.dz == pytest.approx(p.rear_focus_z_mm, abs=1e-6)
    x, _ = chief_ray_points(lens, 1e-3, 0.0, wavelength)
    assert float(x) == pytest.approx(chief_ray(lens, 1e-3, wavelength)[0][-1], rel=1e-6)


@pytest.mark.parametrize("name", ["star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm"])
def test_front_quantities_are_the_rear_ones_of_the_lens_seen_from_behind(name):
    from optics.rays.reverse import reverse

    lens = load_lens(name)
    forward, backward = paraxial(lens), paraxial(reverse(lens))
    assert backward.efl_mm == pytest.approx(forward.efl_mm, rel=1e-12)
    assert -backward.ffl_mm == pytest.approx(forward.bfl_mm, rel=1e-12)
    assert backward.bfl_mm == pytest.approx(-forward.ffl_mm, rel=1e-12)
    assert backward.entrance_pupil_radius_mm == pytest.approx(forward.exit_pupil_radius_mm, rel=1e-12)


def test_colour_of_focus_and_of_the_chief_ray():
    lens = load_lens("star_camera_206mm")
    shift = axial_colour_mm(lens, [500.0, 600.0, 800.0])
    assert shift[1] == 0.0
    focus = [paraxial(lens, w).rear_focus_z_mm for w in (500.0, 600.0, 800.0)]
    np.testing.assert_allclose(shift, np.array(focus) - focus[1], atol=1e-12)
    x, _ = chief_ray_points(lens, 0.01, 0.0, np.array([500.0, 600.0, 800.0]))
    np.testing.assert_allclose(lateral_colour_mm(lens, 0.01, [500.0, 600.0, 800.0]), x - x[1], atol=2e-10)


def test_focal_length_in_vacuum_and_plate_scale_in_focus():
    singlet = thick_lens(60.0, -90.0, 0.0, -10.0)
    air, vacuum = paraxial(singlet), paraxial(replace(singlet, environment=VACUUM))
    n = float(replace(singlet, environment=VACUUM).indices(600.0)[2])
    assert air.efl_mm / vacuum.efl_mm == pytest.approx((n - 1.0) / 0.5, rel=1e-12)
    lens = refocused(load_lens("star_tracker_26mm"))
    assert plate_scale_mm(lens) == pytest.approx(paraxial(lens).efl_mm, rel=1e-4)


@pytest.mark.parametrize("defocus_mm", [0.0, 2.0])
def test_scale_of_the_image_is_the_height_of_the_chief_ray_over_its_slope(defocus_mm):
    """Of a lens in focus and out of it; the focus stays where it is when the detector moves away."""
    lens = load_lens("star_camera_206mm")
    moved = replace(lens, image_position_mm=lens.image_position_mm + defocus_mm * np.eye(3)[2])
    heights, _ = chief_ray(moved, 1.0)
    assert image_scale_mm(moved) == pytest.approx(abs(heights[-1]) / np.tan(np.radians(1.0)), rel=1e-9)
    assert focus_behind_mm(lens) - focus_behind_mm(moved) == pytest.approx(defocus_mm, abs=1e-9)
