"""The simulated night: motion, sky, noise, and what the document states of them."""

import numpy as np
import pytest

from calib.attitude.euler_angles import angles_of_rotation
from calib.attitude.gyro_attitude import link_attitudes
from calib.calibration.drawn_stars import draw_stars
from experiments.acf.settings import AcfConfig, AcfSkyConfig
from experiments.acf.simulate import build_scene, choose_frames, gyro_rotations, observe
from experiments.acf.table2 import TRUE
from render.engine.random import Streams

CONFIG = AcfConfig()


@pytest.fixture(scope="module")
def scene():
    return build_scene(CONFIG)


def test_scene_is_the_one_of_table_1_and_2(scene):
    first = np.degrees(angles_of_rotation(scene.attitude[0]))
    assert first == pytest.approx(TRUE[8:11], abs=1e-9)
    assert np.degrees(angles_of_rotation(scene.installation)) == pytest.approx([2, 2, 2], abs=1e-9)
    assert scene.camera.parameters == pytest.approx(TRUE[:8], rel=1e-12)
    assert np.degrees(np.linalg.norm(scene.motion.rate(scene.time_s), axis=1)) == pytest.approx(0.5, rel=1e-12)
    assert (len(scene.time_s), scene.time_s[-1]) == (60, 59.0)
    linked = link_attitudes(scene.attitude[0], scene.installation, scene.body)
    assert (linked * scene.attitude.inv()).magnitude().max() < 1e-12  # eq. 6


def turn(axis, angle_rad):
    """Matrices of ACF17 eq. 2, as printed: axes turn by the angle."""
    c, s, i, j = np.cos(angle_rad), np.sin(angle_rad), (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = s, -s
    return matrix


def test_stars_lie_where_the_printed_equations_put_them():
    """Eq. 1 to 6 in plain NumPy for half a minute; the rate is integrated by Runge and Kutta in steps of 0.05 s."""
    angles = {"phi": (20.0, -10.0, 30.0), "theta": (2.0, -3.0, 4.0)}
    config = CONFIG.model_copy(update={"frames": 30, "sky": AcfSkyConfig(phi_deg=angles["phi"])})
    config = config.model_copy(update={"gyro": config.gyro.model_copy(update={"installation_deg": angles["theta"]})})
    scene = build_scene(config)
    stars = draw_stars(scene.camera, scene.attitude, np.random.default_rng([3, 0]), mean=10.0)

    def slope(time_s, matrix):
        along, tilt = 2 * np.pi * time_s / 29.0, np.arctan(np.sqrt(0.5))
        rate = [np.cos(tilt) * np.cos(along), np.cos(tilt) * np.sin(along), np.sin(tilt)]
        x, y, z = np.radians(0.5) * np.array(rate)
        return np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]) @ matrix

    body, h = [np.eye(3)], 0.05
    for k in range(29 * 20):
        t, m = k * h, body[-1]
        k1 = slope(t, m)
        k2 = slope(t + h / 2, m + h / 2 * k1)
        k3 = slope(t + h / 2, m + h / 2 * k2)
        body.append(m + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(t + h, m + h * k3)))
    matrix = {
        key: turn(1, a[1]) @ turn(0, a[0]) @ turn(2, a[2]) for key, a in ((k, np.radians(v)) for k, v in angles.items())
    }
    mount = matrix["theta"]
    seen = np.einsum(
        "nij,nj->ni", (mount @ np.array(body[::20]) @ mount.T @ matrix["phi"])[stars.frame], stars.direction
    )
    c = config.camera
    x, y = c.focal_length_mm * seen[:, :2].T / seen[:, 2]  # eq. 3, then eq. 4
    r2 = x * x + y * y
    radial = c.q1_per_mm2 * r2 + c.q2_per_mm4 * r2**2 + c.q3_per_mm6 * r2**3
    dx = x * radial + c.p1_per_mm * (2 * x * x + r2) + 2 * c.p2_per_mm * x * y
    dy = y * radial + c.p2_per_mm * (2 * y * y + r2) + 2 * c.p1_per_mm * x * y
    place = np.column_stack([511.5 + c.x0_px + (x + dx) / 0.01, 511.5 + c.y0_px + (y + dy) / 0.01])
    assert place == pytest.approx(stars.pixel_px, abs=1e-9)


def test_gyro_without_errors_gives_the_truth(scene):
    """0.1 nano-degrees of walk: what is left is the integration, at 100 Hz."""
    (found,) = gyro_rotations(scene, CONFIG, Streams(1), range(1), (0.0, 1e-10))
    assert (found * scene.body.inv()).magnitude().max() < 1e-9
    assert gyro_rotations(scene, CONFIG, Streams(1), range(3), (0.0, 0.0)) == [scene.body] * 3


def test_gyro_runs_do_not_depend_on_their_company(scene):
    both = gyro_rotations(scene, CONFIG, Streams(1), range(4, 6), (0.03, 0.005))
    (alone,) = gyro_rotations(scene, CONFIG, Streams(1), range(5, 6), (0.03, 0.005))
    assert np.array_equal(both[1].as_quat(), alone.as_quat())


def test_noise_of_a_star_does_not_depend_on_the_frames_used(scene):
    stars = draw_stars(scene.camera, scene.attitude, np.random.default_rng([2, 0]), mean=20.0)
    in_odd, in_all = (
        observe(stars, *choose_frames(stars, scene, which), 0.3, Streams(2).generator("noise", 4))
        for which in ("odd", "all")
    )
    odd = stars.frame % 2 == 0  # frames 1, 3, 5 ... as ACF17 counts them
    assert np.array_equal(in_odd.pixel_px, in_all.pixel_px[odd])
    assert in_odd.frames == 30
    assert np.array_equal(in_odd.frame, stars.frame[odd] // 2)
    # N = 2400 deviates: their standard deviation is known to 1.4 %
    assert (in_all.pixel_px - stars.pixel_px).std() == pytest.approx(0.3, rel=0.06)


def test_another_pixel_is_another_field():
    assert build_scene(CONFIG, 6.4).camera.geometry.pixel_pitch_mm == pytest.approx(6.4e-3)
