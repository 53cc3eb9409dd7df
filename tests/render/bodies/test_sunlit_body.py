"""Bodies in the Sun's light: absolute photometry, the path of a moving camera, meshes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from optics.lens_file import load_lens
from optics.light.band import TopHat
from render.bodies.body_image import render_body
from render.bodies.solar_system import planet_field, solar_system
from render.bodies.sunlit_body import SunlitBody, covers, map_factor, planet_body, sphere_photons
from render.camera import Camera
from render.catalogue.motion import earth_observer
from render.forward import render_stars
from render.motion.trajectory import ConstantRate
from render.plugins.camera_properties import lens_camera_properties
from render.sky.sunlight import sunlight

BAND = (TopHat(centre_nm=650.0, width_nm=100.0, edge_nm=5.0),)
PITCH_RAD = 5.5e-3 / 206.2
FINE = np.linspace(590.0, 710.0, 12001)


def camera_of(width=96, height=96):
    return Camera(
        lens=load_lens("star_camera_206mm"),
        width_px=width,
        height_px=height,
        pixel_pitch_mm=5.5e-3,
        charge_diffusion_px=0.18,
    )


def ball(radius_px, phase_deg, **changes):
    a = np.radians(phase_deg)
    settings = {
        "direction": np.array([0.0, 0.0, 1.0]),
        "distance_km": 1e6,
        "to_sun": np.array([np.sin(a), 0.0, -np.cos(a)]),
        "radius_km": 1e6 * radius_px * PITCH_RAD,
        "albedo": [0.3],
    }
    return SunlitBody(**(settings | changes))


def moments(body_image):
    light = body_image.image.electrons[..., 0].astype(float)
    rows, columns = np.indices(light.shape)
    total = light.sum()
    x, y = (light * columns).sum() / total, (light * rows).sum() / total
    return total, x, y, (light * (columns - x) ** 2).sum() / total, (light * (rows - y) ** 2).sum() / total


@pytest.mark.parametrize(
    ("law", "phase_deg"), [("lunar", 60.0), pytest.param("lambert", 100.0, marks=pytest.mark.slow)]
)
def test_total_against_the_closed_form(engine, law, phase_deg):
    """Light of the whole sphere by the phase function, integrated here over wavelength by trapezoids."""
    body = ball(10.0, phase_deg, law=law, sun_distance_au=1.5)
    photons = np.trapezoid(sphere_photons(body, FINE) * BAND[0].transmission(FINE), FINE)
    expected = photons * np.pi * 35.0**2 * 2e-3
    # radius over distance is 3e-4
    assert render_body(camera_of(), body, BAND, exposure_s=2e-3).electrons[0] == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_thin_crescent(engine):
    """0.03 px wide: its light is that of the closed form; the image's error is below photon noise in every pixel."""
    body = ball(2.0, 170.0, law="lunar")
    photons = np.trapezoid(sphere_photons(body, FINE) * BAND[0].transmission(FINE), FINE) * np.pi * 35.0**2
    exposure_s = 1e5 / photons
    image = render_body(camera_of(32, 32), body, BAND, exposure_s=exposure_s)
    # radius over distance is 5e-5, which is 3e-4 of the crescent's angle, and its light goes with the third power
    assert image.electrons[0] == pytest.approx(1e5, rel=3e-3)
    assert image.image.electrons.max() > 5e3
    assert 0.0 < image.noise_share < 0.03
    finer = render_body(camera_of(32, 32), body, BAND, exposure_s=exposure_s, noise_share=1e-5)
    difference = (image.image.electrons - finer.image.electrons).astype(float) ** 2
    assert (difference < 0.03 * finer.image.electrons + 1e-6).all()


@pytest.mark.slow
def test_pixel_by_pixel_against_mitsubas_own_walk(mi):
    """A sphere of Mitsuba under a directional light, by its path integrator backwards through `lens_camera`."""
    camera = replace(camera_of(36, 36), charge_diffusion_px=0.0)
    body = ball(13.0, 40.0, law="lunar", albedo=[1.0])  # farther away Mitsuba's float32 lets the ball shade itself
    line = (TopHat(centre_nm=650.0, width_nm=1.0),)
    image = render_body(camera, body, line, exposure_s=1.0, nodes=1)
    bsdf = {"type": "lunar_surface", "albedo": {"type": "uniform", "value": 1.0}}
    position = (-body.distance_km / body.radius_km * body.direction).tolist()
    sensor = lens_camera_properties(
        camera,
        to_world=mi.ScalarTransform4f().translate(position),
        scene_unit_mm=body.radius_km * 1e6,
        wavelength_nm=650.0,
    )
    sun = {"type": "directional", "direction": (-body.to_sun).tolist(), "irradiance": 1.0}
    scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": bsdf}, "sun": sun, "camera": sensor})
    path = mi.load_dict({"type": "path", "max_depth": 2})
    passes = np.array([np.array(mi.render(scene, integrator=path, spp=256, seed=k))[..., 0] for k in range(12)])
    there, spread = passes.mean(0), passes.std(0, ddof=1) / np.sqrt(12)
    here = image.image.electrons[..., 0] * (there.sum() / image.electrons[0])
    lit = there > 0.02 * there.max()
    # t distribution with 11 degrees of freedom: mean square 11/9; some 400 pixels
    pull = (here - there)[lit] / np.maximum(spread[lit], 1e-3 * there.max())
    assert lit.sum() > 200
    assert np.mean(pull**2) < 1.8
    assert np.abs(pull).max() < 6.0


