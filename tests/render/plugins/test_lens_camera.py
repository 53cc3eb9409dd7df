"""`lens_camera` under Mitsuba's own path integrator: radiometry, and the same geometry as the forward trace."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from optics.frames import light_direction
from optics.lens.perturb import decentre, tilt_image
from optics.lens_file import load_lens
from optics.rays.reverse import retraced
from optics.rays.trace import Rays, trace
from render.camera import Camera, launch_disk
from render.plugins.camera_properties import lens_camera_properties
from render.plugins.lens_camera import exit_disk
from render.tracing.tracer import Tracer

LENSES = ("star_camera_206mm", "star_tracker_26mm", "double_gauss_50mm")


def marginal_sine(lens):
    """Sine of the angle at which the ray through the rim of the pupil meets the axis, by the forward trace."""
    disk = launch_disk(Camera(lens=lens, width_px=2, height_px=2, pixel_pitch_mm=0.001))
    rays = Rays.create(
        x_mm=disk.radius_mm * (1 - 1e-12), y_mm=0.0, z_mm=disk.z_mm, direction=[0, 0, 1.0], wavelength_nm=600.0
    )
    out = trace(lens, rays)
    assert out.ok
    return float(np.abs(out.dx))


def test_uniform_sky_gives_pi_sine_squared(mi, bench):
    lens = load_lens("star_camera_206mm")
    camera = Camera(lens=lens, width_px=16, height_px=16, pixel_pitch_mm=0.01)
    image = bench.path_image(mi, camera, {"sky": {"type": "constant", "radiance": 3.0}}, spp=4096)
    # N = 1e6 rays, of which 75 % hit with nearly equal weight: standard error 6e-4
    assert image.mean() / 3.0 == pytest.approx(np.pi * marginal_sine(lens) ** 2, rel=2.5e-3)


@pytest.mark.parametrize("name", LENSES)
def test_all_light_goes_through_the_exit_disk(name, bench):
    camera = bench.camera_of(decentre(load_lens(name), load_lens(name).elements[-1], x_mm=0.2))
    x, y, z, radius = exit_disk(camera)
    disk, rng, count = launch_disk(camera), np.random.default_rng(2), 20000
    angle, azimuth = camera.field_reach_rad * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    v = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)
    r, phi = disk.radius_mm * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    rays = Rays.create(
        x_mm=disk.x_mm + r * np.cos(phi),
        y_mm=disk.y_mm + r * np.sin(phi),
        z_mm=disk.z_mm,
        direction=light_direction(v),
        wavelength_nm=rng.uniform(500, 800, count),
    )
    out = trace(camera.lens, rays)
    names = ("x", "y", "z", "dx", "dy", "dz", "wavelength_nm", "opl_mm", "status", "failed_at")
    back = retraced(camera.lens, Rays(**{key: getattr(out, key)[out.ok] for key in names}))
    at_x = back.x + back.dx / back.dz * (z - back.z)
    at_y = back.y + back.dy / back.dz * (z - back.z)
    assert out.ok.sum() > 5000
    filled = np.hypot(at_x - x, at_y - y).max() / radius
    assert 0.9 < filled < 1.0


def test_distant_ball_is_seen_where_the_star_is(mi, bench):
    """Reciprocity: light traced backwards from the detector finds the ball where light traced forwards lands."""
    lens = decentre(load_lens("star_camera_206mm"), "L2", x_mm=0.3, y_mm=-0.2)
    lens = tilt_image(lens, x_deg=0.2, y_deg=-0.1)
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    whole = replace(bench.camera_of(lens, charge_diffusion_px=0.0), rotation_cam_from_world=turn)
    stars = bench.stars_at(whole, 3500.3, 400.2, bands=((lens.design_wavelength_nm, 0.0),))
    camera = bench.window(whole, 14, *Tracer(whole).bundle_means(stars)[0, 0])
    truth = Tracer(camera, sobol_log2_rays=18).render(stars, exposure_s=1.0).truth
    angle = 1.5 * 5.5e-3 / 206.2  # 3 px across
    ball = bench.distant_ball(stars.direction[0], angle)
    image = bench.path_image(
        mi, camera, {"ball": ball}, spp=8192, scene_unit_mm=1000.0, wavelength_nm=lens.design_wavelength_nm
    )
    index = np.arange(14)
    mean_x, mean_y = index @ image.sum(0) / image.sum(), index @ image.sum(1) / image.sum()
    hits = 196 * 8192 * (np.pi * 1.5**2) / 196 * 0.7
    error = 2.0 / np.sqrt(hits)  # spot and ball together have a standard deviation below 2 px
    assert abs(mean_x - truth.bundle_x_px[0, 0]) < 4 * error
    assert abs(mean_y - truth.bundle_y_px[0, 0]) < 4 * error
    # flux: etendue of the ball through the pupil, in irradiance x pixels
    collected = (truth.electrons_image + truth.electrons_off_edge)[0, 0] / stars.photon_rate.sum()
    assert image.sum() * camera.pixel_pitch_mm**2 == pytest.approx(collected * np.pi * angle**2, rel=0.02)


CROP = {"crop_offset_x": 26, "crop_offset_y": 9, "crop_width": 14, "crop_height": 15}


def wall(mi):
    """A grey wall with edges in and out of the crop, and a lamp of unit intensity beside it, some metres away."""
    at = mi.ScalarTransform4f().translate([-60.0, 80.0, 5000.0]).rotate([0, 1, 0], 180.0).scale([200.0, 120.0, 1.0])
    return {
        "wall": {"type": "rectangle", "to_world": at, "bsdf": {"type": "diffuse", "reflectance": 0.7}},
        "lamp": {"type": "point", "position": [0.0, 150.0, 4800.0], "intensity": 1e4},
    }


def moments(image):
    row, column = np.indices(image.shape)
    return image.sum(), (image * column).sum() / image.sum(), (image * row).sum() / image.sum()


@pytest.mark.parametrize("integrator", [pytest.param("path", marks=pytest.mark.slow), "ptracer"])
def test_crop_is_a_part_of_the_film(mi, integrator):
    """Pixels of the crop against those of the whole film; light traced forwards against light traced backwards."""
    lens = load_lens("star_tracker_26mm")
    camera = Camera(lens=lens, width_px=48, height_px=40, pixel_pitch_mm=0.05)
    render = {"integrator": {"type": integrator, "max_depth": 2}, "spp": 1024}

    def image(crop, **settings):
        sensor = lens_camera_properties(camera)
        sensor["film"] |= crop
        scene = {"type": "scene", "sensor": sensor, **wall(mi)}
        chosen = render | settings
        integrator = mi.load_dict(chosen["integrator"])
        return np.array(mi.render(mi.load_dict(scene), integrator=integrator, spp=chosen["spp"]), dtype=float)[..., 0]

    cropped = image(CROP)
    part = image({}, integrator={"type": "path", "max_depth": 2}, spp=256)[9:24, 26:40]
    assert cropped.shape == part.shape
    # 256 rays in each of 210 px backwards, some 8e4 photons in the crop forwards: 0.5 %, 0.02 px
    (total, x, y), (whole_total, whole_x, whole_y) = moments(cropped), moments(part)
    assert total == pytest.approx(whole_total, rel=0.015)
    assert (x, y) == pytest.approx((whole_x, whole_y), abs=0.06)
    assert 0.2 < part.min() / part.max() < 0.8 or part.min() == 0.0  # there is something to tell places by


def test_rows_of_a_crop_start_when_those_of_the_film_do(mi):
    """Rolling shutter: an edge leans as in the whole film, from the first row of the film."""
    camera = Camera(lens=load_lens("star_tracker_26mm"), width_px=48, height_px=40, pixel_pitch_mm=0.05)
    rate = 0.05 / 26.0  # a pixel per second
    table = Rotation.from_rotvec(np.outer(np.linspace(0.0, 10.0, 33) * rate, [0.0, 1.0, 0.0])).as_matrix()
    motion = {
        "motion_rotation": mi.TensorXf64(table[None]),
        "motion_duration_s": 10.0,
        "line_time_s": 0.2,
        "shutter_close": 1e-3,
    }
    side = mi.ScalarTransform4f().translate([500.0, 0.0, 5000.0]).rotate([0, 1, 0], 180.0).scale([500.0, 900.0, 1.0])
    screen = {"screen": {"type": "rectangle", "to_world": side, "light": {"type": "area", "radiance": 1.0}}}

    def edge(**crop):
        sensor = lens_camera_properties(camera, **motion)
        sensor["film"] |= crop
        scene = mi.load_dict({"type": "scene", "sensor": sensor, **screen})
        image = np.array(mi.render(scene, integrator=mi.load_dict({"type": "path"}), spp=256), dtype=float)[..., 0]
        return image.sum(1) / image[:, -4:].mean()  # columns of light in each row, up to the right edge

    whole, part = edge(), edge(crop_offset_x=4, crop_offset_y=18, crop_width=40, crop_height=20)
    lean = np.polyfit(np.arange(20), part, 1)[0]
    assert abs(lean) == pytest.approx(0.2, rel=0.1)
    # 256 rays a pixel, two thirds of which get through: 0.1 px in a row
    assert (whole[18:38] - part).mean() == pytest.approx(4.0, abs=0.1)


@pytest.mark.slow
def test_projective_integrators(mi):
    """Images and derivatives of what is not geometry."""
    import drjit as dr

    camera = Camera(lens=load_lens("star_tracker_26mm"), width_px=4, height_px=4, pixel_pitch_mm=0.1)
    wall = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0, 900.0]).scale([500.0, 500.0, 5.0])}
    wall |= {"bsdf": {"type": "diffuse", "reflectance": 0.5}}
    contents = {"wall": wall, "sky": {"type": "constant"}, "sensor": lens_camera_properties(camera)}
    scene = mi.load_dict({"type": "scene", **contents})
    parameters = mi.traverse(scene)
    integrator = mi.load_dict({"type": "prb_projective", "max_depth": 2})

    def differentiated(key):
        dr.enable_grad(parameters[key])
        parameters.update()
        image = mi.render(scene, parameters, integrator=integrator, spp=256)
        total = float(np.array(dr.detach(image)).sum())
        dr.backward(dr.sum(image.array))
        return total, parameters[key]

    total, value = differentiated("wall.bsdf.reflectance.value")
    stock = mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 2}), spp=256)
    assert total == pytest.approx(float(np.array(stock).sum()), rel=0.02)
    # light once scattered is in proportion to the reflectance
    assert float(np.ravel(dr.grad(value))[0]) == pytest.approx(total / 0.5, rel=0.02)
