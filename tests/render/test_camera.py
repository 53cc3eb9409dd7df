"""Camera record: geometry, response, refusal of what cannot be."""

import numpy as np
import pytest

from optics.glass.coating import QuarterWave
from optics.lens.perturb import decentre, tilt_image
from optics.lens_file import load_lens
from optics.light.transmission import lens_transmission
from optics.rays.trace import Rays, trace
from render.camera import Camera, build_camera, launch_disk
from render.detector.spec import load_detector

SETTINGS = {"width_px": 40, "height_px": 30, "pixel_pitch_mm": 0.01}


def test_axis_meets_the_middle_of_the_image():
    camera = Camera(lens=load_lens("star_camera_206mm"), **SETTINGS)
    assert camera.centre_px.tolist() == [19.5, 14.5]
    assert [float(v) for v in camera.to_pixel(np.array(0.1), np.array(0.1))] == pytest.approx([29.5, 4.5])


def test_nominal_direction_and_to_pixel_are_inverse():
    camera = Camera(lens=load_lens("star_camera_206mm"), **SETTINGS)
    x, y = np.array([0.0, 19.5, 39.0]), np.array([29.0, 14.5, 3.0])
    v = camera.nominal_direction(x, y, 200.0)
    assert np.allclose(np.linalg.norm(v, axis=1), 1.0, atol=1e-15)
    # lens frame: x = f X/Z, y = -f Y/Z
    column, row = camera.to_pixel(200.0 * v[:, 0] / v[:, 2], -200.0 * v[:, 1] / v[:, 2])
    assert np.allclose(column, x, atol=1e-11)
    assert np.allclose(row, y, atol=1e-11)
    assert v[2, 0] > 0
    assert v[0, 1] > 0  # larger column: +X, larger row: +Y


def test_defocus_moves_the_detector_along_its_normal():
    lens = tilt_image(load_lens("star_camera_206mm"), x_deg=2.0)
    camera = Camera(lens=lens, defocus_mm=0.3, **SETTINGS)
    shift = camera.focused_lens.image_position_mm - lens.image_position_mm
    assert np.linalg.norm(shift) == pytest.approx(0.3, abs=1e-13)
    assert np.allclose(np.cross(shift, lens.image_rotation[:, 2]), 0.0, atol=1e-15)
    assert shift[2] > 0


def test_response_is_quantum_efficiency_times_transmission():
    lens, detector = load_lens("star_camera_206mm"), load_detector("cmv4000")
    camera = build_camera(lens, detector, coating=QuarterWave(design_wavelength_nm=550.0))
    wavelength = np.array([[500.0, 603.0], [700.0, 851.0]])  # tabulated every 5 nm, linear between
    expected = detector.quantum_efficiency.interpolate(wavelength) * lens_transmission(
        lens, wavelength, coating=QuarterWave(design_wavelength_nm=550.0)
    )
    assert np.allclose(camera.response_at(wavelength), expected, rtol=2e-3)
    assert (camera.width_px, camera.height_px) == (detector.width_px, detector.height_px)
    assert camera.charge_diffusion_px == pytest.approx(detector.diffusion_sigma_mm / detector.pixel_pitch_mm)
    assert np.array_equal(Camera(lens=lens, **SETTINGS).response_at(wavelength), np.ones((2, 2)))


@pytest.mark.parametrize("name", ["star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm"])
def test_no_light_enters_beside_the_launch_disk(name):
    camera = Camera(lens=load_lens(name), width_px=1024, height_px=1024, pixel_pitch_mm=0.01)
    disk = launch_disk(camera)

    def arrive(angle, scale):
        turn = 2 * np.pi * np.arange(400) / 400
        rays = Rays.create(
            x_mm=disk.x_mm + scale * disk.radius_mm * np.cos(turn),
            y_mm=disk.y_mm + scale * disk.radius_mm * np.sin(turn),
            z_mm=disk.z_mm,
            direction=[np.sin(angle), 0.0, np.cos(angle)],
            wavelength_nm=camera.lens.design_wavelength_nm,
        )
        return trace(camera.lens, rays).ok

    assert camera.field_reach_rad >= np.radians(camera.lens.max_field_deg)
    for part in (0.0, 0.4, 0.7, 1.0):
        for scale in (1.0 + 1e-6, 1.02, 1.1, 1.3):
            assert not arrive(part * camera.field_reach_rad, scale).any()
    assert disk.exact == (name == "star_camera_206mm")
    assert arrive(0.0, 1.0 - 1e-9 if disk.exact else 0.9).all()


def test_launch_disk_covers_a_detector_larger_than_the_lens_is_meant_for():
    lens = load_lens("star_tracker_26mm")
    large = Camera(lens=lens, width_px=2000, height_px=2000, pixel_pitch_mm=0.01)
    assert np.degrees(large.field_reach_rad) > 25 > lens.max_field_deg


def test_decentred_stop_is_where_light_is_launched():
    lens = load_lens("star_camera_206mm")
    moved = decentre(lens, lens.stop_index, x_mm=0.7, y_mm=-0.4)
    disk = launch_disk(Camera(lens=moved, **SETTINGS))
    assert (disk.x_mm, disk.y_mm, disk.exact) == (0.7, -0.4, True)