@pytest.mark.slow
def test_error_of_the_image_is_below_photon_noise(engine):
    """(13.6 times the photon noise with 64 rays a pixel.) The same from any start; what is left is stated."""
    camera, body = camera_of(48, 48), ball(10.0, 70.0, law="lunar")
    first, again = (render_body(camera, body, BAND, exposure_s=1e-4, frame=frame) for frame in (0, 2**40))
    assert np.array_equal(first.image.electrons, again.image.electrons)
    assert 1000.0 < first.image.electrons.max() < 2e4
    assert 0.0 < first.noise_share < 0.03
    shifted = np.array([0.37, -0.21]) * PITCH_RAD
    away = np.array([*shifted, 1.0]) / np.sqrt(1.0 + (shifted**2).sum())
    fine = render_body(camera, replace(body, direction=away), BAND, exposure_s=1e-4, noise_share=1e-3)
    coarse = render_body(camera, replace(body, direction=away), BAND, exposure_s=1e-4)
    difference = (coarse.image.electrons - fine.image.electrons).astype(float) ** 2
    assert (difference <= 0.03 * fine.image.electrons + 1e-9).all()
    assert coarse.photon_px[0] - first.photon_px[0] == pytest.approx([0.37, -0.21], abs=0.02)


@pytest.mark.slow
def test_a_body_in_front(engine):
    """A nearer ball hides half of a full disk; a farther one in its list would hide it as well: the caller knows."""
    camera, far = camera_of(), ball(12.0, 0.0)
    near = ball(
        9.0, 0.0, direction=np.array([9.0 * PITCH_RAD, 0.0, 1.0]) / np.hypot(9.0 * PITCH_RAD, 1.0), distance_km=1e5
    )
    near = replace(near, radius_km=1e5 * 9.0 * PITCH_RAD)
    whole = render_body(camera, far, BAND, exposure_s=1e-3)
    hidden = render_body(camera, far, BAND, exposure_s=1e-3, in_front=(near,))
    # Lambert at full phase: radiance sqrt(1 - r^2); integrated here on a grid over what the near disk leaves
    x, y = np.meshgrid(*(2 * [np.linspace(-12.0, 12.0, 1601)]))
    light = np.sqrt(np.maximum(144.0 - x**2 - y**2, 0.0))
    left = light[np.hypot(x - 9.0, y) > 9.0].sum() / light.sum()
    assert hidden.electrons[0] / whole.electrons[0] == pytest.approx(left, abs=2e-3)
    assert hidden.photon_px[0, 0] < whole.photon_px[0, 0] - 3.0


@pytest.mark.slow
def test_planet_is_as_bright_as_its_star(engine):
    """Venus, 45 arcsec across, as a disk and as a point: the two paths share the magnitude only."""
    camera = camera_of(64, 64)
    system = solar_system(2020.4, bodies=["venus"])
    body = planet_body(system, "venus")
    assert system.angular_diameter_rad[0] > 8 * PITCH_RAD
    turn, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [system.direction[0]])
    camera = replace(camera, rotation_cam_from_world=turn.as_matrix())
    disk = render_body(camera, body, BAND, exposure_s=1e-4)
    star = render_stars(camera, planet_field(system, BAND), exposure_s=1e-4)
    truth = star.truth
    whole = star.electrons.sum(dtype=float) + truth.electrons_beyond.sum()  # its tails reach beyond the stamp
    assert disk.electrons[0] == pytest.approx(whole, rel=3e-3)
    # the crescent lies on the Sun's side of the centre
    _, x, y, _, _ = moments(disk)
    side = (turn.as_matrix() @ body.to_sun)[:2]
    side = side / np.linalg.norm(side)
    assert np.array([x - truth.photon_x_px[0, 0], y - truth.photon_y_px[0, 0]]) @ side > 2.0
    assert covers(body, np.stack([system.direction[0], np.roll(system.direction[0], 1)])).tolist() == [True, False]


