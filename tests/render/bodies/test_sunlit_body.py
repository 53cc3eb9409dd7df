"""Bodies in the Sun's light: absolute photometry, the path of a moving camera, meshes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from optics.errors import ConfigError, DomainError
from optics.lens.prescription import load_lens
from optics.light.band import TopHat
from render.bodies.solar_system import planet_field, solar_system
from render.bodies.sunlit_body import SunlitBody, added, covers, planet_body, render_body, sphere_photons
from render.camera import Camera
from render.forward import render_stars
from render.motion.trajectory import ConstantRate

BAND = (TopHat(centre_nm=650.0, width_nm=100.0, edge_nm=5.0),)
PITCH_RAD = 5.5e-3 / 206.2


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


def moments(image):
    light = image.electrons[..., 0].astype(float)
    rows, columns = np.indices(light.shape)
    total = light.sum()
    x, y = (light * columns).sum() / total, (light * rows).sum() / total
    return total, x, y, (light * (columns - x) ** 2).sum() / total, (light * (rows - y) ** 2).sum() / total


@pytest.mark.parametrize(
    ("law", "phase_deg"),
    [
        ("lunar", 60.0),
        pytest.param("lambert", 0.0, marks=pytest.mark.slow),
        pytest.param("lambert", 100.0, marks=pytest.mark.slow),
    ],
)
def test_total_against_the_closed_form(engine, law, phase_deg):
    """Light of the whole sphere by the phase function, integrated here over wavelength by trapezoids."""
    body = ball(10.0, phase_deg, law=law, sun_distance_au=1.5)
    image = render_body(camera_of(), body, BAND, exposure_s=2e-3, samples=256)
    fine = np.linspace(590.0, 710.0, 12001)
    photons = np.trapezoid(sphere_photons(body, fine) * BAND[0].transmission(fine), fine)
    expected = photons * np.pi * 35.0**2 * 2e-3
    # N = 256 x 3 rays in each of some 300 pixels, two thirds get through: 0.3 % where half of the disk is dark and the
    # rest varies by its own size; radius over distance is 3e-4
    assert image.electrons.sum(dtype=float) == pytest.approx(expected, rel=8e-3 if phase_deg == 100.0 else 4e-3)


@pytest.mark.slow
def test_planet_is_as_bright_as_its_star(engine):
    """Venus, 45 arcsec across, as a disk and as a point: the two paths share the magnitude only."""
    camera = camera_of(64, 64)
    system = solar_system(2020.4, bodies=["venus"])
    body = planet_body(system, "venus")
    assert system.angular_diameter_rad[0] > 8 * PITCH_RAD
    turn, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [system.direction[0]])
    camera = replace(camera, rotation_cam_from_world=turn.as_matrix())
    disk = render_body(camera, body, BAND, exposure_s=1e-4, samples=2048)
    star = render_stars(camera, planet_field(system, BAND), exposure_s=1e-4)
    truth = star.truth
    # N = 2048 x 3 rays a pixel, a crescent of some 15 px: 1 %
    assert disk.electrons.sum(dtype=float) == pytest.approx(star.electrons.sum(dtype=float), rel=0.02)
    # the crescent lies on the Sun's side of the centre
    _, x, y, _, _ = moments(disk)
    side = (turn.as_matrix() @ body.to_sun)[:2]
    side = side / np.linalg.norm(side)
    assert np.array([x - truth.photon_x_px[0, 0], y - truth.photon_y_px[0, 0]]) @ side > 2.0
    both = added(star, disk)
    assert both.truth is star.truth
    assert both.electrons.sum(dtype=float) == pytest.approx(2 * star.electrons.sum(dtype=float), rel=0.02)
    assert covers(body, np.stack([system.direction[0], np.roll(system.direction[0], 1)])).tolist() == [True, False]


def test_smear_and_rolling_shutter(engine):
    """A ball under a camera that turns 60 px a second about +Y: spread of a uniform path, slope of late rows."""
    camera, body = camera_of(160, 64), ball(6.0, 0.0)
    still = render_body(camera, body, BAND, exposure_s=1.0, samples=64, nodes=1)
    motion = ConstantRate(initial=Rotation.identity(), rate_rad_per_s=np.array([0.0, 60 * PITCH_RAD, 0.0]), end_s=9.0)
    moved = render_body(camera, body, BAND, exposure_s=1.0, samples=256, nodes=1, trajectory=motion)
    total, x, y, var_x, var_y = moments(still)
    total_m, x_m, y_m, var_x_m, var_y_m = moments(moved)
    # 256 rays in some 900 px: 0.2 %; the position of a star along the path has the variance 60^2/12
    assert total_m == pytest.approx(total, rel=0.02)
    assert abs(x_m - (x - 30.0)) < 0.25
    assert abs(y_m - y) < 0.1
    assert var_x_m - var_x == pytest.approx(300.0, rel=0.02)
    assert var_y_m == pytest.approx(var_y, rel=0.03)
    late = render_body(
        camera, body, BAND, exposure_s=1e-3, samples=256, nodes=1, trajectory=motion, start_s=0.1, line_time_s=5e-3
    )
    light = late.electrons[..., 0].astype(float)
    rows = np.arange(27, 38)
    centre = light[rows] @ np.arange(160) / light[rows].sum(1)
    slope, there = np.polyfit(rows - 31.5, centre, 1)
    # 0.3 px a row; the middle row starts 0.1 s + 31.5 x 5 ms after the motion
    assert slope == pytest.approx(-0.3, abs=0.02)
    assert there == pytest.approx(79.5 - 60 * (0.1 + 31.5 * 5e-3 + 5e-4), abs=0.2)


@pytest.mark.slow
def test_mesh_of_the_user(engine, tmp_path):
    """A square plate of 2 x 1 units, turned by 60 deg about its long side, seen and lit along the axis."""
    file = tmp_path / "plate.obj"
    file.write_text("v -1 -0.5 0\nv 1 -0.5 0\nv 1 0.5 0\nv -1 0.5 0\nf 1 2 3\nf 1 3 4\n", encoding="ascii")
    tilt = Rotation.from_euler("x", 180.0 - 60.0, degrees=True).as_matrix()
    body = ball(20.0, 0.0, mesh=file, mesh_unit_km=1e6 * 16 * PITCH_RAD, rotation_icrs_from_body=tilt)
    image = render_body(camera_of(), body, BAND, exposure_s=1.0, samples=64, nodes=1)
    total, _, _, var_x, var_y = moments(image)
    # extent 32 x 16 cos 60 = 8 px, Lambert's cosine on top; variance of a uniform strip is its square over 12
    sphere = render_body(camera_of(), ball(10.0, 0.0), BAND, exposure_s=1.0, samples=64, nodes=1)
    plate_over_sphere = 32 * 8 * 0.5 / (np.pi * 10.0**2 * 2 / 3)
    assert total / moments(sphere)[0] == pytest.approx(plate_over_sphere, rel=0.02)
    spot = moments(render_body(camera_of(), ball(0.5, 0.0), BAND, exposure_s=1.0, samples=512, nodes=1))
    assert var_x == pytest.approx(32**2 / 12 + spot[3], rel=0.03)
    assert var_y == pytest.approx(8**2 / 12 + spot[4], rel=0.05)


def test_cut_by_the_edge(engine):
    """A full disk around the detector's edge: half of it, and only the part near it is rendered."""
    camera = camera_of(96, 512)
    away = np.array([48.0 * PITCH_RAD, 0.0, 1.0])
    direction = away / np.linalg.norm(away)
    cut = render_body(camera, ball(8.0, 0.0, direction=direction, to_sun=-direction), BAND, exposure_s=1.0, nodes=1)
    whole = render_body(camera, ball(8.0, 0.0), BAND, exposure_s=1.0, nodes=1)
    # 64 rays in each of 200 px: 0.7 %; the spot carries as much in as out
    assert cut.electrons.sum(dtype=float) == pytest.approx(0.5 * whole.electrons.sum(dtype=float), rel=0.04)
    assert not cut.electrons[:200].any()


def test_out_of_sight_and_refusals(engine, tmp_path):
    camera = camera_of(32, 32)
    beside = render_body(camera, ball(5.0, 0.0, direction=[1.0, 0.0, 0.0]), BAND, exposure_s=1.0)
    behind = render_body(camera, ball(5.0, 0.0, direction=[0.0, 0.0, -1.0]), BAND, exposure_s=1.0)
    assert not beside.electrons.any()
    assert not behind.electrons.any()
    with pytest.raises(DomainError, match="outside"):
        ball(5.0, 0.0, distance_km=1.0)
    with pytest.raises(DomainError, match="unit vector"):
        ball(5.0, 0.0, direction=[0.0, 0.0, 2.0])
    with pytest.raises(ConfigError, match="no such file"):
        ball(5.0, 0.0, mesh=tmp_path / "nothing.ply")
    with pytest.raises(ConfigError, match="add up"):
        added(beside, replace(behind, exposure_s=2.0))
    with pytest.raises(DomainError, match="exposure"):
        render_body(camera, ball(5.0, 0.0), BAND, exposure_s=0.0)
