"""Predictions of the attitude-correlated-frames experiment: derivatives, closed forms, limits, sampled statistics."""

from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.attitude.gyro_attitude import link_attitudes
from calib.calibration import linked_design
from calib.calibration.drawn_stars import draw_stars
from experiments.acf.settings import AcfConfig, SweepConfig
from experiments.acf.simulate import build_scene, gyro_rotations
from optics.units import DEG_RAD
from render.engine.random import Streams

CONFIG = AcfConfig(frames=12, sweep=SweepConfig(stars=(4, 8)))
SIGMA = 0.1


@pytest.fixture(scope="module")
def scene():
    return build_scene(CONFIG)


@pytest.fixture(scope="module")
def stars(scene):
    return draw_stars(scene.camera, scene.attitude, np.random.default_rng(1), mean=20.0)


@pytest.fixture(scope="module")
def design(scene, stars):
    return linked_design.LinkedDesign.at(scene.camera, scene.attitude, scene.installation, stars.direction, stars.frame)


def gyro_drift(scene, bias=0.3, walk=0.05):
    return linked_design.GyroDrift.of(
        scene.time_s,
        scene.integrated_rotation,
        bias_rad_per_s=bias * DEG_RAD / 3600,
        walk_rad_per_sqrt_s=walk * DEG_RAD / 60,
    )


def projected(scene, stars, camera=None, first=(0, 0, 0), installation=(0, 0, 0), drift=(0, 0, 0)):
    """Positions with another camera, small turns of both attitudes, a drift of the measured body."""
    turned, mounted = Rotation.from_rotvec(first), Rotation.from_rotvec(installation)
    body = scene.body * Rotation.from_rotvec(-np.asarray(drift))
    attitude = link_attitudes(turned * scene.attitude[0], mounted * scene.installation, body)
    return (camera or scene.camera).project(attitude[stars.frame].apply(stars.direction.copy()))


def test_derivatives_by_the_unknowns(scene, stars, design):
    """Against central differences of the projection through eq. 6."""
    camera, step = scene.camera, 1e-6
    found = design.by_unknown()
    for k in range(14):
        moved = []
        for sign in (1, -1):
            parameters, turn = camera.parameters.copy(), np.zeros(6)
            if k < 8:
                parameters[k] += sign * step * camera.parameter_scales[k]
            else:
                turn[k - 8] = sign * step
            moved.append(projected(scene, stars, camera.with_parameters(parameters), turn[:3], turn[3:]))
        size = camera.parameter_scales[k] if k < 8 else 1.0
        difference = ((moved[0] - moved[1]) / (2 * step * size)).ravel()
        assert np.abs(found[:, k] - difference).max() < 1e-5 * np.abs(difference).max()


def test_derivatives_by_the_gyro(scene, stars, design):
    """A drift e of the first body's axes since the first frame: measured body = truth exp(-e)."""
    found = design.by_drift()
    for axis in range(3):
        drift = np.zeros((CONFIG.frames, 3))
        drift[:, axis] = 1e-6
        moved = [projected(scene, stars, drift=sign * drift) for sign in (1, -1)]
        difference = ((moved[0] - moved[1]) / 2e-6).ravel()
        assert np.abs(found[:, axis] - difference).max() < 1e-5 * np.abs(difference).max()


def test_reprojection_of_the_same_frames_is_the_closed_form(design):
    """tr[H (H'H)^-1 H'] = 14: with a perfect gyro n stars give sigma sqrt(14 / n) whatever the design."""
    found = linked_design.reprojection(design, design, SIGMA)
    assert found.total_px == pytest.approx(SIGMA * np.sqrt(14 / len(design.frame)), rel=1e-9)
    # the square is sigma^2 / n times chi^2 of 14: mean of chi_14 / sqrt(14), variance of chi^2 = 28
    assert found.mean_px / found.total_px == pytest.approx(0.98230, abs=3e-4)
    assert found.scatter_px / found.total_px == pytest.approx(np.sqrt(1 / 28), rel=1e-6)


def test_reprojection_with_gyro_against_drawn_errors(scene, design):
    """3000 drawings of star noise, bias signs and walk through the linear adjustment.
    The mean of the RMS lengths is known to scatter / sqrt(3000), their standard deviation to 1 / sqrt(6000) = 1.3 %;
    four of these, and 1 % for the second-order formula of the mean."""
    odd, even = (design.select(design.frame % 2 == k) for k in (0, 1))
    error = gyro_drift(scene)
    rng = np.random.default_rng(3)
    h, ahead = odd.by_unknown(), even.by_unknown()
    scale = np.linalg.norm(h, axis=0)
    solve = np.linalg.pinv(h / scale)

    def shift(some, drift):  # (draws, 2 n) of drifts (draws, 3 f)
        by_star = drift.reshape(len(drift), -1, 3)[:, np.repeat(some.frame, 2)]
        return np.einsum("ij,dij->di", some.by_drift(), by_star)

    drift = rng.choice([-1.0, 1.0], (3000, 3)) @ error.steady.T
    drift += rng.standard_normal((3000, error.walk.shape[1])) @ error.walk.T
    noise = SIGMA * rng.standard_normal((3000, len(h)))
    unknown = (noise - shift(odd, drift)) @ solve.T
    away = unknown @ (ahead / scale).T + shift(even, drift)
    length = np.sqrt((away**2).sum(1) / len(even.frame))
    # with the gyro's error, which ACC does not know of
    spread = np.sqrt(np.diag(linked_design.correlated_covariance(odd, SIGMA, error))) * scale
    np.testing.assert_allclose(np.sqrt((unknown**2).mean(0)), spread, rtol=4 / np.sqrt(6000) + 0.02)
    assert (spread > 1.05 * np.sqrt(np.diag(linked_design.correlated_covariance(odd, SIGMA))) * scale).any()
    found = linked_design.reprojection(odd, even, SIGMA, error)
    assert length.mean() == pytest.approx(
        found.mean_px, abs=4 * found.scatter_px / np.sqrt(3000) + 0.01 * found.mean_px
    )
    # the formula is of first order; the gyro's few sources make the law skew
    assert length.std() == pytest.approx(found.scatter_px, rel=4 / np.sqrt(6000) + 0.05)
    assert (away[:, ::2] ** 2).sum(1).mean() / len(even.frame) == pytest.approx(found.axis_px[0] ** 2, rel=0.06)