@pytest.mark.slow
def test_smear_and_rolling_shutter(engine):
    """A ball under a camera that turns 60 px a second about +Y: spread of a uniform path, slope of late rows."""
    camera, body = camera_of(160, 64), ball(6.0, 0.0)
    still = render_body(camera, body, BAND, exposure_s=1.0, nodes=1)
    motion = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=np.array([0.0, 60 * PITCH_RAD, 0.0]), end_s=9.0)
    moved = render_body(camera, body, BAND, exposure_s=1.0, nodes=1, trajectory=motion)
    total, x, y, var_x, var_y = moments(still)
    total_m, x_m, y_m, var_x_m, var_y_m = moments(moved)
    # the position of a star along the path has the variance 60^2/12
    assert total_m == pytest.approx(total, rel=2e-3)
    assert abs(x_m - (x - 30.0)) < 0.03
    assert abs(y_m - y) < 0.01
    assert var_x_m - var_x == pytest.approx(300.0, rel=3e-3)
    assert var_y_m == pytest.approx(var_y, rel=3e-3)
    late = render_body(camera, body, BAND, exposure_s=1e-3, nodes=1, trajectory=motion, start_s=0.1, line_time_s=5e-3)
    light = late.image.electrons[..., 0].astype(float)
    rows = np.arange(27, 38)
    centre = light[rows] @ np.arange(160) / light[rows].sum(1)
    slope, there = np.polyfit(rows - 31.5, centre, 1)
    # 0.3 px a row; the middle row starts 0.1 s + 31.5 x 5 ms after the motion
    assert slope == pytest.approx(-0.3, abs=0.02)
    assert there == pytest.approx(79.5 - 60 * (0.1 + 31.5 * 5e-3 + 5e-4), abs=0.2)


def test_mesh_of_the_user(engine, tmp_path):
    """A Lambertian plate turned by 60 deg about its long side, lit and seen along the axis: albedo cos(60 deg) / pi."""
    file = tmp_path / "plate.obj"
    file.write_text("v -1 -0.5 0\nv 1 -0.5 0\nv 1 0.5 0\nv -1 0.5 0\nf 1 2 3\nf 1 3 4\n", encoding="ascii")
    tilt = Rotation.from_euler("x", 180.0 - 60.0, degrees=True).as_matrix()
    body = ball(12.0, 0.0, mesh=file, mesh_unit_km=1e6 * 8 * PITCH_RAD, rotation_icrs_from_body=tilt)
    image = render_body(camera_of(40, 40), body, BAND, exposure_s=1.0, nodes=1)
    total, x, y, var_x, var_y = moments(image)
    # 16 px long, 8 px x cos 60 = 4 px high; the variance of a uniform strip is its square over 12, diffusion on top
    photons = np.trapezoid(sunlight(FINE) * BAND[0].transmission(FINE), FINE)
    solid_angle = 16 * 4 * PITCH_RAD**2
    assert total == pytest.approx(photons * 0.3 * 0.5 / np.pi * solid_angle * np.pi * 35.0**2, rel=0.02)
    assert (x, y) == pytest.approx((19.5, 19.5), abs=0.05)
    assert (var_x, var_y) == pytest.approx((16**2 / 12, 4**2 / 12), rel=0.25)
    assert image.noise_share < 0.03


def test_a_map_of_one_albedo_is_the_closed_form_and_a_gradient_is_linear():
    """Sums over the disk against Lambert's and Lommel and Seeliger's phase functions; cells of 10 deg."""
    for law in ("lambert", "lunar"):
        for phase_deg in (0.0, 50.0, 120.0):
            plain = ball(10.0, phase_deg, law=law)
            mapped = replace(plain, albedo_map=np.full((18, 36), 2.0))
            assert sphere_photons(mapped, 600.0) == pytest.approx(2.0 * sphere_photons(plain, 600.0), rel=1e-3)
    latitude = np.radians(np.arange(-85.0, 90.0, 10.0))
    sloped = ball(10.0, 0.0, albedo_map=np.repeat((2.0 + latitude)[:, None], 36, axis=1))
    angle = np.radians([-80.0, -20.0, 0.0, 33.0])
    normal = np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=-1)
    np.testing.assert_allclose(map_factor(sloped, normal), 2.0 + angle, rtol=1e-6)
    np.testing.assert_allclose(map_factor(ball(10.0, 0.0), normal), 1.0)


def test_the_earth_from_an_orbit_has_air_and_its_bond_albedo():
    above = earth_observer(2024.3).moved(position_km=[0.0, 0.0, 4e4], velocity_km_per_s=[0.0, 0.0, 0.0])
    body = planet_body(solar_system(2024.3, observer=above, bodies=["earth"]), "earth")
    assert (body.law, body.distance_km) == ("lambert", pytest.approx(4e4, rel=1e-3))
    assert body.albedo_at(550.0) == pytest.approx(0.297, rel=1e-3)  # P. R. Goode et al. (2001)
    assert body.air.height == pytest.approx(7.0 / 6371.0, rel=1e-4)


def test_bodies_out_of_the_field_give_no_light(engine):
    camera = camera_of(32, 32)
    beside = render_body(camera, ball(5.0, 0.0, direction=[1.0, 0.0, 0.0]), BAND, exposure_s=1.0)
    behind = render_body(camera, ball(5.0, 0.0, direction=[0.0, 0.0, -1.0]), BAND, exposure_s=1.0)
    assert not beside.image.electrons.any()
    assert not behind.image.electrons.any()
    assert np.isnan(behind.photon_px).all()
