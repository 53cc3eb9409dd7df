"""The simulated night: motion, sky, noise, and what the document states of them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.link import angles_of_rotation, link_attitudes
from experiments.acf.published import TABLE2_TRUE
from experiments.acf.settings import Config
from experiments.acf.simulate import TurningAxis, build_scene, choose_frames, draw_stars, gyro_rotations, observe
from render.engine.random import Streams

CONFIG = Config()


@pytest.fixture(scope="module")
def scene():
    return build_scene(CONFIG)


@pytest.mark.parametrize("turns", [0.0, 0.3])
def test_rate_of_a_turning_axis_is_the_derivative_of_its_attitude(turns):
    """R(t + dt) = exp(-rate dt) R(t), by central differences; the rate keeps its size."""
    start = Rotation.from_rotvec([0.4, -0.2, 0.9])
    motion = TurningAxis(initial=start, speed_rad_per_s=0.2, turns_rad_per_s=turns, end_s=10.0)
    assert (motion.attitude(0.0) * start.inv()).magnitude() < 1e-15
    time = np.array([0.5, 3.0, 9.0])
    step = 1e-4
    turned = (motion.attitude(time + step) * motion.attitude(time - step).inv()).as_rotvec()
    assert motion.rate(time) == pytest.approx(-turned / (2 * step), abs=1e-8)
    assert np.linalg.norm(motion.rate(time), axis=1) == pytest.approx(0.2, rel=1e-12)


def test_scene_is_the_one_of_table_1_and_2(scene):
    first = np.degrees(angles_of_rotation(scene.attitude[0]))
    assert first == pytest.approx(TABLE2_TRUE[8:11], abs=1e-9)
    assert np.degrees(angles_of_rotation(scene.installation)) == pytest.approx([2, 2, 2], abs=1e-9)
    assert scene.camera.parameters == pytest.approx(TABLE2_TRUE[:8], rel=1e-12)
    assert np.degrees(np.linalg.norm(scene.motion.rate(scene.time_s), axis=1)) == pytest.approx(0.5, rel=1e-12)
    assert (len(scene.time_s), scene.time_s[-1]) == (60, 59.0)
    linked = link_attitudes(scene.attitude[0], scene.installation, scene.body)
    assert (linked * scene.attitude.inv()).magnitude().max() < 1e-12  # eq. 6


def test_swept_is_the_integral_of_the_rotation(scene):
    """Against a midpoint sum 50 times finer than a frame; error of that is some 1e-4 of a step."""
    time = (np.arange(59 * 50) + 0.5) / 50
    turned = (scene.motion.attitude(0.0) * scene.motion.attitude(time).inv()).as_matrix()
    sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(turned / 50, axis=0)])[::50]
    assert scene.swept == pytest.approx(sums, abs=1e-5)


def test_gyro_without_errors_gives_the_truth(scene):
    """0.1 nano-degrees of walk: what is left is the integration, at 100 Hz."""
    (found,) = gyro_rotations(scene, CONFIG, Streams(1), range(1), (0.0, 1e-10))
    assert (found * scene.body.inv()).magnitude().max() < 1e-9
    assert gyro_rotations(scene, CONFIG, Streams(1), range(3), (0.0, 0.0)) == [scene.body] * 3


def test_gyro_runs_do_not_depend_on_their_company(scene):
    both = gyro_rotations(scene, CONFIG, Streams(1), range(4, 6), (0.03, 0.005))
    (alone,) = gyro_rotations(scene, CONFIG, Streams(1), range(5, 6), (0.03, 0.005))
    assert np.array_equal(both[1].as_quat(), alone.as_quat())


def test_number_of_stars(scene):
    stars = draw_stars(scene, Streams(2), 0, mean=34.0)
    assert len(stars) / 60 == pytest.approx(34.0, abs=1.0)  # the next fainter star may be in all frames
    exact = draw_stars(scene, Streams(2), 0, exactly=7)
    assert np.bincount(exact.frame).tolist() == [7] * 60


def test_stars_are_where_the_camera_sees_them(scene):
    stars = draw_stars(scene, Streams(2), 3, mean=20.0)
    assert np.linalg.norm(stars.direction, axis=1) == pytest.approx(1.0, abs=1e-12)
    assert stars.pixel_px.min() >= -0.5
    assert stars.pixel_px.max() <= 1023.5
    seen = scene.camera.unproject(stars.pixel_px)
    turned = np.einsum("nij,nj->ni", scene.attitude.as_matrix()[stars.frame], stars.direction)
    assert seen == pytest.approx(turned, abs=1e-12)
    order = np.argsort(stars.star, kind="stable")
    same = np.diff(stars.star[order]) == 0
    assert np.all(np.diff(stars.direction[order], axis=0)[same] == 0)  # a star is one star in all frames


def test_sky_is_uniform(scene):
    """30 skies in the first frame, 8 equal bins along each axis: chi^2 of 7, at 1e-3."""
    pixel = np.concatenate(
        [(s := draw_stars(scene, Streams(5), k, mean=40.0)).pixel_px[s.frame == 0] for k in range(30)]
    )
    for axis in range(2):
        count = np.histogram(pixel[:, axis], bins=8, range=(-0.5, 1023.5))[0]
        expected = len(pixel) / 8
        # the outer bins see 10 % less sky per pixel, and distortion moves some stars out
        assert ((count - expected) ** 2 / expected).sum() < 24.3 + len(pixel) * 0.05**2


def test_noise_of_a_star_does_not_depend_on_the_frames_used(scene):
    stars = draw_stars(scene, Streams(2), 0, mean=20.0)
    found = {}
    for which in ("odd", "all"):
        used, kept = choose_frames(stars, scene, which)
        found[which] = observe(stars, used, kept, 0.3, Streams(2).generator("noise", 4))
    odd = stars.frame % 2 == 0
    assert np.array_equal(found["odd"].pixel_px, found["all"].pixel_px[odd])
    assert found["odd"].frames == 30
    assert np.array_equal(found["odd"].frame, stars.frame[odd] // 2)
    # N = 2400 deviates: their standard deviation is known to 1.4 %
    assert (found["all"].pixel_px - stars.pixel_px).std() == pytest.approx(0.3, rel=0.06)


def test_another_pixel_is_another_field():
    small = build_scene(CONFIG, 6.4)
    assert small.camera.geometry.pixel_pitch_mm == pytest.approx(6.4e-3)
    assert small.pixel_arcsec == pytest.approx(206264.8 * 6.4e-3 / 25.6, rel=1e-6)