def test_limits_of_the_weighted_gyro(scene, design):
    """A perfect gyro gives ACC, a useless one free attitudes; in between the bound is in between."""
    perfect = np.diag(linked_design.correlated_covariance(design, SIGMA))[:8]
    alone = np.diag(linked_design.free_bound(design, SIGMA))
    assert np.diag(linked_design.linked_bound(design, SIGMA, gyro_drift(scene, 0.0, 0.0)))[:8] == pytest.approx(
        perfect, rel=1e-9
    )
    assert np.diag(linked_design.linked_bound(design, SIGMA, gyro_drift(scene, 0.0, 1e4)))[:8] == pytest.approx(
        alone, rel=1e-3
    )
    between = np.diag(linked_design.linked_bound(design, SIGMA, gyro_drift(scene)))[:8]
    assert np.all(perfect < between)
    assert np.all(between < alone)


def test_lonely_stars_tell_nothing_of_the_camera(design):
    """A frame of one star has two measurements and three unknowns."""
    everything = linked_design.free_bound(design, SIGMA)
    keep = design.frame != 5
    lonely = keep.copy()
    lonely[np.flatnonzero(~keep)[0]] = True
    without = np.diag(linked_design.free_bound(design.select(keep), SIGMA))
    assert np.diag(linked_design.free_bound(design.select(lonely), SIGMA)) == pytest.approx(without, rel=1e-9)
    assert np.all(np.diag(everything) < without)


def test_covariance_of_the_gyro_against_the_simulated_one(scene):
    """500 gyro records integrated; every variance is known to sqrt(2 / 500) = 6.3 %, every covariance likewise."""
    noise = (3.0, 0.05)
    found = gyro_rotations(scene, CONFIG, Streams(4).child("gyro"), range(500), noise)
    # measured = truth exp(-e), e in the axes of the body at the first frame
    drift = np.stack([-(scene.body.inv() * one).as_rotvec() for one in found]).reshape(500, -1)
    expected = gyro_drift(scene, *noise).covariance
    assert np.abs(drift[:, :3]).max() < 1e-12  # no error at the first frame
    measured, expected = (drift.T @ drift / 500)[3:, 3:], expected[3:, 3:]
    size = np.sqrt(np.diag(expected))
    away = (measured - expected) / np.outer(size, size)
    assert np.abs(np.diag(away)).max() < 4.0 * np.sqrt(2 / 500)
    assert np.abs(away).max() < 4.5 * np.sqrt(2 / 500)
    # frames at any times: a walk has the covariance of the earlier one
    time = np.array([0.0, 1.0, 5.0, 5.5])
    walk = linked_design.GyroDrift.of(time, np.zeros((4, 3, 3)), bias_rad_per_s=1.0, walk_rad_per_sqrt_s=2.0).covariance
    np.testing.assert_allclose(walk, 4.0 * np.kron(np.minimum.outer(time, time), np.eye(3)), atol=1e-12)


def test_drift_of_a_constant_bias_is_that_of_the_integrated_rates(scene):
    """A record's bias has one of eight signs; to first order its drift is the integral in axes of the first body."""
    steady = gyro_drift(scene, 3.0, 0.0).steady
    expected = steady @ np.array(list(product((-1.0, 1.0), repeat=3))).T
    for one in gyro_rotations(scene, CONFIG, Streams(4).child("gyro"), range(4), (3.0, 0.0)):
        drift = -(scene.body.inv() * one).as_rotvec().reshape(-1, 1)
        assert np.abs(drift - expected).max(0).min() < 1e-4 * np.abs(steady).max()


def test_least_information_tells_what_is_not_determined(design):
    """Eight stars of one frame, seen twice, have 32 coordinates for 14 unknowns, and determine 8 + 3 at most."""
    assert design.least_information() > 1e-12
    one_frame = np.flatnonzero(design.frame == 0)[:8]
    assert design.select(np.concatenate([one_frame, one_frame])).least_information() < 1e-12
    assert design.select(np.arange(len(design.frame)) < 5).least_information() == 0.0


def test_number_of_stars_that_gives_an_error(scene, design):
    """Twice the mean square of the stars, less the gyro's own: half of the stars."""
    odd, even = (design.select(design.frame % 2 == k) for k in (0, 1))
    error = gyro_drift(scene)
    stars2, both2 = (linked_design.reprojection(odd, even, SIGMA, one).total_px ** 2 for one in (None, error))
    factor, gyro2 = linked_design.stars_of_reprojection(odd, even, SIGMA, error, both2 + stars2)
    assert (factor, gyro2) == (pytest.approx(0.5), pytest.approx(both2 - stars2))
    assert linked_design.stars_of_reprojection(odd, even, SIGMA, error, 0.5 * gyro2)[0] == np.inf
